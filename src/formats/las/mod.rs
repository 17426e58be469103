//! LAS, LAZ and COPC files in.

mod chunks;
mod crs;
mod decode;
pub mod extra;
mod header;
pub mod layout;
mod laz;
mod records;
mod source;
pub mod tables;

pub(super) use header::quoted;
pub use source::LasSource;
pub(super) use source::even_pieces;

//! LAS, LAZ and COPC files in.

mod chunks;
mod crs;
mod decode;
pub mod extra;
mod header;
mod layered;
pub mod layout;
mod laz;
mod records;
#[cfg(test)]
pub(super) mod samples;
mod source;
pub mod tables;
#[cfg(test)]
mod tests;

pub(crate) use crs::{of_facts as crs_of, says_crs};
pub(super) use header::quoted;
pub use source::LasSource;
pub(super) use source::even_pieces;

//! PLY files in: the vertex element's scalars, in all three encodings.

mod ascii;
mod binary;
mod header;
mod layout;
mod lines;
mod source;
#[cfg(test)]
mod tests;

pub(super) use binary::Conversion;
pub(super) use header::{Element, Encoding, Kind, Property};
pub(super) use layout::Target;
pub use source::PlySource;

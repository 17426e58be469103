//! PLY files in: the vertex element's scalars, in all three encodings.

mod ascii;
mod binary;
mod header;
mod layout;
mod source;
#[cfg(test)]
mod tests;

pub use source::PlySource;

//! PCD files in: ascii, binary and binary_compressed.

mod header;
mod layout;
mod lzf;
mod source;
#[cfg(test)]
mod tests;

#[cfg(test)]
pub use tests::samples;

pub use source::open;

//! E57 files in: every scan of a file is a source of its own.
//!
//! The `e57` crate reads pages, XML and packets; here its columns become records, and its errors name a place.

mod columns;
mod source;
#[cfg(test)]
mod tests;

#[cfg(test)]
pub use tests::samples;

pub use source::open;

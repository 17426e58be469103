//! Chunks: one column of one part of one node as bytes, and back. Pure: bytes in, columns out.
//!
//! A chunk is cut into [`Blocks`] of one size (the last one shorter), all chunks of a part alike. A
//! directory at its head says where each block lies, so a block decodes without the others. `docs/format-codec.md` has
//! every byte.
//!
//! What is stored of a value is split in two: a *symbol* (a coarse logarithm, one byte) that an entropy coder
//! shortens (`symbols`), and the bits below it, which are sensor noise and are packed as they are (`residual`). Positions send
//! the differences of sorted Morton keys through it, columns what remains of a value after the transform that is
//! estimated cheapest.
//!
//! Which rows chunks are kept in, and what a column means, is for others to know.

mod bits;
mod block;
mod blocks;
mod checksum;
mod column;
mod dictionary;
mod directory;
mod error;
mod joint;
mod leaders;
mod lines;
mod morton;
mod numbers;
mod passes;
mod position;
mod ranked;
mod reader;
mod residual;
mod scratch;
mod steady;
mod stream;
mod symbols;
#[cfg(test)]
mod tests;
mod value;
mod wide;

pub use blocks::{BlockSize, Blocks};
pub use checksum::Checksum;
pub use column::ColumnChunk;
pub use directory::{Cut, cuts};
pub use error::CodecError;
pub use passes::Passes;
pub use position::PositionChunk;
pub use scratch::{Decoder, Encoder};

/// The most points that a part, and so a chunk, may have.
pub const MAX_POINTS: usize = 1 << 24;

/// The most points of a block.
const BLOCK_POINTS: usize = BlockSize::LARGEST.points();

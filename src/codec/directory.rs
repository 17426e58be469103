//! What all chunks begin with: the codec, the count, and the lengths of the blocks.
//!
//! The head is `codec u8, count varint`; the kind's own bytes follow, and then per block its length as a varint.

use super::reader::{Reader, put_varint};
use super::{Blocks, CodecError, MAX_POINTS, PositionChunk, column};
use crate::lattice::Cube;

/// Writes codec and count.
pub(super) fn put_head(codec: u8, count: usize, out: &mut Vec<u8>) -> Result<(), CodecError> {
    if !(0..=MAX_POINTS).contains(&count) {
        return Err(CodecError::TooManyPoints { count });
    }
    out.push(codec);
    put_varint(count as u64, out);
    Ok(())
}

/// The end of a piece of a chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cut {
    /// From the front of the chunk.
    pub end: usize,
    /// The block that it is; `None`: it is needed with any.
    pub block: Option<usize>,
}

/// The pieces in which the chunk of a part with these blocks can be read, in order: those that are a block each, and what lies before,
/// between and behind them. For positions their cube is given.
///
/// # Errors
///
/// [`CodecError`] if its head is none.
pub fn cuts(bytes: &[u8], positions_of: Option<Cube>, blocks: Blocks) -> Result<Vec<Cut>, CodecError> {
    match positions_of {
        Some(cube) => Ok(PositionChunk::parse(bytes, cube, blocks)?.cuts(bytes.len())),
        None => column::cuts(bytes, blocks),
    }
}

/// Reads codec and count, which must be those expected.
pub(super) fn read_head(reader: &mut Reader, expected: u8, count: usize) -> Result<(), CodecError> {
    if !(0..=MAX_POINTS).contains(&count) {
        return Err(CodecError::TooManyPoints { count });
    }
    let found = reader.u8("codec")?;
    if found != expected {
        return Err(CodecError::Codec { expected, found });
    }
    let found = reader.varint("count of points")?;
    if found != count as u64 {
        return Err(CodecError::Count { expected: count, found });
    }
    Ok(())
}

/// The blocks of a chunk.
#[derive(Clone, Debug)]
pub(super) struct Directory<'a> {
    /// The end of each block in `bytes`, ascending.
    ends: Vec<usize>,
    bytes: &'a [u8],
}

impl<'a> Directory<'a> {
    /// Takes the lengths of so many blocks and then all bytes that are left; the blocks fill them exactly.
    pub(super) fn read(mut reader: Reader<'a>, blocks: usize) -> Result<Self, CodecError> {
        const PLACE: &str = "lengths of the blocks";
        let mut ends = Vec::with_capacity(blocks);
        let mut end = 0_usize;
        for _ in 0..blocks {
            let length = reader.varint(PLACE)?;
            let limit = reader.rest().len();
            let next = usize::try_from(length).ok().and_then(|l| end.checked_add(l)).filter(|e| *e <= limit);
            end = next.ok_or(CodecError::Range { place: PLACE, found: length, limit: limit as u64 })?;
            ends.push(end);
        }
        let bytes = reader.rest();
        if end != bytes.len() {
            return Err(CodecError::Length { place: "blocks", expected: end, found: bytes.len() });
        }
        Ok(Self { ends, bytes })
    }

    /// See [`cuts`]; of a chunk of so many bytes, of which the first `blocks` blocks can be read without each other.
    pub(super) fn cuts(&self, blocks: usize, chunk_bytes: usize) -> Vec<Cut> {
        let head = chunk_bytes - self.bytes.len();
        let mut cuts = vec![Cut { end: head, block: None }];
        cuts.extend((0..blocks).map(|block| Cut { end: head + self.ends[block], block: Some(block) }));
        cuts.push(Cut { end: chunk_bytes, block: None });
        cuts
    }

    /// The bytes of one block.
    pub(super) fn block(&self, block: usize) -> Result<&'a [u8], CodecError> {
        let end = *self.ends.get(block).ok_or(CodecError::Block { block, blocks: self.ends.len() })?;
        let start = block.checked_sub(1).map_or(0, |before| self.ends[before]);
        Ok(&self.bytes[start..end])
    }
}

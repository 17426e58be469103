//! Which pass of a scanner each point belongs to: found from times ([`lines`](super::lines)), stored beside the positions,
//! and what everything that is steady within a pass is encoded by ([`steady`](super::steady)).
//!
//! Per block: `passes u8`; with more than one indices, as of a dictionary. Nothing at all where none are known.

use super::CodecError;
use super::dictionary::{put_indices, read_indices};
use super::lines::{MAX_PASSES, Place};
use super::reader::Reader;
use super::stream::{StreamReader, StreamWriter};

/// The passes of a part's points, block by block, for encoding.
#[derive(Clone, Debug, Default)]
pub struct Passes {
    pub(super) blocks: Vec<BlockPasses>,
}

/// The passes of a block's points.
#[derive(Clone, Debug, Default)]
pub(super) struct BlockPasses {
    /// How many; 0 if none are known.
    pub(super) count: usize,
    /// The pass of each point.
    pub(super) of_point: Vec<u8>,
    /// Where each point is.
    pub(super) places: Vec<Place>,
}

impl BlockPasses {
    /// Appends them; `indices` is for its use.
    pub(super) fn put(&self, streams: &mut StreamWriter, indices: &mut Vec<u8>, out: &mut Vec<u8>) {
        if self.count == 0 {
            return;
        }
        out.push(self.count as u8);
        if self.count > 1 {
            indices.clear();
            indices.extend_from_slice(&self.of_point);
            put_indices(streams, self.count, indices, None, out);
        }
    }
}

/// Reads the passes of a block of `count` points into `out` and gives their number.
pub(super) fn read(
    streams: &mut StreamReader,
    bytes: &[u8],
    count: usize,
    out: &mut Vec<u8>,
) -> Result<usize, CodecError> {
    const PASSES: &str = "passes";
    let mut reader = Reader::new(bytes);
    let passes = usize::from(reader.u8(PASSES)?);
    if !(1..=MAX_PASSES).contains(&passes) {
        return Err(CodecError::Range { place: PASSES, found: passes as u64, limit: MAX_PASSES as u64 });
    }
    if passes == 1 {
        reader.end(PASSES)?;
        out.clear();
        out.resize(count, 0);
    } else {
        read_indices(streams, reader, passes, count, None, out)?;
    }
    Ok(passes)
}

/// What is known beside a column that is encoded.
pub(super) enum Beside<'a> {
    /// Passes are to be found.
    Times(&'a mut Passes),
    /// They are known, or there are none.
    Passes(&'a Passes),
}

/// The same for one block.
pub(super) enum BesideBlock<'a> {
    Times(&'a mut BlockPasses),
    Passes(&'a BlockPasses),
    Nothing,
}

impl Beside<'_> {
    pub(super) fn block(&mut self, block: usize) -> BesideBlock<'_> {
        match self {
            Beside::Times(passes) => passes.blocks.get_mut(block).map_or(BesideBlock::Nothing, BesideBlock::Times),
            Beside::Passes(passes) => passes.blocks.get(block).map_or(BesideBlock::Nothing, BesideBlock::Passes),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_is_a_pass_and_there_are_not_too_many() {
        let mut passes = Vec::new();
        let mut read = |bytes: &[u8]| {
            let found = read(&mut StreamReader::default(), bytes, 3, &mut passes);
            found.map(|count| (count, passes.clone()))
        };
        assert_eq!(read(&[1]), Ok((1, vec![0; 3])));
        // As many as there may be: indices as they are, in a stream of three bytes as they are.
        let most = MAX_PASSES as u8;
        assert_eq!(read(&[most, 0, 3 << 2, 0, most - 1, 1]), Ok((MAX_PASSES, vec![0, most - 1, 1])));
        for found in [0, most + 1] {
            let (found, limit) = (u64::from(found), u64::from(most));
            let error = CodecError::Range { place: "passes", found, limit };
            assert_eq!(read(&[found as u8, 0, 3 << 2, 0, 0, 0]), Err(error));
        }
    }
}

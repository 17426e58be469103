//! The pieces of a chunk row's bytes, each with its own checksum: one can be read and believed without the others.

use super::{Put, Take, Taken};
use crate::codec::Cut;
use std::ops::Range;
use xxhash_rust::xxh3::xxh3_64;

/// Where the pieces end, what they are, and their checksums, in order. As bytes: per piece its length, a varint; its block and
/// one, or 0 where it is needed with any block, a varint; its XXH3-64.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Pieces {
    all: Vec<(Cut, u64)>,
}

impl Pieces {
    /// Of bytes that are cut so; what is needed with any block is joined.
    pub fn of(bytes: &[u8], cuts: impl IntoIterator<Item = Cut>) -> Self {
        let mut all: Vec<(Cut, u64)> = Vec::new();
        for cut in joined(cuts) {
            let start = all.last().map_or(0, |(before, _)| before.end);
            all.push((cut, xxh3_64(&bytes[start..cut.end])));
        }
        Self { all }
    }

    pub fn to_bytes(&self) -> Vec<u8> {
        let mut put = Put::default();
        let mut start = 0;
        for &(Cut { end, block }, sum) in &self.all {
            put.varint((end - start) as u64);
            put.varint(block.map_or(0, |block| block as u64 + 1));
            put.u64(sum);
            start = end;
        }
        put.0
    }

    pub fn parse(bytes: &[u8]) -> Taken<Self> {
        let mut take = Take(bytes);
        let mut all = Vec::with_capacity(bytes.len() / 10);
        let mut end = 0_usize;
        while !take.0.is_empty() {
            let (length, block): (u32, u32) = (take.small()?, take.small()?);
            end = end.checked_add(length as usize).ok_or("a piece is too long")?;
            all.push((Cut { end, block: (block as usize).checked_sub(1) }, take.u64()?));
        }
        Ok(Self { all })
    }

    pub fn len(&self) -> usize {
        self.all.len()
    }

    /// The bytes of all of them.
    pub fn total(&self) -> usize {
        self.all.last().map_or(0, |(cut, _)| cut.end)
    }

    /// Are they those of bytes that are cut so?
    pub fn are_cut(&self, cuts: impl IntoIterator<Item = Cut>) -> bool {
        self.all.iter().map(|(cut, _)| *cut).eq(joined(cuts))
    }

    /// Where a piece lies.
    pub fn range(&self, piece: usize) -> Range<usize> {
        piece.checked_sub(1).map_or(0, |before| self.all[before].0.end)..self.all[piece].0.end
    }

    /// The block that a piece is; `None`: it is needed with any.
    pub fn block(&self, piece: usize) -> Option<usize> {
        self.all[piece].0.block
    }

    /// Is what was read of a piece what was written?
    pub fn is_whole(&self, piece: usize, bytes: &[u8]) -> bool {
        xxh3_64(bytes) == self.all[piece].1
    }
}

/// Without empty pieces, and those side by side joined that are needed with any block.
fn joined(cuts: impl IntoIterator<Item = Cut>) -> Vec<Cut> {
    let mut all: Vec<Cut> = Vec::new();
    for cut in cuts {
        match all.last_mut() {
            Some(before) if before.end == cut.end => {}
            Some(before) if before.block.is_none() && cut.block.is_none() => before.end = cut.end,
            _ => all.push(cut),
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn pieces_come_back_and_know_their_bytes(
            bytes in prop::collection::vec(any::<u8>(), 1..400),
            cuts in prop::collection::btree_map(1_usize..400, prop::option::of(0_usize..9), 0..6),
            at: prop::sample::Index,
            bit in 0_u8..8,
        ) {
            let inside = cuts.iter().filter(|(end, _)| **end < bytes.len()).map(|(&end, &block)| Cut { end, block });
            let cuts: Vec<Cut> = inside.chain([Cut { end: bytes.len(), block: None }]).collect();
            let pieces = Pieces::of(&bytes, cuts.iter().copied());
            let found = Pieces::parse(&pieces.to_bytes()).unwrap();
            prop_assert_eq!(&found, &pieces);
            prop_assert_eq!(found.total(), bytes.len());
            prop_assert!(found.are_cut(cuts.iter().copied()));
            let other = cuts.iter().map(|cut| Cut { end: cut.end, block: cut.block.map(|block| block + 1) });
            prop_assert_eq!(found.are_cut(other), cuts.iter().all(|cut| cut.block.is_none()));
            let block_of = |at: usize| cuts[cuts.partition_point(|cut| cut.end <= at)].block;
            let mut damaged = bytes.clone();
            let at = at.index(bytes.len());
            damaged[at] ^= 1 << bit;
            let mut end = 0;
            for piece in 0..found.len() {
                let range = found.range(piece);
                prop_assert!(range.start == end && range.clone().all(|at| block_of(at) == found.block(piece)));
                end = range.end;
                prop_assert!(found.is_whole(piece, &bytes[range.clone()]));
                prop_assert_eq!(found.is_whole(piece, &damaged[range.clone()]), !range.contains(&at));
            }
        }
    }
}

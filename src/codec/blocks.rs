//! How the points of a part are cut into blocks.

use std::ops::Range;

/// Points of a block, a power of two: what is decoded together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlockSize {
    exponent: u8,
}

impl BlockSize {
    /// 16 points.
    pub const SMALLEST: Self = Self { exponent: 4 };
    /// 1,024 points.
    pub const FINE: Self = Self { exponent: 10 };
    /// 4,096 points.
    pub const LARGEST: Self = Self { exponent: 12 };

    /// `2^exponent` points, if that is a size.
    pub const fn of_exponent(exponent: u8) -> Option<Self> {
        if Self::SMALLEST.exponent <= exponent && exponent <= Self::LARGEST.exponent {
            Some(Self { exponent })
        } else {
            None
        }
    }

    /// The size is 2 to this.
    pub const fn exponent(self) -> u8 {
        self.exponent
    }

    /// The points of every block but the last.
    pub const fn points(self) -> usize {
        1 << self.exponent
    }
}

impl Default for BlockSize {
    fn default() -> Self {
        Self::LARGEST
    }
}

/// The blocks of a part: runs of its points in their order, all of one size but the last, which may be shorter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Blocks {
    points: usize,
    size: BlockSize,
}

impl Blocks {
    /// Of so many points.
    pub const fn new(points: usize, size: BlockSize) -> Self {
        Self { points, size }
    }

    /// The points of all of them.
    pub const fn points(self) -> usize {
        self.points
    }

    /// How many there are.
    pub const fn count(self) -> usize {
        self.points.div_ceil(self.size.points())
    }

    /// The points of one; empty beyond the last.
    pub fn range(self, block: usize) -> Range<usize> {
        let start = block.saturating_mul(self.size.points()).min(self.points);
        start..start.saturating_add(self.size.points()).min(self.points)
    }

    /// How many points one has.
    pub fn len_of(self, block: usize) -> usize {
        self.range(block).len()
    }

    /// The block that a point is in.
    pub const fn of_point(self, point: usize) -> usize {
        point >> self.size.exponent
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn sizes_are_the_powers_of_two_between_the_smallest_and_the_largest() {
        let sizes: Vec<usize> = (0..=u8::MAX).filter_map(BlockSize::of_exponent).map(BlockSize::points).collect();
        assert_eq!(sizes, [16, 32, 64, 128, 256, 512, 1024, 2048, 4096]);
    }

    proptest! {
        #[test]
        fn every_point_is_in_its_block_and_in_no_other(points in 0_usize..10_000, exponent in 4_u8..=12) {
            let blocks = Blocks::new(points, BlockSize::of_exponent(exponent).unwrap());
            let all: Vec<usize> = (0..blocks.count()).flat_map(|block| blocks.range(block)).collect();
            prop_assert!(all.iter().copied().eq(0..points));
            prop_assert!(all.iter().all(|&point| blocks.range(blocks.of_point(point)).contains(&point)));
            prop_assert!((0..blocks.count()).all(|block| blocks.len_of(block) > 0));
            prop_assert_eq!(blocks.len_of(blocks.count()), 0);
        }
    }
}

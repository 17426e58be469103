//! The rows of a cube to key order: scattered to bins by the leading bits of their keys, then sorted bin by bin.

use super::rows::RowKey;
use std::ops::Range;

/// Bits of the scatter. Points lie on surfaces, so about two of three bits tell bins apart: that makes some hundreds of
/// bins, each of which fits a cache with its rows.
const BIN_BITS: u32 = 12;
/// Up to so many keys the standard library's sort is the fastest.
const FEW: usize = 64;
/// Bits of a digit within a bin.
const DIGIT_BITS: u32 = 8;
/// Digits within a bin, at most.
const DIGITS: usize = 3;
/// So many keys are sorted by insertion.
const VERY_FEW: usize = 16;

/// Where the rows of each bin begin.
#[derive(Debug, Default)]
pub(super) struct Bins {
    /// Exponent of the cube.
    k: u8,
    bits: u32,
    /// Counts, one place on; then starts; at last ends.
    starts: Vec<u32>,
}

impl Bins {
    /// Begins to count about `rows` rows of a cube of exponent `k`.
    pub fn clear(&mut self, k: u8, rows: usize) {
        self.k = k;
        self.bits = BIN_BITS.min(3 * u32::from(k)).min(rows.max(1).ilog2().saturating_sub(3));
        self.starts.clear();
        self.starts.resize((1 << self.bits) + 1, 0);
    }

    #[inline]
    pub fn count<K: RowKey>(&mut self, key: K) {
        self.starts[key.bin(self.k, self.bits) + 1] += 1;
    }

    /// Ends counting; gives the number of rows.
    pub fn counted(&mut self) -> usize {
        let mut sum = 0;
        for start in &mut self.starts {
            sum += *start;
            *start = sum;
        }
        sum as usize
    }

    /// The place of the next row with this key; all rows that were counted get one.
    #[inline]
    pub fn place<K: RowKey>(&mut self, key: K) -> usize {
        let start = &mut self.starts[key.bin(self.k, self.bits)];
        *start += 1;
        *start as usize - 1
    }
}

/// Sorts keys that lie in their bins; keeps its buffers.
#[derive(Debug, Default)]
pub(super) struct Sorter<K> {
    packed: Vec<u64>,
    other: Vec<u64>,
    pairs: Vec<(K, u32)>,
}

impl<K: RowKey> Sorter<K> {
    /// Sorts `keys`, each of which lies where `bins` has placed it. After each bin, `each` is told which places are the
    /// bin's and which place each of its keys had; `order` is where that is put.
    pub fn sort(
        &mut self,
        bins: &Bins,
        keys: &mut [K],
        order: &mut Vec<u32>,
        mut each: impl FnMut(Range<usize>, &[u32]),
    ) {
        let known = bins.bits;
        let bits = 3 * u32::from(bins.k) - known;
        let mut start = 0;
        // With all rows placed, each bin's start has become its end.
        for &end in &bins.starts[..1 << known] {
            let bin = start..end as usize;
            start = bin.end;
            if !bin.is_empty() {
                order.clear();
                self.sort_bin(&mut keys[bin.clone()], bits, bin.start as u32, order);
                each(bin, order);
            }
        }
    }

    /// Sorts the keys of a bin, which differ in their lowest `bits` bits at most and lie from place `first` on; `order` gets
    /// the place that each had.
    fn sort_bin(&mut self, bin: &mut [K], bits: u32, first: u32, order: &mut Vec<u32>) {
        let Some(last) = bin.len().checked_sub(1) else { return };
        let index_bits = usize::BITS - last.leading_zeros();
        if bits + index_bits > 63 {
            self.pairs.clear();
            self.pairs.extend(bin.iter().copied().zip(first..));
            self.pairs.sort_unstable_by_key(|p| p.0);
            bin.iter_mut().zip(&self.pairs).for_each(|(key, pair)| *key = pair.0);
            order.extend(self.pairs.iter().map(|p| p.1));
            return;
        }
        // What differs, and the place in the bin, in one number.
        let Self { packed, other, .. } = self;
        packed.clear();
        packed.extend(bin.iter().zip(0..).map(|(key, i)| key.low_bits(bits) << index_bits | i));
        sort_packed(packed, other, bits, index_bits);
        bin.iter_mut().zip(&*packed).for_each(|(key, packed)| *key = key.with_low_bits(bits, packed >> index_bits));
        let index = (1 << index_bits) - 1;
        order.extend(packed.iter().map(|packed| first + (packed & index) as u32));
    }
}

/// Sorts numbers by the `bits` bits from bit `shift` on, above which they have none.
fn sort_packed(packed: &mut Vec<u64>, other: &mut Vec<u64>, bits: u32, shift: u32) {
    let n = packed.len();
    if n <= FEW {
        packed.sort_unstable();
        return;
    }
    // Digits from the finest on, each sort stable; so many that, on a surface, few numbers agree in all of them.
    let telling = (3 * n.ilog2() / 2 + 1).min(bits);
    let digits = (telling.div_ceil(DIGIT_BITS) as usize).min(DIGITS);
    let lowest = shift + bits.saturating_sub(DIGIT_BITS * digits as u32);
    // The last digit may reach beyond the bits, where nothing differs.
    let digit = |v: u64, i: usize| (v >> (lowest + DIGIT_BITS * i as u32)) as usize & ((1 << DIGIT_BITS) - 1);
    let mut counts = [[0_u32; 1 << DIGIT_BITS]; DIGITS];
    for &v in packed.iter() {
        for (i, counts) in counts[..digits].iter_mut().enumerate() {
            counts[digit(v, i)] += 1;
        }
    }
    // Every place is overwritten.
    other.resize(n, 0);
    for (i, counts) in counts[..digits].iter_mut().enumerate() {
        let mut place = 0;
        for count in counts.iter_mut() {
            place += std::mem::replace(count, place);
        }
        for &v in packed.iter() {
            let place = &mut counts[digit(v, i)];
            other[*place as usize] = v;
            *place += 1;
        }
        std::mem::swap(packed, other);
    }
    if lowest > shift {
        for run in packed.chunk_by_mut(|a, b| a >> lowest == b >> lowest) {
            if run.len() > VERY_FEW { run.sort_unstable() } else { sort_by_insertion(run) }
        }
    }
}

fn sort_by_insertion(run: &mut [u64]) {
    for end in 1..run.len() {
        let v = run[end];
        let mut place = end;
        while place > 0 && v < run[place - 1] {
            run[place] = run[place - 1];
            place -= 1;
        }
        run[place] = v;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::{Cube, Key, LatticePoint};
    use proptest::prelude::*;

    /// Scatters and sorts; gives the sorted keys, and for each the number that its point has in `points`.
    fn sorted<K: RowKey>(
        points: &[LatticePoint],
        k: u8,
        (bins, sorter): (&mut Bins, &mut Sorter<K>),
    ) -> (Vec<K>, Vec<u32>) {
        bins.clear(k, points.len());
        points.iter().for_each(|p| bins.count(K::of(*p)));
        assert_eq!(bins.counted(), points.len());
        let mut keys = vec![K::default(); points.len()];
        let mut numbers = vec![0; points.len()];
        for (i, p) in (0..).zip(points) {
            let place = bins.place(K::of(*p));
            keys[place] = K::of(*p);
            numbers[place] = i;
        }
        let mut order = Vec::new();
        sorter.sort(bins, &mut keys, &mut vec![7; 3], |bin, of_bin| {
            assert_eq!((bin.start, bin.len()), (order.len(), of_bin.len()));
            order.extend_from_slice(of_bin);
        });
        (keys, order.iter().map(|&place| numbers[place as usize]).collect())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]
        #[test]
        fn sorting_in_bins_is_sorting(
            k in 0_u8..=48, low in 0_u64..1 << 48, spread in 1_u64..1 << 48, flat: bool, n in 1_usize..20_000, earlier in 1_usize..20_000, seed: u64,
        ) {
            let cube = Cube::containing(LatticePoint([low, low / 3, low / 7]), k);
            let mut state = seed | 1;
            let mut next = || { state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407); state >> 16 };
            let points: Vec<_> = (0..n)
                .map(|_| {
                    let [x, y, z] = cube.low().0.map(|c| c + next() % spread.min(cube.side()));
                    LatticePoint([x, y, if flat { cube.low().0[2] } else { z }])
                })
                .collect();
            let mut expected: Vec<_> = points.iter().map(|&p| Key::of(p)).collect();
            expected.sort_unstable();
            let (mut bins, mut narrow, mut wide) = (Bins::default(), Sorter::default(), Sorter::default());
            // What a sorter keeps from other keys must not matter.
            sorted::<Key>(&points[..earlier.min(n)], k, (&mut bins, &mut wide));
            let (keys, order) = sorted::<Key>(&points, k, (&mut bins, &mut wide));
            prop_assert_eq!(&keys, &expected);
            let mut all = order.clone();
            all.sort_unstable();
            prop_assert!(all.into_iter().eq(0..n as u32));
            prop_assert!(keys.iter().zip(&order).all(|(key, &i)| *key == Key::of(points[i as usize])));
            if k <= 21 {
                sorted::<u64>(&points[..earlier.min(n)], k, (&mut bins, &mut narrow));
                let (keys, order) = sorted::<u64>(&points, k, (&mut bins, &mut narrow));
                prop_assert!(keys.iter().zip(&expected).all(|(key, full)| key.full(cube.first_key()) == *full));
                prop_assert!(keys.iter().zip(&order).all(|(key, &i)| *key == <u64 as RowKey>::of(points[i as usize])));
                let mut all = order.clone();
                all.sort_unstable();
                prop_assert!(all.into_iter().eq(0..n as u32));
            }
        }
    }
}

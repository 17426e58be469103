//! Rows: a sort key, then a record's payload. The form in which points wait for their node.

use crate::lattice::{Key, LatticePoint, SortKey};

/// A sort key with a fixed form in bytes.
///
/// `u64` (the low 63 bits of the full key) does for buckets of up to 21 levels, which is nearly every site; `Key`
/// serves the others.
pub(super) trait RowKey: SortKey + Default {
    /// Bytes of a key in a row.
    const BYTES: usize;
    /// The key of a point.
    fn of(point: LatticePoint) -> Self;
    /// Puts the key at the start of a row of at least [`RowKey::BYTES`].
    fn write(self, row: &mut [u8]);
    /// Reads the key at the start of a row of at least [`RowKey::BYTES`].
    fn read(row: &[u8]) -> Self;
    /// The full key of a point with this key in a cube whose first key is `first`.
    fn full(self, first: Key) -> Key;
    /// The `bits` bits of the key below digit `k`: a bin number that keeps the order among the points of a cube of
    /// exponent `k`.
    fn bin(self, k: u8, bits: u32) -> usize;
    /// The key's bits from bit `lowest` on, at most the lowest 64 of them.
    fn bits_from(self, lowest: u32) -> u64;
}

impl RowKey for u64 {
    const BYTES: usize = 8;

    #[inline]
    fn of(point: LatticePoint) -> Self {
        point.low_key()
    }

    #[inline]
    fn write(self, row: &mut [u8]) {
        row[..8].copy_from_slice(&self.to_le_bytes());
    }

    #[inline]
    fn read(row: &[u8]) -> Self {
        let mut bytes = [0; 8];
        bytes.copy_from_slice(&row[..8]);
        Self::from_le_bytes(bytes)
    }

    #[inline]
    fn full(self, first: Key) -> Key {
        Key { high: first.high, low: self }
    }

    #[inline]
    fn bin(self, k: u8, bits: u32) -> usize {
        let width = 3 * u32::from(k);
        let below = if width >= 64 { self } else { self & ((1 << width) - 1) };
        (below >> width.saturating_sub(bits)) as usize
    }

    #[inline]
    fn bits_from(self, lowest: u32) -> u64 {
        self.checked_shr(lowest).unwrap_or(0)
    }
}

impl RowKey for Key {
    const BYTES: usize = 24;

    fn of(point: LatticePoint) -> Self {
        Key::of(point)
    }

    fn write(self, row: &mut [u8]) {
        row[..16].copy_from_slice(&self.high.to_le_bytes());
        row[16..24].copy_from_slice(&self.low.to_le_bytes());
    }

    fn read(row: &[u8]) -> Self {
        let (mut high, mut low) = ([0; 16], [0; 8]);
        high.copy_from_slice(&row[..16]);
        low.copy_from_slice(&row[16..24]);
        Self { high: u128::from_le_bytes(high), low: u64::from_le_bytes(low) }
    }

    fn full(self, _: Key) -> Key {
        self
    }

    fn bin(self, k: u8, bits: u32) -> usize {
        let width = 3 * u32::from(k);
        if width <= 63 {
            return self.low.bin(k, bits);
        }
        let high_bits = width - 63;
        let mask = if high_bits >= 128 { u128::MAX } else { (1 << high_bits) - 1 };
        let joined = (self.high & mask) << 40 | u128::from(self.low >> 23);
        (joined >> (high_bits + 40).saturating_sub(bits)) as usize
    }

    #[inline]
    fn bits_from(self, lowest: u32) -> u64 {
        let high = match lowest.checked_sub(63) {
            Some(shift) => return self.high.checked_shr(shift).unwrap_or(0) as u64,
            None => self.high << (63 - lowest),
        };
        high as u64 | self.low >> lowest
    }
}

/// Sorts `(key, index)` pairs; keeps its buffers.
#[derive(Debug, Default)]
pub(super) struct PairSorter<K> {
    scattered: Vec<(K, u32)>,
    starts: Vec<u32>,
}

/// Up to so many pairs the standard library's sort is the fastest.
const FEW: usize = 64;
/// Bits of the first scatter. Points lie on surfaces, so about two of three bits tell bins apart.
const FIRST_BITS: u32 = 12;
/// Bits of the digits after it.
const DIGIT_BITS: u32 = 8;
/// Digits after it, at most.
const DIGITS: usize = 3;
/// So many pairs are sorted by insertion.
const VERY_FEW: usize = 16;

impl<K: RowKey> PairSorter<K> {
    /// Sorts pairs of one cube of exponent `k` by key: a scatter by the leading bits to bins that fit the first-level
    /// cache; a radix sort by the next bits in each; the standard library's sort for what agrees in these.
    pub fn sort(&mut self, pairs: &mut Vec<(K, u32)>, k: u8) {
        let n = pairs.len();
        if n <= FEW || k == 0 {
            pairs.sort_unstable_by_key(|p| p.0);
            return;
        }
        let first_bits = FIRST_BITS.min(3 * u32::from(k)).min(n.ilog2().saturating_sub(3));
        let starts = &mut self.starts;
        starts.clear();
        starts.resize((1 << first_bits) + 1, 0);
        for (key, _) in pairs.iter() {
            starts[key.bin(k, first_bits) + 1] += 1;
        }
        for i in 0..1 << first_bits {
            starts[i + 1] += starts[i];
        }
        // Every place is overwritten.
        self.scattered.resize(n.max(self.scattered.len()), pairs[0]);
        let scattered = &mut self.scattered[..n];
        for &(key, index) in pairs.iter() {
            let place = &mut starts[key.bin(k, first_bits)];
            scattered[*place as usize] = (key, index);
            *place += 1;
        }
        // Each bin's start has become its end, which is the next one's start.
        let mut start = 0;
        for &end in &starts[..1 << first_bits] {
            let bin = start..end as usize;
            start = bin.end;
            sort_bin(&mut scattered[bin.clone()], &mut pairs[bin], k, first_bits);
        }
        std::mem::swap(pairs, &mut self.scattered);
        pairs.truncate(n);
    }
}

/// Sorts `bin`, whose keys agree in the cube's `known` leading bits; `other` is of the same size, its content is lost.
fn sort_bin<K: RowKey>(bin: &mut [(K, u32)], other: &mut [(K, u32)], k: u8, known: u32) {
    let bits = 3 * u32::from(k) - known;
    if bin.len() <= FEW || bits == 0 {
        bin.sort_unstable_by_key(|p| p.0);
        return;
    }
    // Digits from the finest on, each sort stable; so many that, on a surface, few pairs agree in all of them.
    let telling = (3 * bin.len().ilog2() / 2 + 1).min(bits);
    let digits = (telling.div_ceil(DIGIT_BITS) as usize).min(DIGITS);
    let lowest = bits.saturating_sub(DIGIT_BITS * digits as u32);
    let digit = |key: K, i: usize| key.bits_from(lowest + DIGIT_BITS * i as u32) as usize & ((1 << DIGIT_BITS) - 1);
    let mut counts = [[0_u32; 1 << DIGIT_BITS]; DIGITS];
    for (key, _) in bin.iter() {
        for (i, counts) in counts[..digits].iter_mut().enumerate() {
            counts[digit(*key, i)] += 1;
        }
    }
    // Above the known bits nothing differs, so the last digit may reach beyond them.
    let (mut from, mut to) = (&mut *bin, &mut *other);
    let mut swapped = false;
    for (i, counts) in counts[..digits].iter_mut().enumerate() {
        let mut place = 0;
        for count in counts.iter_mut() {
            place += std::mem::replace(count, place);
        }
        for &(key, index) in from.iter() {
            let place = &mut counts[digit(key, i)];
            to[*place as usize] = (key, index);
            *place += 1;
        }
        std::mem::swap(&mut from, &mut to);
        swapped = !swapped;
    }
    if swapped {
        bin.copy_from_slice(other);
    }
    if lowest > 0 {
        for run in bin.chunk_by_mut(|a, b| a.0.bits_from(lowest) == b.0.bits_from(lowest)) {
            if run.len() > VERY_FEW {
                run.sort_unstable_by_key(|p| p.0);
            } else {
                sort_by_insertion(run);
            }
        }
    }
}

fn sort_by_insertion<K: RowKey>(run: &mut [(K, u32)]) {
    for end in 1..run.len() {
        let pair = run[end];
        let mut place = end;
        while place > 0 && pair.0 < run[place - 1].0 {
            run[place] = run[place - 1];
            place -= 1;
        }
        run[place] = pair;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::Cube;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn sorting_pairs_is_sorting(
            k in 0_u8..=21, low in 0_u64..1 << 48, spread in 1_u64..1 << 21, n in 1_usize..20_000, earlier in 1_usize..20_000, seed in any::<u64>(),
        ) {
            let cube = Cube::containing(LatticePoint([low, low / 3, low / 7]), k);
            let mut state = seed | 1;
            let mut next = || { state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407); state >> 33 };
            let points: Vec<_> = (0..n)
                .map(|_| LatticePoint(cube.low().0.map(|c| c + (next() % spread.min(cube.side())))))
                .collect();
            let narrow: Vec<_> = (0..).zip(&points).map(|(i, &p)| (<u64 as RowKey>::of(p), i)).collect();
            let wide: Vec<_> = (0..).zip(&points).map(|(i, &p)| (<Key as RowKey>::of(p), i)).collect();
            let mut expected: Vec<_> = points.iter().map(|&p| Key::of(p)).collect();
            expected.sort_unstable();
            let (mut narrow, mut wide) = (narrow, wide);
            let (mut narrow_sorter, mut wide_sorter) = (PairSorter::default(), PairSorter::default());
            // What a sorter keeps from other pairs must not matter.
            narrow_sorter.sort(&mut narrow[..earlier.min(n)].to_vec(), k);
            narrow_sorter.sort(&mut narrow, k);
            wide_sorter.sort(&mut wide, k);
            prop_assert!(narrow.len() == n && wide.len() == n);
            for i in 0..n {
                prop_assert_eq!(narrow[i].0.full(cube.first_key()), expected[i]);
                prop_assert_eq!(wide[i].0, expected[i]);
                prop_assert_eq!(Key::of(points[narrow[i].1 as usize]), expected[i]);
            }
        }

        #[test]
        fn bins_of_wide_keys_keep_the_order(
            a in prop::array::uniform3(0_u64..1 << 48), b in prop::array::uniform3(0_u64..1 << 48), k in 22_u8..=48, bits in 1_u32..=16,
        ) {
            let cube = Cube::containing(LatticePoint(a), k);
            let b = LatticePoint(std::array::from_fn(|i| cube.low().0[i] | b[i] & (cube.side() - 1)));
            let (ka, kb) = (Key::of(LatticePoint(a)), Key::of(b));
            prop_assert!(ka.bin(k, bits) < 1 << bits);
            if ka < kb {
                prop_assert!(ka.bin(k, bits) <= kb.bin(k, bits));
            }
        }
    }
}

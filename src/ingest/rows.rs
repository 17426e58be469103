//! Rows: a sort key, then a record's payload. The form in which points wait for their node.

use crate::lattice::{Cube, Key, LatticePoint, SortKey};

/// A sort key with a fixed form in bytes.
///
/// `u64` (the low 63 bits of the full key) does for buckets of up to 21 levels, which is nearly every site; `Key`
/// serves the others.
pub(super) trait RowKey: SortKey {
    /// Bytes of a key in a row.
    const BYTES: usize;
    /// The key of a point.
    fn of(point: LatticePoint) -> Self;
    /// Appends the key.
    fn push(self, row: &mut Vec<u8>);
    /// Reads the key at the start of a row of at least [`RowKey::BYTES`].
    fn read(row: &[u8]) -> Self;
    /// The full key of a point with this key in `cube`.
    fn full(self, cube: Cube) -> Key;
    /// The `bits` bits of the key below digit `k`: a bin number that keeps the order among the points of a cube of
    /// exponent `k`.
    fn bin(self, k: u8, bits: u32) -> usize;
}

impl RowKey for u64 {
    const BYTES: usize = 8;

    #[inline]
    fn of(point: LatticePoint) -> Self {
        point.low_key()
    }

    #[inline]
    fn push(self, row: &mut Vec<u8>) {
        row.extend_from_slice(&self.to_le_bytes());
    }

    #[inline]
    fn read(row: &[u8]) -> Self {
        let mut bytes = [0; 8];
        bytes.copy_from_slice(&row[..8]);
        Self::from_le_bytes(bytes)
    }

    #[inline]
    fn full(self, cube: Cube) -> Key {
        Key { high: cube.first_key().high, low: self }
    }

    #[inline]
    fn bin(self, k: u8, bits: u32) -> usize {
        let width = 3 * u32::from(k);
        let below = if width >= 64 { self } else { self & ((1 << width) - 1) };
        (below >> width.saturating_sub(bits)) as usize
    }
}

impl RowKey for Key {
    const BYTES: usize = 24;

    fn of(point: LatticePoint) -> Self {
        Key::of(point)
    }

    fn push(self, row: &mut Vec<u8>) {
        row.extend_from_slice(&self.high.to_le_bytes());
        row.extend_from_slice(&self.low.to_le_bytes());
    }

    fn read(row: &[u8]) -> Self {
        let (mut high, mut low) = ([0; 16], [0; 8]);
        high.copy_from_slice(&row[..16]);
        low.copy_from_slice(&row[16..24]);
        Self { high: u128::from_le_bytes(high), low: u64::from_le_bytes(low) }
    }

    fn full(self, _cube: Cube) -> Key {
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
}

/// Sorts `(key, index)` pairs of one cube of exponent `k` by key: a scatter by the leading bits, then small sorts.
pub(super) fn sort_pairs<K: RowKey>(pairs: Vec<(K, u32)>, k: u8) -> Vec<(K, u32)> {
    const LARGE: usize = 2048;
    let n = pairs.len();
    if n < LARGE || k == 0 {
        let mut pairs = pairs;
        pairs.sort_unstable_by_key(|p| p.0);
        return pairs;
    }
    // About 32 pairs a bin: small sorts then stay in the first-level cache.
    let bits = (n.ilog2().saturating_sub(5)).min(3 * u32::from(k)).min(16);
    let mut starts = vec![0_u32; (1 << bits) + 1];
    for (key, _) in &pairs {
        starts[key.bin(k, bits) + 1] += 1;
    }
    for i in 0..1 << bits {
        starts[i + 1] += starts[i];
    }
    let mut next = starts.clone();
    let mut sorted = vec![pairs[0]; n];
    for &(key, index) in &pairs {
        let slot = &mut next[key.bin(k, bits)];
        sorted[*slot as usize] = (key, index);
        *slot += 1;
    }
    for bin in starts.windows(2) {
        sorted[bin[0] as usize..bin[1] as usize].sort_unstable_by_key(|p| p.0);
    }
    sorted
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn sorting_pairs_is_sorting(
            k in 0_u8..=21, low in 0_u64..1 << 48, spread in 1_u64..1 << 21, n in 1_usize..6000, seed in any::<u64>(),
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
            let narrow = sort_pairs(narrow, k);
            let wide = sort_pairs(wide, k);
            for i in 0..n {
                prop_assert_eq!(narrow[i].0.full(cube), expected[i]);
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

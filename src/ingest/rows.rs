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
    /// The lowest `bits` bits of the key, at most 63.
    fn low_bits(self, bits: u32) -> u64;
    /// The key with other lowest `bits` bits, at most 63: those of `low`, which has no others.
    fn with_low_bits(self, bits: u32, low: u64) -> Self;
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
    fn low_bits(self, bits: u32) -> u64 {
        self & ((1 << bits) - 1)
    }

    #[inline]
    fn with_low_bits(self, bits: u32, low: u64) -> Self {
        self >> bits << bits | low
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

    fn low_bits(self, bits: u32) -> u64 {
        self.low.low_bits(bits)
    }

    fn with_low_bits(self, bits: u32, low: u64) -> Self {
        Self { low: self.low.with_low_bits(bits, low), ..self }
    }
}

/// Words of 8 bytes, the last two of which may overlap, that a payload of so many bytes is copied as; 0 where bytes are
/// copied one by one. A call to copy so few bytes takes longer than the copy, so the number is to be a constant where
/// many are copied.
pub(super) const fn payload_words(bytes: usize) -> usize {
    match bytes {
        8..=64 => bytes.div_ceil(8),
        _ => 0,
    }
}

/// Calls a function whose last generic parameter is a number of words, with [`payload_words`] of `$bytes` for it.
macro_rules! with_payload_words {
    (@ $words:literal, $call:ident [$($generic:ty,)*] $arguments:tt) => {
        $call::<$($generic,)* $words> $arguments
    };
    ($bytes:expr, $call:ident $(::<$($generic:ty),+>)? ($($argument:expr),*)) => {
        match crate::ingest::rows::payload_words($bytes) {
            1 => with_payload_words!(@ 1, $call [$($($generic,)+)?] ($($argument),*)),
            2 => with_payload_words!(@ 2, $call [$($($generic,)+)?] ($($argument),*)),
            3 => with_payload_words!(@ 3, $call [$($($generic,)+)?] ($($argument),*)),
            4 => with_payload_words!(@ 4, $call [$($($generic,)+)?] ($($argument),*)),
            5 => with_payload_words!(@ 5, $call [$($($generic,)+)?] ($($argument),*)),
            6 => with_payload_words!(@ 6, $call [$($($generic,)+)?] ($($argument),*)),
            7 => with_payload_words!(@ 7, $call [$($($generic,)+)?] ($($argument),*)),
            8 => with_payload_words!(@ 8, $call [$($($generic,)+)?] ($($argument),*)),
            _ => with_payload_words!(@ 0, $call [$($($generic,)+)?] ($($argument),*)),
        }
    };
}
pub(super) use with_payload_words;

/// Copies a payload of [`payload_words`] `WORDS`.
#[inline]
pub(super) fn copy_payload<const WORDS: usize>(from: &[u8], to: &mut [u8]) {
    if WORDS == 0 {
        to.copy_from_slice(from);
        return;
    }
    let mut copy = |start: usize| to[start..start + 8].copy_from_slice(&from[start..start + 8]);
    for word in 0..WORDS - 1 {
        copy(8 * word);
    }
    copy(from.len() - 8);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::Cube;
    use proptest::prelude::*;

    proptest! {
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
            let bits = bits.min(63);
            prop_assert_eq!(ka.with_low_bits(bits, ka.low_bits(bits)), ka);
            prop_assert_eq!(kb.with_low_bits(bits, ka.low_bits(bits)).low_bits(bits), ka.low_bits(bits));
        }
    }
}

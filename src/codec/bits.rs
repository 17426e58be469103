//! Bits packed lowest first into bytes.

/// Bytes that a reader may look at beyond the last bit.
pub(super) const PADDING: usize = 8;

/// The most bits that one read or write can take.
pub(super) const MAX_BITS: u32 = 56;

/// Packs numbers of any widths behind one another.
#[derive(Debug)]
pub(super) struct BitWriter<'a> {
    out: &'a mut [u8],
    /// Where in `out` the first byte of `pending` goes.
    at: usize,
    pending: u64,
    /// Bits in `pending`, at most 7 between calls.
    filled: u32,
}

impl<'a> BitWriter<'a> {
    /// Writes from the beginning of `buffer`, which gets room for `bits` bits.
    pub(super) fn new(buffer: &'a mut Vec<u8>, bits: usize) -> Self {
        let needed = bits.div_ceil(8) + 2 * PADDING;
        if buffer.len() < needed {
            buffer.resize(needed, 0);
        }
        Self { out: buffer, at: 0, pending: 0, filled: 0 }
    }

    /// Appends the low `bits <= MAX_BITS` bits of `value`; those above must be zero.
    #[inline]
    pub(super) fn put(&mut self, value: u64, bits: u32) {
        debug_assert!(bits <= MAX_BITS && value >> bits == 0);
        self.pending |= value << self.filled;
        self.filled += bits;
        self.out[self.at..self.at + 8].copy_from_slice(&self.pending.to_le_bytes());
        // At most 7 whole bytes: 56 new bits behind 7 old ones.
        let whole = self.filled / 8;
        self.at += whole as usize;
        self.pending >>= 8 * whole;
        self.filled %= 8;
    }

    /// The same for up to 64 bits.
    #[inline]
    pub(super) fn put_wide(&mut self, value: u64, bits: u32) {
        if bits > 32 {
            self.put(value & u64::from(u32::MAX), 32);
            self.put(value >> 32, bits - 32);
        } else {
            self.put(value, bits);
        }
    }

    /// How many bytes were written; the last one is filled with zeros.
    pub(super) fn finish(self) -> usize {
        self.at + usize::from(self.filled > 0)
    }
}

/// The `bits <= MAX_BITS` bits at bit `at`. `bytes` must reach [`PADDING`] bytes beyond them.
#[inline]
pub(super) fn bits_at(bytes: &[u8], at: usize, bits: u32) -> u64 {
    let start = at / 8;
    let mut word = [0; 8];
    word.copy_from_slice(&bytes[start..start + 8]);
    u64::from_le_bytes(word) >> (at % 8) & ((1 << bits) - 1)
}

/// The same for up to 64 bits.
#[inline]
pub(super) fn wide_bits_at(bytes: &[u8], at: usize, bits: u32) -> u64 {
    if bits > 32 { bits_at(bytes, at, 32) | bits_at(bytes, at + 32, bits - 32) << 32 } else { bits_at(bytes, at, bits) }
}

/// The same as [`bits_at`] for bytes that may end before: what is not there is zeros.
#[inline]
pub(super) fn bits_or_zeros(bytes: &[u8], at: usize, bits: u32) -> u64 {
    let word = bytes.get(at / 8..).and_then(|rest| rest.first_chunk()).map_or(0, |word| u64::from_le_bytes(*word));
    word >> (at % 8) & ((1 << bits) - 1)
}

/// The same for up to 64 bits.
#[inline]
pub(super) fn wide_bits_or_zeros(bytes: &[u8], at: usize, bits: u32) -> u64 {
    if bits > 32 {
        bits_or_zeros(bytes, at, 32) | bits_or_zeros(bytes, at + 32, bits - 32) << 32
    } else {
        bits_or_zeros(bytes, at, bits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn bits_come_back_in_order(numbers in prop::collection::vec((any::<u64>(), 0_u32..=64), 0..200)) {
            let cut = |value: u64, bits: u32| value.checked_shr(64 - bits).unwrap_or(0);
            let mut bytes = Vec::new();
            let total: u32 = numbers.iter().map(|n| n.1).sum();
            let mut writer = BitWriter::new(&mut bytes, total as usize);
            numbers.iter().for_each(|&(v, bits)| writer.put_wide(cut(v, bits), bits));
            let written = writer.finish();
            bytes.truncate(written);
            prop_assert_eq!(bytes.len(), total.div_ceil(8) as usize);
            bytes.extend([0xff; PADDING]);
            let mut at = 0;
            for &(value, bits) in &numbers {
                prop_assert_eq!(wide_bits_at(&bytes, at, bits), cut(value, bits));
                prop_assert_eq!(wide_bits_or_zeros(&bytes, at, bits), cut(value, bits));
                at += bits as usize;
            }
            // Seven bytes are no word, and nor are none.
            for end in [8 * bytes.len() - 56, 8 * bytes.len() + 99] {
                prop_assert_eq!(wide_bits_or_zeros(&bytes, end, 64), 0);
            }
        }
    }
}

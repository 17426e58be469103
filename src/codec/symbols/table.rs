//! How often each symbol of a context is expected: counts, rounded to what is stored, and brought to a common sum.
//!
//! A count is stored as a *weight* of three significant bits, an exponent (0 for a symbol that is not there) and two bits
//! after the leading one. Exponents are stored by their difference to the one before, which is mostly small. Coding by
//! rounded weights costs about a 200th of a bit a symbol; exact ones would cost more to store.

use super::super::CodecError;
use super::super::bits::{BitWriter, wide_bits_at};

/// Symbols are bytes.
pub(super) const MAX_SYMBOLS: usize = 256;

/// Bits of a weight behind its leading one.
const MANTISSA_BITS: u32 = 2;

/// Bits of an exponent that is stored as it is.
const EXPONENT_BITS: u32 = 4;

/// The most bits that a symbol takes in a stored table.
pub(super) const MAX_STORED_BITS: usize = (2 + EXPONENT_BITS + MANTISSA_BITS) as usize;

/// Exponents are at most 15, so a weight is at most 7 << 14.
const MAX_EXPONENT: u32 = (1 << EXPONENT_BITS) - 1;

/// Exponent and mantissa of the weight nearest to a count below 2^13.
fn weight_of(count: u32) -> (u32, u32) {
    if count == 0 {
        return (0, 0);
    }
    let scaled = count << MANTISSA_BITS;
    let shift = scaled.ilog2() - MANTISSA_BITS;
    let rounded = (scaled + (1 << shift >> 1)) >> shift;
    // Rounding up may carry.
    if rounded >> (MANTISSA_BITS + 1) == 0 { (shift + 1, rounded & 3) } else { (shift + 2, 0) }
}

fn weight(exponent: u32, mantissa: u32) -> u32 {
    if exponent == 0 { 0 } else { (1 << MANTISSA_BITS | mantissa) << (exponent - 1) }
}

/// Writes the table of these counts, each below 2^13, and puts what a reader will find in their place: numbers that add
/// up to `sum`, none of them 0 that was not.
pub(super) fn put(counts: &mut [u32], sum: u32, writer: &mut BitWriter) {
    let mut before = 0;
    for count in counts.iter_mut() {
        let (exponent, mantissa) = weight_of(*count);
        match exponent.wrapping_sub(before) as i32 {
            0 => writer.put(0b0, 1),
            1 => writer.put(0b001, 3),
            -1 => writer.put(0b101, 3),
            _ => writer.put(0b11 | u64::from(exponent) << 2, 2 + EXPONENT_BITS),
        }
        if exponent > 0 {
            writer.put(mantissa.into(), MANTISSA_BITS);
        }
        before = exponent;
        *count = weight(exponent, mantissa);
    }
    normalize(counts, sum);
}

/// Bits at a place, and on.
pub(super) struct Bits<'a> {
    /// With [`PADDING`](super::super::bits::PADDING) behind them.
    pub bytes: &'a [u8],
    /// How many bits there are without it.
    pub len: usize,
    pub at: usize,
}

impl Bits<'_> {
    pub(super) fn take(&mut self, bits: u32) -> Result<u32, CodecError> {
        if self.at + bits as usize > self.len {
            return Err(CodecError::Truncated { place: super::PLACE, needed: self.at / 8 + 1, found: self.len / 8 });
        }
        let value = wide_bits_at(self.bytes, self.at, bits);
        self.at += bits as usize;
        Ok(value as u32)
    }
}

/// The reverse of [`put`].
pub(super) fn read(bits: &mut Bits, numbers: &mut [u32], sum: u32) -> Result<(), CodecError> {
    let mut exponent = 0_u32;
    for number in numbers.iter_mut() {
        if bits.take(1)? == 1 {
            exponent = if bits.take(1)? == 1 {
                bits.take(EXPONENT_BITS)?
            } else if bits.take(1)? == 0 {
                exponent + 1
            } else {
                exponent.wrapping_sub(1)
            };
            if exponent > MAX_EXPONENT {
                let (found, limit) = (exponent.into(), MAX_EXPONENT.into());
                return Err(CodecError::Range { place: "weight of a symbol", found, limit });
            }
        }
        *number = if exponent == 0 { 0 } else { weight(exponent, bits.take(MANTISSA_BITS)?) };
    }
    if numbers.iter().all(|n| *n == 0) {
        return Err(CodecError::Range { place: "weights of a context", found: 0, limit: 0 });
    }
    normalize(numbers, sum);
    Ok(())
}

/// Brings weights, of which one at least is not 0, to the sum `sum`, at least the number of them; none but zeros become 0.
fn normalize(weights: &mut [u32], sum: u32) {
    let total: u64 = weights.iter().map(|w| u64::from(*w)).sum();
    let mut left = i64::from(sum);
    for weight in weights.iter_mut().filter(|w| **w > 0) {
        let share = (u64::from(*weight) * u64::from(sum) + total / 2) / total;
        *weight = (share as u32).max(1);
        left -= i64::from(*weight);
    }
    // The largest bears what rounding left, where a difference costs least; rarely several do.
    while left != 0 {
        let Some(largest) = weights.iter_mut().rev().max_by_key(|w| **w) else { return };
        let change = left.max(1 - i64::from(*largest));
        *largest = (i64::from(*largest) + change) as u32;
        left -= change;
        if change == 0 {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::bits::PADDING;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn tables_come_back_and_add_up(
            counts in prop::collection::vec(prop_oneof![Just(0_u32), 1_u32..10, 0_u32..5000], 1..256),
            bits in 9_u32..12,
        ) {
            prop_assume!(counts.iter().any(|c| *c > 0) && counts.len() <= 1 << bits);
            let sum = 1 << bits;
            let (mut put_counts, mut bytes) = (counts.clone(), Vec::new());
            let mut writer = BitWriter::new(&mut bytes, MAX_STORED_BITS * counts.len());
            put(&mut put_counts, sum, &mut writer);
            let len = 8 * writer.finish();
            prop_assert_eq!(put_counts.iter().sum::<u32>(), sum);
            prop_assert!(counts.iter().zip(&put_counts).all(|(c, n)| (*c == 0) == (*n == 0)));
            bytes.resize(len / 8 + PADDING, 0);
            let mut back = vec![0; counts.len()];
            let mut reader = Bits { bytes: &bytes, len, at: 0 };
            read(&mut reader, &mut back, sum).unwrap();
            prop_assert_eq!(&back, &put_counts);
            prop_assert!(len - reader.at < 8);
            let mut short = Bits { bytes: &bytes, len: reader.at - 1, at: 0 };
            prop_assert!(read(&mut short, &mut back, sum).is_err());
        }

        #[test]
        fn weights_are_near_counts(count in 0_u32..1 << 13) {
            let (exponent, mantissa) = weight_of(count);
            let found = weight(exponent, mantissa);
            prop_assert!(found.abs_diff(4 * count) * 8 <= 4 * count, "{found} for {count}");
            prop_assert!(exponent <= MAX_EXPONENT);
        }
    }

    #[test]
    fn a_table_of_nothing_is_an_error() {
        // Three symbols whose exponents stay 0.
        let mut bits = Bits { bytes: &[0; 1 + PADDING], len: 8, at: 0 };
        assert!(matches!(
            read(&mut bits, &mut [0; 3], 512),
            Err(CodecError::Range { place: "weights of a context", .. })
        ));
    }
}

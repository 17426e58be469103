//! Numbers of which small ones are common, as a symbol each and the bits that the symbol leaves open.
//!
//! With `m` mantissa bits the symbol of a value below `2^(m+1)` is the value itself; above that it counts the bits below
//! the leading `m + 1` ones and holds the `m` after the first. So a symbol is a floating-point number without its tail,
//! the tail goes into the block as it is, and only symbols cost time in an entropy coder. (The exponent takes the part
//! of a Golomb-Rice code's quotient; unlike there the split follows each value's size, so wide jumps between octants
//! need no escape.)

use super::bits::{BitWriter, MAX_BITS, PADDING, bits_or_zeros, wide_bits_or_zeros};
use super::reader::Reader;
use super::stream::{StreamReader, StreamWriter};
use super::{BLOCK_POINTS, CodecError};
use std::ops::Range;
use std::sync::LazyLock;

/// More mantissa bits would leave no symbol for larger values.
const MAX_MANTISSA: u32 = 8;

/// What a symbol costs in the table of an entropy coder, in bits.
const SYMBOL_BITS: f32 = 5.0;

/// The most values that [`sample`] takes: as many runs as fit, and what a stride rounded down leaves.
pub(super) const SAMPLE: usize = 2 * SAMPLE_RUNS * SAMPLE_RUN;

/// `n log2 n` for counts of symbols of a block.
pub(super) static COUNT_LOG: LazyLock<Vec<f32>> =
    LazyLock::new(|| (0..=BLOCK_POINTS).map(|n| if n == 0 { 0.0 } else { n as f32 * (n as f32).log2() }).collect());

/// How values are split, and what they will cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Plan {
    /// Mantissa bits in a symbol.
    pub(super) mantissa: u32,
    /// An estimate of the whole, in bits.
    pub(super) cost_bits: f32,
}

/// The symbol of `value` and how many bits it leaves open.
#[inline]
fn split(value: u64, mantissa: u32) -> (u8, u32) {
    // Values without open bits count as if they had their leading one at bit `mantissa`, so there is one rule for all:
    // the leading one, which stays in `value >> tail`, carries into the count of bits.
    let tail = (value | 1 << mantissa).ilog2() - mantissa;
    (((tail << mantissa) + (value >> tail) as u32) as u8, tail)
}

/// The least value with this symbol, and how many bits it leaves open.
#[inline]
fn join(symbol: u8, mantissa: u32) -> (u64, u32) {
    let symbol = u64::from(symbol);
    let group = (symbol >> mantissa) as u32;
    let tail = group.saturating_sub(1);
    let implied = u64::from(group > 0) << mantissa;
    ((implied | symbol & ((1 << mantissa) - 1)) << tail, tail)
}

/// The largest `m` for which all values of `bits` bits have a symbol of one byte.
pub(super) fn finest_mantissa(bits: u32) -> u32 {
    (0..=MAX_MANTISSA).rev().find(|m| (bits.saturating_sub(*m) + 1) << m <= 256).unwrap_or(0)
}

/// The runs of a block's values that stand for all of them when plans are made.
pub(super) fn sample(count: usize) -> impl Iterator<Item = Range<usize>> {
    let stride = (count / SAMPLE_RUNS).max(SAMPLE_RUN);
    (0..count).step_by(stride).map(move |start| start..(start + SAMPLE_RUN).min(count))
}

const SAMPLE_RUNS: usize = 8;
const SAMPLE_RUN: usize = 64;

/// How often each of a sample's symbols is there.
struct Counts {
    counts: [u32; 256],
    mantissa: u32,
    /// Symbols from here on are not there.
    end: usize,
}

impl Counts {
    /// For values of at most `bits` bits, with symbols as fine as they allow.
    fn new(sample: &[u64], bits: u32) -> Self {
        let mantissa = finest_mantissa(bits);
        // Two tables, since an addition that waits for the one before it is slow.
        let mut tables = [[0_u32; 256]; 2];
        let (pairs, last) = sample.as_chunks::<2>();
        for values in pairs {
            for (table, value) in tables.iter_mut().zip(values) {
                table[usize::from(split(*value, mantissa).0)] += 1;
            }
        }
        last.iter().for_each(|value| tables[0][usize::from(split(*value, mantissa).0)] += 1);
        let counts = std::array::from_fn(|s| tables[0][s] + tables[1][s]);
        Self { counts, mantissa, end: ((bits.saturating_sub(mantissa) + 1) << mantissa) as usize }
    }

    /// One mantissa bit less.
    fn coarsen(&mut self) {
        let half = 1 << (self.mantissa - 1);
        // Symbols below `2 half` are values and stay what they are.
        for symbol in (2 * half..self.end).step_by(2) {
            let n = self.counts[symbol] + self.counts[symbol + 1];
            self.counts[symbol] = 0;
            self.counts[symbol + 1] = 0;
            self.counts[symbol / 2 + half] = n;
        }
        self.end = self.end / 2 + half;
        self.mantissa -= 1;
    }

    /// What `scale` times as many values cost, in bits.
    fn cost(&self, scale: f32) -> f32 {
        let log = &**COUNT_LOG;
        // What fills the last four is not there.
        let (fours, _) = self.counts[..self.end.next_multiple_of(4)].as_chunks::<4>();
        let (mut used, mut tails, mut total) = (0, 0, 0);
        // Several sums, since an addition of floats that waits for the one before it is slow.
        let mut parts = [0.0; 4];
        for (first, four) in (0_u32..).step_by(4).zip(fours) {
            for (symbol, (parts, &n)) in (first..).zip(parts.iter_mut().zip(four)) {
                used += u32::from(n > 0);
                tails += n * (symbol >> self.mantissa).saturating_sub(1);
                total += n;
                *parts += log[n as usize];
            }
        }
        let parts: f32 = parts.iter().sum();
        (log[total as usize] - parts + tails as f32) * scale + used as f32 * SYMBOL_BITS
    }
}

/// Finds the cheapest split of `count` values of at most `bits` bits, of which [`sample`] took `taken`.
pub(super) fn plan(taken: &[u64], bits: u32, count: usize) -> Plan {
    let mut counts = Counts::new(taken, bits);
    let scale = count as f32 / taken.len().max(1) as f32;
    let mut best = Plan { mantissa: counts.mantissa, cost_bits: counts.cost(scale) };
    while counts.mantissa > 0 {
        counts.coarsen();
        let cost_bits = counts.cost(scale);
        if cost_bits < best.cost_bits {
            best = Plan { mantissa: counts.mantissa, cost_bits };
        } else if cost_bits > 1.02 * best.cost_bits {
            break;
        }
    }
    best
}

/// What `count` symbols of a byte each cost, of which [`sample`] took `taken`.
pub(super) fn plan_bytes(taken: impl ExactSizeIterator<Item = u8>, count: usize) -> Plan {
    let scale = count as f32 / taken.len().max(1) as f32;
    let mut counts = [0; 256];
    taken.for_each(|symbol| counts[usize::from(symbol)] += 1);
    let mantissa = MAX_MANTISSA;
    Plan { mantissa, cost_bits: Counts { counts, mantissa, end: 256 }.cost(scale) }
}

/// The same as [`plan`] for all values of a slice, and how many bits they have at most.
pub(super) fn plan_all(values: &[u64]) -> (Plan, u32) {
    let all = values.iter().fold(0, |all, v| all | v);
    let mut taken = [0; SAMPLE];
    let mut len = 0;
    for run in sample(values.len()) {
        taken[len..len + run.len()].copy_from_slice(&values[run.clone()]);
        len += run.len();
    }
    let bits = u64::BITS - all.leading_zeros();
    (plan(&taken[..len], bits, values.len()), bits)
}

/// Appends values of at most `bits` bits, split with `mantissa`: `mantissa u8`, the stream of symbols, the open bits to
/// the end of the block.
pub(super) fn put_residuals(
    streams: &mut StreamWriter,
    values: impl ExactSizeIterator<Item = u64>,
    bits: u32,
    mantissa: u32,
    out: &mut Vec<u8>,
) {
    out.push(mantissa as u8);
    let mut symbols = std::mem::take(&mut streams.symbols);
    let mut tails = std::mem::take(&mut streams.tails);
    symbols.clear();
    let widest = bits.saturating_sub(1 + mantissa);
    let mut writer = BitWriter::new(&mut tails, values.len() * widest as usize);
    if widest == 0 {
        symbols.extend(values.map(|v| v as u8));
    } else if widest <= MAX_BITS {
        symbols.extend(values.map(|value| {
            let (symbol, tail) = split(value, mantissa);
            writer.put(value & ((1 << tail) - 1), tail);
            symbol
        }));
    } else {
        symbols.extend(values.map(|value| {
            let (symbol, tail) = split(value, mantissa);
            writer.put_wide(value & ((1 << tail) - 1), tail);
            symbol
        }));
    }
    let written = writer.finish();
    streams.put(&symbols, out);
    out.extend_from_slice(&tails[..written]);
    streams.symbols = symbols;
    streams.tails = tails;
}

/// Reads `count` values of at most `max_bits` bits, up to the end of the block, into `out`, whose content is replaced.
pub(super) fn read_residuals(
    streams: &mut StreamReader,
    mut reader: Reader,
    count: usize,
    max_bits: u32,
    out: &mut Vec<u64>,
) -> Result<(), CodecError> {
    let mantissa = u32::from(reader.u8("mantissa bits")?);
    if !(0..=MAX_MANTISSA).contains(&mantissa) {
        let (found, limit) = (u64::from(mantissa), u64::from(MAX_MANTISSA));
        return Err(CodecError::Range { place: "mantissa bits", found, limit });
    }
    let mut symbols = std::mem::take(&mut streams.symbols);
    let result = streams.read(&mut reader, count, &mut symbols).and_then(|()| {
        streams.bits.clear();
        streams.bits.extend_from_slice(reader.rest());
        unsplit(&symbols, mantissa, max_bits, &mut streams.bits, out)
    });
    streams.symbols = symbols;
    result
}

/// A value of which no more bits are open has at most 56 bits.
const NARROW_TAIL: u32 = 47;

/// Symbols and open bits to values.
fn unsplit(
    symbols: &[u8],
    mantissa: u32,
    max_bits: u32,
    bits: &mut Vec<u8>,
    out: &mut Vec<u64>,
) -> Result<(), CodecError> {
    let largest = symbols.iter().copied().max().unwrap_or(0);
    let widest = tail_checked(largest, mantissa, max_bits)?;
    let found = bits.len();
    bits.resize(found + PADDING, 0);
    let bits = &bits[..];
    let mut at = 0;
    // What is there is overwritten; most blocks have one length.
    out.resize(symbols.len(), 0);
    let points = out.iter_mut().zip(symbols);
    if widest == 0 {
        points.for_each(|(out, symbol)| *out = u64::from(*symbol));
    } else if widest <= NARROW_TAIL {
        // The least value and the open bits in one number, so that a point takes one look.
        let mut joined = [0; 256];
        for (joined, symbol) in joined.iter_mut().zip(0..=largest) {
            let (base, tail) = join(symbol, mantissa);
            *joined = base << 8 | u64::from(tail);
        }
        for (out, symbol) in points {
            let joined = joined[usize::from(*symbol)];
            let tail = joined as u8;
            *out = joined >> 8 | bits_or_zeros(bits, at, tail.into());
            at += usize::from(tail);
        }
    } else {
        let mut joined = [(0, 0); 256];
        joined.iter_mut().zip(0..=largest).for_each(|(joined, symbol)| *joined = join(symbol, mantissa));
        for (out, symbol) in points {
            let (base, tail) = joined[usize::from(*symbol)];
            *out = base | wide_bits_or_zeros(bits, at, tail);
            at += tail as usize;
        }
    }
    // At most 64 bits for each of a block's values.
    let expected = at.div_ceil(8);
    if found != expected {
        return Err(CodecError::Length { place: "open bits", expected, found });
    }
    Ok(())
}

/// The bits that a symbol from outside leaves open, if all its values have at most `max_bits` bits.
fn tail_checked(symbol: u8, mantissa: u32, max_bits: u32) -> Result<u32, CodecError> {
    let group = u32::from(symbol) >> mantissa;
    // The value's bits: those after the leading one, and it.
    let bits = if group == 0 { 8 - symbol.leading_zeros() } else { group + mantissa };
    if bits > max_bits.min(64) {
        return Err(CodecError::Range { place: "bits of a value", found: u64::from(bits), limit: u64::from(max_bits) });
    }
    Ok(group.saturating_sub(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn values() -> impl Strategy<Value = Vec<u64>> {
        (0_u32..64).prop_flat_map(|shift| {
            let value = (any::<u64>(), 0_u32..64).prop_map(move |(v, more)| v >> shift.max(more));
            prop::collection::vec(value, 0..300)
        })
    }

    proptest! {
        #[test]
        fn every_value_comes_back_from_every_split(values in values()) {
            let all = values.iter().fold(0, |all, v| all | v);
            let bits = 64 - all.leading_zeros();
            prop_assert!(plan_all(&values).0.mantissa <= finest_mantissa(bits));
            let (mut writer, mut reader) = (StreamWriter::default(), StreamReader::default());
            for mantissa in 0..=finest_mantissa(bits) {
                let (mut bytes, mut back) = (Vec::new(), Vec::new());
                put_residuals(&mut writer, values.iter().copied(), bits, mantissa, &mut bytes);
                read_residuals(&mut reader, Reader::new(&bytes), values.len(), bits, &mut back).unwrap();
                prop_assert_eq!(&back, &values);
                if bits > 0 {
                    let narrow = read_residuals(&mut reader, Reader::new(&bytes), values.len(), bits - 1, &mut back);
                    prop_assert!(narrow.is_err());
                }
            }
        }

        #[test]
        fn symbols_order_as_values_do(a: u64, b: u64, shift in 0_u32..64, mantissa in 0_u32..=2) {
            let (a, b) = (a >> shift, b >> shift);
            let ((sa, ta), (sb, _)) = (split(a, mantissa), split(b, mantissa));
            prop_assert!(a > b || sa <= sb);
            let (base, tail) = join(sa, mantissa);
            prop_assert_eq!(tail, ta);
            prop_assert_eq!(base, a >> tail << tail);
        }
    }
}

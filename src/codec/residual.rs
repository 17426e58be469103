//! Numbers of which small ones are common, as a symbol each and the bits that the symbol leaves open.
//!
//! With `m` mantissa bits the symbol of a value below `2^(m+1)` is the value itself; above that it counts the bits below
//! the leading `m + 1` ones and holds the `m` after the first. So a symbol is a floating-point number without its tail,
//! the tail goes into the block as it is, and only symbols cost time in an entropy coder. (The exponent takes the part
//! of a Golomb-Rice code's quotient; unlike there the split follows each value's size, so wide jumps between octants
//! need no escape.)

use super::CodecError;
use super::bits::{BitWriter, MAX_BITS, PADDING, bits_at, wide_bits_at};
use super::reader::Reader;
use super::stream::{StreamReader, StreamWriter};
use std::sync::LazyLock;

/// More mantissa bits would leave no symbol for larger values.
const MAX_MANTISSA: u32 = 8;

/// What a symbol costs in the table of an entropy coder, in bits.
const SYMBOL_BITS: f32 = 5.0;

/// `n log2 n` for the counts of a block.
static COUNT_LOG: LazyLock<Vec<f32>> = LazyLock::new(|| {
    (0..=super::BLOCK_POINTS).map(|n| if n == 0 { 0.0 } else { n as f32 * (n as f32).log2() }).collect()
});

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
    let bits = 64 - value.leading_zeros();
    let tail = bits.saturating_sub(1 + mantissa);
    let group = bits.saturating_sub(mantissa);
    let mask = (1_u64 << mantissa) - 1;
    ((group << mantissa | (value >> tail & mask) as u32) as u8, tail)
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
fn finest_mantissa(bits: u32) -> u32 {
    (0..=MAX_MANTISSA).rev().find(|m| (bits.saturating_sub(*m) + 1) << m <= 256).unwrap_or(0)
}

/// `n log2 n`.
fn count_log(n: u32) -> f32 {
    COUNT_LOG.get(n as usize).copied().unwrap_or_else(|| n as f32 * (n as f32).log2())
}

/// Bits that an order-0 coder needs for symbols of which there are so many each, with its table.
pub(super) fn entropy_bits(counts: &[u32; 256]) -> f32 {
    let (mut total, mut parts) = (0, 0.0);
    for n in counts.iter().filter(|n| **n > 0) {
        (total, parts) = (total + n, parts + count_log(*n) - SYMBOL_BITS);
    }
    count_log(total) - parts
}

/// How often each symbol is there.
pub(super) fn count(symbols: impl Iterator<Item = u8>) -> [u32; 256] {
    // Two tables, since an addition that waits for the one before it is slow.
    let mut counts = [[0_u32; 256]; 2];
    let mut which = 0;
    for symbol in symbols {
        counts[which][usize::from(symbol)] += 1;
        which ^= 1;
    }
    std::array::from_fn(|s| counts[0][s] + counts[1][s])
}

/// Runs of values that stand for all of a block when plans are made.
fn sample(values: &[u64]) -> impl Iterator<Item = u64> + '_ {
    let stride = (values.len() / SAMPLE_RUNS).max(SAMPLE_RUN);
    values.chunks(stride).flat_map(|run| &run[..run.len().min(SAMPLE_RUN)]).copied()
}

const SAMPLE_RUNS: usize = 8;
const SAMPLE_RUN: usize = 128;

/// Finds the cheapest split of `values`.
pub(super) fn plan(values: &[u64]) -> Plan {
    let all = values.iter().fold(0, |all, v| all | v);
    let mut mantissa = finest_mantissa(64 - all.leading_zeros());
    let mut counts = count(sample(values).map(|v| split(v, mantissa).0));
    let scale = values.len() as f32 / counts.iter().sum::<u32>().max(1) as f32;
    let mut best = Plan { mantissa, cost_bits: f32::INFINITY };
    loop {
        let mut coarser = [0; 256];
        let (mut used, mut tails, mut total, mut parts) = (0, 0, 0, 0.0);
        for (symbol, n) in counts.iter().enumerate().filter(|(_, n)| **n > 0) {
            let (base, tail) = join(symbol as u8, mantissa);
            (used, tails, total, parts) = (used + 1, tails + n * tail, total + n, parts + count_log(*n));
            coarser[usize::from(split(base, mantissa.saturating_sub(1)).0)] += n;
        }
        let sampled_bits = count_log(total) - parts + tails as f32;
        let cost_bits = sampled_bits * scale + used as f32 * SYMBOL_BITS;
        if cost_bits < best.cost_bits {
            best = Plan { mantissa, cost_bits };
        } else if cost_bits > 1.02 * best.cost_bits {
            return best;
        }
        if mantissa == 0 {
            return best;
        }
        counts = coarser;
        mantissa -= 1;
    }
}

/// Appends `values`, split with `mantissa`: `mantissa u8`, the stream of symbols, the open bits to the end of the block.
pub(super) fn put_residuals(streams: &mut StreamWriter, values: &[u64], mantissa: u32, out: &mut Vec<u8>) {
    out.push(mantissa as u8);
    let mut symbols = std::mem::take(&mut streams.symbols);
    symbols.clear();
    symbols.extend(values.iter().map(|v| split(*v, mantissa).0));
    streams.put(&symbols, out);
    let largest = symbols.iter().copied().max().unwrap_or(0);
    let widest = join(largest, mantissa).1;
    if widest > 0 {
        let open = symbols.iter().map(|s| join(*s, mantissa).1 as usize).sum();
        let mut writer = BitWriter::new(out, open);
        for (&value, &symbol) in values.iter().zip(&symbols) {
            let tail = join(symbol, mantissa).1;
            if widest <= MAX_BITS {
                writer.put(value & ((1 << tail) - 1), tail);
            } else {
                writer.put_wide(value & ((1 << tail) - 1), tail);
            }
        }
        writer.finish();
    }
    streams.symbols = symbols;
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

/// Symbols and open bits to values.
fn unsplit(
    symbols: &[u8],
    mantissa: u32,
    max_bits: u32,
    bits: &mut Vec<u8>,
    out: &mut Vec<u64>,
) -> Result<(), CodecError> {
    out.clear();
    let largest = symbols.iter().copied().max().unwrap_or(0);
    let widest = tail_checked(largest, mantissa, max_bits)?;
    let open: u64 = if widest == 0 { 0 } else { symbols.iter().map(|s| u64::from(join(*s, mantissa).1)).sum() };
    // At most 64 bits for each of a block's values.
    let expected = open.div_ceil(8) as usize;
    if bits.len() != expected {
        return Err(CodecError::Length { place: "open bits", expected, found: bits.len() });
    }
    bits.resize(expected + PADDING, 0);
    if widest == 0 {
        out.extend(symbols.iter().map(|s| u64::from(*s)));
        return Ok(());
    }
    let mut at = 0;
    if widest <= MAX_BITS {
        out.extend(symbols.iter().map(|s| {
            let (base, tail) = join(*s, mantissa);
            let value = base | bits_at(bits, at, tail);
            at += tail as usize;
            value
        }));
    } else {
        out.extend(symbols.iter().map(|s| {
            let (base, tail) = join(*s, mantissa);
            let value = base | wide_bits_at(bits, at, tail);
            at += tail as usize;
            value
        }));
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
            prop_assert!(plan(&values).mantissa <= finest_mantissa(bits));
            let (mut writer, mut reader) = (StreamWriter::default(), StreamReader::default());
            for mantissa in 0..=finest_mantissa(bits) {
                let (mut bytes, mut back) = (Vec::new(), Vec::new());
                put_residuals(&mut writer, &values, mantissa, &mut bytes);
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

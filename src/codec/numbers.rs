//! A block's numbers by whichever of four ways is estimated cheapest: as bytes or as residuals, each as they are or as
//! differences from the one before.
//!
//! The way is one byte; a stream of symbols or residuals follows, to the end of the block.

use super::CodecError;
use super::reader::Reader;
use super::residual::{Plan, count, entropy_bits, plan, put_residuals, read_residuals};
use super::scratch::NumberBuffers;
use super::stream::{StreamReader, StreamWriter};

/// How numbers are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    /// A stream of bytes, one a number.
    Bytes,
    /// The same of differences, modulo 256.
    ByteDifferences,
    /// Residuals.
    Residuals,
    /// Residuals of differences as zigzags: 0, -1, 1, -2, ... as 0, 1, 2, 3, ...
    Differences,
}

impl Way {
    const ALL: [Self; 4] = [Self::Bytes, Self::ByteDifferences, Self::Residuals, Self::Differences];
}

/// Residuals take longer to decode than bytes, so they must be worth it.
const RESIDUAL_PENALTY: f32 = 1.02;

/// Small numbers of either sign as small numbers.
#[inline]
fn zigzag(difference: u64) -> u64 {
    (difference << 1) ^ ((difference as i64 >> 63) as u64)
}

/// The reverse of [`zigzag`].
#[inline]
fn unzigzag(residual: u64) -> u64 {
    (residual >> 1) ^ (residual & 1).wrapping_neg()
}

/// What was found for some numbers; their differences stay in the buffers until they are put.
#[derive(Clone, Copy, Debug)]
pub(super) struct Choice {
    way: Way,
    mantissa: u32,
    /// An estimate of the whole, in bits.
    pub(super) cost_bits: f32,
}

/// Finds the cheapest way for `numbers`, of which there is at least one.
pub(super) fn choose(numbers: &[u64], buffers: &mut NumberBuffers) -> Choice {
    let NumberBuffers { differences, bytes, byte_differences } = buffers;
    differences.clear();
    differences.extend(numbers.first().map(|v| zigzag(*v)));
    differences.extend(numbers.windows(2).map(|w| zigzag(w[1].wrapping_sub(w[0]))));
    let residuals = |way, Plan { mantissa, cost_bits }| Choice { way, mantissa, cost_bits };
    let (plain, difference) = (plan(numbers), plan(differences));
    let mut best = if difference.cost_bits < plain.cost_bits {
        residuals(Way::Differences, difference)
    } else {
        residuals(Way::Residuals, plain)
    };
    if numbers.iter().fold(0, |all, n| all | n) <= u64::from(u8::MAX) {
        best.cost_bits *= RESIDUAL_PENALTY;
        bytes.clear();
        bytes.extend(numbers.iter().map(|v| *v as u8));
        byte_differences.clear();
        byte_differences.extend(bytes.first());
        byte_differences.extend(bytes.windows(2).map(|w| w[1].wrapping_sub(w[0])));
        for (way, symbols) in [(Way::Bytes, &*bytes), (Way::ByteDifferences, &*byte_differences)] {
            let cost_bits = entropy_bits(&count(symbols.iter().copied()));
            if cost_bits < best.cost_bits {
                best = Choice { way, mantissa: 0, cost_bits };
            }
        }
    }
    best
}

/// Appends `numbers` as [`choose`] found best; `buffers` are as it left them.
pub(super) fn put(
    streams: &mut StreamWriter,
    numbers: &[u64],
    buffers: &NumberBuffers,
    choice: Choice,
    out: &mut Vec<u8>,
) {
    out.push(choice.way as u8);
    match choice.way {
        Way::Bytes => streams.put(&buffers.bytes, out),
        Way::ByteDifferences => streams.put(&buffers.byte_differences, out),
        Way::Residuals => put_residuals(streams, numbers, choice.mantissa, out),
        Way::Differences => put_residuals(streams, &buffers.differences, choice.mantissa, out),
    }
}

/// Numbers as they were read.
#[derive(Debug)]
pub(super) enum Numbers<'a> {
    /// None is above 255.
    Bytes(&'a [u8]),
    /// Any.
    Wide(&'a [u64]),
}

/// Reads `count` numbers, up to the end of the block, into one of the buffers; all are at most `limit`.
pub(super) fn read<'a>(
    streams: &mut StreamReader,
    mut reader: Reader,
    count: usize,
    limit: u64,
    bytes: &'a mut Vec<u8>,
    wide: &'a mut Vec<u64>,
) -> Result<Numbers<'a>, CodecError> {
    const WAY: &str = "way of numbers";
    let code = reader.u8(WAY)?;
    let error = CodecError::Range { place: WAY, found: u64::from(code), limit: Way::ALL.len() as u64 - 1 };
    let way = *Way::ALL.get(usize::from(code)).ok_or(error)?;
    let largest;
    let numbers = match way {
        Way::Bytes | Way::ByteDifferences => {
            streams.read(&mut reader, count, bytes)?;
            reader.end("bytes after the numbers")?;
            if way == Way::ByteDifferences {
                let mut before = 0_u8;
                for byte in bytes.iter_mut() {
                    before = before.wrapping_add(*byte);
                    *byte = before;
                }
            }
            largest = u64::from(bytes.iter().copied().max().unwrap_or(0));
            Numbers::Bytes(bytes)
        }
        Way::Residuals | Way::Differences => {
            read_residuals(streams, reader, count, u64::BITS, wide)?;
            if way == Way::Differences {
                let mut before = 0_u64;
                for number in wide.iter_mut() {
                    before = before.wrapping_add(unzigzag(*number));
                    *number = before;
                }
            }
            largest = wide.iter().copied().max().unwrap_or(0);
            Numbers::Wide(wide)
        }
    };
    if largest > limit {
        return Err(CodecError::Range { place: "number", found: largest, limit });
    }
    Ok(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn zigzag_is_reversible_and_small_for_small_distances(a: u64, b in -1000_i64..1000) {
            prop_assert_eq!(unzigzag(zigzag(a)), a);
            prop_assert!(zigzag(b as u64) <= 2 * b.unsigned_abs());
        }

        #[test]
        fn numbers_come_back_by_every_way(
            numbers in prop_oneof![
                prop::collection::vec(0_u64..256, 1..300),
                prop::collection::vec(any::<u64>(), 1..300),
            ],
        ) {
            let (mut buffers, mut writer) = (NumberBuffers::default(), StreamWriter::default());
            let (mut bytes, mut wide) = (Vec::new(), Vec::new());
            let choice = choose(&numbers, &mut buffers);
            let largest = numbers.iter().copied().max().unwrap();
            for way in &Way::ALL[if largest < 256 { 0 } else { 2 }..] {
                let mut out = Vec::new();
                put(&mut writer, &numbers, &buffers, Choice { way: *way, mantissa: 0, ..choice }, &mut out);
                let mut read = |limit| {
                    let reader = Reader::new(&out);
                    let mut streams = StreamReader::default();
                    let numbers = read(&mut streams, reader, numbers.len(), limit, &mut bytes, &mut wide)?;
                    Ok::<_, CodecError>(match numbers {
                        Numbers::Bytes(bytes) => bytes.iter().map(|b| u64::from(*b)).collect(),
                        Numbers::Wide(wide) => wide.to_vec(),
                    })
                };
                let back: Vec<u64> = read(largest).unwrap();
                prop_assert_eq!(&back, &numbers);
                prop_assert!(largest == 0 || read(largest - 1).is_err());
            }
        }
    }
}

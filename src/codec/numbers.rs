//! A block's numbers by whichever of four ways is estimated cheapest: as bytes or as residuals, each as they are or as
//! differences from the one before.
//!
//! The way is one byte; a stream of symbols or residuals follows, to the end of the block.

use super::CodecError;
use super::reader::Reader;
use super::residual::{Plan, SAMPLE, plan, plan_bytes, put_residuals, read_residuals, sample};
use super::stream::{StreamReader, StreamWriter};

/// How numbers are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    /// A stream of bytes, one a number.
    Bytes,
    /// The same of differences modulo 256, as zigzags of a byte.
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
pub(super) fn zigzag(difference: u64) -> u64 {
    (difference << 1) ^ ((difference as i64 >> 63) as u64)
}

/// The reverse of [`zigzag`].
#[inline]
pub(super) fn unzigzag(residual: u64) -> u64 {
    (residual >> 1) ^ (residual & 1).wrapping_neg()
}

/// The same for differences modulo 256.
#[inline]
pub(super) fn zigzag_byte(difference: u8) -> u8 {
    difference << 1 ^ (difference as i8 >> 7) as u8
}

/// The reverse of [`zigzag_byte`].
#[inline]
pub(super) fn unzigzag_byte(residual: u8) -> u8 {
    residual >> 1 ^ (residual & 1).wrapping_neg()
}

/// Bits of `most` and of the zigzags of differences between numbers up to it.
fn bit_lengths(most: u64) -> (u32, u32) {
    let bits = u64::BITS - most.leading_zeros();
    (bits, (bits + 1).min(u64::BITS))
}

/// What was found for some numbers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Choice {
    way: Way,
    mantissa: u32,
    /// The greatest number.
    most: u64,
    /// An estimate of the whole, in bits.
    pub(super) cost_bits: f32,
}

/// Finds the cheapest way for `count` numbers, the greatest of them `most`, by a sample of them.
pub(super) fn choose(count: usize, most: u64, number: impl Fn(usize) -> u64) -> Choice {
    let (mut plain, mut differences) = ([0; SAMPLE], [0; SAMPLE]);
    let mut len = 0;
    for run in sample(count) {
        let mut before = if run.start == 0 { 0 } else { number(run.start - 1) };
        let places = plain[len..].iter_mut().zip(&mut differences[len..]);
        len += run.len();
        for (i, (plain, difference)) in run.zip(places) {
            let now = number(i);
            *plain = now;
            *difference = now.wrapping_sub(before);
            before = now;
        }
    }
    let (plain, differences) = (&plain[..len], &mut differences[..len]);
    let (bits, difference_bits) = bit_lengths(most);
    let choice = |way, Plan { mantissa, cost_bits }| Choice { way, mantissa, most, cost_bits };
    let mut best = choice(Way::Residuals, plan(plain, bits, count));
    let bytes = most <= u64::from(u8::MAX);
    // Differences of bytes cost the same with or without their ninth bit.
    let of_bytes = bytes.then(|| choice(Way::ByteDifferences, plan_bytes(differences.iter().map(|d| *d as u8), count)));
    differences.iter_mut().for_each(|d| *d = zigzag(*d));
    let difference = choice(Way::Differences, plan(differences, difference_bits, count));
    if difference.cost_bits < best.cost_bits {
        best = difference;
    }
    if let Some(of_bytes) = of_bytes {
        best.cost_bits *= RESIDUAL_PENALTY;
        let plain = choice(Way::Bytes, plan_bytes(plain.iter().map(|v| *v as u8), count));
        for way in [plain, of_bytes] {
            if way.cost_bits < best.cost_bits {
                best = way;
            }
        }
    }
    best
}

/// Appends `numbers` as [`choose`] found best.
pub(super) fn put<N: Copy + Into<u64>>(
    streams: &mut StreamWriter,
    numbers: &[N],
    bytes: &mut Vec<u8>,
    choice: Choice,
    out: &mut Vec<u8>,
) {
    out.push(choice.way as u8);
    let (bits, difference_bits) = bit_lengths(choice.most);
    let mut before = 0_u64;
    let mut difference = |number: &N| {
        let number = (*number).into();
        number.wrapping_sub(std::mem::replace(&mut before, number))
    };
    match choice.way {
        Way::Bytes => {
            bytes.clear();
            bytes.extend(numbers.iter().map(|n| (*n).into() as u8));
            streams.put(bytes, out);
        }
        Way::ByteDifferences => {
            bytes.clear();
            bytes.extend(numbers.iter().map(|n| zigzag_byte(difference(n) as u8)));
            streams.put(bytes, out);
        }
        Way::Residuals => {
            put_residuals(streams, numbers.iter().map(|n| (*n).into()), bits, choice.mantissa, out);
        }
        Way::Differences => {
            let zigzags = numbers.iter().map(|n| zigzag(difference(n)));
            put_residuals(streams, zigzags, difference_bits, choice.mantissa, out);
        }
    }
}

/// Appends so many zeros.
pub(super) fn put_zeros(streams: &mut StreamWriter, count: usize, out: &mut Vec<u8>) {
    out.push(Way::Bytes as u8);
    streams.put_zeros(count, out);
}

/// Numbers as they were read.
#[derive(Debug)]
pub(super) enum Numbers<'a> {
    /// None is above 255.
    Bytes(&'a [u8]),
    /// Any.
    Wide(&'a [u64]),
}

/// The greatest of some numbers, or any from there to the limit if all are within it. (Their bits together tell that mostly,
/// many at a time.)
pub(super) fn largest_above(numbers: &[u64], limit: u64) -> u64 {
    let all = numbers.iter().fold(0, |all, n| all | n);
    if all <= limit { all } else { numbers.iter().copied().max().unwrap_or(0) }
}

/// The greatest of some numbers; 0 of none.
pub(super) fn largest_byte(numbers: &[u8]) -> u64 {
    numbers.iter().copied().max().unwrap_or(0).into()
}

/// Makes of each number its sum with all before it, modulo 256.
pub(super) fn add_up_bytes(numbers: &mut [u8]) {
    /// One in each of the four lanes of 16 bits, in which every second byte of eight has room for its carry.
    const LANES: u64 = 0x0001_0001_0001_0001;
    const LOW: u64 = 0xff * LANES;
    let (eights, rest) = numbers.as_chunks_mut::<8>();
    let mut before = 0_u64;
    for eight in eights {
        let bytes = u64::from_le_bytes(*eight);
        // In each lane the sum of it and those below.
        let (even, odd) = ((bytes & LOW).wrapping_mul(LANES), (bytes >> 8 & LOW).wrapping_mul(LANES));
        let (at_odd, at_even) = (even.wrapping_add(odd), even.wrapping_add(odd << 16));
        // The only step that waits for the eight before.
        let carry = before * LANES;
        before = (before + (at_odd >> 48)) & 0xff;
        let sums = at_even.wrapping_add(carry) & LOW | (at_odd.wrapping_add(carry) & LOW) << 8;
        *eight = sums.to_le_bytes();
    }
    let mut before = before as u8;
    for number in rest {
        before = before.wrapping_add(*number);
        *number = before;
    }
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
                bytes.iter_mut().for_each(|byte| *byte = unzigzag_byte(*byte));
                add_up_bytes(bytes);
            }
            largest = largest_byte(bytes);
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
            largest = largest_above(wide, limit);
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
        fn sums_of_bytes_are_those_of_one_after_another(bytes in prop::collection::vec(any::<u8>(), 0..60)) {
            let mut sums = bytes.clone();
            add_up_bytes(&mut sums);
            let one_by_one = bytes.iter().scan(0_u8, |sum, byte| {
                *sum = sum.wrapping_add(*byte);
                Some(*sum)
            });
            prop_assert_eq!(sums, one_by_one.collect::<Vec<u8>>());
        }

        #[test]
        fn numbers_come_back_by_every_way(
            numbers in prop_oneof![
                prop::collection::vec(0_u64..256, 1..300),
                prop::collection::vec(any::<u64>(), 1..300),
            ],
        ) {
            let mut writer = StreamWriter::default();
            let (mut bytes, mut wide) = (Vec::new(), Vec::new());
            let largest = numbers.iter().copied().max().unwrap();
            let choice = choose(numbers.len(), largest, |i| numbers[i]);
            for way in &Way::ALL[if largest < 256 { 0 } else { 2 }..] {
                let mut out = Vec::new();
                put(&mut writer, &numbers, &mut bytes, Choice { way: *way, mantissa: 0, ..choice }, &mut out);
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

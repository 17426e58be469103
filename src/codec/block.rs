//! One block of an attribute: which transform is cheapest, and its bytes.
//!
//! The first byte says how the rest is to be read: [`Kind`]. All but the first two kinds store
//! `n = (value - least) / step`, for values as integers in the order of the values.

use super::column::is_constant;
use super::dictionary;
use super::numbers::{self, Numbers};
use super::ranked;
use super::reader::{Reader, put_uint, put_varint};
use super::scratch::Buffers;
use super::stream::StreamWriter;
use super::value::Value;
use super::{CodecError, Decoder};
use crate::points::ScalarType;

/// How a block is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// One value for all, in the type's width.
    Constant,
    /// Every value in the type's width.
    Raw,
    /// `least`, `step`; a table of at most 16 `n`, and an index into it for each point, several to a byte.
    Dictionary,
    /// `least`, `step`; every `n` as a number.
    Numbers,
    /// `least`, `step`; all different `n` in order, and which of them each point has.
    Ranked,
}

impl Kind {
    const ALL: [Self; 5] = [Self::Constant, Self::Raw, Self::Dictionary, Self::Numbers, Self::Ranked];
}

/// Below so many bits a value, ranks of values beyond 16 bits are not tried: sorting costs more time than all else.
const SORTED_ABOVE_BITS: f32 = 10.0;

/// The largest `step` with which all values are `least + step * n`; 1 if all are equal.
fn common_step(values: &[u64], least: u64) -> u64 {
    let mut step = 0_u64;
    for value in values {
        let distance = value - least;
        if !distance.is_multiple_of(step) {
            step = gcd(step, distance);
            if step == 1 {
                break;
            }
        }
    }
    step.max(1)
}

fn gcd(mut a: u64, mut b: u64) -> u64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

/// Appends the block of `values`, of which there is at least one.
pub(super) fn put_block<T: Value>(
    streams: &mut StreamWriter,
    buffers: &mut Buffers,
    ty: ScalarType,
    block: &[T],
    out: &mut Vec<u8>,
) {
    let width = ty.size();
    if is_constant(block) {
        out.push(Kind::Constant as u8);
        put_uint(block[0].ordered(), width, out);
        return;
    }
    let start = out.len();
    let values = &mut buffers.values;
    values.clear();
    values.extend(block.iter().map(|v| v.ordered()));
    let (least, greatest) = values.iter().fold((u64::MAX, 0), |(a, b), v| (a.min(*v), b.max(*v)));
    let step = common_step(values, least);
    if step == 1 {
        values.iter_mut().for_each(|v| *v -= least);
    } else {
        values.iter_mut().for_each(|v| *v = (*v - least) / step);
    }
    let head = |kind: Kind, out: &mut Vec<u8>| {
        out.push(kind as u8);
        put_uint(least, width, out);
        put_varint(step, out);
    };

    if let Some(table) = dictionary::build(values, &mut buffers.bytes) {
        head(Kind::Dictionary, out);
        dictionary::put(streams, &table, &mut buffers.bytes, out);
    } else {
        let choice = numbers::choose(&buffers.values, &mut buffers.numbers);
        let most = (greatest - least) / step;
        // Wide values that take many bits may be few different ones, or as jumbled as times are.
        let rankable = match most {
            0..=0xff => false,
            0x100..=0xffff => true,
            _ => choice.cost_bits > SORTED_ABOVE_BITS * block.len() as f32,
        };
        let ranked_head = |out: &mut Vec<u8>| head(Kind::Ranked, out);
        if !rankable || !ranked::try_put(streams, buffers, choice.cost_bits, ranked_head, out) {
            head(Kind::Numbers, out);
            numbers::put(streams, &buffers.values, &buffers.numbers, choice, out);
        }
    }
    if out.len() - start > 1 + width * block.len() {
        out.truncate(start);
        out.push(Kind::Raw as u8);
        block.iter().for_each(|v| put_uint(v.ordered(), width, out));
    }
}

/// Appends the `count` values of a block to `out`, or nothing if there is an error.
pub(super) fn read_block<T: Value>(
    decoder: &mut Decoder,
    ty: ScalarType,
    bytes: &[u8],
    count: usize,
    out: &mut Vec<T>,
) -> Result<(), CodecError> {
    const KIND: &str = "kind of a block";
    let width = ty.size();
    let mut reader = Reader::new(bytes);
    let code = reader.u8(KIND)?;
    let kind = Kind::ALL.into_iter().find(|k| *k as u8 == code);
    let limit = Kind::Ranked as u64;
    let kind = kind.ok_or(CodecError::Range { place: KIND, found: u64::from(code), limit })?;
    match kind {
        Kind::Constant => {
            let value = reader.uint(width, "constant value")?;
            reader.end("bytes after a constant value")?;
            out.resize(out.len() + count, T::from_ordered(value));
            return Ok(());
        }
        Kind::Raw => {
            let bytes = reader.take(width * count, "values")?;
            reader.end("bytes after the values")?;
            let value = |v: &[u8]| T::from_ordered(v.iter().rev().fold(0, |a, &b| a << 8 | u64::from(b)));
            out.extend(bytes.chunks_exact(width).map(value));
            return Ok(());
        }
        _ => {}
    }
    let least = reader.uint(width, "least value")?;
    let step = reader.varint("step between values")?;
    let most = u64::MAX >> (64 - 8 * width);
    // What `n` may be: nothing if the step itself is out of range.
    let limit = (most - least).checked_div(step).unwrap_or(0);
    let value = |n: u64| T::from_ordered(least + step * n);
    if kind == Kind::Numbers {
        let Decoder { streams, bytes, wide, .. } = decoder;
        match numbers::read(streams, reader, count, limit, bytes, wide)? {
            Numbers::Bytes(numbers) => out.extend(numbers.iter().map(|n| value(u64::from(*n)))),
            Numbers::Wide(numbers) => out.extend(numbers.iter().map(|n| value(*n))),
        }
        return Ok(());
    }
    if kind == Kind::Dictionary {
        dictionary::read(&mut decoder.streams, reader, &mut decoder.bytes, count, &mut decoder.values)?;
    } else {
        ranked::read(decoder, reader, count)?;
    }
    let found = decoder.values.iter().copied().max().unwrap_or(0);
    if found > limit {
        return Err(CodecError::Range { place: "value", found, limit });
    }
    out.extend(decoder.values.iter().map(|n| value(*n)));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_common_step_divides_every_distance(
            least in 0_u64..1000,
            step in 1_u64..1000,
            n in prop::collection::vec(0_u64..1000, 1..50),
        ) {
            let values: Vec<_> = n.iter().map(|n| least + step * n).collect();
            let least = *values.iter().min().unwrap();
            let found = common_step(&values, least);
            prop_assert!(values.iter().all(|v| (v - least) % found == 0));
            if values.iter().any(|v| *v != least) {
                prop_assert_eq!(found % step, 0);
            }
        }
    }
}

//! One block of an attribute: which transform is cheapest, and its bytes.
//!
//! The first byte says how the rest is to be read: [`Kind`].

use super::column::is_constant;
use super::dictionary;
use super::reader::{Reader, put_uint, put_varint};
use super::residual::{plan, put_residuals, read_residuals};
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
    /// A table of values, and an index into it for each point.
    Dictionary,
    /// `least`, `step`, and for each value `(value - least) / step` as a residual.
    Plain,
    /// The same, but residuals are differences from the value before, zigzag.
    Difference,
}

impl Kind {
    const ALL: [Self; 5] = [Self::Constant, Self::Raw, Self::Dictionary, Self::Plain, Self::Difference];
}

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
    let Buffers { values, residuals, indices, .. } = buffers;
    values.clear();
    values.extend(block.iter().map(|v| v.ordered()));

    let least = values.iter().copied().min().unwrap_or(0);
    let step = common_step(values, least);
    if step == 1 {
        values.iter_mut().for_each(|v| *v -= least);
    } else {
        values.iter_mut().for_each(|v| *v = (*v - least) / step);
    }
    let plain = plan(values);
    residuals.clear();
    residuals.push(zigzag(values[0]));
    residuals.extend(values.windows(2).map(|w| zigzag(w[1].wrapping_sub(w[0]))));
    let difference = plan(residuals);

    let table = dictionary::build(values, indices);
    let start = out.len();
    if let Some(table) = table
        && table.cost_bits() < plain.cost_bits.min(difference.cost_bits)
    {
        out.push(Kind::Dictionary as u8);
        put_uint(least, width, out);
        put_varint(step, out);
        dictionary::put(streams, &table, indices, out);
    } else {
        let (kind, plan, values) = if difference.cost_bits < plain.cost_bits {
            (Kind::Difference, difference, &*residuals)
        } else {
            (Kind::Plain, plain, &*values)
        };
        out.push(kind as u8);
        put_uint(least, width, out);
        put_varint(step, out);
        put_residuals(streams, values, plan.mantissa, out);
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
    let width = ty.size();
    let mut reader = Reader::new(bytes);
    let code = reader.u8("kind of a block")?;
    let kind = Kind::ALL.into_iter().find(|k| *k as u8 == code);
    let kind = kind.ok_or(CodecError::Range {
        place: "kind of a block",
        found: u64::from(code),
        limit: Kind::Difference as u64,
    })?;
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
    // What a value may be before it is scaled: none if the step itself is out of range.
    let limit = (most - least).checked_div(step).unwrap_or(0);
    let Decoder { streams, indices, values } = decoder;
    match kind {
        Kind::Dictionary => dictionary::read(streams, reader, indices, count, values)?,
        Kind::Plain => read_residuals(streams, reader, count, 64, values)?,
        _ => {
            read_residuals(streams, reader, count, 64, values)?;
            let mut before = 0_u64;
            for value in values.iter_mut() {
                before = before.wrapping_add(unzigzag(*value));
                *value = before;
            }
        }
    }
    let largest = values.iter().copied().max().unwrap_or(0);
    if largest > limit {
        return Err(CodecError::Range { place: "value", found: largest, limit });
    }
    if step == 1 {
        out.extend(values.iter().map(|v| T::from_ordered(least + v)));
    } else {
        out.extend(values.iter().map(|v| T::from_ordered(least + step * v)));
    }
    Ok(())
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
        fn the_common_step_divides_every_distance(least in 0_u64..1000, step in 1_u64..1000, n in prop::collection::vec(0_u64..1000, 1..50)) {
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

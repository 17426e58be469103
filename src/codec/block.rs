//! One block of an attribute: which transform is cheapest, and its bytes.
//!
//! The first byte says how the rest is to be read: [`Kind`]. All but the first two kinds store
//! `n = (value - least) / step`, for values as integers in the order of the values.

use super::dictionary;
use super::joint::{self, Leaders};
use super::lines;
use super::numbers::{self, Numbers, largest_above, largest_byte};
use super::passes::{BesideBlock, BlockPasses};
use super::ranked;
use super::reader::{Reader, put_uint, put_varint};
use super::scratch::Buffers;
use super::steady;
use super::stream::StreamWriter;
use super::value::{Survey, Value};
use super::{CodecError, Decoder, PositionChunk};
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
    /// `least`, `step`; how far the `n` are off what the points' positions let expect.
    Lines,
    /// `least`, `step`; how far the `n` are off what their passes let expect.
    Steady,
    /// `least`, `step`; how far the `n` are off what other columns let expect.
    Joint,
}

impl Kind {
    const ALL: [Self; 8] = [
        Self::Constant,
        Self::Raw,
        Self::Dictionary,
        Self::Numbers,
        Self::Ranked,
        Self::Lines,
        Self::Steady,
        Self::Joint,
    ];
}

/// Below so many bits a value, ranks of values beyond 16 bits are not tried: sorting costs more time than all else.
const SORTED_ABOVE_BITS: f32 = 10.0;

/// Lines that take so many bits a value or less are taken without trying ranks.
const GOOD_LINES_BITS: usize = 12;

/// Distances of which the step is guessed.
const STEP_SAMPLE: usize = 64;

/// A divisor of all distances between values, for dividing without the processor's division, which is slow.
#[derive(Clone, Copy, Debug)]
struct Step {
    /// `odd << zeros`.
    zeros: u32,
    odd: u64,
    /// `odd * inverse` is 1 modulo 2^64: a multiple times this is the quotient, which is at most `most`, and any other
    /// number is more.
    inverse: u64,
    most: u64,
}

impl Step {
    /// `odd` may also be 0, which divides only 0.
    fn new(zeros: u32, odd: u64) -> Self {
        // Right in the lowest three bits, and in twice as many with each turn.
        let mut inverse = odd.max(1);
        for _ in 0..if odd == 0 { 0 } else { 5 } {
            inverse = inverse.wrapping_mul(2_u64.wrapping_sub(odd.wrapping_mul(inverse)));
        }
        Self { zeros, odd, inverse, most: u64::MAX.checked_div(odd).unwrap_or(0) }
    }

    /// The largest with which all values are `least + step * n`; `differing` are the bits in which they do.
    fn common<T: Value>(block: &[T], Survey { least, differing, .. }: Survey) -> Self {
        let zeros = differing.trailing_zeros();
        let distance = |value: &T| (value.ordered() - least) >> zeros;
        let sample = block.iter().step_by(block.len().div_ceil(STEP_SAMPLE));
        let odd = sample.fold(0, |odd, value| if odd == 1 { 1 } else { odd_part(gcd(odd, distance(value))) });
        let mut step = Self::new(zeros, odd);
        if odd != 1 {
            for value in block {
                let distance = distance(value);
                if !step.divides(distance) {
                    step = Self::new(zeros, odd_part(gcd(step.odd, distance)));
                }
            }
        }
        step
    }

    /// Is `distance`, already without `zeros`, a multiple?
    #[inline]
    fn divides(self, distance: u64) -> bool {
        distance.wrapping_mul(self.inverse) <= self.most
    }

    fn size(self) -> u64 {
        self.odd << self.zeros
    }

    /// How many steps a distance is.
    #[inline]
    fn quotient(self, distance: u64) -> u64 {
        (distance >> self.zeros).wrapping_mul(self.inverse)
    }
}

fn odd_part(n: u64) -> u64 {
    n.checked_shr(n.trailing_zeros()).unwrap_or(0)
}

fn gcd(mut a: u64, mut b: u64) -> u64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

/// Blocks that take less are not tried otherwise: one of so many bytes a point.
const SMALL_SHARE: usize = 24;

/// Nor are those that take more: one of so many bytes a point. Colours and intensities, whose decoding must not wait for
/// positions, are never steady enough to be worth it. They have no sign; angles have one, and are tried whatever they take.
const LARGE_SHARE: usize = 2;

/// Appends the block of `values`, of which there is at least one.
pub(super) fn put_block<T: Value>(
    streams: &mut StreamWriter,
    buffers: &mut Buffers,
    ty: ScalarType,
    block: &[T],
    beside: BesideBlock,
    leaders: Leaders,
    out: &mut Vec<u8>,
) {
    let width = ty.size();
    let survey = T::survey(block);
    let Survey { least, greatest, differing } = survey;
    if differing == 0 {
        out.push(Kind::Constant as u8);
        put_uint(least, width, out);
        return;
    }
    let start = out.len();
    let step = Step::common(block, survey);
    let most = step.quotient(greatest - least);
    let (times, passes) = match beside {
        BesideBlock::Times(found) => (Some(found), None),
        BesideBlock::Passes(known) => {
            (None, Some(known).filter(|known| known.count > 0 && known.of_point.len() == block.len()))
        }
        BesideBlock::Nothing => (None, None),
    };
    let head = |kind: Kind, out: &mut Vec<u8>| {
        out.push(kind as u8);
        put_uint(least, width, out);
        put_varint(step.size(), out);
    };
    let steady_head = |out: &mut Vec<u8>| head(Kind::Steady, out);
    if most <= u64::from(u8::MAX) {
        let numbers = &mut buffers.bytes;
        numbers.clear();
        T::append_few_steps(block, least, step.zeros, step.inverse, numbers);
        if let Some(passes) = passes
            && steady::try_put_same(streams, passes, |i| u64::from(buffers.bytes[i]), steady_head, out)
        {
            return;
        }
        put_bytes(streams, buffers, (most, step.size()), leaders, head, out);
    } else {
        let numbers = &mut buffers.values;
        numbers.clear();
        T::append_steps(block, least, step.zeros, step.inverse, numbers);
        if let Some(passes) = passes
            && steady::try_put_same(streams, passes, |i| buffers.values[i], steady_head, out)
        {
            return;
        }
        put_wide(streams, buffers, (most, step.size()), leaders, times, head, out);
    }
    let plain = out.len() - start;
    let signed = matches!(ty, ScalarType::I8 | ScalarType::I16);
    if let Some(passes) = passes
        && most <= u64::from(u16::MAX)
        && plain > block.len() / SMALL_SHARE
        && (signed || plain <= block.len() / LARGE_SHARE)
    {
        let Buffers { values, bytes, steady, other, .. } = buffers;
        other.clear();
        let tried = if most <= u64::from(u8::MAX) {
            steady::try_put(streams, steady, passes, |i| u64::from(bytes[i]), plain, steady_head, other)
        } else {
            steady::try_put(streams, steady, passes, |i| values[i], plain, steady_head, other)
        };
        if tried && other.len() < plain {
            out.truncate(start);
            out.extend_from_slice(other);
        }
    }
    if out.len() - start > 1 + width * block.len() {
        out.truncate(start);
        out.push(Kind::Raw as u8);
        block.iter().for_each(|v| put_uint(v.ordered(), width, out));
    }
}

/// Appends the numbers `buffers.bytes`, the greatest of them `most`, after a head. A number is `step` in values.
fn put_bytes(
    streams: &mut StreamWriter,
    buffers: &mut Buffers,
    (most, step): (u64, u64),
    leaders: Leaders,
    head: impl Fn(Kind, &mut Vec<u8>),
    out: &mut Vec<u8>,
) {
    let Buffers { bytes, packed, residuals, joint: known, .. } = buffers;
    if let Some(table) = dictionary::build_bytes(bytes, packed) {
        head(Kind::Dictionary, out);
        dictionary::put(streams, &table, packed, leaders[0], out);
    } else {
        if known.is_none_or(|known| !known.fits(step)) {
            *known = joint::choose(bytes.len(), most, step, leaders, |i| u64::from(bytes[i]));
        }
        if let Some(joint) = known.filter(|known| known.fits(step)) {
            head(Kind::Joint, out);
            joint::put(streams, bytes, leaders, joint, true, (packed, residuals), out);
            return;
        }
        let choice = numbers::choose(bytes.len(), most, |i| u64::from(bytes[i]));
        head(Kind::Numbers, out);
        numbers::put(streams, bytes, packed, choice, out);
    }
}

/// Appends the numbers `buffers.values`, the greatest of them `most`, after a head. A number is `step` in values.
fn put_wide(
    streams: &mut StreamWriter,
    buffers: &mut Buffers,
    (most, step): (u64, u64),
    leaders: Leaders,
    times: Option<&mut BlockPasses>,
    head: impl Fn(Kind, &mut Vec<u8>),
    out: &mut Vec<u8>,
) {
    let Buffers { values, packed, residuals, joint: known, .. } = buffers;
    if let Some(table) = dictionary::build(values, packed) {
        head(Kind::Dictionary, out);
        dictionary::put(streams, &table, packed, leaders[0], out);
        return;
    }
    let count = values.len();
    if known.is_none_or(|known| !known.fits(step)) {
        *known = joint::choose(count, most, step, leaders, |i| values[i]);
    }
    if let Some(joint) = known.filter(|known| most <= u64::from(u16::MAX) && known.fits(step)) {
        head(Kind::Joint, out);
        joint::put(streams, values, leaders, joint, false, (packed, residuals), out);
        return;
    }
    let wide = most > u64::from(u16::MAX) && ranked::is_sortable(most);
    let start = out.len();
    let (mut lines, mut found, mut sorted) = (0, None, false);
    if let Some(times) = times
        && wide
    {
        buffers.rank.sort(&buffers.values, most);
        sorted = true;
        if lines::try_put(streams, buffers, times, |out| head(Kind::Lines, out), out) {
            lines = out.len() - start;
            if 8 * lines <= GOOD_LINES_BITS * count {
                return;
            }
            found = Some(times);
        }
    }
    let choice = numbers::choose(count, most, |i| buffers.values[i]);
    // Wide values that take many bits may be few different ones, or as jumbled as times are.
    let rankable = most <= u64::from(u16::MAX) || choice.cost_bits > SORTED_ABOVE_BITS * count as f32;
    if rankable && wide && !sorted {
        buffers.rank.sort(&buffers.values, most);
    }
    let limit_bits = if lines > 0 { choice.cost_bits.min(8.0 * lines as f32) } else { choice.cost_bits };
    let ranked_head = |out: &mut Vec<u8>| head(Kind::Ranked, out);
    if rankable && ranked::try_put(streams, buffers, most, limit_bits, ranked_head, out) {
        out.drain(start..start + lines);
    } else if lines == 0 || choice.cost_bits < 8.0 * lines as f32 {
        out.truncate(start);
        head(Kind::Numbers, out);
        numbers::put(streams, &buffers.values, &mut buffers.packed, choice, out);
    } else {
        return;
    }
    // Passes that do not help times would hardly help others.
    if let Some(found) = found {
        found.count = 0;
    }
}

/// Are the values of this block a function of positions and passes too?
pub(super) fn needs_passes(bytes: &[u8]) -> bool {
    bytes.first().is_some_and(|kind| [Kind::Lines as u8, Kind::Steady as u8].contains(kind))
}

/// Appends the `count` values of a block to `out`, or nothing if there is an error. `beside` is where
/// positions are, and which block of them; `leaders` are the values of the columns that this one follows.
pub(super) fn read_block<T: Value>(
    decoder: &mut Decoder,
    ty: ScalarType,
    bytes: &[u8],
    count: usize,
    beside: Option<(&PositionChunk, usize)>,
    leaders: Leaders,
    out: &mut Vec<T>,
) -> Result<(), CodecError> {
    const KIND: &str = "kind of a block";
    let width = ty.size();
    let mut reader = Reader::new(bytes);
    let code = reader.u8(KIND)?;
    let kind = Kind::ALL.into_iter().find(|k| *k as u8 == code);
    let limit = Kind::Joint as u64;
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
    let check = |numbers: &[u64]| {
        let found = largest_above(numbers, limit);
        if found > limit { Err(CodecError::Range { place: "value", found, limit }) } else { Ok(()) }
    };
    match kind {
        Kind::Numbers => {
            let Decoder { streams, bytes, wide, .. } = decoder;
            match numbers::read(streams, reader, count, limit, bytes, wide)? {
                Numbers::Bytes(numbers) => T::append_stepped(numbers, least, step, out),
                Numbers::Wide(numbers) => T::append_stepped(numbers, least, step, out),
            }
            return Ok(());
        }
        Kind::Dictionary => {
            let Decoder { streams, bytes: indices, .. } = decoder;
            let (table, len) = dictionary::read(streams, reader, count, leaders[0], indices)?;
            check(&table)?;
            dictionary::append_values(&table.map(|n| T::from_ordered(least + step * n)), len, indices, out);
            return Ok(());
        }
        Kind::Ranked => ranked::read(decoder, reader, count)?,
        Kind::Joint => {
            let Decoder { streams, bytes, values, .. } = decoder;
            if let Numbers::Bytes(numbers) = joint::read(streams, reader, count, leaders, bytes, values)? {
                check(&[largest_byte(numbers)])?;
                T::append_stepped(numbers, least, step, out);
                return Ok(());
            }
        }
        _ => {
            let (positions, block) = beside.ok_or(CodecError::NoPositions)?;
            let passes = positions.passes(decoder, block)?;
            if decoder.passes.len() != count {
                return Err(CodecError::Count { expected: count, found: decoder.passes.len() as u64 });
            }
            if kind == Kind::Lines {
                positions.places(decoder, block)?;
                lines::read(decoder, reader, passes)?;
            } else {
                steady::read(decoder, reader, passes, |decoder| positions.places(decoder, block))?;
            }
        }
    }
    check(&decoder.values)?;
    T::append_stepped(&decoder.values, least, step, out);
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
            prop_assume!(values.iter().any(|v| *v != least));
            let found = Step::common(&values, Value::survey(&values));
            for value in &values {
                prop_assert_eq!(least + found.size() * found.quotient(value - least), *value);
            }
            let found = found.size();
            prop_assert!(values.iter().all(|v| (v - least) % found == 0));
            prop_assert_eq!(found, values.iter().fold(0, |d, v| gcd(d, v - least)));
        }
    }
}

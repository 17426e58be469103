//! Blocks of times that follow from positions: an airborne scanner sweeps over the ground in lines.
//!
//! A *pass* is one flight over the block (or its sweeps of one direction): lines begin at a fixed period, and when in
//! its line a point was measured is nearly a linear function of its position. A point's pass is stored beside its
//! position; so its line is stored as a
//! difference from what the pass' last point and the way from there to here let expect, and its time within the line in
//! pulses, as a difference from what the line's last point lets expect. `docs/format-codec.md`, kind 5, has all of it.
//!
//! [`find`] is the encoder's judgement: it works with floats and may change. [`walk`] is what both sides must do alike,
//! in integers throughout, so that what one machine encodes any other decodes.

mod clock;
mod find;
mod fit;
mod walk;

use super::CodecError;
use super::numbers::{unzigzag, zigzag};
use super::passes::BlockPasses;
use super::reader::{Reader, put_varint};
use super::residual::{plan_all, put_residuals, read_residuals};
use super::scratch::{Buffers, Decoder};
use super::stream::StreamWriter;
pub(super) use fit::Fit;
use walk::{Expected, MAX_LINES_PER_POINT, Model, ONE_PULSE, TICK_BITS, Units, Walk};
pub(super) use walk::{MAX_PASSES, nearest};

/// A position relative to a cube's low corner; the cube's exponent is at most 21.
pub(super) type Place = [i32; 3];

/// What encoding needs beside the block's buffers.
#[derive(Debug, Default)]
pub(super) struct LineBuffers {
    found: find::Found,
    walk: Walk,
    off: Off,
    /// The bytes of one piece, whose length comes first.
    piece: Vec<u8>,
}

/// Pulses are judged by such a share of the points.
const SAMPLE_SHARE: usize = 16;

/// How far a block's points are off what is expected of them.
#[derive(Debug, Default)]
struct Off {
    /// Lines, for each point.
    choices: Vec<u64>,
    /// Numbers, for the first point of each line.
    firsts: Vec<u64>,
    /// Pulses, for the others.
    pulses: Vec<u64>,
    /// And the ticks that are left between pulses.
    rests: Vec<u64>,
    /// And the numbers that are left between ticks.
    splits: Vec<u64>,
}

/// If what is left between pulses takes so many bits, ticks are looked for.
const TICKS_ABOVE_BITS: usize = 6;

impl Off {
    fn pieces(&self, units: Units) -> impl Iterator<Item = &[u64]> {
        let all = [&self.choices, &self.firsts, &self.pulses, &self.rests, &self.splits];
        all.into_iter().zip(pieces(units)).filter(|(_, there)| *there).map(|(piece, _)| &piece[..])
    }

    /// Fills in all points; `labels` are their passes and lines.
    fn fill(&mut self, model: &Model, walk: &mut Walk, labels: &[(u8, u32)], places: &[Place], numbers: &[u64]) {
        let Self { choices, firsts, pulses, rests, splits } = self;
        choices.clear();
        // Filled by place, since a push may have to grow.
        [&mut *firsts, &mut *pulses, &mut *rests, &mut *splits]
            .into_iter()
            .for_each(|piece| piece.resize(places.len(), 0));
        let (mut first_count, mut other_count) = (0, 0);
        walk.begin(model);
        choices.extend(places.iter().zip(numbers).zip(labels).map(|((&place, &number), &(pass, line))| {
            let Some(next) = walk.next(usize::from(pass), place) else { return 0 };
            let difference = i64::from(line).wrapping_sub(next.line());
            let Some(point) = next.on(line.into()) else { return 0 };
            let Expected { from, pulses: ahead, first } = point.expected();
            let offset = (number as i64).wrapping_sub(point.start());
            let way = offset.wrapping_sub(from);
            if first {
                firsts[first_count] = zigzag(way.wrapping_sub(model.length(model.ticks(ahead))) as u64);
                first_count += 1;
            } else {
                let ticks = model.nearest_ticks(way);
                let whole = model.nearest_pulses(ticks);
                pulses[other_count] = zigzag(whole.wrapping_sub(ahead) as u64);
                rests[other_count] = zigzag(ticks.wrapping_sub(model.ticks(whole)) as u64);
                splits[other_count] = zigzag(way.wrapping_sub(model.length(ticks)) as u64);
                other_count += 1;
            }
            point.keep(offset);
            zigzag(difference as u64)
        }));
        firsts.truncate(first_count);
        pulses.truncate(other_count);
        rests.truncate(other_count);
        splits.truncate(other_count);
    }

    /// About what depends on the units, in bits.
    fn cost(&self) -> usize {
        bits(&self.pulses) + bits(&self.rests) + bits(&self.splits)
    }
}

fn bits(numbers: &[u64]) -> usize {
    numbers.iter().map(|n| (u64::BITS - n.leading_zeros()) as usize).sum()
}

/// Which pieces there are.
fn pieces(Units { pulse, tick }: Units) -> [bool; 5] {
    [true, true, true, pulse != ONE_PULSE, tick != 0]
}

/// Appends the numbers `buffers.values`, whose order is known to `buffers.rank`, to `out` after `head`, if they are found
/// to lie in lines, and says if they were.
pub(super) fn try_put(
    streams: &mut StreamWriter,
    buffers: &mut Buffers,
    passes: &mut BlockPasses,
    head: impl Fn(&mut Vec<u8>),
    out: &mut Vec<u8>,
) -> bool {
    let Buffers { values, lines, rank, .. } = buffers;
    let LineBuffers { found, walk, off, piece } = lines;
    let BlockPasses { count, of_point, places } = passes;
    if places.len() != values.len() || !found.find(rank.sorted(), places) {
        return false;
    }
    let mut units = Units { pulse: found.pulse(), tick: 0 };
    let mut try_units = |units, points: usize| {
        found.set_units(units);
        off.fill(found.model(), walk, found.labels(), &places[..points], values);
        off.cost()
    };
    // The first points tell which units are worth it.
    let few = values.len().div_ceil(SAMPLE_SHARE);
    let mut cost = try_units(units, few);
    if units.pulse != ONE_PULSE {
        let without = Units { pulse: ONE_PULSE, ..units };
        let cost_without = try_units(without, few);
        if cost >= cost_without {
            (units, cost) = (without, cost_without);
        }
    }
    if cost > TICKS_ABOVE_BITS * few
        && let Some(tick) = clock::find(rank.sorted())
    {
        let tick = Units { tick: (tick * (1_u64 << TICK_BITS) as f64) as u64, pulse: ONE_PULSE };
        let pulse = (units.pulse as f64 / tick.tick()) as u64;
        for ticks in [tick, Units { pulse: pulse.max(ONE_PULSE), ..tick }] {
            let cost_ticks = try_units(ticks, few);
            if cost_ticks < cost {
                (units, cost) = (ticks, cost_ticks);
            }
        }
    }
    try_units(units, values.len());
    of_point.clear();
    of_point.extend(found.labels().iter().map(|label| label.0));
    *count = found.model().passes();
    head(out);
    found.model().put(out);
    put_varint(off.firsts.len() as u64, out);
    for numbers in off.pieces(units) {
        let (plan, bits) = plan_all(numbers);
        piece.clear();
        put_residuals(streams, numbers.iter().copied(), bits, plan.mantissa, piece);
        put_varint(piece.len() as u64, out);
        out.extend_from_slice(piece);
    }
    true
}

/// What decoding needs beside the decoder's buffers.
#[derive(Debug, Default)]
pub(super) struct LineScratch {
    model: Model,
    walk: Walk,
    pieces: [Vec<u64>; 5],
}

/// Reads the numbers of the points at `decoder.places` in the passes `decoder.passes`, up to the end of the block, into `decoder.values`, whose content
/// is replaced.
pub(super) fn read(decoder: &mut Decoder, mut reader: Reader, pass_count: usize) -> Result<(), CodecError> {
    const FIRSTS: &str = "first points of lines";
    let Decoder { streams, values, places, passes, lines, .. } = decoder;
    let LineScratch { model, walk, pieces: [choices, firsts, pulses, rests, splits] } = lines;
    let count = places.len();
    model.read(&mut reader, pass_count, MAX_LINES_PER_POINT * count)?;
    let found = reader.varint(FIRSTS)?;
    let first_count = usize::try_from(found).ok().filter(|n| (1..=count).contains(n));
    let first_count = first_count.ok_or(CodecError::Range { place: FIRSTS, found, limit: count as u64 })?;
    let others = count - first_count;
    let counts = [count, first_count, others, others, others];
    let buffers = [&mut *choices, &mut *firsts, &mut *pulses, &mut *rests, &mut *splits];
    for ((out, count), there) in buffers.into_iter().zip(counts).zip(pieces(model.units())) {
        const PIECE: &str = "piece of lines";
        if !there {
            out.clear();
            out.resize(count, 0);
            continue;
        }
        let length = usize::try_from(reader.varint(PIECE)?).unwrap_or(usize::MAX);
        let piece = Reader::new(reader.take(length, PIECE)?);
        read_residuals(streams, piece, count, u64::BITS, out)?;
    }
    reader.end("bytes after the lines")?;
    let (mut firsts, mut others) = (firsts.iter(), pulses.iter().zip(rests.iter()).zip(splits.iter()));
    let outside = |place, found, limit: i64| CodecError::Range { place, found, limit: limit as u64 };
    values.clear();
    values.resize(count, 0);
    walk.begin(model);
    let points = places.iter().zip(passes.iter());
    for (((&place, &pass), &choice), value) in points.zip(choices.iter()).zip(values) {
        let next = walk.next(usize::from(pass), place);
        let next = next.ok_or_else(|| outside("pass of a point", pass.into(), model.passes() as i64 - 1))?;
        let line = next.line().wrapping_add(unzigzag(choice) as i64);
        let lines = next.lines();
        let point = next.on(line).ok_or_else(|| outside("line of a point", line as u64, lines - 1))?;
        let Expected { from, pulses: ahead, first } = point.expected();
        let length = if first {
            firsts.next().map(|left| model.length(model.ticks(ahead)).wrapping_add(unzigzag(*left) as i64))
        } else {
            others.next().map(|((pulses, rest), split)| {
                let ticks = model.ticks(ahead.wrapping_add(unzigzag(*pulses) as i64));
                let ticks = ticks.wrapping_add(unzigzag(*rest) as i64);
                model.length(ticks).wrapping_add(unzigzag(*split) as i64)
            })
        };
        let length = length.ok_or_else(|| outside(FIRSTS, first_count as u64, count as i64))?;
        let offset = from.wrapping_add(length);
        *value = point.start().wrapping_add(offset) as u64;
        point.keep(offset);
    }
    Ok(())
}

#[cfg(test)]
mod tests;

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
use walk::{Expected, MAX_LINES_PER_POINT, Model, ONE_PULSE, Walk};
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
    /// And what is left between pulses.
    rests: Vec<u64>,
}

impl Off {
    fn pieces(&self, pulse: u64) -> impl Iterator<Item = &[u64]> {
        let all = [&self.choices, &self.firsts, &self.pulses, &self.rests];
        all.into_iter().map(|piece| &piece[..]).take(pieces(pulse))
    }

    /// Fills in all points; `labels` are their passes and lines.
    fn fill(&mut self, model: &Model, walk: &mut Walk, labels: &[(u8, u32)], places: &[Place], numbers: &[u64]) {
        let Self { choices, firsts, pulses, rests } = self;
        choices.clear();
        // Filled by place, since a push may have to grow.
        [&mut *firsts, &mut *pulses, &mut *rests].into_iter().for_each(|piece| piece.resize(places.len(), 0));
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
                firsts[first_count] = zigzag(way.wrapping_sub(model.length(ahead)) as u64);
                first_count += 1;
            } else {
                let whole = model.nearest(way);
                pulses[other_count] = zigzag(whole.wrapping_sub(ahead) as u64);
                rests[other_count] = zigzag(way.wrapping_sub(model.length(whole)) as u64);
                other_count += 1;
            }
            point.keep(offset);
            zigzag(difference as u64)
        }));
        firsts.truncate(first_count);
        pulses.truncate(other_count);
        rests.truncate(other_count);
    }

    /// About what depends on the pulse, in bits.
    fn cost(&self) -> u32 {
        let bits = |numbers: &[u64]| numbers.iter().map(|n| u64::BITS - n.leading_zeros()).sum::<u32>();
        bits(&self.pulses) + bits(&self.rests)
    }
}

/// How many pieces there are.
fn pieces(pulse: u64) -> usize {
    if pulse == ONE_PULSE { 3 } else { 4 }
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
    let mut pulse = found.pulse();
    if pulse != ONE_PULSE {
        // The first points tell if pulses are worth it.
        let few = values.len().div_ceil(SAMPLE_SHARE);
        let [with, without] = [pulse, ONE_PULSE].map(|pulse| {
            found.set_pulse(pulse);
            off.fill(found.model(), walk, found.labels(), &places[..few], values);
            off.cost()
        });
        if with >= without {
            pulse = ONE_PULSE;
        }
    }
    found.set_pulse(pulse);
    off.fill(found.model(), walk, found.labels(), places, values);
    of_point.clear();
    of_point.extend(found.labels().iter().map(|label| label.0));
    *count = found.model().passes();
    head(out);
    found.model().put(out);
    put_varint(off.firsts.len() as u64, out);
    for numbers in off.pieces(pulse) {
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
    pieces: [Vec<u64>; 4],
}

/// Reads the numbers of the points at `decoder.places` in the passes `decoder.passes`, up to the end of the block, into `decoder.values`, whose content
/// is replaced.
pub(super) fn read(decoder: &mut Decoder, mut reader: Reader, pass_count: usize) -> Result<(), CodecError> {
    const FIRSTS: &str = "first points of lines";
    let Decoder { streams, values, places, passes, lines, .. } = decoder;
    let LineScratch { model, walk, pieces: [choices, firsts, pulses, rests] } = lines;
    let count = places.len();
    model.read(&mut reader, pass_count, MAX_LINES_PER_POINT * count)?;
    let found = reader.varint(FIRSTS)?;
    let first_count = usize::try_from(found).ok().filter(|n| (1..=count).contains(n));
    let first_count = first_count.ok_or(CodecError::Range { place: FIRSTS, found, limit: count as u64 })?;
    let counts = [count, first_count, count - first_count, count - first_count];
    rests.clear();
    let buffers = [&mut *choices, &mut *firsts, &mut *pulses, &mut *rests];
    for (out, count) in buffers.into_iter().zip(counts).take(pieces(model.pulse())) {
        const PIECE: &str = "piece of lines";
        let length = usize::try_from(reader.varint(PIECE)?).unwrap_or(usize::MAX);
        let piece = Reader::new(reader.take(length, PIECE)?);
        read_residuals(streams, piece, count, u64::BITS, out)?;
    }
    reader.end("bytes after the lines")?;
    rests.resize(count - first_count, 0);
    let (mut firsts, mut others) = (firsts.iter(), pulses.iter().zip(rests.iter()));
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
        let Expected { from, pulses: mut ahead, first } = point.expected();
        let rest = if first {
            firsts.next()
        } else {
            others.next().map(|(pulses, rest)| {
                ahead = ahead.wrapping_add(unzigzag(*pulses) as i64);
                rest
            })
        };
        let rest = unzigzag(*rest.ok_or_else(|| outside(FIRSTS, first_count as u64, count as i64))?) as i64;
        let offset = from.wrapping_add(model.length(ahead)).wrapping_add(rest);
        *value = point.start().wrapping_add(offset) as u64;
        point.keep(offset);
    }
    Ok(())
}

#[cfg(test)]
mod tests;

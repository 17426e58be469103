//! Blocks of numbers that are the same, or change evenly from place to place, within a pass: flight line numbers, scan angles,
//! flags of a scanner's channel.
//!
//! Per pass `base` as a zigzag varint, and three rates as zigzag varints, in 2^-20 a lattice step; then, as numbers, the
//! zigzags of what each number is more than `base + (rates . place + 2^19 >> 20)`.

use super::CodecError;
use super::lines::{Fit, MAX_PASSES, Place, nearest};
use super::numbers::{self, Numbers, unzigzag, zigzag};
use super::passes::BlockPasses;
use super::reader::{Reader, put_varint};
use super::scratch::Decoder;
use super::stream::StreamWriter;

/// Fraction bits of a rate.
const RATE_BITS: u32 = 20;

/// Every so many points are looked at.
const STRIDE: usize = 24;

/// The estimate must be so much better: it is rough, and trying takes time.
const GAIN: f32 = 0.8;

/// What numbers of a pass are expected to be.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Course {
    base: i64,
    rates: [i64; 3],
}

impl Course {
    #[inline]
    fn at(&self, place: Place) -> i64 {
        let along = |axis: usize| i64::from(place[axis]).wrapping_mul(self.rates[axis]);
        let sum = along(0).wrapping_add(along(1)).wrapping_add(along(2));
        self.base.wrapping_add(sum.wrapping_add(1 << (RATE_BITS - 1)) >> RATE_BITS)
    }
}

/// What encoding needs.
#[derive(Debug, Default)]
pub(super) struct SteadyBuffers {
    courses: Vec<Course>,
    off: Vec<u64>,
    packed: Vec<u8>,
}

/// The numbers of a pass that were looked at.
#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    fit: Fit,
    /// The number that more than half may have.
    common: u64,
    votes: u32,
    /// How many have it.
    have: u32,
    count: u32,
}

impl SteadyBuffers {
    /// Finds courses of a block's numbers; false if they are not estimated to take less than `limit_bytes`.
    fn find(&mut self, passes: &BlockPasses, number: impl Fn(usize) -> u64, limit_bytes: usize) -> bool {
        let count = passes.of_point.len();
        let mut seen = [Seen::default(); MAX_PASSES];
        let sample = || (0..count).step_by(STRIDE);
        for i in sample() {
            let (seen, number) = (&mut seen[usize::from(passes.of_point[i])], number(i));
            if seen.votes == 0 {
                seen.common = number;
            }
            seen.votes = if seen.common == number { seen.votes + 1 } else { seen.votes - 1 };
        }
        let mut steady = true;
        for i in sample() {
            let seen = &mut seen[usize::from(passes.of_point[i])];
            seen.have += u32::from(seen.common == number(i));
            seen.count += 1;
        }
        for seen in &seen[..passes.count] {
            steady &= 2 * seen.have >= seen.count;
        }
        if !steady {
            for i in sample() {
                seen[usize::from(passes.of_point[i])].fit.add(passes.places[i].map(f64::from), number(i) as f64);
            }
        }
        self.courses.clear();
        self.courses.extend(seen[..passes.count].iter().map(|seen| {
            if 2 * seen.have >= seen.count {
                return Course { base: seen.common as i64, rates: [0; 3] };
            }
            let rates = seen.fit.with_constant();
            let base = nearest(seen.fit.constant(rates));
            Course { base, rates: rates.map(|rate| nearest(rate * f64::from(1 << RATE_BITS))) }
        }));
        // The bits of each, and about one more to tell how many they are.
        let (mut bits, mut taken, mut all) = (0, 0, 0);
        for i in sample() {
            let off = self.off(passes, i, number(i));
            bits += u64::BITS - off.leading_zeros();
            taken += 1;
            all |= off;
        }
        // No symbol takes less than a bit, unless nearly all are the same.
        let least = if all > 2 { 1.0 } else { 0.0 };
        let bits = (bits as f32 / taken as f32).max(least) + least;
        bits * (count as f32) < GAIN * 8.0 * limit_bytes as f32
    }

    #[inline]
    fn off(&self, passes: &BlockPasses, i: usize, number: u64) -> u64 {
        let course = &self.courses[usize::from(passes.of_point[i])];
        zigzag((number as i64).wrapping_sub(course.at(passes.places[i])) as u64)
    }
}

/// Appends the numbers of a block to `out` after `head` if all of a pass are the same.
pub(super) fn try_put_same(
    streams: &mut StreamWriter,
    passes: &BlockPasses,
    number: impl Fn(usize) -> u64,
    head: impl Fn(&mut Vec<u8>),
    out: &mut Vec<u8>,
) -> bool {
    let mut common = [None; MAX_PASSES];
    let mut points = passes.of_point.iter().enumerate();
    if !points.all(|(i, pass)| *common[usize::from(*pass)].get_or_insert(number(i)) == number(i)) {
        return false;
    }
    head(out);
    for base in &common[..passes.count] {
        put_course(&Course { base: base.unwrap_or(0) as i64, rates: [0; 3] }, out);
    }
    numbers::put_zeros(streams, passes.of_point.len(), out);
    true
}

fn put_course(Course { base, rates }: &Course, out: &mut Vec<u8>) {
    [base].into_iter().chain(rates).for_each(|v| put_varint(zigzag(*v as u64), out));
}

/// Appends the numbers of a block to `out` after `head` if that is estimated to take less than `limit_bytes`.
pub(super) fn try_put(
    streams: &mut StreamWriter,
    buffers: &mut SteadyBuffers,
    passes: &BlockPasses,
    number: impl Fn(usize) -> u64,
    limit_bytes: usize,
    head: impl Fn(&mut Vec<u8>),
    out: &mut Vec<u8>,
) -> bool {
    let count = passes.of_point.len();
    if !buffers.find(passes, &number, limit_bytes) {
        return false;
    }
    let mut off = std::mem::take(&mut buffers.off);
    off.clear();
    off.extend((0..count).map(|i| buffers.off(passes, i, number(i))));
    head(out);
    buffers.courses.iter().for_each(|course| put_course(course, out));
    let most = off.iter().copied().max().unwrap_or(0);
    let choice = numbers::choose(count, most, |i| off[i]);
    numbers::put(streams, &off, &mut buffers.packed, choice, out);
    buffers.off = off;
    true
}

/// Reads the numbers of points in the passes `decoder.passes`, of which there are `passes`, into `decoder.values`. `places`
/// decodes where the points are, if that matters.
pub(super) fn read(
    decoder: &mut Decoder,
    mut reader: Reader,
    passes: usize,
    places: impl FnOnce(&mut Decoder) -> Result<(), CodecError>,
) -> Result<(), CodecError> {
    let mut courses = [Course::default(); MAX_PASSES];
    for Course { base, rates } in &mut courses[..passes] {
        for value in [base].into_iter().chain(rates) {
            *value = unzigzag(reader.varint("course of a pass")?) as i64;
        }
    }
    let count = decoder.passes.len();
    let same = courses.iter().all(|course| course.rates == [0; 3]);
    if !same {
        places(decoder)?;
    }
    let Decoder { streams, bytes, wide, values, passes, places, .. } = decoder;
    let off = numbers::read(streams, reader, count, u64::MAX, bytes, wide)?;
    let course = |pass: u8| &courses[usize::from(pass) % MAX_PASSES];
    let value = |expected: i64, off: u64| expected.wrapping_add(unzigzag(off) as i64) as u64;
    values.clear();
    match (off, same) {
        (Numbers::Bytes(off), true) => {
            values.extend(passes.iter().zip(off).map(|(&pass, &off)| value(course(pass).base, off.into())));
        }
        (Numbers::Wide(off), true) => {
            values.extend(passes.iter().zip(off).map(|(&pass, &off)| value(course(pass).base, off)));
        }
        (Numbers::Bytes(off), false) => {
            let points = passes.iter().zip(places.iter()).zip(off);
            values.extend(points.map(|((&pass, &place), &off)| value(course(pass).at(place), off.into())));
        }
        (Numbers::Wide(off), false) => {
            let points = passes.iter().zip(places.iter()).zip(off);
            values.extend(points.map(|((&pass, &place), &off)| value(course(pass).at(place), off)));
        }
    }
    Ok(())
}

//! Passes and lines, and what the points before let expect of the next one: integers, wrapping where damaged bytes lead
//! them out of range, the same for encoding and decoding.

use super::Place;
use crate::codec::CodecError;
use crate::codec::numbers::{unzigzag, zigzag};
use crate::codec::reader::{Reader, put_varint};

/// The most passes of a block.
pub(in crate::codec) const MAX_PASSES: usize = 32;

/// The most lines of a block, of all passes together, for each of its points.
pub(super) const MAX_LINES_PER_POINT: usize = 4;

/// Fraction bits of a pulse's length.
const PULSE_BITS: u32 = 16;

/// Fraction bits of a tick's length.
pub(super) const TICK_BITS: u32 = 32;

/// A pulse of one tick, which is to say that none is known.
pub(super) const ONE_PULSE: u64 = 1 << PULSE_BITS;

/// Fraction bits of pulses a lattice step.
const ALONG_BITS: u32 = 20;

/// Fraction bits of lines a lattice step.
const ACROSS_BITS: u32 = 24;

/// One pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Pass {
    /// Where line 0 has offset 0.
    pub(super) start: i64,
    /// From line to line.
    pub(super) period: i64,
    /// Lines are numbered from 0.
    pub(super) lines: u32,
    /// Pulses a lattice step, by axis.
    pub(super) along: [i64; 3],
    /// Lines a lattice step, by axis.
    pub(super) across: [i64; 3],
}

impl Pass {
    /// Rounds rates to the model's fractions.
    pub(super) fn set_rates(&mut self, along: [f64; 3], across: [f64; 3]) {
        // Conversions saturate; any rate is valid.
        self.along = along.map(|rate| (rate * f64::from(1 << ALONG_BITS)).round() as i64);
        self.across = across.map(|rate| (rate * f64::from(1 << ACROSS_BITS)).round() as i64);
    }
}

/// What times are counted in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Units {
    /// Ticks a pulse, in 2^-16.
    pub(super) pulse: u64,
    /// Numbers a tick, in 2^-32; 0 if a tick is a number.
    pub(super) tick: u64,
}

impl Units {
    /// Numbers a tick.
    pub(super) fn tick(self) -> f64 {
        if self.tick == 0 { 1.0 } else { self.tick as f64 / (1_u64 << TICK_BITS) as f64 }
    }

    /// Ticks a pulse.
    pub(super) fn pulse(self) -> f64 {
        self.pulse as f64 / ONE_PULSE as f64
    }
}

/// What is stored of a block beside its points.
#[derive(Debug, Default)]
pub(super) struct Model {
    units: Units,
    /// The reverse of both, for encoding.
    ticks_a_number: f64,
    pulses_a_tick: f64,
    passes: Vec<Pass>,
}

impl Model {
    /// Takes over what was found; passes have at least one line each.
    pub(super) fn set(&mut self, units: Units, passes: &[Pass]) {
        self.units = units;
        (self.ticks_a_number, self.pulses_a_tick) = (1.0 / units.tick(), 1.0 / units.pulse());
        self.passes.clear();
        self.passes.extend_from_slice(passes);
    }

    pub(super) fn put(&self, out: &mut Vec<u8>) {
        put_varint(self.units.pulse, out);
        put_varint(self.units.tick, out);
        for pass in &self.passes {
            let Pass { start, period, lines, along, across } = *pass;
            put_varint(lines.into(), out);
            let signed = [start, period].into_iter().chain(along).chain(across);
            signed.for_each(|v| put_varint(zigzag(v as u64), out));
        }
    }

    /// The reverse of [`Model::put`], for so many passes.
    pub(super) fn read(&mut self, reader: &mut Reader, passes: usize, max_lines: usize) -> Result<(), CodecError> {
        const PULSE: &str = "ticks a pulse";
        const LINES: &str = "lines of a pass";
        let pulse = reader.varint(PULSE)?;
        if pulse < ONE_PULSE {
            return Err(CodecError::Range { place: PULSE, found: pulse, limit: u64::MAX });
        }
        self.units = Units { pulse, tick: reader.varint("numbers a tick")? };
        self.passes.clear();
        let mut left = max_lines as u64;
        for _ in 0..passes {
            let lines = reader.varint(LINES)?;
            if !(1..=left).contains(&lines) {
                return Err(CodecError::Range { place: LINES, found: lines, limit: left });
            }
            left -= lines;
            let mut pass = Pass { lines: lines as u32, ..Pass::default() };
            let Pass { start, period, along, across, .. } = &mut pass;
            for value in [start, period].into_iter().chain(along).chain(across) {
                *value = unzigzag(reader.varint("rates of a pass")?) as i64;
            }
            self.passes.push(pass);
        }
        Ok(())
    }

    pub(super) fn units(&self) -> Units {
        self.units
    }

    pub(super) fn passes(&self) -> usize {
        self.passes.len()
    }

    /// How many ticks so many pulses take.
    #[inline]
    pub(super) fn ticks(&self, pulses: i64) -> i64 {
        pulses.wrapping_mul(self.units.pulse as i64).wrapping_add(1 << (PULSE_BITS - 1)) >> PULSE_BITS
    }

    /// The length of so many ticks.
    #[inline]
    pub(super) fn length(&self, ticks: i64) -> i64 {
        let Units { tick, .. } = self.units;
        if tick == 0 {
            return ticks;
        }
        // A product of 63 and 64 bits, and less than one more.
        ((i128::from(ticks) * i128::from(tick) + (1 << (TICK_BITS - 1))) >> TICK_BITS) as i64
    }

    /// How many ticks come nearest to a length. For encoding: whatever it gives, the rest makes up for it.
    #[inline]
    pub(super) fn nearest_ticks(&self, length: i64) -> i64 {
        if self.units.tick == 0 { length } else { nearest(length as f64 * self.ticks_a_number) }
    }

    /// How many pulses come nearest to so many ticks.
    #[inline]
    pub(super) fn nearest_pulses(&self, ticks: i64) -> i64 {
        if self.units.pulse == ONE_PULSE { ticks } else { nearest(ticks as f64 * self.pulses_a_tick) }
    }
}

/// The nearest whole number; conversions are much faster than `f64::round`, a call where the processor may be old.
#[inline]
pub(in crate::codec) fn nearest(value: f64) -> i64 {
    (value + 0.5_f64.copysign(value)) as i64
}

/// What is expected of a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expected {
    /// The offset of the point to go from.
    pub(super) from: i64,
    /// Pulses from there to the point.
    pub(super) pulses: i64,
    /// Is it the first point of its line?
    pub(super) first: bool,
}

/// The last point of a pass or of a line.
#[derive(Clone, Copy, Debug, Default)]
struct Last {
    offset: i64,
    place: Place,
    /// Is there one?
    there: bool,
}

/// A pass on the way.
#[derive(Clone, Copy, Debug, Default)]
struct State {
    pass: Pass,
    last: Last,
    /// The line of the last point.
    line: i64,
    /// The place of line 0 among the lines of all passes.
    slot: usize,
}

/// The points so far.
#[derive(Debug, Default)]
pub(super) struct Walk {
    passes: Vec<State>,
    lines: Vec<Last>,
}

impl Walk {
    /// Before the first point.
    pub(super) fn begin(&mut self, model: &Model) {
        self.passes.clear();
        let mut slot = 0;
        for &pass in &model.passes {
            self.passes.push(State { pass, slot, ..State::default() });
            slot += pass.lines as usize;
        }
        self.lines.clear();
        self.lines.resize(slot, Last::default());
    }

    /// The next point of a pass, if there is such a pass.
    #[inline]
    pub(super) fn next(&mut self, pass: usize, place: Place) -> Option<Next<'_>> {
        let Self { passes, lines } = self;
        Some(Next { state: passes.get_mut(pass)?, lines, place })
    }
}

/// A point whose pass is known.
#[derive(Debug)]
pub(super) struct Next<'a> {
    state: &'a mut State,
    lines: &'a mut [Last],
    place: Place,
}

impl<'a> Next<'a> {
    /// The line that is expected.
    #[inline]
    pub(super) fn line(&self) -> i64 {
        let State { pass, last, line, .. } = &*self.state;
        if last.there { line.wrapping_add(rounded(way(last.place, self.place, &pass.across), ACROSS_BITS)) } else { 0 }
    }

    /// How many lines the pass has.
    #[inline]
    pub(super) fn lines(&self) -> i64 {
        self.state.pass.lines.into()
    }

    /// The point with its line, if the pass has such a line.
    #[inline]
    pub(super) fn on(self, line: i64) -> Option<OnLine<'a>> {
        let Self { state, lines, place } = self;
        if !(0..i64::from(state.pass.lines)).contains(&line) {
            return None;
        }
        state.line = line;
        Some(OnLine { of_line: lines.get_mut(state.slot + line as usize)?, state, place })
    }
}

/// A point whose line is known.
#[derive(Debug)]
pub(super) struct OnLine<'a> {
    state: &'a mut State,
    of_line: &'a mut Last,
    place: Place,
}

impl OnLine<'_> {
    /// The number that has offset 0 in the line.
    #[inline]
    pub(super) fn start(&self) -> i64 {
        let Pass { start, period, .. } = self.state.pass;
        start.wrapping_add(self.state.line.wrapping_mul(period))
    }

    /// The offset that is expected.
    #[inline]
    pub(super) fn expected(&self) -> Expected {
        let first = !self.of_line.there;
        let last = if first { &self.state.last } else { &*self.of_line };
        if !last.there {
            return Expected { from: 0, pulses: 0, first };
        }
        let pulses = rounded(way(last.place, self.place, &self.state.pass.along), ALONG_BITS);
        Expected { from: last.offset, pulses, first }
    }

    /// Notes the point's offset.
    #[inline]
    pub(super) fn keep(self, offset: i64) {
        let last = Last { offset, place: self.place, there: true };
        self.state.last = last;
        *self.of_line = last;
    }
}

/// The way from one place to another at these rates.
#[inline]
fn way(from: Place, to: Place, rates: &[i64; 3]) -> i64 {
    let along = |axis: usize| i64::from(to[axis] - from[axis]).wrapping_mul(rates[axis]);
    along(0).wrapping_add(along(1)).wrapping_add(along(2))
}

/// Without the fraction; halves go up.
#[inline]
fn rounded(value: i64, fraction_bits: u32) -> i64 {
    value.wrapping_add(1 << (fraction_bits - 1)) >> fraction_bits
}

//! Which lines and passes the times of a block show, and at which rates positions tell them. The encoder's alone: any
//! answer can be decoded, a good one makes small differences.

use super::Place;
use super::fit::Fit;
use super::walk::{MAX_LINES_PER_POINT, MAX_PASSES, Model, ONE_PULSE, Pass, Units, nearest};
use crate::codec::ranked::Entry;
use std::ops::Range;

/// The fewest points among which lines are looked for: below, passes cost more than they save.
const MIN_POINTS: usize = 256;

/// The fewest lines.
const MIN_LINES: usize = 6;

/// A gap of so many times the usual distance between lines is one between passes.
const PASS_GAP: i64 = 50;

/// The share of a pass' way against its main direction that makes it a scanner whose sweeps go both ways.
const BOTH_WAYS: f64 = 0.1;

/// Every so many points are looked at for rates.
const STRIDE: usize = 8;

/// Gaps that are looked at for the pulse.
const PULSE_SAMPLE: usize = 256;

/// A pulse of fewer numbers saves nothing.
const MIN_PULSE: f64 = 3.0;

/// Points in one sweep over the block.
#[derive(Clone, Copy, Debug)]
struct Sweep {
    /// Its points, by order of time.
    first: usize,
    end: usize,
    /// The numbers of the first and the last.
    from: i64,
    to: i64,
    pass: usize,
    /// Its line in the pass.
    line: i64,
}

impl Sweep {
    fn middle(&self) -> i64 {
        self.from + (self.to - self.from) / 2
    }
}

/// What was found.
#[derive(Debug, Default)]
pub(super) struct Found {
    model: Model,
    passes: Vec<Pass>,
    /// Numbers and lines a lattice step, by pass.
    rates: Vec<([f64; 3], [f64; 3])>,
    /// The pass and line of each point.
    labels: Vec<(u8, u32)>,
    pulse: u64,
    sweeps: Vec<Sweep>,
    /// The sweeps of the flight that each pass is of.
    flights: Vec<Range<usize>>,
    gaps: Vec<i64>,
    /// Distances from the beginning of a sweep.
    samples: Vec<f64>,
    /// Of those that are near: the square of the error a pulse, the pulses, and the distance.
    near: Vec<(f64, f64, f64)>,
    errors: Vec<u64>,
}

impl Found {
    /// The pass and line of each point.
    pub(super) fn labels(&self) -> &[(u8, u32)] {
        &self.labels
    }

    /// Numbers a pulse; [`ONE_PULSE`] if there is none.
    pub(super) fn pulse(&self) -> u64 {
        self.pulse
    }

    /// What was found.
    pub(super) fn model(&self) -> &Model {
        &self.model
    }

    /// Brings the model to these units.
    pub(super) fn set_units(&mut self, units: Units) {
        let numbers = units.pulse() * units.tick();
        for (pass, (along, across)) in self.passes.iter_mut().zip(&self.rates) {
            pass.set_rates(along.map(|rate| rate / numbers), *across);
        }
        self.model.set(units, &self.passes);
    }

    /// Looks for lines in numbers, sorted, at `places`; false if there are none worth while.
    pub(super) fn find(&mut self, sorted: &[Entry], places: &[Place]) -> bool {
        if sorted.len() < MIN_POINTS {
            return false;
        }
        let Some(gap) = line_gap(sorted) else { return false };
        self.cut(sorted, gap);
        if self.sweeps.len() < MIN_LINES || !self.find_passes(sorted, places) || !self.number_lines(sorted.len()) {
            return false;
        }
        self.fit(sorted, places);
        self.find_pulse(sorted);
        true
    }

    /// Cuts the points into sweeps at gaps above `gap`.
    fn cut(&mut self, sorted: &[Entry], gap: i64) {
        self.sweeps.clear();
        let mut first = 0;
        for end in 1..=sorted.len() {
            let to = sorted[end - 1].number();
            if sorted.get(end).is_none_or(|next| next.number() - to > gap) {
                let from = sorted[first].number();
                self.sweeps.push(Sweep { first, end, from, to, pass: 0, line: 0 });
                first = end;
            }
        }
    }

    /// Groups sweeps to passes, one for each direction; false if there are too many.
    fn find_passes(&mut self, sorted: &[Entry], places: &[Place]) -> bool {
        let Self { sweeps, gaps, flights, .. } = self;
        flights.clear();
        gaps.clear();
        gaps.extend(sweeps.windows(2).map(|w| w[1].from - w[0].from));
        let usual = *gaps.select_nth_unstable(sweeps.len() / 2 - 1).1;
        let (mut passes, mut first) = (0, 0);
        for flight in sweeps.chunk_by_mut(|a, b| b.from - a.from <= usual.max(1).saturating_mul(PASS_GAP)) {
            let direction = |sweep: &Sweep| {
                let [from, to] = [sweep.first, sweep.end - 1].map(|i| places[sorted[i].index()]);
                [0, 1].map(|axis| f64::from(to[axis] - from[axis]))
            };
            let mut main = ([0.0; 2], 0.0);
            for sweep in flight.iter() {
                let [x, y] = direction(sweep);
                if x * x + y * y > main.1 {
                    main = ([x, y], x * x + y * y);
                }
            }
            let along = |sweep: &Sweep| {
                let [x, y] = direction(sweep);
                x * main.0[0] + y * main.0[1]
            };
            let (mut with, mut against) = (0.0, 0.0);
            for way in flight.iter().map(along) {
                if way < 0.0 {
                    against -= way;
                } else {
                    with += way;
                }
            }
            let both = against > BOTH_WAYS * with;
            for sweep in flight.iter_mut() {
                sweep.pass = passes + usize::from(both && along(sweep) < 0.0);
            }
            passes += 1 + usize::from(both);
            if passes > MAX_PASSES {
                return false;
            }
            flights.resize(passes, first..first + flight.len());
            first += flight.len();
        }
        self.passes.clear();
        self.passes.resize(passes, Pass::default());
        true
    }

    /// Finds the period of each pass and numbers its lines; false if there are too many.
    fn number_lines(&mut self, points: usize) -> bool {
        let Self { sweeps, flights, passes, gaps, .. } = self;
        let mut lines = 0;
        for (index, (pass, flight)) in passes.iter_mut().zip(flights).enumerate() {
            let sweeps = &mut sweeps[flight.clone()];
            let own = || sweeps.iter().filter(move |s| s.pass == index).map(Sweep::middle);
            let Some(origin) = own().next() else { return false };
            gaps.clear();
            gaps.extend(own().zip(own().skip(1)).map(|(a, b)| b - a));
            pass.period = i64::MAX >> 8;
            if !gaps.is_empty() {
                let quarter = gaps.len() / 4;
                pass.period = (*gaps.select_nth_unstable(quarter).1).max(1);
                // A least-squares period, by counting lines from each sweep to the next: few periods drift little.
                for _ in 0..2 {
                    let (mut n, mut before, mut count) = (0.0, origin, 0.0);
                    let [mut sn, mut sy, mut snn, mut sny] = [0.0; 4];
                    for middle in own() {
                        n += nearest((middle - before) as f64 / pass.period as f64) as f64;
                        before = middle;
                        let y = (middle - origin) as f64;
                        (sn, sy, snn, sny, count) = (sn + n, sy + y, snn + n * n, sny + n * y, count + 1.0);
                    }
                    let spread = count * snn - sn * sn;
                    if spread > 0.0 {
                        pass.period = (((count * sny - sn * sy) / spread).round() as i64).max(1);
                    }
                }
            }
            let mut last = 0;
            let half = pass.period / 2;
            for sweep in sweeps.iter_mut().filter(|s| s.pass == index) {
                sweep.line = (sweep.middle() - origin + half) / pass.period;
                last = last.max(sweep.line);
            }
            lines += last + 1;
            if lines > (MAX_LINES_PER_POINT * points) as i64 {
                return false;
            }
            (pass.start, pass.lines) = (origin, last as u32 + 1);
        }
        true
    }

    /// Finds rates, and notes every point's pass and line.
    fn fit(&mut self, sorted: &[Entry], places: &[Place]) {
        let Self { sweeps, passes, rates, labels, .. } = self;
        let mut fits = [(Fit::default(), Fit::default()); MAX_PASSES];
        labels.clear();
        labels.resize(sorted.len(), (0, 0));
        for &Sweep { first, end, from, pass, line, .. } in sweeps.iter() {
            let label = (pass as u8, line as u32);
            sorted[first..end].iter().for_each(|entry| labels[entry.index()] = label);
            let (along, across) = &mut fits[pass];
            let origin = places[sorted[first].index()];
            // From different places on, so that short sweeps count too.
            for entry in sorted[first..end].iter().skip(first % STRIDE).step_by(STRIDE) {
                let place = places[entry.index()];
                let way = std::array::from_fn(|axis| f64::from(place[axis] - origin[axis]));
                along.add(way, (entry.number() - from) as f64);
                across.add(place.map(f64::from), line as f64);
            }
        }
        rates.clear();
        rates.extend(fits[..passes.len()].iter().map(|(a, b)| (a.through_origin(), b.with_constant())));
    }

    /// Finds the distance between pulses: the least common gap, then a better one over longer and longer ways.
    fn find_pulse(&mut self, sorted: &[Entry]) {
        let Self { sweeps, gaps, samples, near, errors, .. } = self;
        self.pulse = ONE_PULSE;
        gaps.clear();
        samples.clear();
        let stride = sorted.len().div_ceil(PULSE_SAMPLE);
        for &Sweep { first, end, from, .. } in sweeps.iter() {
            for i in (first..end).skip(first % stride).step_by(stride) {
                let number = sorted[i].number();
                if number > from {
                    samples.push((number - from) as f64);
                    let gap = number - sorted[i - 1].number();
                    if gap > 0 {
                        gaps.push(gap);
                    }
                }
            }
        }
        if gaps.len() < 16 {
            return;
        }
        let eighth = gaps.len() / 8;
        let common = *gaps.select_nth_unstable(eighth).1 as f64;
        let (mut sum, mut count) = (0.0, 0.0);
        for gap in gaps.iter().map(|gap| *gap as f64).filter(|gap| *gap < 1.5 * common) {
            (sum, count) = (sum + gap, count + 1.0);
        }
        let mut pulse: f64 = sum / count;
        for reach in [4.0, 16.0, 64.0, 256.0] {
            near.clear();
            errors.clear();
            let pulses_a_number = 1.0 / pulse;
            for &way in samples.iter() {
                let pulses = nearest(way * pulses_a_number) as f64;
                if pulses > 0.0 && pulses <= reach {
                    // What the pulse's own error does grows with the way. Squares have the same order, and so have the bits
                    // of floats that are not negative.
                    let error = (way - pulses * pulse).powi(2) / pulses;
                    near.push((error, pulses, way));
                    errors.push(error.to_bits());
                }
            }
            if errors.is_empty() {
                continue;
            }
            let middle = errors.len() / 2;
            let limit = 1.5 * 1.5 * f64::from_bits(*errors.select_nth_unstable(middle).1);
            let (mut with, mut squares) = (0.0, 0.0);
            for &(error, pulses, way) in near.iter() {
                if error <= limit {
                    with += pulses * way;
                    squares += pulses * pulses;
                }
            }
            if squares > 0.0 {
                pulse = with / squares;
            }
        }
        if pulse >= MIN_PULSE && pulse < f64::from(u32::MAX) {
            self.pulse = (pulse * ONE_PULSE as f64).round() as u64;
        }
    }
}

/// The gap above which a point begins another sweep: the emptiest place in the distribution of gaps between a heap of
/// small ones (between pulses) and one of large ones (between lines).
fn line_gap(sorted: &[Entry]) -> Option<i64> {
    // Two heaps, since an addition that waits for the one before it is slow.
    let mut heaps = [[0_usize; 66]; 2];
    let bits = |from: Entry, to: Entry| (u64::BITS - (to.number() - from.number()).leading_zeros()) as usize;
    let mut next = 1;
    while let Some(three) = sorted.get(next - 1..next + 2) {
        heaps[0][bits(three[0], three[1])] += 1;
        heaps[1][bits(three[1], three[2])] += 1;
        next += 2;
    }
    if let Some(last) = sorted.get(next - 1..next + 1) {
        heaps[0][bits(last[0], last[1])] += 1;
    }
    let mut heap: [usize; 66] = std::array::from_fn(|i| heaps[0][i] + heaps[1][i]);
    heap[0] = 0;
    let points = sorted.len();
    let mut above: usize = heap.iter().sum();
    let mut least = MIN_LINES.max(points / 1024);
    least = least.max(1);
    let (mut best, mut range) = (1.0, None);
    let mut below = 0;
    for bits in 1..63 {
        above -= heap[bits];
        if bits >= 2 && above >= least && above <= points / 4 * 3 {
            let right = heap[bits + 1..].iter().copied().max().unwrap_or(0);
            let here = (heap[bits - 1] + 6 * heap[bits] + heap[bits + 1]) as f64 / 8.0;
            let score = below.min(right) as f64 / (here + points as f64 / 512.0);
            match &mut range {
                Some((_, last)) if score == best && *last + 1 == bits => *last = bits,
                _ if score > best => (best, range) = (score, Some((bits, bits))),
                _ => {}
            }
        }
        below = below.max(heap[bits]);
    }
    range.map(|(first, last)| 3_i64 << ((first + last) / 2).saturating_sub(1) >> 1)
}

//! The ticks that a scanner's clock counted between pulses, which the steps of a float do not divide: ticks of 43 ns, say, in
//! times with steps of 0.03 ns. The encoder's alone: any tick can be decoded.

use super::walk::nearest;
use crate::codec::ranked::Entry;

/// A tick of fewer numbers saves little.
const MIN_TICK: f64 = 16.0;

/// Gaps that are looked at.
const GAPS: usize = 512;

/// The fewest.
const MIN_GAPS: usize = 32;

/// Gaps that differ by this or less are the same, but for rounding.
const SAME: i64 = 2;

/// The widest range of the same, and the most different ones.
const MAX_SPREAD: i64 = 4;
const MAX_CLUSTERS: usize = 128;

/// The numbers of a tick, if the gaps between sorted numbers, the first of them 0, are whole ticks, rounded.
pub(super) fn find(sorted: &[Entry]) -> Option<f64> {
    let (mut tick, error) = common(sorted)?;
    // The way from the first number on tells the tick ever better: how many ticks the next gap has is known each time.
    let (mut ticks, mut before) = (0.0, 0);
    for number in sorted.iter().map(|entry| entry.number()) {
        if number > before {
            ticks += nearest((number - before) as f64 / tick) as f64;
            before = number;
            if ticks * error > 1.0 {
                tick = number as f64 / ticks;
            }
        }
    }
    (tick >= MIN_TICK).then_some(tick)
}

/// What is known up to an error.
type About = (f64, f64);

/// What the gaps are multiples of, but for rounding.
fn common(sorted: &[Entry]) -> Option<About> {
    let stride = sorted.len().div_ceil(GAPS).max(1);
    let gap = |pair: &[Entry]| Some(pair[1].number() - pair[0].number()).filter(|gap| *gap > 0);
    let mut gaps: Vec<i64> = sorted.windows(2).step_by(stride).filter_map(gap).collect();
    if gaps.len() < MIN_GAPS {
        return None;
    }
    gaps.sort_unstable();
    let mut means: Vec<About> = Vec::with_capacity(MAX_CLUSTERS);
    let mut seen = 0;
    for same in gaps.chunk_by(|a, b| b - a <= SAME) {
        // The longest are those between lines.
        if 4 * seen >= 3 * gaps.len() {
            break;
        }
        seen += same.len();
        if means.len() == MAX_CLUSTERS || same[same.len() - 1] - same[0] > MAX_SPREAD {
            return None;
        }
        let count = same.len() as f64;
        means.push((same.iter().sum::<i64>() as f64 / count, 2.0 / count.sqrt()));
    }
    // Euclid's way, of numbers that are off by a little.
    let mut tick = *means.first()?;
    for &mean in &means {
        let (mut a, mut b) = (mean, tick);
        loop {
            let times = nearest(a.0 / b.0) as f64;
            let rest = ((a.0 - times * b.0).abs(), a.1 + times * b.1);
            if rest.0 <= rest.1 {
                break;
            }
            (a, b) = (b, rest);
            if b.0 < MIN_TICK {
                return None;
            }
        }
        tick = b;
    }
    // What is surely so many ticks tells more exactly what one is.
    for (mean, error) in means {
        let times = nearest(mean / tick.0) as f64;
        if times * tick.1 < tick.0 / 4.0 && error < times * tick.1 {
            tick = (mean / times, error / times);
        }
    }
    Some(tick)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::ranked::RankBuffers;
    use proptest::prelude::*;

    fn sorted(numbers: &[u64]) -> Vec<Entry> {
        let mut rank = RankBuffers::default();
        rank.sort(numbers, numbers.iter().copied().max().unwrap_or(0));
        rank.sorted().to_vec()
    }

    proptest! {
        #[test]
        fn clocks_are_found(tick in 500.0_f64..5000.0, picks in prop::collection::vec((0_u64..2, 0_u64..8, 0_u64..40), 1000)) {
            // Pulses of 236 or 237 ticks, some lost, in sweeps; the clock is set a little after some of them.
            let (mut ticks, mut set) = (0, 0.0);
            let numbers = picks.iter().map(|&(more, lost, end)| {
                ticks += (236 + more) * (1 + lost / 7);
                if end == 0 {
                    (ticks, set) = (ticks + 290_000, set + 3.3);
                }
                (ticks as f64 * tick + set).round() as u64
            });
            let numbers: Vec<u64> = [0].into_iter().chain(numbers).collect();
            let found = find(&sorted(&numbers)).unwrap();
            // So that the way of eighty pulses is known to half a number; setting the clock alone makes half of that.
            prop_assert!((found - tick).abs() < 2.5e-5, "{found} for {tick}");
        }
    }
}

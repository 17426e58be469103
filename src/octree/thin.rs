//! The order of detail of a set of points: by step, and evenly within a step.

#[cfg(test)]
use super::{Metric, Step, steps, wins};
#[cfg(test)]
use crate::lattice::SortKey;

/// The numbers below `n`, each prefix spread evenly over them: by their bits, reversed (van der Corput).
///
/// Of points in key order this takes an even thinning whatever the capacity, since neighbours in key order are
/// neighbours in space. Costs at most two steps a number.
pub fn even_order(n: u32) -> impl Iterator<Item = u32> {
    let bits = u32::BITS - n.saturating_sub(1).leading_zeros();
    (0..1_u64 << bits).map(move |i| ((i << 32).reverse_bits() << bits >> 32) as u32).filter(move |&i| i < n)
}

/// A set of points in the order of detail: win descending, group ascending, evenly within a step; repeated positions
/// last.
#[cfg(test)]
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct DetailOrder {
    /// The points, as indices into the key order, coarse to fine.
    pub order: Vec<u32>,
    /// Each step that has points, with the number of points up to its end.
    pub steps: Vec<(Step, u32)>,
}

#[cfg(test)]
impl DetailOrder {
    /// The step of the point after the first `taken`; `None` if there is none.
    pub fn left_out(&self, taken: usize) -> Option<Step> {
        let next = self.steps.partition_point(|&(_, end)| end as usize <= taken);
        self.steps.get(next).map(|&(step, _)| step)
    }

    /// The bound of the first `taken` points.
    pub fn bound(&self, taken: usize, metric: &Metric) -> f64 {
        metric.prefix(taken as u64, self.left_out(taken))
    }
}

/// The order of detail of a set of points given by their sorted keys: the answers to all capacities at once.
///
/// `first` is the exponent of a cube that holds all of them, at most 48. Bounds hold for this set: it need not be a
/// whole tree.
///
/// # Panics
///
/// If there are 2^32 points or more.
#[cfg(test)]
pub(crate) fn canonical_order<K: SortKey>(keys: &[K], first: i8) -> DetailOrder {
    assert!(u32::try_from(keys.len()).is_ok(), "an order of detail has fewer than 2^32 points");
    let wins = wins(keys, first);
    let groups = steps(keys, &wins);
    let numbers = || wins.iter().zip(&groups).map(|(&win, &group)| Step::number(win, group));
    let mut ends = [0_u32; Step::COUNT];
    numbers().for_each(|n| ends[n] += 1);
    let mut steps = Vec::new();
    let mut starts = [0_u32; Step::COUNT];
    let mut total = 0;
    for n in 0..Step::COUNT {
        starts[n] = total;
        total += ends[n];
        if ends[n] > 0 {
            steps.push((Step::of_number(n), total));
        }
    }
    let mut by_step = vec![0_u32; keys.len()];
    for (i, n) in (0..).zip(numbers()) {
        by_step[starts[n] as usize] = i;
        starts[n] += 1;
    }
    let mut order = Vec::with_capacity(keys.len());
    for &(_, end) in &steps {
        let run = &by_step[order.len()..end as usize];
        order.extend(even_order(run.len() as u32).map(|i| run[i as usize]));
    }
    DetailOrder { order, steps }
}

/// How many numbers below `limit`, which have so many bits, are below `n` with their bits reversed.
fn below(limit: u64, bits: u32, n: u64) -> u64 {
    // Each bit of the limit ends a run of numbers with the same leading bits and any bits after these: reversed they are evenly
    // spaced from the reversed leading bits on.
    let run = |bit: u32| {
        let leading = (limit >> bit & !1) << bit;
        let (first, apart) = (reversed(leading, bits), 1_u64.checked_shl(bits - bit).unwrap_or(u64::MAX));
        n.saturating_sub(first).div_ceil(apart).min(1 << bit)
    };
    (0..bits).filter(|bit| limit >> bit & 1 == 1).map(run).sum()
}

/// The first numbers of [`even_order`], as a set that takes no memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EvenPrefix {
    bits: u32,
    /// With their bits reversed, those below this.
    limit: u64,
}

impl EvenPrefix {
    /// The first `taken` of the numbers below `n`; all of them, if there are not so many.
    ///
    pub fn new(n: u64, taken: u64) -> Self {
        let bits = u64::BITS - n.saturating_sub(1).leading_zeros();
        let all = 1_u64.checked_shl(bits).unwrap_or(u64::MAX);
        if taken >= n {
            return Self { bits, limit: all };
        }
        // The greatest limit below which so many numbers are.
        let (mut limit, mut beyond) = (0, all);
        while beyond - limit > 1 {
            let middle = limit.midpoint(beyond);
            if below(middle, bits, n) <= taken { limit = middle } else { beyond = middle }
        }
        Self { bits, limit }
    }

    /// Is `i`, which is below `n`, among them?
    pub fn contains(&self, i: u64) -> bool {
        reversed(i, self.bits) < self.limit
    }
}

/// The lowest bits of `i` in reverse.
fn reversed(i: u64, bits: u32) -> u64 {
    i.reverse_bits().checked_shr(u64::BITS - bits).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::Key;
    use crate::octree::naive::tests::points;
    use proptest::prelude::*;

    #[test]
    fn every_prefix_of_the_even_order_has_gaps_of_two_sizes_at_most() {
        for n in 0..200_u32 {
            let order: Vec<_> = even_order(n).collect();
            let mut all = order.clone();
            all.sort_unstable();
            assert_eq!(all, (0..n).collect::<Vec<_>>());
            for taken in 2..=order.len() {
                let mut some = order[..taken].to_vec();
                some.sort_unstable();
                let gaps: Vec<_> = some.windows(2).map(|w| w[1] - w[0]).collect();
                let (least, most) = (gaps.iter().min().unwrap(), gaps.iter().max().unwrap());
                assert!(most <= &(2 * least), "{n} {taken} {some:?}");
            }
        }
        assert_eq!(even_order(6).collect::<Vec<_>>(), [0, 4, 2, 1, 5, 3]);
    }

    #[test]
    fn an_even_prefix_has_the_first_numbers_of_the_even_order() {
        for n in 0..70_u32 {
            let order: Vec<u32> = even_order(n).collect();
            for taken in 0..=order.len() + 1 {
                let prefix = EvenPrefix::new(n.into(), taken as u64);
                let some: Vec<u32> = (0..n).filter(|&i| prefix.contains(i.into())).collect();
                let mut expected: Vec<u32> = order.iter().copied().take(taken).collect();
                expected.sort_unstable();
                assert_eq!(some, expected, "{taken} of {n}");
            }
        }
    }

    /// Counted one by one, these took hours.
    #[test]
    fn a_prefix_of_very_many_numbers_has_as_many_as_asked() {
        for (n, taken) in [(10_u64.pow(15) + 7, 123_456_789_u64), (1 << 40, 1 << 39), (3, 2), (u64::MAX, u64::MAX / 3)]
        {
            let EvenPrefix { bits, limit } = EvenPrefix::new(n, taken);
            assert_eq!(below(limit, bits, n), taken, "{n}");
        }
    }

    proptest! {
        #[test]
        fn the_order_is_a_permutation_by_step_and_then_even(points in points(80)) {
            let mut keys: Vec<_> = points.into_iter().map(Key::of).collect();
            keys.sort_unstable();
            let detail = canonical_order(&keys, 48);
            let wins = wins(&keys, 48);
            let groups = steps(&keys, &wins);
            let step = |i: u32| Step { win: wins[i as usize], group: groups[i as usize] };
            let mut naive = Vec::new();
            let mut all: Vec<_> = (0..keys.len() as u32).map(step).collect();
            all.sort_unstable();
            all.dedup();
            for s in all {
                let run: Vec<_> = (0..keys.len() as u32).filter(|&i| step(i) == s).collect();
                naive.extend(even_order(run.len() as u32).map(|i| run[i as usize]));
            }
            prop_assert_eq!(&detail.order, &naive);
            for taken in 0..=naive.len() {
                prop_assert_eq!(detail.left_out(taken), naive.get(taken).map(|&i| step(i)));
            }
        }
    }
}

//! The order of detail of a set of points: by step, and evenly within a step.

use super::{Metric, Step, steps, wins};
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
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DetailOrder {
    /// The points, as indices into the key order, coarse to fine.
    pub order: Vec<u32>,
    /// Each step that has points, with the number of points up to its end.
    pub steps: Vec<(Step, u32)>,
}

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
pub fn canonical_order<K: SortKey>(keys: &[K], first: i8) -> DetailOrder {
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

/// The first points of an order of detail.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DetailPrefix {
    /// The points, as indices into the key order, ascending.
    pub points: Vec<u32>,
    /// The step of the first point that is not among them; `None` if all are.
    pub left_out: Option<Step>,
}

impl DetailPrefix {
    /// The bound of these points.
    pub fn bound(&self, metric: &Metric) -> f64 {
        metric.prefix(self.points.len() as u64, self.left_out)
    }
}

/// The first `capacity` points of [`canonical_order`], as a set: one capacity is answered without ordering the rest.
///
/// # Panics
///
/// As [`canonical_order`].
pub fn canonical_prefix<K: SortKey>(keys: &[K], first: i8, capacity: usize) -> DetailPrefix {
    assert!(u32::try_from(keys.len()).is_ok(), "an order of detail has fewer than 2^32 points");
    let wins = wins(keys, first);
    let groups = steps(keys, &wins);
    let numbers = || wins.iter().zip(&groups).map(|(&win, &group)| Step::number(win, group));
    let mut counts = [0_usize; Step::COUNT];
    numbers().for_each(|n| counts[n] += 1);
    // The step that is cut, and how much of it there is room for.
    let mut room = capacity;
    let Some(cut) = (0..Step::COUNT).find(|&n| match room.checked_sub(counts[n]) {
        Some(left) => {
            room = left;
            false
        }
        None => true,
    }) else {
        return DetailPrefix { points: (0..keys.len() as u32).collect(), left_out: None };
    };
    let mut chosen = vec![false; counts[cut]];
    even_order(counts[cut] as u32).take(room).for_each(|i| chosen[i as usize] = true);
    let mut chosen = chosen.into_iter();
    let taken = |n: usize| n < cut || n == cut && chosen.next().unwrap_or(false);
    let taken: Vec<bool> = numbers().map(taken).collect();
    let points = (0..).zip(taken).filter(|(_, taken)| *taken).map(|(i, _)| i).collect();
    DetailPrefix { points, left_out: Some(Step::of_number(cut)) }
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
                let prefix = canonical_prefix(&keys, 48, taken);
                let mut points = naive[..taken].to_vec();
                points.sort_unstable();
                prop_assert_eq!(prefix, DetailPrefix { points, left_out: detail.left_out(taken) });
            }
        }
    }
}

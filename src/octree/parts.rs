//! How a node's own points are cut into parts: a function of the content alone (OCTREE section 7).

use super::Step;

/// The most parts of a node, unless repeated positions need more.
pub const MOST_PARTS: usize = 4;
/// A part has at least this many points unless it is alone.
pub const LEAST_PART_POINTS: u64 = 4096;
/// Repeated positions beyond this many are cut into parts of at most this many.
pub const MOST_REPEATED_POINTS: u64 = 65_536;

/// One part of a node: a run of consecutive steps, or a piece of the repeated positions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PartPlan {
    /// The step of its coarsest points.
    pub first_step: Step,
    /// The last step that is complete once this part and all before it are taken; `None` if none is.
    pub last_step: Option<Step>,
    /// Its points as indices into the node's own, ascending: in key order.
    pub points: Vec<u32>,
}

/// A run of steps, by number, that share a part.
#[derive(Clone, Copy)]
struct Steps {
    first: usize,
    last: usize,
    points: u64,
}

/// Cuts a node's own points, given in key order by their wins and groups, into parts, coarse to fine.
///
/// At most [`MOST_PARTS`], none under [`LEAST_PART_POINTS`] unless it is alone. Only if there are more than
/// [`MOST_REPEATED_POINTS`] repeated positions, these are cut along the key order into as many parts as it takes, beside
/// the others.
///
/// # Panics
///
/// If the lengths differ, or there are 2^32 points or more.
pub fn split(wins: &[i8], groups: &[u8]) -> Vec<PartPlan> {
    split_at_least(wins, groups, LEAST_PART_POINTS)
}

/// The same with another least number of points of a part, so that tests have small nodes of several.
pub(crate) fn split_at_least(wins: &[i8], groups: &[u8], least: u64) -> Vec<PartPlan> {
    assert!(wins.len() == groups.len() && u32::try_from(wins.len()).is_ok(), "wins and groups of a node must match");
    // Step numbers fit a byte.
    let numbers: Vec<u8> = wins.iter().zip(groups).map(|(&win, &group)| Step::number(win, group) as u8).collect();
    let mut counts = [0_u64; Step::COUNT];
    for &number in &numbers {
        counts[usize::from(number)] += 1;
    }
    let mut steps: Vec<Steps> =
        (0..Step::COUNT).filter(|&n| counts[n] > 0).map(|n| Steps { first: n, last: n, points: counts[n] }).collect();
    let repeated = steps.pop_if(|s| is_repeated(s.last) && s.points > MOST_REPEATED_POINTS);
    let mut runs = joined(steps, least);
    let mut parts = Vec::new();
    let mut pieces = Vec::new();
    if let Some(repeated) = repeated {
        // Steps too small for a part of their own go with the first piece.
        let small = runs.pop_if(|s| s.points < least);
        let before = small.map_or(0, |s| s.points);
        let total = before + repeated.points;
        let count = total.div_ceil(MOST_REPEATED_POINTS);
        pieces = (1..=count).map(|i| total * i / count - before).collect();
        parts.extend(runs.iter().map(plan));
        let complete = small.or(runs.last().copied()).map(|s| Step::of_number(s.last));
        let mut piece = Steps { first: small.unwrap_or(repeated).first, last: repeated.last, points: 0 };
        for i in 0..count {
            piece.points = total * (i + 1) / count - total * i / count;
            let last_step = if i + 1 == count { Some(Step::of_number(repeated.last)) } else { complete };
            parts.push(PartPlan { last_step, ..plan(&piece) });
            piece.first = repeated.first;
        }
        runs.extend(small);
    } else {
        parts.extend(runs.iter().map(plan));
    }
    if parts.len() == 1 {
        // Fewer than 2^32, as asserted.
        parts[0].points.extend(0..wins.len() as u32);
        return parts;
    }
    let mut part_of = [0_usize; Step::COUNT];
    for (part, run) in runs.iter().enumerate() {
        part_of[run.first..=run.last].fill(part);
    }
    // Where the next repeated position goes: its piece, and how many more the piece takes.
    let mut piece = parts.len() - pieces.len();
    let mut seen = 0;
    for (i, &number) in numbers.iter().enumerate() {
        let number = usize::from(number);
        let part = if is_repeated(number) && !pieces.is_empty() {
            if seen == pieces[piece + pieces.len() - parts.len()] {
                piece += 1;
            }
            seen += 1;
            piece
        } else {
            part_of[number]
        };
        // Fewer than 2^32, as asserted.
        parts[part].points.push(i as u32);
    }
    parts
}

const _: () = assert!(Step::COUNT <= 256);

/// Is it the step of the repeated positions?
fn is_repeated(number: usize) -> bool {
    Step::of_number(number).win < 0
}

/// The part of a run, still without its points.
fn plan(run: &Steps) -> PartPlan {
    PartPlan {
        first_step: Step::of_number(run.first),
        last_step: Some(Step::of_number(run.last)),
        points: Vec::with_capacity(run.points as usize),
    }
}

/// Joins small steps to the next, what is small at the end to the one before, then the smallest neighbours.
fn joined(steps: Vec<Steps>, least: u64) -> Vec<Steps> {
    let mut runs: Vec<Steps> = Vec::new();
    for step in steps {
        match runs.last_mut() {
            Some(run) if run.points < least => run.extend(step),
            _ => runs.push(step),
        }
    }
    if runs.len() > 1
        && let Some(small) = runs.pop_if(|run| run.points < least)
        && let Some(run) = runs.last_mut()
    {
        run.extend(small);
    }
    while runs.len() > MOST_PARTS {
        // The first of equal sums, so that the cut is a function of the counts.
        let Some(i) = (1..runs.len()).min_by_key(|&i| runs[i - 1].points + runs[i].points) else { break };
        let next = runs.remove(i);
        runs[i - 1].extend(next);
    }
    runs
}

impl Steps {
    fn extend(&mut self, next: Self) {
        self.last = next.last;
        self.points += next.points;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Wins and groups of a node with these counts per step, mixed in some fixed order.
    fn mixed(counts: &[(i8, u8, u32)]) -> (Vec<i8>, Vec<u8>) {
        let mut points: Vec<(u64, i8, u8)> = Vec::new();
        for &(win, group, n) in counts {
            for i in 0..u64::from(n) {
                let mix = (i + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (win as u64) << 40 ^ u64::from(group) << 20;
                points.push((mix, win, group));
            }
        }
        points.sort_unstable();
        points.into_iter().map(|(_, w, g)| (w, g)).unzip()
    }

    fn check(wins: &[i8], groups: &[u8]) {
        let parts = split(wins, groups);
        let steps = |part: &PartPlan| -> Vec<Step> {
            part.points.iter().map(|&i| Step { win: wins[i as usize], group: groups[i as usize] }).collect()
        };
        let mut all: Vec<u32> = parts.iter().flat_map(|p| p.points.clone()).collect();
        all.sort_unstable();
        assert_eq!(all, (0..wins.len() as u32).collect::<Vec<_>>(), "every point is in one part");
        let repeated = wins.iter().filter(|&&w| w < 0).count() as u64;
        let enormous = repeated > MOST_REPEATED_POINTS;
        assert!(enormous || parts.len() <= MOST_PARTS);
        for (i, part) in parts.iter().enumerate() {
            assert!(part.points.is_sorted_by(|a, b| a < b));
            assert!(parts.len() == 1 || part.points.len() as u64 >= LEAST_PART_POINTS);
            let steps = steps(part);
            assert_eq!(steps.iter().min(), Some(&part.first_step));
            if steps.iter().any(|s| s.win < 0) && enormous {
                assert!(part.points.len() as u64 <= MOST_REPEATED_POINTS);
            }
            let taken: Vec<Step> = parts[..=i].iter().flat_map(steps_of(wins, groups)).collect();
            let later: Vec<Step> = parts[i + 1..].iter().flat_map(steps_of(wins, groups)).collect();
            assert!(taken.iter().max() <= later.iter().min() || later.is_empty(), "parts are coarse to fine");
            let complete = taken.iter().filter(|s| !later.contains(s)).max();
            assert_eq!(complete, part.last_step.as_ref());
        }
    }

    fn steps_of<'a>(wins: &'a [i8], groups: &'a [u8]) -> impl Fn(&PartPlan) -> Vec<Step> + 'a {
        |part| {
            let mut steps: Vec<_> =
                part.points.iter().map(|&i| Step { win: wins[i as usize], group: groups[i as usize] }).collect();
            steps.sort_unstable();
            steps.dedup();
            steps
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]
        #[test]
        fn parts_are_few_large_and_in_the_order_of_detail(
            counts in prop::collection::vec((-1_i8..=48, 1_u8..=3, prop_oneof![0_u32..20, 0_u32..6000, 0_u32..30_000]), 0..9)
        ) {
            let counts: Vec<_> = counts.into_iter().map(|(w, g, n)| (w, if w < 0 { 1 } else { g }, n)).collect();
            let (wins, groups) = mixed(&counts);
            check(&wins, &groups);
        }
    }

    #[test]
    fn an_inner_node_has_a_part_for_each_group() {
        let (wins, groups) = mixed(&[(3, 1, 4096), (3, 2, 9000), (3, 3, 5000)]);
        check(&wins, &groups);
        let sizes: Vec<_> = split(&wins, &groups).iter().map(|p| p.points.len()).collect();
        assert_eq!(sizes, [4096, 9000, 5000]);
        let (wins, groups) = mixed(&[(3, 1, 4095), (3, 2, 9000), (3, 3, 4095)]);
        assert_eq!(split(&wins, &groups).len(), 1);
        assert_eq!(split(&[], &[]), []);
    }

    #[test]
    fn enormous_repeated_positions_are_cut_into_as_many_parts_as_it_takes() {
        for before in [0, 1, 4095, 4096, 20_000] {
            for repeated in [65_536, 65_537, 131_072, 140_000] {
                let (wins, groups) = mixed(&[(5, 1, before), (4, 2, before), (-1, 1, repeated)]);
                check(&wins, &groups);
            }
        }
    }
}

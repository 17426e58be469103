//! The order in which a thinned answer is handed on: coarse to fine, in rounds.
//!
//! A round has the points that a level adds to the one before, so that who stops early has a complete level and the
//! beginning of the next. Each round reads its level anew. That costs a share of what the last one costs as long as levels
//! grow, and so a level that adds little is given together with the next.

use crate::octree::Step;

/// No round is made for fewer points than a block has: they are the first one's.
const FIRST_ROUND_POINTS: u64 = if cfg!(test) { 3 } else { 4096 };

/// A round: the points of a level that are not in the level of the round before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Round {
    /// Exponent of the level's cells; `None`: all points.
    pub cell: Option<u8>,
    /// That of the round before.
    pub before: Option<u8>,
}

impl Round {
    /// A single one.
    pub fn only(cell: Option<u8>) -> Self {
        Self { cell, before: None }
    }

    /// The first step, as an ordinal, that the rounds before do not have.
    pub fn first_step(self) -> u8 {
        self.before.map_or(0, |c| Step { win: c as i8 - 1, group: 1 }.ordinal())
    }
}

/// How levels are made rounds.
#[derive(Clone, Copy)]
pub(crate) struct Pace {
    /// Exponent of the coarsest level.
    pub root: u8,
    /// By how much the exponent changes at most. Up to the `g` of the nodes a piece lies in one cell of the round before, which
    /// has its first point, and of the others in it the piece itself tells what they win.
    pub reach: u8,
    /// How many times as many points as before there are after a round, at least, unless the exponent would change by more.
    pub growth: u64,
}

/// The rounds in which the points of a level are given, coarse to fine. `points` says how many points the level of an
/// exponent has, about.
pub(crate) fn rounds(finest: Option<u8>, pace: Pace, points: impl Fn(Option<u8>) -> u64) -> Vec<Round> {
    let Pace { root, reach, growth } = pace;
    let mut cells = vec![finest];
    let mut here = finest;
    loop {
        let there = points(here);
        if there <= FIRST_ROUND_POINTS {
            break;
        }
        // Repeated positions are no level's.
        let (nearest, furthest) = here.map_or((0, 0), |c| (c.saturating_add(1), c.saturating_add(reach.max(1))));
        let is_small = |c: &u8| points(Some(*c)).saturating_mul(growth) <= there;
        let coarser = (nearest..=furthest).find(is_small).unwrap_or(furthest);
        if coarser > root {
            break;
        }
        here = Some(coarser);
        cells.push(here);
    }
    cells.reverse();
    let before = std::iter::once(None).chain(cells.iter().copied());
    before.zip(&cells).map(|(before, &cell)| Round { cell, before }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pace(root: u8, reach: u8) -> Pace {
        Pace { root, reach, growth: 3 }
    }

    fn cells(rounds: &[Round]) -> Vec<Option<u8>> {
        rounds.iter().map(|r| r.cell).collect()
    }

    #[test]
    fn every_level_of_a_surface_is_a_round() {
        let points = |c: Option<u8>| 100_000_000 >> (2 * c.unwrap_or(0));
        let found = rounds(Some(2), pace(20, 7), points);
        assert_eq!(cells(&found[found.len() - 3..]), [Some(4), Some(3), Some(2)]);
        assert!(found.windows(2).all(|w| w[0].cell == w[1].cell.map(|c| c + 1)));
        assert!(points(found[0].cell) <= FIRST_ROUND_POINTS && points(found[1].cell) > FIRST_ROUND_POINTS);
        assert_eq!(found[0].first_step(), 0);
        for pair in found.windows(2) {
            let last = Step { win: pair[0].cell.unwrap() as i8, group: 3 };
            assert_eq!(pair[1].first_step(), last.ordinal() + 1);
        }
    }

    #[test]
    fn levels_that_add_little_are_given_with_the_next() {
        // As many at 3 as at 0, and a tenth at 4.
        let points = |c: Option<u8>| if c.unwrap_or(0) < 4 { 1000 } else { 100 >> c.unwrap_or(0) };
        assert_eq!(cells(&rounds(Some(0), pace(10, 7), points))[1..], [Some(4), Some(0)]);
        // But no further apart than a node's cells from its own size.
        assert_eq!(cells(&rounds(Some(0), pace(10, 2), points))[1..], [Some(4), Some(2), Some(0)]);
    }

    #[test]
    fn repeated_positions_come_after_all_levels() {
        let points = |c: Option<u8>| c.map_or(1000, |_| 900);
        assert_eq!(cells(&rounds(None, pace(3, 2), points)), [Some(2), Some(0), None]);
        assert_eq!(rounds(None, pace(3, 2), |_| 0), [Round::only(None)]);
    }
}

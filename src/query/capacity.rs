//! Answers under a capacity: the first points of one fixed sequence, whatever the capacity (laws 4 and 5).
//!
//! The sequence is the canonical order of detail of the *matching* points: coarse cells before fine ones, within a cell's
//! size by group of ranks, within a group evenly; repeated positions last. Every level of cells is a prefix of it, so a
//! level with enough points is enough to look at.
//!
//! It is looked at twice, piece by piece. The first time the points of each step are counted, which says at which step the
//! capacity is used up, and which of that step's points are the last to be taken. The second time they are handed on, in
//! rounds, coarse to fine. So never more of them are held than a few pieces have, but for where the first million of
//! filtered ones are: those are not looked for again.

use super::QueryError;
use super::answer::Meter;
use super::looked::{Cut, Known, Looked, Place, Places};
use super::pieces::Pieces;
use super::plan::Plan;
use super::rounds::{Pace, Round, rounds};
use super::task::{PieceTask, Task, by_part};
use super::thin::Thinned;
use crate::octree::Step;
use crate::store::NodeIx;
use std::collections::HashMap;
use std::sync::Arc;

/// The first points of the sequence: which they are, and how good.
#[derive(Default)]
pub(crate) struct Sequence {
    /// How many there are, if that is known.
    pub points: Option<u64>,
    pub error_bound: Option<f64>,
    /// Are they all that match?
    pub is_everything: bool,
    /// Those that are remembered, with their steps; by step, then by place.
    held: Vec<(u8, Place)>,
    held_rounds: Vec<Round>,
    /// The others.
    rounds: Vec<Round>,
    cut: Option<Arc<Cut>>,
    places: Option<Arc<Places>>,
}

/// Which points of a piece are taken.
pub(crate) struct Kept {
    /// The step at which the round begins.
    first_step: u8,
    /// Where the sequence ends.
    cut: Option<Arc<Cut>>,
    /// What is known of the piece, or of the first cube in it.
    known: Option<Known>,
}

impl Kept {
    /// Are the points' steps asked for?
    pub fn needs_steps(&self) -> bool {
        self.first_step > 0 || self.cut.is_some()
    }

    /// Of each of the points, in key order, whether it is taken.
    pub fn of(&self, thinned: &Thinned) -> Vec<bool> {
        if !self.needs_steps() {
            return vec![true; thinned.order.len()];
        }
        // What the piece's first point wins is coarser than the piece tells. Where it is not known that is of no matter: it
        // was taken in a round before.
        let first = self.known.map(|known| known.first);
        let mut number = self.known.map_or(0, |known| known.before);
        let take = |step: u8| {
            let taken = step >= self.first_step && self.cut.as_ref().is_none_or(|cut| cut.takes(step, || number));
            number += u64::from(self.cut.as_ref().is_some_and(|cut| cut.step == step));
            taken
        };
        first.into_iter().chain(thinned.steps.iter().copied().skip(first.iter().count())).map(take).collect()
    }
}

/// A surface has four times as many points at every level, or a little fewer.
const GROWTH: u64 = 3;

/// Points that are remembered are read part by part in each round, so fewer rounds are quicker.
const HELD_GROWTH: u64 = 8;

fn pace(plan: &Plan) -> Pace {
    Pace { root: plan.root().map_or(0, |r| r.k()), reach: plan.g, growth: GROWTH }
}

/// All points of a level; if their order is of no matter, in one round.
pub(crate) fn level(plan: &Plan, c: u8, in_order: bool) -> Result<Sequence, QueryError> {
    let cell = Some(c);
    let bound = plan.metric().step_bound(c as i8, 7);
    if in_order && !plan.is_unfiltered() {
        let looked = Looked::at(plan, cell, true)?;
        return Ok(Sequence::of(plan, cell, looked, None, bound));
    }
    let rounds = if in_order {
        let most = plan.most_points(cell)?;
        rounds(cell, pace(plan), |c| most.about(c.unwrap_or(0)))
    } else {
        vec![Round::only(cell)]
    };
    Ok(Sequence { points: None, error_bound: Some(bound), rounds, ..Sequence::default() })
}

/// The first `capacity` points of the sequence, going no finer than cells of exponent `finest`; `None`: to the end.
pub(crate) fn limited(plan: &Plan, finest: Option<u8>, capacity: u64) -> Result<Sequence, QueryError> {
    let most = plan.most_points(None)?;
    if most.all == 0 || capacity == 0 {
        let error_bound = (most.all == 0).then_some(0.0);
        return Ok(Sequence { points: Some(0), error_bound, ..Sequence::default() });
    }
    // More than enough, so that the first point that is left out is known: it says how good the answer is. Coarser levels
    // cannot have so many.
    let coarsest = plan.root().map_or(0, |r| r.k());
    let start = (finest.unwrap_or(0)..=coarsest).rev().find(|&c| most.at_level(c) > capacity);
    let mut cell = start.or(finest);
    loop {
        let looked = Looked::at(plan, cell, !plan.is_unfiltered())?;
        let points = looked.points();
        match cell {
            Some(c) if points <= capacity && cell != finest => cell = finer(c, points, capacity, finest),
            _ => {
                let complete = cell.map_or(0.0, |c| plan.metric_within().step_bound(c as i8, 7));
                // A filter may have left nothing at all.
                let bound = if points == 0 { 0.0 } else { complete };
                return Ok(Sequence::of(plan, cell, looked, Some(capacity), bound));
            }
        }
    }
}

/// The cell to try after one with too few points: on surfaces each level has four times the points of the one before.
fn finer(c: u8, points: u64, capacity: u64, finest: Option<u8>) -> Option<u8> {
    let missing = capacity / points.max(1);
    let levels = 1 + (missing.max(1).ilog2() / 2).min(40) as u8;
    match (c.checked_sub(levels), finest) {
        (Some(next), finest) => Some(next.max(finest.unwrap_or(0))),
        (None, Some(finest)) => Some(finest),
        (None, None) if c > 0 => Some(0),
        (None, None) => None,
    }
}

impl Sequence {
    /// The first `capacity` of the points that were looked at; `complete` is the bound of all of them.
    fn of(plan: &Plan, cell: Option<u8>, looked: Looked, capacity: Option<u64>, complete: f64) -> Self {
        let total = looked.points();
        let cut = capacity.and_then(|capacity| looked.cut(capacity));
        let points = capacity.map_or(total, |capacity| total.min(capacity));
        let bound = match &cut {
            Some(cut) => plan.metric_within().prefix(points, Some(Step::of_ordinal(cut.step))),
            None => complete,
        };
        let last = match &cut {
            Some(cut) => u8::try_from(Step::of_ordinal(cut.step).win).ok(),
            None => cell,
        };
        let (held_rounds, rounds) = if plan.is_unfiltered() {
            (Vec::new(), rounds(last, pace(plan), |c| looked.at_level(c)))
        } else {
            // Where few points match, coarse levels take as long to find as fine ones: those are remembered instead.
            let before = looked.held_level();
            let all_are_held = before <= last;
            let pace = Pace { reach: u8::MAX, growth: HELD_GROWTH, ..pace(plan) };
            let held = rounds(if all_are_held { last } else { before }, pace, |c| looked.at_level(c));
            (held, if all_are_held { Vec::new() } else { vec![Round { cell, before }] })
        };
        let (places, held) = looked.places(cut.as_ref());
        Self {
            points: Some(points),
            error_bound: Some(bound),
            is_everything: cut.is_none() && cell.is_none(),
            held,
            held_rounds,
            rounds,
            cut: cut.map(Arc::new),
            places: Some(Arc::new(places)),
        }
    }

    /// Those that are remembered: round by round, each by part.
    pub fn held(&mut self, plan: &Plan) -> Result<Vec<Task>, QueryError> {
        let mut held = std::mem::take(&mut self.held);
        let mut tasks = Vec::new();
        let mut nodes = 0;
        for i in 0..self.held_rounds.len() {
            let ends = self.held_rounds.get(i + 1).map_or(u8::MAX, |next| next.first_step());
            let rest = held.split_off(held.partition_point(|(step, _)| *step < ends));
            let mut places: Vec<Place> =
                std::mem::replace(&mut held, rest).into_iter().map(|(_, place)| place).collect();
            places.sort_unstable();
            nodes += places.chunk_by(|a, b| a.0 == b.0).count() as u64;
            tasks.extend(by_part(plan, &places)?);
        }
        Meter::add(&plan.meter.nodes, nodes);
        Ok(tasks)
    }

    /// The pieces of its rounds.
    pub fn tasks(self, plan: Arc<Plan>) -> impl Iterator<Item = Result<PieceTask, QueryError>> + Send {
        let Self { rounds, cut, places, .. } = self;
        let is_one_layer = plan.roots.len() <= 1;
        rounds.into_iter().flat_map(move |round| {
            let (plan, cut, places) = (plan.clone(), cut.clone(), places.clone());
            let mut pieces = Pieces::new(&plan, round.cell);
            std::iter::from_fn(move || {
                loop {
                    let piece = match pieces.next(&plan) {
                        Ok(piece) => piece?,
                        Err(error) => return Some(Err(error)),
                    };
                    // In one layer a node's points win its cells, and those above the piece were given before.
                    let all_above_are_coarse =
                        round.before.is_some_and(|c| u16::from(c) + u16::from(plan.g) <= u16::from(piece.cube.k()) + 1);
                    if is_one_layer && all_above_are_coarse && piece.trees.iter().all(|tree| tree.node.is_none()) {
                        continue;
                    }
                    let known = places.as_ref().map(|places| places.of(piece.cube));
                    // Nothing in it matches.
                    if known.is_some_and(|known| known.is_none()) {
                        continue;
                    }
                    let kept = Kept { first_step: round.first_step(), cut: cut.clone(), known: known.flatten() };
                    let points = piece.points(&plan);
                    return Some(Ok(PieceTask { piece, points, cell: round.cell, kept }));
                }
            })
        })
    }

    /// How many points each node has of them.
    pub fn by_node(mut self, plan: &Arc<Plan>) -> Result<HashMap<NodeIx, u64>, QueryError> {
        let mut counts: HashMap<NodeIx, u64> = HashMap::new();
        std::mem::take(&mut self.held).iter().for_each(|(_, place)| *counts.entry(place.0).or_default() += 1);
        let mut tasks = self.tasks(plan.clone());
        loop {
            let window: Vec<PieceTask> = tasks.by_ref().take(plan.window()).collect::<Result<_, _>>()?;
            if window.is_empty() {
                counts.retain(|_, n| *n > 0);
                return Ok(counts);
            }
            for (node, n) in plan.each(window, |task| task.count(plan))?.into_iter().flatten() {
                *counts.entry(node).or_default() += n;
            }
        }
    }
}

//! Answers under a capacity: the first points of one fixed sequence, whatever the capacity (DESIGN, laws 4 and 5).
//!
//! The sequence is the canonical order of detail of the *matching* points: coarse cells before fine ones, within a cell's
//! size by group of ranks, within a group evenly; repeated positions last. Every level of cells is a prefix of it, so a
//! level with enough points is enough to look at.
//!
//! It is looked at twice, piece by piece. The first time the points of each step are counted, which says at which step the
//! capacity is used up, and which of that step's points are the last to be taken. The second time they are handed on. So
//! never more of them are held than a few pieces have, but for those of the few large nodes above the pieces: a point is
//! settled by its piece, and theirs are known only when all pieces are.

use super::QueryError;
use super::pieces::{Piece, Pieces};
use super::plan::Plan;
use super::task::PieceTask;
use super::thin::{Thinned, thin};
use crate::lattice::{BITS, Cube, Key};
use crate::octree::{EvenPrefix, Step, first_win, steps};
use crate::store::NodeIx;
use std::collections::HashMap;
use std::sync::Arc;

/// The first points of the sequence: which they are, and how good.
pub(crate) struct Sequence {
    /// They are among the points of cells of this exponent; `None`: of all.
    cell: Option<u8>,
    /// How many there are.
    pub points: u64,
    pub error_bound: Option<f64>,
    cut: Option<Arc<Cut>>,
    /// What the pieces that have points need to know of those before them, in key order.
    pieces: Vec<Before>,
    /// Those in large nodes, by part, then by place.
    pub above: Vec<(NodeIx, u32, u32)>,
}

/// Where the sequence is cut off.
struct Cut {
    /// The step in which that is.
    step: u8,
    /// Those of its points that are taken, by their number in key order.
    even: EvenPrefix,
}

impl Cut {
    fn takes(&self, step: u8, number: impl FnOnce() -> u64) -> bool {
        step < self.step || step == self.step && self.even.contains(number())
    }
}

/// What is to be known of all points before a piece.
#[derive(Clone, Copy, Default)]
struct Before {
    /// The step of the piece's first point; `None` for a piece without points.
    first: Option<u8>,
    /// The points of the cut step before the piece.
    points: u64,
}

/// Which points of a piece are taken.
pub(crate) struct Kept {
    cut: Option<Arc<Cut>>,
    before: Before,
}

impl Kept {
    /// Are the points' steps asked for?
    pub fn needs_steps(&self) -> bool {
        self.cut.is_some()
    }

    /// Of each of the points, in key order, whether it is taken.
    pub fn of(&self, thinned: &Thinned) -> Vec<bool> {
        let Some(cut) = &self.cut else { return vec![true; thinned.order.len()] };
        let mut number = self.before.points;
        let steps = self.before.first.into_iter().chain(thinned.steps.iter().copied().skip(1));
        steps
            .map(|step| {
                let taken = cut.takes(step, || number);
                number += u64::from(step == cut.step);
                taken
            })
            .collect()
    }
}

/// What the first look at a piece tells.
struct Facts {
    cube: Cube,
    first: Option<Key>,
    points: u64,
    /// How many points each step has, the first point left out.
    counts: Vec<(u8, u64)>,
    above: Vec<Held>,
}

/// A point of a large node.
struct Held {
    node: NodeIx,
    part: u32,
    index: u32,
    /// `None` for the first point of a piece: what comes before it decides.
    step: Option<u8>,
    /// How many points of its step come before it in its piece, the first left out.
    number: u32,
}

fn look(plan: &Plan, piece: &Piece, cell: Option<u8>) -> Result<Facts, QueryError> {
    let thinned = thin(plan, piece, cell, true)?;
    let mut counts = [0_u32; Step::COUNT];
    let mut above = Vec::new();
    for (i, (&at, &step)) in thinned.order.iter().zip(&thinned.steps).enumerate() {
        let count = &mut counts[usize::from(step)];
        if let Some(pick) = thinned.above(at) {
            let step = (i > 0).then_some(step);
            above.push(Held { node: pick.node, part: pick.part, index: pick.index, step, number: *count });
        }
        *count += u32::from(i > 0);
    }
    let counts = (0..).zip(counts).filter(|(_, n)| *n > 0).map(|(step, n)| (step, u64::from(n))).collect();
    Ok(Facts { cube: piece.cube, first: thinned.first, points: thinned.order.len() as u64, counts, above })
}

fn look_at_all(plan: &Plan, cell: Option<u8>) -> Result<Vec<Facts>, QueryError> {
    let mut pieces = Pieces::new(plan, cell);
    let mut facts = Vec::new();
    loop {
        let mut window = Vec::new();
        while window.len() < plan.window()
            && let Some(piece) = pieces.next(plan)?
        {
            window.push(piece);
        }
        if window.is_empty() {
            return Ok(facts);
        }
        facts.extend(plan.each(window, |piece| look(plan, &piece, cell))?);
    }
}

/// All points of a level.
pub(crate) fn level(plan: &Plan, c: u8) -> Result<Sequence, QueryError> {
    let facts = look_at_all(plan, Some(c))?;
    let bound = plan.metric().step_bound(c as i8, 7);
    Ok(Sequence::of(plan, Some(c), facts, u64::MAX, bound))
}

/// The first `capacity` points of the sequence, going no finer than cells of exponent `finest`; `None`: to the end.
pub(crate) fn limited(plan: &Plan, finest: Option<u8>, capacity: u64) -> Result<Sequence, QueryError> {
    let nothing = |cell| Sequence::of(plan, cell, Vec::new(), capacity, 0.0);
    let most = plan.most_points()?;
    if most.all == 0 {
        return Ok(nothing(finest));
    }
    if capacity == 0 {
        return Ok(Sequence { error_bound: None, ..nothing(finest) });
    }
    let coarsest = plan.root().map_or(0, |r| r.k());
    // More than enough, so that the first point that is left out is known: it says how good the answer is. Coarser levels
    // cannot have so many.
    let start = (finest.unwrap_or(0)..=coarsest).rev().find(|&c| most.by_cell[usize::from(c)] > capacity);
    let mut cell = start.or(finest);
    loop {
        let facts = look_at_all(plan, cell)?;
        let points: u64 = facts.iter().map(|f| f.points).sum();
        match cell {
            Some(c) if points <= capacity && cell != finest => cell = finer(c, points, capacity, finest),
            _ => {
                let complete = cell.map_or(0.0, |c| plan.metric().step_bound(c as i8, 7));
                // A filter may have left nothing at all.
                let bound = if points == 0 { 0.0 } else { complete };
                return Ok(Sequence::of(plan, cell, facts, capacity, bound));
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
    fn of(plan: &Plan, cell: Option<u8>, facts: Vec<Facts>, capacity: u64, complete: f64) -> Self {
        // The first points of the pieces, as a sequence of their own: of points that win a cell larger than their piece
        // there are no others.
        let mut firsts: Vec<(Key, i8)> = Vec::new();
        let mut previous = None;
        for Facts { cube, first, .. } in &facts {
            let Some(key) = first else { continue };
            // Any cube that holds all points gives the same sequence: the first point is first.
            let win = previous.map_or(BITS as i8, |p| first_win(Some(p), *cube, *cube));
            firsts.push((*key, win));
            previous = Some(*cube);
        }
        let (keys, wins): (Vec<Key>, Vec<i8>) = firsts.into_iter().unzip();
        let mut groups = steps(&keys, &wins).into_iter().zip(wins).map(|(group, win)| Step { win, group }.ordinal());
        let mut pieces: Vec<Before> =
            facts.iter().map(|f| Before { first: f.first.and_then(|_| groups.next()), points: 0 }).collect();
        let of_piece = |facts: &Facts, before: &Before, step: u8| {
            let rest = facts.counts.binary_search_by_key(&step, |c| c.0).map_or(0, |i| facts.counts[i].1);
            rest + u64::from(before.first == Some(step))
        };
        let mut room = capacity;
        let total: u64 = facts.iter().map(|f| f.points).sum();
        let mut cut = None;
        if total > capacity {
            for step in 0..Step::COUNT as u8 {
                let points: u64 = facts.iter().zip(&pieces).map(|(f, b)| of_piece(f, b, step)).sum();
                match room.checked_sub(points) {
                    Some(left) => room = left,
                    None => {
                        cut = Some(Arc::new(Cut { step, even: EvenPrefix::new(points, room) }));
                        break;
                    }
                }
            }
        }
        let mut above = Vec::new();
        let mut number = 0;
        for (facts, before) in facts.iter().zip(&mut pieces) {
            before.points = number;
            let own_first = |step: u8| u64::from(before.first == Some(step));
            let taken = |held: &&Held| {
                let Some(cut) = &cut else { return true };
                match held.step.map(Ok).or(before.first.map(Err)) {
                    Some(Ok(step)) => cut.takes(step, || number + own_first(step) + u64::from(held.number)),
                    Some(Err(first)) => cut.takes(first, || number),
                    None => false,
                }
            };
            above.extend(facts.above.iter().filter(taken).map(|h| (h.node, h.part, h.index)));
            number += cut.as_ref().map_or(0, |cut| of_piece(facts, before, cut.step));
        }
        above.sort_unstable();
        let bound =
            cut.as_ref().map_or(complete, |cut| plan.metric().prefix(capacity, Some(Step::of_ordinal(cut.step))));
        Self { cell, points: total.min(capacity), error_bound: Some(bound), cut, pieces, above }
    }

    /// The pieces of those that are not in large nodes.
    pub fn tasks(self, plan: Arc<Plan>) -> impl Iterator<Item = Result<PieceTask, QueryError>> + Send {
        let Self { cell, cut, pieces: before, .. } = self;
        let mut before = before.into_iter();
        let mut pieces = Pieces::new(&plan, cell);
        std::iter::from_fn(move || {
            loop {
                let before = before.next()?;
                let piece = match pieces.next(&plan) {
                    Ok(piece) => piece?,
                    Err(error) => return Some(Err(error)),
                };
                let is_own = piece.trees.iter().any(|tree| tree.node.is_some());
                if is_own && before.first.is_some() {
                    let kept = Kept { cut: cut.clone(), before };
                    let points = piece.points(&plan);
                    return Some(Ok(PieceTask { piece, points, cell, kept: Some(kept) }));
                }
            }
        })
    }

    /// How many points each node has of them.
    pub fn by_node(mut self, plan: &Arc<Plan>) -> Result<HashMap<NodeIx, u64>, QueryError> {
        let mut counts: HashMap<NodeIx, u64> = HashMap::new();
        std::mem::take(&mut self.above).iter().for_each(|(node, ..)| *counts.entry(*node).or_default() += 1);
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

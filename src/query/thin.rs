//! A level of a tree, subtree by subtree: the same points as [`cells::filtered`](super::cells), but never more of them in
//! memory than a few subtrees have.
//!
//! From the root down, nodes are read whole as long as much lies below them. In a node at or above the level every matching
//! point is the least of its cell, but for leaves, where several may share one. So what a large node gives is final, and
//! what lies below needs to know only which cells are taken, and which have a first point that does not match.

use super::QueryError;
use super::cells::{Above, Pick, level_below, read_above};
use super::plan::{Plan, Prospect, Scope};
use super::run::{Task, by_part, work};
use crate::lattice::{Cube, Key};
use crate::points::Batch;
use crate::store::Node;
use std::sync::Arc;

/// A subtree with at most as many points as so many full leaves is a task of its own.
const UNIT_LEAVES: u64 = 5;

fn unit_points(plan: &Plan) -> u64 {
    UNIT_LEAVES * u64::from(plan.snapshot.site().leaf_capacity)
}

/// A subtree, and what the nodes above it know of its cube.
pub(crate) struct Unit {
    node: Node,
    c: u8,
    known: Arc<Known>,
    points: u64,
}

/// Ascending.
#[derive(Default)]
struct Known {
    /// The matching points of the nodes above.
    picks: Vec<Pick>,
    /// The cells with a point above that does not match.
    missed: Vec<Key>,
}

impl Known {
    fn inside(&self, cube: Cube, c: u8) -> Self {
        let (first, last) = (cube.first_key(), cube.last_key());
        let picks = self.picks.partition_point(|p| p.key < first)..self.picks.partition_point(|p| p.key <= last);
        // A cell may be larger than the cube.
        let floor = first.floor(c);
        let missed = self.missed.partition_point(|m| *m < floor)..self.missed.partition_point(|m| *m <= last);
        Self { picks: self.picks[picks].to_vec(), missed: self.missed[missed].to_vec() }
    }
}

impl Unit {
    /// The points that are read for it, or that it can give.
    pub fn points(&self) -> u64 {
        self.points
    }
}

/// The tasks of a level, in pre-order.
pub(crate) struct Units {
    plan: Arc<Plan>,
    c: u8,
    /// Subtrees that are still to come, the next one last.
    open: Vec<(Node, Arc<Known>)>,
    /// Tasks that are ready, the next one last.
    ready: Vec<Task>,
}

impl Units {
    pub fn new(plan: Arc<Plan>, root: Node, c: u8) -> Self {
        Self { plan, c, open: vec![(root, Arc::default())], ready: Vec::new() }
    }

    /// Takes the next subtree apart; false if there is none.
    fn advance(&mut self) -> Result<bool, QueryError> {
        let Some((node, known)) = self.open.pop() else { return Ok(false) };
        let (plan, c) = (&self.plan, self.c);
        plan.cancel.check()?;
        if plan.prospect(&node, Scope::Subtree)? == Prospect::Nothing {
            return Ok(true);
        }
        let lowest = i16::from(node.cube.k()) <= i16::from(c) + i16::from(plan.g);
        if lowest || node.leaf || node.subtree_points <= unit_points(plan) {
            let points = node.subtree_points.min(unit_points(plan));
            self.ready.push(Task::Unit(Unit { node, c, known, points }));
            return Ok(true);
        }
        let root = plan.root().unwrap_or(node.cube);
        let Above { picks, missed } = read_above(plan, &node, root, c)?;
        let mut all = Known { picks: known.picks.clone(), missed: known.missed.clone() };
        all.picks.extend_from_slice(&picks);
        all.picks.sort_unstable();
        all.missed.extend(missed);
        all.missed.sort_unstable();
        all.missed.dedup();
        let children: Vec<Node> = plan.nodes.children(&node)?.collect();
        self.open.extend(children.into_iter().rev().map(|child| {
            let known = all.inside(child.cube, c);
            (child, Arc::new(known))
        }));
        let mut picks = picks;
        picks.sort_unstable_by_key(|p| (p.node, p.part, p.index));
        self.ready.extend(by_part(plan, &picks)?.into_iter().rev());
        Ok(true)
    }
}

impl Iterator for Units {
    type Item = Result<Task, QueryError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(task) = self.ready.pop() {
                return Some(Ok(task));
            }
            match self.advance() {
                Ok(true) => {}
                Ok(false) => return None,
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

/// The points of a unit, in the order of nodes, parts and places.
pub(crate) fn picks(plan: &Plan, unit: &Unit) -> Result<Vec<Pick>, QueryError> {
    let Unit { node, c, known, .. } = unit;
    let mut picks =
        level_below(plan, node, plan.root().unwrap_or(node.cube), *c, known.picks.clone(), known.missed.clone())?;
    // Those from above have been given already.
    let own = node.subtree();
    picks.retain(|pick| own.contains(&pick.node));
    picks.sort_unstable_by_key(|p| (p.node, p.part, p.index));
    Ok(picks)
}

/// The same as a batch.
pub(crate) fn batch(plan: &Plan, unit: &Unit) -> Result<Batch, QueryError> {
    let picks = picks(plan, unit)?;
    let mut all = Batch::empty(plan.attributes.clone());
    for task in by_part(plan, &picks)? {
        let batch = work(plan, task)?;
        if all.is_empty() {
            all = batch;
        } else {
            all.append(&batch);
        }
    }
    Ok(all)
}

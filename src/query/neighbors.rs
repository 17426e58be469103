//! The search for the neighbours of one place.
//!
//! Distances are in f64 between world coordinates, `(dx * dx + dy * dy) + dz * dz`. What lies beyond the last neighbour that
//! was found is told in lattice steps, a little wider than it need be, so that of nodes, blocks and runs no coordinates are
//! made; the order in which these are looked at is by rounded distances and decides nothing but the time.

use super::QueryError;
use super::answer::Meter;
use super::cells::Pick;
use super::near::{Near, NearBlock, RUN};
use super::plan::{Plan, Prospect, Scope};
use super::ties;
use crate::geometry::Containment;
use crate::lattice::{BIAS, Decimal, Key, LatticeBox, LatticePoint};
use crate::store::Node;
use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

/// A neighbour; the order is by distance, then by position (the order of the points' keys), then by place in the store, which
/// is a layer's own order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Candidate {
    pub square: f64,
    pub pick: Pick,
}

impl Eq for Candidate {}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        self.square.total_cmp(&other.square).then(self.pick.cmp(&other.pick))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// What is done with a node: its children come before its own points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Step {
    Children,
    Own,
}

/// A node that may hold neighbours.
struct Waiting {
    square: f64,
    step: Step,
    node: Node,
}

impl Waiting {
    /// Near ones first. Of those around the place the small ones, which have the nearest points.
    fn order(&self) -> (Step, u8) {
        (self.step, self.node.cube.k())
    }
}

impl Ord for Waiting {
    fn cmp(&self, other: &Self) -> Ordering {
        self.square.total_cmp(&other.square).then_with(|| self.order().cmp(&other.order()))
    }
}

impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Waiting {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Waiting {}

/// Indices on each axis outside of which a point is farther away than the last neighbour; both ends inside.
#[derive(Clone, Copy, Debug)]
struct Window {
    low: [u64; 3],
    high: [u64; 3],
}

impl Window {
    fn meets(&self, bounds: &LatticeBox) -> bool {
        (0..3).all(|axis| bounds.min.0[axis] <= self.high[axis] && bounds.max.0[axis] >= self.low[axis])
    }

    fn contains(&self, at: LatticePoint) -> bool {
        (0..3).all(|axis| (self.low[axis]..=self.high[axis]).contains(&at.0[axis]))
    }
}

/// A place, and what is looked for around it.
pub(super) struct Search<'a> {
    plan: &'a Plan,
    point: [f64; 3],
    k: usize,
    /// The square of the radius.
    farthest: f64,
    quantum: [f64; 3],
    phase: [f64; 3],
    /// The nearest of each layer: which of equally near points of several layers are the first is told by their records.
    found: Vec<BinaryHeap<Candidate>>,
    window: Window,
    /// Boxes that are [about](Self::about) farther than this are outside of the window's sphere: from far away most of the
    /// window's box is, too.
    beyond: f64,
}

/// Puts equally near points of several layers into the canonical order, in the neighbours of some places; `k` of each stay.
pub(super) fn settle(plan: &Plan, found: &mut [Vec<Candidate>], k: usize) -> Result<(), QueryError> {
    if plan.roots.len() < 2 {
        return Ok(());
    }
    let is_one_place = |a: &Candidate, b: &Candidate| a.pick.key == b.pick.key;
    let runs = found.iter().flat_map(|of_place| of_place.chunk_by(is_one_place)).filter(|run| run.len() > 1);
    let mut tied: Vec<Pick> = runs.flatten().map(|candidate| candidate.pick).collect();
    tied.sort_unstable();
    tied.dedup();
    ties::settle(plan, &mut tied)?;
    let mut ranks: Vec<(Pick, usize)> = tied.into_iter().zip(0..).collect();
    ranks.sort_unstable();
    let rank = |c: &Candidate| ranks.binary_search_by_key(&c.pick, |r| r.0).map_or(usize::MAX, |i| ranks[i].1);
    for of_place in found {
        of_place.chunk_by_mut(is_one_place).filter(|run| run.len() > 1).for_each(|run| run.sort_by_cached_key(rank));
        of_place.truncate(k);
        of_place.shrink_to_fit();
    }
    Ok(())
}

impl<'a> Search<'a> {
    pub fn new(plan: &'a Plan, point: [f64; 3], k: usize, farthest: f64) -> Self {
        let (quantum, phase) = (plan.lattice.quantum_f64(), plan.lattice.phase().map(Decimal::to_f64));
        let window = Window { low: [0; 3], high: [u64::MAX; 3] };
        let found = vec![BinaryHeap::new(); plan.roots.len()];
        let beyond = f64::INFINITY;
        let mut search = Self { plan, point, k, farthest, quantum, phase, found, window, beyond };
        search.narrow();
        search
    }

    /// Where the place is, in lattice steps.
    pub fn at(&self) -> LatticePoint {
        LatticePoint(std::array::from_fn(|axis| self.index(axis, self.point[axis])))
    }

    /// Nearest first, up to `k` of each layer; a layer's equally near points in their order.
    pub fn run(mut self, near: &mut Near<'_>) -> Result<Vec<Candidate>, QueryError> {
        let plan = self.plan;
        let mut open: BinaryHeap<Reverse<Waiting>> = BinaryHeap::new();
        let mut visited = 0;
        if self.k > 0 {
            self.wait(plan.roots.iter().cloned(), &mut open);
        }
        while let Some(Reverse(Waiting { square, step, node })) = open.pop() {
            plan.cancel.check()?;
            if square > self.beyond {
                break;
            }
            match step {
                Step::Children => {
                    visited += 1;
                    if !self.reaches(&node.subtree_bounds) || plan.prospect(&node, Scope::Subtree)? == Prospect::Nothing
                    {
                        continue;
                    }
                    self.wait(plan.nodes.children(&node)?, &mut open);
                    if let Some(bounds) = node.own_bounds {
                        open.push(Reverse(Waiting { square: self.about(&bounds), step: Step::Own, node }));
                    }
                }
                Step::Own => {
                    let near_enough = node.own_bounds.is_some_and(|bounds| self.reaches(&bounds));
                    if near_enough && plan.prospect(&node, Scope::Own)? != Prospect::Nothing {
                        for part in 0..node.parts.len() {
                            plan.cancel.check()?;
                            self.offer_part(&node, part, near)?;
                        }
                    }
                }
            }
        }
        Meter::add(&plan.meter.nodes_visited, visited);
        let mut found: Vec<Candidate> = self.found.into_iter().flatten().collect();
        found.sort_unstable();
        if plan.roots.len() < 2 {
            found.truncate(self.k);
        }
        // It is kept until all places are done, and there may be many.
        found.shrink_to_fit();
        Ok(found)
    }

    fn wait(&self, nodes: impl Iterator<Item = Node>, open: &mut BinaryHeap<Reverse<Waiting>>) {
        open.extend(nodes.filter(|node| self.reaches(&node.subtree_bounds)).map(|node| {
            let square = self.about(&node.subtree_bounds);
            Reverse(Waiting { square, step: Step::Children, node })
        }));
    }

    /// Looks at the points of a part, the nearest blocks first.
    fn offer_part(&mut self, node: &Node, part: usize, near: &mut Near<'_>) -> Result<(), QueryError> {
        let layer = self.plan.roots.iter().position(|root| root.layer == node.layer).unwrap_or_default();
        let bounds = near.bounds(node, part)?;
        let mut blocks: Vec<usize> = (0..bounds.len()).filter(|&block| self.reaches(&bounds[block])).collect();
        blocks.sort_by(|a, b| self.about(&bounds[*a]).total_cmp(&self.about(&bounds[*b])));
        for block in blocks {
            let outside = self.plan.region.classify(&bounds[block]) == Containment::Outside;
            if !outside && self.reaches(&bounds[block]) {
                let read = near.block(node, part, block)?;
                let first = node.blocks(part).range(block).start as u32;
                self.offer_block(&read, layer, |key, i| Pick {
                    key,
                    node: node.ix(),
                    part: part as u32,
                    index: first + i,
                });
            }
        }
        Ok(())
    }

    fn offer_block(&mut self, block: &NearBlock, layer: usize, pick: impl Fn(Key, u32) -> Pick) {
        // What is nearest first, as long as nothing tells what is near.
        let first = (self.found[layer].len() < self.k)
            .then(|| {
                let squares = block.runs.iter().map(|bounds| self.about(bounds)).enumerate();
                squares.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(run, _)| run)
            })
            .flatten();
        let rest = (0..block.runs.len()).filter(|run| Some(*run) != first);
        for run in first.into_iter().chain(rest) {
            if self.reaches(&block.runs[run]) {
                self.offer_run(block, run, layer, &pick);
            }
        }
    }

    fn offer_run(&mut self, block: &NearBlock, run: usize, layer: usize, pick: &impl Fn(Key, u32) -> Pick) {
        let lattice = &self.plan.lattice;
        let mut narrower = false;
        for i in block.mask.indices_of_word(run) {
            let at = block.positions.point(run * RUN + i);
            if !self.window.contains(at) {
                continue;
            }
            let [dx, dy, dz]: [f64; 3] =
                std::array::from_fn(|axis| lattice.world_on_axis(axis, at.0[axis]) - self.point[axis]);
            let square = (dx * dx + dy * dy) + dz * dz;
            // What is as far as the last neighbour may come before it.
            if square <= self.limit() {
                let found = &mut self.found[layer];
                found.push(Candidate { square, pick: pick(Key::of(at), (run * RUN + i) as u32) });
                if found.len() > self.k {
                    found.pop();
                }
                narrower |= found.len() == self.k;
            }
        }
        if narrower {
            self.narrow();
        }
    }

    /// Nothing beyond can be a neighbour.
    fn limit(&self) -> f64 {
        let full = self.found.iter().filter(|found| found.len() >= self.k);
        full.filter_map(|found| found.peek()).map(|last| last.square).fold(self.farthest, f64::min)
    }

    /// May a neighbour lie in the box?
    fn reaches(&self, bounds: &LatticeBox) -> bool {
        self.window.meets(bounds) && self.about(bounds) <= self.beyond
    }

    /// Fits the window to the limit.
    fn narrow(&mut self) {
        let reach = self.limit().sqrt();
        let mut farther = reach;
        for axis in 0..3 {
            let at = self.point[axis];
            // World coordinates are the nearest f64 to what indices mean: some units in the last place wider.
            let slack = (reach + at.abs()) * 4e-15 + 2.0 * self.quantum[axis];
            self.window.low[axis] = self.index(axis, at - reach - slack);
            self.window.high[axis] = self.index(axis, at + reach + slack);
            farther += slack;
        }
        self.beyond = farther * farther;
    }

    /// The index of a coordinate, or the first or last there is.
    fn index(&self, axis: usize, world: f64) -> u64 {
        // Saturates.
        let steps = ((world - self.phase[axis]) / self.quantum[axis]) as i64;
        steps.saturating_add(BIAS).max(0) as u64
    }

    /// The square of about the distance to a box.
    fn about(&self, bounds: &LatticeBox) -> f64 {
        let [dx, dy, dz]: [f64; 3] = std::array::from_fn(|axis| {
            let at = (self.point[axis] - self.phase[axis]) / self.quantum[axis] + BIAS as f64;
            let (low, high) = (bounds.min.0[axis] as f64, bounds.max.0[axis] as f64);
            (low - at).max(at - high).max(0.0) * self.quantum[axis]
        });
        dx * dx + dy * dy + dz * dz
    }
}

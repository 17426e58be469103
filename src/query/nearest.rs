//! The nearest neighbours of points.
//!
//! Distances are in f64 between world coordinates, `(dx * dx + dy * dy) + dz * dz`. Of a box the same is computed from its
//! nearest face: rounding keeps order, so no point of the box comes out nearer than the box does.

use super::answer::{Meter, Statistics};
use super::cells::Pick;
use super::part::{Look, Part};
use super::plan::{Plan, Prospect, Scope};
use super::task::{by_part, work};
use super::{Detail, Query, QueryError};
use crate::codec::BLOCK_POINTS;
use crate::geometry::Containment;
use crate::lattice::{BIAS, Decimal, Key, Lattice, LatticeBox};
use crate::points::Batch;
use crate::store::{Node, Snapshot};
use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;
use std::ops::RangeInclusive;

/// The neighbours of some points.
#[derive(Clone, Debug)]
pub struct Neighbors {
    /// All neighbours: those of the first point, nearest first, then those of the second, and so on.
    pub batch: Batch,
    /// The distance of each, in CRS units.
    pub distances: Vec<f64>,
    /// Where the neighbours of each point end. Fewer than were asked for are there if no more match.
    pub ends: Vec<usize>,
    /// What it cost.
    pub statistics: Statistics,
}

/// A neighbour; the order is by distance, then by position (the order of the points' keys), then by place in the store.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Candidate {
    square: f64,
    pick: Pick,
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

impl Query {
    /// The `k` matching points that are nearest to each of `points` and at most `radius` away. Exact; of equally near
    /// points those whose key is least come first.
    ///
    /// ```
    /// use esker::lattice::Lattice;
    /// use esker::query::{Filter, Query};
    /// use esker::store::{SiteOptions, Store};
    ///
    /// # let store = Store::in_memory(SiteOptions::new(Lattice::uniform(0.001)?))?;
    /// let ground = Query::new().filter(Filter::parse("Z < 10")?);
    /// let found = ground.nearest(&store.snapshot()?, &[[1.0, 2.0, 3.0]], 8, Some(0.5))?;
    /// assert_eq!((found.batch.len(), found.ends), (0, vec![0]));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    ///
    /// As [`Query::run`]; [`QueryError::Combination`] if the query has a level, a capacity or a view;
    /// [`QueryError::Detail`] if a coordinate is not finite or the radius is negative or NaN.
    pub fn nearest(
        &self,
        snapshot: &Snapshot,
        points: &[[f64; 3]],
        k: usize,
        radius: Option<f64>,
    ) -> Result<Neighbors, QueryError> {
        if self.view.is_some() || self.capacity.is_some() || self.detail != Detail::Everything {
            return Err(QueryError::Combination(
                "neighbours are looked for among all points; leave out the view, level, spacing, max error and capacity",
            ));
        }
        if let Some(&value) = points.iter().flatten().find(|c| !c.is_finite()) {
            return Err(QueryError::Detail { what: "coordinate", value, expected: "a finite number" });
        }
        if let Some(value) = radius.filter(|r| !(0.0..).contains(r)) {
            return Err(QueryError::Detail { what: "radius", value, expected: "a length of 0 or more" });
        }
        let mut plan = Plan::new(self, snapshot)?;
        // The neighbours of a point are read again for the point beside it.
        plan.reads(0);
        let farthest = radius.map_or(f64::INFINITY, |r| r * r);
        let found = plan.each(points.to_vec(), |point| Search { plan: &plan, point, k, farthest }.run())?;
        let mut ends = Vec::with_capacity(points.len());
        let mut all: Vec<Candidate> = Vec::new();
        for found in found {
            all.extend(found);
            ends.push(all.len());
        }
        let batch = gather(&plan, &all)?;
        let distances = all.iter().map(|c| c.square.sqrt()).collect();
        let statistics = plan.finish(super::Answer::default()).statistics;
        Ok(Neighbors { batch, distances, ends, statistics })
    }
}

/// The points of the candidates, in their order; each place is read once.
fn gather(plan: &Plan, candidates: &[Candidate]) -> Result<Batch, QueryError> {
    let place = |c: &Candidate| (c.pick.node, c.pick.part, c.pick.index);
    let mut places: Vec<_> = candidates.iter().map(place).collect();
    places.sort_unstable();
    places.dedup();
    let mut batch = Batch::empty(plan.attributes.clone());
    for read in plan.each(by_part(plan, &places)?, |task| work(plan, task))? {
        batch.append(&read);
    }
    let row = |c: &Candidate| places.binary_search(&place(c)).unwrap_or_default() as u32;
    Ok(batch.gathered(&candidates.iter().map(row).collect::<Vec<_>>()))
}

/// A node that may hold neighbours.
struct Waiting {
    square: f64,
    node: Node,
}

impl Ord for Waiting {
    fn cmp(&self, other: &Self) -> Ordering {
        self.square.total_cmp(&other.square).then(self.node.ix().cmp(&other.node.ix()))
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

struct Search<'a> {
    plan: &'a Plan,
    point: [f64; 3],
    k: usize,
    farthest: f64,
}

impl Search<'_> {
    /// Nearest first.
    fn run(&self) -> Result<Vec<Candidate>, QueryError> {
        let plan = self.plan;
        let mut found: BinaryHeap<Candidate> = BinaryHeap::with_capacity(self.k.min(1 << 16) + 1);
        let mut open: BinaryHeap<Reverse<Waiting>> = BinaryHeap::new();
        let wait = |node: Node| Reverse(Waiting { square: self.square_to(&node.subtree_bounds), node });
        open.extend(plan.roots.iter().cloned().map(wait));
        let mut visited = 0;
        while let Some(Reverse(Waiting { square, node })) = open.pop() {
            // What is as far as the last neighbour may still come before it.
            if self.k == 0 || square > self.limit(&found) {
                break;
            }
            plan.cancel.check()?;
            visited += 1;
            if plan.prospect(&node, Scope::Subtree)? == Prospect::Nothing {
                continue;
            }
            let near = node.own_bounds.is_some_and(|bounds| self.square_to(&bounds) <= self.limit(&found));
            if near && plan.prospect(&node, Scope::Own)? != Prospect::Nothing {
                for part in 0..node.parts.len() {
                    self.offer(&node, part, &mut found)?;
                }
            }
            open.extend(plan.nodes.children(&node)?.map(wait));
        }
        Meter::add(&plan.meter.nodes_visited, visited);
        Ok(found.into_sorted_vec())
    }

    /// Nothing beyond can be a neighbour.
    fn limit(&self, found: &BinaryHeap<Candidate>) -> f64 {
        match found.peek() {
            Some(last) if found.len() >= self.k => last.square,
            _ => self.farthest,
        }
    }

    fn offer(&self, node: &Node, part: usize, found: &mut BinaryHeap<Candidate>) -> Result<(), QueryError> {
        let plan = self.plan;
        let limit = self.limit(found);
        let skips = |bounds: &LatticeBox| {
            plan.region.classify(bounds) == Containment::Outside || self.square_to(bounds) > limit
        };
        let look = Look { skips: &skips, misses: false, positions: true };
        for block in Part::new(plan, node, part).find(&look)? {
            let first = (block.block * BLOCK_POINTS) as u32;
            // As far as neighbours are when the block is begun; most of its points are beyond.
            let window = self.window(self.limit(found));
            for i in block.mask.indices() {
                let at = block.content.positions.point(i as usize);
                if (0..3).any(|axis| !window[axis].contains(&at.0[axis])) {
                    continue;
                }
                let square =
                    square(std::array::from_fn(|axis| plan.lattice.world_on_axis(axis, at.0[axis]) - self.point[axis]));
                if square <= self.limit(found) {
                    let pick = Pick { key: Key::of(at), node: node.ix(), part: part as u32, index: first + i };
                    found.push(Candidate { square, pick });
                    if found.len() > self.k {
                        found.pop();
                    }
                }
            }
        }
        Ok(())
    }

    /// Indices on each axis outside of which a point is farther away than the root of `limit`.
    fn window(&self, limit: f64) -> [RangeInclusive<u64>; 3] {
        let lattice = &self.plan.lattice;
        let (quantum, phase) = (lattice.quantum_f64(), lattice.phase().map(Decimal::to_f64));
        std::array::from_fn(|axis| {
            let (reach, at) = (limit.sqrt(), self.point[axis]);
            // World coordinates are the nearest f64 to what indices mean: some units in the last place wider.
            let slack = (reach + at.abs()) * 4e-15 + 2.0 * quantum[axis];
            let index = |world: f64| {
                // Saturates.
                let steps = ((world - phase[axis]) / quantum[axis]) as i64;
                steps.saturating_add(BIAS).max(0) as u64
            };
            index(at - reach - slack)..=index(at + reach + slack)
        })
    }

    /// The square of the distance to a box.
    fn square_to(&self, bounds: &LatticeBox) -> f64 {
        distance_to(&self.plan.lattice, self.point, bounds)
    }
}

fn square([dx, dy, dz]: [f64; 3]) -> f64 {
    (dx * dx + dy * dy) + dz * dz
}

fn distance_to(lattice: &Lattice, point: [f64; 3], bounds: &LatticeBox) -> f64 {
    square(std::array::from_fn(|axis| {
        let low = lattice.world_on_axis(axis, bounds.min.0[axis]);
        let high = lattice.world_on_axis(axis, bounds.max.0[axis]);
        (low - point[axis]).max(point[axis] - high).max(0.0)
    }))
}

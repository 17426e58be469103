//! A view part by part, for those who keep parts from one camera to the next: what a camera wants, and the points of any
//! one part of it.

use super::part::{Found, Look, Part};
use super::plan::{Plan, Prospect, Scope};
use super::view::ViewCut;
use super::{Query, QueryError, Statistics};
use crate::geometry::{Camera, Containment};
use crate::lattice::{Cube, LatticeBox};
use crate::octree::{Step, even_order};
use crate::points::Batch;
use crate::store::model::{NodeHead, ScanId};
use crate::store::{Node, NodeIx, Nodes, Snapshot};
use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};

/// A query on one snapshot that is asked again and again, for other cameras.
pub struct ViewParts {
    plan: Plan,
    /// Of the filter; 0 without one.
    filter: u64,
}

/// The points that a query has in a part of a node: the same id, the same points, in any generation of the store.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct PartId {
    /// The node's first chunk row, which is never given out again.
    chunks: i64,
    part: u32,
    /// Of what decides which of the points match; 0 if all of them do.
    matching: u64,
}

impl PartId {
    /// Do all stored points of the part match?
    pub fn is_whole(&self) -> bool {
        self.matching == 0
    }
}

#[cfg(test)]
impl PartId {
    /// An id like no other of another number.
    pub(crate) fn for_test(number: u32) -> Self {
        Self { chunks: i64::from(number), part: 0, matching: 0 }
    }
}

#[cfg(test)]
impl WantedPart {
    /// A part that can't be read.
    pub(crate) fn for_test(id: PartId, node: u32, cube: Cube, points: u32, after: Option<u32>, spacing: f64) -> Self {
        Self { id, at: 0, node, cube, part: 0, points, stored: points, after, spacing }
    }
}

/// A node of which a camera wants something.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WantedNode {
    /// Its cube.
    pub cube: Cube,
    /// Its layer.
    pub layer: u16,
    /// The parent's place in [`Wanted::nodes`]; none for a root.
    pub parent: Option<u32>,
    /// The side of the cells, in CRS units, on which nodes above have sampled its cube.
    pub spacing_before: f64,
}

/// A part that is wanted, or an even thinning of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WantedPart {
    /// What it holds.
    pub id: PartId,
    /// Where to read it.
    pub(super) at: NodeIx,
    /// Its node: a place in [`Wanted::nodes`].
    pub node: u32,
    /// The node's cube.
    pub cube: Cube,
    /// Which part of the node.
    pub part: u32,
    /// How many of its points: the first so many in even order.
    pub points: u32,
    /// How many points are stored in it, whether they match or not.
    pub stored: u32,
    /// The part that must be there before this one is worth anything: a place in [`Wanted::parts`], always before this
    /// one's.
    pub after: Option<u32>,
    /// How far apart points lie, in CRS units, once this part is there: the side of the cells that are sampled, or less in
    /// a whole leaf whose points are closer.
    pub spacing: f64,
}

/// What a camera wants, best first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Wanted {
    /// The nodes, parents first.
    pub nodes: Vec<WantedNode>,
    /// In the order of the sequence: a closed cut at any point.
    pub parts: Vec<WantedPart>,
    /// Points of all parts together.
    pub points: u64,
    /// As [`super::Selection::error_bound`]; under a filter only if everything is wanted.
    pub error_bound: Option<f64>,
    /// The same in pixels.
    pub error_bound_px: Option<f64>,
    /// Nodes whose rows were looked at.
    pub nodes_visited: u64,
}

/// How far apart the points of a whole node are seen, by the side of its cells and their mean distance to the nearest
/// neighbour.
///
/// Where cells are finer than the data the points are further apart than cells, but a few strays must not become
/// large. A leaf has everything, and may have it far closer than the cells of a large cube that holds few points: points that
/// lie anyhow are twice as far apart on the whole as the nearest two, and their largest gaps as wide again.
fn seen_spacing(cell: f64, nearest: f64, leaf: bool) -> f64 {
    let apart = cell.max((1.5 * nearest).min(4.0 * cell));
    if leaf && nearest > 0.0 { apart.min(4.0 * nearest) } else { apart }
}

/// How much of a part to take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Take {
    /// It, of which so many points match (or are thought to), and go on.
    All(u32),
    /// Its first so many points, and end.
    First(u32),
}

/// The matching points of a part.
#[derive(Clone, Debug, PartialEq)]
pub struct PartPoints {
    /// The points, in key order.
    pub batch: Batch,
    /// Their places among the stored points of the part, ascending; `None`: all.
    indices: Option<Vec<u32>>,
    stored: u32,
    /// Bytes of the chunks read.
    pub bytes_read: u64,
}

impl PartPoints {
    /// The places of the points in the batch, in an order whose every prefix is an even thinning of the part.
    pub fn even_order(&self) -> Vec<u32> {
        let Some(indices) = &self.indices else { return even_order(self.stored).collect() };
        let mut place = vec![u32::MAX; self.stored as usize];
        for (i, &index) in (0..).zip(indices) {
            place[index as usize] = i;
        }
        even_order(self.stored).map(|i| place[i as usize]).filter(|&p| p != u32::MAX).collect()
    }
}

impl Query {
    /// The query, ready to be asked for views; the view, detail and capacity of the query itself are not looked at.
    ///
    /// # Errors
    ///
    /// As [`Query::run`].
    pub fn view_parts(&self, snapshot: &Snapshot) -> Result<ViewParts, QueryError> {
        let filter = self.filter.as_ref().map_or(0, |f| hash_of(&f.to_string()) | 1);
        Ok(ViewParts { plan: Plan::new(self, snapshot)?, filter })
    }
}

impl ViewParts {
    /// The snapshot that is read.
    pub fn snapshot(&self) -> &Snapshot {
        &self.plan.snapshot
    }

    /// The parts that a camera wants, best first, until every node is finer than `max_error_px` on the image or `take`
    /// says that it is enough. `take` is asked for each part in turn, with the number of points stored in it.
    ///
    /// # Errors
    ///
    /// [`QueryError::Store`] if rows can't be read.
    pub fn select(
        &self,
        camera: &Camera,
        max_error_px: f64,
        mut take: impl FnMut(&PartId, u32) -> Take,
    ) -> Result<Wanted, QueryError> {
        let plan = &self.plan;
        let unfiltered = plan.is_unfiltered() && plan.region.is_everything();
        let may = |node: &Node| -> Result<bool, QueryError> {
            Ok(unfiltered || plan.prospect(node, Scope::Subtree)? != Prospect::Nothing)
        };
        let mut cut = ViewCut::new(&plan.nodes, &plan.lattice, plan.g, camera, max_error_px, may)?;
        let mut sequence = Sequence::new(&plan.nodes, plan.lattice.largest_quantum(), plan.g);
        let mut ended = false;
        while !ended && let Some((at, part)) = cut.advance()? {
            let id = self.part_id(&at, part);
            let points = match take(&id, at.parts[part].points) {
                Take::All(points) => points,
                Take::First(points) => {
                    cut.take_back();
                    ended = true;
                    if points == 0 {
                        break;
                    }
                    points
                }
            };
            sequence.push(&at, part, id, points)?;
        }
        let (mut bound, mut bound_px) = cut.bounds(sequence.wanted.points > 0)?;
        if !unfiltered {
            let complete = cut.is_complete().then_some(0.0);
            (bound, bound_px) = (complete, complete);
        }
        let visited = cut.visited();
        Ok(Wanted { error_bound: bound, error_bound_px: bound_px, nodes_visited: visited, ..sequence.wanted })
    }

    /// What all readings cost so far.
    pub fn statistics(&self) -> Statistics {
        self.plan.meter.statistics(std::time::Duration::ZERO)
    }

    fn part_id(&self, head: &NodeHead, part: usize) -> PartId {
        let scans = self.plan.scans.as_ref().filter(|shown| head.scans.iter().any(|s| !contains(shown, s.scan)));
        let shown = |shown: &Vec<ScanId>| {
            let here: Vec<ScanId> = head.scans.iter().map(|s| s.scan).filter(|&s| contains(shown, s)).collect();
            hash_of(&here) | 1
        };
        let matching = match (self.filter, scans.map_or(0, shown)) {
            (0, 0) => 0,
            both => hash_of(&both) | 1,
        };
        PartId { chunks: head.chunk_base, part: part as u32, matching }
    }

    /// The points of a part of [`ViewParts::select`]'s.
    ///
    /// # Errors
    ///
    /// [`QueryError::Store`], [`QueryError::Inconsistent`] if the part can't be read.
    pub fn read(&self, wanted: &WantedPart) -> Result<PartPoints, QueryError> {
        let plan = &self.plan;
        let (node, part) = (wanted.at, wanted.part as usize);
        let stored = wanted.stored;
        let node = plan.nodes.node(node)?;
        let prospect = plan.prospect(&node, Scope::Own)?;
        let mut read = Part::new(plan, &node, part);
        let (batch, indices) = match prospect {
            Prospect::Nothing => (Batch::empty(plan.attributes.clone()), Some(Vec::new())),
            Prospect::Everything => (read.whole()?, None),
            Prospect::Some => {
                let outside = |bounds: &LatticeBox| plan.region.classify(bounds) == Containment::Outside;
                let found = read.find(&Look { skips: &outside, misses: false, positions: true })?;
                let blocks = read.blocks;
                let indices = |Found { block, mask, .. }: &Found| {
                    let start = blocks.range(*block).start as u32;
                    mask.indices().into_iter().map(move |i| start + i)
                };
                let indices = found.iter().flat_map(indices).collect();
                (read.take(&found)?, Some(indices))
            }
        };
        Ok(PartPoints { batch, indices, stored, bytes_read: read.bytes_read() })
    }
}

/// The parts so far, with the nodes above them.
struct Sequence<'a> {
    stored: &'a Nodes,
    quantum: f64,
    g: u8,
    wanted: Wanted,
    /// By node: its place in `wanted.nodes`.
    places: HashMap<NodeIx, u32>,
    /// By place: the node's last part in `wanted.parts`.
    last: Vec<Option<u32>>,
}

impl<'a> Sequence<'a> {
    fn new(stored: &'a Nodes, quantum: f64, g: u8) -> Self {
        Self { stored, quantum, g, wanted: Wanted::default(), places: HashMap::new(), last: Vec::new() }
    }

    fn push(&mut self, head: &Node, part: usize, id: PartId, points: u32) -> Result<(), QueryError> {
        let node = self.place(head)?;
        let after = self.before(node);
        let own = i32::from(head.cube.k()) - i32::from(self.g);
        let cell = if part + 1 == head.parts.len() {
            own
        } else {
            let steps = head.parts[..=part].iter().rev();
            let reached = steps.filter_map(|p| p.last_step).next();
            // Without a complete step nothing is finer than above.
            reached.map_or(own + 1, |Step { win, group }| i32::from(win) + i32::from(group < 3)).max(own)
        };
        let mut spacing = self.side(cell);
        if part + 1 == head.parts.len() {
            spacing = seen_spacing(spacing, head.shape.spacing * self.quantum, head.leaf);
        }
        let last = self.wanted.parts.len() as u32;
        self.last[node as usize] = Some(last);
        self.wanted.points += u64::from(points);
        let stored = head.parts[part].points;
        self.wanted.parts.push(WantedPart {
            id,
            at: head.ix(),
            node,
            cube: head.cube,
            part: part as u32,
            points,
            stored,
            after,
            spacing,
        });
        Ok(())
    }

    fn side(&self, cell: i32) -> f64 {
        2_f64.powi(cell) * self.quantum
    }

    /// The node's place; it and those above it are listed if they are not yet.
    fn place(&mut self, head: &Node) -> Result<u32, QueryError> {
        if let Some(&place) = self.places.get(&head.ix()) {
            return Ok(place);
        }
        let parent = if head.is_root() { None } else { self.stored.find(head.layer, head.cube.parent())? };
        let parent = parent.map(|parent| self.place(&parent)).transpose()?;
        let spacing_before = self.side(i32::from(head.cube.k()) - i32::from(self.g) + 1);
        let place = self.wanted.nodes.len() as u32;
        self.wanted.nodes.push(WantedNode { cube: head.cube, layer: head.layer, parent, spacing_before });
        self.last.push(None);
        self.places.insert(head.ix(), place);
        Ok(place)
    }

    /// The last part so far of the node, or of the nearest node above that has parts.
    fn before(&self, node: u32) -> Option<u32> {
        let mut node = Some(node);
        while let Some(at) = node {
            if let last @ Some(_) = self.last[at as usize] {
                return last;
            }
            node = self.wanted.nodes[at as usize].parent;
        }
        None
    }
}

fn contains(ascending: &[ScanId], scan: ScanId) -> bool {
    ascending.binary_search(&scan).is_ok()
}

fn hash_of(value: &impl Hash) -> u64 {
    // With its fixed keys: the same in every run.
    let mut hasher = DefaultHasher::new();
    value.hash(&mut hasher);
    hasher.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_seen_as_far_apart_as_they_lie() {
        // As the cells: a surface that is sampled, a leaf of about a point a cell.
        assert_eq!([seen_spacing(1.0, 0.6, false), seen_spacing(1.0, 0.4, true)], [1.0, 1.0]);
        // Cells finer than the data; strays.
        assert_eq!([seen_spacing(1.0, 2.0, false), seen_spacing(1.0, 2.0, true)], [3.0, 3.0]);
        assert_eq!([seen_spacing(1.0, 50.0, false), seen_spacing(1.0, 50.0, true)], [4.0, 4.0]);
        // A large leaf with everything in a corner; an inner node's cells hold nothing finer.
        assert_eq!([seen_spacing(64.0, 0.5, true), seen_spacing(64.0, 0.5, false)], [2.0, 64.0]);
        // A single point, or many on one place.
        assert_eq!([seen_spacing(1.0, 0.0, true), seen_spacing(1.0, 0.0, false)], [1.0, 1.0]);
    }
}

//! What nodes give to a level: their points that may be the least matching ones of a cell (OCTREE section 6).
//!
//! The unfiltered level is among the points of the nodes that sample on these cells or coarser ones. Where the first point
//! of a cell does not match, the cell is a hole, and the nodes below are searched for its least matching point, as far as
//! they can still hold one.

use super::QueryError;
use super::mask::Mask;
use super::part::{Found, Look, Part};
use super::plan::{Plan, Prospect, Scope};
use crate::geometry::Containment;
use crate::lattice::{Cube, Key, LatticeBox, LatticePoint};
use crate::store::{Node, NodeIx};

/// A matching point and where it is stored. Within a layer these order as the points do: of equal keys the one in the
/// coarser node comes first, then the one in the earlier part, and a part keeps the order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Pick {
    pub key: Key,
    pub node: NodeIx,
    pub part: u32,
    pub index: u32,
}

/// With more open cells than this, blocks are not tested against each of them.
const FEW_HOLES: usize = 64;

/// What a part gave, as it was decoded.
pub(crate) struct Reading<'a> {
    pub node: NodeIx,
    pub part: u32,
    pub read: Part<'a>,
    pub found: Vec<Found>,
}

impl Reading<'_> {
    /// Calls `each` with the positions of the matching points, in key order.
    pub fn positions(&self, mut each: impl FnMut(LatticePoint)) {
        for Found { content, mask, .. } in &self.found {
            if mask.is_all() {
                content.positions.iter().for_each(&mut each);
            } else {
                mask.indices().into_iter().for_each(|i| each(content.positions.point(i as usize)));
            }
        }
    }

    /// The places of the matching points in the part, ascending.
    pub fn indices(&self) -> impl Iterator<Item = u32> + '_ {
        self.found.iter().flat_map(|f| {
            let first = self.read.blocks.range(f.block).start as u32;
            f.mask.indices().into_iter().map(move |i| first + i)
        })
    }

    /// The matching points with their keys.
    pub fn picks(&self, picks: &mut Vec<Pick>) {
        let (node, part) = (self.node, self.part);
        let mut indices = self.indices();
        self.positions(|point| {
            let index = indices.next().unwrap_or_default();
            picks.push(Pick { key: Key::of(point), node, part, index });
        });
    }

    /// Keeps those matching points for which `keep`, asked in their order, says so.
    pub fn narrow(&mut self, mut keep: impl FnMut() -> bool) {
        for Found { mask, .. } in &mut self.found {
            let kept = mask.indices().into_iter().filter(|_| keep()).map(|i| i as usize);
            *mask = Mask::of_indices(mask.len(), kept);
        }
        self.found.retain(|f| !f.mask.is_none());
    }
}

/// What was read of a node at or above a level.
#[derive(Default)]
pub(crate) struct Level<'a> {
    pub readings: Vec<Reading<'a>>,
    /// Cells, by their least key, with a point that does not match.
    pub missed: Vec<Key>,
}

/// Reads the matching points of a node that may be the least of a cell of exponent `c`, and of an inner node the cells of
/// those that do not match; all its matching points, if there is no `c`. `root` is the root of the node's tree.
pub(crate) fn read_node<'a>(
    plan: &'a Plan,
    head: &Node,
    root: Cube,
    c: Option<u8>,
    level: &mut Level<'a>,
) -> Result<(), QueryError> {
    plan.cancel.check()?;
    let complete = plan.takes_all_of(head.cube);
    for (part, facts) in head.parts.iter().enumerate() {
        // The first point of a tree has its root's exponent for a win, and is the least of any larger cell, too. Where
        // everything matches, a part whose points win no such cell has the least of none.
        let loses = c.is_some_and(|c| facts.first_step.win < c.min(root.k()) as i8);
        if !(complete && loses) {
            read_part(plan, head, part, c.filter(|_| !complete && !head.leaf), level)?;
        }
    }
    Ok(())
}

/// The box of the cells of exponent `c` that `bounds` meets.
pub(crate) fn cells_of(bounds: &LatticeBox, c: u8) -> LatticeBox {
    let side = (1_u64 << c) - 1;
    LatticeBox {
        min: LatticePoint(bounds.min.0.map(|v| v >> c << c)),
        max: LatticePoint(bounds.max.0.map(|v| v | side)),
    }
}

/// Appends the matching points of a part; with `misses` also the cells of that exponent of those that do not match, as
/// far as the cells meet the region.
fn read_part<'a>(
    plan: &'a Plan,
    node: &Node,
    part: usize,
    misses: Option<u8>,
    level: &mut Level<'a>,
) -> Result<(), QueryError> {
    let outside = |bounds: &LatticeBox| plan.region.classify(bounds) == Containment::Outside;
    let skips = |bounds: &LatticeBox| match misses {
        Some(c) => outside(&cells_of(bounds, c)),
        None => outside(bounds),
    };
    let look = Look { skips: &skips, misses: misses.is_some(), positions: true };
    let mut read = Part::new(plan, node, part);
    let mut found = read.find(&look)?;
    for Found { content, mask, .. } in &found {
        let Some(c) = misses.filter(|_| !mask.is_all()) else { continue };
        for (i, point) in content.positions.iter().enumerate() {
            if !mask.contains(i) && !outside(&cells_of(&LatticeBox::of(point), c)) {
                level.missed.push(Key::of(point).floor(c));
            }
        }
    }
    found.retain(|f| !f.mask.is_none());
    if !found.is_empty() {
        level.readings.push(Reading { node: node.ix(), part: part as u32, read, found });
    }
    Ok(())
}

/// A cell whose first point does not match.
pub(crate) struct Hole {
    /// The least key of the cell.
    pub floor: Key,
    bounds: LatticeBox,
    /// The key of the least matching point so far.
    best: Option<Key>,
    /// That point, if it was found below.
    pub found: Option<Pick>,
}

impl Hole {
    /// `best` is the least key found in the cell so far.
    pub fn new(floor: Key, c: u8, best: Option<Key>) -> Self {
        Self { floor, bounds: Cube::containing(floor.point(), c).to_box(), best, found: None }
    }

    /// Can a point of this cube be less than what was found? Which of equal keys is less is decided when the points are
    /// there.
    fn is_open(&self, cube: Cube, bounds: &LatticeBox) -> bool {
        self.best.is_none_or(|best| best >= self.floor.max(cube.first_key())) && self.bounds.meets(bounds)
    }
}

/// Searches the nodes below `node` for the least matching points of the holes, which ascend.
pub(crate) fn fill(plan: &Plan, node: &Node, c: u8, holes: &mut [Hole]) -> Result<(), QueryError> {
    let mut children: Vec<Node> = plan.nodes.children(node)?.collect();
    children.sort_by_key(|n| n.cube.first_key());
    if node.cube.k() > c {
        // No cell belongs to two of them.
        let mut jobs = Vec::with_capacity(children.len());
        let mut rest = holes;
        for head in children {
            let cube = head.cube;
            let (_, after) = rest.split_at_mut(rest.partition_point(|h| h.floor < cube.first_key()));
            let (own, after) = after.split_at_mut(after.partition_point(|h| h.floor <= cube.last_key()));
            rest = after;
            jobs.push((head, own));
        }
        return plan.each(jobs, |(head, holes)| fill_child(plan, &head, c, holes)).map(|_: Vec<()>| ());
    }
    children.iter().try_for_each(|head| {
        let cube = head.cube;
        let from = holes.partition_point(|h| h.floor < cube.first_key().floor(c));
        let to = holes.partition_point(|h| h.floor <= cube.last_key());
        fill_child(plan, head, c, &mut holes[from..to])
    })
}

/// Searches a node and those below it for the least matching points of the holes, which ascend.
pub(crate) fn fill_child(plan: &Plan, head: &Node, c: u8, holes: &mut [Hole]) -> Result<(), QueryError> {
    plan.cancel.check()?;
    let open = holes.iter().filter(|h| h.is_open(head.cube, &head.subtree_bounds)).count();
    if open == 0 || plan.prospect(head, Scope::Subtree)? == Prospect::Nothing {
        return Ok(());
    }
    if plan.prospect(head, Scope::Own)? != Prospect::Nothing {
        fill_from(plan, head, c, holes, open <= FEW_HOLES)?;
    }
    if head.leaf { Ok(()) } else { fill(plan, head, c, holes) }
}

/// Offers the matching points of one node to the holes.
fn fill_from(plan: &Plan, head: &Node, c: u8, holes: &mut [Hole], few: bool) -> Result<(), QueryError> {
    for part in 0..head.parts.len() {
        let mut candidates = Vec::new();
        {
            let holes = &*holes;
            let skips = |bounds: &LatticeBox| {
                plan.region.classify(bounds) == Containment::Outside
                    || few && !holes.iter().any(|h| h.is_open(head.cube, bounds))
            };
            let look = Look { skips: &skips, misses: false, positions: true };
            let mut read = Part::new(plan, head, part);
            let found = read.find(&look)?;
            Reading { node: head.ix(), part: part as u32, read, found }.picks(&mut candidates);
        }
        for pick in candidates {
            let floor = pick.key.floor(c);
            // One that is as good as what was found above is offered, too: that may be of another layer.
            if let Ok(i) = holes.binary_search_by_key(&floor, |h| h.floor)
                && holes[i].best.is_none_or(|best| pick.key < best || pick.key == best && holes[i].found.is_none())
            {
                holes[i].best = Some(pick.key);
                holes[i].found = Some(pick);
            }
        }
    }
    Ok(())
}

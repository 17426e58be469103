//! Answers at a level: the least matching point of every cell that has one (OCTREE section 6).
//!
//! The unfiltered level is the points of the nodes that sample on these cells or coarser ones. Where the first point of a
//! cell does not match, the cell is a hole, and the nodes below are searched for its least matching point, as far as they
//! can still hold one.

use super::QueryError;
use super::part::{Look, Part};
use super::plan::{Plan, Prospect, Scope};
use super::ties;
use crate::geometry::Containment;
use crate::lattice::{Cube, Key, LatticeBox, LatticePoint};
use crate::store::{Node, NodeIx};
use rayon::prelude::*;

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

/// All matching points, in key order.
pub(crate) fn everything(plan: &Plan) -> Result<Vec<Pick>, QueryError> {
    let mut nodes = Vec::new();
    plan.walk(|node| {
        nodes.push(node.clone());
        Ok(true)
    })?;
    let read: Vec<Vec<Pick>> = plan.each(nodes, |node| {
        plan.cancel.check()?;
        let mut picks = Vec::new();
        if plan.prospect(&node, Scope::Own)? != Prospect::Nothing {
            for part in 0..node.parts.len() {
                read_part(plan, &node, part, None, &mut picks, &mut Vec::new())?;
            }
        }
        Ok(picks)
    })?;
    let mut picks = read.concat();
    picks.par_sort_unstable();
    ties::settle(plan, &mut picks)?;
    Ok(picks)
}

/// The least matching point of every cell of exponent `c` that has one, in key order.
pub(crate) fn filtered(plan: &Plan, c: u8) -> Result<Vec<Pick>, QueryError> {
    let mut picks = Vec::new();
    for root in &plan.roots {
        // The least of each layer, then the least of all: the union's is among them.
        picks.extend(level_below(plan, root, root.cube, c, Vec::new(), Vec::new())?);
    }
    picks.par_sort_unstable();
    ties::settle(plan, &mut picks)?;
    picks.dedup_by_key(|p| p.key.prefix(c));
    Ok(picks)
}

/// What the nodes at or above a level gave.
#[derive(Default)]
pub(crate) struct Above {
    pub picks: Vec<Pick>,
    /// Cells, by their least key, with a point that does not match.
    pub missed: Vec<Key>,
}

/// The least matching points of the cells of a subtree, in key order. `picks` and `missed` are what the nodes above it have
/// in its cube; the former are in the result. `root` is the root of its tree.
pub(crate) fn level_below(
    plan: &Plan,
    top: &Node,
    root: Cube,
    c: u8,
    mut picks: Vec<Pick>,
    mut missed: Vec<Key>,
) -> Result<Vec<Pick>, QueryError> {
    let mut above = Vec::new();
    let mut frontier = Vec::new();
    plan.walk_from(vec![top.clone()], |head| {
        let finer = i16::from(head.cube.k()) < i16::from(c) + i16::from(plan.g);
        if finer && !head.is_root() {
            return Ok(false);
        }
        above.push(head.clone());
        let lowest = finer || head.cube.k() == c + plan.g;
        if lowest && !head.leaf {
            frontier.push(head.clone());
        }
        Ok(!lowest)
    })?;
    for read in plan.each(above, |node| read_above(plan, &node, root, c))? {
        picks.extend(read.picks);
        missed.extend(read.missed);
    }
    picks.sort_unstable();
    picks.dedup_by_key(|p| p.key.prefix(c));
    if missed.is_empty() {
        return Ok(picks);
    }
    missed.sort_unstable();
    missed.dedup();
    let filled = plan.each(frontier, |node| {
        let cube = node.cube;
        let from = missed.partition_point(|m| *m < cube.first_key().floor(c));
        let to = missed.partition_point(|m| *m <= cube.last_key());
        let mut holes: Vec<Hole> = missed[from..to].iter().map(|&floor| Hole::new(floor, c, &picks)).collect();
        fill(plan, &node, c, &mut holes)?;
        Ok(holes.into_iter().filter_map(|h| h.found).collect::<Vec<_>>())
    })?;
    filled.into_iter().for_each(|f| picks.extend(f));
    picks.sort_unstable();
    picks.dedup_by_key(|p| p.key.prefix(c));
    Ok(picks)
}

/// The matching points of a node at or above the level, at most one a cell, and the cells of those that do not match.
pub(crate) fn read_above(plan: &Plan, head: &Node, root: Cube, c: u8) -> Result<Above, QueryError> {
    plan.cancel.check()?;
    let mut result = Above::default();
    let complete = plan.takes_all_of(head.cube);
    // The first point of a tree has its root's exponent for a win, and is the least of any larger cell, too.
    let winning = c.min(root.k()) as i8;
    for (part, facts) in head.parts.iter().enumerate() {
        // Where everything matches, a point that wins no such cell is the least of none.
        if complete && facts.first_step.win < winning {
            continue;
        }
        read_part(plan, head, part, Some((c, !complete && !head.leaf)), &mut result.picks, &mut result.missed)?;
    }
    result.picks.sort_unstable();
    if head.cube.k() >= c {
        result.picks.dedup_by_key(|p| p.key.prefix(c));
    }
    Ok(result)
}

/// The box of the cells of exponent `c` that `bounds` meets.
pub(crate) fn cells_of(bounds: &LatticeBox, c: u8) -> LatticeBox {
    let side = (1_u64 << c) - 1;
    LatticeBox {
        min: LatticePoint(bounds.min.0.map(|v| v >> c << c)),
        max: LatticePoint(bounds.max.0.map(|v| v | side)),
    }
}

/// Appends the matching points of a part; with `misses` also the cells of exponent `c` of those that do not match, as
/// far as the cells meet the region.
fn read_part(
    plan: &Plan,
    node: &Node,
    part: usize,
    cells: Option<(u8, bool)>,
    picks: &mut Vec<Pick>,
    missed: &mut Vec<Key>,
) -> Result<(), QueryError> {
    let outside = |bounds: &LatticeBox| plan.region.classify(bounds) == Containment::Outside;
    let misses = cells.filter(|(_, misses)| *misses).map(|(c, _)| c);
    let skips = |bounds: &LatticeBox| match misses {
        Some(c) => outside(&cells_of(bounds, c)),
        None => outside(bounds),
    };
    let look = Look { skips: &skips, misses: misses.is_some(), positions: true };
    for found in Part::new(plan, node, part).find(&look)? {
        let first = (found.block * crate::codec::BLOCK_POINTS) as u32;
        for i in found.mask.indices() {
            let key = Key::of(found.content.positions.point(i as usize));
            picks.push(Pick { key, node: node.ix(), part: part as u32, index: first + i });
        }
        let Some(c) = misses else { continue };
        if found.mask.is_all() {
            continue;
        }
        for (i, point) in found.content.positions.iter().enumerate() {
            if !found.mask.contains(i) && !outside(&cells_of(&LatticeBox::of(point), c)) {
                missed.push(Key::of(point).floor(c));
            }
        }
    }
    Ok(())
}

/// A cell whose first point does not match.
struct Hole {
    /// The least key of the cell.
    floor: Key,
    bounds: LatticeBox,
    /// The key of the least matching point so far.
    best: Option<Key>,
    /// That point, if it was found below.
    found: Option<Pick>,
}

impl Hole {
    fn new(floor: Key, c: u8, picks: &[Pick]) -> Self {
        let at = picks.partition_point(|p| p.key < floor);
        let best = picks.get(at).filter(|p| p.key.floor(c) == floor).map(|p| p.key);
        Self { floor, bounds: Cube::containing(floor.point(), c).to_box(), best, found: None }
    }

    /// Can a point of this cube be less than what was found? Of equal keys the one above is less, but that is decided
    /// when the point is there.
    fn is_open(&self, cube: Cube, bounds: &LatticeBox) -> bool {
        self.best.is_none_or(|best| best >= self.floor.max(cube.first_key())) && self.bounds.meets(bounds)
    }
}

/// Searches the nodes below `node` for the least matching points of the holes, which ascend.
fn fill(plan: &Plan, node: &Node, c: u8, holes: &mut [Hole]) -> Result<(), QueryError> {
    let mut children: Vec<Node> = plan.nodes.children(node)?.collect();
    children.sort_by_key(|n| n.cube.first_key());
    for head in &children {
        let cube = head.cube;
        let from = holes.partition_point(|h| h.floor < cube.first_key().floor(c));
        let to = holes.partition_point(|h| h.floor <= cube.last_key());
        let holes = &mut holes[from..to];
        plan.cancel.check()?;
        let open = holes.iter().filter(|h| h.is_open(cube, &head.subtree_bounds)).count();
        if open == 0 || plan.prospect(head, Scope::Subtree)? == Prospect::Nothing {
            continue;
        }
        if plan.prospect(head, Scope::Own)? != Prospect::Nothing {
            fill_from(plan, head, c, holes, open <= FEW_HOLES)?;
        }
        if !head.leaf {
            fill(plan, head, c, holes)?;
        }
    }
    Ok(())
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
            for found in Part::new(plan, head, part).find(&look)? {
                let first = (found.block * crate::codec::BLOCK_POINTS) as u32;
                for i in found.mask.indices() {
                    let key = Key::of(found.content.positions.point(i as usize));
                    candidates.push(Pick { key, node: head.ix(), part: part as u32, index: first + i });
                }
            }
        }
        for pick in candidates {
            let floor = pick.key.floor(c);
            if let Ok(i) = holes.binary_search_by_key(&floor, |h| h.floor)
                && holes[i].best.is_none_or(|best| pick.key < best)
            {
                holes[i].best = Some(pick.key);
                holes[i].found = Some(pick);
            }
        }
    }
    Ok(())
}

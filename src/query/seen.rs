//! Answers for a camera: selected from node rows alone, or, under a filter, part by part.

use super::answer::{Answer, Meter, Stage};
use super::cells::{Hole, Pick, cells_of, fill_child};
use super::gaps::{Bound, Gap, Holes, Missed};
use super::part::{Found, Look, Part};
use super::plan::{Plan, Prospect, Scope};
use super::policy::{Policy, select_by_distance};
use super::task::{Task, outside};
use super::view::{RelativeLattice, ViewCut, select};
use super::{Query, QueryError};
use crate::geometry::{Camera, DVec3};
use crate::lattice::{Cube, Key, LatticeBox};
use crate::octree::even_order;
use crate::store::{Node, NodeIx};
use std::cmp::Reverse;

/// Parts that are matched together, in a view under a filter.
const VIEW_WINDOW: usize = 16;

/// So many points that do not match are remembered; of more their parts are looked at again.
const MOST_MISSED: usize = if cfg!(test) { 8 } else { 1 << 20 };

/// What a camera needs.
pub(crate) fn view(
    plan: &Plan,
    query: &Query,
    camera: &Camera,
    max_error_px: f64,
    finest: Option<u8>,
    counting: bool,
) -> Result<(Vec<Task>, Answer), QueryError> {
    let (tasks, answer) = if plan.is_unfiltered() && plan.region.is_everything() {
        let selection = plan.meter.time(Stage::Selecting, || match &query.policy {
            Policy::Screen => {
                let all = |_: &Node| Ok::<_, QueryError>(true);
                let cut = ViewCut::new(&plan.nodes, &plan.lattice, plan.g, camera, max_error_px, all)?;
                select(&mut cut.no_finer_than(finest), query.capacity)
            }
            Policy::Distance(_) if finest.is_some() => Err(QueryError::Combination(
                "the distance policy takes points by their distance; leave out spacing, level and error, or --policy",
            )),
            Policy::Distance(policy) => {
                select_by_distance(&plan.nodes, &plan.lattice, plan.g, camera, policy, query.capacity)
            }
        })?;
        Meter::add(&plan.meter.nodes_visited, selection.nodes_visited);
        let picked = selection.parts.iter().map(|selected| {
            let (node, part) = (selected.node, selected.part as usize);
            let all = plan.nodes.node(node)?.parts[part].points;
            let some = || {
                let mut indices: Vec<u32> = even_order(all).take(selected.points as usize).collect();
                indices.sort_unstable();
                indices
            };
            Ok(Task::Picked { node, part, points: all, indices: (selected.points < all).then(some) })
        });
        let (bound, px) = (selection.error_bound, selection.error_bound_px);
        let answer = Answer { points: selection.points, error_bound: bound, error_bound_px: px, ..Answer::default() };
        // Only what is to be delivered is worth listing point by point.
        (if counting { Vec::new() } else { picked.collect::<Result<_, QueryError>>()? }, answer)
    } else {
        if query.policy != Policy::Screen {
            return Err(QueryError::Combination(
                "the distance policy counts stored points; leave out filter, region and scans, or --policy",
            ));
        }
        plan.meter.time(Stage::Selecting, || filtered_view(plan, camera, max_error_px, finest, query.capacity))?
    };
    let node = |task: &Task| match task {
        Task::Picked { node, .. } => Some(*node),
        _ => None,
    };
    let nodes: std::collections::BTreeSet<NodeIx> = tasks.iter().filter_map(node).collect();
    Meter::add(&plan.meter.nodes, nodes.len() as u64);
    // They are counted once more as they are handed on.
    if counting { Ok((Vec::new(), answer)) } else { Ok((near_first(plan, camera, tasks)?, answer)) }
}

/// Near to far, so that who stops early has the foreground. A node comes before those below it, since the bounds of its
/// subtree hold theirs.
fn near_first(plan: &Plan, camera: &Camera, tasks: Vec<Task>) -> Result<Vec<Task>, QueryError> {
    let lattice = RelativeLattice::new(&plan.lattice, camera.eye());
    let mut placed = Vec::with_capacity(tasks.len());
    for task in tasks {
        let Task::Picked { node, part, .. } = &task else { continue };
        let head = plan.nodes.node(*node)?;
        let distance = lattice.relative(&head.subtree_bounds).map_or(f64::INFINITY, |b| b.distance_to(DVec3::ZERO));
        placed.push(((distance.to_bits(), Reverse(head.cube.k()), *node, *part), task));
    }
    placed.sort_by_key(|(place, _)| *place);
    Ok(placed.into_iter().map(|(_, task)| task).collect())
}

/// The same sequence of parts, of which only the matching points count; then, where their first points do not match, the first
/// ones of the parts below that do: as if there were no others.
///
/// Of each part also the points that do not match are looked at: they say where a coarse point is missing.
fn filtered_view(
    plan: &Plan,
    camera: &Camera,
    max_error_px: f64,
    finest: Option<u8>,
    capacity: Option<u64>,
) -> Result<(Vec<Task>, Answer), QueryError> {
    let begin = || {
        let may = |node: &Node| Ok::<_, QueryError>(plan.prospect(node, Scope::Subtree)? != Prospect::Nothing);
        let cut = ViewCut::new(&plan.nodes, &plan.lattice, plan.g, camera, max_error_px, may)?;
        Ok::<_, QueryError>(cut.no_finer_than(finest))
    };
    let mut cut = begin()?;
    let mut taken = Taken { left: capacity.unwrap_or(u64::MAX), missed: Some(Vec::new()), ..Taken::default() };
    while taken.left > 0 {
        plan.cancel.check()?;
        let window = std::iter::from_fn(|| cut.advance().transpose()).take(VIEW_WINDOW);
        let window: Vec<(Node, usize)> = window.collect::<Result<_, _>>()?;
        if window.is_empty() {
            break;
        }
        let matched = plan.each(window.clone(), |(node, part)| matching(plan, &node, part))?;
        for ((node, part), matched) in window.iter().zip(matched) {
            if taken.left > 0 {
                taken.part(node, *part, matched);
            }
        }
    }
    Meter::add(&plan.meter.nodes_visited, cut.visited());
    if taken.left == 0 {
        // The window went on beyond what was taken: again as far as that.
        cut = begin()?;
        for _ in 0..taken.looked.len() {
            cut.advance()?;
        }
        if taken.cut_short {
            cut.take_back();
        }
    }
    let gaps = cut.gaps();
    taken.returned.sort_unstable();
    let holes = taken.holes(plan, &gaps)?;
    let open = if taken.left > 0 {
        taken.fill(plan, &gaps, holes, |cell| cut.sees(cell))?
    } else {
        let of_gap = |(i, cells): (usize, Vec<Key>)| cells.into_iter().map(move |cell| (i, cell));
        holes.into_iter().flat_map(of_gap).map(|(i, cell)| (gaps[i].layer, cell)).collect()
    };
    let complete = taken.left > 0 && open.is_empty() && (taken.total == 0 || gaps.is_empty());
    let (bound, px) = if complete || !taken.cut_short && cut.is_complete() {
        (Some(0.0), Some(0.0))
    } else {
        let mut bound = Bound::new(taken.returned, &gaps);
        bound.miss(&open);
        bound.finish(&plan.metric_within(), camera)
    };
    Ok((taken.tasks, Answer { points: taken.total, error_bound: bound, error_bound_px: px, ..Answer::default() }))
}

/// What was taken for a view under a filter.
#[derive(Default)]
struct Taken {
    /// Points that may still be taken.
    left: u64,
    total: u64,
    tasks: Vec<Task>,
    /// The keys of the points that were.
    returned: Vec<Key>,
    /// Points that do not match; `None` if they are too many to be kept.
    missed: Option<Vec<Missed>>,
    /// The parts that were looked at.
    looked: Vec<(NodeIx, usize)>,
    /// The last part is not wholly taken.
    cut_short: bool,
}

impl Taken {
    /// Takes the matching points of a part, as far as there is room.
    fn part(&mut self, node: &Node, part: usize, matched: Matching) {
        self.looked.push((node.ix(), part));
        let Matching { mut indices, mut keys, missed: more } = matched;
        self.missed = self.missed.take().filter(|all| all.len() + more.len() <= MOST_MISSED);
        if let Some(missed) = &mut self.missed {
            missed.extend(more);
        }
        let all = node.parts[part].points;
        if indices.len() as u64 > self.left {
            self.cut_short = true;
            let place = |i: u32| indices.binary_search(&i).ok();
            let mut some: Vec<usize> = even_order(all).filter_map(place).take(self.left as usize).collect();
            some.sort_unstable();
            keys = some.iter().map(|&i| keys[i]).collect();
            indices = some.into_iter().map(|i| indices[i]).collect();
        }
        self.left -= indices.len() as u64;
        self.total += indices.len() as u64;
        self.returned.extend(keys);
        if !indices.is_empty() {
            self.tasks.push(Task::Picked { node: node.ix(), part, points: all, indices: Some(indices) });
        }
    }

    /// The cells of each gap in which a point does not match and none was returned.
    fn holes(&mut self, plan: &Plan, gaps: &[Gap]) -> Result<Vec<(usize, Vec<Key>)>, QueryError> {
        let mut holes = Holes::new(gaps);
        if let Some(missed) = self.missed.take() {
            holes.miss(missed.into_iter());
            return Ok(holes.empty(&self.returned));
        }
        for window in self.looked.chunks(VIEW_WINDOW) {
            plan.cancel.check()?;
            let missed = plan.each(window.to_vec(), |(node, part)| {
                let node = plan.nodes.node(node)?;
                let (cube, layer) = (node.cube, node.layer);
                let meets =
                    |gap: &Gap| gap.layer == layer && (gap.cube.contains_cube(cube) || cube.contains_cube(gap.cube));
                if gaps.iter().any(meets) { Ok(matching(plan, &node, part)?.missed) } else { Ok(Vec::new()) }
            })?;
            holes.miss(missed.into_iter().flatten());
        }
        Ok(holes.empty(&self.returned))
    }

    /// Takes the first matching points of the holes that are `seen` from what lies below, gap by gap as far as there is room;
    /// gives the cells whose points there was no room for.
    fn fill(
        &mut self,
        plan: &Plan,
        gaps: &[Gap],
        holes: Vec<(usize, Vec<Key>)>,
        seen: impl Fn(&LatticeBox) -> bool,
    ) -> Result<Vec<Missed>, QueryError> {
        let mut open: Vec<Missed> = Vec::new();
        let searched: Vec<(&Gap, u8, Vec<Key>)> = holes
            .into_iter()
            .filter_map(|(i, mut cells)| {
                let c = gaps[i].cell?;
                cells.retain(|cell| seen(&Cube::containing(cell.point(), c).to_box()));
                (!cells.is_empty()).then_some((&gaps[i], c, cells))
            })
            .collect();
        for window in searched.chunks(VIEW_WINDOW) {
            if self.left == 0 {
                open.extend(window.iter().flat_map(|(gap, _, cells)| cells.iter().map(|&cell| (gap.layer, cell))));
                continue;
            }
            let found = plan.each(window.iter().collect(), |(gap, c, cells)| {
                let mut holes: Vec<Hole> = cells.iter().map(|&cell| Hole::new(cell, *c, None)).collect();
                fill_child(plan, &plan.nodes.node(gap.node)?, *c, &mut holes)?;
                Ok(holes.into_iter().filter_map(|hole| hole.found).collect::<Vec<Pick>>())
            })?;
            for ((gap, c, _), mut picks) in window.iter().zip(found) {
                let all = picks.len() as u64;
                if all > self.left {
                    let mut order: Vec<usize> = even_order(all as u32).map(|i| i as usize).collect();
                    let left = order.split_off(self.left as usize);
                    open.extend(left.into_iter().map(|i| (gap.layer, picks[i].key.floor(*c))));
                    order.sort_unstable();
                    picks = order.into_iter().map(|i| picks[i]).collect();
                }
                self.left -= picks.len() as u64;
                self.total += picks.len() as u64;
                self.returned.extend(picks.iter().map(|pick| pick.key));
                picks.sort_unstable_by_key(|pick| (pick.node, pick.part, pick.index));
                for same in picks.chunk_by(|a, b| (a.node, a.part) == (b.node, b.part)) {
                    let (node, part) = (same[0].node, same[0].part as usize);
                    let points = plan.nodes.node(node)?.parts[part].points;
                    let indices = Some(same.iter().map(|pick| pick.index).collect());
                    self.tasks.push(Task::Picked { node, part, points, indices });
                }
            }
        }
        Ok(open)
    }
}

/// What was found in a part.
struct Matching {
    /// The points that match, ascending, and their keys.
    indices: Vec<u32>,
    keys: Vec<Key>,
    /// The keys of those that do not, as far as something may match in their cells.
    missed: Vec<Missed>,
}

fn matching(plan: &Plan, node: &Node, part: usize) -> Result<Matching, QueryError> {
    // The largest cell whose first point may be in this part: a gap's cells are no larger. A root holds those of all cells.
    let of_own = (node.cube.k() + 1).saturating_sub(plan.g);
    let first = node.parts.get(part).map_or(0, |facts| facts.first_step.win.saturating_add(1).max(0) as u8);
    let cell = if node.is_root() { of_own.max(first).min(node.cube.k()) } else { of_own };
    let skips = |bounds: &LatticeBox| outside(plan)(&cells_of(bounds, cell));
    let look = Look { skips: &skips, misses: true, positions: true };
    let mut result = Matching { indices: Vec::new(), keys: Vec::new(), missed: Vec::new() };
    let mut part = Part::new(plan, node, part);
    for Found { block, content, mask } in part.find(&look)? {
        let first = part.blocks.range(block).start as u32;
        for (i, point) in content.positions.iter().enumerate() {
            if mask.contains(i) {
                result.indices.push(first + i as u32);
                result.keys.push(Key::of(point));
            } else {
                result.missed.push((node.layer, Key::of(point)));
            }
        }
    }
    Ok(result)
}

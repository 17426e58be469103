//! Running a query: full detail, a level or a capacity, a view.

use super::answer::{Answer, Meter, Stage};
use super::batches::{Batches, Prepared};
use super::capacity::{self, Chosen};
use super::cells::{Pick, cells_of};
use super::gaps::{self, Looked};
use super::part::{Found, Look, Part};
use super::plan::{Plan, Prospect, Scope};
use super::policy::{Policy, select_by_distance};
use super::stream::Source;
use super::thin::{self, Unit, Units};
use super::view::{RelativeLattice, ViewCut, select};
use super::{Query, QueryError, Region, Summary};
use crate::geometry::{Camera, Containment, DVec3};
use crate::lattice::{Key, LatticeBox};
use crate::octree::even_order;
use crate::points::Batch;
use crate::store::model::PartHead;
use crate::store::{Node, NodeIx, Snapshot};
use rayon::prelude::*;
use std::cmp::Reverse;
use std::ops::ControlFlow;
use std::sync::Arc;

/// What is read and handed on together.
pub(crate) enum Task {
    /// The matching points of a part.
    Part { node: NodeIx, part: usize, points: u32, prospect: Prospect },
    /// Some points of a part, of which all of `points` are read.
    Picked { node: NodeIx, part: usize, points: u32, indices: Option<Vec<u32>> },
    /// The points of a level in a subtree.
    Unit(Unit),
}

/// Parts that are matched together, in a view under a filter.
const VIEW_WINDOW: usize = 16;

impl Query {
    /// Runs the query and hands the points to `sink`, in an order that is always the same; `sink` may end it.
    ///
    /// # Errors
    ///
    /// [`QueryError`]: names that the store does not have, numbers that make no sense, a store that cannot be read. Then
    /// the sink may already have had some batches.
    pub fn run(
        &self,
        snapshot: &Snapshot,
        mut sink: impl FnMut(Batch) -> ControlFlow<()>,
    ) -> Result<Answer, QueryError> {
        let mut batches = self.batches(snapshot)?;
        while let Some(batch) = batches.next() {
            let batch = batch?;
            if batches.plan().meter.time(Stage::Delivering, || sink(batch)).is_break() {
                break;
            }
        }
        Ok(batches.answer())
    }

    /// The points as an iterator of batches, in an order that is always the same. Only what is asked for is read, and a
    /// little ahead; dropping it ends the query.
    ///
    /// ```
    /// use esker::lattice::Lattice;
    /// use esker::query::Query;
    /// use esker::store::{SiteOptions, Store};
    ///
    /// # let store = Store::in_memory(SiteOptions::new(Lattice::uniform(0.001)?))?;
    /// let mut batches = Query::new().batches(&store.snapshot()?)?;
    /// let mut points = 0;
    /// for batch in &mut batches {
    ///     points += batch?.len() as u64;
    /// }
    /// assert_eq!(batches.answer().points, points);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    ///
    /// As [`Query::run`]; what goes wrong later is an item of the iterator, its last.
    pub fn batches(&self, snapshot: &Snapshot) -> Result<Batches, QueryError> {
        Ok(Batches::new(self.prepare(snapshot, false)?))
    }

    /// Folds the points on all threads: every batch into a fresh `zero` by `add`, and these into the first, in the order
    /// of the batches, by `merge`. So the result does not depend on the threads.
    ///
    /// ```
    /// use esker::lattice::Lattice;
    /// use esker::query::Query;
    /// use esker::store::{SiteOptions, Store};
    ///
    /// # let store = Store::in_memory(SiteOptions::new(Lattice::uniform(0.001)?))?;
    /// let highest = |a: &mut u64, b: u64| *a = (*a).max(b);
    /// let add = |top: &mut u64, batch: esker::points::Batch| {
    ///     batch.positions.z.iter().for_each(|&z| highest(top, z));
    /// };
    /// let (top, answer) = Query::new().positions_only().fold(&store.snapshot()?, || 0, add, highest)?;
    /// assert_eq!((top, answer.points), (0, 0));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    ///
    /// As [`Query::run`].
    pub fn fold<A: Send>(
        &self,
        snapshot: &Snapshot,
        zero: impl Fn() -> A + Sync,
        add: impl Fn(&mut A, Batch) + Sync,
        mut merge: impl FnMut(&mut A, A),
    ) -> Result<(A, Answer), QueryError> {
        let Prepared { plan, mut source, mut answer } = self.prepare(snapshot, false)?;
        let mut all = zero();
        answer.points = 0;
        loop {
            let window: Vec<Task> = source.by_ref().take(plan.window()).collect::<Result<_, _>>()?;
            if window.is_empty() {
                break;
            }
            let folded = plan.each(window, |task| {
                let batch = work(&plan, task)?;
                let (points, mut one) = (batch.len() as u64, zero());
                if points > 0 {
                    add(&mut one, batch);
                }
                Ok((points, one))
            })?;
            for (points, one) in folded.into_iter().filter(|f| f.0 > 0) {
                answer.points += points;
                merge(&mut all, one);
            }
        }
        Ok((all, plan.finish(answer)))
    }

    /// Counts the points, and reads only what that needs.
    ///
    /// # Errors
    ///
    /// As [`Query::run`].
    pub fn count(&self, snapshot: &Snapshot) -> Result<Answer, QueryError> {
        let Prepared { plan, mut source, mut answer } = self.prepare(snapshot, true)?;
        loop {
            let window: Vec<Task> = source.by_ref().take(plan.window()).collect::<Result<_, _>>()?;
            if window.is_empty() {
                return Ok(plan.finish(answer));
            }
            answer.points += plan.each(window, |task| count(&plan, &task))?.into_iter().sum::<u64>();
        }
    }

    /// Runs the query and gives all its points as one batch.
    ///
    /// # Errors
    ///
    /// As [`Query::run`].
    pub fn collect(&self, snapshot: &Snapshot) -> Result<(Batch, Answer), QueryError> {
        let mut batches = self.batches(snapshot)?;
        let mut all = Batch::empty(batches.attributes().clone());
        for batch in &mut batches {
            let batch = batch?;
            if all.is_empty() {
                all = batch;
            } else {
                all.append(&batch);
            }
        }
        Ok((all, batches.answer()))
    }

    /// An empty summary for the batches of this query. They must carry their scans ([`Query::with_scans`]) if some scan
    /// lacks an attribute.
    ///
    /// # Errors
    ///
    /// As [`Query::run`].
    pub fn summary(&self, snapshot: &Snapshot) -> Result<Summary, QueryError> {
        let plan = Plan::new(self, snapshot)?;
        let scans = snapshot.scans();
        Ok(Summary::new(&plan.lattice, &plan.columns, |column| {
            let having: Vec<_> = scans.iter().filter(|s| s.attributes.contains(&column.id)).map(|s| s.id).collect();
            (having.len() < scans.len()).then_some(having)
        }))
    }

    /// Decides what is to be read. When the points are only counted, those that are known already are in the answer.
    fn prepare(&self, snapshot: &Snapshot, counting: bool) -> Result<Prepared, QueryError> {
        let mut plan = Plan::new(self, snapshot)?;
        let root = plan.root();
        let cell = self.detail.cell(root, plan.g, plan.lattice.quantum_f64())?;
        let listed = |plan: &mut Plan, (tasks, answer): (Vec<Task>, Answer)| {
            plan.reads(tasks.iter().map(points).sum());
            let tasks: Source<Task> = Box::new(tasks.into_iter().map(Ok));
            (tasks, answer)
        };
        let (source, answer) = match (&self.view, cell, self.capacity) {
            (Some((camera, max_error_px)), ..) => {
                if !(0.0..).contains(max_error_px) {
                    let (what, value) = ("the pixel error", *max_error_px);
                    return Err(QueryError::Detail { what, value, expected: "0 or more" });
                }
                let chosen = view(&plan, self, camera, *max_error_px, cell, counting)?;
                listed(&mut plan, chosen)
            }
            (None, None, None) => {
                let all = everything(&mut plan, &self.region, counting)?;
                listed(&mut plan, all)
            }
            (None, Some(cell), None) => match plan.roots.as_slice() {
                [root] => {
                    let bound = plan.metric().step_bound(cell as i8, 7);
                    let root = root.clone();
                    let plan = Arc::new(plan);
                    let units: Source<Task> = Box::new(Units::new(plan.clone(), root, cell));
                    return Ok(Prepared { plan, source: units, answer: answer(0, Some(bound)) });
                }
                // The least of a cell may be of any layer.
                _ => {
                    let chosen = plan.meter.time(Stage::Selecting, || capacity::level(&plan, cell))?;
                    let chosen = picked(&plan, chosen, counting)?;
                    listed(&mut plan, chosen)
                }
            },
            (None, cell, Some(capacity)) => {
                let enough = cell.is_none() && plan.most_points()?.all <= capacity;
                let chosen = if enough {
                    everything(&mut plan, &self.region, counting)?
                } else {
                    let chosen = plan.meter.time(Stage::Selecting, || capacity::limited(&plan, cell, capacity))?;
                    picked(&plan, chosen, counting)?
                };
                listed(&mut plan, chosen)
            }
        };
        Ok(Prepared { plan: Arc::new(plan), source, answer })
    }
}

/// Does a task.
pub(crate) fn work(plan: &Plan, task: Task) -> Result<Batch, QueryError> {
    plan.cancel.check()?;
    match task {
        Task::Part { node, part, prospect, .. } => {
            let mut part = Part::at(plan, node, part)?;
            if prospect == Prospect::Everything {
                return if plan.keeps_blocks { part.gather(None) } else { part.whole() };
            }
            let found = part.find(&Look { skips: &outside(plan), misses: false, positions: true })?;
            part.take(&found)
        }
        Task::Picked { node, part, points, indices } => {
            let mut part = Part::at(plan, node, part)?;
            match indices {
                Some(indices) if indices.len() < points as usize => part.gather(Some(&indices)),
                _ if plan.keeps_blocks => part.gather(None),
                _ => part.whole(),
            }
        }
        Task::Unit(unit) => thin::batch(plan, &unit),
    }
}

/// The points that a task takes in, for keeping memory bounded.
pub(crate) fn points(task: &Task) -> u64 {
    match task {
        Task::Part { points, .. } | Task::Picked { points, .. } => u64::from(*points),
        Task::Unit(unit) => unit.points(),
    }
}

/// The points that a task would give.
fn count(plan: &Plan, task: &Task) -> Result<u64, QueryError> {
    plan.cancel.check()?;
    match task {
        Task::Part { node, part, .. } => {
            let found =
                Part::at(plan, *node, *part)?.find(&Look { skips: &outside(plan), misses: false, positions: false })?;
            Ok(found.iter().map(|f| f.mask.count() as u64).sum())
        }
        Task::Picked { points, indices, .. } => Ok(indices.as_ref().map_or(u64::from(*points), |i| i.len() as u64)),
        Task::Unit(unit) => Ok(thin::picks(plan, unit)?.len() as u64),
    }
}

fn answer(points: u64, error_bound: Option<f64>) -> Answer {
    Answer { points, error_bound, ..Answer::default() }
}

fn outside(plan: &Plan) -> impl Fn(&LatticeBox) -> bool + '_ {
    |bounds| plan.region.classify(bounds) == Containment::Outside
}

/// Every matching point.
fn everything(plan: &mut Plan, region: &Region, counting: bool) -> Result<(Vec<Task>, Answer), QueryError> {
    if matches!(region, Region::Box { .. }) {
        plan.count_faces(region)?;
    }
    let plan = &*plan;
    let mut tasks = Vec::new();
    let mut known = 0;
    plan.meter.time(Stage::Selecting, || {
        plan.walk(|node| {
            let prospect = plan.prospect(node, Scope::Own)?;
            if prospect == Prospect::Everything && counting {
                known += node.own_points;
            } else if prospect != Prospect::Nothing {
                Meter::add(&plan.meter.nodes, 1);
                let k = node.cube.k();
                let task = |(part, facts): (usize, &PartHead)| {
                    let (node, points) = (node.ix(), facts.points);
                    (k, Task::Part { node, part, points, prospect })
                };
                tasks.extend(node.parts.iter().enumerate().map(task));
            }
            Ok(true)
        })
    })?;
    coarse_first(&mut tasks);
    Ok((tasks.into_iter().map(|(_, task)| task).collect(), answer(known, Some(0.0))))
}

/// Coarse to fine, so that who stops early has all of it thinned; nodes of one size keep the order of the tree.
fn coarse_first(tasks: &mut [(u8, Task)]) {
    tasks.sort_by_key(|(k, _)| Reverse(*k));
}

/// Points that were chosen by their places.
fn picked(plan: &Plan, chosen: Chosen, counting: bool) -> Result<(Vec<Task>, Answer), QueryError> {
    let Chosen { mut picks, error_bound } = chosen;
    let answer = answer(picks.len() as u64, error_bound);
    if counting {
        return Ok((Vec::new(), answer));
    }
    picks.par_sort_unstable_by_key(|p| (p.node, p.part, p.index));
    let mut tasks = Vec::new();
    for task in by_part(plan, &picks)? {
        let Task::Picked { node, .. } = &task else { continue };
        tasks.push((plan.nodes.node(*node)?.cube.k(), task));
    }
    coarse_first(&mut tasks);
    let tasks: Vec<Task> = tasks.into_iter().map(|(_, task)| task).collect();
    let node = |task: &Task| match task {
        Task::Picked { node, .. } => Some(*node),
        _ => None,
    };
    Meter::add(&plan.meter.nodes, tasks.chunk_by(|a, b| node(a) == node(b)).count() as u64);
    Ok((tasks, answer))
}

/// A task for each part; the picks are in the order of the parts.
pub(crate) fn by_part(plan: &Plan, picks: &[Pick]) -> Result<Vec<Task>, QueryError> {
    let same = |a: &Pick, b: &Pick| (a.node, a.part) == (b.node, b.part);
    picks
        .chunk_by(same)
        .map(|run| {
            let (node, part) = (run[0].node, run[0].part as usize);
            let points = plan.nodes.node(node)?.parts[part].points;
            Ok(Task::Picked { node, part, points, indices: Some(run.iter().map(|p| p.index).collect()) })
        })
        .collect()
}

/// What a camera needs.
fn view(
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

/// The same sequence of parts, of which only the matching points count.
///
/// Of each part also the points that do not match are looked at: they say where a coarse point is missing, and so how far
/// what was left out can be from what was returned.
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
    let mut looked = Looked::default();
    let mut tasks: Vec<Task> = Vec::new();
    let mut left = capacity.unwrap_or(u64::MAX);
    let (mut total, mut parts, mut cut_short) = (0, 0_usize, false);
    while left > 0 {
        let window = std::iter::from_fn(|| cut.advance().transpose()).take(VIEW_WINDOW);
        let window: Vec<(Node, usize)> = window.collect::<Result<_, _>>()?;
        if window.is_empty() {
            break;
        }
        let matched = plan.each(window.clone(), |(node, part)| matching(plan, &node, part))?;
        for ((node, part), matched) in window.iter().zip(matched) {
            if left == 0 {
                break;
            }
            parts += 1;
            let Matching { mut indices, mut keys, missed } = matched;
            looked.missed.extend(missed);
            let all = node.parts[*part].points;
            if indices.len() as u64 > left {
                cut_short = true;
                let place = |i: u32| indices.binary_search(&i).ok();
                let mut some: Vec<usize> = even_order(all).filter_map(place).take(left as usize).collect();
                some.sort_unstable();
                keys = some.iter().map(|&i| keys[i]).collect();
                indices = some.into_iter().map(|i| indices[i]).collect();
            }
            left -= indices.len() as u64;
            total += indices.len() as u64;
            looked.returned.extend(keys);
            if !indices.is_empty() {
                tasks.push(Task::Picked { node: node.ix(), part: *part, points: all, indices: Some(indices) });
            }
        }
    }
    Meter::add(&plan.meter.nodes_visited, cut.visited());
    if left == 0 {
        // The window went on beyond what was taken: again as far as that.
        cut = begin()?;
        for _ in 0..parts {
            cut.advance()?;
        }
        if cut_short {
            cut.take_back();
        }
    }
    let complete = !cut_short && cut.is_complete();
    let gaps = cut.gaps();
    let (bound, px) =
        if complete { (Some(0.0), Some(0.0)) } else { gaps::bound(looked, &gaps, &plan.metric(), camera) };
    Ok((tasks, Answer { points: total, error_bound: bound, error_bound_px: px, ..Answer::default() }))
}

/// What was found in a part.
struct Matching {
    /// The points that match, ascending, and their keys.
    indices: Vec<u32>,
    keys: Vec<Key>,
    /// The keys of those that do not, as far as something may match in their cells.
    missed: Vec<(u16, Key)>,
}

fn matching(plan: &Plan, node: &Node, part: usize) -> Result<Matching, QueryError> {
    let cell = node.cube.k().saturating_sub(plan.g);
    let skips = |bounds: &LatticeBox| outside(plan)(&cells_of(bounds, cell));
    let look = Look { skips: &skips, misses: true, positions: true };
    let mut result = Matching { indices: Vec::new(), keys: Vec::new(), missed: Vec::new() };
    for Found { block, content, mask } in Part::new(plan, node, part).find(&look)? {
        let first = (block * crate::codec::BLOCK_POINTS) as u32;
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

//! Running a query: full detail, a level or a capacity, a view.

use super::answer::{Answer, Meter, Stage};
use super::capacity::{self, Chosen};
use super::cells::Pick;
use super::part::{Found, Look, Part};
use super::pipeline::deliver;
use super::plan::{Plan, Prospect, Scope};
use super::view::{ViewCut, select_view};
use super::{Detail, Query, QueryError, Region, Summary};
use crate::geometry::{Camera, Containment};
use crate::lattice::LatticeBox;
use crate::octree::even_order;
use crate::points::Batch;
use crate::store::{NodeIx, Snapshot};
use rayon::prelude::*;
use std::ops::ControlFlow;
use std::sync::atomic::Ordering;
use std::time::Instant;

/// Where points go; `None`: they are only counted.
type Sink<'a> = Option<&'a mut dyn FnMut(Batch) -> ControlFlow<()>>;

/// A part to be read, and what is known of its points.
struct Task {
    node: NodeIx,
    part: usize,
    prospect: Prospect,
}

/// Points of one part.
struct Picked {
    node: NodeIx,
    part: usize,
    /// Ascending; `None`: all.
    indices: Option<Vec<u32>>,
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
        self.execute(snapshot, Some(&mut sink))
    }

    /// Counts the points, and reads only what that needs.
    ///
    /// # Errors
    ///
    /// As [`Query::run`].
    pub fn count(&self, snapshot: &Snapshot) -> Result<Answer, QueryError> {
        self.execute(snapshot, None)
    }

    /// Runs the query and gives all its points as one batch.
    ///
    /// # Errors
    ///
    /// As [`Query::run`].
    pub fn collect(&self, snapshot: &Snapshot) -> Result<(Batch, Answer), QueryError> {
        let mut all: Option<Batch> = None;
        let answer = self.run(snapshot, |batch| {
            match &mut all {
                None => all = Some(batch),
                Some(all) => all.append(&batch),
            }
            ControlFlow::Continue(())
        })?;
        let batch = match all {
            Some(batch) => batch,
            None => Batch::empty(Plan::new(self, snapshot)?.attributes),
        };
        Ok((batch, answer))
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

    fn execute(&self, snapshot: &Snapshot, sink: Sink) -> Result<Answer, QueryError> {
        let start = Instant::now();
        let mut plan = Plan::new(self, snapshot)?;
        let root = plan.root();
        let cell = self.detail.cell(root, plan.g, plan.lattice.quantum_f64())?;
        let mut answer = match (&self.view, cell, self.capacity) {
            (Some((camera, max_error_px)), ..) => {
                if self.detail != Detail::Everything {
                    return Err(QueryError::Combination(
                        "a view has its detail in pixels; leave out the level, spacing or max error",
                    ));
                }
                if !(0.0..).contains(max_error_px) {
                    let (what, value) = ("the pixel error", *max_error_px);
                    return Err(QueryError::Detail { what, value, expected: "0 or more" });
                }
                run_view(&plan, camera, *max_error_px, self.capacity, sink)?
            }
            (None, None, None) => run_everything(&mut plan, &self.region, sink)?,
            (None, Some(cell), None) => {
                let chosen = plan.meter.time(Stage::Selecting, || capacity::level(&plan, cell))?;
                run_chosen(&plan, chosen, sink)?
            }
            (None, cell, Some(capacity)) => {
                let enough = cell.is_none() && plan.most_points()?.all <= capacity;
                if enough {
                    run_everything(&mut plan, &self.region, sink)?
                } else {
                    let chosen = plan.meter.time(Stage::Selecting, || capacity::limited(&plan, cell, capacity))?;
                    run_chosen(&plan, chosen, sink)?
                }
            }
        };
        answer.region_misses_site = plan.region_misses_site();
        answer.statistics = plan.meter.statistics(start.elapsed());
        Ok(answer)
    }
}

fn answer(points: u64, error_bound: Option<f64>) -> Answer {
    Answer { points, error_bound, ..Answer::default() }
}

fn outside(plan: &Plan) -> impl Fn(&LatticeBox) -> bool + '_ {
    |bounds| plan.region.classify(bounds) == Containment::Outside
}

/// Every matching point.
fn run_everything(plan: &mut Plan, region: &Region, sink: Sink) -> Result<Answer, QueryError> {
    let has_faces = matches!(region, Region::Box { .. });
    if has_faces {
        plan.count_faces(region)?;
    }
    let plan = &*plan;
    let mut tasks = Vec::new();
    let mut known = 0;
    let counting = sink.is_none();
    plan.meter.time(Stage::Selecting, || {
        plan.walk(|node| {
            let prospect = plan.prospect(node, Scope::Own)?;
            let head = plan.index.head(node);
            if prospect == Prospect::Everything && counting {
                known += head.own_points;
            } else if prospect != Prospect::Nothing {
                Meter::add(&plan.meter.nodes, 1);
                tasks.extend((0..head.parts.len()).map(|part| Task { node, part, prospect }));
            }
            Ok(true)
        })
    })?;
    let points = match sink {
        None => known + count(plan, &tasks)?,
        Some(sink) => {
            let work = |task: &Task| {
                let mut part = Part::new(plan, task.node, task.part)?;
                if task.prospect == Prospect::Everything {
                    return part.whole();
                }
                let look = Look { skips: &outside(plan), misses: false, positions: true };
                let found = part.find(&look)?;
                part.take(&found)
            };
            let points = |t: &Task| u64::from(plan.index.head(t.node).parts[t.part].points);
            deliver(&tasks, points, work, &plan.meter, sink)?
        }
    };
    let on_maximum_faces = has_faces.then(|| plan.meter.on_maximum_faces.load(Ordering::Relaxed));
    Ok(Answer { on_maximum_faces, ..answer(points, Some(0.0)) })
}

/// The matching points of these parts.
fn count(plan: &Plan, tasks: &[Task]) -> Result<u64, QueryError> {
    let counts = tasks.par_iter().map(|task| {
        let look = Look { skips: &outside(plan), misses: false, positions: false };
        let found = Part::new(plan, task.node, task.part)?.find(&look)?;
        Ok(found.iter().map(|f| f.mask.count() as u64).sum::<u64>())
    });
    // Collected before they are summed, so that of several errors it is always the first.
    Ok(counts.collect::<Result<Vec<_>, QueryError>>()?.into_iter().sum())
}

/// Points that were chosen by their places.
fn run_chosen(plan: &Plan, chosen: Chosen, sink: Sink) -> Result<Answer, QueryError> {
    let Chosen { mut picks, error_bound } = chosen;
    let points = picks.len() as u64;
    let Some(sink) = sink else { return Ok(answer(points, error_bound)) };
    picks.par_sort_unstable_by_key(|p| (p.node, p.part, p.index));
    let same = |a: &Pick, b: &Pick| (a.node, a.part) == (b.node, b.part);
    let tasks: Vec<Picked> = picks
        .chunk_by(same)
        .map(|run| Picked {
            node: run[0].node,
            part: run[0].part as usize,
            indices: Some(run.iter().map(|p| p.index).collect()),
        })
        .collect();
    let nodes = tasks.chunk_by(|a, b| a.node == b.node).count();
    Meter::add(&plan.meter.nodes, nodes as u64);
    let points = deliver_picked(plan, &tasks, sink)?;
    Ok(answer(points, error_bound))
}

fn deliver_picked(
    plan: &Plan,
    tasks: &[Picked],
    sink: &mut dyn FnMut(Batch) -> ControlFlow<()>,
) -> Result<u64, QueryError> {
    let work = |task: &Picked| {
        let mut part = Part::new(plan, task.node, task.part)?;
        let all = plan.index.head(task.node).parts[task.part].points as usize;
        match &task.indices {
            Some(indices) if indices.len() < all => part.gather(indices),
            _ => part.whole(),
        }
    };
    // What is read is the whole part.
    let points = |t: &Picked| u64::from(plan.index.head(t.node).parts[t.part].points);
    deliver(tasks, points, work, &plan.meter, sink)
}

/// What a camera needs.
fn run_view(
    plan: &Plan,
    camera: &Camera,
    max_error_px: f64,
    capacity: Option<u64>,
    sink: Sink,
) -> Result<Answer, QueryError> {
    let (tasks, mut answer) = if plan.is_unfiltered() && plan.region.is_everything() {
        let selection = plan
            .meter
            .time(Stage::Selecting, || select_view(&plan.index, &plan.lattice, plan.g, camera, max_error_px, capacity));
        Meter::add(&plan.meter.nodes_visited, selection.nodes_visited);
        let picked = selection.parts.iter().map(|selected| {
            let (node, part) = (selected.node, selected.part as usize);
            let all = plan.index.head(node).parts[part].points;
            let some = || {
                let mut indices: Vec<u32> = even_order(all).take(selected.points as usize).collect();
                indices.sort_unstable();
                indices
            };
            Picked { node, part, indices: (selected.points < all).then(some) }
        });
        let (bound, px) = (selection.error_bound, selection.error_bound_px);
        let answer = Answer { points: selection.points, error_bound: bound, error_bound_px: px, ..Answer::default() };
        // Only what is to be delivered is worth listing point by point.
        (if sink.is_some() { picked.collect() } else { Vec::new() }, answer)
    } else {
        plan.meter.time(Stage::Selecting, || filtered_view(plan, camera, max_error_px, capacity))?
    };
    if let Some(sink) = sink {
        let nodes: std::collections::BTreeSet<NodeIx> = tasks.iter().map(|t| t.node).collect();
        Meter::add(&plan.meter.nodes, nodes.len() as u64);
        answer.points = deliver_picked(plan, &tasks, sink)?;
    }
    Ok(answer)
}

/// The same sequence of parts, of which only the matching points count.
///
/// A point that stands for others may be one that does not match, so there is no bound unless all that is visible is
/// taken.
fn filtered_view(
    plan: &Plan,
    camera: &Camera,
    max_error_px: f64,
    capacity: Option<u64>,
) -> Result<(Vec<Picked>, Answer), QueryError> {
    let mut failure = None;
    let may = |node| match plan.prospect(node, Scope::Subtree) {
        Ok(prospect) => prospect != Prospect::Nothing,
        Err(error) => {
            failure.get_or_insert(error);
            false
        }
    };
    let mut cut = ViewCut::new(&plan.index, &plan.lattice, plan.g, camera, max_error_px, may);
    let mut tasks: Vec<Picked> = Vec::new();
    let mut left = capacity.unwrap_or(u64::MAX);
    let mut total = 0;
    let mut cut_short = false;
    while left > 0 {
        let window: Vec<(NodeIx, usize)> = std::iter::from_fn(|| cut.advance()).take(VIEW_WINDOW).collect();
        if window.is_empty() {
            break;
        }
        let matched = window.par_iter().map(|&(node, part)| matching_indices(plan, node, part));
        for (&(node, part), indices) in window.iter().zip(matched.collect::<Result<Vec<_>, _>>()?) {
            if indices.is_empty() {
                continue;
            }
            if left == 0 {
                cut_short = true;
                break;
            }
            let indices = if indices.len() as u64 > left {
                cut_short = true;
                let all = plan.index.head(node).parts[part].points;
                let matches = |i: &u32| indices.binary_search(i).is_ok();
                let mut some: Vec<u32> = even_order(all).filter(matches).take(left as usize).collect();
                some.sort_unstable();
                some
            } else {
                indices
            };
            left -= indices.len() as u64;
            total += indices.len() as u64;
            tasks.push(Picked { node, part, indices: Some(indices) });
        }
    }
    let complete = !cut_short && cut.is_complete();
    Meter::add(&plan.meter.nodes_visited, cut.visited());
    drop(cut);
    if let Some(error) = failure {
        return Err(error);
    }
    let bound = complete.then_some(0.0);
    Ok((tasks, Answer { points: total, error_bound: bound, error_bound_px: bound, ..Answer::default() }))
}

/// The points of a part that match, by index, ascending.
fn matching_indices(plan: &Plan, node: NodeIx, part: usize) -> Result<Vec<u32>, QueryError> {
    let look = Look { skips: &outside(plan), misses: false, positions: false };
    let found = Part::new(plan, node, part)?.find(&look)?;
    let indices = found.iter().flat_map(|Found { block, mask, .. }| {
        let first = (block * crate::codec::BLOCK_POINTS) as u32;
        mask.indices().into_iter().map(move |i| first + i)
    });
    Ok(indices.collect())
}

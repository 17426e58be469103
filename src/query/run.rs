//! Running a query: full detail, a level or a capacity, a view.

use super::answer::{Answer, Meter, Stage};
use super::batches::{Batches, Prepared};
use super::capacity::{self, Sequence};
use super::plan::{Plan, Prospect, Scope};
use super::seen;
use super::stream::{Source, Stream};
use super::task::{Task, count, points, work};
use super::{Policy, Query, QueryError, Region};
use crate::points::Batch;
use crate::store::model::PartHead;
use crate::store::{Node, Snapshot};
use std::cmp::Reverse;
use std::ops::ControlFlow;
use std::sync::Arc;

impl Query {
    /// Runs the query and hands the points to `sink`, in an order that is always the same; `sink` may end it, after
    /// which the answer has no error bound.
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
                return Ok(batches.answer());
            }
        }
        Ok(batches.answer())
    }

    /// As [`Query::run`], but every batch is first made something else by `map`, on the threads that decode.
    ///
    /// # Errors
    ///
    /// As [`Query::run`].
    pub fn run_mapped<R: Send + 'static>(
        &self,
        snapshot: &Snapshot,
        map: impl Fn(Batch) -> R + Send + Sync + 'static,
        mut sink: impl FnMut(R) -> ControlFlow<()>,
    ) -> Result<Answer, QueryError> {
        let Prepared { plan, source, mut answer } = self.prepare(snapshot, false)?;
        answer.points = 0;
        let here = plan.clone();
        let stream = Stream::new(source, points, plan.threads, plan.cancel.clone(), move |task| {
            let batch = work(&here, task)?;
            let points = batch.len() as u64;
            Ok((points, (points > 0).then(|| here.meter.time(Stage::Delivering, || map(batch)))))
        });
        for mapped in stream {
            let (points, Some(mapped)) = mapped? else { continue };
            answer.points += points;
            if plan.meter.time(Stage::Delivering, || sink(mapped)).is_break() {
                return Ok(plan.finish(answer.cut_short()));
            }
        }
        Ok(plan.finish(answer))
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

    /// Decides what is to be read. When the points are only counted, those that are known already are in the answer.
    fn prepare(&self, snapshot: &Snapshot, counting: bool) -> Result<Prepared, QueryError> {
        if self.view.is_none() && self.policy != Policy::default() {
            return Err(QueryError::Combination("a policy is about a view; give the query one, or no policy"));
        }
        let mut plan = Plan::new(self, snapshot)?;
        let root = plan.root();
        let cell = self.detail.cell(root, plan.g, plan.lattice.quantum_f64())?;
        let listed = |plan: &mut Plan, (tasks, answer): (Vec<Task>, Answer)| {
            let all = tasks.iter().map(points).sum();
            plan.reads(all);
            plan.expects(all);
            let tasks: Source<Task> = Box::new(tasks.into_iter().map(Ok));
            (tasks, answer)
        };
        let (source, answer) = match (&self.view, cell, self.capacity) {
            (Some((camera, max_error_px)), ..) => {
                if !(0.0..).contains(max_error_px) {
                    let (what, value) = ("the pixel error", *max_error_px);
                    return Err(QueryError::Detail { what, value, expected: "0 or more" });
                }
                let chosen = seen::view(&plan, self, camera, *max_error_px, cell, counting)?;
                listed(&mut plan, chosen)
            }
            (None, cell, capacity) => match thinned(&mut plan, cell, capacity, counting)? {
                None => {
                    let all = everything(&mut plan, &self.region, counting)?;
                    listed(&mut plan, all)
                }
                Some(mut sequence) => {
                    let plan = Arc::new(plan);
                    let answer = answer(sequence.points.unwrap_or(0), sequence.error_bound);
                    let source: Source<Task> = if counting && sequence.points.is_some() {
                        Box::new(std::iter::empty())
                    } else {
                        let held = sequence.held(&plan)?;
                        let pieces = sequence.tasks(plan.clone()).map(|task| Ok(Task::Piece(task?)));
                        Box::new(held.into_iter().map(Ok).chain(pieces))
                    };
                    return Ok(Prepared { plan, source, answer });
                }
            },
        };
        Ok(Prepared { plan: Arc::new(plan), source, answer })
    }
}

fn answer(points: u64, error_bound: Option<f64>) -> Answer {
    Answer { points, error_bound, ..Answer::default() }
}

/// The points of a level, under a capacity, or both; `None` if those are all that match.
fn thinned(
    plan: &mut Plan,
    cell: Option<u8>,
    capacity: Option<u64>,
    counting: bool,
) -> Result<Option<Sequence>, QueryError> {
    let sequence = match (cell, capacity) {
        (None, None) => return Ok(None),
        (Some(cell), None) => {
            plan.reads(plan.most_points(Some(cell))?.at_level(cell));
            plan.meter.time(Stage::Selecting, || capacity::level(plan, cell, !counting))?
        }
        (cell, Some(capacity)) => {
            if cell.is_none() && plan.most_points(None)?.all <= capacity {
                return Ok(None);
            }
            plan.reads(capacity);
            plan.meter.time(Stage::Selecting, || capacity::limited(plan, cell, capacity))?
        }
    };
    Ok(Some(sequence).filter(|sequence| !sequence.is_everything))
}

/// Every matching point.
fn everything(plan: &mut Plan, region: &Region, counting: bool) -> Result<(Vec<Task>, Answer), QueryError> {
    if region.is_of_boxes() {
        plan.count_faces(region)?;
    }
    let plan = &*plan;
    let mut tasks = Vec::new();
    let mut known = 0;
    plan.meter.time(Stage::Selecting, || {
        plan.walk(|node| {
            if counting && plan.prospect(node, Scope::Own)? == Prospect::Everything {
                known += node.own_points;
            } else {
                parts_of(plan, node, &mut tasks)?;
            }
            Ok(true)
        })
    })?;
    coarse_first(&mut tasks);
    Ok((tasks.into_iter().map(|(_, task)| task).collect(), answer(known, Some(0.0))))
}

/// The parts of a node, as far as something in them may match.
fn parts_of(plan: &Plan, node: &Node, tasks: &mut Vec<(u8, Task)>) -> Result<(), QueryError> {
    let prospect = plan.prospect(node, Scope::Own)?;
    if prospect != Prospect::Nothing {
        Meter::add(&plan.meter.nodes, 1);
        let (k, ix) = (node.cube.k(), node.ix());
        let task =
            |(part, facts): (usize, &PartHead)| (k, Task::Part { node: ix, part, points: facts.points, prospect });
        tasks.extend(node.parts.iter().enumerate().map(task));
    }
    Ok(())
}

/// Coarse to fine, so that who stops early has all of it thinned; nodes of one size keep the order of the tree.
fn coarse_first(tasks: &mut [(u8, Task)]) {
    tasks.sort_by_key(|(k, _)| Reverse(*k));
}

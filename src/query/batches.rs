//! An answer as an iterator of batches.

use super::QueryError;
use super::answer::Answer;
use super::plan::Plan;
use super::stream::{Source, Stream};
use super::task::{Task, points, work};
use crate::points::{Attribute, Batch};
use std::sync::Arc;

/// A query that has been decided but not read.
pub(crate) struct Prepared {
    pub plan: Arc<Plan>,
    pub source: Source<Task>,
    pub answer: Answer,
}

/// The batches of an answer: see [`Query::batches`](super::Query::batches). None of them is empty.
pub struct Batches {
    plan: Arc<Plan>,
    stream: Stream<Task, Batch>,
    answer: Answer,
}

impl Batches {
    pub(crate) fn new(prepared: Prepared) -> Self {
        let Prepared { plan, source, answer } = prepared;
        let here = plan.clone();
        let stream = Stream::new(source, points, plan.threads, move |task| work(&here, task));
        Self { plan, stream, answer: Answer { points: 0, ..answer } }
    }

    pub(crate) fn plan(&self) -> &Plan {
        &self.plan
    }

    /// What every batch's columns hold.
    pub fn attributes(&self) -> &Arc<[Attribute]> {
        &self.plan.attributes
    }

    /// The report: the points that were handed on so far, and what they cost. The error bound holds once the last batch is
    /// there.
    pub fn answer(&self) -> Answer {
        self.plan.finish(self.answer.clone())
    }
}

impl Iterator for Batches {
    type Item = Result<Batch, QueryError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            match self.stream.next()? {
                Ok(batch) if batch.is_empty() => {}
                Ok(batch) => {
                    self.answer.points += batch.len() as u64;
                    return Some(Ok(batch));
                }
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

impl std::fmt::Debug for Batches {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Batches").field("answer", &self.answer).finish_non_exhaustive()
    }
}

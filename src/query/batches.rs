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
    is_complete: bool,
    has_failed: bool,
}

impl Batches {
    pub(crate) fn new(prepared: Prepared) -> Self {
        let Prepared { plan, source, answer } = prepared;
        let here = plan.clone();
        let stream = Stream::new(source, points, plan.threads, plan.cancel.clone(), move |task| work(&here, task));
        Self { plan, stream, answer: Answer { points: 0, ..answer }, is_complete: false, has_failed: false }
    }

    pub(crate) fn plan(&self) -> &Plan {
        &self.plan
    }

    /// What every batch's columns hold.
    pub fn attributes(&self) -> &Arc<[Attribute]> {
        &self.plan.attributes
    }

    /// The report: the points that were handed on so far, and what they cost. There is an error bound once `next` has given
    /// `None`: some points may be missing before.
    pub fn answer(&self) -> Answer {
        let answer = self.answer.clone();
        self.plan.finish(if self.is_complete { answer } else { answer.cut_short() })
    }
}

impl Iterator for Batches {
    type Item = Result<Batch, QueryError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let Some(next) = self.stream.next() else {
                self.is_complete = !self.has_failed;
                return None;
            };
            match next {
                Ok(batch) if batch.is_empty() => {}
                Ok(batch) => {
                    self.answer.points += batch.len() as u64;
                    return Some(Ok(batch));
                }
                Err(error) => {
                    self.has_failed = true;
                    return Some(Err(error));
                }
            }
        }
    }
}

impl std::fmt::Debug for Batches {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Batches").field("answer", &self.answer).finish_non_exhaustive()
    }
}

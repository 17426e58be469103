//! An answer batch by batch: a thread reads ahead, a little.

use crate::errors::{Failure, misuse};
use crate::points::{Form, Piece, Points};
use crate::reader::json;
use crate::waiting::{LOOK_EVERY, check_process};
use esker::points::Batch;
use esker::query::{Answer, Cancel, Query, QueryError};
use esker::store::Snapshot;
use pyo3::prelude::*;
use std::ops::ControlFlow;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};

/// Decoded batches that wait to be taken; the query itself has some more in hand.
const READ_AHEAD: usize = 4;

/// Hands out the points of an answer so many at a time.
#[pyclass(frozen, module = "esker._esker")]
pub struct Batches {
    form: Arc<Form>,
    /// Points of a batch; the last has what is left.
    size: usize,
    state: Mutex<State>,
}

struct State {
    /// `None`: closed, or at its end.
    source: Option<Decoding>,
    /// What was received and not handed out.
    waiting: Vec<Piece>,
    answer: Option<Answer>,
}

struct Decoding {
    batches: Receiver<Batch>,
    cancel: Cancel,
    thread: JoinHandle<Result<Answer, QueryError>>,
}

impl Batches {
    pub fn new(snapshot: Snapshot, query: Query, cancel: Cancel, form: Form, size: usize) -> Self {
        let (sender, batches) = sync_channel(READ_AHEAD);
        let query = form.complete(query);
        let thread = thread::spawn(move || {
            // If nobody listens any more the rest is not wanted.
            let hand_on = |batch| sender.send(batch).map_or(ControlFlow::Break(()), ControlFlow::Continue);
            query.run(&snapshot, hand_on)
        });
        let state = State { source: Some(Decoding { batches, cancel, thread }), waiting: Vec::new(), answer: None };
        Self { form: Arc::new(form), size: size.max(1), state: Mutex::new(state) }
    }

    /// Only taken with the interpreter's lock released.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Waits until `size` points are there or the answer is at its end; looks for signals meanwhile.
    fn fill(&mut self, form: &Form, size: usize) -> PyResult<()> {
        let mut there: usize = self.waiting.iter().map(|p| p.range.len()).sum();
        while there < size {
            let Some(source) = &self.source else { return Ok(()) };
            match source.batches.recv_timeout(LOOK_EVERY) {
                Ok(batch) => {
                    there += batch.len();
                    self.waiting.push(form.piece(batch));
                }
                Err(RecvTimeoutError::Timeout) => Python::attach(|py| py.check_signals())?,
                Err(RecvTimeoutError::Disconnected) => self.end()?,
            }
        }
        Ok(())
    }

    /// Takes the answer, or the reason why there is none.
    fn end(&mut self) -> PyResult<()> {
        let Some(Decoding { batches, thread, .. }) = self.source.take() else { return Ok(()) };
        drop(batches);
        let ended = thread.join().map_err(|_| misuse("the thread that reads broke down"))?;
        self.answer = Some(ended.map_err(Failure::from)?);
        Ok(())
    }

    /// The first `size` points of those that wait.
    fn take(&mut self, size: usize) -> Vec<Piece> {
        let (mut taken, mut missing) = (Vec::new(), size);
        let mut left = Vec::new();
        for Piece { batch, range } in self.waiting.drain(..) {
            let cut = range.start + missing.min(range.len());
            missing -= cut - range.start;
            if cut < range.end {
                left.push(Piece { batch: batch.clone(), range: cut..range.end });
            }
            if cut > range.start {
                taken.push(Piece { batch, range: range.start..cut });
            }
        }
        self.waiting = left;
        taken
    }
}

#[pymethods]
impl Batches {
    /// The next points; `None` at the end.
    fn take(&self, py: Python<'_>) -> PyResult<Option<Points>> {
        check_process()?;
        let pieces = py.detach(|| {
            let mut state = self.state();
            state.fill(&self.form, self.size)?;
            Ok::<_, PyErr>(state.take(self.size))
        })?;
        Ok((!pieces.is_empty()).then(|| Points::new(self.form.clone(), pieces)))
    }

    /// The answer's report as JSON, once all points were handed out.
    fn answer(&self, py: Python<'_>) -> PyResult<Option<String>> {
        check_process()?;
        let answer = py.detach(|| self.state().answer.clone());
        answer.map(|a| json(&a)).transpose()
    }

    /// Reads no more.
    fn close(&self, py: Python<'_>) {
        // After a fork it is the other process that reads, and another thread may have held the lock.
        if check_process().is_err() {
            return;
        }
        py.detach(|| {
            let mut state = self.state();
            state.waiting.clear();
            // The thread ends when it sees that, or finds that nobody listens.
            if let Some(source) = state.source.take() {
                source.cancel.cancel();
            }
        });
    }
}

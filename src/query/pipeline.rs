//! From tasks to batches: worked on in parallel, delivered in order, a bounded number at a time.

use super::QueryError;
use super::answer::{Meter, Stage};
use crate::points::Batch;
use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::mpsc::{Receiver, TryRecvError, channel};

/// What became of a task; an error of the outer kind is a panic, which is passed on.
type Done = std::thread::Result<Result<Batch, QueryError>>;

/// Points per thread that are worked on or wait to be handed on: some parts. Few, so that batches are handed on while
/// they are in the processor's cache and their memory is used again.
const POINTS_IN_FLIGHT: u64 = 128 * 1024;

/// Runs `work` on all tasks and hands its batches to `sink`, in the order of the tasks; a bounded number of batches is
/// in memory. Empty batches are left out. Returns the number of points delivered.
///
/// The pool's threads never wait: a task is given to them only when there is room for its batch. So the sink may use the
/// pool, too.
///
/// # Errors
///
/// The first task's in order that fails; what came before was delivered.
pub(crate) fn deliver<T: Sync>(
    tasks: &[T],
    points: impl Fn(&T) -> u64,
    work: impl Fn(&T) -> Result<Batch, QueryError> + Sync,
    meter: &Meter,
    sink: &mut dyn FnMut(Batch) -> ControlFlow<()>,
) -> Result<u64, QueryError> {
    let threads = rayon::current_num_threads();
    let room = POINTS_IN_FLIGHT * threads as u64;
    let work = &work;
    rayon::in_place_scope_fifo(|scope| {
        let (sender, receiver) = channel();
        // Tasks from `next` on have not begun; `waiting` has the batches of those before, as they are done, from the
        // first that is not delivered.
        let (mut next, mut in_flight, mut delivered) = (0, 0, 0);
        let mut waiting: VecDeque<Option<Done>> = VecDeque::new();
        for (first, task) in tasks.iter().enumerate() {
            // Beyond the room one for each thread, however large, so that none is idle.
            while next < tasks.len() && (in_flight < room || next - first <= threads) {
                in_flight += points(&tasks[next]);
                waiting.push_back(None);
                let (sender, task, index) = (sender.clone(), &tasks[next], next);
                // If nobody listens any more the batch is not wanted.
                scope.spawn_fifo(move |_| {
                    let done = catch_unwind(AssertUnwindSafe(|| work(task)));
                    let _ = sender.send((index, done));
                });
                next += 1;
            }
            let batch = loop {
                if let Some(done) = waiting.front_mut().and_then(Option::take) {
                    waiting.pop_front();
                    break done.unwrap_or_else(|panic| resume_unwind(panic))?;
                }
                let Some((index, done)) = receive(&receiver) else { return Ok(delivered) };
                if let Some(place) = waiting.get_mut(index - first) {
                    *place = Some(done);
                }
            };
            in_flight -= points(task);
            if batch.is_empty() {
                continue;
            }
            delivered += batch.len() as u64;
            if meter.time(Stage::Delivering, || sink(batch)).is_break() {
                break;
            }
        }
        Ok(delivered)
    })
}

/// The next message. A thread of the pool works on meanwhile: all of them may be waiting here.
fn receive<T>(receiver: &Receiver<T>) -> Option<T> {
    if rayon::current_thread_index().is_none() {
        return receiver.recv().ok();
    }
    loop {
        match receiver.try_recv() {
            Ok(message) => return Some(message),
            Err(TryRecvError::Disconnected) => return None,
            Err(TryRecvError::Empty) => drop(rayon::yield_now()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::Positions;

    fn batch(n: u64) -> Batch {
        let point = |i| crate::lattice::LatticePoint([i, n, 0]);
        Batch { positions: (0..n).map(point).collect::<Positions>(), ..Batch::empty(Vec::new().into()) }
    }

    #[test]
    fn batches_come_in_the_order_of_their_tasks_until_the_sink_has_enough() {
        let tasks: Vec<u64> = (0..200).map(|i| i * 7919 % 60).collect();
        for weight in [1, 20_000] {
            let meter = Meter::default();
            let mut seen = Vec::new();
            let mut all = |b: Batch| {
                seen.push(b.len() as u64);
                ControlFlow::Continue(())
            };
            let points = deliver(&tasks, |t| t * weight, |&t| Ok(batch(t)), &meter, &mut all).unwrap();
            assert_eq!(seen, tasks.iter().copied().filter(|&t| t > 0).collect::<Vec<_>>());
            assert_eq!(points, tasks.iter().sum::<u64>());
            let mut left = 5;
            let mut some = |_: Batch| {
                left -= 1;
                if left == 0 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            };
            deliver(&tasks, |t| t * weight, |&t| Ok(batch(t)), &meter, &mut some).unwrap();
            assert_eq!(left, 0);
            let fails = |&t: &u64| if t == 33 { Err(QueryError::Combination("no")) } else { Ok(batch(t)) };
            let mut ignore = |_: Batch| ControlFlow::Continue(());
            assert!(deliver(&tasks, |t| t * weight, fails, &meter, &mut ignore).is_err());
        }
    }
}

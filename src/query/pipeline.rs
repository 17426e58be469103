//! From tasks to batches: worked on in parallel, delivered in order, a bounded number at a time.

use super::QueryError;
use super::answer::{Meter, Stage};
use crate::points::Batch;
use rayon::prelude::*;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::sync_channel;

/// Points that a thread works on before the batches are handed on: some parts. Small, so that a small answer is written
/// while the rest of it is still being read.
const WINDOW_POINTS: u64 = 64 * 1024;

/// Runs `work` on all tasks and hands its batches to `sink`, in the order of the tasks; at most three windows of batches
/// are in memory. Empty batches are left out. Returns the number of points delivered.
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
    let windows = windows(tasks, points, WINDOW_POINTS * rayon::current_num_threads() as u64);
    let mut delivered = 0;
    let mut deliver_window = |batches: Vec<Result<Batch, QueryError>>| {
        for batch in batches {
            let batch = batch?;
            if batch.is_empty() {
                continue;
            }
            delivered += batch.len() as u64;
            if meter.time(Stage::Delivering, || sink(batch)).is_break() {
                return Ok(ControlFlow::Break(()));
            }
        }
        Ok::<_, QueryError>(ControlFlow::Continue(()))
    };
    let run = |window: &[T]| -> Vec<Result<Batch, QueryError>> { window.par_iter().map(&work).collect() };
    match windows.as_slice() {
        [] => {}
        [one] => {
            let _done_or_enough = deliver_window(run(one))?;
        }
        many => {
            let stop = AtomicBool::new(false);
            let (sender, receiver) = sync_channel(1);
            std::thread::scope(|scope| {
                let (stop, run) = (&stop, &run);
                scope.spawn(move || {
                    for window in many {
                        if stop.load(Ordering::Relaxed) || sender.send(run(window)).is_err() {
                            break;
                        }
                    }
                });
                for batches in receiver {
                    match deliver_window(batches) {
                        Ok(ControlFlow::Continue(())) => {}
                        end => {
                            stop.store(true, Ordering::Relaxed);
                            return end.map(|_| ());
                        }
                    }
                }
                Ok(())
            })?;
        }
    }
    Ok(delivered)
}

/// Cuts tasks into runs of about so many points.
fn windows<T>(tasks: &[T], points: impl Fn(&T) -> u64, most: u64) -> Vec<&[T]> {
    let mut windows = Vec::new();
    let (mut start, mut sum) = (0, 0_u64);
    for (i, task) in tasks.iter().enumerate() {
        sum = sum.saturating_add(points(task));
        if sum >= most {
            windows.push(&tasks[start..=i]);
            (start, sum) = (i + 1, 0);
        }
    }
    if start < tasks.len() {
        windows.push(&tasks[start..]);
    }
    windows
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

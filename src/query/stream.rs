//! From tasks to their results: worked on in parallel, handed on in order, a bounded number at a time, only when asked.

use super::QueryError;
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};

/// What became of a task; an error of the outer kind is a panic, which is passed on.
type Done<R> = std::thread::Result<Result<R, QueryError>>;

/// The number of a task, and what became of it.
type Message<R> = (u64, Done<R>);

/// Where tasks come from.
pub(crate) type Source<T> = Box<dyn Iterator<Item = Result<T, QueryError>> + Send>;

/// Points per thread that are worked on or wait to be handed on: some parts. Few, so that batches are handed on while
/// they are in the processor's cache and their memory is used again.
const POINTS_IN_FLIGHT: u64 = 128 * 1024;

/// A task counts as so many points, at least.
const LEAST_POINTS: u64 = 1024;

/// The results of tasks in the order of the tasks, as an iterator; it ends after an error.
///
/// The pool's threads never wait: a task is given to them only when there is room for its result, and that is when the
/// one who iterates asks for more. So whoever iterates may use the pool, too. Dropping it ends the tasks that have not
/// begun.
pub(crate) struct Stream<T, R> {
    source: Option<Source<T>>,
    points: fn(&T) -> u64,
    work: Arc<dyn Fn(T) -> Result<R, QueryError> + Send + Sync>,
    /// Tasks at once; with one they run on the thread that iterates.
    threads: usize,
    dropped: Arc<AtomicBool>,
    channel: (Sender<Message<R>>, Receiver<Message<R>>),
    /// The number of the first task that is not handed on; then its points and result, and those of the tasks after it.
    first: u64,
    waiting: VecDeque<(u64, Option<Done<R>>)>,
    in_flight: u64,
}

impl<T: Send + 'static, R: Send + 'static> Stream<T, R> {
    /// Nothing is begun before the first result is asked for. `threads` of `None` are all of the pool.
    pub fn new(
        source: Source<T>,
        points: fn(&T) -> u64,
        threads: Option<usize>,
        work: impl Fn(T) -> Result<R, QueryError> + Send + Sync + 'static,
    ) -> Self {
        Self {
            source: Some(source),
            points,
            work: Arc::new(work),
            threads: threads.unwrap_or_else(rayon::current_num_threads).max(1),
            dropped: Arc::default(),
            channel: channel(),
            first: 0,
            waiting: VecDeque::new(),
            in_flight: 0,
        }
    }

    /// The next task; an error of the source is the result of one that has already been done.
    fn pull(&mut self) -> Option<Result<T, QueryError>> {
        let next = self.source.as_mut()?.next();
        if !matches!(next, Some(Ok(_))) {
            self.source = None;
        }
        next
    }

    fn begin(&mut self) {
        // Beyond the room one for each thread, however large, so that none is idle.
        let room = POINTS_IN_FLIGHT * self.threads as u64;
        while self.in_flight < room || self.waiting.len() <= self.threads {
            let task = match self.pull() {
                None => return,
                Some(Err(error)) => {
                    self.waiting.push_back((0, Some(Ok(Err(error)))));
                    return;
                }
                Some(Ok(task)) => task,
            };
            // What has no point of its own takes room, too: its result waits.
            let points = (self.points)(&task).max(LEAST_POINTS);
            let number = self.first + self.waiting.len() as u64;
            self.in_flight += points;
            self.waiting.push_back((points, None));
            let (sender, work, dropped) = (self.channel.0.clone(), self.work.clone(), self.dropped.clone());
            rayon::spawn_fifo(move || {
                if !dropped.load(Ordering::Relaxed) {
                    let done = catch_unwind(AssertUnwindSafe(|| work(task)));
                    // What the work holds is let go before its last result is known: nobody waits for the rest.
                    drop(work);
                    // If nobody listens any more the result is not wanted.
                    let _ = sender.send((number, done));
                }
            });
        }
    }

    /// The next message. A thread of the pool works on meanwhile: all of them may be waiting here.
    fn receive(&self) -> Option<Message<R>> {
        let receiver = &self.channel.1;
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

    fn pass_on(&mut self, result: Result<R, QueryError>) -> Option<Result<R, QueryError>> {
        if result.is_err() {
            self.source = None;
            self.waiting.clear();
            self.dropped.store(true, Ordering::Relaxed);
        }
        Some(result)
    }
}

impl<T: Send + 'static, R: Send + 'static> Iterator for Stream<T, R> {
    type Item = Result<R, QueryError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.threads == 1 {
            let result = self.pull()?.and_then(|task| (self.work)(task));
            return self.pass_on(result);
        }
        self.begin();
        loop {
            let (points, done) = self.waiting.front_mut()?;
            let points = *points;
            if let Some(done) = done.take() {
                self.in_flight -= points;
                self.waiting.pop_front();
                self.first += 1;
                let result = done.unwrap_or_else(|panic| resume_unwind(panic));
                return self.pass_on(result);
            }
            let (number, done) = self.receive()?;
            if let Some(place) = self.waiting.get_mut((number - self.first) as usize) {
                place.1 = Some(done);
            }
        }
    }
}

impl<T, R> Drop for Stream<T, R> {
    fn drop(&mut self) {
        self.dropped.store(true, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicU64;

    fn source(tasks: &[u64]) -> Source<u64> {
        let tasks: Vec<u64> = tasks.into();
        Box::new(tasks.into_iter().map(Ok))
    }

    #[test]
    fn results_come_in_the_order_of_their_tasks_until_the_first_error() {
        let tasks: Vec<u64> = (0..200).map(|i| i * 7919 % 61).collect();
        for threads in [None, Some(1), Some(3)] {
            for points in [(|t| *t) as fn(&u64) -> u64, |t| t * 20_000] {
                let same = Stream::new(source(&tasks), points, threads, Ok);
                assert_eq!(same.collect::<Result<Vec<u64>, _>>().unwrap(), tasks);
                let fails = |t| if t == 33 { Err(QueryError::Combination("no")) } else { Ok(t) };
                let mut some = Stream::new(source(&tasks), points, threads, fails);
                let before = tasks.iter().position(|&t| t == 33).unwrap();
                assert_eq!(some.by_ref().take(before).map(Result::unwrap).collect::<Vec<_>>(), tasks[..before]);
                assert!(matches!(some.next(), Some(Err(QueryError::Combination("no")))));
                assert!(some.next().is_none());
            }
        }
    }

    #[test]
    fn an_error_of_the_source_comes_after_the_results_before_it() {
        let tasks = [Ok(1), Ok(2), Err(QueryError::Cancelled), Ok(3)];
        let mut stream = Stream::new(Box::new(tasks.into_iter()), |_| 1, Some(2), |t: u64| Ok(t));
        assert_eq!((stream.next().unwrap().unwrap(), stream.next().unwrap().unwrap()), (1, 2));
        assert!(stream.next().unwrap().is_err());
        assert!(stream.next().is_none());
    }

    #[test]
    fn nothing_is_begun_beyond_the_room_and_nothing_more_once_it_is_dropped() {
        let begun = Arc::new(AtomicU64::new(0));
        let count = begun.clone();
        let work = move |t: u64| {
            count.fetch_add(1, Ordering::Relaxed);
            Ok(t)
        };
        let mut stream = Stream::new(source(&[1; 500]), |_| 60_000, Some(2), work);
        assert_eq!(begun.load(Ordering::Relaxed), 0);
        for asked in 1..20 {
            stream.next().unwrap().unwrap();
            // Time for all that was begun.
            std::thread::sleep(std::time::Duration::from_millis(2));
            // 256 Ki points are five of these tasks.
            assert!(begun.load(Ordering::Relaxed) <= asked + 5, "{begun:?} after {asked}");
        }
        drop(stream);
        let then = begun.load(Ordering::Relaxed);
        std::thread::sleep(std::time::Duration::from_millis(20));
        assert!(begun.load(Ordering::Relaxed) <= then + 5);
    }
}

//! From tasks to their results: worked on in parallel, handed on in order, a bounded number at a time, only when asked.

use super::{Cancel, QueryError};
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// What became of a task; an error of the outer kind is a panic, which is passed on.
type Done<R> = std::thread::Result<Result<R, QueryError>>;

/// The number of a task, and what became of it.
type Message<R> = (u64, Done<R>);

/// What is done with a task.
type Work<T, R> = Arc<dyn Fn(T) -> Result<R, QueryError> + Send + Sync>;

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
    work: Work<T, R>,
    /// Tasks at once; with one they run on the thread that iterates.
    threads: usize,
    cancel: Cancel,
    /// The tasks that have been given out and not begun, and how many of the pool's threads take them.
    given: Arc<Mutex<Given<T, R>>>,
    dropped: Arc<AtomicBool>,
    channel: (Sender<Message<R>>, Receiver<Message<R>>),
    /// The number of the first task that is not handed on; then its points and result, and those of the tasks after it.
    first: u64,
    waiting: VecDeque<(u64, Option<Done<R>>)>,
    in_flight: u64,
}

struct Given<T, R> {
    tasks: VecDeque<(u64, T, Work<T, R>)>,
    threads: usize,
}

fn lock<T, R>(given: &Mutex<Given<T, R>>) -> MutexGuard<'_, Given<T, R>> {
    given.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Has a thread of the pool do a task, and then, after whoever else waits for a thread, the next one.
fn work_on<T: Send + 'static, R: Send + 'static>(
    given: Arc<Mutex<Given<T, R>>>,
    dropped: Arc<AtomicBool>,
    sender: Sender<Message<R>>,
) {
    rayon::spawn_fifo(move || {
        let next = {
            let mut given = lock(&given);
            let next = given.tasks.pop_front();
            given.threads -= usize::from(next.is_none());
            next
        };
        let Some((number, task, work)) = next else { return };
        if !dropped.load(Ordering::Relaxed) {
            let done = catch_unwind(AssertUnwindSafe(|| work(task)));
            // What the work holds is let go before its last result is known: nobody waits for the rest.
            drop(work);
            // If nobody listens any more the result is not wanted.
            let _ = sender.send((number, done));
        }
        work_on(given, dropped, sender);
    });
}

impl<T: Send + 'static, R: Send + 'static> Stream<T, R> {
    /// Nothing is begun before the first result is asked for, and no result handed on after `cancel`. `threads` of `None` are
    /// all of the pool.
    pub fn new(
        source: Source<T>,
        points: fn(&T) -> u64,
        threads: Option<usize>,
        cancel: Cancel,
        work: impl Fn(T) -> Result<R, QueryError> + Send + Sync + 'static,
    ) -> Self {
        Self {
            source: Some(source),
            points,
            work: Arc::new(work),
            // More than the pool has would be no faster, and read further ahead.
            threads: threads.unwrap_or(usize::MAX).clamp(1, rayon::current_num_threads().max(1)),
            cancel,
            given: Arc::new(Mutex::new(Given { tasks: VecDeque::new(), threads: 0 })),
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
            self.give((number, task, self.work.clone()));
        }
    }

    /// Gives a task out, and one more thread to take it if not enough do.
    fn give(&self, task: (u64, T, Work<T, R>)) {
        let mut given = lock(&self.given);
        given.tasks.push_back(task);
        if given.threads < self.threads {
            given.threads += 1;
            drop(given);
            work_on(self.given.clone(), self.dropped.clone(), self.channel.0.clone());
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
        let is_over = self.source.is_none() && self.waiting.is_empty();
        if !is_over && let Err(cancelled) = self.cancel.check() {
            return self.pass_on(Err(cancelled));
        }
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
        lock(&self.given).tasks.clear();
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
                let same = Stream::new(source(&tasks), points, threads, Cancel::new(), Ok);
                assert_eq!(same.collect::<Result<Vec<u64>, _>>().unwrap(), tasks);
                let fails = |t| if t == 33 { Err(QueryError::Combination("no")) } else { Ok(t) };
                let mut some = Stream::new(source(&tasks), points, threads, Cancel::new(), fails);
                let before = tasks.iter().position(|&t| t == 33).unwrap();
                assert_eq!(some.by_ref().take(before).map(Result::unwrap).collect::<Vec<_>>(), tasks[..before]);
                assert!(matches!(some.next(), Some(Err(QueryError::Combination("no")))));
                assert!(some.next().is_none());
            }
        }
    }

    #[test]
    fn no_more_tasks_run_at_once_than_were_asked_for() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(8).build().unwrap();
        for (asked, most) in [(Some(2), 2), (Some(3), 3), (None, 8), (Some(usize::MAX), 8)] {
            let (at_once, highest) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
            let (now, top) = (at_once.clone(), highest.clone());
            let work = move |t: u64| {
                top.fetch_max(now.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
                std::thread::sleep(std::time::Duration::from_micros(300));
                now.fetch_sub(1, Ordering::SeqCst);
                Ok(t)
            };
            let tasks: Vec<u64> = (0..300).collect();
            let all = pool.install(|| {
                let all = Stream::new(source(&tasks), |_| 1, asked, Cancel::new(), work);
                all.collect::<Result<Vec<_>, _>>().unwrap()
            });
            assert_eq!(all, tasks);
            let highest = highest.load(Ordering::SeqCst);
            assert!(1 < highest && highest <= most, "{highest} at once of {asked:?}");
        }
    }

    #[test]
    fn nothing_is_handed_on_once_it_is_cancelled() {
        for threads in [None, Some(1)] {
            let cancel = Cancel::new();
            let mut stream = Stream::new(source(&[1; 50]), |_| 1, threads, cancel.clone(), Ok);
            assert!(matches!(stream.next(), Some(Ok(1))));
            // Time for all that was begun.
            std::thread::sleep(std::time::Duration::from_millis(5));
            cancel.cancel();
            assert!(matches!(stream.next(), Some(Err(QueryError::Cancelled))));
            assert!(stream.next().is_none());
        }
        // What was over before is not.
        let cancel = Cancel::new();
        let mut stream = Stream::new(source(&[1]), |_| 1, Some(1), cancel.clone(), Ok);
        assert!(stream.next().unwrap().is_ok() && stream.next().is_none());
        cancel.cancel();
        assert!(stream.next().is_none());
    }

    #[test]
    fn an_error_of_the_source_comes_after_the_results_before_it() {
        let tasks = [Ok(1), Ok(2), Err(QueryError::Cancelled), Ok(3)];
        let mut stream = Stream::new(Box::new(tasks.into_iter()), |_| 1, Some(2), Cancel::new(), |t: u64| Ok(t));
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
        let mut stream = Stream::new(source(&[1; 500]), |_| 60_000, Some(2), Cancel::new(), work);
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

//! What a run works with: the store's path, memory, threads, and who is told of its progress.

use super::budget::{default_memory, default_threads};
use super::{IngestError, Progress};
use crate::store::{Store, StoreError, Writer, followed};
use std::path::Path;
use std::time::Duration;

/// More threads than any machine has use for.
const MOST_THREADS: usize = 1024;

/// How often a store that is in use is asked for again.
const ASK_AGAIN: Duration = Duration::from_millis(200);

/// What changing a store may use. The default is right for most machines.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Resources {
    /// Memory to use at most; `None` for a quarter of the machine's.
    pub memory_bytes: Option<u64>,
    /// Threads; `None` for one per core, but no more than one for 32 MiB of memory, or two.
    pub threads: Option<usize>,
    /// Wait for a store that another process is writing to, instead of failing.
    pub wait: bool,
}

pub(super) struct Context<'a> {
    pub path: &'a Path,
    pub memory: u64,
    pub threads: usize,
    pub wait: bool,
    pub progress: &'a dyn Progress,
}

impl Context<'_> {
    /// Runs `work` on a pool of the threads that it may use.
    pub fn run<R: Send>(
        path: &Path,
        resources: &Resources,
        progress: &dyn Progress,
        work: impl FnOnce(&Context<'_>) -> Result<R, IngestError> + Send,
    ) -> Result<R, IngestError> {
        let memory = resources.memory_bytes.unwrap_or_else(default_memory);
        let threads = resources.threads.unwrap_or_else(|| default_threads(memory)).max(1);
        if threads > MOST_THREADS {
            return Err(IngestError::TooManyThreads { asked: threads, most: MOST_THREADS });
        }
        // Temporary files lie beside the store itself.
        let path = &*followed(path);
        let context = Context { path, memory, threads, wait: resources.wait, progress };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.map_err(|e| IngestError::Threads(e.to_string()))?.install(|| work(&context))
    }

    /// The store's one writer; waits for it if that is wished.
    pub fn writer(&self, store: &Store) -> Result<Writer, IngestError> {
        self.when_free(|| store.writer())
    }

    /// What only one can have at a time; waits for it if that is wished.
    pub fn when_free<R>(&self, take: impl Fn() -> Result<R, StoreError>) -> Result<R, IngestError> {
        let mut told = false;
        loop {
            match take() {
                Err(StoreError::InUse { .. }) if self.wait => {
                    if !told {
                        self.progress.say("the store is in use; waiting");
                        told = true;
                    }
                    self.pause()?;
                }
                other => return Ok(other?),
            }
        }
    }

    /// Waits a little.
    pub fn pause(&self) -> Result<(), IngestError> {
        self.go_on()?;
        std::thread::sleep(ASK_AGAIN);
        Ok(())
    }

    /// Does what can be stopped by a flag that it looks at, and then fails.
    pub fn unless_cancelled<R>(
        &self,
        work: impl FnOnce(&(dyn Fn() -> bool + Sync)) -> Result<R, StoreError>,
    ) -> Result<R, IngestError> {
        let done = work(&|| self.progress.cancelled());
        if done.is_err() {
            self.go_on()?;
        }
        Ok(done?)
    }

    /// An error if the run is to stop.
    pub fn go_on(&self) -> Result<(), IngestError> {
        if self.progress.cancelled() { Err(IngestError::Interrupted) } else { Ok(()) }
    }
}

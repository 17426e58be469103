//! The reading stage: pieces of sources become rows of buckets, on all threads, while the sources' bytes are hashed
//! beside.

use super::IngestError;
use super::budget::Budget;
use super::error::Stopped;
use super::identity::{PieceHash, content_hash};
use super::partition::{Partition, RowPlan, ScanTally, Sorter};
use super::progress::Progress;
use super::rows::RowKey;
use super::sources::Source;
use crate::formats::Piece;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// What does not change while reading.
pub(super) struct Reading<'a> {
    /// Of the sources.
    pub plans: &'a [RowPlan],
    pub sources: &'a [Source],
    pub threads: usize,
    pub strict: bool,
    /// Are the others read though one can't be?
    pub keep_going: bool,
    pub progress: &'a dyn Progress,
}

/// What was read of the new sources.
pub(super) struct Read {
    pub tallies: Vec<ScanTally>,
    /// BLAKE3 of their bytes.
    pub contents: Vec<[u8; 32]>,
}

enum Task {
    Hash(usize),
    Piece(usize, Piece),
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// For a source whose bytes are not yet known, and are read as they are.
fn piece_hash(source: &Source) -> Option<PieceHash> {
    let asked = source.content.is_none() && source.reader.verbatim_from().is_some();
    asked.then(|| PieceHash::new(source.bytes))
}

impl Reading<'_> {
    /// Reads everything.
    ///
    /// # Errors
    ///
    /// [`Stopped`]; with `keep_going` all sources that can't be read.
    pub fn read<K: RowKey>(&self, partition: &Partition<'_>, budget: &Budget) -> Result<Read, Stopped> {
        let contents: Vec<_> = self.sources.iter().map(|s| Mutex::new(s.content)).collect();
        let tallies: Vec<_> = self.sources.iter().map(|_| Mutex::new(ScanTally::default())).collect();
        // Of some sources the bytes are hashed as they are read.
        let hashes: Vec<_> = self.sources.iter().map(piece_hash).collect();
        // The other hashes first: they are the longest tasks.
        let unknown = |&i: &usize| self.sources[i].content.is_none() && hashes[i].is_none();
        let mut tasks: Vec<_> = (0..self.sources.len()).filter(unknown).map(Task::Hash).collect();
        for (i, source) in self.sources.iter().enumerate() {
            tasks.extend(source.reader.pieces(budget.piece_records).into_iter().map(|p| Task::Piece(i, p)));
        }
        let next = AtomicUsize::new(0);
        let failed = AtomicBool::new(false);
        let first_error = Mutex::new(None);
        let unreadable = Mutex::new(BTreeMap::new());
        let leave_out = |i: usize, error: IngestError| match error.source_path() {
            Some(_) if self.keep_going => {
                lock(&unreadable).entry(i).or_insert(error);
                Ok(())
            }
            _ => Err(error),
        };
        // Pieces of a source come one after the other, so a thread has one sorter at a time.
        let work = || {
            let mut current: Option<(usize, Sorter<'_, '_>)> = None;
            let finish = |done: Option<(usize, Sorter<'_, '_>)>| {
                if let Some((i, sorter)) = done {
                    lock(&tallies[i]).merge(&sorter.finish()?);
                }
                Ok::<_, IngestError>(())
            };
            while let Some(task) = tasks.get(next.fetch_add(1, Ordering::Relaxed)) {
                if failed.load(Ordering::Relaxed) {
                    return Ok(());
                }
                match task {
                    Task::Hash(i) => {
                        let path = &self.sources[*i].reader.info().path;
                        match content_hash(path, &|| self.progress.cancelled()) {
                            Ok(hash) => *lock(&contents[*i]) = Some(hash.ok_or(IngestError::Interrupted)?),
                            Err(error) => leave_out(*i, error.into())?,
                        }
                    }
                    // What has been read of it is of no use any more.
                    Task::Piece(i, _) if self.keep_going && lock(&unreadable).contains_key(i) => {}
                    Task::Piece(i, piece) => {
                        if current.as_ref().is_none_or(|(at, _)| at != i) {
                            finish(current.take())?;
                        }
                        let plan = &self.plans[*i];
                        let (_, sorter) = current.get_or_insert_with(|| (*i, partition.sorter(plan)));
                        let hash = hashes[*i].as_ref();
                        match self.piece::<K>(sorter, &self.sources[*i], *piece, hash, budget.open_bytes) {
                            Ok(truncated) => lock(&tallies[*i]).rejected.truncated += truncated,
                            Err(error) => leave_out(*i, error)?,
                        }
                    }
                }
            }
            finish(current)
        };
        rayon::scope(|scope| {
            for _ in 0..self.threads {
                scope.spawn(|_| {
                    if let Err(error) = work() {
                        failed.store(true, Ordering::Relaxed);
                        lock(&first_error).get_or_insert(error);
                    }
                });
            }
        });
        if let Some(error) = first_error.into_inner().unwrap_or_else(PoisonError::into_inner) {
            return Err(error.into());
        }
        let unreadable = unreadable.into_inner().unwrap_or_else(PoisonError::into_inner);
        if !unreadable.is_empty() {
            return Err(Stopped::Unreadable(unreadable.into_iter().collect()));
        }
        let mut read = Read { tallies: Vec::new(), contents: Vec::new() };
        for (tally, source) in tallies.into_iter().zip(self.sources) {
            let mut tally = tally.into_inner().unwrap_or_else(PoisonError::into_inner);
            tally.rejected.truncated += source.reader.info().missing;
            read.tallies.push(tally);
        }
        for ((content, hash), source) in contents.into_iter().zip(hashes).zip(self.sources) {
            let content = match hash {
                Some(hash) => {
                    let hash = hash.finish(&source.reader.info().path, &|| self.progress.cancelled())?;
                    Some(hash.ok_or(IngestError::Interrupted)?)
                }
                None => content.into_inner().unwrap_or_else(PoisonError::into_inner),
            };
            read.contents.push(content.ok_or_else(|| IngestError::Internal("a source without a hash".into()))?);
        }
        Ok(read)
    }

    /// Reads a piece; returns the records that the file turned out not to hold.
    fn piece<K: RowKey>(
        &self,
        sorter: &mut Sorter<'_, '_>,
        source: &Source,
        piece: Piece,
        hash: Option<&PieceHash>,
        open_bytes: usize,
    ) -> Result<u64, IngestError> {
        let stride = source.reader.info().layout.stride();
        let start = source.reader.verbatim_from().map(|start| start + piece.first * stride as u64);
        let mut blocks = hash.zip(start).map(|(hash, start)| hash.piece(start));
        let mut failure = None;
        let given = source.reader.read(piece, &mut |records| {
            if self.progress.cancelled() {
                failure = Some(IngestError::Interrupted);
                return false;
            }
            if let Some(blocks) = &mut blocks {
                blocks.update(records);
            }
            if let Err(error) = sorter.take::<K>(records, open_bytes) {
                failure = Some(error);
                return false;
            }
            self.progress.advance((records.len() / stride) as u64);
            true
        })?;
        if let Some(error) = failure {
            return Err(error);
        }
        if self.strict && given.truncated > 0 {
            let path = source.reader.info().path.clone();
            return Err(IngestError::Truncated { path, missing: given.truncated });
        }
        Ok(given.truncated)
    }
}

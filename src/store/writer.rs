//! The one writer: payload in transactions of bounded size, then one small transaction that makes it count.
//!
//! Rows of `chunk` that no node refers to are invisible, so what is written before the flip changes nothing. Ids of
//! chunk rows only grow: after a crash the rows that were never referred to are those from `site.next_chunk` on, and
//! those that a flip left behind are in `garbage`.

use super::connection::{self, Purpose};
use super::error::{RowError, StoreError};
use super::files::{self, remove_spills, wal_bytes};
use super::flip::{Flip, flip};
use super::handle::SiteOptions;
use super::interrupt::{patiently, unless};
use super::lock::{WRITER_HERE, WriterLock};
use super::log::{self, Checkpoint};
use super::model::{FIRST_ATTRIBUTE, SLOT_PACKED, SLOT_STRIDE, ScanId, Site, Slot, StoredAttribute};
use super::place::{Place, lock};
use super::rows::{self, ChunkRow, SiteRow};
use super::snapshot::facts;
use super::space;
use crate::points::{Attribute, Identity};
use rusqlite::Connection;
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

/// Bytes of chunks in one transaction.
const TRANSACTION_BYTES: u64 = 16 << 20;

/// A log beyond this is checkpointed as soon as readers allow.
const WAL_BYTES: u64 = 128 << 20;

/// Gives out ids of chunk rows; cheap to clone, may be used from any thread.
#[derive(Clone, Debug, Default)]
pub struct ChunkIds(Arc<AtomicI64>);

impl ChunkIds {
    /// The `chunk_base` of a node of this many parts. Never the same twice in the life of a store.
    pub fn reserve(&self, parts: usize) -> i64 {
        self.0.fetch_add((parts as i64).saturating_mul(SLOT_STRIDE), Ordering::Relaxed)
    }

    /// The first id that was not given out.
    fn next(&self) -> i64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// What a crash had left and the writer has removed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Leftovers {
    /// Chunk rows that no node refers to.
    pub chunk_rows: u64,
    /// Temporary files.
    pub spill_files: u64,
}

/// What a commit came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Committed {
    /// The generation now.
    pub generation: u64,
    /// Chunk rows removed that belonged to older generations.
    pub removed_rows: u64,
    /// Is the log empty? If not, a reader of an older generation is holding it.
    pub log_truncated: bool,
}

/// The one writer of a store. Dropped without a commit, it leaves the store as it was.
#[derive(Debug)]
pub struct Writer {
    place: Arc<Place>,
    /// For a store in a file; declared before the lock, so that it is closed before the lock is given back.
    connection: Option<Connection>,
    lock: Option<WriterLock>,
    site: SiteRow,
    /// The committed ones, then the pending ones.
    attributes: Vec<StoredAttribute>,
    ids: ChunkIds,
    next_scan: ScanId,
    /// Bytes in the open payload transaction; `None` if there is none.
    pending_bytes: Option<u64>,
    /// A payload write failed: what follows can't be complete.
    failed: bool,
    /// Rows go straight into the file, under a rollback journal.
    without_log: bool,
    /// The next transaction may be the first of a log.
    begins_log: bool,
    /// The size at which the log is looked at next.
    wal_limit: u64,
    leftovers: Leftovers,
}

impl Writer {
    pub(super) fn open(place: &Arc<Place>) -> Result<Self, StoreError> {
        Self::open_locked(place, None)
    }

    /// With the lock, if it is held already.
    pub(super) fn open_locked(place: &Arc<Place>, held: Option<WriterLock>) -> Result<Self, StoreError> {
        let (connection, lock) = match &**place {
            Place::File(file) => {
                file.check_there()?;
                let taken = held.map_or_else(|| WriterLock::take(&file.path), Ok)?;
                let connection = connection::open(&file.path, Purpose::Write).map_err(|e| e.at(&file.path))?;
                (Some(connection), Some(taken))
            }
            Place::Memory(memory) => {
                if std::mem::replace(&mut *lock(&memory.writer), true) {
                    return Err(StoreError::InUse { path: place.path().into(), owner: WRITER_HERE.into() });
                }
                (None, None)
            }
        };
        let read = match (&connection, &**place) {
            (Some(c), _) => facts(c),
            (None, Place::Memory(memory)) => facts(&super::place::lock(&memory.connection)),
            (None, Place::File(_)) => Err(RowError::Inconsistent("there is no connection".into())),
        };
        let (site, _, attributes) = read.map_err(|e| {
            if let Place::Memory(memory) = &**place {
                *super::place::lock(&memory.writer) = false;
            }
            place.error(e)
        })?;
        let mut writer = Self {
            place: place.clone(),
            connection,
            lock,
            next_scan: site.next_scan.max(1),
            ids: ChunkIds(Arc::new(AtomicI64::new(site.next_chunk))),
            site,
            attributes,
            pending_bytes: None,
            failed: false,
            without_log: false,
            begins_log: false,
            wal_limit: WAL_BYTES,
            leftovers: Leftovers::default(),
        };
        // What a crash left in the log goes on; else a new one is begun.
        writer.checkpoint("PASSIVE");
        writer.leftovers = writer.remove_leftovers()?;
        Ok(writer)
    }

    fn remove_leftovers(&mut self) -> Result<Leftovers, StoreError> {
        let spill_files = match &*self.place {
            Place::File(file) => remove_spills(&file.path).map_err(|source| StoreError::Io {
                path: file.path.clone(),
                action: "removing temporary files of a run that was cut off",
                source,
            })?,
            Place::Memory(_) => 0,
        };
        let chunk_rows = self.remove_unreferenced()? + self.remove_garbage()?;
        if chunk_rows > 0 {
            self.tidy();
        }
        Ok(Leftovers { chunk_rows, spill_files })
    }

    /// What a crash had left and is now removed.
    pub(crate) fn leftovers(&self) -> Leftovers {
        self.leftovers
    }

    /// The site as it was last committed.
    pub fn site(&self) -> &Site {
        &self.site.site
    }

    /// Was the store made with its writer, and nothing committed to it? It is what a run that was cut off has left.
    pub(crate) fn is_provisional(&self) -> bool {
        self.site.site.generation == 0 && self.site.next_scan == 0
    }

    /// Gives a provisional store another site: nothing of the first one counts.
    ///
    /// # Errors
    ///
    /// [`StoreError::Inconsistent`] if it is not provisional, and as [`Writer::put_chunks_unless`].
    pub(crate) fn begin_anew(&mut self, options: SiteOptions) -> Result<(), StoreError> {
        if !self.is_provisional() || self.pending_bytes.is_some() {
            let what = "the store has a site that is not to change".into();
            return Err(StoreError::Inconsistent { path: self.place.path().into(), what });
        }
        self.begin_log()?;
        let site = SiteRow { site: options.into_site(), ..self.site.clone() };
        self.run(|c| rows::put_site(c, &site))?;
        self.site = site;
        Ok(())
    }

    /// All attributes, the pending ones included, ascending by id.
    pub fn attributes(&self) -> &[StoredAttribute] {
        &self.attributes
    }

    /// The numbers of these attributes; those that are new (by their identity) are written with the next commit, which
    /// removes those that no scan has then.
    ///
    /// # Errors
    ///
    /// [`StoreError::Inconsistent`] if there are too many.
    pub(crate) fn add_attributes(&mut self, attributes: &[Attribute]) -> Result<Vec<Slot>, StoreError> {
        let mut slots = Vec::with_capacity(attributes.len());
        // A record has room for tens of thousands.
        let before = self.attributes.clone();
        let mut known: HashMap<Identity<'_>, Slot> = before.iter().map(|a| (a.attribute.identity(), a.id)).collect();
        for attribute in attributes {
            let slot = match known.get(&attribute.identity()) {
                Some(&known) => known,
                None => {
                    let id = self.attributes.last().map_or(FIRST_ATTRIBUTE, |a| a.id.saturating_add(1));
                    if id == SLOT_PACKED {
                        let what = "there are too many attributes".into();
                        return Err(StoreError::Inconsistent { path: self.place.path().into(), what });
                    }
                    let attribute = Attribute { no_data: attribute.no_data_bytes(), ..attribute.clone() };
                    self.attributes.push(StoredAttribute { id, attribute });
                    id
                }
            };
            known.insert(attribute.identity(), slot);
            slots.push(slot);
        }
        Ok(slots)
    }

    /// The next number for a scan; never given out again once it is committed.
    pub fn reserve_scan(&mut self) -> ScanId {
        let id = self.next_scan;
        self.next_scan = self.next_scan.saturating_add(1);
        id
    }

    /// The source of ids for chunk rows.
    pub fn chunk_ids(&self) -> ChunkIds {
        self.ids.clone()
    }

    /// Says that many rows are about to come. Into a store that nothing was ever committed to they are then written once,
    /// straight into the file, and not twice, through the log, unless somebody else has the store open. Whoever opens it
    /// meanwhile finds it empty, and waits at most while a transaction is written.
    ///
    /// # Errors
    ///
    /// As [`Writer::put_chunks_unless`].
    pub(crate) fn expect_many(&mut self) -> Result<(), StoreError> {
        let Place::File(file) = &*self.place else { return Ok(()) };
        if self.site.site.generation == 0 && self.pending_bytes.is_none() && !self.without_log {
            file.close_idle();
            self.without_log = self.run(connection::leave_log)?;
        }
        Ok(())
    }

    /// As [`Writer::put_chunks_unless`], whatever happens.
    #[cfg(test)]
    pub(crate) fn put_chunks<'a>(&mut self, chunks: impl IntoIterator<Item = &'a ChunkRow>) -> Result<(), StoreError> {
        self.put_chunks_unless(chunks, &|| false)
    }

    /// Writes chunk rows, which nothing refers to before the next commit. Transactions stay open from call to call and
    /// are closed at a bounded size. Waits for nobody once `stop` says so.
    ///
    /// # Errors
    ///
    /// [`StoreError::Full`], [`StoreError::ReadOnly`], [`StoreError::Sqlite`], and [`StoreError::Busy`] if it was stopped while it
    /// waited; the writer can then only be dropped.
    pub(crate) fn put_chunks_unless<'a>(
        &mut self,
        chunks: impl IntoIterator<Item = &'a ChunkRow>,
        stop: &dyn Fn() -> bool,
    ) -> Result<(), StoreError> {
        let result = self.try_put(chunks, stop);
        if result.is_err() {
            self.failed = true;
            self.roll_back();
        }
        result
    }

    fn try_put<'a>(
        &mut self,
        chunks: impl IntoIterator<Item = &'a ChunkRow>,
        stop: &dyn Fn() -> bool,
    ) -> Result<(), StoreError> {
        let patience = self.patience();
        let mut pending = self.pending_bytes;
        // A log may end anywhere after a crash; in the file itself the order of writes matters.
        let begin = match self.without_log {
            true => "PRAGMA synchronous = FULL; BEGIN IMMEDIATE",
            false => "PRAGMA synchronous = NORMAL; BEGIN IMMEDIATE",
        };
        let mut chunks = chunks.into_iter().peekable();
        while chunks.peek().is_some() {
            if pending.is_none() {
                self.begin_log()?;
            }
            let bytes = self.run(|c| {
                let mut bytes = match pending {
                    Some(bytes) => bytes,
                    None => {
                        patiently(c, patience, stop, begin)?;
                        0
                    }
                };
                while bytes < TRANSACTION_BYTES {
                    let Some(chunk) = chunks.next() else { return Ok(Some(bytes)) };
                    rows::put_chunk(c, chunk)?;
                    bytes += chunk.bytes.len() as u64;
                }
                patiently(c, patience, stop, "COMMIT")?;
                Ok(None)
            });
            pending = bytes?;
            self.pending_bytes = pending;
            if pending.is_none() {
                self.bound_log();
            }
        }
        Ok(())
    }

    /// Makes all that was written count: one transaction, durable when this returns. Then removes what older
    /// generations leave behind, as far as readers allow.
    ///
    /// # Errors
    ///
    /// [`StoreError::Inconsistent`] if the change contradicts itself or what is stored, [`StoreError::Full`] and others
    /// if it can't be written: the store is then as it was.
    pub fn commit(&mut self, change: Flip) -> Result<Committed, StoreError> {
        self.commit_unless(change, &|| false)
    }

    /// As [`Writer::commit`]; waits for nobody once `stop` says so.
    ///
    /// # Errors
    ///
    /// As [`Writer::commit`], and [`StoreError::Busy`] if it was stopped while it waited.
    pub(crate) fn commit_unless(&mut self, change: Flip, stop: &dyn Fn() -> bool) -> Result<Committed, StoreError> {
        if self.failed {
            let what = "a write failed before".into();
            return Err(StoreError::Inconsistent { path: self.place.path().into(), what });
        }
        self.end_payload(stop)?;
        if self.without_log {
            // A journal is only beside a store without a commit: so one that a deleted store left is known for what it is.
            if let Err(e) = self.run(|c| connection::enter_log(c, stop)) {
                self.failed = true;
                return Err(e);
            }
            self.without_log = false;
            self.begins_log = true;
        }
        self.begin_log()?;
        let base = SiteRow { next_chunk: self.ids.next(), next_scan: self.next_scan, ..self.site.clone() };
        let (site, attributes) = self.run(|c| {
            patiently(c, connection::PATIENCE, stop, "PRAGMA synchronous = FULL; BEGIN IMMEDIATE")?;
            let done = flip(c, &base, &self.attributes, change).and_then(|flipped| {
                c.execute_batch("COMMIT")?;
                Ok(flipped)
            });
            if done.is_err() && !c.is_autocommit() {
                c.execute_batch("ROLLBACK")?;
            }
            done
        })?;
        (self.site, self.attributes) = (site, attributes);
        // From here on the change is made: what fails now is done by the next writer.
        let removed_rows = self.remove_garbage().unwrap_or(0);
        let log_truncated = self.tidy();
        Ok(Committed { generation: self.site.site.generation, removed_rows, log_truncated })
    }

    /// Ends the open transaction of payload, if there is one: what follows is not part of it.
    fn end_payload(&mut self, stop: &dyn Fn() -> bool) -> Result<(), StoreError> {
        let patience = self.patience();
        if self.pending_bytes.take().is_some()
            && let Err(e) = self.run(|c| patiently(c, patience, stop, "COMMIT"))
        {
            self.failed = true;
            self.roll_back();
            return Err(e);
        }
        Ok(())
    }

    /// Keeps a camera under a name; visible at once.
    ///
    /// # Errors
    ///
    /// [`StoreError::Full`], [`StoreError::ReadOnly`], [`StoreError::Sqlite`].
    pub fn put_bookmark(&mut self, name: &str, camera_json: &str) -> Result<(), StoreError> {
        self.end_payload(&|| false)?;
        self.begin_log()?;
        self.run(|c| rows::put_bookmark(c, name, camera_json))
    }

    /// Lets go of a camera; nothing happens if there is none of that name.
    ///
    /// # Errors
    ///
    /// As [`Writer::put_bookmark`].
    pub fn remove_bookmark(&mut self, name: &str) -> Result<(), StoreError> {
        self.end_payload(&|| false)?;
        self.begin_log()?;
        self.run(|c| rows::remove_bookmark(c, name))
    }

    /// Writes the file anew without the free space inside it. Takes as much room again while it runs.
    ///
    /// # Errors
    ///
    /// [`StoreError::Full`], [`StoreError::Sqlite`]; the store is then as it was.
    pub fn compact(&mut self, stop: impl Fn() -> bool + Send) -> Result<(), StoreError> {
        self.end_payload(&|| false)?;
        self.remove_garbage()?;
        self.begin_log()?;
        let folder = match &*self.place {
            Place::File(file) => file.path.parent().filter(|p| !p.as_os_str().is_empty()).map(Path::to_owned),
            Place::Memory(_) => None,
        };
        self.run(|c| {
            // The second copy lies beside the store, where there is room for a store, and not in the system's folder
            // for temporary files.
            if let Some(folder) = folder.as_deref().and_then(Path::to_str) {
                c.pragma_update(None, "temp_store_directory", folder)?;
            }
            let done = unless(c, stop, |c| Ok(c.execute_batch("PRAGMA synchronous = FULL; VACUUM")?));
            // It is the whole process's. (SQLite guards it against threads.)
            if folder.is_some() {
                c.pragma_update(None, "temp_store_directory", "")?;
            }
            done
        })?;
        self.tidy();
        Ok(())
    }

    fn run<R>(&self, f: impl FnOnce(&Connection) -> Result<R, RowError>) -> Result<R, StoreError> {
        match (&self.connection, &*self.place) {
            (Some(connection), _) => f(connection),
            (None, Place::Memory(memory)) => f(&lock(&memory.connection)),
            (None, Place::File(_)) => Err(RowError::Inconsistent("the writer is closed".into())),
        }
        .map_err(|e| self.place.error(e))
    }

    /// Makes the disk full beyond so many pages.
    #[cfg(test)]
    pub(super) fn limit_pages(&self, pages: i64) {
        let limit = format!("PRAGMA max_page_count = {pages}");
        self.run(|c| Ok(c.query_row(&limit, [], |_| Ok(()))?)).unwrap();
    }

    /// Ends writing and removes the files of the store, while nobody else can be writing to it or making another in its place.
    pub(crate) fn remove_store(mut self) {
        self.roll_back();
        self.connection = None;
        if let Place::File(file) = &*self.place {
            file.close_idle();
            files::remove(&file.path);
        }
    }

    /// How long others are waited for.
    fn patience(&self) -> Duration {
        if self.without_log { connection::PATIENCE_WITHOUT_LOG } else { connection::PATIENCE }
    }

    fn roll_back(&mut self) {
        self.pending_bytes = None;
        let _ = self.run(|c| if c.is_autocommit() { Ok(()) } else { Ok(c.execute_batch("ROLLBACK")?) });
    }

    /// Removes the rows that `garbage` names, and says how many; in memory only when no older snapshot is left.
    fn remove_garbage(&mut self) -> Result<u64, StoreError> {
        if let Place::Memory(memory) = &*self.place
            && lock(&memory.snapshots).range(..self.site.site.generation).next().is_some()
        {
            return Ok(0);
        }
        if !self.run(space::has_garbage)? {
            return Ok(0);
        }
        self.begin_log()?;
        let mut removed = 0;
        while let Some(rows) = self.run(space::remove_some_garbage)? {
            removed += rows;
        }
        Ok(removed)
    }

    /// Removes the rows that were never referred to, and says how many.
    fn remove_unreferenced(&mut self) -> Result<u64, StoreError> {
        let first = self.site.next_chunk;
        if !self.run(|c| space::has_unreferenced(c, first))? {
            return Ok(0);
        }
        self.begin_log()?;
        self.run(|c| space::remove_unreferenced(c, first))
    }

    /// Gives many free pages back to the disk and empties the log; says whether the log is empty.
    fn tidy(&mut self) -> bool {
        let Place::File(file) = &*self.place else { return true };
        let path = file.path.clone();
        if self.run(space::has_room).unwrap_or(false) && self.begin_log().is_ok() {
            let _ = self.run(space::vacuum);
        }
        self.checkpoint("TRUNCATE");
        self.wal_limit = WAL_BYTES;
        wal_bytes(&path) == 0
    }

    /// Marks a log that is begun as this file's, in a transaction before any other.
    fn begin_log(&mut self) -> Result<(), StoreError> {
        if !self.begins_log || self.without_log {
            return Ok(());
        }
        let marked = SiteRow { log: self.site.log.next(), ..self.site.clone() };
        self.run(|c| {
            // Of what follows nothing can be there without it.
            c.execute_batch("PRAGMA synchronous = NORMAL")?;
            rows::put_site(c, &marked)
        })?;
        (self.site, self.begins_log) = (marked, false);
        Ok(())
    }

    /// Has the log written back and used from its start again, when it has grown.
    fn bound_log(&mut self) {
        let Place::File(file) = &*self.place else { return };
        let path = file.path.clone();
        if self.without_log {
            return;
        }
        // Waits for nobody. Done while nodes are still being encoded, it leaves little for the commit, and the next
        // transaction begins the log anew if no reader holds it.
        self.checkpoint("PASSIVE");
        if wal_bytes(&path) < self.wal_limit {
            return;
        }
        let restarted = self.checkpoint("RESTART");
        // A reader that holds an older generation can't be hurried: try again when there is as much once more.
        self.wal_limit = if restarted { WAL_BYTES } else { self.wal_limit.saturating_add(WAL_BYTES) };
    }

    /// Did it run to its end?
    fn checkpoint(&mut self, mode: &str) -> bool {
        if self.connection.is_none() {
            return true;
        }
        let Checkpoint { done, complete } = self.run(|c| log::checkpoint(c, mode)).unwrap_or_default();
        // What is begun now may have this file's state before it.
        self.begins_log |= complete;
        done
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        self.roll_back();
        // Best effort, which keeps nobody waiting: what stays is removed by the next writer.
        let _ = self.run(|c| Ok(c.busy_timeout(log::WAIT_FOR_READERS)?));
        if self.ids.next() > self.site.next_chunk {
            let removed = self.remove_unreferenced();
            if removed.is_ok_and(|n| n > 0) {
                self.tidy();
            }
        }
        self.connection = None;
        self.lock = None;
        if let Place::Memory(memory) = &*self.place {
            *lock(&memory.writer) = false;
        }
    }
}

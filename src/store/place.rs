//! Where a store is: a file, or memory that readers and writer of one process share.

use super::cache::Caches;
use super::connection::{self, Purpose};
use super::error::{RowError, StoreError};
use super::untouched::Untouched;
use rusqlite::Connection;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Idle read connections that are kept open.
const KEPT: usize = 16;

/// Locks, also after a panic elsewhere: what the locks here guard is valid between any two statements.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What all handles of one store share.
#[derive(Debug)]
pub(super) enum Place {
    File(FilePlace),
    Memory(MemoryPlace),
}

/// How much of a store is kept in memory between reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Limits {
    /// Bytes of node rows of one snapshot: a row takes about a kilobyte, and belongs to 13,000 points.
    pub node_bytes: usize,
    /// Bytes of chunks as they are in the file, for all snapshots together.
    pub row_bytes: usize,
    /// Bytes of decoded blocks, for all snapshots together. What reads more than half of it at once does not go
    /// through it.
    pub block_bytes: usize,
}

impl Limits {
    /// At most so many bytes together, in the proportions of the default. A part of the tree that is in use is kept
    /// beyond it.
    pub fn of_bytes(bytes: usize) -> Self {
        Self { node_bytes: bytes / 11, row_bytes: bytes / 11 * 2, block_bytes: bytes / 11 * 8 }
    }

    /// For a program that asks once: nothing is kept but node rows.
    pub fn once() -> Self {
        Self { row_bytes: 0, block_bytes: 0, ..Self::default() }
    }
}

impl Default for Limits {
    fn default() -> Self {
        Self { node_bytes: 32 << 20, row_bytes: 64 << 20, block_bytes: 256 << 20 }
    }
}

#[derive(Debug)]
pub(super) struct FilePlace {
    pub path: PathBuf,
    /// For a file that is read as one that nobody can write.
    untouched: Option<Untouched>,
    pub limits: Limits,
    pub caches: Caches,
    /// Which file it was when it was opened.
    id: Option<FileId>,
    /// Read connections that nobody uses.
    idle: Mutex<Vec<Connection>>,
}

/// One connection for everybody. What a snapshot of an older generation refers to stays until the snapshot is gone.
#[derive(Debug)]
pub(super) struct MemoryPlace {
    pub caches: Caches,
    pub connection: Mutex<Connection>,
    /// How many snapshots there are, by generation.
    pub snapshots: Mutex<BTreeMap<u64, usize>>,
    /// Held by the writer.
    pub writer: Mutex<bool>,
}

impl Place {
    /// With its first connection.
    pub fn file(path: &Path, limits: Limits, connection: Connection, untouched: Option<Untouched>) -> Self {
        let idle = Mutex::new(vec![connection]);
        let caches = Caches::new(limits.row_bytes, limits.block_bytes);
        Self::File(FilePlace { path: path.to_path_buf(), untouched, limits, caches, id: file_id(path), idle })
    }

    pub fn memory(connection: Connection) -> Self {
        // All of it is in memory as it is.
        let caches = Caches::new(0, 0);
        Self::Memory(MemoryPlace {
            caches,
            connection: Mutex::new(connection),
            snapshots: Mutex::default(),
            writer: Mutex::new(false),
        })
    }

    pub fn caches(&self) -> &Caches {
        match self {
            Self::File(file) => &file.caches,
            Self::Memory(memory) => &memory.caches,
        }
    }

    /// For messages.
    pub fn path(&self) -> &Path {
        match self {
            Self::File(file) => &file.path,
            Self::Memory(_) => Path::new("(store in memory)"),
        }
    }

    /// With the path of this store.
    pub fn error(&self, error: RowError) -> StoreError {
        error.at(self.path())
    }
}

/// Device and number of a file, where files have them.
type FileId = (u64, u64);

/// Which file lies under the path now; `None`: none.
fn file_id(path: &Path) -> Option<FileId> {
    let found = std::fs::metadata(path).ok()?;
    #[cfg(unix)]
    let id = {
        use std::os::unix::fs::MetadataExt;
        (found.dev(), found.ino())
    };
    // An open store can't be replaced here.
    #[cfg(not(unix))]
    let id = (u64::from(found.is_file()), 0);
    Some(id)
}

impl FilePlace {
    /// What was read so far, and what another file holds that lies under the path now, must not be mixed.
    ///
    /// # Errors
    ///
    /// [`StoreError::Gone`] if another file lies there, or none.
    pub fn check_there(&self) -> Result<(), StoreError> {
        let is_there = self.id.is_some() && file_id(&self.path) == self.id;
        if is_there { Ok(()) } else { Err(StoreError::Gone { path: self.path.clone() }) }
    }

    /// A read connection without a transaction.
    ///
    /// # Errors
    ///
    /// [`StoreError::Gone`], and those of opening it.
    pub fn connect(&self) -> Result<Connection, StoreError> {
        self.check_there()?;
        let idle = lock(&self.idle).pop();
        match idle {
            Some(connection) => Ok(connection),
            None => {
                let purpose = if self.can_change() { Purpose::Read } else { Purpose::Immutable };
                connection::open(&self.path, purpose).map_err(|e| e.at(&self.path))
            }
        }
    }

    /// May a new generation come while this is open?
    pub fn can_change(&self) -> bool {
        self.untouched.is_none()
    }

    /// After reading: nobody has changed a file that is read as one that nobody can write.
    ///
    /// # Errors
    ///
    /// [`StoreError::Changed`].
    pub fn check_untouched(&self) -> Result<(), StoreError> {
        self.untouched.map_or(Ok(()), |untouched| untouched.check(&self.path))
    }

    /// Closes the read connections that nobody uses.
    pub fn close_idle(&self) {
        lock(&self.idle).clear();
    }

    /// Ends the connection's transaction and keeps it for later.
    pub fn give_back(&self, connection: Connection) {
        let ended = connection.is_autocommit() || connection.execute_batch("ROLLBACK").is_ok();
        let mut idle = lock(&self.idle);
        if ended && idle.len() < KEPT {
            idle.push(connection);
        }
    }
}

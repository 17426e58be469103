//! Where a store is: a file, or memory that readers and writer of one process share.

use super::connection::{self, Purpose};
use super::error::{RowError, StoreError};
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

#[derive(Debug)]
pub(super) struct FilePlace {
    pub path: PathBuf,
    pub purpose: Purpose,
    /// Read connections that nobody uses.
    idle: Mutex<Vec<Connection>>,
}

/// One connection for everybody. What a snapshot of an older generation refers to stays until the snapshot is gone.
#[derive(Debug)]
pub(super) struct MemoryPlace {
    pub connection: Mutex<Connection>,
    /// How many snapshots there are, by generation.
    pub snapshots: Mutex<BTreeMap<u64, usize>>,
    /// Held by the writer.
    pub writer: Mutex<bool>,
}

impl Place {
    pub fn file(path: &Path, purpose: Purpose, connection: Option<Connection>) -> Self {
        let idle = Mutex::new(connection.into_iter().collect());
        Self::File(FilePlace { path: path.to_path_buf(), purpose, idle })
    }

    pub fn memory(connection: Connection) -> Self {
        Self::Memory(MemoryPlace {
            connection: Mutex::new(connection),
            snapshots: Mutex::default(),
            writer: Mutex::new(false),
        })
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

impl FilePlace {
    /// A read connection without a transaction.
    pub fn connect(&self) -> Result<Connection, StoreError> {
        let idle = lock(&self.idle).pop();
        match idle {
            Some(connection) => Ok(connection),
            None => connection::open(&self.path, self.purpose).map_err(|e| e.at(&self.path)),
        }
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

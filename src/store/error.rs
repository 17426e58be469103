//! What can be wrong with a store, and how SQLite's errors become that.

use rusqlite::{ErrorCode, ffi};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a store could not be opened, read or written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum StoreError {
    /// No such file.
    #[error("{path}: there is no such store")]
    NotThere {
        /// Where it was looked for.
        path: PathBuf,
    },
    /// It was there when it was opened.
    #[error("{path}: is not the store any more that was opened: the file was removed, moved or replaced")]
    Gone {
        /// Where it was.
        path: PathBuf,
    },
    /// It was opened without a log, as on a medium that nobody can write, and is being written after all.
    #[error(
        "{path}: was changed while it was read (there was no place for a log beside it, so it was read as a file that nobody writes); \
         open it again"
    )]
    Changed {
        /// The store.
        path: PathBuf,
    },
    /// A store is one file.
    #[error("{path}: is a directory, not a store")]
    Directory {
        /// The directory.
        path: PathBuf,
    },
    /// A new store never replaces a file.
    #[error("{path}: is already there; a new store never replaces a file")]
    AlreadyThere {
        /// The file.
        path: PathBuf,
    },
    /// The name of a log, an index, a journal or a lock, as they lie beside a store: it would be taken for that, and lost.
    #[error("{path}: ends in -wal, -shm, -journal or -lock, as what lies beside a store does; give another name")]
    NameOfAnother {
        /// The file.
        path: PathBuf,
    },
    /// A store is made in a folder that is there.
    #[error("{path}: the folder {folder} does not exist; create it first")]
    NoFolder {
        /// The store.
        path: PathBuf,
        /// Where it was to be.
        folder: PathBuf,
    },
    /// Some other file.
    #[error("{path}: is not an Esker store: {found}")]
    NotAStore {
        /// The file.
        path: PathBuf,
        /// What it is instead.
        found: String,
    },
    /// Written by a newer Esker.
    #[error("{path}: has format version {found}, but this program knows versions up to {known}; use a newer Esker")]
    Newer {
        /// The store.
        path: PathBuf,
        /// Its version.
        found: i64,
        /// The newest version that this program knows.
        known: i64,
    },
    /// A row is missing, or is not what was written.
    #[error("{path}: damaged: table {table}, {key}: {what}")]
    Damaged {
        /// The store.
        path: PathBuf,
        /// The table.
        table: &'static str,
        /// Which row.
        key: String,
        /// What is wrong with it.
        what: String,
    },
    /// There is a write-ahead log beside the store that belongs to another one, or to another state of it.
    #[error(
        "{path}: the file {path}-wal beside it is the log of another store, or of this one in another state (was one of them \
         put there from a copy?); if the store is the one that you want, move the log away"
    )]
    ForeignWal {
        /// The store.
        path: PathBuf,
    },
    /// There is a rollback journal beside the store that belongs to another one.
    #[error(
        "{path}: the file {path}-journal beside it belongs to another store; move it away (it is of no use to this one)"
    )]
    ForeignJournal {
        /// The store.
        path: PathBuf,
    },
    /// Another writer has it, in this or another process.
    #[error("{path}: is being written by {owner}; wait until it is finished, or give --wait")]
    InUse {
        /// The store.
        path: PathBuf,
        /// `another process (process N)`, or another writer in this one.
        owner: String,
    },
    /// The file has several names: a log would lie beside one of them, and who comes by another would not see it.
    #[error(
        "{path}: the file has {names} names (hard links), and whoever writes by one of them could destroy it for the others; make \
         a copy of its own first (`cp` and `mv`)"
    )]
    HardLinked {
        /// The store.
        path: PathBuf,
        /// How many.
        names: u64,
    },
    /// SQLite waited for another process in vain.
    #[error("{path}: another process keeps it locked; try again")]
    Busy {
        /// The store.
        path: PathBuf,
    },
    /// No space left.
    #[error("{path}: the disk is full; free some space and run the command again: what was committed is kept")]
    Full {
        /// The store.
        path: PathBuf,
    },
    /// A new store's place can't be written.
    #[error("{path}: cannot be made there (read-only folder or medium); name a place that can be written")]
    ReadOnlyFolder {
        /// The store.
        path: PathBuf,
    },
    /// The place can't be written.
    #[error(
        "{path}: cannot be written (read-only file, folder or medium); copy the store to a place that can be written, or name one"
    )]
    ReadOnly {
        /// The store.
        path: PathBuf,
    },
    /// The place can't be read as it is.
    #[error(
        "{path}: has uncommitted traces of a writer beside it ({path}-wal or {path}-journal) but lies on a read-only medium; copy \
         all of them to a writable place and open the copy"
    )]
    NeedsRecovery {
        /// The store.
        path: PathBuf,
    },
    /// The operating system refused.
    #[error("{path}: {action} failed")]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// The system's word.
        source: std::io::Error,
    },
    /// A valid store, but something that this version does not do.
    #[error("{path}: {what} is not supported by this version")]
    Unsupported {
        /// The store.
        path: PathBuf,
        /// The feature.
        what: String,
    },
    /// SQLite failed otherwise.
    #[error("{path}: SQLite failed")]
    Sqlite {
        /// The store.
        path: PathBuf,
        /// SQLite's word.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// What was to be committed contradicts itself: a mistake of the caller, not of the file. Nothing was changed.
    #[error("{path}: refused to commit: {what}")]
    Inconsistent {
        /// The store.
        path: PathBuf,
        /// The contradiction.
        what: String,
    },
}

/// What goes wrong while rows are read or written, before the store's path is known.
#[derive(Debug)]
pub(super) enum RowError {
    /// A row is missing or wrong.
    Damage { table: &'static str, key: String, what: String },
    /// SQLite's own.
    Sqlite(rusqlite::Error),
    /// The caller's mistake.
    Inconsistent(String),
}

impl RowError {
    /// A damaged row.
    pub fn damage(table: &'static str, key: impl Into<String>, what: impl Into<String>) -> Self {
        Self::Damage { table, key: key.into(), what: what.into() }
    }

    /// Is it about what the file holds, not about how it is reached?
    pub fn is_damage(&self) -> bool {
        match self {
            Self::Damage { .. } => true,
            Self::Sqlite(e) => !matches!(
                e.sqlite_error_code(),
                Some(
                    ErrorCode::CannotOpen
                        | ErrorCode::DatabaseBusy
                        | ErrorCode::DatabaseLocked
                        | ErrorCode::DiskFull
                        | ErrorCode::OperationInterrupted
                        | ErrorCode::OutOfMemory
                        | ErrorCode::PermissionDenied
                        | ErrorCode::ReadOnly
                        | ErrorCode::SystemIoFailure
                )
            ),
            Self::Inconsistent(_) => false,
        }
    }

    /// With the path of the store.
    pub fn at(self, path: &Path) -> StoreError {
        let path = path.to_path_buf();
        match self {
            Self::Damage { table, key, what } => StoreError::Damaged { path, table, key, what },
            Self::Sqlite(source) => from_sqlite(source, path),
            Self::Inconsistent(what) => StoreError::Inconsistent { path, what },
        }
    }
}

impl From<rusqlite::Error> for RowError {
    fn from(error: rusqlite::Error) -> Self {
        Self::Sqlite(error)
    }
}

fn from_sqlite(error: rusqlite::Error, path: PathBuf) -> StoreError {
    let damaged = |what: String| StoreError::Damaged {
        path: path.clone(),
        table: "SQLite",
        key: "structure of the file".into(),
        what,
    };
    match &error {
        rusqlite::Error::SqliteFailure(ffi::Error { code, extended_code }, message) => match code {
            ErrorCode::DatabaseCorrupt => damaged(error.to_string()),
            ErrorCode::NotADatabase => {
                StoreError::NotAStore { path, found: "it does not begin as an SQLite database does".into() }
            }
            ErrorCode::DiskFull => StoreError::Full { path },
            // The shared index of the log can only fail to grow for want of space.
            _ if *extended_code == ffi::SQLITE_IOERR_SHMSIZE => StoreError::Full { path },
            ErrorCode::ReadOnly if *extended_code == ffi::SQLITE_READONLY_RECOVERY => {
                StoreError::NeedsRecovery { path }
            }
            ErrorCode::ReadOnly => StoreError::ReadOnly { path },
            ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked => StoreError::Busy { path },
            // Our statements fit our schema: if SQLite can't make sense of them, the schema is damaged.
            ErrorCode::Unknown => damaged(message.clone().unwrap_or_else(|| error.to_string())),
            _ => StoreError::Sqlite { path, source: error.into() },
        },
        rusqlite::Error::InvalidColumnType(..)
        | rusqlite::Error::IntegralValueOutOfRange(..)
        | rusqlite::Error::FromSqlConversionFailure(..)
        | rusqlite::Error::Utf8Error(..)
        | rusqlite::Error::QueryReturnedNoRows => damaged(error.to_string()),
        _ => StoreError::Sqlite { path, source: error.into() },
    }
}

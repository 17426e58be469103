//! The write-ahead log: when it is written back, and how it is known to be this file's.
//!
//! SQLite applies whatever lies beside a file under the name of its log. A store that was put back from a copy, or put where
//! a deleted one was, would take in pages of another file and be lost. So every log begins with a mark: the row of the site
//! says which log it was written in and which one came before, and a log belongs to a file that has one of the two.

use super::connection;
use super::error::RowError;
use rusqlite::Connection;
use std::time::Duration;

/// How long the writer waits for readers to let go of the log; they renew their transactions several times in this
/// time, unless a flip has overtaken them.
pub(super) const WAIT_FOR_READERS: Duration = Duration::from_millis(600);

/// In which log the row of the site was last written, and which was the log before: random numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LogMark {
    pub this: i64,
    pub before: i64,
}

impl LogMark {
    /// Of a file that never had a log.
    pub fn random() -> Self {
        let this = rand::random();
        Self { this, before: this }
    }

    /// Of the log after this one.
    pub fn next(self) -> Self {
        Self { this: rand::random(), before: self.this }
    }

    /// Can a file that says `file` have a log that says this?
    pub fn can_follow(self, file: Self) -> bool {
        file.this == self.this || file.this == self.before
    }
}

/// How far a checkpoint came.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Checkpoint {
    /// It waited for nobody in vain.
    pub done: bool,
    /// All of the log is in the file.
    pub complete: bool,
}

/// Writes the log back, in a mode of SQLite's: PASSIVE, RESTART or TRUNCATE.
pub(super) fn checkpoint(connection: &Connection, mode: &str) -> Result<Checkpoint, RowError> {
    connection.busy_timeout(WAIT_FOR_READERS)?;
    let counts = |row: &rusqlite::Row<'_>| Ok([row.get::<_, i64>(0)?, row.get(1)?, row.get(2)?]);
    let result = connection.query_row(&format!("PRAGMA wal_checkpoint({mode})"), [], counts);
    connection.busy_timeout(connection::PATIENCE)?;
    let [busy, in_log, written_back] = result?;
    Ok(Checkpoint { done: busy == 0, complete: busy == 0 && in_log == written_back })
}

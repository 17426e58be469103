//! Ending what is one statement to SQLite and takes long, or waits for others.

use super::error::RowError;
use rusqlite::{Connection, ErrorCode};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::{Duration, Instant};

/// How often it is asked whether to go on.
const ASK_EVERY: Duration = Duration::from_millis(20);

/// Where SQLite gives up without waiting it is not asked again at once.
const BETWEEN_TRIES: Duration = Duration::from_millis(5);

/// Runs `work` on the connection; once `stop` says so, its statements end with an error, and change nothing.
pub(super) fn unless<R>(
    connection: &Connection,
    stop: impl Fn() -> bool + Send,
    work: impl FnOnce(&Connection) -> Result<R, RowError>,
) -> Result<R, RowError> {
    let handle = connection.get_interrupt_handle();
    let (done, is_done) = channel::<()>();
    thread::scope(|scope| {
        scope.spawn(move || {
            while let Err(RecvTimeoutError::Timeout) = is_done.recv_timeout(ASK_EVERY) {
                // Again and again: it may come between two statements.
                if stop() {
                    handle.interrupt();
                }
            }
        });
        let result = work(connection);
        drop(done);
        result
    })
}

/// Runs one statement that may have to wait for the locks of others, again and again, until they let it, `patience` is used
/// up, or `stop` says so: the last two give the error that somebody has it locked. What has failed has changed nothing.
pub(super) fn patiently(
    connection: &Connection,
    patience: Duration,
    stop: &dyn Fn() -> bool,
    statement: &str,
) -> Result<(), RowError> {
    let begun = Instant::now();
    connection.busy_timeout(ASK_EVERY)?;
    let result = loop {
        match connection.execute_batch(statement) {
            // SQLite itself does not end a wait before its time.
            Err(e) if is_busy(&e) && begun.elapsed() < patience && !stop() => thread::sleep(BETWEEN_TRIES),
            other => break other,
        }
    };
    connection.busy_timeout(patience)?;
    Ok(result?)
}

/// Has somebody else locked what is wanted?
pub(super) fn is_busy(error: &rusqlite::Error) -> bool {
    matches!(error.sqlite_error_code(), Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicBool, Ordering};

    #[test]
    fn a_statement_ends_once_it_is_to_stop_and_the_next_does_not() {
        // Longer than a test may take.
        const LONG: &str =
            "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 200000000) SELECT max(i) FROM n";
        let connection = Connection::open_in_memory().unwrap();
        let count = |c: &Connection, sql: &str| c.query_row(sql, [], |row| row.get::<_, i64>(0));
        let begun = AtomicBool::new(false);
        // Not at the first question: the statement is under way by the second.
        let stop = || begun.swap(true, Ordering::Relaxed);
        let ended = unless(&connection, stop, |c| Ok(count(c, LONG)?));
        assert!(ended.is_err(), "{ended:?}");
        assert_eq!(unless(&connection, || false, |c| Ok(count(c, "SELECT 7")?)).unwrap(), 7);
    }
}

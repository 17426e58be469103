//! Ending what is one statement to SQLite and takes long.

use super::error::RowError;
use rusqlite::Connection;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

/// How often it is asked whether to go on.
const ASK_EVERY: Duration = Duration::from_millis(20);

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

//! Ctrl-C in commands that change no store: the work ends, and no half-written output is left.

use crate::formats::remove_unfinished;
use crate::query::Cancel;
use std::time::Duration;

/// How long a command may take to end in good order.
const PATIENCE: Duration = Duration::from_millis(500);

/// A token that Ctrl-C cancels. A command that has not ended soon after that is ended: it may be waiting for whoever
/// reads its output.
pub(super) fn cancelled_by_interrupt() -> Cancel {
    let cancel = Cancel::new();
    let token = cancel.clone();
    // Where no handler can be set Ctrl-C keeps its ordinary meaning.
    let _ = ctrlc::set_handler(move || {
        token.cancel();
        std::thread::sleep(PATIENCE);
        remove_unfinished();
        std::process::exit(i32::from(super::EXIT_INTERRUPTED));
    });
    cancel
}

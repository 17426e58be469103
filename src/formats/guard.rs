//! Other people's decoders may panic on damaged data: here that becomes a value.

use std::any::Any;
use std::cell::Cell;
use std::panic::{self, AssertUnwindSafe};
use std::sync::Once;

thread_local! {
    static QUIET: Cell<bool> = const { Cell::new(false) };
}

/// Runs `decode`; a panic inside becomes `Err` with its message, and stays off stderr.
///
/// What `decode` has borrowed mutably must not be relied on after a panic.
pub(super) fn catching<T>(decode: impl FnOnce() -> T) -> Result<T, String> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let report = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            // A thread whose locals are gone is not inside `catching`.
            if !QUIET.try_with(Cell::get).unwrap_or(false) {
                report(info);
            }
        }));
    });
    let before = QUIET.replace(true);
    let result = panic::catch_unwind(AssertUnwindSafe(decode));
    QUIET.set(before);
    result.map_err(|payload| message(&*payload))
}

fn message(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<&str>().map(|s| (*s).to_owned());
    text.or_else(|| payload.downcast_ref::<String>().cloned()).unwrap_or_else(|| "no message".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panics_become_values() {
        assert_eq!(catching(|| 1), Ok(1));
        assert_eq!(catching(|| panic!("at {}", 7)), Err::<(), _>("at 7".to_owned()));
        assert_eq!(catching(|| catching(|| panic!("inner"))), Ok(Err::<(), _>("inner".to_owned())));
        assert!(!QUIET.get());
    }
}

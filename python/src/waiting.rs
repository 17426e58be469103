//! Work without the interpreter's lock, that can be interrupted.

use crate::errors::misuse;
use pyo3::prelude::*;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

/// How often a thread that waits looks for signals.
pub const LOOK_EVERY: Duration = Duration::from_millis(20);

/// The process whose threads have worked; 0 if none has.
static WORKED_IN: AtomicU32 = AtomicU32::new(0);

/// Refuses work in a process that was forked from one that has worked: the threads that its answers wait for did not come along.
pub fn check_process() -> PyResult<()> {
    let here = std::process::id();
    match WORKED_IN.compare_exchange(0, here, Ordering::Relaxed, Ordering::Relaxed) {
        Ok(_) => Ok(()),
        Err(worked_in) if worked_in == here => Ok(()),
        Err(_) => Err(misuse(
            "this process was forked from one in which esker has worked, and its threads did not come along; let processes be \
             spawned, multiprocessing.set_start_method(\"spawn\")",
        )),
    }
}

/// Runs `work` on a thread of its own while this one waits with the interpreter's lock released, and every now and then
/// takes the lock to handle signals and to call `tick`. If either raises, `stop` is called, and what was raised is passed on
/// once `work` has ended; so nothing is left running.
pub fn interruptible<R: Send>(
    py: Python<'_>,
    stop: impl Fn() + Send + Sync,
    mut tick: impl FnMut(Python<'_>) -> PyResult<()> + Send,
    work: impl FnOnce() -> R + Send,
) -> PyResult<R> {
    check_process()?;
    py.detach(|| {
        thread::scope(|scope| {
            let (sender, receiver) = channel();
            scope.spawn(move || {
                // The receiver waits until this is sent.
                let _ = sender.send(catch_unwind(AssertUnwindSafe(work)));
            });
            let mut raised = None;
            loop {
                match receiver.recv_timeout(LOOK_EVERY) {
                    Ok(done) => {
                        let result = done.unwrap_or_else(|panic| resume_unwind(panic));
                        return raised.map_or(Ok(result), Err);
                    }
                    Err(RecvTimeoutError::Timeout) if raised.is_none() => {
                        let looked = Python::attach(|py| py.check_signals().and_then(|()| tick(py)));
                        if let Err(error) = looked {
                            stop();
                            raised = Some(error);
                        }
                    }
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => return Err(misuse("the worker thread is gone")),
                }
            }
        })
    })
}

/// For work that can't be stopped: what was raised waits until its end.
pub fn to_its_end() {}

/// For work that tells nothing while it goes on.
pub fn quietly(_: Python<'_>) -> PyResult<()> {
    Ok(())
}

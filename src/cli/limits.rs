//! What the shell lets a process have: the size of files (`ulimit -f`), how many are open (`ulimit -n`).

/// Lets as many files be open as the system allows at most: the ordinary limit is there for programs of another kind.
pub(super) fn open_many_files() {
    #[cfg(unix)]
    {
        use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
        let Rlimit { maximum, .. } = getrlimit(Resource::Nofile);
        // Where that is refused the limit stays as it is, and is told when it is met.
        let _ = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum });
    }
}

/// Lets a write beyond that size fail as on a full disk, so that it ends in good order. Otherwise a signal ends the process
/// on the spot, without a word, and half-written files stay.
///
/// For this thread and all that it begins afterwards.
pub(super) fn let_writes_fail() {
    #[cfg(unix)]
    {
        let mut signals = nix::sys::signal::SigSet::empty();
        signals.add(nix::sys::signal::Signal::SIGXFSZ);
        // Where it can't be held back the signal keeps its ordinary meaning.
        let _ = signals.thread_block();
    }
}

/// What to add to an error that comes of that size.
#[cfg(unix)]
pub(super) fn of_file_size(error: &anyhow::Error) -> Option<String> {
    use crate::ingest::IngestError;
    use crate::store::StoreError;
    use rustix::process::{Resource, getrlimit};
    use std::io;
    let bytes = getrlimit(Resource::Fsize).current?;
    let of_system = |e: &(dyn std::error::Error + 'static)| {
        e.downcast_ref().is_some_and(|e: &io::Error| e.kind() == io::ErrorKind::FileTooLarge)
    };
    // SQLite does not tell what the system said.
    let of_sqlite = matches!(error.downcast_ref(), Some(IngestError::Store(StoreError::Sqlite { .. })));
    (of_sqlite || error.chain().any(of_system))
        .then(|| format!("; no file may be larger than {bytes} bytes here: raise that limit (`ulimit -f`)"))
}

/// There is no such limit.
#[cfg(not(unix))]
pub(super) fn of_file_size(_: &anyhow::Error) -> Option<String> {
    None
}

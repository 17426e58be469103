//! A store that is read without its log, as on a medium that nobody can write, and must stay as it is meanwhile: SQLite then
//! takes no locks, and whoever can write it after all would change it from under its reader.

use super::error::StoreError;
use super::files::{has_journal, wal_bytes};
use std::path::Path;
use std::time::SystemTime;

/// What a file was like when it was opened in this way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Untouched {
    bytes: u64,
    modified: Option<SystemTime>,
}

impl Untouched {
    /// As it is now.
    pub fn of(path: &Path) -> Result<Self, StoreError> {
        let facts = std::fs::metadata(path).map_err(|source| StoreError::Io {
            path: path.into(),
            action: "looking at the store",
            source,
        })?;
        Ok(Self { bytes: facts.len(), modified: facts.modified().ok() })
    }

    /// Is it so still, and has nobody begun to write? A writer has a log or a journal before it changes the file.
    pub fn check(self, path: &Path) -> Result<(), StoreError> {
        if wal_bytes(path) == 0 && !has_journal(path) && Self::of(path)? == self {
            return Ok(());
        }
        Err(StoreError::Changed { path: path.into() })
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::super::testing::{content, options, replace, some_points};
    use super::super::{Store, StoreError};
    use std::fs;

    #[test]
    fn a_file_read_without_its_log_and_changed_meanwhile_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.esker");
        let index = folder.path().join("a.esker-shm");
        replace(&Store::create(&path, options()).unwrap(), some_points(900));
        // SQLite follows no link to an index.
        std::os::unix::fs::symlink("nowhere", &index).unwrap();
        assert_eq!(content(&Store::open(&path).unwrap().snapshot().unwrap()).unwrap().len(), 900);
        // Nothing of its content is in memory.
        let held = Store::open(&path).unwrap();
        let snapshot = held.snapshot().unwrap();
        fs::remove_file(&index).unwrap();
        let changed = |result: Result<(), StoreError>| matches!(result, Err(StoreError::Changed { .. }));
        let writing = Store::open(&path).unwrap();
        replace(&writing, some_points(500));
        assert!(changed(content(&snapshot).map(drop)));
        assert!(changed(held.snapshot().map(drop)) && changed(held.changed(&snapshot).map(drop)));
        // And once its log is applied and gone.
        drop(writing);
        assert!(!folder.path().join("a.esker-wal").exists());
        assert!(changed(content(&snapshot).map(drop)));
        assert_eq!(content(&Store::open(&path).unwrap().snapshot().unwrap()).unwrap().len(), 500);
    }
}

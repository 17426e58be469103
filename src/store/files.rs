//! The files of a store: its own, and those that may lie beside it.

use super::error::StoreError;
use std::borrow::Cow;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// A file beside a store that is nobody's once its process has ended: `STORE.spill-PROCESS-NUMBER`, `STORE.partial-PROCESS-NUMBER`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Temporary {
    /// Rows of an ingest that do not fit its memory.
    Spill,
    /// A copy of another store that is not complete.
    Copy,
}

impl Temporary {
    /// What comes after the store's own name.
    fn suffix(self) -> &'static str {
        match self {
            Self::Spill => ".spill-",
            Self::Copy => ".partial-",
        }
    }

    /// The file beside this store; `number` tells several of this process apart.
    pub fn path(self, store: &Path, number: u64) -> PathBuf {
        beside(store, &format!("{}{}-{number}", self.suffix(), std::process::id()))
    }

    /// Those that are there; only what has a lock on the store may take them for left behind.
    ///
    /// # Errors
    ///
    /// If the folder can't be read.
    pub fn there(self, store: &Path) -> std::io::Result<Vec<PathBuf>> {
        let Some(name) = store.file_name() else { return Ok(Vec::new()) };
        let mut found = Vec::new();
        for entry in std::fs::read_dir(folder_of(store))? {
            let entry = entry?;
            let other = entry.file_name();
            let rest = other.as_encoded_bytes().strip_prefix(name.as_encoded_bytes());
            if rest.is_some_and(|rest| self.is_ending(rest)) && entry.file_type()?.is_file() {
                found.push(entry.path());
            }
        }
        Ok(found)
    }

    /// Is it the suffix and two numbers? Anything else is the name of a user's file.
    fn is_ending(self, ending: &[u8]) -> bool {
        let Some(numbers) = ending.strip_prefix(self.suffix().as_bytes()) else { return false };
        let numbers: Vec<&[u8]> = numbers.split(|&b| b == b'-').collect();
        numbers.len() == 2 && numbers.iter().all(|n| !n.is_empty() && n.iter().all(u8::is_ascii_digit))
    }
}

/// `path` with something appended to its file name.
pub(super) fn beside(path: &Path, suffix: &str) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(suffix);
    name.into()
}

/// The file that a link leads to: a store's log, its journal and its lock lie beside the file itself, whatever it is called.
pub fn followed(path: &Path) -> Cow<'_, Path> {
    let is_link = std::fs::symlink_metadata(path).is_ok_and(|facts| facts.is_symlink());
    match std::fs::canonicalize(path) {
        Ok(file) if is_link => file.into(),
        _ => path.into(),
    }
}

/// Is it called like a file beside a store? A store so called would be taken for the log or the lock of another, and that one's
/// writer would cut it off or remove it.
pub(super) fn is_named_as_beside(path: &Path) -> bool {
    let name = path.as_os_str().as_encoded_bytes();
    let is_spill = |at: usize| Temporary::Spill.is_ending(&name[at..]);
    ["-wal", "-shm", "-journal", "-lock"].iter().any(|suffix| name.ends_with(suffix.as_bytes()))
        || name.iter().rposition(|&b| b == b'.').is_some_and(is_spill)
}

/// The write-ahead log.
pub(super) fn wal(path: &Path) -> PathBuf {
    beside(path, "-wal")
}

/// The size of the write-ahead log; 0 if there is none.
pub(super) fn wal_bytes(path: &Path) -> u64 {
    std::fs::metadata(wal(path)).map_or(0, |m| m.len())
}

/// Is all of a store in its file, and nothing in a log beside it?
pub(crate) fn has_empty_log(path: &Path) -> bool {
    wal_bytes(path) == 0
}

/// The rollback journal, which is there while the store is made or first filled.
pub(super) fn journal(path: &Path) -> PathBuf {
    beside(path, "-journal")
}

/// Is there a rollback journal?
pub(super) fn has_journal(path: &Path) -> bool {
    std::fs::metadata(journal(path)).is_ok_and(|m| m.len() > 0)
}

/// Removes a store, as far as that can be done: what stays is an empty one, which does no harm. The lock is its holder's.
pub(super) fn remove(path: &Path) {
    for path in [path.to_path_buf(), wal(path), beside(path, "-shm"), journal(path)] {
        let _ = std::fs::remove_file(path);
    }
}

/// The folder in which a file lies.
fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Is there a folder for it?
///
/// # Errors
///
/// [`StoreError::NoFolder`].
pub fn check_folder(path: &Path) -> Result<(), StoreError> {
    let folder = folder_of(path);
    let is_missing = match std::fs::metadata(folder) {
        Ok(there) => !there.is_dir(),
        Err(e) => matches!(e.kind(), std::io::ErrorKind::NotFound | std::io::ErrorKind::NotADirectory),
    };
    if is_missing {
        return Err(StoreError::NoFolder { path: path.into(), folder: folder.into() });
    }
    Ok(())
}

/// Removes files of crashed ingests; the caller holds the writer's lock. Gives how many there were.
pub(super) fn remove_spills(path: &Path) -> std::io::Result<u64> {
    let left = Temporary::Spill.there(path)?;
    left.iter().try_for_each(std::fs::remove_file)?;
    Ok(left.len() as u64)
}

/// An SQLite URI for the file, with every special byte of the path escaped.
pub(super) fn uri(path: &Path, parameters: &str) -> String {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    let mut uri = String::from("file:");
    if !absolute.as_os_str().as_encoded_bytes().starts_with(b"/") {
        uri.push('/');
    }
    for &b in absolute.as_os_str().as_encoded_bytes() {
        match b {
            b'/' | b'.' | b'-' | b'_' | b'~' | b'0'..=b'9' | b'a'..=b'z' | b'A'..=b'Z' => uri.push(b as char),
            b'\\' if cfg!(windows) => uri.push('/'),
            b':' if cfg!(windows) => uri.push(':'),
            _ => uri.push_str(&format!("%{b:02X}")),
        }
    }
    uri.push('?');
    uri.push_str(parameters);
    uri
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn special_characters_of_a_path_are_escaped() {
        assert_eq!(uri(Path::new("/a b/c?d#e%f.esker"), "mode=ro"), "file:/a%20b/c%3Fd%23e%25f.esker?mode=ro");
    }

    #[test]
    fn only_spills_of_this_store_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("a.esker");
        let other = Temporary::Spill.path(&folder.path().join("aa.esker"), 1);
        // What a user may call a file, a store even.
        let users = ["2", "report.txt", "1-2.txt", "1-", "-2", "1-2-3", "a.esker"]
            .map(|tag| beside(&store, &format!(".spill-{tag}")));
        let spills = [Temporary::Spill.path(&store, 1), Temporary::Spill.path(&store, 2)];
        let kept: Vec<PathBuf> =
            users.iter().chain([&other]).cloned().chain([wal(&store), Temporary::Copy.path(&store, 1)]).collect();
        spills.iter().chain(&kept).for_each(|path| std::fs::write(path, b"x").unwrap());
        let folder_of_that_name = beside(&store, ".spill-7-7");
        std::fs::create_dir(&folder_of_that_name).unwrap();
        assert_eq!(remove_spills(&store).unwrap(), 2);
        assert!(kept.iter().all(|path| path.exists()) && folder_of_that_name.exists());
        assert!(spills.iter().all(|path| is_named_as_beside(path)));
        assert!(users.iter().all(|path| !is_named_as_beside(path)));
    }
}

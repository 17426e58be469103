//! The writer's lock: a file beside the store that the kernel unlocks when its holder ends, however it ends.

use super::error::StoreError;
use super::files::{beside, check_folder, is_named_as_beside};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// What messages call another writer of this process.
pub(super) const WRITER_HERE: &str = "this process already";

/// So often a lock that is taken is tried again, a millisecond later each time.
const LOOKS: u32 = 3;

/// Held by the one writer of a store.
#[derive(Debug)]
pub(crate) struct WriterLock {
    file: File,
    path: PathBuf,
}

impl WriterLock {
    /// Takes the lock.
    pub fn take(store: &Path) -> Result<Self, StoreError> {
        if is_named_as_beside(store) {
            return Err(StoreError::NameOfAnother { path: store.to_path_buf() });
        }
        check_folder(store)?;
        let names = names(store);
        if names > 1 {
            return Err(StoreError::HardLinked { path: store.to_path_buf(), names });
        }
        let path = beside(store, "-lock");
        let mut looks = 0;
        loop {
            let mut file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path).map_err(
                |source| match source.kind() {
                    std::io::ErrorKind::ReadOnlyFilesystem | std::io::ErrorKind::PermissionDenied => {
                        StoreError::ReadOnly { path: store.to_path_buf() }
                    }
                    std::io::ErrorKind::StorageFull => StoreError::Full { path: store.to_path_buf() },
                    _ => StoreError::Io { path: path.clone(), action: "opening the writer's lock", source },
                },
            )?;
            match file.try_lock() {
                Ok(()) => {}
                // Somebody who only looks (`is_taken`) has it for a moment.
                Err(TryLockError::WouldBlock) if looks < LOOKS => {
                    looks += 1;
                    std::thread::sleep(Duration::from_millis(1));
                    continue;
                }
                Err(TryLockError::WouldBlock) => {
                    let mut owner = String::new();
                    let _ = (&file).take(20).read_to_string(&mut owner);
                    let owner = match owner.trim().parse::<u32>() {
                        Ok(id) if id == std::process::id() => WRITER_HERE.into(),
                        Ok(id) => format!("another process (process {id})"),
                        Err(_) => "another process".into(),
                    };
                    return Err(StoreError::InUse { path: store.to_path_buf(), owner });
                }
                Err(TryLockError::Error(source)) => {
                    return Err(StoreError::Io { path, action: "taking the writer's lock", source });
                }
            }
            // The one who held it before may have removed the file between our opening and our locking it.
            if is_at(&file, &path) {
                let _ = file.set_len(0).and_then(|()| writeln!(file, "{}", std::process::id()));
                return Ok(Self { file, path });
            }
        }
    }

    /// Is there a writer? Looks without taking part.
    pub fn is_taken(store: &Path) -> bool {
        let Ok(file) = File::open(beside(store, "-lock")) else { return false };
        matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock))
    }
}

impl Drop for WriterLock {
    fn drop(&mut self) {
        // While it is still held, so that nobody can hold a removed file and believe in it: see `take`.
        if cfg!(unix) {
            let _ = std::fs::remove_file(&self.path);
        }
        let _ = self.file.unlock();
    }
}

/// How many names the file has; 1 if nobody can tell.
#[cfg(unix)]
fn names(path: &Path) -> u64 {
    use std::os::unix::fs::MetadataExt;
    std::fs::metadata(path).ok().filter(std::fs::Metadata::is_file).map_or(1, |m| m.nlink())
}

#[cfg(not(unix))]
fn names(_: &Path) -> u64 {
    1
}

/// Is `file` what lies under `path`?
#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let id = |m: std::fs::Metadata| (m.dev(), m.ino());
    match (file.metadata(), std::fs::metadata(path)) {
        (Ok(a), Ok(b)) => id(a) == id(b),
        _ => false,
    }
}

/// Nobody removes the file here.
#[cfg(not(unix))]
fn is_at(_: &File, _: &Path) -> bool {
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lock_is_held_by_one_and_given_back() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("a.esker");
        assert!(!WriterLock::is_taken(&store));
        let lock = WriterLock::take(&store).unwrap();
        assert!(WriterLock::is_taken(&store));
        let error = WriterLock::take(&store).unwrap_err().to_string();
        assert!(error.contains("a.esker: is being written by this process already"), "{error}");
        drop(lock);
        assert!(!WriterLock::is_taken(&store));
        drop(WriterLock::take(&store).unwrap());
    }

    #[cfg(unix)]
    #[test]
    fn a_file_of_several_names_is_not_written() {
        let folder = tempfile::tempdir().unwrap();
        let (store, other) = (folder.path().join("a.esker"), folder.path().join("b.esker"));
        std::fs::write(&store, b"x").unwrap();
        drop(WriterLock::take(&store).unwrap());
        std::fs::hard_link(&store, &other).unwrap();
        for path in [&store, &other] {
            let error = WriterLock::take(path).unwrap_err().to_string();
            assert!(error.contains("has 2 names (hard links)"), "{error}");
            assert!(!beside(path, "-lock").exists());
        }
        std::fs::remove_file(other).unwrap();
        drop(WriterLock::take(&store).unwrap());
    }

    #[test]
    fn a_lock_file_that_a_killed_process_left_holds_nobody_up() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("a.esker");
        std::fs::write(beside(&store, "-lock"), b"12345").unwrap();
        WriterLock::take(&store).unwrap();
    }
}

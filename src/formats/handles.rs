//! Handles of files that are read: of many inputs only some are open at once, as systems allow few.

use std::collections::VecDeque;
use std::fs::{File, Metadata};
use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::SystemTime;

/// So many are open at once, and those that are being read. Systems allow 256 and more.
const MOST: usize = 48;

/// The handles that are open, the longest first.
static OPEN: Mutex<VecDeque<Weak<Slot>>> = Mutex::new(VecDeque::new());

type Slot = Mutex<Option<Arc<File>>>;

/// A file that is opened when it is read, and may be closed between two reads.
#[derive(Debug)]
pub(super) struct Handle {
    slot: Arc<Slot>,
    /// What it was when it was opened first.
    known: Known,
}

/// By what a file is known again.
#[derive(Debug, PartialEq)]
struct Known {
    bytes: u64,
    modified: Option<SystemTime>,
    inode: Option<(u64, u64)>,
}

impl Known {
    fn of(metadata: &Metadata) -> Self {
        Self { bytes: metadata.len(), modified: metadata.modified().ok(), inode: inode(metadata) }
    }
}

#[cfg(unix)]
fn inode(metadata: &Metadata) -> Option<(u64, u64)> {
    use std::os::unix::fs::MetadataExt;
    Some((metadata.dev(), metadata.ino()))
}

#[cfg(not(unix))]
fn inode(_: &Metadata) -> Option<(u64, u64)> {
    None
}

impl Handle {
    /// Opens `path`; gives its size, too.
    pub fn open(path: &Path) -> io::Result<(Self, u64)> {
        let file = File::open(path)?;
        let known = Known::of(&file.metadata()?);
        let bytes = known.bytes;
        let handle = Self { slot: Arc::new(Mutex::new(Some(Arc::new(file)))), known };
        handle.is_open();
        Ok((handle, bytes))
    }

    /// The file, which is opened again if it was closed meanwhile. It stays open at least as long as what is given.
    ///
    /// # Errors
    ///
    /// As the system says; [`io::ErrorKind::InvalidData`] if it is another file now.
    pub fn get(&self, path: &Path) -> io::Result<Arc<File>> {
        let mut slot = lock(&self.slot);
        if let Some(file) = &*slot {
            return Ok(file.clone());
        }
        let file = Arc::new(File::open(path)?);
        if Known::of(&file.metadata()?) != self.known {
            return Err(io::Error::new(
                io::ErrorKind::InvalidData,
                "the file was changed or replaced while it was read",
            ));
        }
        *slot = Some(file.clone());
        drop(slot);
        self.is_open();
        Ok(file)
    }

    /// Closes those that have been open longest.
    fn is_open(&self) {
        let mut open = lock(&OPEN);
        open.retain(|slot| slot.strong_count() > 0);
        open.push_back(Arc::downgrade(&self.slot));
        while open.len() > MOST {
            if let Some(slot) = open.pop_front().and_then(|slot| slot.upgrade()) {
                *lock(&slot) = None;
            }
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;

    #[test]
    fn few_files_are_open_at_once_and_another_one_is_never_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = |i: usize| folder.path().join(format!("{i}"));
        let handles: Vec<_> = (0..3 * MOST)
            .map(|i| {
                std::fs::write(path(i), format!("{i}")).unwrap();
                Handle::open(&path(i)).unwrap().0
            })
            .collect();
        let open = || handles.iter().filter(|h| lock(&h.slot).is_some()).count();
        assert!(open() <= MOST, "{}", open());
        for i in [0, 7, 2 * MOST, 0] {
            let mut text = String::new();
            let mut file: &File = &handles[i].get(&path(i)).unwrap();
            file.read_to_string(&mut text).unwrap();
            assert!(text.is_empty() || text == format!("{i}"));
        }
        assert!(open() <= MOST);
        // It is closed by now, and another one is in its place.
        std::fs::rename(path(5), path(1)).unwrap();
        assert_eq!(handles[1].get(&path(1)).unwrap_err().kind(), io::ErrorKind::InvalidData);
    }
}

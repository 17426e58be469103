//! The one temporary file of an ingest that does not fit its memory budget.
//!
//! Read and written by position, not mapped: mapped pages would count as the process's memory, which is what the
//! budget is there to limit.

use super::IngestError;
use crate::store::spill_path;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Tells the files of a process apart: a scan that is read may wait in one while a layer is built anew through another.
static NEXT: AtomicU64 = AtomicU64::new(0);

/// A file beside the store, removed when this is dropped.
#[derive(Debug)]
pub(super) struct Spill {
    file: File,
    path: PathBuf,
    end: AtomicU64,
}

impl Spill {
    /// Creates `STORE.spill-PID-N`.
    pub fn create(store: &Path) -> Result<Self, IngestError> {
        let path = spill_path(store, &format!("{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed)));
        let file = File::options()
            .read(true)
            .write(true)
            .create(true)
            .truncate(true)
            .open(&path)
            .map_err(|source| IngestError::Spill { path: path.clone(), action: "creating", source })?;
        Ok(Self { file, path, end: AtomicU64::new(0) })
    }

    /// Appends `bytes` and returns where they are.
    pub fn append(&self, bytes: &[u8]) -> Result<u64, IngestError> {
        let offset = self.end.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        self.file.write_all_at(bytes, offset).map_err(|source| IngestError::Spill {
            path: self.path.clone(),
            action: "writing",
            source,
        })?;
        Ok(offset)
    }

    /// Fills `bytes` from `offset`.
    pub fn read(&self, bytes: &mut [u8], offset: u64) -> Result<(), IngestError> {
        self.file.read_exact_at(bytes, offset).map_err(|source| IngestError::Spill {
            path: self.path.clone(),
            action: "reading",
            source,
        })
    }

    /// Bytes written.
    pub fn bytes(&self) -> u64 {
        self.end.load(Ordering::Relaxed)
    }
}

impl Drop for Spill {
    fn drop(&mut self) {
        // Nothing can be done about a failure here; the next writer removes what is left.
        let _ = std::fs::remove_file(&self.path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Replacing a scan in little memory read the rows of the new scan from a file that building the rest anew had
    // emptied and filled again.
    #[test]
    fn two_of_a_store_do_not_touch_each_other() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("a.esker");
        let (a, b) = (Spill::create(&store).unwrap(), Spill::create(&store).unwrap());
        let at = [a.append(b"north").unwrap(), b.append(b"south").unwrap()];
        let mut read = [0; 5];
        a.read(&mut read, at[0]).unwrap();
        assert_eq!(&read, b"north");
        drop(b);
        a.read(&mut read, at[0]).unwrap();
        assert_eq!(&read, b"north");
        drop(a);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}

//! The one temporary file of an ingest that does not fit its memory budget.
//!
//! Read and written by position, not mapped: mapped pages would count as the process's memory, which is what the
//! budget is there to limit.

use super::IngestError;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// A file beside the store, removed when this is dropped.
#[derive(Debug)]
pub(super) struct Spill {
    file: File,
    path: PathBuf,
    end: AtomicU64,
}

impl Spill {
    /// Creates `STORE.spill-PID`.
    pub fn create(store: &Path) -> Result<Self, IngestError> {
        let mut name = store.as_os_str().to_owned();
        name.push(format!(".spill-{}", std::process::id()));
        let path = PathBuf::from(name);
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

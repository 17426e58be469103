//! The one temporary file of an ingest that does not fit its memory budget.
//!
//! Read and written by position, not mapped: mapped pages would count as the process's memory, which is what the
//! budget is there to limit.

use super::IngestError;
use crate::store::Temporary;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Tells the files of a process apart: a scan that is read may wait in one while a layer is built anew through another.
static NEXT: AtomicU64 = AtomicU64::new(0);

/// A file beside the store, removed when this is dropped.
#[derive(Debug)]
pub(super) struct Spill {
    file: File,
    path: PathBuf,
    end: AtomicU64,
    /// What was given back.
    free: Mutex<Vec<Extent>>,
}

/// A piece of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Extent {
    pub offset: u64,
    pub bytes: usize,
}

/// Where bytes wait: in memory, or in the file, in one piece or in several.
#[derive(Debug)]
pub(super) enum Place {
    Memory(Vec<u8>),
    Spilled(Extent),
    Scattered(Vec<Extent>),
}

impl Place {
    /// Puts `bytes` where the file has room again, if there is one and it has; else they stay in memory.
    pub fn again(bytes: &[u8], spill: Option<&Spill>) -> Result<Self, IngestError> {
        let spilled = spill.map(|spill| spill.write_again(bytes)).transpose()?.flatten();
        Ok(match spilled {
            Some(extents) => match extents[..] {
                [only] => Self::Spilled(only),
                _ => Self::Scattered(extents),
            },
            None => Self::Memory(bytes.to_vec()),
        })
    }

    /// Appends the bytes to `to` if they are in the file.
    pub fn read_spilled(&self, spill: Option<&Spill>, to: &mut Vec<u8>) -> Result<(), IngestError> {
        match (self.extents(), spill) {
            ([], _) => Ok(()),
            (extents, Some(spill)) => spill.read(extents, to),
            (_, None) => Err(IngestError::Internal("spilled rows without a temporary file".into())),
        }
    }

    /// The bytes, with `buffer` for those that are in the file, which is free there afterwards.
    pub fn take<'b>(&'b self, spill: Option<&Spill>, buffer: &'b mut Vec<u8>) -> Result<&'b [u8], IngestError> {
        if let Self::Memory(bytes) = self {
            return Ok(bytes);
        }
        buffer.clear();
        self.read_spilled(spill, buffer)?;
        self.give_back(spill);
        Ok(buffer)
    }

    /// Says that what is there is no longer needed: nobody may read it any more.
    pub fn give_back(&self, spill: Option<&Spill>) {
        if let Some(spill) = spill {
            spill.give_back(self.extents().iter().copied());
        }
    }

    fn extents(&self) -> &[Extent] {
        match self {
            Self::Memory(_) => &[],
            Self::Spilled(extent) => std::slice::from_ref(extent),
            Self::Scattered(extents) => extents,
        }
    }
}

impl Spill {
    /// Creates `STORE.spill-PID-N`.
    pub fn create(store: &Path) -> Result<Self, IngestError> {
        let path = Temporary::Spill.path(store, NEXT.fetch_add(1, Ordering::Relaxed));
        // The writer, who holds the lock, has removed those that a process of the same number had left.
        let file = File::options()
            .read(true)
            .write(true)
            .create_new(true)
            .open(&path)
            .map_err(|source| IngestError::Spill { path: path.clone(), action: "creating", source })?;
        Ok(Self { file, path, end: AtomicU64::new(0), free: Mutex::default() })
    }

    /// Appends `bytes` and returns where they are.
    pub fn append(&self, bytes: &[u8]) -> Result<Extent, IngestError> {
        let offset = self.end.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        self.write(bytes, offset)?;
        Ok(Extent { offset, bytes: bytes.len() })
    }

    fn write(&self, bytes: &[u8], offset: u64) -> Result<(), IngestError> {
        self.file.write_all_at(bytes, offset).map_err(|source| IngestError::Spill {
            path: self.path.clone(),
            action: "writing",
            source,
        })
    }

    fn give_back(&self, extents: impl IntoIterator<Item = Extent>) {
        self.free().extend(extents);
    }

    /// Writes `bytes` to where others were given back; not at all if that has no room for them, since the file takes no more
    /// than was said before.
    fn write_again(&self, bytes: &[u8]) -> Result<Option<Vec<Extent>>, IngestError> {
        let mut taken = Vec::new();
        {
            let mut free = self.free();
            let mut missing = bytes.len();
            while missing > 0 {
                let Some(extent) = free.pop() else { break };
                let used = Extent { bytes: extent.bytes.min(missing), ..extent };
                if used.bytes < extent.bytes {
                    free.push(Extent { offset: extent.offset + used.bytes as u64, bytes: extent.bytes - used.bytes });
                }
                missing -= used.bytes;
                taken.push(used);
            }
            if missing > 0 {
                free.append(&mut taken);
                return Ok(None);
            }
        }
        let mut rest = bytes;
        for extent in &taken {
            let (now, later) = rest.split_at(extent.bytes);
            self.write(now, extent.offset)?;
            rest = later;
        }
        Ok(Some(taken))
    }

    /// Appends what is in `extents`, one after the other, to `to`.
    pub fn read(&self, extents: &[Extent], to: &mut Vec<u8>) -> Result<(), IngestError> {
        for &Extent { offset, bytes } in extents {
            let start = to.len();
            to.resize(start + bytes, 0);
            self.file.read_exact_at(&mut to[start..], offset).map_err(|source| IngestError::Spill {
                path: self.path.clone(),
                action: "reading",
                source,
            })?;
        }
        Ok(())
    }

    fn free(&self) -> MutexGuard<'_, Vec<Extent>> {
        // Whole after every statement.
        self.free.lock().unwrap_or_else(PoisonError::into_inner)
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
        let read = || {
            let mut read = Vec::new();
            a.read(&at[..1], &mut read).unwrap();
            read
        };
        assert_eq!(read(), b"north");
        drop(b);
        assert_eq!(read(), b"north");
        drop(a);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn what_was_given_back_is_written_again_and_the_file_does_not_grow() {
        let folder = tempfile::tempdir().unwrap();
        let spill = Spill::create(&folder.path().join("a.esker")).unwrap();
        let at: Vec<_> = (0..10_u8).map(|i| spill.append(&[i; 7]).unwrap()).collect();
        assert_eq!(spill.write_again(&[9; 1]).unwrap(), None, "nothing was given back");
        spill.give_back([at[2], at[5], at[6]]);
        assert_eq!(spill.write_again(&[9; 22]).unwrap(), None, "21 bytes were given back");
        let wanted: [Vec<u8>; 3] = [(100..110).collect(), Vec::new(), (120..131).collect()];
        let places = wanted.each_ref().map(|bytes| spill.write_again(bytes).unwrap().unwrap());
        assert_eq!(spill.write_again(&[9; 1]).unwrap(), None, "all is taken again");
        let read = |extents: &[Extent]| {
            let mut read = vec![1, 2];
            spill.read(extents, &mut read).unwrap();
            read.split_off(2)
        };
        for (extents, bytes) in places.iter().zip(&wanted) {
            assert_eq!(read(extents), bytes[..]);
        }
        // The others are as they were.
        for i in [0, 1, 3, 4, 7, 8, 9] {
            assert_eq!(read(&at[i..=i]), [i as u8; 7]);
        }
        assert_eq!(spill.bytes(), 70);
    }
}

//! The store itself: made, opened, looked at.

use super::cache::CacheFigures;
use super::connection;
use super::error::{RowError, StoreError};
use super::files::{beside, check_folder, followed, is_named_as_beside, journal, wal};
use super::interrupt::unless;
use super::lock::WriterLock;
use super::log::LogMark;
use super::model::{ScanId, Site};
use super::place::{Limits, Place, lock};
use super::rows::{SiteRow, load_generation, put_site};
use super::snapshot::{Inner, Snapshot};
use super::writer::Writer;
use crate::lattice::Lattice;
use crate::points::Crs;
use rusqlite::Connection;
use std::fs::OpenOptions;
use std::path::Path;
use std::sync::{Arc, Mutex, Weak};

/// What is fixed when a store is made.
#[derive(Clone, Debug, PartialEq)]
pub struct SiteOptions {
    /// Quantum and phase.
    pub lattice: Lattice,
    /// The sampling grid has `2^g` cells a side: [`super::model::FORMAT_G`] but for tests.
    pub(crate) g: u8,
    /// The leaf rule: [`super::model::FORMAT_LEAF_CAPACITY`] but for tests.
    pub(crate) leaf_capacity: u32,
    /// The CRS, if it is known already.
    pub crs: Option<Crs>,
}

impl SiteOptions {
    /// As format version 1 fixes it, on this lattice.
    pub fn new(lattice: Lattice) -> Self {
        let (g, leaf_capacity) = (super::model::FORMAT_G, super::model::FORMAT_LEAF_CAPACITY);
        Self { lattice, g, leaf_capacity, crs: None }
    }

    /// With a CRS that is known already.
    #[must_use]
    pub fn crs(self, crs: Option<Crs>) -> Self {
        Self { crs, ..self }
    }

    /// The site before the first commit.
    pub(super) fn into_site(self) -> Site {
        let Self { lattice, g, leaf_capacity, crs } = self;
        Site { lattice, g, leaf_capacity, roots: vec![None], crs, generation: 0 }
    }
}

/// A store: one file, or memory. Cheap to clone; clones are the same store.
#[derive(Clone, Debug)]
pub struct Store {
    place: Arc<Place>,
    /// The newest snapshot, as long as somebody holds it: shared by those who ask for the same generation.
    newest: Arc<Mutex<Weak<Inner>>>,
}

/// Whoever holds a store open: handles, snapshots, threads that had begun to decode when an answer was given up.
#[cfg(feature = "cli")]
pub(crate) struct Holders(Weak<Place>);

#[cfg(feature = "cli")]
impl Holders {
    /// Waits until there is nobody, or so long.
    pub fn wait(self, longest: std::time::Duration) {
        let begun = std::time::Instant::now();
        while self.0.strong_count() > 0 && begun.elapsed() < longest {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
    }
}

impl Store {
    /// Whoever holds this store open.
    #[cfg(feature = "cli")]
    pub(crate) fn holders(&self) -> Holders {
        Holders(Arc::downgrade(&self.place))
    }

    /// Is this file what remains of a store whose making was cut off? It holds nothing, and [`Store::create`] takes it
    /// over.
    pub fn is_unfinished(path: impl AsRef<Path>) -> bool {
        connection::is_unfinished(&followed(path.as_ref()))
    }

    /// Makes an empty store in a file that is not there yet, or holds nothing ([`Store::is_unfinished`]).
    ///
    /// # Errors
    ///
    /// [`StoreError::AlreadyThere`], [`StoreError::InUse`], [`StoreError::ReadOnly`], [`StoreError::Full`],
    /// [`StoreError::Io`].
    pub fn create(path: impl AsRef<Path>, options: SiteOptions) -> Result<Self, StoreError> {
        Self::create_locked(path.as_ref(), options, FIRST_SCAN).map(|(store, _)| store)
    }

    /// As [`Store::create`], with the one writer: nobody else can come first. Until the first commit the store is provisional:
    /// if that is never made, whoever comes next may give it another site.
    ///
    /// # Errors
    ///
    /// As [`Store::create`].
    pub fn create_with_writer(path: impl AsRef<Path>, options: SiteOptions) -> Result<(Self, Writer), StoreError> {
        let (store, lock) = Self::create_locked(path.as_ref(), options, PROVISIONAL)?;
        let writer = Writer::open_locked(&store.place, Some(lock))?;
        Ok((store, writer))
    }

    fn create_locked(path: &Path, options: SiteOptions, next_scan: ScanId) -> Result<(Self, WriterLock), StoreError> {
        let path = &*followed(path);
        let io = |source| not_made(path, source);
        if path.is_dir() {
            return Err(StoreError::Directory { path: path.into() });
        }
        if path.exists() && !Self::is_unfinished(path) {
            return Err(StoreError::AlreadyThere { path: path.into() });
        }
        let lock = WriterLock::take(path)?;
        // Again, now that nobody else can be making one: nothing but an empty file is taken over.
        if Self::is_unfinished(path) {
            std::fs::remove_file(path).map_err(io)?;
        }
        match OpenOptions::new().write(true).create_new(true).open(path) {
            Ok(_) => {}
            Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {
                return Err(StoreError::AlreadyThere { path: path.into() });
            }
            Err(e) => return Err(io(e)),
        }
        // What lies beside an empty file belongs to a store that was deleted; SQLite would take it for the new one's.
        for stale in [wal(path), beside(path, "-shm"), journal(path)] {
            match std::fs::remove_file(&stale) {
                Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(io(e)),
                _ => {}
            }
        }
        let made = connection::create(Some(path), |c| put_site(c, &first_row(options, next_scan)));
        match made {
            Ok(_) => Ok((Self::open(path)?, lock)),
            Err(e) => {
                let _ = std::fs::remove_file(path);
                Err(e.at(path))
            }
        }
    }

    /// Opens a store for reading; [`Store::writer`] is what writes.
    ///
    /// # Errors
    ///
    /// [`StoreError::NotThere`], [`StoreError::Directory`], [`StoreError::NotAStore`], [`StoreError::Newer`],
    /// [`StoreError::ForeignWal`], [`StoreError::ForeignJournal`], [`StoreError::NeedsRecovery`], [`StoreError::Damaged`].
    pub fn open(path: impl AsRef<Path>) -> Result<Self, StoreError> {
        Self::open_with(path, Limits::default())
    }

    /// As [`Store::open`], with other limits of what is kept in memory.
    ///
    /// # Errors
    ///
    /// As [`Store::open`].
    pub fn open_with(path: impl AsRef<Path>, limits: Limits) -> Result<Self, StoreError> {
        let path = &*followed(path.as_ref());
        let (connection, untouched) = connection::open_for_reading(path)?;
        Ok(Self::at(Place::file(path, limits, connection, untouched)))
    }

    /// Makes an empty store in memory: gone with its last handle.
    ///
    /// # Errors
    ///
    /// [`StoreError::Sqlite`] if there is no memory.
    pub fn in_memory(options: SiteOptions) -> Result<Self, StoreError> {
        let made = connection::create(None, |c| put_site(c, &first_row(options, FIRST_SCAN)));
        made.map(|c| Self::at(Place::memory(c))).map_err(|e| e.at(Path::new("(store in memory)")))
    }

    fn at(place: Place) -> Self {
        Self { place: Arc::new(place), newest: Arc::default() }
    }

    /// The file; `None` for a store in memory.
    pub fn path(&self) -> Option<&Path> {
        match &*self.place {
            Place::File(file) => Some(&file.path),
            Place::Memory(_) => None,
        }
    }

    /// The newest generation, held until the snapshot is dropped.
    ///
    /// # Errors
    ///
    /// [`StoreError::Damaged`] if the site, a scan or an attribute is missing or wrong.
    pub fn snapshot(&self) -> Result<Snapshot, StoreError> {
        let mut newest = lock(&self.newest);
        let inner = match &*self.place {
            Place::Memory(_) => Inner::of_memory(&self.place).map_err(|e| self.place.error(e))?,
            Place::File(file) => {
                let connection = file.connect()?;
                let seen = connection.execute_batch("BEGIN").map_err(RowError::from);
                let seen = seen.and_then(|()| load_generation(&connection)).map_err(|e| self.place.error(e));
                file.check_untouched()?;
                let seen = seen?;
                if let Some(held) = newest.upgrade().filter(|held| held.generation() == seen) {
                    file.give_back(connection);
                    return Ok(Snapshot::of(held));
                }
                let inner = Inner::of_file(&self.place, connection, file.can_change()).map_err(|e| self.place.error(e));
                file.check_untouched()?;
                inner?
            }
        };
        let inner = Arc::new(inner);
        *newest = Arc::downgrade(&inner);
        Ok(Snapshot::of(inner))
    }

    /// What its caches hold, and how often they had what was asked for.
    pub fn cache_figures(&self) -> CacheFigures {
        self.place.caches().figures()
    }

    /// Has anything been committed since `snapshot`? One of another store differs, too.
    ///
    /// # Errors
    ///
    /// [`StoreError::Damaged`] if the site's row can't be read.
    pub fn changed(&self, snapshot: &Snapshot) -> Result<bool, StoreError> {
        let generation = match &*self.place {
            Place::Memory(memory) => load_generation(&lock(&memory.connection)),
            Place::File(file) => {
                let connection = file.connect()?;
                let generation = load_generation(&connection);
                file.check_untouched()?;
                file.give_back(connection);
                generation
            }
        };
        let is_other = !Arc::ptr_eq(&self.place, snapshot.place()) && self.place.path() != snapshot.place().path();
        Ok(is_other || generation.map_err(|e| self.place.error(e))? != snapshot.generation())
    }

    /// Writes a copy without free space to `path`, where nothing may be yet, also of a store that can't be written.
    ///
    /// # Errors
    ///
    /// [`StoreError::AlreadyThere`], [`StoreError::NameOfAnother`], [`StoreError::NoFolder`], [`StoreError::Full`] and
    /// [`StoreError::ReadOnly`] of the copy; [`StoreError::Sqlite`], also if `stop`, which is asked now and then, says so. No
    /// copy is left then.
    pub fn copy_to(&self, path: &Path, stop: impl Fn() -> bool + Send) -> Result<(), StoreError> {
        let Some(text) = path.to_str() else {
            let what = "the copy's path is no UTF-8".into();
            return Err(StoreError::Inconsistent { path: path.into(), what });
        };
        if is_named_as_beside(path) {
            return Err(StoreError::NameOfAnother { path: path.into() });
        }
        check_folder(path)?;
        // An empty file may be copied into, and is nobody else's: what is removed after an error is this one.
        match OpenOptions::new().write(true).create_new(true).open(path) {
            Ok(_) => {}
            Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {
                return Err(StoreError::AlreadyThere { path: path.into() });
            }
            Err(e) => return Err(not_made(path, e)),
        }
        let copy = |c: &Connection| unless(c, stop, |c| Ok(c.execute("VACUUM INTO ?", [text]).map(drop)?));
        let copied = match &*self.place {
            Place::Memory(memory) => copy(&lock(&memory.connection)).map_err(|e| self.place.error(e)),
            Place::File(file) => {
                let connection = file.connect()?;
                // The copy would be a change, too. The connection is not given back.
                let copied = connection.pragma_update(None, "query_only", false).map_err(RowError::from);
                let copied = copied.and_then(|()| copy(&connection)).map_err(|e| self.place.error(e));
                copied.and_then(|()| file.check_untouched())
            }
        };
        if copied.is_err() {
            let _ = std::fs::remove_file(path);
        }
        copied.map_err(|e| match e {
            // Only the copy is written.
            StoreError::Full { .. } => StoreError::Full { path: path.into() },
            StoreError::ReadOnly { .. } => StoreError::ReadOnlyFolder { path: path.into() },
            e => e,
        })
    }

    /// The one writer.
    ///
    /// # Errors
    ///
    /// [`StoreError::InUse`] if there is another, [`StoreError::ReadOnly`], [`StoreError::Full`],
    /// [`StoreError::Damaged`].
    pub fn writer(&self) -> Result<Writer, StoreError> {
        Writer::open(&self.place)
    }
}

/// The number of a store's first scan.
const FIRST_SCAN: ScanId = 1;

/// What stands for it in a store that nothing counts of before its first commit.
const PROVISIONAL: ScanId = 0;

fn first_row(options: SiteOptions, next_scan: ScanId) -> SiteRow {
    SiteRow {
        site: options.into_site(),
        store_id: rand::random(),
        next_chunk: 0,
        next_scan,
        nodes: 0,
        scans: 0,
        attributes: 0,
        log: LogMark::random(),
    }
}

/// Why the file of a store could not be made.
fn not_made(path: &Path, source: std::io::Error) -> StoreError {
    match source.kind() {
        std::io::ErrorKind::ReadOnlyFilesystem | std::io::ErrorKind::PermissionDenied => {
            StoreError::ReadOnlyFolder { path: path.into() }
        }
        std::io::ErrorKind::StorageFull => StoreError::Full { path: path.into() },
        _ => StoreError::Io { path: path.into(), action: "making the store", source },
    }
}

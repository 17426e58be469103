//! Why an ingest stopped. The store stays at its last commit in every case.

use crate::formats::FormatError;
use crate::lattice::LatticeError;
use crate::store::StoreError;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why an ingest stopped.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum IngestError {
    /// A source could not be read.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// The store refused.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Quantum or phase is not usable.
    #[error(transparent)]
    Lattice(#[from] LatticeError),
    /// Nothing to do.
    #[error("no point file among the inputs{0}")]
    NoInput(String),
    /// Nothing to join.
    #[error("no stores to join; give one at least")]
    NoStores,
    /// One name for several scans.
    #[error("--name names one scan; give one input of one scan with it")]
    NameOfMany,
    /// A name without a character.
    #[error("a name can't be empty")]
    NoName,
    /// A scan of this name is there.
    #[error("the store has another scan named '{0}'; give another name")]
    NameTaken(String),
    /// Not one pose per file.
    #[error("{poses} poses are given for {files} files; give one for each file, in their order")]
    Poses {
        /// How many were given.
        poses: usize,
        /// How many there are to place.
        files: usize,
    },
    /// A source that is to be read again is another file now.
    #[error("{path}: it has changed, and which of its scans is '{name}' can't be told; name the new file")]
    Changed {
        /// The source.
        path: PathBuf,
        /// The scan.
        name: String,
    },
    /// A scan that is to be read again was no file.
    #[error("'{0}' was made of a program's points, which can't be read again; name a file")]
    NoFile(String),
    /// A source that is to be read again is known by a path from a folder that nobody knows.
    #[error("'{name}' came from {path}, and the store does not say in which folder that is; name the file")]
    Relative {
        /// The source.
        path: PathBuf,
        /// The scan.
        name: String,
    },
    /// The source is there, elsewhere.
    #[error(
        "{scan}: the store has it as '{name}' with another pose or other options; `esker replace` puts it in its place"
    )]
    OtherPose {
        /// The file, and which of its scans.
        scan: String,
        /// The stored scan.
        name: String,
    },
    /// Nothing was ever stored.
    #[error("{0}: an ingest was cut off before anything was stored; give that again first")]
    Unfinished(PathBuf),
    /// A file is cut before its first whole record.
    #[error(
        "{path}: ends before the first of the records that its header announces ({missing}); copy it again from where it is whole"
    )]
    Nothing {
        /// The file.
        path: PathBuf,
        /// How many are missing.
        missing: u64,
    },
    /// A camera of this name is kept already.
    #[error("the store has a bookmark '{0}'; give another name; --force puts it in its place")]
    BookmarkTaken(String),
    /// There is no such camera.
    #[error("the store has no bookmark '{name}'; there are: {there}")]
    NoBookmark {
        /// What was asked for.
        name: String,
        /// Those that there are, in words.
        there: String,
    },
    /// What is kept under this name is no view.
    #[error("bookmark '{0}' is no view")]
    BookmarkUnread(String, #[source] serde_json::Error),
    /// The site is in another CRS.
    #[error("the site's CRS is {has}, not {asked}; --force puts it in its place, and no coordinate changes")]
    HasCrs {
        /// What it has.
        has: String,
        /// What was to be set.
        asked: String,
    },
    /// There is no such scan.
    #[error("the store has no scan '{wanted}'{nearest}; `esker scans` lists them")]
    NoScan {
        /// What was asked for.
        wanted: String,
        /// A name that is nearly it, in words.
        nearest: String,
    },
    /// What is to take a scan's place is in the store as another scan.
    #[error("'{scan}' was not replaced: {input}: {reason}")]
    NotReplaced {
        /// The scan that was to go.
        scan: String,
        /// What was to come.
        input: String,
        /// Why it does not come, in words.
        reason: String,
    },
    /// A store to be made is there already.
    #[error("{0} is there already; give the name of a new store")]
    OutputThere(PathBuf),
    /// A compact copy could not be given its name, or is not all in its file.
    #[error("{path}: naming the copy: {source}")]
    Copy {
        /// The name.
        path: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// Stores that can't be joined.
    #[error("{path} can't be joined with {first}: {why}")]
    NotAlike {
        /// The first store.
        first: PathBuf,
        /// Another.
        path: PathBuf,
        /// What is different, and what to do.
        why: String,
    },
    /// Two coordinate reference systems.
    #[error(
        "{path}: its CRS is {found}, the site's is {expected}; reproject it first, or --ignore-crs to take its numbers as they are"
    )]
    OtherCrs {
        /// The source.
        path: PathBuf,
        /// The site's CRS.
        expected: String,
        /// The source's.
        found: String,
    },
    /// The store's lattice is fixed and the user asked for another.
    #[error(
        "the store's quantum is {stored} and its phase {phase}, not what is asked for: --quantum, --phase and --lattice apply when a store is created"
    )]
    LatticeFixed {
        /// Its quantum per axis.
        stored: String,
        /// Its phase per axis.
        phase: String,
    },
    /// Scale or offset of a source don't fit exact arithmetic.
    #[error(
        "{0}: its scale has too many digits for exact arithmetic beside the quantum, or its offset is far off all \
         coordinates; rewrite it with a scale such as 0.001 and an offset near its points"
    )]
    Grid(PathBuf),
    /// Every point of a source is out of the lattice's range.
    #[error(
        "{path}: all of its points ({points}) are outside the lattice ({range}); create the store with a coarser --quantum"
    )]
    OutOfRange {
        /// The source.
        path: PathBuf,
        /// How many.
        points: u64,
        /// The lattice's range.
        range: String,
    },
    /// A truncated file under `--strict`.
    #[error("{path}: {missing} of the records that its header announces are missing (--strict)")]
    Truncated {
        /// The source.
        path: PathBuf,
        /// How many.
        missing: u64,
    },
    /// Not enough room.
    #[error("{folder}: needs at least some {needed} for the store and {temp} for temporary data, has {free} free")]
    DiskFull {
        /// Where.
        folder: PathBuf,
        /// For the store.
        needed: String,
        /// For the spill.
        temp: String,
        /// What is there.
        free: String,
    },
    /// The temporary file failed.
    #[error("{path}: {action} the temporary file failed")]
    Spill {
        /// The file.
        path: PathBuf,
        /// `creating`, `writing`, `reading`.
        action: &'static str,
        /// The system's word.
        source: std::io::Error,
    },
    /// More than any machine has use for; starting them would take for ever.
    #[error("{asked} threads are too many; {most} are the most")]
    TooManyThreads {
        /// So many were asked for.
        asked: usize,
        /// So many there may be.
        most: usize,
    },
    /// Threads could not be started.
    #[error("starting the worker threads failed: {0}")]
    Threads(String),
    /// A rule that the code relies on does not hold: a bug.
    #[error("internal error: {0}; please report it")]
    Internal(String),
    /// Ctrl-C.
    #[error("interrupted; what was committed counts, and the same command goes on from there")]
    Interrupted,
}

/// Why a batch was not added.
pub(super) enum Stopped {
    /// Some of its sources can't be read or do not fit: their places in the batch, ascending.
    Unreadable(Vec<(usize, IngestError)>),
    /// Anything else.
    Failed(IngestError),
}

impl From<Stopped> for IngestError {
    fn from(stopped: Stopped) -> Self {
        match stopped {
            Stopped::Failed(error) => error,
            Stopped::Unreadable(errors) => {
                let nobody = || Self::Internal("sources that can't be read, and none of them".into());
                errors.into_iter().next().map_or_else(nobody, |first| first.1)
            }
        }
    }
}

impl From<FormatError> for Stopped {
    fn from(error: FormatError) -> Self {
        Self::Failed(error.into())
    }
}

impl From<IngestError> for Stopped {
    fn from(error: IngestError) -> Self {
        Self::Failed(error)
    }
}

impl From<StoreError> for Stopped {
    fn from(error: StoreError) -> Self {
        Self::Failed(error.into())
    }
}

impl IngestError {
    /// The source that is at fault, where it is one.
    pub(super) fn source_path(&self) -> Option<&Path> {
        match self {
            Self::Format(error) => Some(error.path()),
            Self::Grid(path)
            | Self::OutOfRange { path, .. }
            | Self::Truncated { path, .. }
            | Self::Nothing { path, .. } => Some(path),
            _ => None,
        }
    }
}

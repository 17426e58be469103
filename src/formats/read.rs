//! What every reader of point files gives: facts first, then pieces that decode independently.

use super::FormatError;
use crate::geometry::Pose;
use crate::lattice::{Decimal, SourceGrid};
use crate::points::{Crs, LasFacts, RecordLayout};
use std::path::{Path, PathBuf};

/// What is known of a source before its points are read.
#[derive(Clone, Debug)]
pub struct SourceInfo {
    /// The file.
    pub path: PathBuf,
    /// Which cloud of the file, 0 for formats with one.
    pub index: u32,
    /// What the file calls this cloud, if it has several or names the one.
    pub scan_name: Option<String>,
    /// From the scan's own frame to where the records have their positions: the file's own pose, then the one given.
    pub pose: Pose,
    /// How the file was read, where that was asked for: part of the scan's identity.
    pub options: String,
    /// `las`, `laz`, `copc`, `ply`, `e57`, `ptx`, `pts`, `text`, `pcd`.
    pub format: &'static str,
    /// Records that can be read: from the file's size where the header announces more.
    pub records: u64,
    /// Records that the header announces beyond those.
    pub missing: u64,
    /// The source's integer grid; `None` for floating-point sources.
    pub grid: Option<SourceGrid>,
    /// Are x and y degrees, as names of columns say?
    pub degrees: bool,
    /// Without a grid: the step that a store should have for these coordinates, if the source can tell.
    pub step: Option<Decimal>,
    /// Are coordinates floats of 32 bits? At 5,000,000 these are half a metre apart.
    pub is_single: bool,
    /// Bounds as the header gives them: a hint that may lie; `None` where there is none or it is not finite.
    pub bounds_hint: Option<([f64; 3], [f64; 3])>,
    /// How records are laid out.
    pub layout: RecordLayout,
    /// The CRS, if the file has one.
    pub crs: Option<Crs>,
    /// For LAS and LAZ.
    pub las: Option<LasFacts>,
    /// What a user should know: truncation, waveform packets or faces not kept, header fields that lie.
    pub warnings: Vec<String>,
}

impl SourceInfo {
    /// The only cloud of a file, in the world's frame, without a grid, bounds, a CRS or warnings.
    pub(super) fn new(path: &Path, format: &'static str, records: u64, missing: u64, layout: RecordLayout) -> Self {
        Self {
            path: path.to_owned(),
            index: 0,
            scan_name: None,
            pose: Pose::IDENTITY,
            options: String::new(),
            format,
            records,
            missing,
            grid: None,
            degrees: false,
            step: None,
            is_single: false,
            bounds_hint: None,
            layout,
            crs: None,
            las: None,
            warnings: Vec::new(),
        }
    }
}

/// A run of records that decodes without any other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Piece {
    /// The first record.
    pub first: u64,
    /// How many.
    pub records: u64,
}

/// What reading a piece came to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Records given to the sink.
    pub read: u64,
    /// Records of the piece that the file turned out not to hold.
    pub truncated: u64,
}

/// A point file that has been opened and understood, or one cloud of it.
///
/// A record of floating-point positions whose coordinates are no measurement (a pulse that did not come back, a point
/// that the scanner marked as invalid) has NaN for them.
pub trait PointSource: Send + Sync {
    /// What is known without reading points.
    fn info(&self) -> &SourceInfo;

    /// Adds to what a user should know.
    fn warn(&mut self, warning: String);

    /// What a user should know and is not known before all is read.
    fn found_while_reading(&self) -> Option<String> {
        None
    }

    /// Pieces of about `target_records` each, in order, that together are all records. One piece if the format allows
    /// no more.
    fn pieces(&self, target_records: u64) -> Vec<Piece>;

    /// Where the first record begins, if what [`PointSource::read`] gives are the file's own bytes, record after record.
    fn verbatim_from(&self) -> Option<u64> {
        None
    }

    /// Reads the records of a piece in order, giving them to `sink` in runs of whole records of
    /// `info().layout.stride()` bytes each, at most about 1 MiB at a time. `sink` returns false to stop early.
    ///
    /// # Errors
    ///
    /// [`FormatError`] if the piece can't be read; runs given before stay valid.
    fn read(&self, piece: Piece, sink: &mut dyn FnMut(&[u8]) -> bool) -> Result<Tally, FormatError>;
}

//! What every writer of point files takes: a plan that is fixed before the first point, then batches.

use super::FormatError;
use crate::lattice::Lattice;
use crate::points::{Attribute, Batch, Crs, LasFacts};
use std::sync::Arc;

/// The form of an output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum OutputFormat {
    Las,
    Laz,
    Ply,
    Csv,
}

impl OutputFormat {
    /// By the ending of a file name, case-insensitively.
    pub fn of_extension(extension: &str) -> Option<Self> {
        match extension.to_ascii_lowercase().as_str() {
            "las" => Some(Self::Las),
            "laz" => Some(Self::Laz),
            "ply" => Some(Self::Ply),
            "csv" => Some(Self::Csv),
            _ => None,
        }
    }
}

/// What a LAS or LAZ file will look like, decided from the contributing scans.
#[derive(Clone, Debug, PartialEq)]
pub enum LasTarget {
    /// All contributing scans agree on version, point format, scale, offset and extra bytes: theirs.
    AsSource(LasFacts),
    /// They disagree or are no LAS files: the smallest point format of LAS 1.4 that holds the attributes, at this scale
    /// and offset, other attributes as extra bytes.
    Merged {
        /// Scale per axis.
        scale: [f64; 3],
        /// Offset per axis.
        offset: [f64; 3],
    },
}

/// Everything that a writer needs to know before the first point.
#[derive(Clone, Debug)]
pub struct OutputPlan {
    /// What the positions mean.
    pub lattice: Lattice,
    /// The columns of every batch that will come, in this order.
    pub attributes: Arc<[Attribute]>,
    /// The CRS to write, if known.
    pub crs: Option<Crs>,
    /// For LAS and LAZ; other formats ignore it.
    pub las: LasTarget,
}

/// A file that is being written: it appears under its name when it is finished, or not at all.
pub trait PointWriter {
    /// Appends the points of a batch.
    ///
    /// # Errors
    ///
    /// [`FormatError::Io`] if the disk refuses, [`FormatError::Unwritable`] if a coordinate does not fit.
    fn write(&mut self, batch: &Batch) -> Result<(), FormatError>;

    /// Completes header and tables, and gives the file its name. Returns what a user should know about the file.
    ///
    /// # Errors
    ///
    /// As [`PointWriter::write`].
    fn finish(self: Box<Self>) -> Result<Vec<String>, FormatError>;
}

//! Why an answer could not be written.

use crate::formats::FormatError;
use crate::geometry::PoseError;
use crate::lattice::LatticeError;
use crate::query::QueryError;
use std::path::PathBuf;
use thiserror::Error;

/// Why an answer could not be written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ExportError {
    /// The query has no answer.
    #[error(transparent)]
    Query(#[from] QueryError),
    /// The file can't be written.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// The name of the file does not say its form.
    #[error(
        "{path}: '{ending}' is no ending that Esker writes; use .las, .laz, .ply, .csv, .xyz, .npy or .npz, or name a format"
    )]
    Ending {
        /// The file.
        path: PathBuf,
        /// What its name ends in.
        ending: String,
    },
    /// LAS has 32 bits for a coordinate.
    #[error(
        "the points are {width} units wide on {}, too wide for 32-bit coordinates in steps of {scale}; give a \
         coarser scale, a smaller region, or split by scan",
        ["x", "y", "z"][*axis]
    )]
    TooWide {
        /// How wide, in CRS units.
        width: f64,
        /// 0 to 2.
        axis: usize,
        /// The step.
        scale: f64,
    },
    /// A scale for a form without a grid.
    #[error("a scale is for LAS and LAZ: in other forms coordinates have no grid of their own")]
    ScaleOfNoGrid,
    /// The scale that was asked for is none.
    #[error("a scale of {scale} is not usable: it must be a positive number")]
    Scale {
        /// The step of an axis.
        scale: f64,
    },
    /// Only one scan has a frame.
    #[error("the frame of a scan is for the points of one scan; name it, or split by scan")]
    FrameOfSeveral,
    /// A scan's pose is none.
    #[error("the pose of scan '{scan}'")]
    Pose {
        /// Its name.
        scan: String,
        /// What is wrong with it.
        source: PoseError,
    },
    /// In a scan's frame a point has no place on the lattice.
    #[error("a point in the scan's frame")]
    Frame(#[from] LatticeError),
    /// The points have no classes.
    #[error("the points have no Classification to split by")]
    NoClass,
    /// One file for each scan or class would be too many.
    #[error("these would be more than {most} files")]
    TooManyFiles {
        /// How many there may be.
        most: usize,
    },
    /// Several files have no place on the standard output.
    #[error("splitting writes several files; give a file name")]
    SplitOfStandardOutput,
    /// The store has a point of a scan that it does not have.
    #[error("there is a point of scan {0}, which is not there; run `esker verify`")]
    NoScan(u32),
}

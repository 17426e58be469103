//! Point files in and out. Knows columns and records, not the store.

mod error;
mod file;
mod guard;
pub mod las;
mod read;
mod write;

pub use error::FormatError;
pub use read::{Piece, PointSource, SourceInfo, Tally};
pub use write::{
    CreateOptions, CreationDate, LasTarget, OutputFormat, OutputPlan, PointWriter, create, create_standard_output,
    remove_unfinished,
};

//! Point files in and out. Knows columns and records, not the store.

#[cfg(test)]
mod damage_tests;
#[cfg(test)]
mod data_tests;
mod detect;
mod error;
mod file;
mod guard;
pub mod las;
mod ply;
mod read;
mod write;

pub use detect::{InputFormat, Inputs, ReadOptions, list_inputs, open};
pub use error::FormatError;
pub use read::{Piece, PointSource, SourceInfo, Tally};
pub use write::{
    CreateOptions, CreationDate, LasTarget, OutputFormat, OutputPlan, PointWriter, create, create_standard_output,
    remove_unfinished,
};

//! Point files in and out. Knows columns and records, not the store.

#[cfg(test)]
mod damage_tests;
#[cfg(test)]
mod data_tests;
mod detect;
mod e57;
mod error;
mod file;
mod guard;
mod handles;
pub mod las;
mod names;
mod pcd;
mod ply;
mod pose_file;
mod posed;
mod read;
mod table;
mod text;
mod write;

pub use detect::{InputFormat, Inputs, ReadOptions, list_inputs, open, open_all, parse_columns};
pub use error::FormatError;
pub use pose_file::read_poses;
pub(crate) use posed::place;
pub use read::{Piece, PointSource, SourceInfo, Tally};
pub(crate) use table::TableSource;
pub use table::{PointTable, TableError};
pub use write::{
    CreateOptions, CreationDate, LasField, LasTarget, LasValues, OutputFile, OutputFormat, OutputPlan, Packed, Packer,
    PointWriter, Raster, RasterFormat, check_output, create, create_standard_output, is_database, las_field,
    remove_unfinished, write_raster,
};

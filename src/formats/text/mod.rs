//! Points as rows of text: PTS, PTX, and XYZ in all its forms (TXT, CSV, ASC).
//!
//! A file is looked through once when it is opened: how many rows, which columns hold what. Then it is read in pieces, on
//! all threads. Rows are what counts, not what a header announces.

mod columns;
mod lines;
mod number;
mod open;
mod sections;
mod shape;
mod source;
mod survey;
mod table;
#[cfg(test)]
mod tests;
mod words;

pub use columns::parse_columns;
pub(super) use number::odd_float;
pub use open::{open_pts, open_ptx, open_rows};
pub use shape::{HEAD_BYTES, Shape, shape};
pub(super) use survey::{Chunk, Place, count_rows, first_row};
pub(super) use table::{Cell, Coordinates, Table};
pub(super) use words::Separator;

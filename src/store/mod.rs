//! The SQLite file: rows, snapshots, the writer, verify.

pub mod model;

//! An out-of-core point store: scans in, one SQLite file as a layered octree, exact regions and levels of detail out.

pub mod lattice;
pub mod points;

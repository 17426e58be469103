//! An out-of-core point store: scans in, one SQLite file as a layered octree, exact regions and levels of detail out.

pub mod codec;
pub mod export;
pub mod formats;
pub mod generate;
pub mod geometry;
pub mod ingest;
pub mod lattice;
pub mod octree;
pub mod points;
pub mod processor;
pub mod query;
#[cfg(feature = "render")]
pub mod render;
pub mod store;
#[cfg(feature = "stream")]
pub mod stream;
#[cfg(feature = "viewer")]
pub mod viewer;

#[cfg(feature = "cli")]
pub mod cli;

/// README.md, whose example is compiled with the doc tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;

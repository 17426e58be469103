//! An out-of-core point store: scans in, one SQLite file as a layered octree, exact regions and levels of detail out.
//!
//! [`ingest::ingest`] puts files of points into a store. A [`Store`](store::Store) gives [`Snapshot`](store::Snapshot)s: states that
//! stay as they are, whatever is committed meanwhile. A [`Query`](query::Query) says which points of a snapshot are wanted, and how
//! fine; it gives them batch by batch, as an iterator, or folded on all threads, with the distance within which every point that
//! matches has a returned one. [`export::export`] writes them to a file.
//!
//! ```
//! use esker::export::{ExportOptions, Target, export};
//! use esker::generate::{GenerateOptions, Kind, generate};
//! use esker::ingest::{IngestOptions, ingest};
//! use esker::query::{Detail, Filter, Query, Region};
//! use esker::store::{Store, WorldBounds, info};
//! # let folder = std::env::temp_dir().join(format!("esker-front-{}", std::process::id()));
//! # std::fs::create_dir_all(&folder)?;
//! # let (scan, path, ground) = (folder.join("scan.laz"), folder.join("site.esker"), folder.join("ground.laz"));
//!
//! // Something to work with: `scan`, `path` and `ground` are the paths of files.
//! generate(Kind::Terrain, 20_000, 1, &scan, &GenerateOptions::default(), &mut |_| true)?;
//! let report = ingest(&path, &[scan], &IngestOptions::default(), &())?;
//! assert_eq!(report.points, 20_000);
//!
//! let snapshot = Store::open(&path)?.snapshot()?;
//! let bounds = info(&snapshot)?.bounds.ok_or("no points")?;
//! let [x, y, _] = WorldBounds::new(&snapshot.site().lattice, &bounds).min;
//! let corner = Region::new_box([x, y, f64::NEG_INFINITY], [x + 50.0, y + 50.0, f64::INFINITY])?;
//! let low = Query::new().region(corner).filter(Filter::parse("Classification = 2")?).attributes(["Intensity"]);
//!
//! // All of them, batch by batch: positions on the lattice, attributes by column.
//! let mut points = 0;
//! for batch in low.batches(&snapshot)? {
//!     points += batch?.len() as u64;
//! }
//! assert_eq!(points, low.count(&snapshot)?.points);
//!
//! // Thinned, each of them within a metre of one that is kept, as a file.
//! let coarse = low.detail(Detail::MaxError(1.0));
//! let done = export(&snapshot, &coarse, Target::File(&ground), &ExportOptions::default(), |_| {})?;
//! assert!(done.answer.points < points && done.answer.error_bound.is_some_and(|bound| bound <= 1.0));
//! # std::fs::remove_dir_all(&folder)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! | to | look at |
//! |---|---|
//! | put points in, from files or memory, take scans out, merge stores | [`ingest`] |
//! | ask for points, count, look for neighbours, make rasters | [`query`] |
//! | write files | [`export`] |
//! | read files of points without a store | [`formats`] |
//! | draw pictures (feature `render`), load for a moving camera (`stream`) | `render`, `stream` |
//! | know what a coordinate is | [`lattice`], [`points`] |
//! | know what a store is made of: generations, scans, node rows, columns | [`store`], [`codec`], [`octree`] |
//!
//! Without the default features there is neither a program nor a window, and nothing needs a graphics library.

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

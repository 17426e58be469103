//! Files to store: parallel, out of core, within a memory budget.
//!
//! Records of all sources are moved to the lattice and sorted into buckets (in memory, or through one temporary file),
//! buckets are built into nodes, nodes are encoded and written, and one small transaction makes them the store's
//! content. Until then the store is what it was.
//!
//! A store that has scans already takes new ones at the cost of what they touch: into the tree that is there, or into a
//! layer of their own (`layers.rs`). The tree is the canonical one whatever the order of scans.

mod agree;
mod batch;
mod bookmarks;
mod budget;
mod build;
mod bulk;
mod change;
mod context;
mod edit;
mod error;
mod gather;
mod identity;
mod labels;
mod lattice_choice;
mod layers;
mod loaded;
mod measure;
mod merge;
mod naming;
mod partition;
mod progress;
mod queue;
mod reading;
mod report;
mod rising;
mod rows;
mod run;
mod sort;
mod sources;
mod spill;
mod split;
mod stored;
mod subtrees;
mod versions;
mod writing;

pub use bookmarks::{bookmark, keep_bookmark, remove_bookmark};
pub use context::Resources;
pub use edit::{Compacted, Removed, compact, digest, remove, replace, set_visible};
pub use error::IngestError;
pub use labels::{rename, set_crs};
pub use lattice_choice::LatticeWish;
pub use merge::{Merged, SkippedScan, merge};
pub use progress::{Progress, Stage};
pub use report::{NamedScan, Report, ScanReport, Skipped, StageReport};
pub use run::{ingest, ingest_table};

use crate::geometry::Pose;
use crate::points::Crs;
use crate::store::model::{FORMAT_G, FORMAT_LEAF_CAPACITY};

/// How to ingest. The default is right for most sites.
#[derive(Clone, Debug, PartialEq)]
pub struct IngestOptions {
    /// Quantum and phase of a new store.
    pub lattice: LatticeWish,
    /// Memory and threads, and whether to wait for another writer.
    pub resources: Resources,
    /// The CRS of all inputs, instead of their own.
    pub crs: Option<Crs>,
    /// Take coordinates as they are though the CRS differ.
    pub ignore_crs: bool,
    /// Name of the scan, for a single input.
    pub name: Option<String>,
    /// Where each input file's scans stand: applied after the file's own pose. As many as there are files, or none.
    pub poses: Vec<Pose>,
    /// What the columns of text files are called, in their order; `None` for their own names or the customary ones.
    pub columns: Option<Vec<String>>,
    /// Look into folders below the given ones.
    pub recursive: bool,
    /// Refuse truncated files.
    pub strict: bool,
    /// Leave out inputs that can't be read, and store the others; the [`Report`] names them.
    pub keep_going: bool,
    /// The sampling grid of a new store, `2^g` cells a side. Format version 1 has 7; others are for tests.
    #[doc(hidden)]
    pub g: u8,
    /// The leaf capacity of a new store. Format version 1 has 32,768; others are for tests.
    #[doc(hidden)]
    pub leaf_capacity: u32,
}

impl Default for IngestOptions {
    fn default() -> Self {
        Self {
            lattice: LatticeWish::default(),
            resources: Resources::default(),
            crs: None,
            ignore_crs: false,
            name: None,
            poses: Vec::new(),
            columns: None,
            recursive: false,
            strict: false,
            keep_going: false,
            g: FORMAT_G,
            leaf_capacity: FORMAT_LEAF_CAPACITY,
        }
    }
}

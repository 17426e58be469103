//! The SQLite file: rows, snapshots, the writer, verify. `docs/format.md` has every byte and every invariant.

mod checksum;
mod connection;
mod error;
mod files;
mod flip;
mod handle;
mod index;
mod lanes;
mod lock;
pub mod model;
mod place;
mod rows;
mod snapshot;
mod writer;

pub use checksum::Checksum;
pub use connection::APPLICATION_ID;
pub use error::StoreError;
pub use files::{SPILL_SUFFIX, spill_path};
pub use flip::{Flip, NodeChange};
pub use handle::{SiteOptions, Store};
pub use index::{NodeIndex, NodeIx};
pub use rows::{ChunkRow, pack};
pub use snapshot::{ChunkBytes, ReadCost, Snapshot};
pub use writer::{ChunkIds, Committed, Leftovers, Writer};

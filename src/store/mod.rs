//! The SQLite file: rows, snapshots, the writer, verify. `docs/format.md` has every byte and every invariant.

#[cfg(test)]
mod bookmark_tests;
mod cache;
mod checksum;
mod connection;
#[cfg(test)]
mod damage_tests;
mod decode;
mod describe;
mod digest;
mod encode;
mod error;
mod files;
#[cfg(test)]
mod first_tests;
mod flip;
mod flip_check;
mod handle;
mod index;
mod info;
mod interrupt;
mod lanes;
mod leaders;
mod lock;
mod log;
#[cfg(test)]
mod log_tests;
pub mod model;
mod nodes;
#[cfg(test)]
mod nodes_tests;
mod own_points;
mod place;
mod rows;
mod shape;
mod snapshot;
mod space;
mod summary;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod tree_check;
mod untouched;
mod verify;
mod writer;
mod zones;

pub use cache::CacheFigures;
pub(crate) use cache::CachedBlock;
pub use connection::APPLICATION_ID;
pub(crate) use decode::{DecodedPart, decode_part, decode_part_keys, follow};
pub(crate) use describe::scaled_ends;
pub use describe::{AttributeCost, CrsDescription, Description, ScanDescription, WorldBounds, describe};
pub use digest::Digest;
pub(crate) use digest::{Digester, digest};
pub(crate) use encode::{
    EncodeScratch, EncodedNode, NodeInput, PartColumns, PointColumns, ScanTable, block_size, encode_node,
};
pub use error::StoreError;
pub(crate) use files::{Temporary, check_folder, followed, has_empty_log};
pub use flip::{Flip, NodeChange};
#[cfg(feature = "cli")]
pub(crate) use handle::Holders;
pub use handle::{SiteOptions, Store};
pub use index::{NodeIndex, NodeIx};
pub use info::{Info, info};
pub(crate) use lock::WriterLock;
pub use nodes::{Children, Node, Nodes};
pub use place::Limits;
#[cfg(test)]
pub(crate) use rows::ChunkRow;
pub use snapshot::Snapshot;
pub(crate) use snapshot::{ChunkBytes, ReadCost, WantedBlocks};
pub use summary::{Summary, merge_subtree};
pub use verify::{Finding, Report, verify};
#[cfg(test)]
pub(crate) use writer::Leftovers;
pub use writer::{ChunkIds, Committed, Writer};

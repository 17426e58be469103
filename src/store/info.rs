//! What there is to say of a store without reading its points.

use super::error::{RowError, StoreError};
use super::files::wal_bytes;
use super::lock::WriterLock;
use super::model::{SLOT_POSITION, SLOT_SCAN, Slot};
use super::place::Place;
use super::snapshot::Snapshot;
use crate::lattice::LatticeBox;

/// Sizes and counts of a snapshot.
#[derive(Clone, Debug, PartialEq)]
pub struct Info {
    /// Points.
    pub points: u64,
    /// Nodes of all layers.
    pub nodes: u64,
    /// Chunk rows.
    pub chunk_rows: u64,
    /// Levels of the deepest tree, the root's included.
    pub levels: u32,
    /// Tight bounds of all points.
    pub bounds: Option<LatticeBox>,
    /// Bytes of the positions' chunks.
    pub position_bytes: u64,
    /// Bytes of the scan ids' chunks.
    pub scan_bytes: u64,
    /// Bytes of each attribute's chunks, ascending by slot.
    pub attribute_bytes: Vec<(Slot, u64)>,
    /// Bytes of all encoded columns.
    pub chunk_bytes: u64,
    /// Bytes of the store's file, its log included.
    pub total_bytes: u64,
    /// Is a writer at work, or is there a log that is not yet in the file? Then the file alone is not the store, and
    /// must not be copied alone.
    pub in_use: bool,
}

/// Gathers them from the node rows and the file system.
///
/// # Errors
///
/// [`StoreError::Damaged`] if a node row is missing or wrong; [`StoreError::Io`].
pub fn info(snapshot: &Snapshot) -> Result<Info, StoreError> {
    let index = snapshot.index()?;
    let roots: Vec<_> = index.roots().map(|r| index.head(r)).collect();
    let mut info = Info {
        points: roots.iter().map(|h| h.subtree_points).sum(),
        nodes: index.len() as u64,
        chunk_rows: 0,
        levels: 0,
        bounds: roots.iter().map(|h| h.subtree_bounds).reduce(|a, b| a.union(&b)),
        position_bytes: 0,
        scan_bytes: 0,
        attribute_bytes: snapshot.attributes().iter().map(|a| (a.id, 0)).collect(),
        chunk_bytes: 0,
        total_bytes: 0,
        in_use: false,
    };
    for root in index.roots() {
        let top = index.head(root).cube.k();
        let deepest = index.subtree(root).map(|n| index.head(n).cube.k()).min().unwrap_or(top);
        info.levels = info.levels.max(u32::from(top - deepest) + 1);
    }
    for part in index.heads().iter().flat_map(|h| &h.parts) {
        for (slot, bytes) in part.chunks.iter().chain(&part.packed).map(|&(s, b)| (s, u64::from(b))) {
            info.chunk_bytes += bytes;
            match slot {
                SLOT_POSITION => info.position_bytes += bytes,
                SLOT_SCAN => info.scan_bytes += bytes,
                slot => {
                    if let Ok(i) = info.attribute_bytes.binary_search_by_key(&slot, |a| a.0) {
                        info.attribute_bytes[i].1 += bytes;
                    }
                }
            }
        }
        info.chunk_rows += part.chunks.len() as u64 + u64::from(!part.packed.is_empty());
    }
    match &**snapshot.place() {
        Place::File(file) => {
            let facts = std::fs::metadata(&file.path).map_err(|source| StoreError::Io {
                path: file.path.clone(),
                action: "looking at the store",
                source,
            })?;
            let log = wal_bytes(&file.path);
            info.total_bytes = facts.len() + log;
            info.in_use = log > 0 || WriterLock::is_taken(&file.path);
        }
        Place::Memory(_) => {
            let pages = |c: &rusqlite::Connection| {
                let pragma = |name| c.query_row(name, [], |row| row.get::<_, i64>(0)).map_err(RowError::from);
                Ok(pragma("PRAGMA page_count")?.saturating_mul(pragma("PRAGMA page_size")?))
            };
            info.total_bytes = snapshot.with(pages)?.unsigned_abs();
        }
    }
    Ok(info)
}

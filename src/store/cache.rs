//! What is kept of chunks between reads, for all snapshots of a store and all threads: their rows as they are in the file,
//! checked, and blocks as they were decoded. Both are bounded in bytes.
//!
//! A chunk's id is never given out twice, and what it names does not change, so nothing here ever goes stale; what belongs
//! to a node that is gone is not asked for any more and makes room in its turn. No lock is held while a row is read or a
//! block is decoded: two threads that miss the same one both do it, and one of the results stays.

use super::model::Slot;
use crate::points::{Column, Positions};
use crate::with_column;
use quick_cache::Weighter;
use quick_cache::sync::Cache;
use serde::Serialize;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// A block of a column, by the id of its chunk and its place in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BlockKey {
    /// `chunk_base + part * SLOT_STRIDE + slot`, also for a column in a packed row.
    pub chunk: i64,
    /// From 0.
    pub block: u32,
}

/// A decoded block.
#[derive(Clone, Debug)]
pub enum CachedBlock {
    /// Where its points are.
    Positions(Arc<Positions>),
    /// The values of one attribute.
    Column(Arc<Column>),
}

/// What the caches of a store hold and have been asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct CacheFigures {
    /// Bytes of rows that are kept.
    pub row_bytes: u64,
    /// Rows that were there when they were asked for.
    pub row_hits: u64,
    /// Rows that were not.
    pub row_misses: u64,
    /// Bytes of decoded blocks that are kept.
    pub block_bytes: u64,
    /// Blocks that were there when they were asked for.
    pub block_hits: u64,
    /// Blocks that were not.
    pub block_misses: u64,
}

/// Bytes beside the content: the entry, its key, its reference counts.
const ENTRY_BYTES: u64 = 96;

#[derive(Clone, Copy, Debug)]
struct Bytes;

impl Weighter<i64, Arc<Vec<u8>>> for Bytes {
    fn weight(&self, _: &i64, row: &Arc<Vec<u8>>) -> u64 {
        ENTRY_BYTES + row.capacity() as u64
    }
}

impl Weighter<BlockKey, CachedBlock> for Bytes {
    fn weight(&self, _: &BlockKey, block: &CachedBlock) -> u64 {
        ENTRY_BYTES
            + match block {
                CachedBlock::Positions(p) => 8 * (p.x.capacity() + p.y.capacity() + p.z.capacity()) as u64,
                CachedBlock::Column(column) => {
                    with_column!(&**column, values => (values.capacity() * size_of_val(&values[..1.min(values.len())])) as u64)
                }
            }
    }
}

/// See the module.
#[derive(Debug)]
pub(super) struct Caches {
    rows: Option<Cache<i64, Arc<Vec<u8>>, Bytes>>,
    blocks: Option<Cache<BlockKey, CachedBlock, Bytes>>,
    row_hits: AtomicU64,
    row_misses: AtomicU64,
    block_hits: AtomicU64,
    block_misses: AtomicU64,
}

impl Caches {
    /// Empty ones, with limits in bytes; 0 keeps nothing.
    pub fn new(row_bytes: usize, block_bytes: usize) -> Self {
        // A row has some ten kilobytes, a decoded block too.
        let cells = |bytes: usize| (bytes >> 13).max(16);
        Self {
            rows: (row_bytes > 0).then(|| Cache::with_weighter(cells(row_bytes), row_bytes as u64, Bytes)),
            blocks: (block_bytes > 0).then(|| Cache::with_weighter(cells(block_bytes), block_bytes as u64, Bytes)),
            row_hits: AtomicU64::default(),
            row_misses: AtomicU64::default(),
            block_hits: AtomicU64::default(),
            block_misses: AtomicU64::default(),
        }
    }

    /// Are rows kept at all?
    pub fn keeps_rows(&self) -> bool {
        self.rows.is_some()
    }

    pub fn row(&self, chunk: i64) -> Option<Arc<Vec<u8>>> {
        let found = self.rows.as_ref()?.get(&chunk);
        count(found.is_some(), &self.row_hits, &self.row_misses);
        found
    }

    pub fn keep_row(&self, chunk: i64, row: &Arc<Vec<u8>>) {
        if let Some(rows) = &self.rows {
            rows.insert(chunk, row.clone());
        }
    }

    /// The limit of the blocks.
    pub fn block_limit(&self) -> u64 {
        self.blocks.as_ref().map_or(0, Cache::capacity)
    }

    pub fn block(&self, key: BlockKey) -> Option<CachedBlock> {
        let found = self.blocks.as_ref()?.get(&key);
        count(found.is_some(), &self.block_hits, &self.block_misses);
        found
    }

    pub fn keep_block(&self, key: BlockKey, block: CachedBlock) {
        if let Some(blocks) = &self.blocks {
            blocks.insert(key, block);
        }
    }

    pub fn figures(&self) -> CacheFigures {
        let count = |c: &AtomicU64| c.load(Ordering::Relaxed);
        CacheFigures {
            row_bytes: self.rows.as_ref().map_or(0, Cache::weight),
            row_hits: count(&self.row_hits),
            row_misses: count(&self.row_misses),
            block_bytes: self.blocks.as_ref().map_or(0, Cache::weight),
            block_hits: count(&self.block_hits),
            block_misses: count(&self.block_misses),
        }
    }
}

fn count(found: bool, hits: &AtomicU64, misses: &AtomicU64) {
    if found { hits } else { misses }.fetch_add(1, Ordering::Relaxed);
}

/// The key of a block of a column of a part.
pub(super) fn block_key(head: &super::model::NodeHead, part: usize, slot: Slot, block: usize) -> BlockKey {
    BlockKey { chunk: head.chunk_id(part, slot), block: block as u32 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_stays_below_its_limit_and_comes_back() {
        let caches = Caches::new(100_000, 200_000);
        for chunk in 0..500 {
            caches.keep_row(chunk, &Arc::new(vec![chunk as u8; 1000]));
            let column = CachedBlock::Column(Arc::new(Column::U32(vec![chunk as u32; 500])));
            caches.keep_block(BlockKey { chunk, block: 3 }, column);
            let figures = caches.figures();
            assert!(figures.row_bytes <= 100_000 && figures.block_bytes <= 200_000, "{figures:?}");
        }
        let mut found = (0, 0);
        for chunk in 0..500 {
            if let Some(row) = caches.row(chunk) {
                assert_eq!(row[..], vec![chunk as u8; 1000]);
                found.0 += 1;
            }
            assert!(caches.block(BlockKey { chunk, block: 2 }).is_none());
            if let Some(CachedBlock::Column(column)) = caches.block(BlockKey { chunk, block: 3 }) {
                assert_eq!(*column, Column::U32(vec![chunk as u32; 500]));
                found.1 += 1;
            }
        }
        let figures = caches.figures();
        assert_eq!((figures.row_hits, figures.block_hits), found);
        assert_eq!((figures.row_misses, figures.block_misses), (500 - found.0, 1000 - found.1));
        assert!(found.0 > 50 && found.1 > 50, "most of the room is used: {found:?}");
        let none = Caches::new(0, 0);
        none.keep_row(1, &Arc::new(vec![1]));
        assert!(none.row(1).is_none() && none.figures() == CacheFigures::default());
    }
}

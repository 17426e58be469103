//! Which parts lie in the pool, from one frame of a walk to the next.

use crate::query::PartId;
use crate::stream::Densities;
use crate::stream::gpu::{BlockId, PackedPoint, PointPool, PoolError};
use std::collections::HashMap;

/// A part, whole, or an even thinning of it to so many points.
pub(super) type Key = (PartId, Option<u32>);

/// Parts in a pool: loaded once while they are wanted, and kept as long as there is room.
#[derive(Debug)]
pub(super) struct Resident<P> {
    pool: P,
    parts: HashMap<Key, Held>,
    free: Vec<BlockId>,
    /// The pool grows up to this, then what was not wanted for longest goes.
    limit_blocks: u32,
    frame: u64,
}

/// A part as it is uploaded.
pub(super) struct Packed {
    pub points: Vec<PackedPoint>,
    /// How close the points of the part lie, and which share of them these are.
    pub densities: Densities,
    pub share: f32,
}

/// A part that is there.
#[derive(Clone, Debug)]
pub(super) struct Held {
    pub points: u32,
    pub blocks: Vec<BlockId>,
    /// How close the points of the part lie, and which share of them is here.
    pub densities: Densities,
    pub share: f32,
    last_wanted: u64,
}

impl<P: PointPool> Resident<P> {
    /// `pool` has no blocks yet.
    pub fn new(pool: P, limit_blocks: u32) -> Self {
        Self { pool, parts: HashMap::new(), free: Vec::new(), limit_blocks, frame: 0 }
    }

    pub fn pool(&self) -> &P {
        &self.pool
    }

    pub fn get(&self, id: &Key) -> Option<&Held> {
        self.parts.get(id)
    }

    /// Begins a frame in which these parts are wanted.
    pub fn begin(&mut self, wanted: impl Iterator<Item = Key>) {
        self.frame += 1;
        for id in wanted {
            if let Some(held) = self.parts.get_mut(&id) {
                held.last_wanted = self.frame;
            }
        }
    }

    /// Makes room for as many blocks. Only parts that the frame doesn't want go; if these are not enough the pool grows
    /// over its limit, which the caller's capacity bounds.
    ///
    /// # Errors
    ///
    /// [`PoolError`] of the pool.
    pub fn reserve(&mut self, blocks: usize) -> Result<(), PoolError> {
        let missing = |free: usize| u32::try_from(blocks.saturating_sub(free)).unwrap_or(u32::MAX);
        let growth = missing(self.free.len()).min(self.limit_blocks.saturating_sub(self.pool.blocks()));
        self.grow(growth)?;
        if self.free.len() < blocks {
            let mut old: Vec<(u64, Key)> = self
                .parts
                .iter()
                .filter(|(_, held)| held.last_wanted < self.frame)
                .map(|(id, h)| (h.last_wanted, *id))
                .collect();
            old.sort_unstable();
            for (_, id) in old {
                if self.free.len() >= blocks {
                    break;
                }
                self.free.extend(self.parts.remove(&id).into_iter().flat_map(|held| held.blocks));
            }
        }
        self.grow(missing(self.free.len()))
    }

    fn grow(&mut self, blocks: u32) -> Result<(), PoolError> {
        if blocks > 0 {
            let before = self.pool.blocks();
            let after = before.saturating_add(blocks);
            self.pool.resize(after)?;
            self.free.extend((before..after).map(BlockId));
        }
        Ok(())
    }

    /// Writes a part into free blocks; see [`Resident::reserve`].
    ///
    /// # Errors
    ///
    /// [`PoolError`] of the pool.
    pub fn insert(&mut self, id: Key, packed: Packed) -> Result<(), PoolError> {
        let Packed { points, densities, share } = packed;
        let block_points = self.pool.block_points() as usize;
        let needed = points.len().div_ceil(block_points);
        if self.free.len() < needed {
            self.reserve(needed)?;
        }
        let blocks = self.free.split_off(self.free.len().saturating_sub(needed));
        for (block, chunk) in blocks.iter().zip(points.chunks(block_points)) {
            self.pool.write(*block, chunk)?;
        }
        let held = Held { points: points.len() as u32, blocks, densities, share, last_wanted: self.frame };
        if let Some(before) = self.parts.insert(id, held) {
            self.free.extend(before.blocks);
        }
        Ok(())
    }
}

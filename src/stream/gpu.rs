//! What the stream and a renderer agree on: points as the graphics adapter has them, a pool of fixed blocks, lists of what
//! to draw.
//!
//! The stream fills blocks of a [`PointPool`] and hands out [`DrawList`]s; a renderer draws a list's blocks. Neither knows
//! the other. A block of a list is not written again while anybody holds the list, so a renderer keeps its [`Arc`] of a
//! list until the commands that draw it are submitted, and no longer.

use crate::lattice::{Cube, Lattice, LatticePoint};
use crate::points::{Batch, Positions};
use bytemuck::{Pod, Zeroable};
use std::fmt::Debug;
use std::sync::Arc;
use thiserror::Error;

/// Points of a block, unless a pool has a reason for another number: parts of nodes have some thousands of points, so
/// little of their last blocks stays empty, and 2 M points are some 1,200 blocks.
pub const BLOCK_POINTS: u32 = 2048;

/// A point on the adapter: 16 bytes.
///
/// The steps are lattice steps from the low corner of the node's cube, divided by `2^shift` where the cube's side is more
/// than `2^32` steps (see [`step_shift`]). What the value means is the business of the [`Paint`] that made it.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Pod, Zeroable)]
pub struct PackedPoint {
    /// From the low corner of the node's cube.
    pub steps: [u32; 3],
    /// RGBA8 (red in the lowest byte), or the bits of an attribute's value.
    pub value: u32,
}

const _: () = assert!(size_of::<PackedPoint>() == 16);

/// By how many bits steps in this cube are shifted: 0 for all cubes of at most `2^32` steps a side.
pub fn step_shift(cube: Cube) -> u8 {
    cube.k().saturating_sub(32)
}

impl PackedPoint {
    /// Packs a point of `cube`. Exact without a shift, else rounded to the nearest `2^shift` steps.
    pub fn pack(cube: Cube, point: LatticePoint, value: u32) -> Self {
        let (shift, low) = (step_shift(cube), cube.low());
        let half = (1_u64 << shift) >> 1;
        let step = |i: usize| (point.0[i].wrapping_sub(low.0[i]).saturating_add(half) >> shift).min(u32::MAX.into());
        Self { steps: std::array::from_fn(|i| step(i) as u32), value }
    }

    /// Packs all points of a batch that lie in `cube`, with their values, as [`PackedPoint::pack`] does one.
    pub fn pack_all(cube: Cube, positions: &Positions, values: &[u32], points: &mut Vec<Self>) {
        let axes = positions.x.iter().zip(&positions.y).zip(&positions.z).zip(values);
        if step_shift(cube) > 0 {
            points.extend(axes.map(|(((&x, &y), &z), &value)| Self::pack(cube, LatticePoint([x, y, z]), value)));
            return;
        }
        // A cube of at most 2^32 steps is aligned: the low words alone say where in it a point is.
        let [x0, y0, z0] = cube.low().0.map(|c| c as u32);
        points.extend(axes.map(|(((&x, &y), &z), &value)| {
            let steps = [(x as u32).wrapping_sub(x0), (y as u32).wrapping_sub(y0), (z as u32).wrapping_sub(z0)];
            Self { steps, value }
        }));
    }

    /// The point again, up to the rounding of [`PackedPoint::pack`].
    pub fn unpack(&self, cube: Cube) -> LatticePoint {
        let (shift, low) = (step_shift(cube), cube.low());
        LatticePoint(std::array::from_fn(|i| low.0[i] + (u64::from(self.steps[i]) << shift)))
    }
}

/// One block of a pool, from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct BlockId(pub u32);

/// Why a pool can't do what is asked.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PoolError {
    /// There is no such block, or it is smaller.
    #[error("the pool has {blocks} blocks of {block_points} points; block {block} can't take {points} points")]
    NoRoom {
        /// Blocks of the pool.
        blocks: u32,
        /// Points of a block.
        block_points: u32,
        /// The block asked for.
        block: u32,
        /// What it was to hold.
        points: usize,
    },
    /// The adapter is gone or has no memory: everything in the pool is lost.
    #[error("the graphics adapter lost its points: {0}")]
    Lost(String),
}

/// Memory for points on the adapter, in blocks of one size: it never fragments, and never takes more than its budget.
///
/// The stream calls it from its own thread, never from the frame's.
pub trait PointPool: Send {
    /// The most points of a block.
    fn block_points(&self) -> u32;

    /// How many blocks there are.
    fn blocks(&self) -> u32;

    /// Fills a block from its start; what it held before is gone. Draws that were submitted before still see the old
    /// points, those submitted later the new ones.
    ///
    /// # Errors
    ///
    /// [`PoolError`].
    fn write(&mut self, block: BlockId, points: &[PackedPoint]) -> Result<(), PoolError>;

    /// Changes the number of blocks. Those that stay keep their points; no list that is held has one that goes.
    ///
    /// # Errors
    ///
    /// [`PoolError::Lost`] if there is no memory for more; the pool is as it was then.
    fn resize(&mut self, blocks: u32) -> Result<(), PoolError>;

    /// The most bytes of points that the pool takes.
    fn budget_bytes(&self) -> u64 {
        u64::from(self.blocks()) * u64::from(self.block_points()) * size_of::<PackedPoint>() as u64
    }
}

/// What the value of a packed point is: a colour, or an attribute that the renderer maps to one.
///
/// Changing the paint uploads all points again; what a renderer can change by a uniform (ranges, ramps) is not part of it.
pub trait Paint: Send + Sync + Debug {
    /// Says to the renderer what the values are; every [`DrawList`] carries the tag of its paint. Paints of one tag give
    /// the same values.
    fn tag(&self) -> u64;

    /// The attributes that it looks at; those that the store lacks are left out of the batch.
    fn attributes(&self) -> Vec<String>;

    /// Does it look at the scans of the points? Otherwise batches may come without.
    fn needs_scans(&self) -> bool;

    /// Appends one value per point of the batch, in its order.
    fn paint(&self, batch: &Batch, lattice: &Lattice, values: &mut Vec<u32>);
}

/// A node of which something is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DrawNode {
    /// Its cube: packed points are relative to the low corner.
    pub cube: Cube,
    /// Its layer.
    pub layer: u16,
    /// How far apart the points lie, in CRS units, for as much of the node as is drawn. Where a patch or a finer node of the
    /// list holds a point too, that one's spacing counts.
    pub spacing: f64,
    /// Are finer points wanted here that are not there yet? Then the points stand in for them and are drawn larger.
    pub stand_in: bool,
    /// The parent's place in [`DrawList::nodes`]; `None` for a root. It is always before its children.
    pub parent: Option<u32>,
}

/// A cube in a node, with no node of its own, in which points lie otherwise than in the rest of the node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// The node's place in [`DrawList::nodes`].
    pub node: u32,
    /// An octant of the node's cube, or an octant of a patch.
    pub cube: Cube,
    /// How far apart the points lie here, in CRS units.
    pub spacing: f64,
}

/// A block to draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DrawBlock {
    /// Where the points lie in the pool.
    pub block: BlockId,
    /// How many, from the block's start.
    pub points: u32,
    /// Whose points: a place in [`DrawList::nodes`].
    pub node: u32,
    /// Which part of the node.
    pub part: u32,
    /// How many points of the part lie in the blocks before this one.
    pub first: u32,
}

/// What to draw: a closed cut of the octree, in the order in which to draw it.
#[derive(Clone, Debug, PartialEq)]
pub struct DrawList {
    /// What positions mean.
    pub lattice: Lattice,
    /// The tag of the [`Paint`] that made the values.
    pub paint: u64,
    /// In node-key order, then by layer; every node's parent is there.
    pub nodes: Vec<DrawNode>,
    /// Where points lie otherwise than in the rest of their node.
    pub patches: Vec<Patch>,
    /// In the order of their nodes, then of parts, then of the points in the part.
    pub blocks: Vec<DrawBlock>,
    /// Points of all blocks together.
    pub points: u64,
    /// Is this all that the camera asks for? Then nothing is a stand-in.
    pub complete: bool,
}

impl DrawList {
    /// Nothing to draw.
    pub fn empty(lattice: Lattice, paint: u64) -> Self {
        Self { lattice, paint, nodes: Vec::new(), patches: Vec::new(), blocks: Vec::new(), points: 0, complete: false }
    }
}

/// A pool in ordinary memory that counts what is written: for tests, and to look at what was uploaded.
#[derive(Debug)]
pub struct MemoryPool {
    block_points: u32,
    content: Arc<std::sync::Mutex<PoolContent>>,
}

/// What is in a [`MemoryPool`], and what it cost.
#[derive(Debug, Default)]
pub struct PoolContent {
    /// By block.
    pub blocks: Vec<Vec<PackedPoint>>,
    /// Calls of [`PointPool::write`].
    pub writes: u64,
    /// Bytes of all of them.
    pub bytes: u64,
    /// From now on every write fails, as if the adapter were lost.
    pub lost: bool,
}

impl MemoryPool {
    /// An empty pool.
    pub fn new(blocks: u32, block_points: u32) -> Self {
        let content = PoolContent { blocks: vec![Vec::new(); blocks as usize], ..PoolContent::default() };
        Self { block_points, content: Arc::new(std::sync::Mutex::new(content)) }
    }

    /// The content, which stays reachable when the stream has the pool.
    pub fn content(&self) -> Arc<std::sync::Mutex<PoolContent>> {
        self.content.clone()
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, PoolContent> {
        // A test that failed while it looked has said so itself.
        self.content.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

impl PointPool for MemoryPool {
    fn block_points(&self) -> u32 {
        self.block_points
    }

    fn blocks(&self) -> u32 {
        self.lock().blocks.len() as u32
    }

    fn write(&mut self, block: BlockId, points: &[PackedPoint]) -> Result<(), PoolError> {
        let block_points = self.block_points;
        let content = &mut *self.lock();
        if content.lost {
            return Err(PoolError::Lost("the test says so".into()));
        }
        let blocks = content.blocks.len() as u32;
        match content.blocks.get_mut(block.0 as usize) {
            Some(held) if points.len() <= block_points as usize => {
                held.clear();
                held.extend_from_slice(points);
            }
            _ => return Err(PoolError::NoRoom { blocks, block_points, block: block.0, points: points.len() }),
        }
        content.writes += 1;
        content.bytes += size_of_val(points) as u64;
        Ok(())
    }

    fn resize(&mut self, blocks: u32) -> Result<(), PoolError> {
        self.lock().blocks.resize(blocks as usize, Vec::new());
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn packed_points_come_back(corner in any::<[u64; 3]>(), k in 7_u8..=48, offset in any::<[u64; 3]>(), value in any::<u32>()) {
            let range = (1_u64 << 48) - 1;
            let cube = Cube::containing(LatticePoint(corner.map(|c| c & range)), k);
            let point = LatticePoint(std::array::from_fn(|i| cube.low().0[i] + offset[i] % cube.side()));
            let packed = PackedPoint::pack(cube, point, value);
            let back = packed.unpack(cube);
            let half = (1_u64 << step_shift(cube)) >> 1;
            for axis in 0..3 {
                let error = back.0[axis].abs_diff(point.0[axis]);
                // The last half of the highest step has nothing above to be rounded to.
                let at_top = packed.steps[axis] == u32::MAX;
                prop_assert!(error <= half || at_top && error < 2 * half, "{} of {}", error, half);
            }
            prop_assert_eq!(packed.value, value);
            let mut all = Vec::new();
            PackedPoint::pack_all(cube, &[point, cube.low()].into_iter().collect(), &[value, 7], &mut all);
            prop_assert_eq!(all, vec![packed, PackedPoint::pack(cube, cube.low(), 7)]);
        }
    }

    #[test]
    fn a_pool_in_memory_refuses_what_does_not_fit() {
        let mut pool = MemoryPool::new(2, 3);
        let content = pool.content();
        let point = PackedPoint { steps: [1, 2, 3], value: 4 };
        pool.write(BlockId(1), &[point; 3]).unwrap();
        assert!(matches!(pool.write(BlockId(1), &[point; 4]), Err(PoolError::NoRoom { .. })));
        assert!(matches!(pool.write(BlockId(2), &[point]), Err(PoolError::NoRoom { .. })));
        assert_eq!(pool.budget_bytes(), 2 * 3 * 16);
        pool.resize(3).unwrap();
        pool.write(BlockId(2), &[point]).unwrap();
        let content = content.lock().unwrap();
        assert_eq!((content.writes, content.bytes, content.blocks[1].len()), (2, 64, 3));
    }
}

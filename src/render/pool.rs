//! The stream's pool of point blocks in buffers on the adapter.
//!
//! Blocks lie side by side in *slabs*: buffers of one size, each small enough to be bound at once, only the last one
//! shorter. So the pool takes exactly its blocks' bytes, never fragments, and a block's place is a division.

use super::canvas::bind;
use crate::stream::gpu::{BlockId, PackedPoint, PointPool, PoolError};
use std::sync::{Arc, PoisonError, RwLock};

/// The bytes of a slab, unless the adapter can bind fewer: half of what software Vulkan binds. Small enough that the
/// last one can be replaced when the pool is resized.
pub(super) const SLAB_BYTES: u64 = 64 << 20;

/// Where blocks lie: shared by the pool that is written and the renderer that draws.
#[derive(Debug)]
pub(super) struct Slabs {
    pub block_points: u32,
    pub blocks_per_slab: u32,
    pub blocks: u32,
    pub slabs: Vec<Slab>,
}

#[derive(Debug)]
pub(super) struct Slab {
    buffer: wgpu::Buffer,
    pub group: wgpu::BindGroup,
}

impl Slabs {
    /// The slab of a block, and its first point there; `None` if there is no such block.
    pub fn place(&self, block: BlockId) -> Option<(usize, u32)> {
        let slab = block.0 / self.blocks_per_slab;
        (block.0 < self.blocks).then(|| (slab as usize, block.0 % self.blocks_per_slab * self.block_points))
    }
}

/// What the renderer knows of a [`GpuPool`], which itself is on its way with the stream.
#[derive(Clone, Debug)]
pub struct PoolPoints(pub(super) Arc<RwLock<Slabs>>);

/// Points on the adapter, in blocks. Made by [`Renderer::pool`](super::Renderer::pool).
#[derive(Debug)]
pub struct GpuPool {
    device: wgpu::Device,
    queue: wgpu::Queue,
    layout: wgpu::BindGroupLayout,
    shared: Arc<RwLock<Slabs>>,
    /// Copied here by the pool, since the lock may be waited for.
    block_points: u32,
    blocks: u32,
}

impl GpuPool {
    /// An empty pool; [`PointPool::resize`] gives it blocks.
    pub(super) fn new(
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        layout: &wgpu::BindGroupLayout,
        block_points: u32,
        slab_bytes: u64,
    ) -> Self {
        let limits = device.limits();
        let largest = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size).min(slab_bytes);
        let block_points = block_points.max(1);
        let block_bytes = u64::from(block_points) * size_of::<PackedPoint>() as u64;
        let blocks_per_slab = (largest / block_bytes).clamp(1, u64::from(u32::MAX)) as u32;
        let slabs = Slabs { block_points, blocks_per_slab, blocks: 0, slabs: Vec::new() };
        let shared = Arc::new(RwLock::new(slabs));
        let (device, queue, layout) = (device.clone(), queue.clone(), layout.clone());
        Self { device, queue, layout, shared, block_points, blocks: 0 }
    }

    /// The handle by which a renderer draws from the pool.
    pub fn points(&self) -> PoolPoints {
        PoolPoints(self.shared.clone())
    }

    fn slab(&self, blocks: u32) -> Slab {
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("points"),
            size: self.bytes(blocks),
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        let group = bind(&self.device, "points", &self.layout, &[buffer.as_entire_binding()]);
        Slab { buffer, group }
    }

    fn bytes(&self, blocks: u32) -> u64 {
        u64::from(blocks) * u64::from(self.block_points) * size_of::<PackedPoint>() as u64
    }
}

impl PointPool for GpuPool {
    fn block_points(&self) -> u32 {
        self.block_points
    }

    fn blocks(&self) -> u32 {
        self.blocks
    }

    fn write(&mut self, block: BlockId, points: &[PackedPoint]) -> Result<(), PoolError> {
        let slabs = self.shared.read().unwrap_or_else(PoisonError::into_inner);
        let fits = points.len() <= self.block_points as usize;
        let Some((slab, first)) = slabs.place(block).filter(|_| fits) else {
            let (blocks, block_points) = (self.blocks, self.block_points);
            return Err(PoolError::NoRoom { blocks, block_points, block: block.0, points: points.len() });
        };
        let offset = u64::from(first) * size_of::<PackedPoint>() as u64;
        self.queue.write_buffer(&slabs.slabs[slab].buffer, offset, bytemuck::cast_slice(points));
        Ok(())
    }

    fn resize(&mut self, blocks: u32) -> Result<(), PoolError> {
        let per_slab = self.shared.read().unwrap_or_else(PoisonError::into_inner).blocks_per_slab;
        let lengths = |blocks: u32| -> Vec<u32> {
            let whole = std::iter::repeat_n(per_slab, (blocks / per_slab) as usize);
            whole.chain(Some(blocks % per_slab).filter(|rest| *rest > 0)).collect()
        };
        let (old, new) = (lengths(self.blocks), lengths(blocks));
        let scope = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        // Slabs whose length stays are kept as they are; of the others the common part is copied.
        let made: Vec<(usize, Slab)> =
            (0..new.len()).filter(|&i| old.get(i) != Some(&new[i])).map(|i| (i, self.slab(new[i]))).collect();
        if let Some(error) = pollster::block_on(scope.pop()) {
            return Err(PoolError::Lost(error.to_string()));
        }
        let mut slabs = self.shared.write().unwrap_or_else(PoisonError::into_inner);
        let mut encoder = self.device.create_command_encoder(&Default::default());
        for (i, slab) in made {
            if let Some(before) = slabs.slabs.get(i) {
                let common = self.bytes(old[i].min(new[i]));
                encoder.copy_buffer_to_buffer(&before.buffer, 0, &slab.buffer, 0, common);
            }
            if i < slabs.slabs.len() {
                slabs.slabs[i] = slab;
            } else {
                slabs.slabs.push(slab);
            }
        }
        slabs.slabs.truncate(new.len());
        slabs.blocks = blocks;
        self.blocks = blocks;
        self.queue.submit([encoder.finish()]);
        Ok(())
    }
}

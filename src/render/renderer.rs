//! The renderer: a device, the passes, and one picture after another.

use super::canvas::{Canvas, Draw, FrameData, bind, texture};
use super::frame::Frame;
use super::gpu_types::{GpuFrame, GpuLine};
use super::lines::box_lines;
use super::list::{ListData, frame_of};
use super::pack::{Page, for_each_page};
use super::passes::{COLOR_FORMAT, Passes, PointsVariant};
use super::pick::PickRequest;
use super::pool::{GpuPool, PoolPoints, SLAB_BYTES};
use super::{Image, Palette, Picked, RenderError, RenderOptions, Scene, Shape, adapter, read_back};
use crate::geometry::Camera;
use crate::stream::gpu::{DrawList, PackedPoint, PointPool};
use std::sync::PoisonError;

/// Points of a scene that are uploaded at once: 64 MiB, half of what software Vulkan binds.
const PAGE_POINTS: usize = 1 << 22;
const PAGE_BLOCKS: usize = 1 << 16;
/// The farthest from a pixel that a pick looks: 256 bytes of ids a row, the least that a copy has.
const MAX_PICK_REACH_PX: u32 = 31;

/// Draws points on a graphics adapter: scenes to images in memory, draw lists to any texture.
pub struct Renderer {
    device: wgpu::Device,
    queue: wgpu::Queue,
    passes: Passes,
    adapter: String,
    limits: wgpu::Limits,
}

/// How a list is looked at.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// From where, and the image's size.
    pub camera: &'a Camera,
    /// How it is drawn.
    pub options: &'a RenderOptions,
    /// What the values of its points look like.
    pub palette: &'a Palette,
}

impl std::fmt::Debug for Renderer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Renderer").field("adapter", &self.adapter).finish_non_exhaustive()
    }
}

impl Renderer {
    /// A renderer on the machine's fastest adapter, or the one that the environment names: see [`adapter()`](super::adapter()).
    ///
    /// # Errors
    ///
    /// As [`adapter()`](super::adapter()); [`RenderError::Device`] if it can't be used.
    pub fn new() -> Result<Self, RenderError> {
        let adapter = adapter::adapter(&adapter::instance(), None)?;
        let info = adapter.get_info();
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("esker"),
            required_limits: adapter.limits(),
            memory_hints: wgpu::MemoryHints::MemoryUsage,
            ..Default::default()
        }))
        .map_err(|e| RenderError::Device { adapter: adapter::described(&info), reason: e.to_string() })?;
        Self::on_device(device, queue, &info, COLOR_FORMAT)
    }

    /// A renderer on a device that others use, too, for targets of format `output`: a window's. If that codes colours
    /// itself (an sRGB format), it is given linear ones.
    ///
    /// # Errors
    ///
    /// [`RenderError::Device`] if the device can't do the passes.
    pub fn on_device(
        device: wgpu::Device,
        queue: wgpu::Queue,
        adapter: &wgpu::AdapterInfo,
        output: wgpu::TextureFormat,
    ) -> Result<Self, RenderError> {
        let adapter = adapter::described(adapter);
        let limits = device.limits();
        let scope = device.push_error_scope(wgpu::ErrorFilter::Validation);
        let passes = Passes::new(&device, output);
        passes.points(PointsVariant { deep: false, ids: false });
        passes.shade();
        if let Some(error) = pollster::block_on(scope.pop()) {
            return Err(RenderError::Device { adapter, reason: error.to_string() });
        }
        Ok(Self { device, queue, passes, adapter, limits })
    }

    /// The adapter's name, with its interface and kind: `llvmpipe (LLVM 15.0.6, 256 bits) (Vulkan, Cpu)`.
    pub fn adapter_name(&self) -> &str {
        &self.adapter
    }

    /// The most pixels on a side of an image.
    pub fn max_size_px(&self) -> u32 {
        self.limits.max_texture_dimension_2d
    }

    /// A pool of `blocks` blocks of `block_points` points each: exactly their bytes are taken, in several buffers where
    /// the adapter binds less at once.
    ///
    /// # Errors
    ///
    /// [`RenderError::Device`] if there is no memory.
    pub fn pool(&self, blocks: u32, block_points: u32) -> Result<GpuPool, RenderError> {
        self.pool_of_slabs(blocks, block_points, SLAB_BYTES)
    }

    /// The same with at most so many bytes a buffer.
    pub(super) fn pool_of_slabs(&self, blocks: u32, block_points: u32, bytes: u64) -> Result<GpuPool, RenderError> {
        let mut pool = GpuPool::new(&self.device, &self.queue, &self.passes.points_layout, block_points, bytes);
        pool.resize(blocks).map_err(|e| self.failed(e))?;
        Ok(pool)
    }

    /// Something to draw on; `with_ids`: points can be picked from it.
    pub fn canvas(&self, with_ids: bool) -> Canvas {
        Canvas::new(&self.device, &self.queue, with_ids)
    }

    /// Encodes the passes that draw `list` from the pool into `output`, a texture of the camera's size and the format
    /// given to [`Renderer::on_device`]. Nothing is waited for, and nothing is submitted: small buffers are handed to the
    /// queue, for the submission of `encoder`.
    ///
    /// # Errors
    ///
    /// [`RenderError::Size`] above [`Renderer::max_size_px`]; [`RenderError::Number`] for options that can't be drawn
    /// with.
    pub fn encode(
        &self,
        canvas: &mut Canvas,
        encoder: &mut wgpu::CommandEncoder,
        points: &PoolPoints,
        list: &DrawList,
        view: View<'_>,
        output: &wgpu::TextureView,
    ) -> Result<(), RenderError> {
        let frame = frame_of(list, view.camera, view.options, self.max_size_px())?;
        let slabs = points.0.read().unwrap_or_else(PoisonError::into_inner);
        let data = ListData::new(list, &slabs, &frame, view.options);
        let gpu_frame = GpuFrame::new(&frame, list.lattice.quantum_f64(), view.options, view.palette);
        canvas.fit(&self.passes, frame.size_px);
        let palette = view.palette.entries();
        canvas
            .upload(&self.passes, &FrameData { frame: &gpu_frame, palette, blocks: &data.blocks, nodes: &data.nodes });
        let groups: Vec<_> = slabs.slabs.iter().map(|slab| &slab.group).collect();
        canvas.points(&self.passes, encoder, true, is_deep(view.options), &data.draws, &groups);
        let lines = box_lines(&list.lattice, data.boxes, &frame);
        canvas.lines(&self.passes, encoder, &lines.iter().map(GpuLine::from).collect::<Vec<_>>());
        canvas.shade(&self.passes, encoder, output);
        canvas.picks = data.picks;
        Ok(())
    }

    /// Encodes a look at the last frame on `canvas`: which point is at `pixel`, or at the nearest one within `reach_px`
    /// (at most 31). `None` if the canvas has no ids, or the pixel is not on it.
    ///
    /// After the submission call [`PickRequest::submitted`], then [`PickRequest::poll`] in later frames.
    pub fn request_pick(
        &self,
        canvas: &Canvas,
        encoder: &mut wgpu::CommandEncoder,
        pixel: [u32; 2],
        reach_px: u32,
    ) -> Option<PickRequest> {
        let (ids, size_px) = (canvas.ids()?, canvas.size_px()?);
        if (0..2).any(|i| pixel[i] >= size_px[i]) {
            return None;
        }
        let reach_px = reach_px.min(MAX_PICK_REACH_PX);
        let low = pixel.map(|c| c.saturating_sub(reach_px));
        let size: [u32; 2] = std::array::from_fn(|i| (pixel[i] + reach_px + 1).min(size_px[i]) - low[i]);
        let row_bytes = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT;
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("pick"),
            size: u64::from(row_bytes) * u64::from(size[1]),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let mut source = ids.as_image_copy();
        (source.origin.x, source.origin.y) = (low[0], low[1]);
        let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row_bytes), rows_per_image: None };
        encoder.copy_texture_to_buffer(
            source,
            wgpu::TexelCopyBufferInfo { buffer: &buffer, layout },
            wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
        );
        Some(PickRequest { buffer, table: canvas.picks.clone(), low, size, wanted: pixel, arrived: None })
    }

    /// The point at `pixel` of the last frame on `canvas`, or at the nearest one within `reach_px`: waits for the adapter.
    ///
    /// # Errors
    ///
    /// [`RenderError::Device`] if the adapter fails.
    pub fn pick(&self, canvas: &Canvas, pixel: [u32; 2], reach_px: u32) -> Result<Option<Picked>, RenderError> {
        let mut encoder = self.device.create_command_encoder(&Default::default());
        let Some(mut request) = self.request_pick(canvas, &mut encoder, pixel, reach_px) else { return Ok(None) };
        self.queue.submit([encoder.finish()]);
        request.submitted();
        self.wait()?;
        Ok(request.poll().flatten())
    }

    /// The image of a list: waits until it is drawn and brought back. For files and screenshots; the renderer must be one
    /// of [`Renderer::new`], or for RGBA8.
    ///
    /// # Errors
    ///
    /// As [`Renderer::encode`]; [`RenderError::Device`] if the adapter runs out of memory or fails.
    pub fn render_list(
        &self,
        canvas: &mut Canvas,
        points: &PoolPoints,
        list: &DrawList,
        view: View<'_>,
    ) -> Result<Image, RenderError> {
        self.checked(|| {
            let size_px = view.camera.size_px();
            self.check_size(size_px)?;
            let (shaded, output) = self.output(size_px);
            let mut encoder = self.device.create_command_encoder(&Default::default());
            self.encode(canvas, &mut encoder, points, list, view, &output)?;
            self.queue.submit([encoder.finish()]);
            read_back::image(&self.device, &self.queue, &shaded, size_px).map_err(|e| self.failed(e))
        })
    }

    /// Waits until all that was handed to the adapter is done.
    ///
    /// # Errors
    ///
    /// [`RenderError::Device`] if it fails.
    pub fn finish(&self) -> Result<(), RenderError> {
        self.queue.submit([]);
        self.wait()
    }

    /// The image of `scene` in the camera's size. The same input gives the same bytes on the same adapter; another
    /// adapter may decide otherwise on the edges of splats.
    ///
    /// The memory that it takes on the adapter is bounded by the image, not by the scene: points go there page by page.
    ///
    /// # Errors
    ///
    /// [`RenderError::Size`] above [`Renderer::max_size_px`]; [`RenderError::ColorCount`] and [`RenderError::Number`]
    /// for what can't be drawn; [`RenderError::Device`] if the adapter runs out of memory or fails.
    pub fn render(&self, scene: &Scene, camera: &Camera, options: &RenderOptions) -> Result<Image, RenderError> {
        scene.check()?;
        let frame = Frame::new(&scene.lattice, scene.bounds(options), camera, options, self.max_size_px())?;
        self.checked(|| {
            let mut canvas = self.canvas(false);
            canvas.fit(&self.passes, frame.size_px);
            self.draw_scene(&mut canvas, scene, &frame, options)?;
            let (shaded, output) = self.output(frame.size_px);
            let mut encoder = self.device.create_command_encoder(&Default::default());
            if options.node_boxes {
                let lines = box_lines(&scene.lattice, scene.boxes.iter().copied(), &frame);
                canvas.lines(&self.passes, &mut encoder, &lines.iter().map(GpuLine::from).collect::<Vec<_>>());
            }
            canvas.shade(&self.passes, &mut encoder, &output);
            self.queue.submit([encoder.finish()]);
            read_back::image(&self.device, &self.queue, &shaded, frame.size_px).map_err(|e| self.failed(e))
        })
    }

    /// Clears the targets and draws the scene, page by page in order.
    fn draw_scene(
        &self,
        canvas: &mut Canvas,
        scene: &Scene,
        frame: &Frame,
        options: &RenderOptions,
    ) -> Result<(), RenderError> {
        let palette = Palette::colors();
        let gpu_frame = GpuFrame::new(frame, scene.lattice.quantum_f64(), options, &palette);
        let binding_bytes = self.limits.max_storage_buffer_binding_size.min(self.limits.max_buffer_size);
        let most_points = usize::try_from(binding_bytes).unwrap_or(usize::MAX) / size_of::<PackedPoint>();
        let page_points = scene.len().clamp(1, PAGE_POINTS.min(most_points.max(1)));
        let points = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("page"),
            size: (page_points * size_of::<PackedPoint>()) as u64,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let group = bind(&self.device, "points", &self.passes.points_layout, &[points.as_entire_binding()]);
        let mut first = true;
        let mut draw_page = |page: &Page| {
            self.queue.write_buffer(&points, 0, bytemuck::cast_slice(&page.points));
            let data =
                FrameData { frame: &gpu_frame, palette: palette.entries(), blocks: &page.blocks, nodes: &page.nodes };
            canvas.upload(&self.passes, &data);
            let draws: Vec<Draw> = page
                .blocks
                .iter()
                .zip(&page.counts)
                .map(|(block, &points)| Draw { slab: 0, first_point: block.first_point, points })
                .collect();
            let mut encoder = self.device.create_command_encoder(&Default::default());
            canvas.points(&self.passes, &mut encoder, first, is_deep(options), &draws, &[&group]);
            first = false;
            self.queue.submit([encoder.finish()]);
            // The page's staging memory is free before the next one is filled.
            self.wait()
        };
        // The first page clears; a scene without points has none.
        draw_page(&Page::default())?;
        for_each_page(scene, frame, options.radius_factor, page_points, PAGE_BLOCKS, draw_page)
    }

    /// Runs `work`, and gives what the adapter says about it if it fails.
    fn checked<T>(&self, work: impl FnOnce() -> Result<T, RenderError>) -> Result<T, RenderError> {
        let scopes = [wgpu::ErrorFilter::Validation, wgpu::ErrorFilter::OutOfMemory, wgpu::ErrorFilter::Internal]
            .map(|filter| self.device.push_error_scope(filter));
        let done = work();
        // The last pushed first. What the adapter says is the cause of what the drawing noticed.
        let mut error = None;
        for scope in scopes.into_iter().rev() {
            error = pollster::block_on(scope.pop()).or(error);
        }
        match error {
            Some(error) => Err(self.failed(error)),
            None => done,
        }
    }

    fn check_size(&self, [width, height]: [u32; 2]) -> Result<(), RenderError> {
        let limit = self.max_size_px();
        let fits = |side: u32| (1..=limit).contains(&side);
        if fits(width) && fits(height) { Ok(()) } else { Err(RenderError::Size { width, height, limit }) }
    }

    fn output(&self, size_px: [u32; 2]) -> (wgpu::Texture, wgpu::TextureView) {
        let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC;
        texture(&self.device, "shaded", size_px, self.passes.output(), usage)
    }

    fn failed(&self, reason: impl std::fmt::Display) -> RenderError {
        RenderError::Device { adapter: self.adapter.clone(), reason: reason.to_string() }
    }

    fn wait(&self) -> Result<(), RenderError> {
        self.device.poll(wgpu::PollType::wait_indefinitely()).map(|_| ()).map_err(|e| self.failed(e))
    }
}

/// Must fragments decide the depth?
fn is_deep(options: &RenderOptions) -> bool {
    options.shadow_px > 0.0 || options.shape == Shape::Paraboloid
}

//! The renderer: an adapter, its device, and one picture after another.

use super::frame::Frame;
use super::gpu_types::{GpuBlock, GpuFrame, GpuPoint};
use super::pack::{Page, for_each_page};
use super::passes::{COLOR_FORMAT, DEPTH_FORMAT, Passes};
use super::{Image, RenderError, RenderOptions, Scene};
use crate::geometry::Camera;

/// Points uploaded at once: 64 MiB, half of what software Vulkan binds.
const PAGE_POINTS: usize = 1 << 22;
const PAGE_BLOCKS: usize = 1 << 16;
/// Bytes of the image copied back at once.
const STRIP_BYTES: u64 = 64 << 20;

/// Draws scenes on a graphics adapter, without a window.
///
/// The memory that it takes on the adapter is bounded by the image, not by the scene: points go there page by page.
pub struct Renderer {
    device: wgpu::Device,
    queue: wgpu::Queue,
    passes: Passes,
    adapter: String,
    limits: wgpu::Limits,
}

impl std::fmt::Debug for Renderer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Renderer").field("adapter", &self.adapter).finish_non_exhaustive()
    }
}

impl Renderer {
    /// A renderer on the machine's fastest adapter: a graphics card if there is one, else software.
    ///
    /// # Errors
    ///
    /// [`RenderError::NoAdapter`] if there is none at all; [`RenderError::Device`] if it can't be used.
    pub fn new() -> Result<Self, RenderError> {
        let instance = wgpu::Instance::default();
        let adapter = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            ..Default::default()
        }))
        .map_err(RenderError::NoAdapter)?;
        let info = adapter.get_info();
        let name = format!("{} ({:?}, {:?})", info.name, info.backend, info.device_type);
        let failed = |reason: String| RenderError::Device { adapter: name.clone(), reason };
        let limits = adapter.limits();
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("esker"),
            required_limits: limits.clone(),
            memory_hints: wgpu::MemoryHints::MemoryUsage,
            ..Default::default()
        }))
        .map_err(|e| failed(e.to_string()))?;
        let scope = device.push_error_scope(wgpu::ErrorFilter::Validation);
        let passes = Passes::new(&device);
        if let Some(error) = pollster::block_on(scope.pop()) {
            return Err(failed(error.to_string()));
        }
        Ok(Self { device, queue, passes, adapter: name, limits })
    }

    /// The adapter's name, with its interface and kind: `llvmpipe (LLVM 15.0.6, 256 bits) (Vulkan, Cpu)`.
    pub fn adapter_name(&self) -> &str {
        &self.adapter
    }

    /// The most pixels on a side of an image.
    pub fn max_size_px(&self) -> u32 {
        self.limits.max_texture_dimension_2d
    }

    /// The image of `scene` in the camera's size. The same input gives the same bytes on the same adapter; another
    /// adapter may decide otherwise on the edges of splats.
    ///
    /// # Errors
    ///
    /// [`RenderError::Size`] above [`Renderer::max_size_px`]; [`RenderError::ColorCount`] and [`RenderError::Number`]
    /// for what can't be drawn; [`RenderError::Device`] if the adapter runs out of memory or fails.
    pub fn render(&self, scene: &Scene, camera: &Camera, options: &RenderOptions) -> Result<Image, RenderError> {
        let frame = Frame::new(scene, camera, options, self.max_size_px())?;
        let scopes = [wgpu::ErrorFilter::Validation, wgpu::ErrorFilter::OutOfMemory, wgpu::ErrorFilter::Internal]
            .map(|filter| self.device.push_error_scope(filter));
        let image = self.draw(scene, &frame, options);
        // The last pushed first. What the adapter says is the cause of what the drawing noticed.
        let mut error = None;
        for scope in scopes.into_iter().rev() {
            error = pollster::block_on(scope.pop()).or(error);
        }
        match error {
            Some(error) => Err(self.failed(error)),
            None => image,
        }
    }

    fn failed(&self, reason: impl std::fmt::Display) -> RenderError {
        RenderError::Device { adapter: self.adapter.clone(), reason: reason.to_string() }
    }

    fn draw(&self, scene: &Scene, frame: &Frame, options: &RenderOptions) -> Result<Image, RenderError> {
        let gpu_frame = GpuFrame::new(frame, scene.lattice.quantum_f64(), options);
        let frame_buffer = self.buffer("frame", size_of::<GpuFrame>(), wgpu::BufferUsages::UNIFORM);
        self.queue.write_buffer(&frame_buffer, 0, bytemuck::bytes_of(&gpu_frame));
        let frame_group = self.bind("frame", &self.passes.frame_layout, &[frame_buffer.as_entire_binding()]);

        let attached = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING;
        let colors = self.target("colors", frame.size_px, COLOR_FORMAT, attached);
        let depths = self.target("depths", frame.size_px, DEPTH_FORMAT, attached);
        self.draw_points(scene, frame, options.radius_factor, &frame_group, [&colors.1, &depths.1])?;

        let copied = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC;
        let shaded = self.target("shaded", frame.size_px, COLOR_FORMAT, copied);
        let inputs = [&colors.1, &depths.1].map(wgpu::BindingResource::TextureView);
        let shade_group = self.bind("shade", &self.passes.shade_layout, &inputs);
        let mut encoder = self.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("shade"),
                color_attachments: &[Some(attachment(&shaded.1, true))],
                ..Default::default()
            });
            pass.set_pipeline(&self.passes.shade);
            pass.set_bind_group(0, &frame_group, &[]);
            pass.set_bind_group(1, &shade_group, &[]);
            pass.draw(0..3, 0..1);
        }
        self.queue.submit([encoder.finish()]);
        self.read_back(&shaded.0, frame.size_px)
    }

    /// Clears the targets and draws the scene, page by page in order.
    fn draw_points(
        &self,
        scene: &Scene,
        frame: &Frame,
        radius_factor: f64,
        frame_group: &wgpu::BindGroup,
        [colors, depths]: [&wgpu::TextureView; 2],
    ) -> Result<(), RenderError> {
        let binding_bytes = self.limits.max_storage_buffer_binding_size.min(self.limits.max_buffer_size);
        let most_points = usize::try_from(binding_bytes).unwrap_or(usize::MAX) / size_of::<GpuPoint>();
        let page_points = scene.len().clamp(1, PAGE_POINTS.min(most_points.max(1)));
        let points = self.buffer("points", page_points * size_of::<GpuPoint>(), wgpu::BufferUsages::STORAGE);
        let blocks = self.buffer("blocks", PAGE_BLOCKS * size_of::<GpuBlock>(), wgpu::BufferUsages::STORAGE);
        let buffers = [points.as_entire_binding(), blocks.as_entire_binding()];
        let points_group = self.bind("points", &self.passes.points_layout, &buffers);

        let mut first = true;
        let mut draw_page = |page: &Page| {
            self.queue.write_buffer(&points, 0, bytemuck::cast_slice(&page.points));
            self.queue.write_buffer(&blocks, 0, bytemuck::cast_slice(&page.blocks));
            let mut encoder = self.device.create_command_encoder(&Default::default());
            {
                // 0 is infinitely far.
                let load = if first { wgpu::LoadOp::Clear(0.0) } else { wgpu::LoadOp::Load };
                let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                    label: Some("points"),
                    color_attachments: &[Some(attachment(colors, first))],
                    depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                        view: depths,
                        depth_ops: Some(wgpu::Operations { load, store: wgpu::StoreOp::Store }),
                        stencil_ops: None,
                    }),
                    ..Default::default()
                });
                pass.set_pipeline(&self.passes.points);
                pass.set_bind_group(0, frame_group, &[]);
                pass.set_bind_group(1, &points_group, &[]);
                let mut start = 0;
                for (&count, block) in page.counts.iter().zip(0..) {
                    pass.draw(3 * start..3 * (start + count), block..block + 1);
                    start += count;
                }
            }
            first = false;
            self.queue.submit([encoder.finish()]);
            // The page's staging memory is free before the next one is filled.
            self.wait()
        };
        // The first page clears; a scene without points has none.
        draw_page(&Page::default())?;
        for_each_page(scene, frame, radius_factor, page_points, PAGE_BLOCKS, draw_page)
    }

    /// The image's bytes, in strips of whole rows.
    fn read_back(&self, texture: &wgpu::Texture, [width, height]: [u32; 2]) -> Result<Image, RenderError> {
        let row_bytes = width * 4;
        let padded_bytes = row_bytes.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let strip_rows = (STRIP_BYTES / u64::from(padded_bytes)).clamp(1, u64::from(height)) as u32;
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("strip"),
            size: u64::from(padded_bytes) * u64::from(strip_rows),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let mut rgba = Vec::with_capacity(row_bytes as usize * height as usize);
        let mut top = 0;
        while top < height {
            let rows = strip_rows.min(height - top);
            let mut encoder = self.device.create_command_encoder(&Default::default());
            let mut source = texture.as_image_copy();
            source.origin.y = top;
            let layout =
                wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(padded_bytes), rows_per_image: None };
            let target = wgpu::TexelCopyBufferInfo { buffer: &buffer, layout };
            encoder.copy_texture_to_buffer(
                source,
                target,
                wgpu::Extent3d { width, height: rows, depth_or_array_layers: 1 },
            );
            self.queue.submit([encoder.finish()]);
            let (sender, receiver) = std::sync::mpsc::channel();
            buffer.map_async(wgpu::MapMode::Read, .., move |result| {
                // The receiver lives until the result is there.
                let _ = sender.send(result);
            });
            self.wait()?;
            receiver.recv().map_err(|e| self.failed(e))?.map_err(|e| self.failed(e))?;
            let bytes = buffer.get_mapped_range(..).map_err(|e| self.failed(e))?;
            for row in bytes.chunks_exact(padded_bytes as usize).take(rows as usize) {
                rgba.extend_from_slice(&row[..row_bytes as usize]);
            }
            drop(bytes);
            buffer.unmap();
            top += rows;
        }
        Ok(Image { width, height, rgba })
    }

    fn wait(&self) -> Result<(), RenderError> {
        self.device.poll(wgpu::PollType::wait_indefinitely()).map(|_| ()).map_err(|e| self.failed(e))
    }

    fn buffer(&self, label: &str, bytes: usize, usage: wgpu::BufferUsages) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes as u64,
            usage: usage | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        })
    }

    fn bind(
        &self,
        label: &str,
        layout: &wgpu::BindGroupLayout,
        resources: &[wgpu::BindingResource<'_>],
    ) -> wgpu::BindGroup {
        let entries: Vec<_> = (0..)
            .zip(resources)
            .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource: resource.clone() })
            .collect();
        self.device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some(label), layout, entries: &entries })
    }

    fn target(
        &self,
        label: &str,
        [width, height]: [u32; 2],
        format: wgpu::TextureFormat,
        usage: wgpu::TextureUsages,
    ) -> (wgpu::Texture, wgpu::TextureView) {
        let texture = self.device.create_texture(&wgpu::TextureDescriptor {
            label: Some(label),
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage,
            view_formats: &[],
        });
        let view = texture.create_view(&Default::default());
        (texture, view)
    }
}

fn attachment(view: &wgpu::TextureView, clear: bool) -> wgpu::RenderPassColorAttachment<'_> {
    let load = if clear { wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT) } else { wgpu::LoadOp::Load };
    let ops = wgpu::Operations { load, store: wgpu::StoreOp::Store };
    wgpu::RenderPassColorAttachment { view, depth_slice: None, resolve_target: None, ops }
}

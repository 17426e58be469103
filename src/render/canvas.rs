//! What a picture is drawn on: targets of one size, and the buffers of a frame, which are used again by the next.

use super::gpu_types::{GpuBlock, GpuFrame, GpuLine, GpuNode};
use super::passes::{COLOR_FORMAT, DEPTH_FORMAT, ID_FORMAT, Passes, PointsVariant};
use super::pick::PickTable;

/// Targets and buffers for one picture after another. A window keeps one; it follows the size of the camera's image.
pub struct Canvas {
    device: wgpu::Device,
    queue: wgpu::Queue,
    with_ids: bool,
    targets: Option<Targets>,
    frame: wgpu::Buffer,
    palette: Growing,
    blocks: Growing,
    nodes: Growing,
    lines: Growing,
    frame_group: Option<wgpu::BindGroup>,
    /// Who is who in the id target of the last frame.
    pub(super) picks: PickTable,
}

impl std::fmt::Debug for Canvas {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Canvas").field("size_px", &self.size_px()).finish_non_exhaustive()
    }
}

/// Images that the passes draw into and read from.
struct Targets {
    size_px: [u32; 2],
    colors: wgpu::TextureView,
    depths: wgpu::TextureView,
    ids: Option<(wgpu::Texture, wgpu::TextureView)>,
    shade_group: wgpu::BindGroup,
}

/// What all passes of a frame read.
pub(super) struct FrameData<'a> {
    pub frame: &'a GpuFrame,
    pub palette: &'a [[u8; 4]],
    pub blocks: &'a [GpuBlock],
    pub nodes: &'a [GpuNode],
}

/// Consecutive points of a buffer that have the same entry of the frame's blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Draw {
    /// Which of the buffers.
    pub slab: usize,
    pub first_point: u32,
    pub points: u32,
}

impl Canvas {
    pub(super) fn new(device: &wgpu::Device, queue: &wgpu::Queue, with_ids: bool) -> Self {
        let storage = |label| Growing::new(device, label, wgpu::BufferUsages::STORAGE);
        Self {
            device: device.clone(),
            queue: queue.clone(),
            with_ids,
            targets: None,
            frame: device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("frame"),
                size: size_of::<GpuFrame>() as u64,
                usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            }),
            palette: storage("palette"),
            blocks: storage("blocks"),
            nodes: storage("nodes"),
            lines: storage("lines"),
            frame_group: None,
            picks: PickTable::default(),
        }
    }

    /// The size of the targets; `None` before the first picture.
    pub fn size_px(&self) -> Option<[u32; 2]> {
        self.targets.as_ref().map(|targets| targets.size_px)
    }

    pub(super) fn ids(&self) -> Option<&wgpu::Texture> {
        self.targets.as_ref()?.ids.as_ref().map(|(texture, _)| texture)
    }

    /// Gives the targets this size.
    pub(super) fn fit(&mut self, passes: &Passes, size_px: [u32; 2]) {
        if self.size_px() == Some(size_px) {
            return;
        }
        // The old ones first: two sets of a large image are not needed at once.
        self.targets = None;
        let attached = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING;
        let (_, colors) = texture(&self.device, "colors", size_px, COLOR_FORMAT, attached);
        let (_, depths) = texture(&self.device, "depths", size_px, DEPTH_FORMAT, attached);
        let ids = self.with_ids.then(|| {
            let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC;
            texture(&self.device, "ids", size_px, ID_FORMAT, usage)
        });
        let inputs = [&colors, &depths].map(wgpu::BindingResource::TextureView);
        let shade_group = bind(&self.device, "shade", &passes.shade_layout, &inputs);
        self.targets = Some(Targets { size_px, colors, depths, ids, shade_group });
    }

    /// Hands the frame's data to the queue, for what is submitted next.
    pub(super) fn upload(&mut self, passes: &Passes, data: &FrameData) {
        self.queue.write_buffer(&self.frame, 0, bytemuck::bytes_of(data.frame));
        let changed = [
            self.palette.write(&self.device, &self.queue, bytemuck::cast_slice(data.palette)),
            self.blocks.write(&self.device, &self.queue, bytemuck::cast_slice(data.blocks)),
            self.nodes.write(&self.device, &self.queue, bytemuck::cast_slice(data.nodes)),
        ];
        if self.frame_group.is_none() || changed.contains(&true) {
            let buffers = [&self.frame, &self.palette.buffer, &self.blocks.buffer, &self.nodes.buffer];
            let resources = buffers.map(wgpu::Buffer::as_entire_binding);
            self.frame_group = Some(bind(&self.device, "frame", &passes.frame_layout, &resources));
        }
    }

    /// Draws points, one draw for each block of the frame; `clear`: on empty targets. Needs [`Canvas::fit`] and
    /// [`Canvas::upload`] before.
    pub(super) fn points(
        &self,
        passes: &Passes,
        encoder: &mut wgpu::CommandEncoder,
        clear: bool,
        deep: bool,
        draws: &[Draw],
        slabs: &[&wgpu::BindGroup],
    ) {
        let variant = PointsVariant { deep, ids: self.with_ids };
        let Some(mut pass) = self.scene_pass(encoder, "points", clear) else { return };
        pass.set_pipeline(passes.points(variant));
        pass.set_bind_group(0, &self.frame_group, &[]);
        let mut bound = None;
        for (draw, block) in draws.iter().zip(0..) {
            let Some(&slab) = slabs.get(draw.slab) else { continue };
            if bound != Some(draw.slab) {
                pass.set_bind_group(1, slab, &[]);
                bound = Some(draw.slab);
            }
            let end = draw.first_point + draw.points;
            pass.draw(3 * draw.first_point..3 * end, block..block + 1);
        }
    }

    /// Draws lines over what is there.
    pub(super) fn lines(&mut self, passes: &Passes, encoder: &mut wgpu::CommandEncoder, lines: &[GpuLine]) {
        if lines.is_empty() {
            return;
        }
        self.lines.write(&self.device, &self.queue, bytemuck::cast_slice(lines));
        let group = bind(&self.device, "lines", &passes.lines_layout, &[self.lines.buffer.as_entire_binding()]);
        let Some(mut pass) = self.scene_pass(encoder, "lines", false) else { return };
        pass.set_pipeline(passes.lines(self.with_ids));
        pass.set_bind_group(0, &self.frame_group, &[]);
        pass.set_bind_group(1, &group, &[]);
        pass.draw(0..6 * lines.len() as u32, 0..1);
    }

    /// Shades what was drawn, into `output`.
    pub(super) fn shade(&self, passes: &Passes, encoder: &mut wgpu::CommandEncoder, output: &wgpu::TextureView) {
        let Some(targets) = &self.targets else { return };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shade"),
            color_attachments: &[Some(attachment(output, true))],
            ..Default::default()
        });
        pass.set_pipeline(passes.shade());
        pass.set_bind_group(0, &self.frame_group, &[]);
        pass.set_bind_group(1, &targets.shade_group, &[]);
        pass.draw(0..3, 0..1);
    }

    fn scene_pass<'e>(
        &self,
        encoder: &'e mut wgpu::CommandEncoder,
        label: &str,
        clear: bool,
    ) -> Option<wgpu::RenderPass<'e>> {
        let targets = self.targets.as_ref()?;
        // 0 is infinitely far, and nobody's id.
        let load = if clear { wgpu::LoadOp::Clear(0.0) } else { wgpu::LoadOp::Load };
        let mut colors = vec![Some(attachment(&targets.colors, clear))];
        colors.extend(targets.ids.iter().map(|(_, view)| Some(attachment(view, clear))));
        Some(encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some(label),
            color_attachments: &colors,
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &targets.depths,
                depth_ops: Some(wgpu::Operations { load, store: wgpu::StoreOp::Store }),
                stencil_ops: None,
            }),
            ..Default::default()
        }))
    }
}

/// A buffer that is replaced by a larger one when it is too small.
struct Growing {
    label: &'static str,
    usage: wgpu::BufferUsages,
    buffer: wgpu::Buffer,
}

impl Growing {
    fn new(device: &wgpu::Device, label: &'static str, usage: wgpu::BufferUsages) -> Self {
        let usage = usage | wgpu::BufferUsages::COPY_DST;
        Self { label, usage, buffer: Self::sized(device, label, usage, 256) }
    }

    fn sized(device: &wgpu::Device, label: &str, usage: wgpu::BufferUsages, size: u64) -> wgpu::Buffer {
        device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false })
    }

    /// Is the buffer another one now?
    fn write(&mut self, device: &wgpu::Device, queue: &wgpu::Queue, bytes: &[u8]) -> bool {
        let grows = bytes.len() as u64 > self.buffer.size();
        if grows {
            self.buffer = Self::sized(device, self.label, self.usage, (bytes.len() as u64).next_power_of_two());
        }
        if !bytes.is_empty() {
            queue.write_buffer(&self.buffer, 0, bytes);
        }
        grows
    }
}

pub(super) fn texture(
    device: &wgpu::Device,
    label: &str,
    [width, height]: [u32; 2],
    format: wgpu::TextureFormat,
    usage: wgpu::TextureUsages,
) -> (wgpu::Texture, wgpu::TextureView) {
    let texture = device.create_texture(&wgpu::TextureDescriptor {
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

pub(super) fn bind(
    device: &wgpu::Device,
    label: &str,
    layout: &wgpu::BindGroupLayout,
    resources: &[wgpu::BindingResource<'_>],
) -> wgpu::BindGroup {
    let entries: Vec<_> = (0..)
        .zip(resources)
        .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource: resource.clone() })
        .collect();
    device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some(label), layout, entries: &entries })
}

fn attachment(view: &wgpu::TextureView, clear: bool) -> wgpu::RenderPassColorAttachment<'_> {
    let load = if clear { wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT) } else { wgpu::LoadOp::Load };
    let ops = wgpu::Operations { load, store: wgpu::StoreOp::Store };
    wgpu::RenderPassColorAttachment { view, depth_slice: None, resolve_target: None, ops }
}

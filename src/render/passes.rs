//! The passes as pipelines: points, lines, then shading. A pipeline is made when it is first wanted.

use super::gpu_types::{GpuBlock, GpuFrame, GpuLine, GpuNode};
use crate::stream::gpu::PackedPoint;
use std::sync::OnceLock;

/// Shared by all passes; prepended because WGSL has no includes.
macro_rules! shader {
    ($name:literal) => {
        concat!(include_str!("../../shaders/frame.wgsl"), include_str!(concat!("../../shaders/", $name)))
    };
}

pub(super) const POINTS_WGSL: &str = shader!("points.wgsl");
pub(super) const LINES_WGSL: &str = shader!("lines.wgsl");
pub(super) const SHADE_WGSL: &str = shader!("shade.wgsl");

/// Bytes as they are: colours are sRGB-coded by what writes them, not by the target.
pub(super) const COLOR_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
pub(super) const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
pub(super) const ID_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;

/// Which of the point passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PointsVariant {
    /// Splats have a relief or a shadow: the fragment decides the depth.
    pub deep: bool,
    /// There is an id target.
    pub ids: bool,
}

/// Pipelines and the layouts of their bind groups: group 0 is the frame, group 1 what a pass reads.
pub(super) struct Passes {
    pub frame_layout: wgpu::BindGroupLayout,
    pub points_layout: wgpu::BindGroupLayout,
    pub lines_layout: wgpu::BindGroupLayout,
    pub shade_layout: wgpu::BindGroupLayout,
    device: wgpu::Device,
    output: wgpu::TextureFormat,
    points_module: OnceLock<wgpu::ShaderModule>,
    points: [OnceLock<wgpu::RenderPipeline>; 4],
    lines: [OnceLock<wgpu::RenderPipeline>; 2],
    shade: OnceLock<wgpu::RenderPipeline>,
}

impl Passes {
    /// The passes of a device that end in a target of format `output`.
    pub fn new(device: &wgpu::Device, output: wgpu::TextureFormat) -> Self {
        let uniform = wgpu::BufferBindingType::Uniform;
        let storage = wgpu::BufferBindingType::Storage { read_only: true };
        let both = wgpu::ShaderStages::VERTEX_FRAGMENT;
        let vertex = wgpu::ShaderStages::VERTEX;
        let frame = [
            buffer_entry(0, both, uniform, size_of::<GpuFrame>()),
            buffer_entry(1, vertex, storage, size_of::<u32>()),
            buffer_entry(2, vertex, storage, size_of::<GpuBlock>()),
            buffer_entry(3, vertex, storage, size_of::<GpuNode>()),
        ];
        let shade = [
            texture_entry(0, wgpu::TextureSampleType::Float { filterable: false }),
            texture_entry(1, wgpu::TextureSampleType::Depth),
        ];
        let layout = |label, entries: &[_]| {
            device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries })
        };
        Self {
            frame_layout: layout("frame", &frame),
            points_layout: layout("points", &[buffer_entry(0, vertex, storage, size_of::<PackedPoint>())]),
            lines_layout: layout("lines", &[buffer_entry(0, both, storage, size_of::<GpuLine>())]),
            shade_layout: layout("shade", &shade),
            device: device.clone(),
            output,
            points_module: OnceLock::new(),
            points: Default::default(),
            lines: Default::default(),
            shade: OnceLock::new(),
        }
    }

    /// The format that pictures end in.
    pub fn output(&self) -> wgpu::TextureFormat {
        self.output
    }

    pub fn points(&self, variant: PointsVariant) -> &wgpu::RenderPipeline {
        let place = usize::from(variant.deep) << 1 | usize::from(variant.ids);
        self.points[place].get_or_init(|| {
            let module = self.points_module.get_or_init(|| self.module("points", POINTS_WGSL));
            let entry = if variant.deep { "fragment_deep" } else { "fragment" };
            let layouts = [&self.frame_layout, &self.points_layout];
            self.pipeline("points", module, entry, &layouts, &targets(variant.ids), Some(DEPTH))
        })
    }

    pub fn lines(&self, ids: bool) -> &wgpu::RenderPipeline {
        self.lines[usize::from(ids)].get_or_init(|| {
            let module = self.module("lines", LINES_WGSL);
            let layouts = [&self.frame_layout, &self.lines_layout];
            self.pipeline("lines", &module, "fragment", &layouts, &targets(ids), Some(DEPTH))
        })
    }

    pub fn shade(&self) -> &wgpu::RenderPipeline {
        self.shade.get_or_init(|| {
            let module = self.module("shade", SHADE_WGSL);
            let entry = if self.output.is_srgb() { "fragment_linear" } else { "fragment" };
            let layouts = [&self.frame_layout, &self.shade_layout];
            self.pipeline("shade", &module, entry, &layouts, &[target(self.output)], None)
        })
    }

    fn module(&self, label: &str, wgsl: &'static str) -> wgpu::ShaderModule {
        let source = wgpu::ShaderSource::Wgsl(wgsl.into());
        self.device.create_shader_module(wgpu::ShaderModuleDescriptor { label: Some(label), source })
    }

    fn pipeline(
        &self,
        label: &str,
        module: &wgpu::ShaderModule,
        fragment: &str,
        layouts: &[&wgpu::BindGroupLayout],
        targets: &[Option<wgpu::ColorTargetState>],
        depth_stencil: Option<wgpu::DepthStencilState>,
    ) -> wgpu::RenderPipeline {
        let bind_group_layouts: Vec<_> = layouts.iter().map(|&layout| Some(layout)).collect();
        let layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(label),
            bind_group_layouts: &bind_group_layouts,
            immediate_size: 0,
        });
        self.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(label),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module,
                entry_point: Some("vertex"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil,
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module,
                entry_point: Some(fragment),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets,
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}

/// Greater: reversed depth, and of equals the first drawn stays.
const DEPTH: wgpu::DepthStencilState = wgpu::DepthStencilState {
    format: DEPTH_FORMAT,
    depth_write_enabled: Some(true),
    depth_compare: Some(wgpu::CompareFunction::Greater),
    stencil: wgpu::StencilState {
        front: wgpu::StencilFaceState::IGNORE,
        back: wgpu::StencilFaceState::IGNORE,
        read_mask: 0,
        write_mask: 0,
    },
    bias: wgpu::DepthBiasState { constant: 0, slope_scale: 0.0, clamp: 0.0 },
};

fn target(format: wgpu::TextureFormat) -> Option<wgpu::ColorTargetState> {
    Some(wgpu::ColorTargetState { format, blend: None, write_mask: wgpu::ColorWrites::ALL })
}

/// Colours, and ids where they are wanted: without the target the shader's ids go nowhere.
fn targets(ids: bool) -> Vec<Option<wgpu::ColorTargetState>> {
    let mut targets = vec![target(COLOR_FORMAT)];
    if ids {
        targets.push(target(ID_FORMAT));
    }
    targets
}

fn buffer_entry(
    binding: u32,
    visibility: wgpu::ShaderStages,
    ty: wgpu::BufferBindingType,
    least_bytes: usize,
) -> wgpu::BindGroupLayoutEntry {
    let min_binding_size = std::num::NonZeroU64::new(least_bytes as u64);
    let ty = wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size };
    wgpu::BindGroupLayoutEntry { binding, visibility, ty, count: None }
}

fn texture_entry(binding: u32, sample_type: wgpu::TextureSampleType) -> wgpu::BindGroupLayoutEntry {
    let ty =
        wgpu::BindingType::Texture { sample_type, view_dimension: wgpu::TextureViewDimension::D2, multisampled: false };
    wgpu::BindGroupLayoutEntry { binding, visibility: wgpu::ShaderStages::FRAGMENT, ty, count: None }
}

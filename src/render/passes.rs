//! The two passes as pipelines: points, then shading.

use super::gpu_types::{GpuBlock, GpuFrame, GpuPoint};

/// Shared by all passes; prepended because WGSL has no includes.
macro_rules! shader {
    ($name:literal) => {
        concat!(include_str!("../../shaders/frame.wgsl"), include_str!(concat!("../../shaders/", $name)))
    };
}

pub(super) const POINTS_WGSL: &str = shader!("points.wgsl");
pub(super) const SHADE_WGSL: &str = shader!("shade.wgsl");

/// Bytes as they are: colours are sRGB-coded by what writes them, not by the target.
pub(super) const COLOR_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
pub(super) const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// Pipelines and the layouts of their bind groups: group 0 is the frame, group 1 what a pass reads.
pub(super) struct Passes {
    pub frame_layout: wgpu::BindGroupLayout,
    pub points_layout: wgpu::BindGroupLayout,
    pub shade_layout: wgpu::BindGroupLayout,
    pub points: wgpu::RenderPipeline,
    pub shade: wgpu::RenderPipeline,
}

impl Passes {
    pub fn new(device: &wgpu::Device) -> Self {
        let uniform = wgpu::BufferBindingType::Uniform;
        let storage = wgpu::BufferBindingType::Storage { read_only: true };
        let frame_stages = wgpu::ShaderStages::VERTEX_FRAGMENT;
        let frame_layout =
            bind_group_layout(device, "frame", &[buffer_entry(0, frame_stages, uniform, size_of::<GpuFrame>())]);
        let vertex = wgpu::ShaderStages::VERTEX;
        let points_layout = bind_group_layout(
            device,
            "points",
            &[
                buffer_entry(0, vertex, storage, size_of::<GpuPoint>()),
                buffer_entry(1, vertex, storage, size_of::<GpuBlock>()),
            ],
        );
        let shade_layout = bind_group_layout(
            device,
            "shade",
            &[
                texture_entry(0, wgpu::TextureSampleType::Float { filterable: false }),
                texture_entry(1, wgpu::TextureSampleType::Depth),
            ],
        );
        // Greater: reversed depth, and of equals the first drawn stays.
        let depth = wgpu::DepthStencilState {
            format: DEPTH_FORMAT,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Greater),
            stencil: wgpu::StencilState::default(),
            bias: wgpu::DepthBiasState::default(),
        };
        let points = pipeline(device, "points", POINTS_WGSL, &[&frame_layout, &points_layout], Some(depth));
        let shade = pipeline(device, "shade", SHADE_WGSL, &[&frame_layout, &shade_layout], None);
        Self { frame_layout, points_layout, shade_layout, points, shade }
    }
}

fn bind_group_layout(
    device: &wgpu::Device,
    label: &str,
    entries: &[wgpu::BindGroupLayoutEntry],
) -> wgpu::BindGroupLayout {
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries })
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

fn pipeline(
    device: &wgpu::Device,
    label: &str,
    wgsl: &'static str,
    layouts: &[&wgpu::BindGroupLayout],
    depth_stencil: Option<wgpu::DepthStencilState>,
) -> wgpu::RenderPipeline {
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(label),
        source: wgpu::ShaderSource::Wgsl(wgsl.into()),
    });
    let bind_group_layouts: Vec<_> = layouts.iter().map(|&layout| Some(layout)).collect();
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(label),
        bind_group_layouts: &bind_group_layouts,
        immediate_size: 0,
    });
    let target = wgpu::ColorTargetState { format: COLOR_FORMAT, blend: None, write_mask: wgpu::ColorWrites::ALL };
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(label),
        layout: Some(&layout),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("vertex"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil,
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("fragment"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[Some(target)],
        }),
        multiview_mask: None,
        cache: None,
    })
}

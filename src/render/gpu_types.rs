//! The bytes that go to the graphics adapter: twins of the structs in `shaders/`.

use super::RenderOptions;
use super::frame::Frame;
use bytemuck::{Pod, Zeroable};

/// `Frame` in `frame.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(super) struct GpuFrame {
    pub view_from_steps: [[f32; 4]; 3],
    pub image_px: [f32; 2],
    pub focal_px: f32,
    pub perspective: u32,
    pub front_depth: f32,
    pub depth_scale: f32,
    pub nearest_past_front: f32,
    pub farthest_past_front: f32,
    pub min_radius_px: f32,
    pub max_radius_px: f32,
    pub edl_strength: f32,
    pub edl_radius_px: f32,
    pub pad_0: u32,
    pub pad_1: u32,
    pub pad_2: u32,
    pub pad_3: u32,
    pub background_top: [f32; 4],
    pub background_bottom: [f32; 4],
}

/// `Point` in `points.wgsl`: 16 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub(super) struct GpuPoint {
    pub steps_x: u32,
    pub steps_y: u32,
    pub steps_z: u32,
    pub color: [u8; 4],
}

/// `Block` in `points.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(super) struct GpuBlock {
    pub anchor_steps: [u32; 3],
    pub radius: f32,
    pub anchor_view: [f32; 3],
    pub pad_0: u32,
}

const _: () = assert!(size_of::<GpuFrame>() == 144 && size_of::<GpuPoint>() == 16 && size_of::<GpuBlock>() == 32);

impl GpuFrame {
    pub fn new(frame: &Frame, quantum: [f64; 3], options: &RenderOptions) -> Self {
        let row = |i: usize| {
            let row = frame.view_from_relative.row(i).to_array();
            [(row[0] * quantum[0]) as f32, (row[1] * quantum[1]) as f32, (row[2] * quantum[2]) as f32, 0.0]
        };
        let [background_top, background_bottom] = options.background.ends();
        Self {
            view_from_steps: [row(0), row(1), row(2)],
            image_px: frame.size_px.map(|side| side as f32),
            focal_px: frame.focal_px as f32,
            perspective: u32::from(frame.perspective),
            front_depth: frame.front as f32,
            depth_scale: frame.depth_scale as f32,
            nearest_past_front: (frame.near - frame.front) as f32,
            farthest_past_front: frame.far.map_or(f32::MAX, |far| (far - frame.front) as f32),
            min_radius_px: frame.min_radius_px as f32,
            max_radius_px: frame.max_radius_px as f32,
            edl_strength: frame.edl_strength,
            edl_radius_px: frame.edl_radius_px,
            pad_0: 0,
            pad_1: 0,
            pad_2: 0,
            pad_3: 0,
            background_top,
            background_bottom,
        }
    }
}

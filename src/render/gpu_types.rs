//! The bytes that go to the graphics adapter: twins of the structs in `shaders/`.

use super::color::Palette;
use super::frame::Frame;
use super::{MAX_CLIPS, RenderOptions, Shape};
use bytemuck::{Pod, Zeroable};

/// `ClipBox` in `frame.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
pub(super) struct GpuClipBox {
    pub unit_from_view: [[f32; 4]; 3],
}

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
    pub shape: u32,
    pub shadow_px: f32,
    pub fog_half: f32,
    pub fog_start: f32,
    pub values: u32,
    pub palette_last: u32,
    pub ramp_scale: f32,
    pub ramp_offset: f32,
    pub clips_to_keep: u32,
    pub clips_in_all: u32,
    pub pad_0: u32,
    pub pad_1: u32,
    pub fog_color: [f32; 4],
    pub background_top: [f32; 4],
    pub background_bottom: [f32; 4],
    pub clips: [GpuClipBox; MAX_CLIPS],
}

/// `Block` in `points.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(super) struct GpuBlock {
    pub anchor_steps: [u32; 3],
    pub node: u32,
    pub anchor_view: [f32; 3],
    pub step_scale: f32,
    pub first_point: u32,
    pub first_id: u32,
    pub bits: u32,
    pub level: u32,
}

/// `Node` in `points.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(super) struct GpuNode {
    pub radius: f32,
    pub children: u32,
}

/// `Line` in `lines.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(super) struct GpuLine {
    pub from_px: [f32; 2],
    pub to_px: [f32; 2],
    pub from_depth: f32,
    pub to_depth: f32,
    pub color: u32,
    pub pad_0: u32,
}

const _: () = assert!(size_of::<GpuFrame>() == 192 + MAX_CLIPS * 48 && size_of::<GpuBlock>() == 48);

fn coded([red, green, blue]: [u8; 3]) -> [f32; 4] {
    [f32::from(red) / 255.0, f32::from(green) / 255.0, f32::from(blue) / 255.0, 1.0]
}

impl GpuFrame {
    pub fn new(frame: &Frame, quantum: [f64; 3], options: &RenderOptions, palette: &Palette) -> Self {
        let row = |i: usize| {
            let row = frame.view_from_relative.row(i).to_array();
            [(row[0] * quantum[0]) as f32, (row[1] * quantum[1]) as f32, (row[2] * quantum[2]) as f32, 0.0]
        };
        let [background_top, background_bottom] = options.background.ends();
        let mut clips = [GpuClipBox::default(); MAX_CLIPS];
        for (clip, gpu) in frame.clips.iter().zip(&mut clips) {
            for (i, row) in gpu.unit_from_view.iter_mut().enumerate() {
                let direction = clip.unit_from_view.row(i);
                // The shader's view coordinates begin at the front.
                let offset = clip.offset[i] + direction.z * frame.front;
                *row = [direction.x as f32, direction.y as f32, direction.z as f32, offset as f32];
            }
        }
        let (ramp_scale, ramp_offset) = palette.ramp_of();
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
            shape: match options.shape {
                Shape::Round => 0,
                Shape::Square => 1,
                Shape::Paraboloid => 2,
            },
            shadow_px: options.shadow_px as f32,
            fog_half: options.fog.map_or(0.0, |fog| fog.half as f32),
            fog_start: options.fog.map_or(0.0, |fog| fog.start as f32),
            values: palette.kind(),
            palette_last: palette.last(),
            ramp_scale,
            ramp_offset,
            clips_to_keep: frame.clips.iter().filter(|clip| clip.keep).count() as u32,
            clips_in_all: frame.clips.len() as u32,
            pad_0: 0,
            pad_1: 0,
            fog_color: options.fog.and_then(|fog| fog.color).map_or([0.0; 4], coded),
            background_top,
            background_bottom,
            clips,
        }
    }
}

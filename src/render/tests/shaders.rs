//! WGSL without an adapter: it is valid, and its structs are ours.

use crate::render::gpu_types::{GpuBlock, GpuClipBox, GpuFrame, GpuLine, GpuNode};
use crate::render::passes::{LINES_WGSL, POINTS_WGSL, SHADE_WGSL};
use crate::stream::gpu::PackedPoint;
use std::mem::offset_of;
use wgpu::naga;

fn module(wgsl: &str) -> naga::Module {
    let module = naga::front::wgsl::parse_str(wgsl).unwrap_or_else(|e| panic!("{}", e.emit_to_string(wgsl)));
    let mut validator =
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty());
    validator.validate(&module).unwrap_or_else(|e| panic!("{}", e.emit_to_string(wgsl)));
    module
}

/// Names and offsets of a struct's members, and its size.
fn layout(module: &naga::Module, name: &str) -> (Vec<(String, usize)>, usize) {
    for (_, ty) in module.types.iter() {
        if let naga::TypeInner::Struct { members, span } = &ty.inner
            && ty.name.as_deref() == Some(name)
        {
            let member = |m: &naga::StructMember| (m.name.clone().unwrap(), m.offset as usize);
            return (members.iter().map(member).collect(), *span as usize);
        }
    }
    panic!("no struct {name}");
}

macro_rules! ours {
    ($ty:ty: $($field:ident),*) => {
        (vec![$((stringify!($field).to_owned(), offset_of!($ty, $field))),*], size_of::<$ty>())
    };
}

#[test]
fn shaders_are_valid() {
    for (wgsl, entries) in [(POINTS_WGSL, 3), (LINES_WGSL, 2), (SHADE_WGSL, 3)] {
        assert_eq!(module(wgsl).entry_points.len(), entries);
    }
}

#[test]
fn shared_structs_agree_with_wgsl() {
    let frame = ours!(GpuFrame: view_from_steps, image_px, focal_px, perspective, front_depth, depth_scale,
        nearest_past_front, farthest_past_front, min_radius_px, max_radius_px, edl_strength,
        edl_radius_px, shape, shadow_px, fog_half, fog_start, values, palette_last, ramp_scale, ramp_offset,
        clips_to_keep, clips_in_all, pad_0, pad_1, fog_color, background_top, background_bottom, clips);
    for wgsl in [POINTS_WGSL, LINES_WGSL, SHADE_WGSL] {
        let module = module(wgsl);
        assert_eq!(layout(&module, "Frame"), frame);
        assert_eq!(layout(&module, "ClipBox"), ours!(GpuClipBox: unit_from_view));
    }
    let points = module(POINTS_WGSL);
    // The three steps are one array here.
    let (members, size) = layout(&points, "Point");
    assert_eq!(
        members,
        [("steps_x", 0), ("steps_y", 4), ("steps_z", 8), ("value", 12)].map(|(n, o)| (n.to_owned(), o))
    );
    assert_eq!((offset_of!(PackedPoint, steps), offset_of!(PackedPoint, value), size), (0, 12, 16));
    let block = ours!(GpuBlock: anchor_steps, node, anchor_view, step_scale, first_point, first_id, bits, level);
    assert_eq!(layout(&points, "Block"), block);
    assert_eq!(layout(&points, "Node"), ours!(GpuNode: radius, children));
    let line = ours!(GpuLine: from_px, to_px, from_depth, to_depth, color, pad_0);
    assert_eq!(layout(&module(LINES_WGSL), "Line"), line);
}

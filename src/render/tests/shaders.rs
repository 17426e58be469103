//! WGSL without an adapter: it is valid, and its structs are ours.

use crate::render::gpu_types::{GpuBlock, GpuFrame, GpuPoint};
use crate::render::passes::{POINTS_WGSL, SHADE_WGSL};
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
    for (wgsl, entries) in [(POINTS_WGSL, 2), (SHADE_WGSL, 2)] {
        assert_eq!(module(wgsl).entry_points.len(), entries);
    }
}

#[test]
fn shared_structs_agree_with_wgsl() {
    let frame = ours!(GpuFrame: view_from_steps, image_px, focal_px, perspective, front_depth, depth_scale,
        nearest_past_front, farthest_past_front, min_radius_px, max_radius_px, edl_strength,
        edl_radius_px, pad_0, pad_1, pad_2, pad_3, background_top, background_bottom);
    let points = module(POINTS_WGSL);
    assert_eq!(layout(&points, "Frame"), frame);
    assert_eq!(layout(&module(SHADE_WGSL), "Frame"), frame);
    assert_eq!(layout(&points, "Point"), ours!(GpuPoint: steps_x, steps_y, steps_z, color));
    assert_eq!(layout(&points, "Block"), ours!(GpuBlock: anchor_steps, radius, anchor_view, pad_0));
}

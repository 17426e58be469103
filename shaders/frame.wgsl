// What all passes of one picture share. Prepended to the other files; the test `shared_structs_agree_with_wgsl` compares
// every offset with `gpu_types.rs`.
//
// Spaces: "steps" are steps relative to a block's corner; "view" is in world units, x right, y up, z = depth *past the
// front*: the distance along the line of sight minus `front_depth`, so that a scene 10,000 km away keeps its depth
// differences in f32.

// A point is inside if |row * view + offset| <= 1 for all three rows.
struct ClipBox {
    // The rows in xyz, the offsets in w.
    unit_from_view: array<vec4<f32>, 3>,
}

struct Frame {
    // Rows right, up and forward of the rotation, each axis times the quantum; w is unused.
    view_from_steps: array<vec4<f32>, 3>,
    image_px: vec2<f32>,
    // Pixels that a unit of length takes: at depth 1 in perspective, anywhere in orthographic.
    focal_px: f32,
    // 1 in perspective, 0 in orthographic.
    perspective: u32,
    front_depth: f32,
    // Reversed depth with infinite far: z = depth_scale / (depth_scale + depth past the front).
    depth_scale: f32,
    nearest_past_front: f32,
    farthest_past_front: f32,
    min_radius_px: f32,
    max_radius_px: f32,
    // 0 turns eye-dome lighting off.
    edl_strength: f32,
    edl_radius_px: f32,
    // SHAPE_*.
    shape: u32,
    // 0 turns point shadows off.
    shadow_px: f32,
    // 0 turns fog off; both past the eye, not the front.
    fog_half: f32,
    fog_start: f32,
    // VALUES_*: what the fourth word of a point is.
    values: u32,
    // The last of `palette`.
    palette_last: u32,
    // A ramp's place is value * scale + offset, from 0 to 1.
    ramp_scale: f32,
    ramp_offset: f32,
    // Of `clips`: first those to keep, then those to cut out.
    clips_to_keep: u32,
    clips_in_all: u32,
    pad_0: u32,
    pad_1: u32,
    // w is 1 if the colour counts, 0 for the background's.
    fog_color: vec4<f32>,
    background_top: vec4<f32>,
    background_bottom: vec4<f32>,
    clips: array<ClipBox, 8>,
}

@group(0) @binding(0) var<uniform> frame: Frame;

// Reversed depth of what is `z` past the front.
fn depth_of(z: f32) -> f32 {
    return clamp(frame.depth_scale / (frame.depth_scale + z), 0.0, 1.0);
}

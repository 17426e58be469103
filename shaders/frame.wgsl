// What all passes of one picture share. Prepended to the other files; the test `shared_structs_agree_with_wgsl` compares
// every offset with `gpu_types.rs`.
//
// Spaces: "steps" are lattice steps relative to a block's corner; "view" is in world units, x right, y up, z = depth
// *past the front*: the distance along the line of sight minus `front_depth`, so that a scene 10,000 km away keeps its
// depth differences in f32.

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
    pad_0: u32,
    pad_1: u32,
    pad_2: u32,
    pad_3: u32,
    background_top: vec4<f32>,
    background_bottom: vec4<f32>,
}

@group(0) @binding(0) var<uniform> frame: Frame;

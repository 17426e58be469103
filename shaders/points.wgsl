// One round splat per point: a triangle around the circle, pulled by vertex index, and a fragment test that keeps the
// circle. Twin on the CPU: `reference::draw_points`.
//
// The position is subtracted as integers from the block's anchor (the eye, moved into the block's box), then turned into
// f32: next to the eye the difference is small, so its rounding is too, whatever the coordinates.

struct Point {
    steps_x: u32,
    steps_y: u32,
    steps_z: u32,
    // RGBA8, red in the low byte; the fourth byte is not read.
    color: u32,
}

struct Block {
    // From the block's corner.
    anchor_steps: vec3<u32>,
    // In world units.
    radius: f32,
    anchor_view: vec3<f32>,
    pad_0: u32,
}

@group(1) @binding(0) var<storage, read> points: array<Point>;
@group(1) @binding(1) var<storage, read> blocks: array<Block>;

struct Splat {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat) center_px: vec2<f32>,
    @location(1) @interpolate(flat) radius_px: f32,
    @location(2) @interpolate(flat) color: u32,
}

// Covers the centre of the pixel that holds a splat's centre, however small the splat, with room for the rasteriser's
// rounding of vertices.
const LEAST_REACH_PX: f32 = 0.7072;
const MARGIN_PX: f32 = 0.0625;

// a - b without wrapping: the sign apart from the size.
fn difference(a: vec3<u32>, b: vec3<u32>) -> vec3<f32> {
    return select(-vec3<f32>(b - a), vec3<f32>(a - b), a >= b);
}

@vertex
fn vertex(@builtin(vertex_index) index: u32, @builtin(instance_index) block_index: u32) -> Splat {
    let point = points[index / 3u];
    let block = blocks[block_index];
    let steps = difference(vec3<u32>(point.steps_x, point.steps_y, point.steps_z), block.anchor_steps);
    let view = block.anchor_view + vec3<f32>(
        dot(frame.view_from_steps[0].xyz, steps),
        dot(frame.view_from_steps[1].xyz, steps),
        dot(frame.view_from_steps[2].xyz, steps),
    );

    var px_per_unit = frame.focal_px;
    if (frame.perspective == 1u) {
        px_per_unit = frame.focal_px / (frame.front_depth + view.z);
    }
    let center_px = 0.5 * frame.image_px + px_per_unit * vec2<f32>(view.x, -view.y);
    let radius_px = clamp(block.radius * px_per_unit, frame.min_radius_px, frame.max_radius_px);
    let reach_px = max(radius_px, LEAST_REACH_PX) + MARGIN_PX;

    var splat: Splat;
    // Left outside of the depth range, and so clipped, unless it can be seen. Written so that NaN is clipped.
    splat.position = vec4<f32>(0.0, 0.0, -1.0, 1.0);
    splat.center_px = center_px;
    splat.radius_px = radius_px;
    // The fourth byte tells the shading pass how large the splat is, in half pixels. The limit between two of them is no
    // round number, which radii are often.
    let half_px = u32(clamp(floor(2.0 * radius_px + 0.4142), 1.0, 255.0));
    splat.color = (point.color & 0x00ffffffu) | (half_px << 24u);
    let in_depth = view.z >= frame.nearest_past_front && view.z <= frame.farthest_past_front;
    let in_image = all(center_px >= vec2<f32>(-reach_px)) && all(center_px <= frame.image_px + reach_px);
    if (in_depth && in_image) {
        // The circle of radius 1 is inscribed in the triangle (0, 2), (-sqrt 3, -1), (sqrt 3, -1).
        var corner = vec2<f32>(0.0, 2.0);
        if (index % 3u == 1u) {
            corner = vec2<f32>(-1.7320508, -1.0);
        } else if (index % 3u == 2u) {
            corner = vec2<f32>(1.7320508, -1.0);
        }
        let vertex_px = center_px + reach_px * corner;
        let ndc = vertex_px / frame.image_px * 2.0 - 1.0;
        let depth = min(frame.depth_scale / (frame.depth_scale + view.z), 1.0);
        splat.position = vec4<f32>(ndc.x, -ndc.y, depth, 1.0);
    }
    return splat;
}

@fragment
fn fragment(splat: Splat) -> @location(0) vec4<f32> {
    let pixel = splat.position.xy;
    let offset = pixel - splat.center_px;
    let in_circle = dot(offset, offset) <= splat.radius_px * splat.radius_px;
    let holds_center = all(floor(pixel) == floor(splat.center_px));
    if (!(in_circle || holds_center)) {
        discard;
    }
    // The bytes as they are, sRGB-coded: the target isn't an sRGB one, so an unlit colour comes out exactly.
    return unpack4x8unorm(splat.color);
}

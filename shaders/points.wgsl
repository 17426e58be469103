// One splat per point: a triangle around its circle, pulled by vertex index, and a fragment test that keeps the circle
// (or the square around it). Twin on the CPU: `reference::draw_points`.
//
// The position is subtracted as integers from the block's anchor (the eye, moved into the block's box), then turned into
// f32: next to the eye the difference is small, so its rounding is too, whatever the coordinates.
//
// A splat is as large as the finest drawn node that holds its point asks for: the nodes of the picture lie in a table,
// and the point's own steps say which child it is in.

struct Point {
    steps_x: u32,
    steps_y: u32,
    steps_z: u32,
    // RGBA8, red in the low byte, whose fourth byte is not read; or an attribute's value: see `Frame.values`.
    value: u32,
}

struct Block {
    // From the block's corner.
    anchor_steps: vec3<u32>,
    // The place of its node in `nodes`.
    node: u32,
    anchor_view: vec3<f32>,
    // Lattice steps that a step stands for.
    step_scale: f32,
    // In the buffer.
    first_point: u32,
    // Of the first point, in drawing order; 0 is nobody's.
    first_id: u32,
    // The node's cube is 2^bits steps wide.
    bits: u32,
    // The node's place among the levels, for a palette by level.
    level: u32,
}

struct Node {
    // Of a splat, in world units.
    radius: f32,
    // Bits 0 to 7: which octants are there; above: the place of the first of them, the others follow in octant order.
    children: u32,
}

@group(0) @binding(1) var<storage, read> palette: array<u32>;
@group(0) @binding(2) var<storage, read> blocks: array<Block>;
@group(0) @binding(3) var<storage, read> nodes: array<Node>;
@group(1) @binding(0) var<storage, read> points: array<Point>;

struct Splat {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat) center_px: vec2<f32>,
    @location(1) @interpolate(flat) radius_px: f32,
    @location(2) @interpolate(flat) color: u32,
    @location(3) @interpolate(flat) id: u32,
    // Past the front.
    @location(4) @interpolate(flat) z: f32,
    @location(5) @interpolate(flat) px_per_unit: f32,
}

const SHAPE_SQUARE: u32 = 1u;
const SHAPE_PARABOLOID: u32 = 2u;
const VALUES_COLORS: u32 = 0u;
const VALUES_NUMBERS: u32 = 1u;
const VALUES_RAMP: u32 = 2u;
// The value of a point that lacks what others show, and its colour.
const NO_VALUE: u32 = 0xffffffffu;
const NO_VALUE_COLOR: u32 = 0xff969696u;

// Covers the centre of the pixel that holds a splat's centre, however small the splat, with room for the rasteriser's
// rounding of vertices.
const LEAST_REACH_PX: f32 = 0.7072;
const MARGIN_PX: f32 = 0.0625;
const SQRT_2: f32 = 1.4142136;

// a - b without wrapping: the sign apart from the size.
fn difference(a: vec3<u32>, b: vec3<u32>) -> vec3<f32> {
    return select(-vec3<f32>(b - a), vec3<f32>(a - b), a >= b);
}

// Of the finest node of the picture that holds the point.
fn radius_of(block: Block, steps: vec3<u32>) -> f32 {
    var node = nodes[block.node];
    var bit = block.bits;
    loop {
        let mask = node.children & 0xffu;
        if (mask == 0u || bit == 0u) {
            break;
        }
        bit -= 1u;
        let bits = (steps >> vec3<u32>(bit)) & vec3<u32>(1u);
        let octant = bits.x | bits.y << 1u | bits.z << 2u;
        if ((mask >> octant & 1u) == 0u) {
            break;
        }
        let place = countOneBits(mask & ((1u << octant) - 1u));
        node = nodes[(node.children >> 8u) + place];
    }
    return node.radius;
}

fn color_of(value: u32, level: u32) -> u32 {
    switch frame.values {
        case 0u: {
            return value | 0xff000000u;
        }
        case 1u: {
            if (value == NO_VALUE) {
                return NO_VALUE_COLOR;
            }
            return palette[min(value, frame.palette_last)];
        }
        case 2u: {
            if (value == NO_VALUE) {
                return NO_VALUE_COLOR;
            }
            let place = clamp(bitcast<f32>(value) * frame.ramp_scale + frame.ramp_offset, 0.0, 1.0);
            return palette[u32(place * f32(frame.palette_last) + 0.5)];
        }
        default: {
            return palette[min(level, frame.palette_last)];
        }
    }
}

fn is_inside(clip: u32, view: vec3<f32>) -> bool {
    let rows = frame.clips[clip].unit_from_view;
    let unit = vec3<f32>(
        dot(rows[0].xyz, view) + rows[0].w,
        dot(rows[1].xyz, view) + rows[1].w,
        dot(rows[2].xyz, view) + rows[2].w,
    );
    return all(abs(unit) <= vec3<f32>(1.0));
}

fn is_kept(view: vec3<f32>) -> bool {
    var kept = frame.clips_to_keep == 0u;
    for (var clip = 0u; clip < frame.clips_to_keep; clip++) {
        kept = kept || is_inside(clip, view);
    }
    for (var clip = frame.clips_to_keep; clip < frame.clips_in_all; clip++) {
        kept = kept && !is_inside(clip, view);
    }
    return kept;
}

@vertex
fn vertex(@builtin(vertex_index) index: u32, @builtin(instance_index) block_index: u32) -> Splat {
    let point = points[index / 3u];
    let block = blocks[block_index];
    let steps = vec3<u32>(point.steps_x, point.steps_y, point.steps_z);
    let relative = difference(steps, block.anchor_steps) * block.step_scale;
    let view = block.anchor_view + vec3<f32>(
        dot(frame.view_from_steps[0].xyz, relative),
        dot(frame.view_from_steps[1].xyz, relative),
        dot(frame.view_from_steps[2].xyz, relative),
    );

    var px_per_unit = frame.focal_px;
    if (frame.perspective == 1u) {
        px_per_unit = frame.focal_px / (frame.front_depth + view.z);
    }
    let center_px = 0.5 * frame.image_px + px_per_unit * vec2<f32>(view.x, -view.y);
    let radius_px = clamp(radius_of(block, steps) * px_per_unit, frame.min_radius_px, frame.max_radius_px);
    var reach_px = radius_px + frame.shadow_px;
    if (frame.shape == SHAPE_SQUARE) {
        reach_px *= SQRT_2;
    }
    reach_px = max(reach_px, LEAST_REACH_PX) + MARGIN_PX;
    let color = color_of(point.value, block.level);

    var splat: Splat;
    // Left outside of the depth range, and so clipped, unless it can be seen. Written so that NaN is clipped.
    splat.position = vec4<f32>(0.0, 0.0, -1.0, 1.0);
    splat.center_px = center_px;
    splat.radius_px = radius_px;
    // The fourth byte tells the shading pass how large the splat is, in half pixels. The limit between two of them is no
    // round number, which radii are often.
    let half_px = u32(clamp(floor(2.0 * radius_px + 0.4142), 1.0, 255.0));
    splat.color = (color & 0x00ffffffu) | (half_px << 24u);
    splat.id = block.first_id + (index / 3u - block.first_point);
    splat.z = view.z;
    splat.px_per_unit = px_per_unit;
    let in_depth = view.z >= frame.nearest_past_front && view.z <= frame.farthest_past_front;
    let in_image = all(center_px >= vec2<f32>(-reach_px)) && all(center_px <= frame.image_px + reach_px);
    let is_shown = (color >> 24u) != 0u;
    if (in_depth && in_image && is_shown && is_kept(view)) {
        // The circle of radius 1 is inscribed in the triangle (0, 2), (-sqrt 3, -1), (sqrt 3, -1).
        var corner = vec2<f32>(0.0, 2.0);
        if (index % 3u == 1u) {
            corner = vec2<f32>(-1.7320508, -1.0);
        } else if (index % 3u == 2u) {
            corner = vec2<f32>(1.7320508, -1.0);
        }
        let vertex_px = center_px + reach_px * corner;
        let ndc = vertex_px / frame.image_px * 2.0 - 1.0;
        splat.position = vec4<f32>(ndc.x, -ndc.y, depth_of(view.z), 1.0);
    }
    return splat;
}

// How far a pixel is from the splat's centre, as its shape measures.
fn distance_px(offset: vec2<f32>) -> f32 {
    if (frame.shape == SHAPE_SQUARE) {
        return max(abs(offset.x), abs(offset.y));
    }
    return sqrt(dot(offset, offset));
}

fn holds_center(splat: Splat) -> bool {
    return all(floor(splat.position.xy) == floor(splat.center_px));
}

struct Pixel {
    @location(0) color: vec4<f32>,
    @location(1) id: u32,
}

// Flat splats without shadows: the rasteriser's depth is the point's.
@fragment
fn fragment(splat: Splat) -> Pixel {
    if (!(distance_px(splat.position.xy - splat.center_px) <= splat.radius_px || holds_center(splat))) {
        discard;
    }
    // The bytes as they are, sRGB-coded: the target isn't an sRGB one, so an unlit colour comes out exactly.
    return Pixel(unpack4x8unorm(splat.color), splat.id);
}

struct DeepPixel {
    @location(0) color: vec4<f32>,
    @location(1) id: u32,
    @builtin(frag_depth) depth: f32,
}

// How far behind its point a shadow lies, in its own radii: surfaces seen at up to 76 degrees from their normal lie before
// the shadows of their own points, such as the ground under a camera that looks down a little.
const SHADOW_BEHIND: f32 = 4.0;

// Splats with a relief of their own: the paraboloid, and the shadow behind any.
@fragment
fn fragment_deep(splat: Splat) -> DeepPixel {
    let away_px = distance_px(splat.position.xy - splat.center_px);
    let shadow_radius_px = splat.radius_px + frame.shadow_px;
    if (away_px <= splat.radius_px || holds_center(splat)) {
        var behind_px = 0.0;
        if (frame.shape == SHAPE_PARABOLOID) {
            let part = min(away_px / splat.radius_px, 1.0);
            behind_px = splat.radius_px * part * part;
        }
        let depth = depth_of(splat.z + behind_px / splat.px_per_unit);
        return DeepPixel(unpack4x8unorm(splat.color), splat.id, depth);
    }
    if (!(away_px <= shadow_radius_px && frame.shadow_px > 0.0)) {
        discard;
    }
    let depth = depth_of(splat.z + SHADOW_BEHIND * shadow_radius_px / splat.px_per_unit);
    return DeepPixel(unpack4x8unorm(splat.color & 0xff000000u), splat.id, depth);
}

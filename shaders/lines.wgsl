// Straight lines of a fixed width, for boxes: each is a quad around the segment. The CPU clips and projects them
// (`lines.rs`), so that ends behind the eye or far beside the image cost no precision here. Twin: `reference::draw_lines`.

struct Line {
    from_px: vec2<f32>,
    to_px: vec2<f32>,
    // Depth past the front is linear along a line in parallel projection; in perspective 1 / depth is, and these are
    // 1 / (front + past front).
    from_depth: f32,
    to_depth: f32,
    // RGBA8.
    color: u32,
    pad_0: u32,
}

@group(1) @binding(0) var<storage, read> lines: array<Line>;

const HALF_WIDTH_PX: f32 = 0.75;
const LINE_MARGIN_PX: f32 = 1.0;

struct Corner {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat) line: u32,
}

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> Corner {
    let line = lines[index / 6u];
    let span = line.to_px - line.from_px;
    let length_px = length(span);
    let along = select(vec2<f32>(1.0, 0.0), span / length_px, length_px > 0.0);
    let across = vec2<f32>(-along.y, along.x);
    let reach_px = HALF_WIDTH_PX + LINE_MARGIN_PX;
    // Two triangles: corners 0 1 2, 2 1 3.
    let corners = array<u32, 6>(0u, 1u, 2u, 2u, 1u, 3u);
    let corner = corners[index % 6u];
    let end = select(line.from_px - along * reach_px, line.to_px + along * reach_px, (corner & 1u) == 1u);
    let side = select(-1.0, 1.0, (corner & 2u) == 2u);
    let ndc = (end + across * side * reach_px) / frame.image_px * 2.0 - 1.0;
    return Corner(vec4<f32>(ndc.x, -ndc.y, 0.5, 1.0), index / 6u);
}

struct LinePixel {
    @location(0) color: vec4<f32>,
    @location(1) id: u32,
    @builtin(frag_depth) depth: f32,
}

@fragment
fn fragment(corner: Corner) -> LinePixel {
    let line = lines[corner.line];
    let span = line.to_px - line.from_px;
    let square = dot(span, span);
    var t = 0.0;
    if (square > 0.0) {
        t = clamp(dot(corner.position.xy - line.from_px, span) / square, 0.0, 1.0);
    }
    let offset = corner.position.xy - (line.from_px + t * span);
    if (!(dot(offset, offset) <= HALF_WIDTH_PX * HALF_WIDTH_PX)) {
        discard;
    }
    var z = mix(line.from_depth, line.to_depth, t);
    if (frame.perspective == 1u) {
        z = 1.0 / z - frame.front_depth;
    }
    // The splat that the shading pass sees is the least.
    return LinePixel(unpack4x8unorm((line.color & 0x00ffffffu) | 0x01000000u), 0u, depth_of(max(z, 0.0)));
}

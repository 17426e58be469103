// Background, eye-dome lighting and fog: a pixel gets darker the more its neighbours are nearer to the eye. Twin on the CPU:
// `reference::shade`.
//
// The depth difference to a neighbour is taken relative to the sideways distance (a slope): in perspective through the
// logarithm of the ratio of depths, which is the same at every distance, in orthographic directly as a part of the height
// seen. Neighbours without a point don't count, so neither a lone point nor a silhouette against the background changes
// colour. Neighbours are looked for beyond the pixel's own splat: flat discs on a slope are stairs, and shading the steps
// would draw a line around every disc.

@group(1) @binding(0) var colors: texture_2d<f32>;
@group(1) @binding(1) var depths: texture_depth_2d;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    // One triangle that covers the image.
    let corner = vec2<f32>(f32(index & 1u), f32(index >> 1u)) * 4.0 - 1.0;
    return vec4<f32>(corner, 0.0, 1.0);
}

fn past_front(depth: f32) -> f32 {
    return frame.depth_scale * (1.0 / depth - 1.0);
}

// log(1 + x) for x >= 0, to f32 also where x is so small that 1 + x isn't.
fn log_1p(x: f32) -> f32 {
    if (x < 0.01) {
        return x * (1.0 - x * (0.5 - x * 0.33333333));
    }
    return log(1.0 + x);
}

// A slope counts at most this much: edges are drawn dark, not black.
const STEEPEST: f32 = 3.0;
// How far beyond its own splat's radius a pixel looks.
const BEYOND_SPLAT: f32 = 1.5;

// How steeply the image comes nearer towards the pixel `step` away; 0 if it doesn't. Steps end at the image's edge.
fn occlusion(own: f32, pixel: vec2<i32>, step: vec2<i32>) -> f32 {
    let neighbor = clamp(pixel + step, vec2<i32>(0), vec2<i32>(frame.image_px) - 1);
    let depth = textureLoad(depths, neighbor, 0);
    if (all(neighbor == pixel) || depth <= 0.0) {
        return 0.0;
    }
    let other = past_front(depth);
    var behind = max(own - other, 0.0);
    if (frame.perspective == 1u) {
        behind = log_1p(behind / (frame.front_depth + other));
    }
    let slope = behind * frame.focal_px / length(vec2<f32>(neighbor - pixel));
    return slope / (1.0 + slope / STEEPEST);
}

fn linear_from_srgb(c: vec3<f32>) -> vec3<f32> {
    return select(pow((c + 0.055) / 1.055, vec3<f32>(2.4)), c / 12.92, c <= vec3<f32>(0.04045));
}

fn srgb_from_linear(c: vec3<f32>) -> vec3<f32> {
    return select(1.055 * pow(c, vec3<f32>(1.0 / 2.4)) - 0.055, c * 12.92, c <= vec3<f32>(0.0031308));
}

// Rounded here, so that the target's own rounding has nothing left to decide.
fn byte(c: vec4<f32>) -> vec4<f32> {
    return floor(clamp(c, vec4<f32>(0.0), vec4<f32>(1.0)) * 255.0 + 0.5) / 255.0;
}

fn background(y: f32) -> vec4<f32> {
    return mix(frame.background_top, frame.background_bottom, y / frame.image_px.y);
}

// 1 where nothing is nearer beside the pixel, towards 0 where much is.
fn light_at(pixel: vec2<i32>, own: f32, splat_radius_px: f32) -> f32 {
    if (frame.edl_strength <= 0.0) {
        return 1.0;
    }
    let reach_px = max(frame.edl_radius_px, BEYOND_SPLAT * splat_radius_px);
    let s = i32(floor(reach_px + 0.5));
    let d = i32(floor(reach_px * 0.70710678 + 0.5));
    var sum = occlusion(own, pixel, vec2<i32>(s, 0)) + occlusion(own, pixel, vec2<i32>(-s, 0));
    sum += occlusion(own, pixel, vec2<i32>(0, s)) + occlusion(own, pixel, vec2<i32>(0, -s));
    sum += occlusion(own, pixel, vec2<i32>(d, d)) + occlusion(own, pixel, vec2<i32>(-d, d));
    sum += occlusion(own, pixel, vec2<i32>(d, -d)) + occlusion(own, pixel, vec2<i32>(-d, -d));
    return exp(-frame.edl_strength * sum / 8.0);
}

// How much of a point's own colour the fog leaves.
fn clearness_at(own: f32) -> f32 {
    if (frame.fog_half <= 0.0) {
        return 1.0;
    }
    return exp2(-max(own + frame.front_depth - frame.fog_start, 0.0) / frame.fog_half);
}

fn shaded(position: vec4<f32>) -> vec4<f32> {
    let pixel = vec2<i32>(position.xy);
    let depth = textureLoad(depths, pixel, 0);
    if (depth <= 0.0) {
        return byte(background(position.y));
    }
    let texel = textureLoad(colors, pixel, 0);
    let own = past_front(depth);
    let light = light_at(pixel, own, floor(texel.a * 255.0 + 0.5) / 2.0);
    let clearness = clearness_at(own);
    if (light >= 1.0 && clearness >= 1.0) {
        return vec4<f32>(texel.rgb, 1.0);
    }
    let fog = select(background(position.y).rgb, frame.fog_color.rgb, frame.fog_color.w > 0.0);
    let color = mix(linear_from_srgb(fog), linear_from_srgb(texel.rgb) * light, clearness);
    return byte(vec4<f32>(srgb_from_linear(color), 1.0));
}

@fragment
fn fragment(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    return shaded(position);
}

// For a target that codes what it is given.
@fragment
fn fragment_linear(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    let coded = shaded(position);
    return vec4<f32>(linear_from_srgb(coded.rgb), coded.a);
}

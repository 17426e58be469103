//! What an image must be: the twin of the passes on the CPU, point by point in `f64`.
//!
//! The passes work in `f32` on packed points; here are the plain formulas on world coordinates. The two images agree
//! up to rounding: a pixel may differ only where the edge of a splat passes within a rounding of its centre, or where
//! two splats are equally near within a rounding of the depth. On scenes in general position at most 0.5 % of the
//! pixels differ by more than 2 of 255 (tested).

use super::frame::Frame;
use super::lines::{Line, box_lines};
use super::{Image, RenderError, RenderOptions, Scene, Shape};
use crate::geometry::Camera;
use std::f64::consts::FRAC_1_SQRT_2;

/// The most pixels on a side.
const MAX_SIZE_PX: u32 = 32_768;

/// The image of `scene` in the camera's size.
///
/// # Errors
///
/// [`RenderError::Size`] above 32,768 pixels a side; [`RenderError::ColorCount`] and [`RenderError::Number`] for what
/// can't be drawn.
pub fn render(scene: &Scene, camera: &Camera, options: &RenderOptions) -> Result<Image, RenderError> {
    scene.check()?;
    let frame = Frame::new(&scene.lattice, scene.bounds(options), camera, options, MAX_SIZE_PX)?;
    let mut canvas = draw_points(scene, &frame, options);
    if options.node_boxes {
        draw_lines(&mut canvas, &box_lines(&scene.lattice, scene.boxes.iter().copied(), &frame), &frame);
    }
    Ok(shade(&canvas, &frame, options))
}

/// For each pixel of the image, row by row, the number of the point that it shows, counted from 0 through the nodes of
/// the scene; `None` where there is none.
///
/// # Errors
///
/// As [`render`].
pub fn points_shown(
    scene: &Scene,
    camera: &Camera,
    options: &RenderOptions,
) -> Result<Vec<Option<usize>>, RenderError> {
    scene.check()?;
    let frame = Frame::new(&scene.lattice, scene.bounds(options), camera, options, MAX_SIZE_PX)?;
    Ok(draw_points(scene, &frame, options).points)
}

/// Shading counts a slope at most this much; as in `shade.wgsl`.
const STEEPEST: f64 = 3.0;
/// How far beyond its own splat's radius a pixel looks; as in `shade.wgsl`.
const BEYOND_SPLAT: f64 = 1.5;
/// Of a line; as in `lines.wgsl`.
const HALF_WIDTH_PX: f64 = 0.75;

/// Colour, the splat's radius in half pixels as the fourth byte, and reversed depth per pixel; depth 0 where no point is.
struct Canvas {
    width: usize,
    height: usize,
    colors: Vec<[u8; 4]>,
    depths: Vec<f32>,
    points: Vec<Option<usize>>,
}

/// A point on the image.
struct Splat {
    center_px: [f64; 2],
    radius_px: f64,
    depth: f64,
    px_per_unit: f64,
    /// With the radius as its fourth byte.
    color: [u8; 4],
    point: usize,
}

/// Twin of `points.wgsl`.
fn draw_points(scene: &Scene, frame: &Frame, options: &RenderOptions) -> Canvas {
    let [width, height] = frame.size_px.map(|side| side as usize);
    let pixels = width * height;
    let mut canvas =
        Canvas { width, height, colors: vec![[0; 4]; pixels], depths: vec![0.0; pixels], points: vec![None; pixels] };
    let image_px = frame.size_px.map(f64::from);
    let mut numbers = 0..;
    for node in &scene.nodes {
        for ((world, &color), point) in node.positions.iter().zip(&node.colors).zip(&mut numbers) {
            let view = frame.view_from_world(scene.lattice.world_from_lattice(world));
            if !(view.z >= frame.near && frame.far.is_none_or(|far| view.z <= far) && frame.keeps(view)) {
                continue;
            }
            let px_per_unit = if frame.perspective { frame.focal_px / view.z } else { frame.focal_px };
            let center_px = [image_px[0] / 2.0 + view.x * px_per_unit, image_px[1] / 2.0 - view.y * px_per_unit];
            let radius_px =
                (node.spacing * options.radius_factor * px_per_unit).clamp(frame.min_radius_px, frame.max_radius_px);
            let half_px = (2.0 * radius_px + 0.4142).floor().clamp(1.0, 255.0) as u8;
            let [red, green, blue, _] = color;
            let color = [red, green, blue, half_px];
            canvas.splat(&Splat { center_px, radius_px, depth: view.z, px_per_unit, color, point }, frame, options);
        }
    }
    canvas
}

/// As in `points.wgsl`.
const SHADOW_BEHIND: f64 = 4.0;

impl Canvas {
    fn splat(&mut self, splat: &Splat, frame: &Frame, options: &RenderOptions) {
        let shadow_radius_px = splat.radius_px + options.shadow_px;
        let reach_px = shadow_radius_px.max(1.0);
        let center_px = splat.center_px;
        for y in span(center_px[1] - reach_px, center_px[1] + reach_px, self.height) {
            for x in span(center_px[0] - reach_px, center_px[0] + reach_px, self.width) {
                let (dx, dy) = (x as f64 + 0.5 - center_px[0], y as f64 + 0.5 - center_px[1]);
                let away_px = if options.shape == Shape::Square { dx.abs().max(dy.abs()) } else { dx.hypot(dy) };
                let holds_center = center_px[0].floor() == x as f64 && center_px[1].floor() == y as f64;
                let [red, green, blue, half_px] = splat.color;
                let (behind_px, color) = if away_px <= splat.radius_px || holds_center {
                    let part = (away_px / splat.radius_px).min(1.0);
                    let bent = options.shape == Shape::Paraboloid;
                    (if bent { splat.radius_px * part * part } else { 0.0 }, [red, green, blue, half_px])
                } else if away_px <= shadow_radius_px && options.shadow_px > 0.0 {
                    (SHADOW_BEHIND * shadow_radius_px, [0, 0, 0, half_px])
                } else {
                    continue;
                };
                let depth = frame.reversed(splat.depth + behind_px / splat.px_per_unit);
                self.put(x, y, depth, color, Some(splat.point));
            }
        }
    }

    fn put(&mut self, x: usize, y: usize, depth: f32, color: [u8; 4], point: Option<usize>) {
        let pixel = y * self.width + x;
        if depth > self.depths[pixel] {
            self.depths[pixel] = depth;
            self.colors[pixel] = color;
            self.points[pixel] = point;
        }
    }

    /// The depth of a pixel of the image; `None` where no point is.
    fn depth_at(&self, x: i64, y: i64) -> Option<f32> {
        let depth = self.depths[y as usize * self.width + x as usize];
        (depth > 0.0).then_some(depth)
    }
}

/// Columns or rows from the first to before the last; empty if all are beside the image.
fn span(low: f64, high: f64, side: usize) -> std::ops::Range<usize> {
    low.floor().clamp(0.0, side as f64) as usize..high.ceil().clamp(0.0, side as f64) as usize
}

/// Twin of `lines.wgsl`.
fn draw_lines(canvas: &mut Canvas, lines: &[Line], frame: &Frame) {
    for line in lines {
        let delta: [f64; 2] = std::array::from_fn(|i| line.to_px[i] - line.from_px[i]);
        let square = delta[0] * delta[0] + delta[1] * delta[1];
        let across = |i: usize, side| {
            let (low, high) = (line.from_px[i].min(line.to_px[i]), line.from_px[i].max(line.to_px[i]));
            span(low - HALF_WIDTH_PX - 1.0, high + HALF_WIDTH_PX + 1.0, side)
        };
        for y in across(1, canvas.height) {
            for x in across(0, canvas.width) {
                let at = [x as f64 + 0.5 - line.from_px[0], y as f64 + 0.5 - line.from_px[1]];
                let t = if square > 0.0 { (at[0] * delta[0] + at[1] * delta[1]) / square } else { 0.0 };
                let t = t.clamp(0.0, 1.0);
                if (at[0] - t * delta[0]).hypot(at[1] - t * delta[1]) > HALF_WIDTH_PX {
                    continue;
                }
                let z = line.from_depth + (line.to_depth - line.from_depth) * t;
                let depth = if frame.perspective { 1.0 / z } else { z + frame.front };
                let [red, green, blue, _] = line.color;
                canvas.put(x, y, frame.reversed(depth.max(frame.front)), [red, green, blue, 1], None);
            }
        }
    }
}

/// Twin of `shade.wgsl`.
fn shade(canvas: &Canvas, frame: &Frame, options: &RenderOptions) -> Image {
    let [top, bottom] = options.background.ends().map(|color| color.map(f64::from));
    let past_front = |depth: f32| frame.depth_scale * (1.0 / f64::from(depth) - 1.0);
    let mut rgba = Vec::with_capacity(canvas.colors.len() * 4);
    for y in 0..canvas.height as i64 {
        let t = (y as f64 + 0.5) / canvas.height as f64;
        let background: [f64; 4] = std::array::from_fn(|i| (1.0 - t) * top[i] + t * bottom[i]);
        for x in 0..canvas.width as i64 {
            let Some(depth) = canvas.depth_at(x, y) else {
                rgba.extend(background.map(|coded| (coded * 255.0).round() as u8));
                continue;
            };
            let own = past_front(depth);
            let [red, green, blue, half_px] = canvas.colors[y as usize * canvas.width + x as usize];
            let reach_px = f64::from(frame.edl_radius_px).max(BEYOND_SPLAT * f64::from(half_px) / 2.0);
            let (s, d) = ((reach_px + 0.5).floor() as i64, (reach_px * FRAC_1_SQRT_2 + 0.5).floor() as i64);
            let neighbors = [(s, 0), (-s, 0), (0, s), (0, -s), (d, d), (-d, d), (d, -d), (-d, -d)];
            let occlusion = |(step_x, step_y): (i64, i64)| {
                let neighbor_x = (x + step_x).clamp(0, canvas.width as i64 - 1);
                let neighbor_y = (y + step_y).clamp(0, canvas.height as i64 - 1);
                let sideways_px = ((neighbor_x - x) as f64).hypot((neighbor_y - y) as f64);
                let Some(other) = canvas.depth_at(neighbor_x, neighbor_y).filter(|_| sideways_px > 0.0) else {
                    return 0.0;
                };
                let other = past_front(other);
                let behind = (own - other).max(0.0);
                let behind = if frame.perspective { (behind / (frame.front + other)).ln_1p() } else { behind };
                let slope = behind * frame.focal_px / sideways_px;
                slope / (1.0 + slope / STEEPEST)
            };
            let sum: f64 = neighbors.into_iter().map(occlusion).sum();
            let light = (-f64::from(frame.edl_strength) * sum / 8.0).exp();
            let clearness =
                options.fog.map_or(1.0, |fog| (-(own + frame.front - fog.start).max(0.0) / fog.half).exp2());
            let fog = options.fog.and_then(|fog| fog.color).map(|color| color.map(|byte| f64::from(byte) / 255.0));
            let fog = fog.unwrap_or([background[0], background[1], background[2]]);
            rgba.extend([red, green, blue].into_iter().zip(fog).map(|(byte, fog)| hazed(byte, light, clearness, fog)));
            rgba.push(255);
        }
    }
    Image { width: canvas.width as u32, height: canvas.height as u32, rgba }
}

fn linear(coded: f64) -> f64 {
    if coded <= 0.04045 { coded / 12.92 } else { ((coded + 0.055) / 1.055).powf(2.4) }
}

/// An sRGB-coded byte in `light` from 0 to 1, of which fog leaves `clearness`; unchanged in full light and clear air.
fn hazed(byte: u8, light: f64, clearness: f64, fog: f64) -> u8 {
    let linear = linear(f64::from(byte) / 255.0) * light * clearness + linear(fog) * (1.0 - clearness);
    let coded = if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    (coded * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn full_light_leaves_every_byte_and_no_light_leaves_none() {
        for byte in 0..=255 {
            assert_eq!(hazed(byte, 1.0, 1.0, 0.3), byte);
            assert_eq!(hazed(byte, 0.0, 1.0, 0.3), 0);
            assert_eq!(hazed(byte, 1.0, 0.0, f64::from(byte) / 255.0), byte);
        }
    }
}

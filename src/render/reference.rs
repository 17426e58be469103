//! What an image must be: the twin of the passes on the CPU, point by point in `f64`.
//!
//! The passes work in `f32` on packed points; here are the plain formulas on world coordinates. The two images agree
//! up to rounding: a pixel may differ only where the edge of a splat passes within a rounding of its centre, or where
//! two splats are equally near within a rounding of the depth. On scenes in general position at most 0.5 % of the
//! pixels differ by more than 2 of 255 (tested).

use super::frame::Frame;
use super::{Image, RenderError, RenderOptions, Scene};
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
    let frame = Frame::new(scene, camera, options, MAX_SIZE_PX)?;
    let canvas = draw_points(scene, &frame, options.radius_factor);
    Ok(shade(&canvas, &frame, options))
}

/// Shading counts a slope at most this much; as in `shade.wgsl`.
const STEEPEST: f64 = 3.0;
/// How far beyond its own splat's radius a pixel looks; as in `shade.wgsl`.
const BEYOND_SPLAT: f64 = 1.5;

/// Colour, the splat's radius in half pixels as the fourth byte, and reversed depth per pixel; depth 0 where no point is.
struct Canvas {
    width: usize,
    height: usize,
    colors: Vec<[u8; 4]>,
    depths: Vec<f32>,
}

/// Twin of `points.wgsl`.
fn draw_points(scene: &Scene, frame: &Frame, radius_factor: f64) -> Canvas {
    let [width, height] = frame.size_px.map(|side| side as usize);
    let mut canvas = Canvas { width, height, colors: vec![[0; 4]; width * height], depths: vec![0.0; width * height] };
    let image_px = frame.size_px.map(f64::from);
    for node in &scene.nodes {
        for (point, &color) in node.positions.iter().zip(&node.colors) {
            let view = frame.view_from_world(scene.lattice.world_from_lattice(point));
            if !(view.z >= frame.near && frame.far.is_none_or(|far| view.z <= far)) {
                continue;
            }
            let px_per_unit = if frame.perspective { frame.focal_px / view.z } else { frame.focal_px };
            let center_px = [image_px[0] / 2.0 + view.x * px_per_unit, image_px[1] / 2.0 - view.y * px_per_unit];
            let radius_px =
                (node.spacing * radius_factor * px_per_unit).clamp(frame.min_radius_px, frame.max_radius_px);
            let depth = (frame.depth_scale / (frame.depth_scale + (view.z - frame.front))).min(1.0) as f32;
            let half_px = (2.0 * radius_px + 0.4142).floor().clamp(1.0, 255.0) as u8;
            let [red, green, blue, _] = color;
            canvas.splat(center_px, radius_px, depth, [red, green, blue, half_px]);
        }
    }
    canvas
}

impl Canvas {
    fn splat(&mut self, center_px: [f64; 2], radius_px: f64, depth: f32, color: [u8; 4]) {
        let reach_px = radius_px.max(1.0);
        // Columns and rows from the first to before the last; empty if the splat is beside the image.
        let span = |center: f64, side: usize| {
            let first = (center - reach_px).floor().clamp(0.0, side as f64) as usize;
            let end = (center + reach_px).ceil().clamp(0.0, side as f64) as usize;
            first..end
        };
        for y in span(center_px[1], self.height) {
            for x in span(center_px[0], self.width) {
                let (dx, dy) = (x as f64 + 0.5 - center_px[0], y as f64 + 0.5 - center_px[1]);
                let in_circle = dx * dx + dy * dy <= radius_px * radius_px;
                let holds_center = center_px[0].floor() == x as f64 && center_px[1].floor() == y as f64;
                let pixel = y * self.width + x;
                if (in_circle || holds_center) && depth > self.depths[pixel] {
                    self.depths[pixel] = depth;
                    self.colors[pixel] = color;
                }
            }
        }
    }

    /// The depth of a pixel of the image; `None` where no point is.
    fn depth_at(&self, x: i64, y: i64) -> Option<f32> {
        let depth = self.depths[y as usize * self.width + x as usize];
        (depth > 0.0).then_some(depth)
    }
}

/// Twin of `shade.wgsl`.
fn shade(canvas: &Canvas, frame: &Frame, options: &RenderOptions) -> Image {
    let [top, bottom] = options.background.ends().map(|color| color.map(f64::from));
    let past_front = |depth: f32| frame.depth_scale * (1.0 / f64::from(depth) - 1.0);
    let mut rgba = Vec::with_capacity(canvas.colors.len() * 4);
    for y in 0..canvas.height as i64 {
        for x in 0..canvas.width as i64 {
            let Some(depth) = canvas.depth_at(x, y) else {
                let t = (y as f64 + 0.5) / canvas.height as f64;
                rgba.extend((0..4).map(|i| (((1.0 - t) * top[i] + t * bottom[i]) * 255.0).round() as u8));
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
            rgba.extend([red, green, blue].map(|byte| darkened(byte, light)));
            rgba.push(255);
        }
    }
    Image { width: canvas.width as u32, height: canvas.height as u32, rgba }
}

/// An sRGB-coded byte in `light` from 0 to 1; unchanged in full light.
fn darkened(byte: u8, light: f64) -> u8 {
    let coded = f64::from(byte) / 255.0;
    let linear = if coded <= 0.04045 { coded / 12.92 } else { ((coded + 0.055) / 1.055).powf(2.4) } * light;
    let coded = if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    (coded * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn full_light_leaves_every_byte_and_no_light_leaves_none() {
        for byte in 0..=255 {
            assert_eq!(darkened(byte, 1.0), byte);
            assert_eq!(darkened(byte, 0.0), 0);
        }
    }
}

//! The edges of boxes as lines on the image: clipped at the near plane and at the image's edges in `f64`, so that what is
//! drawn is always near the image.

use super::frame::{Frame, corners};
use super::gpu_types::GpuLine;
use crate::geometry::DVec3;
use crate::lattice::{Lattice, LatticeBox};

/// A line on the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Line {
    pub from_px: [f64; 2],
    pub to_px: [f64; 2],
    /// What is linear along the line on the image: 1 / depth in perspective, depth past the front in parallel.
    pub from_depth: f64,
    pub to_depth: f64,
    pub color: [u8; 4],
}

/// How far beyond the image lines go on, relative to its sides.
const BEYOND: f64 = 0.1;

/// The twelve edges of each box, as far as they can be seen.
pub(super) fn box_lines(
    lattice: &Lattice,
    boxes: impl IntoIterator<Item = (LatticeBox, [u8; 4])>,
    frame: &Frame,
) -> Vec<Line> {
    let mut lines = Vec::new();
    for (bounds, color) in boxes {
        let view: Vec<DVec3> = corners(&bounds).map(|c| frame.view_from_world(lattice.world_from_lattice(c))).collect();
        for axis in 0..3 {
            for corner in (0..8).filter(|corner| corner >> axis & 1 == 0) {
                lines.extend(line(view[corner], view[corner | 1 << axis], color, frame));
            }
        }
    }
    lines
}

fn line(from: DVec3, to: DVec3, color: [u8; 4], frame: &Frame) -> Option<Line> {
    let [width, height] = frame.size_px.map(f64::from);
    // What is at least 0 of a place that can be seen: linear in view coordinates.
    let half = [width, height].map(|side| side * (0.5 + BEYOND) / frame.focal_px);
    let planes = |p: DVec3| {
        let reach = if frame.perspective { p.z } else { 1.0 };
        let far = frame.far.map_or(1.0, |far| far - p.z);
        let sides = [half[0] * reach - p.x, half[0] * reach + p.x, half[1] * reach - p.y, half[1] * reach + p.y];
        [p.z - frame.near, far, sides[0], sides[1], sides[2], sides[3]]
    };
    let (mut start, mut end) = (0.0_f64, 1.0_f64);
    for (a, b) in planes(from).into_iter().zip(planes(to)) {
        if a < 0.0 && b < 0.0 {
            return None;
        }
        if a < 0.0 {
            start = start.max(a / (a - b));
        } else if b < 0.0 {
            end = end.min(a / (a - b));
        }
    }
    if !(start <= end) {
        return None;
    }
    let place = |t: f64| {
        let p = from + (to - from) * t;
        let z = p.z.max(frame.near);
        let px_per_unit = if frame.perspective { frame.focal_px / z } else { frame.focal_px };
        let at_px = [width / 2.0 + p.x * px_per_unit, height / 2.0 - p.y * px_per_unit];
        (at_px, if frame.perspective { 1.0 / z } else { z - frame.front })
    };
    let ((from_px, from_depth), (to_px, to_depth)) = (place(start), place(end));
    Some(Line { from_px, to_px, from_depth, to_depth, color })
}

impl From<&Line> for GpuLine {
    fn from(line: &Line) -> Self {
        Self {
            from_px: line.from_px.map(|c| c as f32),
            to_px: line.to_px.map(|c| c as f32),
            from_depth: line.from_depth as f32,
            to_depth: line.to_depth as f32,
            color: u32::from_le_bytes(line.color),
            pad_0: 0,
        }
    }
}

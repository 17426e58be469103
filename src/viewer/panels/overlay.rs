//! What is drawn over the points: measured ways, the clicked point, clip boxes.

use super::super::model::Model;
use crate::geometry::{Camera, DVec3};
use egui::{Align2, Color32, FontId, Pos2, Stroke, Ui};

const MEASURE: Color32 = Color32::from_rgb(255, 214, 90);

/// `free` is what the panels leave of the picture.
pub(super) fn show(ui: &Ui, model: &Model, aspect: f64, free: egui::Rect) {
    let rect = ui.ctx().content_rect();
    let height = 1000_u32;
    let width = (f64::from(height) * aspect).round().max(1.0) as u32;
    let Ok(camera) = model.nav.rig.camera([width, height]) else { return };
    let painter = ui.ctx().layer_painter(egui::LayerId::background()).with_clip_rect(free);
    let scale = rect.height() / height as f32;
    let place = |point: DVec3| -> Option<Pos2> {
        let [x, y, _] = camera.pixel_from_relative(point - camera.eye())?;
        (x.abs() < 1e5 && y.abs() < 1e5).then(|| rect.min + egui::vec2(x as f32, y as f32) * scale)
    };
    for clip in model.clips.iter().filter(|c| c.on) {
        let Some(bounds) = clip.bounds() else { continue };
        let color = if clip.keep { Color32::from_rgb(120, 200, 255) } else { Color32::from_rgb(255, 120, 120) };
        let corners = bounds.corners();
        for axis in 0..3 {
            for corner in (0..8).filter(|c| c >> axis & 1 == 0) {
                line(
                    &painter,
                    &camera,
                    &place,
                    [corners[corner], corners[corner | 1 << axis]],
                    Stroke::new(1.5, color),
                );
            }
        }
    }
    let points = model.measured.points();
    for (ends, segment) in points.windows(2).zip(model.measured.segments()) {
        line(&painter, &camera, &place, [ends[0], ends[1]], Stroke::new(2.0, MEASURE));
        if let Some(middle) = place((ends[0] + ends[1]) / 2.0) {
            let text = format!("{:.3}  (up {:.3})", segment.distance, segment.height);
            let galley = painter.layout_no_wrap(text.clone(), FontId::proportional(14.0), Color32::WHITE);
            let back = egui::Rect::from_center_size(middle, galley.size() + egui::vec2(8.0, 4.0));
            painter.rect_filled(back, 3.0, Color32::from_black_alpha(180));
            painter.text(middle, Align2::CENTER_CENTER, text, FontId::proportional(14.0), Color32::WHITE);
        }
    }
    for at in points.iter().filter_map(|p| place(*p)) {
        painter.circle(at, 4.0, MEASURE, Stroke::new(1.0, Color32::BLACK));
    }
    if let Some(at) = model.picked.as_ref().and_then(|f| place(f.world)) {
        painter.circle_stroke(at, 7.0, Stroke::new(2.0, Color32::WHITE));
    }
}

/// A line in space, cut off before the eye.
fn line(
    painter: &egui::Painter,
    camera: &Camera,
    place: &impl Fn(DVec3) -> Option<Pos2>,
    [a, b]: [DVec3; 2],
    stroke: Stroke,
) {
    let depth = |p: DVec3| (p - camera.eye()).dot(camera.forward()) - camera.near().max(1e-9) * 2.0;
    let (da, db) = (depth(a), depth(b));
    if da <= 0.0 && db <= 0.0 {
        return;
    }
    let cut =
        |from: DVec3, to: DVec3, df: f64, dt: f64| if df < 0.0 { from + (to - from) * (df / (df - dt)) } else { from };
    if let (Some(a), Some(b)) = (place(cut(a, b, da, db)), place(cut(b, a, db, da))) {
        painter.line_segment([a, b], stroke);
    }
}

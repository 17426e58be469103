//! How much is drawn, and how it looks.

use super::super::model::Model;
use super::mark;
use crate::render::Shape;
use egui::{Slider, Ui};

/// How wide what is dragged is, in points.
const SLIDER: f32 = 110.0;

pub(super) fn show(ui: &mut Ui, model: &mut Model) {
    ui.spacing_mut().slider_width = SLIDER;
    let millions = |n: f64, _: std::ops::RangeInclusive<usize>| format!("{:.1} M", n / 1e6);
    let parse = |text: &str| text.trim_end_matches([' ', 'M']).parse::<f64>().ok().map(|n| n * 1e6);
    let set = &mut model.set;
    let budget = Slider::new(&mut set.budget_points, 100_000..=50_000_000)
        .logarithmic(true)
        .custom_formatter(millions)
        .custom_parser(parse)
        .text("points at most");
    let mut sliders = vec![("budget", ui.add(budget))];
    let mut slider = |ui: &mut Ui, name, slider: Slider<'_>| sliders.push((name, ui.add(slider)));
    slider(ui, "error", Slider::new(&mut set.error_px, 0.5..=16.0).logarithmic(true).text("pixels apart"));
    ui.separator();
    slider(ui, "splat", Slider::new(&mut set.splat, 0.1..=2.0).text("size of points"));
    slider(ui, "least", Slider::new(&mut set.least_px, 0.5..=5.0).text("least radius, pixels"));
    ui.horizontal(|ui| {
        for shape in Shape::ALL {
            let word = shape.word();
            if ui.selectable_label(set.shape == word, word).clicked() {
                set.shape = word.to_owned();
            }
        }
    });
    ui.separator();
    slider(ui, "edl", Slider::new(&mut set.edl, 0.0..=3.0).text("relief shading"));
    slider(ui, "outlines", Slider::new(&mut set.shadow_px, 0.0..=4.0).text("outlines, pixels"));
    slider(ui, "haze", Slider::new(&mut set.haze, 0.0..=1.0).text("haze"));
    let mut fov = model.nav.rig.fov_y_deg();
    if ui.add(Slider::new(&mut fov, 10.0..=120.0).text("degrees of view")).changed() {
        model.nav.rig.set_fov_y_deg(fov);
        // A bookmark's own angle is not remembered, what was set here is.
        model.set.fov_y_deg = model.nav.rig.fov_y_deg();
    }
    let response = ui.checkbox(&mut model.node_boxes, "nodes of the octree as boxes");
    mark(model, "boxes", &response);
    for (name, response) in sliders {
        // The middle of what is dragged, not of the words beside it.
        let rail = egui::Rect::from_min_size(response.rect.min, egui::vec2(SLIDER, response.rect.height()));
        mark(model, name, &response.with_new_rect(rail));
    }
}

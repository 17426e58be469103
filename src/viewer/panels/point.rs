//! The point that was clicked, and what has been measured.

use super::super::model::Model;
use super::mark;
use egui::Ui;

pub(super) fn show(ui: &mut Ui, model: &mut Model) {
    let Some(found) = model.picked.as_ref().or(model.hover.as_ref()) else {
        ui.weak("Click a point to see what is stored of it.");
        return;
    };
    egui::Grid::new("point").num_columns(2).striped(true).show(ui, |ui| {
        for (name, value) in &found.values {
            ui.label(name);
            ui.monospace(value);
            ui.end_row();
        }
    });
    if model.picked.is_some() && ui.small_button("let go").clicked() {
        model.picked = None;
    }
}

pub(super) fn measure(ui: &mut Ui, model: &mut Model) {
    ui.horizontal(|ui| {
        let response = ui.selectable_label(model.measuring, if model.measuring { "Click points" } else { "Begin" });
        mark(model, "measure.begin", &response);
        if response.clicked() {
            model.measuring = !model.measuring;
        }
        if ui.button("Back").on_hover_text("Take the last point back (Backspace)").clicked() {
            model.measured.undo();
        }
        let response = ui.button("Clear");
        mark(model, "measure.clear", &response);
        if response.clicked() {
            model.measured.clear();
        }
    });
    let unit = model.site.as_ref().map_or("", |s| s.unit.as_str());
    let Some(span) = model.measured.span() else {
        ui.weak("Two clicked points give a distance and a height.");
        return;
    };
    egui::Grid::new("measure").num_columns(4).striped(true).show(ui, |ui| {
        for heading in ["", "distance", "in plan", "height"] {
            ui.weak(heading);
        }
        ui.end_row();
        for (i, s) in model.measured.segments().enumerate() {
            ui.label(format!("{}", i + 1));
            for value in [s.distance, s.horizontal, s.height] {
                ui.monospace(format!("{value:.3}"));
            }
            ui.end_row();
        }
    });
    ui.label(format!("Along all: {:.3} {unit}", model.measured.length()));
    ui.label(format!("First to last: {:.3} {unit}, height {:.3} {unit}", span.distance, span.height));
}

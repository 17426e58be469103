//! What colours show, and what they mean.

use super::super::model::Model;
use super::mark;
use crate::render::{ColorMode, Legend, LegendKey};
use egui::{Color32, Sense, Ui, vec2};

pub(super) fn show(ui: &mut Ui, model: &mut Model) {
    let mut mode = model.mode;
    let shown = |mode: ColorMode| match mode {
        ColorMode::Rgb => "recorded colours",
        ColorMode::Time => "GPS time",
        ColorMode::Level => "level of detail",
        other => other.word(),
    };
    let response = egui::ComboBox::from_id_salt("mode").selected_text(shown(mode)).show_ui(ui, |ui| {
        for which in ColorMode::ALL {
            let there = model.site.as_ref().is_none_or(|s| which.is_available(|name| s.has(name)));
            let response = ui.add_enabled(there, egui::Button::selectable(mode == which, shown(which)));
            mark(model, format!("mode.{}", which.word()), &response);
            if response.clicked() {
                mode = which;
            }
        }
    });
    mark(model, "mode", &response.response);
    if mode != model.mode {
        (model.mode, model.range) = (mode, None);
    }
    let Some(coloring) = model.coloring() else { return };
    let legend = coloring.legend.clone();
    if coloring.mode != mode {
        ui.weak(format!("Nothing has this; shown by {}", shown(coloring.mode)));
    }
    let classes = coloring.mode == ColorMode::Class;
    show_legend(ui, model, &legend, classes);
}

fn show_legend(ui: &mut Ui, model: &mut Model, legend: &Legend, classes: bool) {
    match &legend.key {
        LegendKey::Recorded => {}
        LegendKey::Ramp { colors, low, high } => {
            let (rect, _) = ui.allocate_exact_size(vec2(ui.available_width(), 16.0), Sense::hover());
            let width = rect.width() / colors.len().max(1) as f32;
            for (i, color) in colors.iter().enumerate() {
                let left = rect.left() + width * i as f32;
                // A hair wider, so that nothing shows between two.
                let step = egui::Rect::from_min_size(egui::pos2(left, rect.top()), vec2(width + 0.6, rect.height()));
                ui.painter().rect_filled(step.intersect(rect), 0.0, opaque(*color));
            }
            let (mut from, mut to) = (*low, *high);
            let speed = ((to - from).abs() * 0.005).max(1e-9);
            ui.horizontal(|ui| {
                let changed = ui.add(egui::DragValue::new(&mut from).speed(speed)).changed();
                let changed = ui.add(egui::DragValue::new(&mut to).speed(speed)).changed() || changed;
                if changed && from < to {
                    model.range = Some([from, to]);
                }
                if ui.small_button("reset").clicked() {
                    model.range = None;
                }
            });
        }
        LegendKey::Entries(entries) => {
            for entry in entries {
                ui.horizontal(|ui| {
                    let (rect, _) = ui.allocate_exact_size(vec2(14.0, 14.0), Sense::hover());
                    ui.painter().rect_filled(rect, 3.0, opaque(entry.color));
                    if classes {
                        let mut on = !model.classes_off.contains(&entry.number);
                        let response = ui.checkbox(&mut on, format!("{} {}", entry.number, entry.name));
                        mark(model, format!("class.{}", entry.number), &response);
                        if response.changed() {
                            if on {
                                model.classes_off.remove(&entry.number);
                            } else {
                                model.classes_off.insert(entry.number);
                            }
                        }
                    } else {
                        ui.label(&entry.name);
                    }
                });
            }
        }
    }
    if !classes && !model.classes_off.is_empty() {
        ui.horizontal(|ui| {
            ui.weak(format!("{} classes are off", model.classes_off.len()));
            if ui.small_button("all on").clicked() {
                model.classes_off.clear();
            }
        });
    }
}

fn opaque([red, green, blue, _]: [u8; 4]) -> Color32 {
    Color32::from_rgb(red, green, blue)
}

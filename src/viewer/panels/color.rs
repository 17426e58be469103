//! What colours show, and what they mean.

use super::super::model::Model;
use super::mark;
use crate::render::{ColorMode, Legend, LegendKey};
use egui::{Color32, Sense, Ui, vec2};

pub(super) fn show(ui: &mut Ui, model: &mut Model) {
    let mut mode = model.mode;
    let seen = model.coloring().map_or(mode, |coloring| coloring.mode);
    let shown = |mode: ColorMode| match mode {
        ColorMode::Rgb => "recorded colours",
        ColorMode::Time => "GPS time",
        ColorMode::Level => "level of detail",
        other => other.word(),
    };
    let response = egui::ComboBox::from_id_salt("mode").selected_text(shown(seen)).show_ui(ui, |ui| {
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
        ui.weak(format!("There is nothing to show as {}", shown(mode)));
    }
    let classes = coloring.mode == ColorMode::Class;
    show_legend(ui, model, &legend, classes);
}

fn show_legend(ui: &mut Ui, model: &mut Model, legend: &Legend, classes: bool) {
    match &legend.key {
        LegendKey::Recorded => {}
        LegendKey::Ramp { colors, low, high } => {
            let (rect, _) = ui.allocate_exact_size(vec2(ui.available_width(), 16.0), Sense::hover());
            let mut mesh = egui::Mesh::default();
            let last = colors.len().saturating_sub(1).max(1) as f32;
            for (i, color) in (0_u32..).zip(colors) {
                let x = rect.left() + rect.width() * i as f32 / last;
                mesh.colored_vertex(egui::pos2(x, rect.top()), opaque(*color));
                mesh.colored_vertex(egui::pos2(x, rect.bottom()), opaque(*color));
                if i > 0 {
                    mesh.add_triangle(2 * i - 2, 2 * i - 1, 2 * i);
                    mesh.add_triangle(2 * i - 1, 2 * i, 2 * i + 1);
                }
            }
            ui.painter().add(mesh);
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
            ui.weak(match model.classes_off.len() {
                1 => "1 class is off".to_owned(),
                several => format!("{several} classes are off"),
            });
            if ui.small_button("all on").clicked() {
                model.classes_off.clear();
            }
        });
    }
}

fn opaque([red, green, blue, _]: [u8; 4]) -> Color32 {
    Color32::from_rgb(red, green, blue)
}

//! All that mouse and keys do.

use super::super::bindings::{Command, HELP};
use super::super::model::Model;
use egui::{Align2, Color32, Context, RichText};

const KEYS: Color32 = Color32::from_rgb(255, 214, 90);

pub(super) fn show(context: &Context, model: &mut Model, aspect: f64) {
    let mut open = true;
    egui::Window::new("Mouse and keys")
        .open(&mut open)
        .anchor(Align2::CENTER_CENTER, [0.0, 0.0])
        .collapsible(false)
        .resizable(false)
        .show(context, |ui| {
            for (title, lines) in HELP {
                ui.add_space(4.0);
                ui.label(RichText::new(*title).strong());
                egui::Grid::new(*title).num_columns(2).min_col_width(160.0).spacing([12.0, 3.0]).show(ui, |ui| {
                    for line in *lines {
                        ui.label(RichText::new(line.keys).monospace().color(KEYS));
                        ui.label(line.does);
                        ui.end_row();
                    }
                });
            }
            ui.add_space(6.0);
            ui.weak("Point at something to see where it is; click it to see all that is stored of it.");
        });
    if !open {
        model.command(Command::Help, aspect);
    }
}

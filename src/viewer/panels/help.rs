//! All that mouse and keys do, and what comes first of it.

use super::super::bindings::{Command, HELP, hint};
use super::super::model::Model;
use super::{bar, mark};
use egui::{Color32, Context, Rect, RichText, TextStyle, Ui};

const KEYS: Color32 = Color32::from_rgb(255, 214, 90);

/// The line below the picture, until it is closed or the whole help has been opened.
pub(super) fn first_steps(ui: &mut Ui, model: &mut Model) {
    if model.set.knows_help {
        return;
    }
    egui::Panel::bottom("hint").frame(bar(ui)).show(ui, |ui| {
        ui.horizontal(|ui| {
            let response = ui.small_button("\u{d7}").on_hover_text("Enough of this line");
            mark(model, "hint.close", &response);
            if response.clicked() {
                model.set.knows_help = true;
            }
            let font = TextStyle::Body.resolve(ui.style());
            let gap = ui.spacing().item_spacing.x;
            for line in hint(model.nav.rig.mode) {
                let width = |text: &str| ui.painter().layout_no_wrap(text.to_owned(), font.clone(), KEYS).size().x;
                // What a narrow window has no room for is in the help.
                if width(line.keys) + width(line.does) + 3.0 * gap > ui.available_width() {
                    break;
                }
                ui.label(RichText::new(line.keys).color(KEYS));
                ui.label(line.does);
                ui.add_space(gap);
            }
        });
    });
}

/// All of it, beside as much of the picture as there is room for: `free` is what the panels leave.
pub(super) fn show(context: &Context, model: &mut Model, free: Rect, aspect: f64) {
    let mut open = true;
    egui::Window::new("Mouse and keys")
        .open(&mut open)
        .fixed_pos(free.min + egui::vec2(8.0, 8.0))
        .max_height((free.height() - 60.0).max(80.0))
        .vscroll(true)
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

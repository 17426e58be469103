//! Bookmarks that are kept in the store, and the places of scanners.

use super::super::bindings::Command;
use super::super::model::{Action, Model};
use super::mark;
use egui::Ui;

pub(super) fn show(ui: &mut Ui, model: &mut Model, aspect: f64) {
    ui.horizontal(|ui| {
        let field = egui::TextEdit::singleline(&mut model.bookmark_name).hint_text("name").desired_width(130.0);
        let response = ui.add(field);
        mark(model, "bookmark.name", &response);
        let entered = response.lost_focus() && ui.input(|input| input.key_pressed(egui::Key::Enter));
        let response = ui.button("Keep this view").on_hover_text("In the store, for everybody (B)");
        mark(model, "bookmark.save", &response);
        if response.clicked() || entered {
            model.command(Command::Bookmark, aspect);
        }
    });
    let Some(site) = &model.site else { return };
    let bookmarks = site.bookmarks.clone();
    let stations: Vec<_> = site.stations().map(|(name, place)| (name.to_owned(), place)).collect();
    for (name, camera) in bookmarks {
        // From the right, so that a long name is cut and nothing is pushed out.
        let row = egui::vec2(ui.available_width(), ui.spacing().interact_size.y);
        ui.allocate_ui_with_layout(row, egui::Layout::right_to_left(egui::Align::Center), |ui| {
            let response = ui.small_button("remove");
            mark(model, format!("bookmark.remove.{name}"), &response);
            if response.clicked() {
                model.actions.push(Action::RemoveBookmark(name.clone()));
            }
            ui.with_layout(egui::Layout::left_to_right(egui::Align::Center), |ui| {
                let response = ui.add(egui::Button::new(&name).truncate()).on_hover_text(&name);
                mark(model, format!("bookmark.{name}"), &response);
                if response.clicked() {
                    model.nav.rig.fly_to(&camera);
                }
            });
        });
    }
    if !stations.is_empty() {
        ui.separator();
        ui.weak("Scanner positions");
        egui::ScrollArea::vertical().id_salt("stations").max_height(160.0).show(ui, |ui| {
            for (name, place) in stations {
                let response = ui.button(&name);
                mark(model, format!("station.{name}"), &response);
                if response.clicked() {
                    model.stand_at(&name, place);
                }
            }
        });
    }
}

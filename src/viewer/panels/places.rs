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
        let response = ui.button("Keep this view").on_hover_text("In the store, for everybody (B)");
        mark(model, "bookmark.save", &response);
        if response.clicked() {
            model.command(Command::Bookmark, aspect);
        }
    });
    let Some(site) = &model.site else { return };
    let bookmarks = site.bookmarks.clone();
    let stations: Vec<_> = site.stations().map(|(name, place)| (name.to_owned(), place)).collect();
    for (name, camera) in bookmarks {
        ui.horizontal(|ui| {
            let response = ui.button(&name);
            mark(model, format!("bookmark.{name}"), &response);
            if response.clicked() {
                model.nav.rig.fly_to(&camera);
            }
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                let response = ui.small_button("remove");
                mark(model, format!("bookmark.remove.{name}"), &response);
                if response.clicked() {
                    model.actions.push(Action::RemoveBookmark(name.clone()));
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

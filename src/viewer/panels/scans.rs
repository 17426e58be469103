//! Which scans are seen, and which of their points.

use super::super::model::{Action, Model};
use super::{counted, mark};
use egui::Ui;

pub(super) fn show(ui: &mut Ui, model: &mut Model) {
    let Some(site) = &model.site else {
        ui.spinner();
        return;
    };
    let scans = site.scans.clone();
    let total = site.points;
    ui.horizontal(|ui| {
        if ui.small_button("All").clicked() {
            scans.iter().for_each(|s| model.scans.set(s.id, s.visible, true));
        }
        if ui.small_button("None").clicked() {
            scans.iter().for_each(|s| model.scans.set(s.id, s.visible, false));
        }
        if ui.small_button("As stored").on_hover_text("As `esker show` and `esker hide` left them").clicked() {
            model.scans = Default::default();
        }
        ui.weak(format!("{}, {}", counted(scans.len() as u64, "scan"), counted(total, "point")));
    });
    egui::ScrollArea::vertical().id_salt("scans").max_height(260.0).show(ui, |ui| {
        for scan in &scans {
            ui.horizontal(|ui| {
                let mut seen = model.scans.sees(scan.id, scan.visible);
                let response = ui.checkbox(&mut seen, "");
                mark(model, format!("scan.{}", scan.name), &response);
                if response.changed() {
                    model.scans.set(scan.id, scan.visible, seen);
                }
                ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                    if ui.small_button("only").on_hover_text("This scan alone").clicked() {
                        scans.iter().for_each(|s| model.scans.set(s.id, s.visible, s.id == scan.id));
                    }
                    if let Some(place) = scan.station
                        && ui.small_button("stand").on_hover_text("Stand where the scanner stood").clicked()
                    {
                        model.stand_at(&scan.name, place);
                    }
                    // What is left is the name's, however long.
                    ui.with_layout(egui::Layout::left_to_right(egui::Align::Center), |ui| {
                        let name = ui.add(egui::Label::new(&scan.name).truncate());
                        name.on_hover_text(format!("{}: {}", scan.name, counted(scan.points, "point")));
                    });
                });
            });
        }
    });
    show_filter(ui, model);
}

/// A field for a filter, as `esker query --where` takes it.
fn show_filter(ui: &mut Ui, model: &mut Model) {
    ui.horizontal(|ui| {
        ui.label("Only");
        let field =
            egui::TextEdit::singleline(&mut model.filter_text).hint_text("Intensity > 1000").desired_width(130.0);
        let response =
            ui.add(field).on_hover_text("Points for which this is true, as `esker query --where` takes it; Enter");
        mark(model, "filter", &response);
        let entered = response.lost_focus() && ui.input(|input| input.key_pressed(egui::Key::Enter));
        let response = ui.small_button("show");
        mark(model, "filter.set", &response);
        if entered || response.clicked() {
            match model.filter_text.trim() {
                "" => model.filter = None,
                text => model.actions.push(Action::Filter(text.to_owned())),
            }
        }
        let response = ui.small_button("all");
        mark(model, "filter.clear", &response);
        if response.clicked() {
            (model.filter, model.filter_text) = (None, String::new());
        }
    });
    if let Some(filter) = &model.filter {
        ui.weak(format!("Shown: {filter}"));
    }
}

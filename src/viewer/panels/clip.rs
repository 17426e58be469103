//! Boxes that keep or cut out points, and the way of their points to a file.

use super::super::model::{Action, Model};
use super::mark;
use egui::{DragValue, Ui};
use std::path::PathBuf;

pub(super) fn show(ui: &mut Ui, model: &mut Model) {
    let response = ui.button("Add a box here").on_hover_text("Around the clicked point, or what is looked at");
    mark(model, "clip.add", &response);
    if response.clicked() {
        model.add_clip();
    }
    let mut gone = None;
    let mut export = None;
    let mut clips = std::mem::take(&mut model.clips);
    for (i, clip) in clips.iter_mut().enumerate() {
        ui.separator();
        ui.horizontal(|ui| {
            ui.checkbox(&mut clip.on, format!("box {}", i + 1));
            ui.selectable_value(&mut clip.keep, true, "keep");
            ui.selectable_value(&mut clip.keep, false, "cut out");
            if ui.small_button("remove").clicked() {
                gone = Some(i);
            }
        });
        let speed = (0..3).map(|a| (clip.max[a] - clip.min[a]).abs()).fold(0.0, f64::max).max(1e-6) * 0.005;
        egui::Grid::new(("clip", i)).show(ui, |ui| {
            for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
                ui.label(name);
                ui.add(DragValue::new(&mut clip.min[axis]).speed(speed).max_decimals(3));
                ui.add(DragValue::new(&mut clip.max[axis]).speed(speed).max_decimals(3));
                ui.end_row();
            }
        });
        ui.horizontal(|ui| {
            let hint = "All points of the store in this box, of the scans that are seen, at full detail";
            let ready = clip.bounds().is_some();
            let response = ui.add_enabled(ready, egui::Button::new("Export")).on_hover_text(hint);
            mark(model, format!("clip.export.{}", i + 1), &response);
            if response.clicked() {
                export = clip.bounds();
            }
            ui.text_edit_singleline(&mut model.export_path).on_hover_text("A file ending in .laz or .las");
        });
    }
    if let Some(gone) = gone {
        clips.remove(gone);
    }
    model.clips = clips;
    if let Some(bounds) = export {
        let path = model.export_path.trim();
        let path = if path.is_empty() { "clip.laz" } else { path };
        model.actions.push(Action::Export(bounds, PathBuf::from(path)));
    }
}

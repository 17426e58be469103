//! Boxes that keep or cut out points, and the way of their points to a file.

use super::super::model::{Action, Model};
use super::mark;
use egui::{DragValue, Ui};
use std::path::PathBuf;

pub(super) fn show(ui: &mut Ui, model: &mut Model, aspect: f64) {
    let response = ui.button("Add a box here").on_hover_text("Around the clicked point, or what is looked at");
    mark(model, "clip.add", &response);
    if response.clicked() {
        model.add_clip(aspect);
    }
    let mut gone = None;
    let mut export = None;
    let decimals = model.decimals();
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
        let mut changed = false;
        let speed = (0..3).map(|a| (clip.max[a] - clip.min[a]).abs()).fold(0.0, f64::max).max(1e-6) * 0.005;
        egui::Grid::new(("clip", i)).show(ui, |ui| {
            for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
                ui.label(name);
                let min = ui.add(DragValue::new(&mut clip.min[axis]).speed(speed).fixed_decimals(decimals));
                let max = ui.add(DragValue::new(&mut clip.max[axis]).speed(speed).fixed_decimals(decimals));
                changed |= min.changed() || max.changed();
                ui.end_row();
            }
        });
        if changed {
            clip.round(decimals);
        }
        ui.horizontal(|ui| {
            let hint = "All points of the store in this box, of the scans and classes that are on, at full detail";
            let ready = clip.bounds().is_some();
            let response = ui.add_enabled(ready, egui::Button::new("Export")).on_hover_text(hint);
            mark(model, format!("clip.export.{}", i + 1), &response);
            if response.clicked() {
                export = clip.bounds();
            }
            let field = egui::TextEdit::singleline(&mut model.export_path).hint_text("clip.laz");
            let words = "A file that ends in .laz, .las, .ply or .csv; clip.laz if this is empty";
            let response = ui.add(field).on_hover_text(words);
            mark(model, format!("clip.path.{}", i + 1), &response);
        });
    }
    if let Some(gone) = gone {
        clips.remove(gone);
    }
    model.clips = clips;
    if let Some(bounds) = export {
        let path = model.export_path.trim();
        let path = if path.is_empty() { free_name() } else { PathBuf::from(path) };
        model.actions.push(Action::Export(bounds, path));
    }
}

/// Where no name was typed: a second box does not stop at the first one's file.
fn free_name() -> PathBuf {
    let numbered = |i: u32| PathBuf::from(if i < 2 { "clip.laz".into() } else { format!("clip-{i}.laz") });
    // If all are taken, the last one's writer says so.
    (1..1000).map(numbered).find(|path| !path.exists()).unwrap_or_else(|| numbered(1000))
}

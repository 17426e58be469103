//! What is drawn and what it costs.

use super::super::model::Model;
use super::{bytes, counted, grouped};
use egui::Ui;
use std::time::Duration;

pub(super) fn show(ui: &mut Ui, model: &mut Model) {
    let (status, times) = (&model.status, &model.times);
    let ms = |d: Duration| format!("{:.1} ms", d.as_secs_f64() * 1e3);
    let later = |d: Option<Duration>| d.map_or_else(|| "not yet".to_owned(), ms);
    let error = match (status.error, status.error_px) {
        (Some(e), Some(px)) => format!("{e:.3} ({px:.2} pixels)"),
        _ => "not known".to_owned(),
    };
    let rows = [
        ("points", grouped(status.points)),
        ("of", model.site.as_ref().map_or_else(String::new, |s| grouped(s.points))),
        ("nodes", grouped(status.nodes)),
        ("error bound", error),
        ("loading", format!("{}, {}", counted(status.loading, "part"), counted(status.missing_points, "point"))),
        ("read", bytes(status.read_bytes)),
        ("uploaded", bytes(status.uploaded_bytes)),
        ("on the adapter", format!("{} of {}", bytes(status.pool_used_bytes), bytes(status.pool_bytes))),
        ("selection", ms(status.select_time)),
        ("last view complete in", ms(status.complete_time)),
        ("frame, this thread", ms(times.work)),
        ("frame to frame", ms(times.interval)),
        ("start to the adapter", later(times.adapter)),
        ("start to a picture", later(times.first_picture)),
        ("start to the whole one", later(times.first_complete)),
        ("generation", status.generation.to_string()),
        ("adapter", model.adapter.clone()),
    ];
    egui::Grid::new("statistics").num_columns(2).striped(true).show(ui, |ui| {
        for (name, value) in rows {
            ui.label(name);
            ui.add(egui::Label::new(value).wrap());
            ui.end_row();
        }
    });
}

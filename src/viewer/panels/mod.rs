//! The panels: each section shows a piece of the [`Model`] and changes it.

mod clip;
mod color;
mod help;
mod overlay;
mod places;
mod point;
mod quality;
mod scans;
mod statistics;

use super::bindings::Command;
use super::model::{Model, Section};
use super::rig::Mode;
use crate::geometry::ImageArea;
use egui::{Align2, Color32, RichText, Ui};

/// All of the window's widgets for one frame; `aspect` is that of the picture, `ui` covers it.
pub fn show(ui: &mut Ui, model: &mut Model, aspect: f64) {
    model.widgets.clear();
    top(ui, model, aspect);
    bottom(ui, model);
    help::first_steps(ui, model);
    if model.set.panels {
        egui::Panel::right("panels").frame(bar(ui)).default_size(290.0).size_range(220.0..=520.0).show(ui, |ui| {
            egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
                for section in Section::ALL {
                    show_section(ui, model, section, aspect);
                }
            });
        });
    }
    let (all, free) = (ui.ctx().content_rect(), ui.available_rect_before_wrap());
    let part = |at: egui::Pos2| {
        [(at.x - all.min.x) / all.width(), (at.y - all.min.y) / all.height()].map(|p| f64::from(p).clamp(0.0, 1.0))
    };
    model.set_free_area(ImageArea::new(part(free.min), part(free.max)), aspect);
    overlay::show(ui, model, aspect, free);
    if model.help {
        help::show(ui.ctx(), model, free, aspect);
    }
}

/// What lies behind the panels' widgets: the picture shines through a little.
fn bar(ui: &Ui) -> egui::Frame {
    egui::Frame::side_top_panel(ui.style()).fill(Color32::from_rgba_unmultiplied(24, 27, 33, 238))
}

/// Remembers where a widget is, so that a script can click it.
fn mark(model: &mut Model, name: impl Into<String>, response: &egui::Response) {
    let center = response.rect.center();
    model.widgets.insert(name.into(), [center.x, center.y]);
}

fn show_section(ui: &mut Ui, model: &mut Model, section: Section, aspect: f64) {
    let open = model.open.contains(&section);
    let header = egui::CollapsingHeader::new(RichText::new(section.title()).strong())
        .id_salt(section.word())
        .open(Some(open))
        .show(ui, |ui| match section {
            Section::Scans => scans::show(ui, model),
            Section::Color => color::show(ui, model),
            Section::Quality => quality::show(ui, model),
            Section::Clip => clip::show(ui, model, aspect),
            Section::Measure => point::measure(ui, model),
            Section::Places => places::show(ui, model, aspect),
            Section::Point => point::show(ui, model),
            Section::Statistics => statistics::show(ui, model),
        });
    mark(model, section.word(), &header.header_response);
    if header.header_response.clicked() {
        if open {
            model.open.remove(&section);
        } else {
            model.open.insert(section);
        }
    }
}

/// Buttons for what one does all the time.
fn top(ui: &mut Ui, model: &mut Model, aspect: f64) {
    egui::Panel::top("top").frame(bar(ui)).show(ui, |ui| {
        ui.horizontal(|ui| {
            let mode = model.nav.rig.mode;
            for (which, text, hint) in [
                (Mode::Orbit, "Orbit", "Drag to turn, right drag to move, wheel to zoom (Esc)"),
                (Mode::Fly, "Fly", "W A S D to move, drag to look, wheel for speed"),
                (Mode::Walk, "Walk", "As flying, on the ground (G)"),
            ] {
                let response = ui.selectable_label(mode == which, text).on_hover_text(hint);
                mark(model, format!("mode.{}", text.to_lowercase()), &response);
                if response.clicked() {
                    model.set_mode(which);
                }
            }
            ui.separator();
            for (name, text, hint, command) in [
                ("fit", "Fit", "See everything (F)", Command::Fit),
                ("top", "Top", "From above (1)", Command::Top),
                ("front", "Front", "From the south (2)", Command::Front),
                ("side", "Side", "From the east (3)", Command::Side),
            ] {
                let response = ui.button(text).on_hover_text(hint);
                mark(model, name, &response);
                if response.clicked() {
                    model.command(command, aspect);
                }
            }
            let parallel = model.nav.rig.is_orthographic();
            if ui.selectable_label(parallel, "Parallel").on_hover_text("Without perspective (O)").clicked() {
                model.command(Command::Orthographic, aspect);
            }
            ui.separator();
            let response = ui.selectable_label(model.measuring, "Measure").on_hover_text("Click points (M)");
            mark(model, "measuring", &response);
            if response.clicked() {
                model.command(Command::Measure, aspect);
            }
            let response = ui.button("Picture").on_hover_text("To a file (P)");
            mark(model, "picture", &response);
            if response.clicked() {
                model.command(Command::Screenshot, aspect);
            }
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                let response = ui.selectable_label(model.set.panels, "Panels").on_hover_text("Tab");
                mark(model, "panels", &response);
                if response.clicked() {
                    model.command(Command::Panels, aspect);
                }
                let response = ui.selectable_label(model.help, "Help").on_hover_text("All keys (F1)");
                mark(model, "help", &response);
                if response.clicked() {
                    model.command(Command::Help, aspect);
                }
            });
        });
    });
}

/// One line of what is going on.
fn bottom(ui: &mut Ui, model: &mut Model) {
    egui::Panel::bottom("bottom").frame(bar(ui)).show(ui, |ui| {
        ui.horizontal(|ui| {
            let status = &model.status;
            ui.label(counted(status.points, "point"));
            if status.missing_points > 0 {
                ui.spinner();
                ui.label(format!("{} more to come", grouped(status.missing_points)));
            } else if status.error_px == Some(0.0) {
                ui.label("all that is in view");
            } else if let Some(px) = status.error_px {
                ui.label(format!("within {px:.1} pixels"))
                    .on_hover_text("Every point of the site that lies in view has a drawn one so near");
            }
            if let Some(error) = &status.error_message {
                ui.colored_label(Color32::from_rgb(255, 150, 120), error);
            }
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                // Nothing is drawn anew while nothing changes, so frames a second would say little.
                ui.label(format!("{:.0} ms a frame", model.times.work.as_secs_f64() * 1e3));
                if let Some(found) = &model.hover {
                    let coordinates = found.world.to_array().map(|value| model.coordinate(value));
                    ui.label(RichText::new(coordinates.join("  ")).monospace());
                }
            });
        });
    });
    if let Some(words) = model.message() {
        // A long one takes lines, not the height of the window.
        let width = (ui.ctx().content_rect().width() * 0.6).clamp(120.0, 560.0);
        let area = egui::Area::new(egui::Id::unique("message")).anchor(Align2::CENTER_TOP, [0.0, 44.0]);
        area.default_width(width).show(ui.ctx(), |ui| {
            egui::Frame::popup(ui.style()).show(ui, |ui| {
                ui.set_max_width(width);
                ui.label(words);
            });
        });
    }
}

/// `1 234 567`, with thin gaps.
fn counted(n: u64, what: &str) -> String {
    format!("{} {what}{}", grouped(n), if n == 1 { "" } else { "s" })
}

/// `1234567` in groups of three digits, with thin spaces between them.
fn grouped(n: u64) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push('\u{2009}');
        }
        text.push(digit);
    }
    text
}

/// `12.3 MB`.
fn bytes(n: u64) -> String {
    match n {
        0..10_000 => format!("{n} B"),
        10_000..10_000_000 => format!("{:.0} kB", n as f64 / 1e3),
        _ => format!("{:.1} MB", n as f64 / 1e6),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::viewer::remembered::Remembered;

    #[test]
    fn numbers_are_grouped() {
        assert_eq!(grouped(1_234_567).replace('\u{2009}', " "), "1 234 567");
        assert_eq!((counted(1, "scan"), counted(20, "scan")), ("1 scan".into(), "20 scans".into()));
        assert_eq!((grouped(12), bytes(999), bytes(12_345_678)), ("12".into(), "999 B".into(), "12.3 MB".into()));
    }

    /// In a narrow window the line of first steps is one line: it grew over the picture.
    #[test]
    fn the_first_steps_are_one_line_however_narrow_the_window() {
        for width in [1600.0, 900.0, 500.0, 300.0] {
            let mut model = Model::new(Remembered::default());
            let context = egui::Context::default();
            for _ in 0..10 {
                let input = egui::RawInput {
                    screen_rect: Some(egui::Rect::from_min_size(egui::Pos2::ZERO, egui::vec2(width, 600.0))),
                    ..egui::RawInput::default()
                };
                context.run_ui(input, |ui| show(ui, &mut model, 1.5)).textures_delta.clear();
            }
            let [x, y] = model.widgets["hint.close"];
            assert!(x > 0.0 && x < 60.0 && y > 520.0, "{x} {y} in a window {width} wide");
        }
    }

    /// Every section is drawn, open and closed, without a store and without a window; a click opens one.
    #[test]
    fn the_panels_stand_without_a_store() {
        let mut model = Model::new(Remembered::default());
        let context = egui::Context::default();
        let input = |events| egui::RawInput {
            screen_rect: Some(egui::Rect::from_min_size(egui::Pos2::ZERO, egui::vec2(1200.0, 3000.0))),
            events,
            ..egui::RawInput::default()
        };
        let frame = |model: &mut Model, events| {
            // Nobody draws: textures are not wanted.
            context.run_ui(input(events), |ui| show(ui, model, 1.5)).textures_delta.clear();
        };
        model.open.clear();
        frame(&mut model, vec![]);
        let [x, y] = model.widgets["quality"];
        let at = egui::pos2(x, y);
        let button = |pressed| egui::Event::PointerButton {
            pos: at,
            button: egui::PointerButton::Primary,
            pressed,
            modifiers: egui::Modifiers::NONE,
        };
        frame(&mut model, vec![egui::Event::PointerMoved(at)]);
        frame(&mut model, vec![button(true)]);
        frame(&mut model, vec![button(false)]);
        assert!(model.open.contains(&Section::Quality), "a click opens a section");
        model.open.extend(Section::ALL);
        model.clips.push(super::super::model::Clip { min: [0.0; 3], max: [1.0; 3], keep: true, on: true });
        for _ in 0..30 {
            frame(&mut model, vec![]);
        }
        for name in ["budget", "clip.add", "bookmark.save", "help", "measuring", "hint.close"] {
            assert!(model.widgets.contains_key(name), "{name} is not there");
        }
    }
}

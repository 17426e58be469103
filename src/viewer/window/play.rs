//! A script's steps, in place of hands.

use super::{PATIENCE, Viewer};
use crate::viewer::ViewerError;
use crate::viewer::navigate::Button;
use crate::viewer::script::{At, Step};
use std::time::{Duration, Instant};
use winit::event_loop::ActiveEventLoop;

impl Viewer {
    /// Does the script's next step, if the one before has been drawn.
    pub(super) fn run_script(&mut self, events: &ActiveEventLoop) -> Result<(), ViewerError> {
        let Some(step) = self.options.script.get(self.step).cloned() else { return Ok(()) };
        // Two frames: the first brings the event, in the second all have seen what it changed.
        if self.open.is_none() || self.frame_number < self.step_frame + 2 {
            return self.check_patience(&step);
        }
        if !self.do_step(events, &step)? {
            return self.check_patience(&step);
        }
        self.step += 1;
        (self.step_since, self.step_frame) = (Instant::now(), self.frame_number);
        Ok(())
    }

    fn check_patience(&self, step: &Step) -> Result<(), ViewerError> {
        if self.step_since.elapsed() < PATIENCE {
            return Ok(());
        }
        Err(self.script_error(format!("{step:?} was waited for in vain: {:?}", self.model.status)))
    }

    fn script_error(&self, what: String) -> ViewerError {
        ViewerError::Script { step: self.step + 1, what }
    }

    /// Says whether the step is done.
    fn do_step(&mut self, events: &ActiveEventLoop, step: &Step) -> Result<bool, ViewerError> {
        match step {
            Step::WaitComplete => {
                let site = self.model.site.as_ref().is_some_and(|s| s.generation == self.model.status.generation);
                let picks = self.open.as_ref().is_some_and(|o| o.pick.is_none() && !o.pick_due);
                return Ok(site && picks && self.model.status.complete && !self.model.nav.is_moving());
            }
            Step::WaitPoints(points) => return Ok(self.model.status.points >= u64::from(*points)),
            Step::Wait(time) => return Ok(self.step_since.elapsed() >= *time),
            Step::Point(at) => {
                let place = match at {
                    At::Place(place) => *place,
                    At::Widget(name) => {
                        let place = self.model.widgets.get(name).copied();
                        place.ok_or_else(|| self.script_error(format!("there is no widget '{name}'")))?
                    }
                };
                self.tell_egui(egui::Event::PointerMoved(place.into()));
                let scale = f64::from(self.egui.pixels_per_point());
                self.pointer(place.map(|c| f64::from(c) * scale));
            }
            Step::Button(button, down) => {
                let pos = self.egui.input(|i| i.pointer.latest_pos()).unwrap_or_default();
                let which = match button {
                    Button::Left => egui::PointerButton::Primary,
                    Button::Middle => egui::PointerButton::Middle,
                    Button::Right => egui::PointerButton::Secondary,
                };
                let modifiers = egui::Modifiers::NONE;
                self.button(*button, *down);
                self.tell_egui(egui::Event::PointerButton { pos, button: which, pressed: *down, modifiers });
            }
            Step::Wheel(steps) => self.wheel(f64::from(*steps)),
            Step::Key(key, down) => self.key(*key, *down),
            Step::Text(text) => self.tell_egui(egui::Event::Text(text.clone())),
            Step::Size([width, height]) => {
                if *width == 0 || *height == 0 {
                    // What a window that is minimised is told, where that has no size.
                    self.resized([*width, *height]);
                } else if let Some(open) = &self.open {
                    let size = winit::dpi::PhysicalSize::new(*width, *height);
                    if open.window.request_inner_size(size).is_some() || open.window.inner_size() == size {
                        // There will be no event.
                        self.resized([*width, *height]);
                    }
                }
            }
            Step::Shot(path) => {
                let Some(open) = &mut self.open else { return Ok(false) };
                open.gpu.read()?.write_png(path, true)?;
            }
            Step::State => println!("{}", self.state()),
            Step::LoseSurface => {
                if let Some(open) = &mut self.open {
                    open.gpu.lose_surface();
                }
            }
            Step::LoseDevice => {
                if let Some(open) = &self.open {
                    open.gpu.lose();
                }
            }
            Step::Quit => events.exit(),
        }
        self.redraw();
        Ok(true)
    }

    fn tell_egui(&mut self, event: egui::Event) {
        if let Some(open) = &mut self.open {
            open.events.egui_input_mut().events.push(event);
        }
    }

    /// What a script can ask for.
    fn state(&self) -> serde_json::Value {
        let model = &self.model;
        let ms = |d: Option<Duration>| d.map(|d| d.as_secs_f64() * 1e3);
        let hover = model.hover.as_ref().map(|f| f.world.to_array());
        serde_json::json!({
            "points": model.status.points,
            "nodes": model.status.nodes,
            "generation": model.status.generation,
            "complete": model.status.complete,
            "error": model.status.error_message,
            "error_px": model.status.error_px,
            "mode": format!("{:?}", model.nav.rig.mode),
            "parallel": model.nav.rig.is_orthographic(),
            "color": model.mode.word(),
            "eye": model.nav.rig.eye().to_array(),
            "hover": hover,
            "picked": model.picked.as_ref().map(|f| f.values.clone()),
            "measured": model.measured.points().len(),
            "measured_length": model.measured.length(),
            "bookmarks": model.site.as_ref().map(|s| s.bookmarks.iter().map(|b| b.0.clone()).collect::<Vec<_>>()),
            "open": model.open.iter().map(|s| s.word()).collect::<Vec<_>>(),
            "edl": model.set.edl,
            "outlines_px": model.set.shadow_px,
            "haze": model.set.haze,
            "hidden_scans": model.scans.hidden.len(),
            "filter": model.filter.as_ref().map(|f| f.to_string()),
            "help": model.help,
            "hint": !model.set.knows_help,
            "clips": model.clips.len(),
            "size": self.open.as_ref().map(|o| o.gpu.size_px()),
            "presented": self.open.as_ref().map(|o| o.gpu.presented()),
            "message": model.message(),
            "adapter": model.adapter,
            "adapter_ms": ms(model.times.adapter),
            "first_picture_ms": ms(model.times.first_picture),
            "first_complete_ms": ms(model.times.first_complete),
            "complete_ms": ms(Some(model.status.complete_time)),
            "frame_ms": model.times.work.as_secs_f64() * 1e3,
            "uploaded_bytes": model.status.uploaded_bytes,
            "pool_bytes": model.status.pool_bytes,
        })
    }
}

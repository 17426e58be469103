//! One frame: what is new comes in, panels and points are drawn, what the panels want is done.

use super::pick::{Pick, flies};
use super::{GROUND_EVERY, Open, Viewer, dark_context};
use crate::geometry::Camera;
use crate::render::Image;
use crate::viewer::ViewerError;
use crate::viewer::gpu::{Panels, Picture};
use crate::viewer::model::{Action, Model};
use crate::viewer::panels;
use crate::viewer::rig::Mode;
use crate::viewer::site::ScanFacts;
use crate::viewer::work::{Job, News, Wanted};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use winit::window::Fullscreen;

impl Viewer {
    /// One frame.
    pub(super) fn frame(&mut self) -> Result<(), ViewerError> {
        let began = Instant::now();
        let elapsed = began - self.last_frame;
        self.last_frame = began;
        self.frame_number += 1;
        self.take_news();
        // A pause is not a leap.
        self.model.advance(elapsed.as_secs_f64().min(0.1));
        self.ask_for_ground();
        self.replace_lost_device()?;
        let aspect = self.aspect();
        let Some(open) = self.open.as_mut().filter(|open| open.has_size()) else { return Ok(()) };
        if let Some(words) = open.gpu.trouble() {
            self.model.tell(words);
        }
        self.model.status = open.stream.status();
        let panels = lay_out(open, &mut self.model, &self.egui, aspect);
        let model = &mut self.model;
        let Ok(camera) = model.nav.rig.camera(open.gpu.size_px()) else {
            // Too far out to be a camera: back to where there is something.
            model.fit(aspect);
            return Ok(());
        };
        let camera = match model.seen_bounds() {
            Some(bounds) => camera.reaching(&bounds),
            None => camera,
        };
        if model.site.is_some() {
            if let Some(shown) = model.shown() {
                open.stream.set_shown(&shown);
            }
            open.stream.set_limits(model.limits());
            open.stream.set_camera(&camera);
        }
        let (points, complete) = draw_points(open, model, &camera)?;
        let image = if std::mem::take(&mut self.picture_wanted) { Some(open.gpu.read()?) } else { None };
        open.gpu.draw_panels(&panels);
        open.gpu.present();
        open.follow_pick(model);
        if open.pick.is_none()
            && !open.pick_due
            && let Some(click) = self.clicked.take()
        {
            model.click(click, aspect);
        }

        let times = &mut model.times;
        if points > 0 {
            times.first_picture.get_or_insert_with(|| self.started.elapsed());
            if complete {
                times.first_complete.get_or_insert_with(|| self.started.elapsed());
            }
        }
        let smooth = |old: Duration, new: Duration| (old * 7 + new) / 8;
        times.work = smooth(times.work, began.elapsed());
        times.interval = smooth(times.interval, elapsed);
        if let Some(image) = image {
            self.save_picture(&image);
        }
        self.act();
        Ok(())
    }

    /// A lost device is replaced by a new one, with a stream that fills it again.
    fn replace_lost_device(&mut self) -> Result<(), ViewerError> {
        // The adapter tells of a loss when it is asked, so it is asked before anything is drawn.
        let Some(open) = self.open.take_if(|open| {
            open.gpu.poll();
            open.gpu.is_lost()
        }) else {
            return Ok(());
        };
        // The old one thinks that its letters are on the adapter.
        self.egui = dark_context(!self.options.script.is_empty());
        self.attach(open.window)?;
        self.model.tell("The graphics device was lost; here is a new one");
        Ok(())
    }

    fn take_news(&mut self) {
        while let Some(news) = self.worker.news() {
            match news {
                News::Site(site) => {
                    let aspect = self.aspect();
                    (self.site_generation, self.site_asked) = (site.generation, false);
                    self.model.set_site(*site, aspect);
                }
                News::Bookmarks(bookmarks) => {
                    if let Some(site) = &mut self.model.site {
                        site.bookmarks = bookmarks;
                    }
                }
                News::Filter(filter) => self.model.filter = Some(filter),
                News::Told(words) | News::Failed(words) => {
                    self.model.tell(words);
                    self.site_asked = false;
                }
                News::Ground(height) => self.model.nav.ground = height,
            }
        }
        // The stream has seen a newer generation than the panels know.
        let seen = self.model.status.generation;
        if seen > self.site_generation && !self.site_asked {
            self.site_asked = true;
            self.worker.ask(Job::Site);
        }
    }

    fn ask_for_ground(&mut self) {
        if self.model.nav.rig.mode != Mode::Walk {
            (self.model.nav.ground, self.ground_asked) = (None, None);
        } else if self.ground_asked.is_none_or(|then| then.elapsed() >= GROUND_EVERY) {
            self.ground_asked = Some(Instant::now());
            self.worker.ask_for_ground(self.model.nav.rig.eye());
        }
    }

    fn act(&mut self) {
        for action in std::mem::take(&mut self.model.actions) {
            match action {
                Action::Screenshot => {
                    self.picture_wanted = true;
                    self.redraw();
                }
                Action::SaveBookmark(name, camera) => self.worker.ask(Job::SaveBookmark(name, camera)),
                Action::Filter(text) => self.worker.ask(Job::Filter(text)),
                Action::RemoveBookmark(name) => self.worker.ask(Job::RemoveBookmark(name)),
                Action::Export(bounds, path) => {
                    let site = self.model.site.as_ref();
                    let seen = |s: &&ScanFacts| self.model.scans.sees(s.id, s.visible);
                    let scans = site
                        .map_or_else(Vec::new, |site| site.scans.iter().filter(seen).map(|s| s.name.clone()).collect());
                    let wanted = Wanted { bounds, scans, filter: self.model.shown_filter() };
                    self.model.tell(format!("Writing {} ...", path.display()));
                    self.worker.export(Box::new(wanted), path);
                }
                Action::FullScreen => {
                    if let Some(open) = &self.open {
                        let now = open.window.fullscreen().is_some();
                        open.window.set_fullscreen((!now).then_some(Fullscreen::Borderless(None)));
                    }
                }
            }
        }
    }

    /// To the next free name beside where the viewer was started.
    fn save_picture(&mut self, image: &Image) {
        let stem = Path::new(&self.options.name).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let free = (1..10_000).map(|i| PathBuf::from(format!("{stem}-{i:03}.png"))).find(|p| !p.exists());
        let Some(path) = free else { return self.model.tell("there are too many pictures here") };
        match image.write_png(&path, false) {
            Ok(()) => self.model.tell(format!("Picture: {}", path.display())),
            Err(error) => self.model.tell(error.to_string()),
        }
    }
}

/// The panels of this frame.
fn lay_out(open: &mut Open, model: &mut Model, egui: &egui::Context, aspect: f64) -> Panels {
    let input = open.events.take_egui_input(&open.window);
    let output = egui.run_ui(input, |ui| panels::show(ui, model, aspect));
    open.events.handle_platform_output(&open.window, output.platform_output);
    open.gpu.update_textures(output.textures_delta);
    open.over_points = open.pointer_inside && !egui.egui_wants_pointer_input();
    let jobs = egui.tessellate(output.shapes, output.pixels_per_point);
    Panels { jobs, pixels_per_point: output.pixels_per_point }
}

/// Draws the newest list, and asks for the point under the pointer if it is time; says how many points there are, and
/// whether these are all that were asked for.
fn draw_points(open: &mut Open, model: &mut Model, camera: &Camera) -> Result<(u64, bool), ViewerError> {
    let front = open.stream.front();
    if front.number != open.front_number {
        open.front_number = front.number;
        open.pick_due = true;
    }
    let (options, palette) = (model.options(), model.palette_for(front.list.paint));
    let (looking, pick) = (open.pick.is_some(), open.pick_place(model));
    let picture = Picture { list: &front.list, camera, options: &options, palette: &palette, pick };
    if let Some(request) = open.gpu.draw_points(&picture)? {
        open.pick = Some(Pick::asked(request, &front, flies(model)));
    }
    open.pick_due &= looking;
    Ok((front.list.points, front.list.complete))
}

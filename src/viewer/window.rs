//! The window's loop: events in, pictures out.

use super::ViewerError;
use super::bindings::Key;
use super::found::found;
use super::gpu::{Gpu, Panels, Picture};
use super::model::{Action, Found, Model};
use super::navigate::{Button, Click};
use super::panels;
use super::remembered::Remembered;
use super::rig::Mode;
use super::script::{At, Step};
use super::work::{Exporter, Job, News, Worker};
use crate::geometry::DVec3;
use crate::lattice::Lattice;
use crate::points::Batch;
use crate::render::{Image, PickRequest};
use crate::store::Store;
use crate::stream::gpu::DrawList;
use crate::stream::{Front, PickPlace, StoreSource, Stream, StreamError};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};
use winit::application::ApplicationHandler;
use winit::event::{ElementState, MouseButton, MouseScrollDelta, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy};
use winit::keyboard::{KeyCode, PhysicalKey};
use winit::window::{Fullscreen, Window, WindowId};

/// A frame is drawn so often even if nothing happens: spinners, messages that end.
const IDLE: Duration = Duration::from_millis(500);
/// A script's step is waited for no longer than this.
const PATIENCE: Duration = Duration::from_secs(120);
/// A walker's ground is asked for so often.
const GROUND_EVERY: Duration = Duration::from_millis(150);

/// What the viewer is started with.
pub struct Options {
    /// What is looked at.
    pub store: Store,
    /// What its positions mean.
    pub lattice: Lattice,
    /// Its name, for the window's title.
    pub name: String,
    /// Writes the points of a box to a file.
    pub exporter: Arc<Exporter>,
    /// Where settings are remembered; `None`: nowhere.
    pub remember: Option<PathBuf>,
    /// What a script does.
    pub script: Vec<Step>,
}

/// Something has happened elsewhere: look.
#[derive(Clone, Copy, Debug)]
struct Wake;

/// Opens the window, until it is closed.
///
/// # Errors
///
/// [`ViewerError`] if there is no display or no adapter, or a script waited in vain.
pub fn run(options: Options) -> Result<(), ViewerError> {
    let started = Instant::now();
    let window_error = |e: &dyn std::fmt::Display| ViewerError::Window(e.to_string());
    let events = EventLoop::<Wake>::with_user_event().build().map_err(|e| window_error(&e))?;
    let proxy = events.create_proxy();
    let set = options.remember.as_deref().map(Remembered::load).unwrap_or_default();
    let wake = waker(&proxy);
    let worker = Worker::spawn(options.store.clone(), options.exporter.clone(), wake)?;
    worker.ask(Job::Site);
    let model = Model::new(options.name.clone(), set);
    let egui = dark_context(!options.script.is_empty());
    let mut viewer = Viewer {
        options,
        proxy,
        worker,
        model,
        open: None,
        egui,
        started,
        last_frame: started,
        frame_number: 0,
        step: 0,
        step_since: started,
        step_frame: 0,
        site_generation: 0,
        site_asked: true,
        ground_asked: None,
        picture_wanted: false,
        clicked: None,
        failed: None,
    };
    events.run_app(&mut viewer).map_err(|e| window_error(&e))?;
    if let Some(path) = &viewer.options.remember {
        // What can't be remembered is no reason to fail.
        let _ = viewer.model.remembered().save(path);
    }
    match viewer.failed.take() {
        Some(error) => Err(error),
        None => Ok(()),
    }
}

/// `steady`: panels open at once, so that a script finds widgets where they were drawn.
fn dark_context(steady: bool) -> egui::Context {
    let context = egui::Context::default();
    context.set_theme(egui::Theme::Dark);
    if steady {
        context.all_styles_mut(|style| style.animation_time = 0.0);
    }
    context
}

fn waker(proxy: &EventLoopProxy<Wake>) -> impl Fn() + Send + Sync + 'static {
    let proxy = proxy.clone();
    move || {
        // A window that is closing needs no waking.
        let _ = proxy.send_event(Wake);
    }
}

/// A window with what draws into it.
struct Open {
    window: Arc<Window>,
    gpu: Gpu,
    stream: Stream,
    events: egui_winit::State,
    pick: Option<Pick>,
    /// The pointer is in the window.
    pointer_inside: bool,
    /// It is over the points, not over panels.
    over_points: bool,
    /// The pointer has moved, or the picture has changed, since the last pick.
    pick_due: bool,
    front_number: u64,
}

/// A point that is being looked up.
struct Pick {
    of_centre: bool,
    front: Front,
    stage: PickStage,
}

enum PickStage {
    OnAdapter(PickRequest),
    InStore(Receiver<Result<Batch, StreamError>>),
}

struct Viewer {
    options: Options,
    proxy: EventLoopProxy<Wake>,
    worker: Worker,
    model: Model,
    open: Option<Open>,
    egui: egui::Context,
    started: Instant,
    last_frame: Instant,
    frame_number: u64,
    /// The script's next step, since when it is waited for, and the frame that was drawn then.
    step: usize,
    step_since: Instant,
    step_frame: u64,
    /// The generation that the panels know.
    site_generation: u64,
    site_asked: bool,
    ground_asked: Option<Instant>,
    picture_wanted: bool,
    /// A click whose point is being looked up.
    clicked: Option<Click>,
    failed: Option<ViewerError>,
}

impl ApplicationHandler<Wake> for Viewer {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        if self.open.is_none()
            && let Err(error) = self.open_window(events)
        {
            self.fail(events, error);
        }
    }

    fn user_event(&mut self, _: &ActiveEventLoop, _: Wake) {
        self.redraw();
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(open) = &mut self.open else { return };
        let is_key = matches!(event, WindowEvent::KeyboardInput { .. } | WindowEvent::Ime(_));
        let typing = self.egui.text_edit_focused();
        // Keys are the picture's unless somebody types: Space must not press the button that was clicked last.
        if !is_key || typing {
            let response = open.events.on_window_event(&open.window, &event);
            if response.repaint {
                open.window.request_redraw();
            }
        }
        match event {
            WindowEvent::CloseRequested | WindowEvent::Destroyed => events.exit(),
            WindowEvent::RedrawRequested => {
                if let Err(error) = self.frame(events) {
                    self.fail(events, error);
                }
            }
            WindowEvent::Resized(size) => {
                open.gpu.resize([size.width, size.height]);
                if size.width > 0 && size.height > 0 {
                    let scale = open.window.scale_factor();
                    self.model.set.window = size.to_logical::<u32>(scale).into();
                }
                self.redraw();
            }
            WindowEvent::Focused(false) => self.model.nav.release_all(),
            WindowEvent::CursorMoved { position, .. } => self.pointer([position.x, position.y]),
            WindowEvent::CursorLeft { .. } => {
                open.pointer_inside = false;
                self.model.hover = None;
            }
            WindowEvent::MouseInput { state, button, .. } => {
                let button = match button {
                    MouseButton::Left => Button::Left,
                    MouseButton::Middle => Button::Middle,
                    MouseButton::Right => Button::Right,
                    _ => return,
                };
                self.button(button, state == ElementState::Pressed);
            }
            WindowEvent::MouseWheel { delta, .. } => {
                let steps = match delta {
                    MouseScrollDelta::LineDelta(_, y) => f64::from(y),
                    MouseScrollDelta::PixelDelta(by) => by.y / 50.0,
                };
                self.wheel(steps);
            }
            WindowEvent::KeyboardInput { event, .. } => {
                if let (PhysicalKey::Code(code), false) = (event.physical_key, typing)
                    && let Some(key) = key_of(code)
                    && !(event.repeat && event.state == ElementState::Pressed)
                {
                    self.key(key, event.state == ElementState::Pressed);
                }
            }
            _ => {}
        }
    }

    fn about_to_wait(&mut self, events: &ActiveEventLoop) {
        if let Err(error) = self.run_script(events) {
            return self.fail(events, error);
        }
        let waits_for_pick =
            self.clicked.is_some() || self.open.as_ref().is_some_and(|o| o.pick.is_some() || o.pick_due);
        let busy = self.model.nav.is_moving() || waits_for_pick || self.step < self.options.script.len();
        let flow = if busy {
            self.redraw();
            ControlFlow::WaitUntil(Instant::now() + Duration::from_millis(8))
        } else {
            if self.last_frame.elapsed() >= IDLE {
                self.redraw();
            }
            ControlFlow::WaitUntil(Instant::now() + IDLE)
        };
        events.set_control_flow(flow);
    }
}

impl Viewer {
    fn fail(&mut self, events: &ActiveEventLoop, error: ViewerError) {
        self.failed = Some(error);
        events.exit();
    }

    fn redraw(&self) {
        if let Some(open) = &self.open {
            open.window.request_redraw();
        }
    }

    fn open_window(&mut self, events: &ActiveEventLoop) -> Result<(), ViewerError> {
        let [width, height] = self.model.set.window;
        let attributes = Window::default_attributes()
            .with_title(format!("{} - Esker", self.options.name))
            .with_inner_size(winit::dpi::LogicalSize::new(width, height));
        let window = events.create_window(attributes).map_err(|e| ViewerError::Window(e.to_string()))?;
        self.attach(Arc::new(window))
    }

    /// Device, pool, stream and panels for a window: at the start, and again when the device was lost.
    fn attach(&mut self, window: Arc<Window>) -> Result<(), ViewerError> {
        let limits = self.model.limits();
        let (gpu, pool) = Gpu::new(window.clone(), &limits)?;
        let source = Arc::new(StoreSource::new(self.options.store.clone()));
        let coloring = self.model.shown();
        // Until the store is known nothing can be coloured: what comes first is shown by height.
        let shown = coloring.unwrap_or_else(super::model::plain_shown);
        let lattice = self.options.lattice.clone();
        let stream = Stream::spawn(source, pool, shown, limits, lattice, waker(&self.proxy))?;
        let context = self.egui.clone();
        let side = gpu.max_side_px() as usize;
        let events = egui_winit::State::new(context, egui::ViewportId::ROOT, &window, None, None, Some(side));
        self.model.adapter = gpu.adapter_name().to_owned();
        window.request_redraw();
        let (pick, front_number) = (None, 0);
        self.open = Some(Open {
            window,
            gpu,
            stream,
            events,
            pick,
            pointer_inside: false,
            over_points: false,
            pick_due: true,
            front_number,
        });
        Ok(())
    }

    fn aspect(&self) -> f64 {
        let [width, height] = self.open.as_ref().map_or([4, 3], |o| o.gpu.size_px());
        f64::from(width) / f64::from(height.max(1))
    }

    fn height_px(&self) -> f64 {
        self.open.as_ref().map_or(1.0, |o| f64::from(o.gpu.size_px()[1]))
    }

    fn under(&self) -> Option<DVec3> {
        self.model.hover.as_ref().map(|f| f.world)
    }

    fn pointer(&mut self, at: [f64; 2]) {
        let height = self.height_px();
        if let Some(open) = &mut self.open {
            open.pointer_inside = true;
            open.pick_due = true;
        }
        self.model.nav.point(at, height);
        self.redraw();
    }

    fn button(&mut self, button: Button, down: bool) {
        if down {
            if !self.egui.egui_wants_pointer_input() {
                // A field that was typed in gives the keys back.
                self.egui.memory_mut(|m| m.stop_text_input());
                let (at, under) = (self.model.nav.pointer(), self.under());
                self.model.nav.press(button, at, under);
            }
        } else {
            // What was clicked is known when the point under the pointer has been looked up.
            self.clicked = self.model.nav.release(button).or(self.clicked);
            if let Some(open) = &mut self.open {
                open.pick_due = true;
            }
        }
        self.redraw();
    }

    fn wheel(&mut self, steps: f64) {
        if !self.egui.egui_wants_pointer_input() {
            let under = self.under();
            self.model.nav.wheel(steps, under);
            self.redraw();
        }
    }

    fn key(&mut self, key: Key, down: bool) {
        let aspect = self.aspect();
        self.model.key(key, down, aspect);
        self.redraw();
    }

    /// One frame.
    fn frame(&mut self, events: &ActiveEventLoop) -> Result<(), ViewerError> {
        let began = Instant::now();
        let elapsed = began - self.last_frame;
        self.last_frame = began;
        self.frame_number += 1;
        self.take_news();
        // A pause is not a leap.
        self.model.advance(elapsed.as_secs_f64().min(0.1));
        self.ask_for_ground();
        // The adapter tells of a loss when it is asked, so it is asked before anything is drawn.
        self.open.iter().for_each(|o| o.gpu.poll());
        if self.open.as_ref().is_some_and(|o| o.gpu.is_lost()) {
            let window = self.open.take().map(|o| o.window);
            if let Some(window) = window {
                // The old one thinks that its letters are on the adapter.
                self.egui = dark_context(!self.options.script.is_empty());
                self.attach(window)?;
                self.model.tell("The graphics device was lost; here is a new one");
            }
        }
        let aspect = self.aspect();
        let Some(open) = &mut self.open else { return Ok(()) };
        let size = open.window.inner_size();
        if size.width == 0 || size.height == 0 {
            return Ok(());
        }
        if let Some(words) = open.gpu.trouble() {
            self.model.tell(words);
        }
        self.model.status = open.stream.status();

        let input = open.events.take_egui_input(&open.window);
        let model = &mut self.model;
        let output = self.egui.run_ui(input, |ui| panels::show(ui, model, aspect));
        open.events.handle_platform_output(&open.window, output.platform_output);
        open.gpu.update_textures(output.textures_delta);
        open.over_points = open.pointer_inside && !self.egui.egui_wants_pointer_input();
        let panels = Panels {
            jobs: self.egui.tessellate(output.shapes, output.pixels_per_point),
            pixels_per_point: output.pixels_per_point,
        };

        let Ok(camera) = model.nav.rig.camera(open.gpu.size_px()) else {
            // Too far out to be a camera: back to where there is something.
            if let Some(bounds) = model.seen_bounds() {
                model.nav.fit(&bounds, aspect);
            }
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

        let front = open.stream.front();
        if front.number != open.front_number {
            open.front_number = front.number;
            open.pick_due = true;
        }
        let (options, palette) = (model.options(), model.palette_for(front.list.paint));
        let (looking, pick) = (open.pick.is_some(), open.pick_place(model));
        let picture = Picture { list: &front.list, camera: &camera, options: &options, palette: &palette, pick };
        let asked = open.gpu.draw_points(&picture)?;
        let of_centre = flies(model);
        if let Some(request) = asked {
            let list = Arc::new(DrawList::empty(front.list.lattice.clone(), front.list.paint));
            open.pick =
                Some(Pick { of_centre, front: Front { list, ..front.clone() }, stage: PickStage::OnAdapter(request) });
        }
        open.pick_due &= looking;
        let (points, complete) = (front.list.points, front.list.complete);
        drop(front);
        let image = if std::mem::take(&mut self.picture_wanted) { Some(open.gpu.read()?) } else { None };
        open.gpu.draw_panels(&panels);
        open.gpu.present();
        open.follow_pick(model);
        if open.pick.is_none()
            && !open.pick_due
            && let Some(click) = self.clicked.take()
        {
            model.click(click);
        }

        let times = &mut model.times;
        if points > 0 {
            times.first_picture.get_or_insert_with(|| began - self.started);
            if complete {
                times.first_complete.get_or_insert_with(|| began - self.started);
            }
        }
        let smooth = |old: Duration, new: Duration| (old * 7 + new) / 8;
        times.work = smooth(times.work, began.elapsed());
        times.interval = smooth(times.interval, elapsed);
        if let Some(image) = image {
            self.save_picture(&image);
        }
        self.act(events);
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
                News::Told(words) => {
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
            self.worker.ask(Job::Ground(self.model.nav.rig.eye()));
        }
    }

    fn act(&mut self, _: &ActiveEventLoop) {
        for action in std::mem::take(&mut self.model.actions) {
            match action {
                Action::Screenshot => {
                    self.picture_wanted = true;
                    self.redraw();
                }
                Action::SaveBookmark(name, camera) => self.worker.ask(Job::SaveBookmark(name, camera)),
                Action::RemoveBookmark(name) => self.worker.ask(Job::RemoveBookmark(name)),
                Action::Export(bounds, path) => {
                    let site = self.model.site.as_ref();
                    let seen = |s: &&super::site::ScanFacts| self.model.scans.sees(s.id, s.visible);
                    let scans = site
                        .map_or_else(Vec::new, |site| site.scans.iter().filter(seen).map(|s| s.name.clone()).collect());
                    self.model.tell(format!("Writing {} ...", path.display()));
                    self.worker.ask(Job::Export(bounds, scans, path));
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

    /// Does the script's next step, if the one before has been drawn.
    fn run_script(&mut self, events: &ActiveEventLoop) -> Result<(), ViewerError> {
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
                if let Some(open) = &self.open {
                    let _ = open.window.request_inner_size(winit::dpi::PhysicalSize::new(*width, *height));
                }
            }
            Step::Shot(path) => {
                let Some(open) = &mut self.open else { return Ok(false) };
                open.gpu.read()?.write_png(path, true)?;
            }
            Step::State => println!("{}", self.state()),
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
            "eye": model.nav.rig.eye().to_array(),
            "hover": hover,
            "picked": model.picked.as_ref().map(|f| f.values.clone()),
            "measured": model.measured.points().len(),
            "measured_length": model.measured.length(),
            "bookmarks": model.site.as_ref().map(|s| s.bookmarks.iter().map(|b| b.0.clone()).collect::<Vec<_>>()),
            "open": model.open.iter().map(|s| s.word()).collect::<Vec<_>>(),
            "hidden_scans": model.scans.hidden.len(),
            "help": model.help,
            "clips": model.clips.len(),
            "size": self.open.as_ref().map(|o| o.gpu.size_px()),
            "message": model.message(),
            "adapter": model.adapter,
            "first_picture_ms": ms(model.times.first_picture),
            "first_complete_ms": ms(model.times.first_complete),
            "frame_ms": model.times.work.as_secs_f64() * 1e3,
            "uploaded_bytes": model.status.uploaded_bytes,
            "pool_bytes": model.status.pool_bytes,
        })
    }
}

/// Is what lies ahead of interest, and not what is under the pointer?
fn flies(model: &Model) -> bool {
    model.nav.rig.mode != Mode::Orbit && model.nav.is_moving()
}

impl Open {
    /// The pixel whose point is to be looked up in the next frame.
    fn pick_place(&self, model: &Model) -> Option<[u32; 2]> {
        let [width, height] = self.gpu.size_px();
        if self.pick.is_some() || model.nav.is_dragging() {
            return None;
        }
        if flies(model) {
            return Some([width / 2, height / 2]);
        }
        let at = model.nav.pointer();
        let inside = (0.0..f64::from(width)).contains(&at[0]) && (0.0..f64::from(height)).contains(&at[1]);
        (self.pick_due && self.over_points && inside).then(|| at.map(|c| c as u32))
    }

    /// Goes on with the point that is being looked up.
    fn follow_pick(&mut self, model: &mut Model) {
        if !self.over_points {
            model.hover = None;
        }
        let Some(pick) = &mut self.pick else { return };
        match &mut pick.stage {
            PickStage::OnAdapter(request) => match request.poll() {
                None => {}
                Some(None) => {
                    if !pick.of_centre {
                        model.hover = None;
                    }
                    self.pick = None;
                }
                Some(Some(place)) => {
                    let (cube, layer) = (place.cube, place.layer);
                    let at = PickPlace { cube, layer, part: place.part, index: place.index };
                    pick.stage = PickStage::InStore(self.stream.pick(&pick.front, at));
                }
            },
            PickStage::InStore(answer) => match answer.try_recv() {
                Err(std::sync::mpsc::TryRecvError::Empty) => {}
                Ok(Ok(batch)) => {
                    let found = model.site.as_ref().and_then(|site| found(&batch, site));
                    Self::point_found(model, found, pick.of_centre);
                    self.pick = None;
                }
                Ok(Err(_)) | Err(std::sync::mpsc::TryRecvError::Disconnected) => self.pick = None,
            },
        }
    }

    fn point_found(model: &mut Model, found: Option<Found>, of_centre: bool) {
        let Some(found) = found else { return };
        let depth = (found.world - model.nav.rig.eye()).dot(model.nav.rig.forward());
        if of_centre {
            // Speed follows the distance to what is looked at.
            model.nav.rig.set_distance(depth);
        } else {
            model.hover = Some(found);
        }
    }
}

/// The key at this place.
fn key_of(code: KeyCode) -> Option<Key> {
    Some(match code {
        KeyCode::KeyW => Key::W,
        KeyCode::KeyA => Key::A,
        KeyCode::KeyS => Key::S,
        KeyCode::KeyD => Key::D,
        KeyCode::KeyQ => Key::Q,
        KeyCode::KeyE => Key::E,
        KeyCode::KeyF => Key::F,
        KeyCode::KeyG => Key::G,
        KeyCode::KeyH => Key::H,
        KeyCode::KeyL => Key::L,
        KeyCode::KeyM => Key::M,
        KeyCode::KeyO => Key::O,
        KeyCode::KeyP => Key::P,
        KeyCode::KeyB => Key::B,
        KeyCode::KeyC => Key::C,
        KeyCode::KeyI => Key::I,
        KeyCode::Tab => Key::Tab,
        KeyCode::Space => Key::Space,
        KeyCode::ControlLeft | KeyCode::ControlRight => Key::Control,
        KeyCode::IntlBackslash => Key::Less,
        KeyCode::ShiftLeft | KeyCode::ShiftRight => Key::Shift,
        KeyCode::AltLeft | KeyCode::AltRight => Key::Alt,
        KeyCode::ArrowUp => Key::Up,
        KeyCode::ArrowDown => Key::Down,
        KeyCode::ArrowLeft => Key::Left,
        KeyCode::ArrowRight => Key::Right,
        KeyCode::Digit1 | KeyCode::Numpad1 => Key::Digit(1),
        KeyCode::Digit2 | KeyCode::Numpad2 => Key::Digit(2),
        KeyCode::Digit3 | KeyCode::Numpad3 => Key::Digit(3),
        KeyCode::F1 => Key::F1,
        KeyCode::F2 => Key::F2,
        KeyCode::F11 => Key::F11,
        KeyCode::Home => Key::Home,
        KeyCode::Escape => Key::Escape,
        KeyCode::Backspace => Key::Backspace,
        KeyCode::Delete => Key::Delete,
        _ => return None,
    })
}

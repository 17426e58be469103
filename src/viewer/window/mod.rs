//! The window's loop: events in, pictures out.

mod frame;
mod keys;
mod pick;
mod play;

use super::ViewerError;
use super::bindings::Key;
use super::gpu::Gpu;
use super::model::{Model, Start};
use super::navigate::{Button, Click};
use super::remembered::Remembered;
use super::rig::Mode;
use super::script::Step;
use super::work::{Exporter, Job, Worker};
use crate::geometry::DVec3;
use crate::lattice::Lattice;
use crate::store::Store;
use crate::stream::{StoreSource, Stream};
use keys::key_of;
use pick::Pick;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};
use winit::application::ApplicationHandler;
use winit::event::{ElementState, MouseButton, MouseScrollDelta, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy};
use winit::keyboard::{KeyCode, PhysicalKey};
use winit::window::{Window, WindowId};

/// A frame is drawn so often even if nothing happens: spinners, messages that end.
const IDLE: Duration = Duration::from_millis(500);
/// A script's step is waited for no longer than this.
const PATIENCE: Duration = Duration::from_secs(120);
/// A walker's ground is asked for so often.
const GROUND_EVERY: Duration = Duration::from_millis(150);

/// What the viewer is started with.
pub struct Options {
    /// When the program began: times to the first pictures count from here.
    pub started: Instant,
    /// What is looked at.
    pub store: Store,
    /// What its positions mean.
    pub lattice: Lattice,
    /// Its name, for the window's title.
    pub name: String,
    /// What is seen at first.
    pub start: Start,
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
    let started = options.started;
    let window_error = |e: &dyn std::fmt::Display| ViewerError::Window(without_place(&e.to_string()));
    let events = EventLoop::<Wake>::with_user_event().build().map_err(|e| window_error(&e))?;
    let proxy = events.create_proxy();
    let set = options.remember.as_deref().map(Remembered::load).unwrap_or_default();
    let wake = waker(&proxy);
    let worker = Worker::spawn(options.store.clone(), options.exporter.clone(), wake)?;
    worker.ask(Job::Site);
    let mut model = Model::new(set);
    model.begin(options.start.clone());
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
        control: false,
        clicked: None,
        failed: None,
    };
    events.run_app(&mut viewer).map_err(|e| window_error(&e))?;
    if let Some(path) = &viewer.options.remember {
        // What can't be remembered is no reason to fail.
        let _ = viewer.model.remembered().save(path);
    }
    let Viewer { worker, open, failed, .. } = viewer;
    // Gone before what was begun is waited for.
    drop(open);
    let not_done = worker.close();
    match failed {
        failed if !not_done.is_empty() => Err(ViewerError::NotDone(not_done.join("; "), failed.map(Box::new))),
        Some(error) => Err(error),
        None => Ok(()),
    }
}

/// `steady`: panels open at once, so that a script finds widgets where they were drawn.
fn dark_context(steady: bool) -> egui::Context {
    let context = egui::Context::default();
    context.set_theme(egui::Theme::Dark);
    // Text that is read for hours, on panels that let the picture shine through.
    context.all_styles_mut(|style| style.visuals.override_text_color = Some(egui::Color32::from_gray(222)));
    if steady {
        context.all_styles_mut(|style| style.animation_time = 0.0);
        // However slow the frames between a button's going down and up.
        context.options_mut(|options| options.input_options.max_click_duration = f64::INFINITY);
    }
    context
}

/// What winit says of the system's errors, without the place in its source before it.
fn without_place(text: &str) -> String {
    let behind = text.split_once(".rs:").and_then(|(_, rest)| rest.split_once(": "));
    behind.map_or(text, |(_, what)| what).trim_end_matches('.').to_owned()
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
    /// In pixels, as the window system told it.
    size: [u32; 2],
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

impl Open {
    fn has_size(&self) -> bool {
        self.size.iter().all(|&side| side > 0)
    }
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
    /// Is Ctrl held?
    control: bool,
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
                if let Err(error) = self.frame() {
                    self.fail(events, error);
                }
            }
            WindowEvent::Resized(size) => self.resized(size.into()),
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
                let down = event.state == ElementState::Pressed;
                let with_control = self.control && self.model.nav.rig.mode == Mode::Orbit;
                if let (PhysicalKey::Code(code), false) = (event.physical_key, typing)
                    && with_control
                    && down
                    && !matches!(code, KeyCode::ControlLeft | KeyCode::ControlRight)
                {
                    // What other programs do with it is not what the letter does here; all know how to quit.
                    if code == KeyCode::KeyQ {
                        events.exit();
                    }
                } else if let (PhysicalKey::Code(code), false) = (event.physical_key, typing)
                    && let Some(key) = key_of(code)
                    && !(event.repeat && down)
                {
                    self.key(key, down);
                }
            }
            WindowEvent::ModifiersChanged(modifiers) => self.control = modifiers.state().control_key(),
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
        self.model.times.adapter.get_or_insert_with(|| self.started.elapsed());
        window.request_redraw();
        let (pick, front_number) = (None, 0);
        self.open = Some(Open {
            size: window.inner_size().into(),
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

    /// The window has this size now; a minimised one may have none, and nothing is drawn then.
    fn resized(&mut self, size: [u32; 2]) {
        let Some(open) = &mut self.open else { return };
        open.size = size;
        open.gpu.resize(size);
        if open.has_size() {
            let scale = open.window.scale_factor();
            self.model.set.window = winit::dpi::PhysicalSize::<u32>::from(size).to_logical::<u32>(scale).into();
        }
        self.redraw();
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
}

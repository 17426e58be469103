//! Progress on stderr: a bar on a terminal, JSON lines for programs, nothing otherwise. And Ctrl-C.

use super::output;
use crate::ingest::{Progress, Stage};
use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// How progress is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(super) enum Mode {
    /// A bar if stderr is a terminal.
    #[default]
    Auto,
    /// One JSON object a line.
    Json,
    /// Nothing.
    None,
}

/// Progress of an ingest, and the wish to stop it.
pub(super) struct Shown {
    mode: Mode,
    bar: ProgressBar,
    stopped: Arc<AtomicBool>,
    state: Mutex<Option<(Stage, Instant)>>,
    total: AtomicU64,
    done: AtomicU64,
}

impl Shown {
    pub fn new(mode: Mode) -> Self {
        let stopped = Arc::new(AtomicBool::new(false));
        let flag = stopped.clone();
        // A second handler in one process can't be set; then Ctrl-C keeps its ordinary meaning, which is safe too.
        let _ = ctrlc::set_handler(move || flag.store(true, Ordering::SeqCst));
        let bar = bar("", true);
        if mode == Mode::Auto && std::io::stderr().is_terminal() {
            bar.set_draw_target(ProgressDrawTarget::stderr());
        }
        Self { mode, bar, stopped, state: Mutex::new(None), total: AtomicU64::new(0), done: AtomicU64::new(0) }
    }

    /// Takes the bar off the screen.
    pub fn clear(&self) {
        self.bar.finish_and_clear();
    }

    fn print(&self, stage: Stage) {
        let (done, total) = (self.done.load(Ordering::Relaxed), self.total.load(Ordering::Relaxed));
        output::tell!("{}", serde_json::json!({ "stage": stage.word(), "points": done, "total": total }));
    }
}

/// A bar for a stage of the work, which nobody sees before it is given somewhere to draw; `counted`: it is known how many points
/// there are.
pub(super) fn bar(stage: &'static str, counted: bool) -> ProgressBar {
    let bar = ProgressBar::no_length();
    bar.set_draw_target(ProgressDrawTarget::hidden());
    let template = match counted {
        true => "{msg:9} [{bar:32}] {human_pos}/{human_len} points  {rate}  {eta} left",
        false => "{msg:9} {human_pos} points read  {rate}  {elapsed}",
    };
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style.progress_chars("=> ").with_key("rate", rate));
    }
    bar.set_message(stage);
    bar
}

/// Points a second, whole ones.
fn rate(state: &ProgressState, out: &mut dyn std::fmt::Write) {
    // What the bar has no room for is not shown.
    let _ = write!(out, "{}/s", output::grouped(state.per_sec() as u64));
}

impl Progress for Shown {
    fn stage(&self, stage: Stage, total: u64) {
        self.bar.set_message(stage.word());
        self.bar.set_length(total);
        self.bar.reset();
        self.total.store(total, Ordering::Relaxed);
        self.done.store(0, Ordering::Relaxed);
        if let Ok(mut state) = self.state.lock() {
            *state = Some((stage, Instant::now()));
        }
        if self.mode == Mode::Json {
            self.print(stage);
        }
    }

    fn advance(&self, points: u64) {
        self.bar.inc(points);
        self.done.fetch_add(points, Ordering::Relaxed);
        if self.mode == Mode::Json
            && let Ok(mut state) = self.state.lock()
            && let Some((stage, last)) = state.as_mut()
            && last.elapsed() >= Duration::from_millis(500)
        {
            *last = Instant::now();
            self.print(*stage);
        }
    }

    fn say(&self, message: &str) {
        self.bar.suspend(|| output::tell!("esker: {}", output::clean(message)));
    }

    fn cancelled(&self) -> bool {
        self.stopped.load(Ordering::Relaxed)
    }
}

//! How far commands are that change nothing: a bar on a terminal once they take a while, JSON lines for programs.

use super::output;
use super::progress::{Mode, bar};
use anyhow::Context;
use clap::Args;
use indicatif::{ProgressBar, ProgressDrawTarget};
use std::io::IsTerminal;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// What is over sooner has no bar.
const PATIENCE: Duration = Duration::from_millis(300);

/// How often the bar moves.
const TICK: Duration = Duration::from_millis(100);

/// How often there is a line of JSON.
const LINE: Duration = Duration::from_millis(500);

/// The options of commands that read.
#[derive(Debug, Args)]
pub(super) struct Reading {
    /// Threads (default: one per core).
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// How to show progress on stderr.
    #[arg(long, value_enum, default_value_t = Mode::Auto)]
    pub progress: Mode,
}

impl Reading {
    /// The threads to work on.
    pub fn pool(&self) -> anyhow::Result<rayon::ThreadPool> {
        let threads = self.threads.map_or(0, usize::from);
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().context("starting threads failed")
    }
}

/// Shows how far the work is until it is dropped.
pub(super) struct Watching(Option<(Sender<()>, JoinHandle<()>)>);

impl Watching {
    /// Shows what `far` gives: points done, and how many there are, if that is known.
    pub fn new(mode: Mode, stage: &'static str, far: impl Fn() -> (u64, Option<u64>) + Send + 'static) -> Self {
        let (end, ended) = channel();
        // True once the work is done.
        let wait = move |time| !matches!(ended.recv_timeout(time), Err(RecvTimeoutError::Timeout));
        let show: Box<dyn FnOnce() + Send> = match mode {
            Mode::Json => Box::new(move || {
                let mut line = (0, None);
                loop {
                    let (points, total) = line;
                    output::tell!("{}", serde_json::json!({ "stage": stage, "points": points, "total": total }));
                    if wait(LINE) {
                        break;
                    }
                    line = far();
                }
            }),
            Mode::Auto if std::io::stderr().is_terminal() => Box::new(move || {
                if wait(PATIENCE) {
                    return;
                }
                let bars = [false, true].map(|counted| bar(stage, counted));
                let mut shown = None;
                loop {
                    let (points, total) = far();
                    let bar = &bars[usize::from(total.is_some())];
                    if let Some(total) = total {
                        bar.set_length(total.max(points));
                    }
                    bar.set_position(points);
                    // What it is becomes known while the work goes on.
                    if shown != Some(total.is_some()) {
                        if shown.is_some() {
                            bars[usize::from(total.is_none())].finish_and_clear();
                        }
                        bar.set_draw_target(ProgressDrawTarget::stderr());
                        shown = Some(total.is_some());
                    }
                    if wait(TICK) {
                        break;
                    }
                }
                bars.iter().for_each(ProgressBar::finish_and_clear);
            }),
            Mode::Auto | Mode::None => return Self(None),
        };
        // Without a thread for it nothing is shown.
        let thread = std::thread::Builder::new().name("progress".into()).spawn(show);
        Self(thread.ok().map(|thread| (end, thread)))
    }
}

impl Drop for Watching {
    fn drop(&mut self) {
        if let Some((end, thread)) = self.0.take() {
            drop(end);
            // What it shows is gone before the next line is printed.
            let _ = thread.join();
        }
    }
}

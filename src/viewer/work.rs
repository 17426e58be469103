//! What takes time and is not the stream's: reading what is known of the store, bookmarks, exports, the ground. One thread
//! does it, so that the window never waits.

use super::site::{Site, bookmarks};
use crate::geometry::{Camera, DVec3, WorldBox};
use crate::points::counted;
use crate::query::{Filter, Query, Region};
use crate::store::{Snapshot, Store, StoreError};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

/// How long a writer that has the store is waited for before it is asked again.
const RETRY: Duration = Duration::from_millis(500);
/// The ground is looked for so far around the eye, in plan, and so far below it; farther where there is nothing nearer.
const GROUND: [(f64, f64); 4] = [(0.6, 6.0), (0.6, 500.0), (3.0, 1000.0), (12.0, 2000.0)];

/// Which points are written to a file.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// Where.
    pub bounds: WorldBox,
    /// Of which scans.
    pub scans: Vec<String>,
    /// Which of them, if not all.
    pub filter: Option<Filter>,
}

/// Writes points to a file; says how many there are.
pub type Exporter = dyn Fn(&Snapshot, &Wanted, &Path) -> Result<u64, String> + Send + Sync;

/// What is to be done.
#[derive(Clone, Debug)]
pub enum Job {
    /// Read what is known of the newest generation.
    Site,
    /// Keep a camera.
    SaveBookmark(String, Box<Camera>),
    /// Let go of one.
    RemoveBookmark(String),
    /// Write points.
    Export(Box<Wanted>, PathBuf),
    /// Does this mean something in the store, as a filter?
    Filter(String),
    /// How high is the ground below?
    Ground(DVec3),
}

/// What was done.
#[derive(Debug)]
pub enum News {
    /// What is known now.
    Site(Box<Site>),
    /// The cameras in the store now.
    Bookmarks(Vec<(String, Camera)>),
    /// A filter that the store has the attributes for.
    Filter(Filter),
    /// Something to tell.
    Told(String),
    /// The ground's height below a point; none if there is none.
    Ground(Option<f64>),
}

/// The thread, as the window sees it.
pub struct Worker {
    jobs: Option<Sender<Job>>,
    news: Receiver<News>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Worker {
    /// Begins; `wake` is called when there is news.
    ///
    /// # Errors
    ///
    /// [`std::io::Error`] if there can't be another thread.
    pub fn spawn(store: Store, exporter: Arc<Exporter>, wake: impl Fn() + Send + 'static) -> std::io::Result<Self> {
        let (jobs, receiver) = channel();
        let (sender, news) = channel();
        let tell = move |news: News| {
            // A window that has closed wants no news.
            let _ = sender.send(news);
            wake();
        };
        let work = move || Work { store, exporter, waiting: Vec::new() }.run(&receiver, &tell);
        let thread = std::thread::Builder::new().name("viewer-work".into()).spawn(work)?;
        Ok(Self { jobs: Some(jobs), news, thread: Some(thread) })
    }

    /// To be done, after what was asked for before.
    pub fn ask(&self, job: Job) {
        if let Some(jobs) = &self.jobs {
            let _ = jobs.send(job);
        }
    }

    /// News, if there is any.
    pub fn news(&self) -> Option<News> {
        self.news.try_recv().ok()
    }
}

impl Drop for Worker {
    /// Waits for what was begun: an export is not cut off.
    fn drop(&mut self) {
        self.jobs = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Work {
    store: Store,
    exporter: Arc<Exporter>,
    /// Bookmarks that wait until a writer lets go of the store; `None`: to be removed.
    waiting: Vec<(String, Option<Box<Camera>>)>,
}

impl Work {
    fn run(mut self, jobs: &Receiver<Job>, tell: &impl Fn(News)) {
        loop {
            let job = if self.waiting.is_empty() {
                jobs.recv().map_err(|_| RecvTimeoutError::Disconnected)
            } else {
                jobs.recv_timeout(RETRY)
            };
            match job {
                Ok(job) => self.work(job, tell),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            self.write_bookmarks(tell);
        }
    }

    fn work(&mut self, job: Job, tell: &impl Fn(News)) {
        match job {
            Job::Site => {
                let site = self.store.snapshot().map_err(crate::query::QueryError::from).and_then(|s| Site::read(&s));
                tell(match site {
                    Ok(site) => News::Site(Box::new(site)),
                    Err(error) => News::Told(error.to_string()),
                });
            }
            Job::SaveBookmark(name, camera) => self.waiting.push((name, Some(camera))),
            Job::RemoveBookmark(name) => self.waiting.push((name, None)),
            Job::Export(wanted, path) => {
                let snapshot = self.store.snapshot().map_err(|e| e.to_string());
                let done = snapshot.and_then(|s| (self.exporter)(&s, &wanted, &path));
                tell(News::Told(match done {
                    Ok(points) => format!("{} written to {}", counted(points, "point"), path.display()),
                    Err(error) => error,
                }));
            }
            Job::Filter(text) => tell(match self.filter(&text) {
                Ok(filter) => News::Filter(filter),
                Err(words) => News::Told(words),
            }),
            Job::Ground(eye) => tell(News::Ground(self.ground(eye))),
        }
    }

    fn write_bookmarks(&mut self, tell: &impl Fn(News)) {
        if self.waiting.is_empty() {
            return;
        }
        let mut writer = match self.store.writer() {
            Ok(writer) => writer,
            // An ingest has it: later.
            Err(StoreError::InUse { .. }) => return,
            Err(error) => {
                self.waiting.clear();
                return tell(News::Told(format!("the bookmark can't be kept: {error}")));
            }
        };
        for (name, camera) in self.waiting.drain(..) {
            let done = match &camera {
                Some(camera) => serde_json::to_string(camera)
                    .map_err(|e| e.to_string())
                    .and_then(|json| writer.put_bookmark(&name, &json).map_err(|e| e.to_string())),
                None => writer.remove_bookmark(&name).map_err(|e| e.to_string()),
            };
            tell(News::Told(match (done, camera) {
                (Ok(()), Some(_)) => format!("Kept: {name}"),
                (Ok(()), None) => format!("Removed: {name}"),
                (Err(error), _) => error,
            }));
        }
        drop(writer);
        if let Ok(bookmarks) = self.store.snapshot().and_then(|s| bookmarks(&s)) {
            tell(News::Bookmarks(bookmarks));
        }
    }

    fn filter(&self, text: &str) -> Result<Filter, String> {
        let filter = Filter::parse(text).map_err(|e| e.message().to_owned())?;
        let snapshot = self.store.snapshot().map_err(|e| e.to_string())?;
        filter.check(&snapshot).map_err(|e| e.message().to_owned())?;
        Ok(filter)
    }

    /// The height below which a tenth of the points under the eye lie.
    fn ground(&self, eye: DVec3) -> Option<f64> {
        let snapshot = self.store.snapshot().ok()?;
        for (around, below) in GROUND {
            let min = [eye.x - around, eye.y - around, eye.z - below];
            let max = [eye.x + around, eye.y + around, eye.z];
            let region = Region::new_box(min, max).ok()?;
            let lattice = &snapshot.site().lattice;
            let mut heights = Vec::new();
            let query = Query::new().region(region).capacity(1000).positions_only();
            query
                .run(&snapshot, |batch| {
                    heights.extend(batch.positions.z.iter().map(|&z| lattice.world_on_axis(2, z)));
                    ControlFlow::Continue(())
                })
                .ok()?;
            heights.sort_by(f64::total_cmp);
            if let Some(height) = heights.get(heights.len() / 10) {
                return Some(*height);
            }
        }
        None
    }
}

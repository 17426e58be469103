//! What takes time and is not the stream's: reading what is known of the store, bookmarks, the ground on one thread, exports
//! on another, so that neither the window nor what is asked for meanwhile waits for an export.

use super::site::{Site, bookmarks};
use crate::geometry::{Camera, DVec3, WorldBox};
use crate::points::counted;
use crate::query::{Filter, Query, Region};
use crate::store::{Snapshot, Store, StoreError};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How long a writer that has the store is waited for before it is asked again.
const RETRY: Duration = Duration::from_millis(500);
/// How long it is waited for when the window has closed: a short change of the store ends meanwhile, an ingest may take hours.
const LAST_WAIT: Duration = Duration::from_secs(5);
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
    /// What was asked for and was not done, and why.
    Failed(String),
    /// The ground's height below a point; none if there is none.
    Ground(Option<f64>),
}

/// The threads, as the window sees them.
pub struct Worker {
    jobs: Option<Sender<Job>>,
    exports: Option<Sender<(Box<Wanted>, PathBuf)>>,
    news: Receiver<News>,
    /// The ground is asked for, and there is no answer yet.
    ground_pending: bool,
    threads: Vec<JoinHandle<()>>,
}

impl Worker {
    /// Begins; `wake` is called when there is news.
    ///
    /// # Errors
    ///
    /// [`std::io::Error`] if there can't be another thread.
    pub fn spawn(
        store: Store,
        exporter: Arc<Exporter>,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> std::io::Result<Self> {
        let (jobs, asked) = channel();
        let (exports, wanted) = channel();
        let (sender, news) = channel();
        let tell = Arc::new(move |news: News| {
            // Nobody is left to tell only when the worker itself is gone.
            let _ = sender.send(news);
            wake();
        });
        let mut worker =
            Self { jobs: Some(jobs), exports: Some(exports), news, ground_pending: false, threads: Vec::new() };
        let (exported, told) = (store.clone(), tell.clone());
        worker.begin("viewer-export", move || write_exports(&exported, &*exporter, &wanted, &*told))?;
        worker.begin("viewer-work", move || Work::new(store, LAST_WAIT).run(&asked, &*tell))?;
        Ok(worker)
    }

    fn begin(&mut self, name: &str, work: impl FnOnce() + Send + 'static) -> std::io::Result<()> {
        self.threads.push(std::thread::Builder::new().name(name.into()).spawn(work)?);
        Ok(())
    }

    /// To be done, after what was asked for before.
    pub fn ask(&self, job: Job) {
        if let Some(jobs) = &self.jobs {
            let _ = jobs.send(job);
        }
    }

    /// Asks how high the ground below `eye` is, unless that was asked and is not answered yet: answers for where the eye
    /// was long ago would move it.
    pub fn ask_for_ground(&mut self, eye: DVec3) {
        if !std::mem::replace(&mut self.ground_pending, true) {
            self.ask(Job::Ground(eye));
        }
    }

    /// Points to be written, after those of the exports before.
    pub fn export(&self, wanted: Box<Wanted>, path: PathBuf) {
        if let Some(exports) = &self.exports {
            let _ = exports.send((wanted, path));
        }
    }

    /// News, if there is any.
    pub fn news(&mut self) -> Option<News> {
        let news = self.news.try_recv().ok()?;
        self.ground_pending &= !matches!(news, News::Ground(_));
        Some(news)
    }

    /// Waits for what was begun: an export is not cut off, and a bookmark is tried for some seconds. What was not done, and
    /// that nobody was told of, comes back.
    pub fn close(mut self) -> Vec<String> {
        self.end();
        let failed = |news| if let News::Failed(words) = news { Some(words) } else { None };
        self.news.try_iter().filter_map(failed).collect()
    }

    fn end(&mut self) {
        (self.jobs, self.exports) = (None, None);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

impl Drop for Worker {
    /// As [`Worker::close`].
    fn drop(&mut self) {
        self.end();
    }
}

fn write_exports(store: &Store, exporter: &Exporter, exports: &Receiver<(Box<Wanted>, PathBuf)>, tell: &impl Fn(News)) {
    for (wanted, path) in exports {
        let snapshot = store.snapshot().map_err(|e| e.to_string());
        tell(match snapshot.and_then(|s| exporter(&s, &wanted, &path)) {
            Ok(points) => News::Told(format!("{} written to {}", counted(points, "point"), path.display())),
            Err(error) => News::Failed(error),
        });
    }
}

struct Work {
    store: Store,
    /// Bookmarks that wait until a writer lets go of the store; `None`: to be removed.
    waiting: Vec<(String, Option<Box<Camera>>)>,
    last_wait: Duration,
}

/// What became of a bookmark that couldn't be written.
fn not_written(name: &str, camera: Option<&Camera>, why: &str) -> News {
    let done = if camera.is_some() { "kept" } else { "removed" };
    News::Failed(format!("bookmark '{name}': not {done}: {why}"))
}

impl Work {
    fn new(store: Store, last_wait: Duration) -> Self {
        Self { store, waiting: Vec::new(), last_wait }
    }

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
                Err(RecvTimeoutError::Disconnected) => return self.end(tell),
            }
            self.write_bookmarks(tell);
        }
    }

    /// The window has closed: bookmarks that still wait are tried for some time, and told of if they are not written then.
    fn end(mut self, tell: &impl Fn(News)) {
        let begun = Instant::now();
        while !self.waiting.is_empty() && begun.elapsed() < self.last_wait {
            std::thread::sleep(RETRY.min(self.last_wait));
            self.write_bookmarks(tell);
        }
        for (name, camera) in self.waiting {
            tell(not_written(&name, camera.as_deref(), "something else is writing to the store"));
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
                let error = error.to_string();
                let lost = self.waiting.drain(..);
                return lost.for_each(|(name, camera)| tell(not_written(&name, camera.as_deref(), &error)));
            }
        };
        for (name, camera) in self.waiting.drain(..) {
            let done = match &camera {
                Some(camera) => serde_json::to_string(camera)
                    .map_err(|e| e.to_string())
                    .and_then(|json| writer.put_bookmark(&name, &json).map_err(|e| e.to_string())),
                None => writer.remove_bookmark(&name).map_err(|e| e.to_string()),
            };
            tell(match (done, &camera) {
                (Ok(()), Some(_)) => News::Told(format!("Kept: {name}")),
                (Ok(()), None) => News::Told(format!("Removed: {name}")),
                (Err(error), _) => not_written(&name, camera.as_deref(), &error),
            });
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Projection;
    use crate::lattice::Lattice;
    use crate::store::SiteOptions;

    /// Long enough for any machine; a wait that ends in it has failed.
    const PATIENCE: Duration = Duration::from_secs(60);

    fn store(folder: &Path) -> Store {
        Store::create(folder.join("a.esker"), SiteOptions::new(Lattice::uniform(0.01).unwrap())).unwrap()
    }

    fn camera() -> Box<Camera> {
        let projection = Projection::Perspective { fov_y_rad: 1.0 };
        Box::new(Camera::new(DVec3::ZERO, DVec3::X, DVec3::Z, projection, [100, 100]).unwrap())
    }

    fn kept(store: &Store) -> Vec<String> {
        bookmarks(&store.snapshot().unwrap()).unwrap().into_iter().map(|(name, _)| name).collect()
    }

    /// The thread ended with the window, and what waited was lost without a word.
    #[test]
    fn bookmarks_that_wait_when_the_window_closes_are_written_or_told_of() {
        let folder = tempfile::tempdir().unwrap();
        let store = store(folder.path());
        let close = |last_wait, held: bool| {
            let (jobs, asked) = channel();
            let (sender, news) = channel();
            jobs.send(Job::SaveBookmark("door".into(), camera())).unwrap();
            jobs.send(Job::RemoveBookmark("gate".into())).unwrap();
            drop(jobs);
            let writer = store.writer().unwrap();
            let work = Work::new(store.clone(), last_wait);
            let thread = std::thread::spawn(move || work.run(&asked, &|news| sender.send(news).unwrap()));
            let writer = held.then_some(writer);
            thread.join().unwrap();
            drop(writer);
            news.try_iter().filter_map(|n| if let News::Failed(words) = n { Some(words) } else { None }).collect()
        };
        let told: Vec<String> = close(Duration::from_millis(20), true);
        assert_eq!(told.len(), 2, "{told:?}");
        assert!(told[0].contains("'door': not kept") && told[1].contains("'gate': not removed"), "{told:?}");
        assert!(kept(&store).is_empty());
        assert!(close(PATIENCE, false).iter().all(|words| !words.contains("door")));
        assert_eq!(kept(&store), ["door"]);
    }

    /// Behind a long export thousands of questions for the ground came together, and their answers moved the eye to heights
    /// of old places.
    #[test]
    fn an_export_holds_nothing_up_and_is_not_cut_off() {
        let folder = tempfile::tempdir().unwrap();
        let store = store(folder.path());
        let (go_on, held) = channel::<()>();
        let held = std::sync::Mutex::new(held);
        let exporter = Arc::new(move |_: &Snapshot, _: &Wanted, path: &Path| {
            held.lock().unwrap().recv_timeout(PATIENCE).map_err(|e| e.to_string())?;
            std::fs::write(path, "points").map_err(|e| e.to_string())?;
            if path.ends_with("bad.csv") { Err("bad.csv: there is no room".into()) } else { Ok(6) }
        });
        let mut worker = Worker::spawn(store, exporter, || {}).unwrap();
        let bounds = WorldBox::new([0.0; 3], [1.0; 3]).unwrap();
        let wanted = Box::new(Wanted { bounds, scans: Vec::new(), filter: None });
        let (good, bad) = (folder.path().join("good.csv"), folder.path().join("bad.csv"));
        worker.export(wanted.clone(), good.clone());
        worker.export(wanted, bad);
        worker.ask_for_ground(DVec3::ZERO);
        worker.ask_for_ground(DVec3::ONE);
        worker.ask(Job::Site);
        let begun = Instant::now();
        let mut before = Vec::new();
        while !matches!(before.last(), Some(News::Site(_))) {
            assert!(begun.elapsed() < PATIENCE, "{before:?}");
            before.extend(worker.news());
        }
        assert!(matches!(before[..], [News::Ground(None), News::Site(_)]), "{before:?}");
        assert!(!good.exists());
        worker.ask_for_ground(DVec3::ONE);
        go_on.send(()).unwrap();
        go_on.send(()).unwrap();
        assert_eq!(worker.close(), ["bad.csv: there is no room"]);
        assert_eq!(std::fs::read_to_string(good).unwrap(), "points");
    }
}

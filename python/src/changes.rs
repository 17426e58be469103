//! What changes stores, and makes files to try them with.

use crate::errors::{Failure, bad_ingest, misuse};
use crate::options::parse_view;
use crate::reader::json;
use crate::waiting::{interruptible, quietly};
use esker::formats::parse_columns;
use esker::generate::{GenerateOptions, Kind};
use esker::geometry::Pose;
use esker::ingest::{self as library, IngestError, IngestOptions, LatticeWish, Progress, Resources, Stage};
use esker::lattice::Decimal;
use esker::points::Crs;
use esker::store::Store;
use pyo3::prelude::*;
use serde::Serialize;
use std::cell::Cell;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How often progress is told.
const TELL_EVERY: Duration = Duration::from_millis(100);

/// The keywords of `esker.ingest`, all of them given.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Wishes {
    quantum: Option<[f64; 3]>,
    phase: Option<[f64; 3]>,
    /// A store whose quantum and phase are to be taken.
    lattice: Option<PathBuf>,
    memory: Option<u64>,
    threads: Option<usize>,
    crs: Option<String>,
    ignore_crs: bool,
    name: Option<String>,
    /// 16 numbers each, row-major.
    poses: Vec<[f64; 16]>,
    columns: Option<String>,
    recursive: bool,
    strict: bool,
    keep_going: bool,
    wait: bool,
}

impl Wishes {
    fn resources(&self) -> Resources {
        Resources { memory_bytes: self.memory, threads: self.threads, wait: self.wait }
    }

    fn options(&self) -> PyResult<IngestOptions> {
        let mut lattice = LatticeWish { quantum: self.quantum, phase: self.phase };
        if let Some(path) = &self.lattice {
            let other = Store::open(path).and_then(|store| store.snapshot()).map_err(Failure::from)?;
            let found = &other.site().lattice;
            lattice =
                LatticeWish { quantum: Some(found.quantum_f64()), phase: Some(found.phase().map(Decimal::to_f64)) };
        }
        let rigid = |pose: Pose| pose.rigid_scale().map(|_| pose);
        let pose = |matrix: &[f64; 16]| {
            Pose::from_matrix(matrix).and_then(rigid).map_err(|e| bad_ingest(format!("a pose: {e}")))
        };
        Ok(IngestOptions {
            lattice,
            resources: self.resources(),
            crs: self.crs.as_deref().map(parse_crs).transpose()?,
            ignore_crs: self.ignore_crs,
            name: self.name.clone(),
            poses: self.poses.iter().map(pose).collect::<PyResult<_>>()?,
            columns: self.columns.as_deref().map(parse_columns).transpose().map_err(bad_ingest)?,
            recursive: self.recursive,
            strict: self.strict,
            keep_going: self.keep_going,
            ..IngestOptions::default()
        })
    }
}

fn parse_crs(text: &str) -> PyResult<Crs> {
    Crs::parse(text).ok_or_else(|| bad_ingest(format!("the CRS '{text}' is neither EPSG:N (1024 to 32766) nor WKT")))
}

/// What work tells, for a thread that listens; and its wish that the work stop.
#[derive(Default)]
struct Told {
    stop: AtomicBool,
    stage: Mutex<Option<Stage>>,
    total: AtomicU64,
    done: AtomicU64,
    messages: Mutex<Vec<String>>,
}

impl Progress for Told {
    fn stage(&self, stage: Stage, total: u64) {
        *self.stage.lock().unwrap_or_else(PoisonError::into_inner) = Some(stage);
        self.total.store(total, Ordering::Relaxed);
        self.done.store(0, Ordering::Relaxed);
    }

    fn advance(&self, points: u64) {
        self.done.fetch_add(points, Ordering::Relaxed);
    }

    fn say(&self, message: &str) {
        self.messages.lock().unwrap_or_else(PoisonError::into_inner).push(message.to_owned());
    }

    fn cancelled(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

thread_local! {
    /// Is a progress callback of a change running on this thread?
    static IS_TOLD: Cell<bool> = const { Cell::new(false) };
}

/// Who is told: two functions of the package.
#[derive(FromPyObject)]
pub struct Listener {
    /// Takes the stage's word, the points done and all points of the stage.
    progress: Option<Py<PyAny>>,
    /// Takes a message.
    say: Py<PyAny>,
}

impl Listener {
    /// What is told every now and then, for a thread that waits.
    pub fn every_now_and_then<'l>(
        &'l self,
        mut tell: impl FnMut(Python<'_>, &Self) -> PyResult<()> + Send + 'l,
    ) -> impl FnMut(Python<'_>) -> PyResult<()> + Send + 'l {
        let mut last = Instant::now();
        move |py| {
            if last.elapsed() < TELL_EVERY {
                return Ok(());
            }
            last = Instant::now();
            tell(py, self)
        }
    }

    /// Tells how many points were written so far; how many there will be nobody knows.
    pub fn points(&self, py: Python<'_>, written: &AtomicU64) -> PyResult<()> {
        if let Some(progress) = &self.progress {
            progress.call1(py, ("writing", written.load(Ordering::Relaxed), None::<u64>))?;
        }
        Ok(())
    }

    fn listen(&self, py: Python<'_>, told: &Told) -> PyResult<()> {
        for message in std::mem::take(&mut *told.messages.lock().unwrap_or_else(PoisonError::into_inner)) {
            self.say.call1(py, (message,))?;
        }
        let stage = *told.stage.lock().unwrap_or_else(PoisonError::into_inner);
        if let (Some(progress), Some(stage)) = (&self.progress, stage) {
            let (done, total) = (told.done.load(Ordering::Relaxed), told.total.load(Ordering::Relaxed));
            let outer = IS_TOLD.replace(true);
            let called = progress.call1(py, (stage.word(), done, total));
            IS_TOLD.set(outer);
            called?;
        }
        Ok(())
    }
}

/// As [`run`], of a change. What the listener raises where the change is committed already says so.
fn change<R: Serialize + Send>(
    py: Python<'_>,
    wishes: &Wishes,
    listener: &Listener,
    work: impl FnOnce(&dyn Progress) -> Result<R, IngestError> + Send,
) -> PyResult<String> {
    if wishes.wait && IS_TOLD.get() {
        return Err(misuse(
            "a progress callback can't wait for a change to end: it may be the one that it is told of; leave out wait",
        ));
    }
    let is_committed = AtomicBool::new(false);
    let noted = |told: &dyn Progress| {
        let done = work(told);
        is_committed.store(done.is_ok(), Ordering::Relaxed);
        done
    };
    run(py, listener, noted).inspect_err(|raised| {
        if is_committed.load(Ordering::Relaxed) {
            // Python has notes from 3.11 on; without them the exception is as it was raised.
            let _ = raised
                .value(py)
                .call_method1("add_note", ("esker: the change was complete by then, and is committed",));
        }
    })
}

/// Runs work, tells how far it is, and gives its report as JSON.
fn run<R: Serialize + Send>(
    py: Python<'_>,
    listener: &Listener,
    work: impl FnOnce(&dyn Progress) -> Result<R, IngestError> + Send,
) -> PyResult<String> {
    let told = Told::default();
    let tick = listener.every_now_and_then(|py, listener| listener.listen(py, &told));
    let report = interruptible(py, || told.stop.store(true, Ordering::Relaxed), tick, || work(&told))?;
    listener.listen(py, &told)?;
    json(&report.map_err(Failure::from)?)
}

/// Puts files into a store.
#[pyfunction]
pub fn ingest(
    py: Python<'_>,
    path: PathBuf,
    inputs: Vec<PathBuf>,
    wishes: Wishes,
    listener: Listener,
) -> PyResult<String> {
    let options = wishes.options()?;
    change(py, &wishes, &listener, |told| library::ingest(&path, &inputs, &options, told))
}

/// Puts arrays into a store: x, y and z, then attributes.
#[pyfunction]
pub fn ingest_table(
    py: Python<'_>,
    path: PathBuf,
    name: String,
    columns: Vec<(String, Bound<'_, PyAny>)>,
    wishes: Wishes,
    listener: Listener,
) -> PyResult<String> {
    let options = wishes.options()?;
    let table = crate::table::table(name, &columns)?;
    change(py, &wishes, &listener, |told| library::ingest_table(&path, table, &options, told))
}

/// Takes scans out of a store.
#[pyfunction]
pub fn remove(
    py: Python<'_>,
    path: PathBuf,
    scans: Vec<String>,
    wishes: Wishes,
    listener: Listener,
) -> PyResult<String> {
    change(py, &wishes, &listener, |told| library::remove(&path, &scans, &wishes.resources(), told))
}

/// Puts a file in a scan's place.
#[pyfunction]
pub fn replace(
    py: Python<'_>,
    path: PathBuf,
    scan: String,
    input: Option<PathBuf>,
    wishes: Wishes,
    listener: Listener,
) -> PyResult<String> {
    let options = wishes.options()?;
    change(py, &wishes, &listener, |told| library::replace(&path, &scan, input.as_deref(), &options, told))
}

/// Shows or hides scans.
#[pyfunction]
pub fn set_visible(
    py: Python<'_>,
    path: PathBuf,
    scans: Vec<String>,
    visible: bool,
    wishes: Wishes,
    listener: Listener,
) -> PyResult<String> {
    change(py, &wishes, &listener, |told| library::set_visible(&path, &scans, visible, &wishes.resources(), told))
}

/// Gives a scan another name.
#[pyfunction]
pub fn rename(
    py: Python<'_>,
    path: PathBuf,
    scan: String,
    name: String,
    wishes: Wishes,
    listener: Listener,
) -> PyResult<String> {
    change(py, &wishes, &listener, |told| library::rename(&path, &scan, &name, &wishes.resources(), told))
}

/// Says in which CRS a site is; gives what it was in.
#[pyfunction]
pub fn set_crs(
    py: Python<'_>,
    path: PathBuf,
    crs: &str,
    force: bool,
    wishes: Wishes,
    listener: Listener,
) -> PyResult<String> {
    let crs = parse_crs(crs)?;
    let resources = wishes.resources();
    change(py, &wishes, &listener, |told| {
        let before = library::set_crs(&path, &crs, force, &resources, told)?;
        Ok(before.map(|crs| crs.describe()))
    })
}

/// Keeps a camera under a name; says whether there was another one of that name.
#[pyfunction]
pub fn keep_bookmark(
    py: Python<'_>,
    path: PathBuf,
    name: String,
    view: &str,
    replace: bool,
    wishes: Wishes,
    listener: Listener,
) -> PyResult<String> {
    let camera = parse_view(view)?;
    let resources = wishes.resources();
    change(py, &wishes, &listener, |told| library::keep_bookmark(&path, &name, &camera, replace, &resources, told))
}

/// Lets go of a camera.
#[pyfunction]
pub fn remove_bookmark(
    py: Python<'_>,
    path: PathBuf,
    name: String,
    wishes: Wishes,
    listener: Listener,
) -> PyResult<String> {
    change(py, &wishes, &listener, |told| library::remove_bookmark(&path, &name, &wishes.resources(), told))
}

/// Makes one layer of all and gives free space back.
#[pyfunction]
pub fn compact(
    py: Python<'_>,
    path: PathBuf,
    copy: Option<PathBuf>,
    wishes: Wishes,
    listener: Listener,
) -> PyResult<String> {
    change(py, &wishes, &listener, |told| library::compact(&path, copy.as_deref(), &wishes.resources(), told))
}

/// Joins stores to a new one.
#[pyfunction]
pub fn merge(
    py: Python<'_>,
    out: PathBuf,
    stores: Vec<PathBuf>,
    wishes: Wishes,
    listener: Listener,
) -> PyResult<String> {
    change(py, &wishes, &listener, |told| library::merge(&out, &stores, &wishes.resources(), told))
}

/// The two hashes of what a store holds.
#[pyfunction]
pub fn digest(py: Python<'_>, path: PathBuf, wishes: Wishes, listener: Listener) -> PyResult<String> {
    run(py, &listener, |told| {
        let digest = library::digest(&path, &wishes.resources(), told)?;
        Ok([("points", digest.points.to_string()), ("scans", digest.scans.to_string())])
    })
}

/// The keywords of `esker.generate`, all of them given.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Model {
    seed: u64,
    scans: u32,
    laz: bool,
    force: bool,
}

/// Makes a synthetic model: its files, each with its points.
#[pyfunction]
pub fn generate(py: Python<'_>, kind: &str, points: u64, path: PathBuf, model: Model) -> PyResult<Vec<(PathBuf, u64)>> {
    let kind = Kind::from_word(kind).ok_or_else(|| {
        let words: Vec<_> = Kind::ALL.iter().map(|k| k.word()).collect();
        misuse(format!("there is no model '{kind}'; there are {}", words.join(", ")))
    })?;
    let options = GenerateOptions { force: model.force, scans: model.scans, laz: model.laz };
    let stop = AtomicBool::new(false);
    let work =
        || esker::generate::generate(kind, points, model.seed, &path, &options, &mut |_| !stop.load(Ordering::Relaxed));
    let made = interruptible(py, || stop.store(true, Ordering::Relaxed), quietly, work)?;
    Ok(made.map_err(Failure::from)?.files)
}

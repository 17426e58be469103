//! A store that is open for reading: the newest generation, or one that is held.

use crate::batches::Batches;
use crate::errors::{Failure, misuse};
use crate::options::Options;
use crate::points::{Form, Points};
use crate::waiting::{check_process, interruptible, quietly, to_its_end};
use esker::points::{canonical_name, same_name};
use esker::query::{Answer, Cancel, Query, QueryError};
use esker::store::{Finding, Limits, ScanDescription, Snapshot, Store, describe, verify};
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use serde::Serialize;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

type Array<'py, T> = Bound<'py, PyArray1<T>>;
type Nearest<'py> = (Points, Array<'py, f64>, Array<'py, u64>);
type Squares<'py> = ((Array<'py, u64>, Array<'py, f64>, Array<'py, f64>), [i64; 2], [usize; 2]);

/// A store, and its generation that was used last, so that what was read of it stays in memory.
#[pyclass(frozen, module = "esker._esker")]
pub struct Reader {
    open: Mutex<Option<Open>>,
    /// Is `Open::snapshot` kept though there is a newer one?
    held: bool,
    /// Threads and connections do not come along when a process forks.
    process: u32,
}

struct Open {
    store: Store,
    snapshot: Snapshot,
}

impl Reader {
    fn new(store: Store, snapshot: Snapshot, held: bool) -> Self {
        Self { open: Mutex::new(Some(Open { store, snapshot })), held, process: std::process::id() }
    }

    /// Only taken with the interpreter's lock released, or for a moment.
    fn open(&self) -> MutexGuard<'_, Option<Open>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Before anything is locked: another thread may have held the lock when this process was forked.
    fn check_here(&self) -> PyResult<()> {
        if self.process == std::process::id() {
            return Ok(());
        }
        Err(misuse(
            "the store was opened before this process was forked; open it again in a process that is spawned, \
             multiprocessing.set_start_method(\"spawn\")",
        ))
    }

    /// The store and the generation that questions are about.
    fn current(&self, py: Python<'_>) -> PyResult<(Store, Snapshot)> {
        self.check_here()?;
        py.detach(|| {
            let mut open = self.open();
            let Some(Open { store, snapshot }) = open.as_mut() else { return Err(misuse("the store is closed")) };
            if !self.held {
                *snapshot = store.snapshot().map_err(Failure::from)?;
            }
            Ok((store.clone(), snapshot.clone()))
        })
    }

    /// What is asked, and how to end it.
    pub fn asked(&self, py: Python<'_>, options: &Options) -> PyResult<(Snapshot, Query, Cancel)> {
        let (_, snapshot) = self.current(py)?;
        let cancel = Cancel::new();
        let query = options.query(&snapshot)?.cancel(&cancel);
        Ok((snapshot, query, cancel))
    }
}

#[pymethods]
impl Reader {
    /// Opens a store.
    #[new]
    fn opened(py: Python<'_>, path: PathBuf, cache: Option<u64>) -> PyResult<Self> {
        let limits = cache.map_or_else(Limits::default, |bytes| Limits::of_bytes(bytes as usize));
        let (store, snapshot) = py.detach(|| {
            let store = Store::open_with(path, limits)?;
            let snapshot = store.snapshot()?;
            Ok::<_, Failure>((store, snapshot))
        })?;
        Ok(Self::new(store, snapshot, false))
    }

    /// JSON: what the caches hold and have been asked for.
    fn cache(&self, py: Python<'_>) -> PyResult<String> {
        json(&self.current(py)?.0.cache_figures())
    }

    /// Points that are answered with, of all visible scans.
    fn points(&self, py: Python<'_>) -> PyResult<u64> {
        let (_, snapshot) = self.current(py)?;
        Ok(snapshot.scans().iter().filter(|s| s.visible).map(|s| s.stored).sum())
    }

    /// The present generation, kept.
    fn hold(&self, py: Python<'_>) -> PyResult<Self> {
        let (store, snapshot) = self.current(py)?;
        Ok(Self::new(store, snapshot, true))
    }

    /// In a forked process there is nothing to give up.
    fn close(&self, py: Python<'_>) {
        if self.check_here().is_ok() {
            py.detach(|| drop(self.open().take()));
        }
    }

    fn is_closed(&self, py: Python<'_>) -> PyResult<bool> {
        self.check_here()?;
        Ok(py.detach(|| self.open().is_none()))
    }

    fn generation(&self, py: Python<'_>) -> PyResult<u64> {
        Ok(self.current(py)?.1.generation())
    }

    /// JSON: what `esker info --json` prints.
    fn info(&self, py: Python<'_>) -> PyResult<String> {
        let (_, snapshot) = self.current(py)?;
        let description = interruptible(py, to_its_end, quietly, || describe(&snapshot))?;
        json(&description.map_err(Failure::from)?)
    }

    /// JSON: an array of what `esker scans --json` prints.
    fn scans(&self, py: Python<'_>) -> PyResult<String> {
        let (_, snapshot) = self.current(py)?;
        let lattice = &snapshot.site().lattice;
        let scans: Vec<_> = snapshot.scans().iter().map(|s| ScanDescription::new(s, lattice)).collect();
        json(&scans)
    }

    /// JSON: name, type, scaling, no-data value and description of each attribute.
    fn attributes(&self, py: Python<'_>) -> PyResult<String> {
        let (_, snapshot) = self.current(py)?;
        let attributes: Vec<_> = snapshot.attributes().iter().map(|a| &a.attribute).collect();
        json(&attributes)
    }

    /// Name and JSON of each bookmark.
    fn bookmarks(&self, py: Python<'_>) -> PyResult<Vec<(String, String)>> {
        let (_, snapshot) = self.current(py)?;
        Ok(py.detach(|| snapshot.bookmarks()).map_err(Failure::from)?)
    }

    /// The points, and the answer's report as JSON.
    fn query(&self, py: Python<'_>, options: Options) -> PyResult<(Points, String)> {
        let (snapshot, query, cancel) = self.asked(py, &options)?;
        let work = || {
            let form = Form::new(&query, &snapshot, options.give())?;
            let mut pieces = Vec::new();
            let answer = form.complete(query).run(&snapshot, |batch| {
                pieces.push(form.piece(batch));
                ControlFlow::Continue(())
            })?;
            Ok((Points::new(Arc::new(form), pieces), answer))
        };
        let (points, answer): (Points, Answer) = found(interruptible(py, || cancel.cancel(), quietly, work)?)?;
        Ok((points, json(&answer)?))
    }

    /// The points batch by batch.
    fn batches(&self, py: Python<'_>, options: Options, points: usize) -> PyResult<Batches> {
        check_process()?;
        let (snapshot, query, cancel) = self.asked(py, &options)?;
        let form = py.detach(|| Form::new(&query, &snapshot, options.give()));
        Ok(Batches::new(snapshot, query, cancel, found(form)?, points))
    }

    /// The report of an answer without its points, as JSON.
    fn count(&self, py: Python<'_>, options: Options) -> PyResult<String> {
        let (snapshot, query, cancel) = self.asked(py, &options)?;
        let answer = interruptible(py, || cancel.cancel(), quietly, || query.count(&snapshot))?;
        json(&found(answer)?)
    }

    /// JSON: what `esker query --explain --json` prints.
    fn explain(&self, py: Python<'_>, options: Options) -> PyResult<String> {
        let (snapshot, query, cancel) = self.asked(py, &options)?;
        let explanation = interruptible(py, || cancel.cancel(), quietly, || query.explain(&snapshot))?;
        json(&found(explanation)?)
    }

    /// JSON: what `esker query --json` prints.
    fn summary(&self, py: Python<'_>, options: Options) -> PyResult<String> {
        let (snapshot, query, cancel) = self.asked(py, &options)?;
        let summary = interruptible(py, || cancel.cancel(), quietly, || query.summary(&snapshot))?;
        let (answer, summary) = found(summary)?;
        let mut value = serde_json::to_value(&answer).map_err(|e| misuse(e.to_string()))?;
        value["attributes"] = serde_json::to_value(&summary).map_err(|e| misuse(e.to_string()))?;
        json(&value)
    }

    /// The points that are nearest to each of `points`, with their distances and where those of each end.
    fn nearest<'py>(
        &self,
        py: Python<'py>,
        options: Options,
        points: PyReadonlyArray2<'_, f64>,
        k: usize,
        radius: Option<f64>,
    ) -> PyResult<Nearest<'py>> {
        let (snapshot, query, cancel) = self.asked(py, &options)?;
        let points: Vec<[f64; 3]> = points.as_array().rows().into_iter().map(|p| [p[0], p[1], p[2]]).collect();
        let work = || {
            let form = Form::new(&query, &snapshot, options.give())?;
            let found = form.complete(query).nearest(&snapshot, &points, k, radius)?;
            let piece = form.piece(found.batch);
            Ok((Points::new(Arc::new(form), vec![piece]), found.distances, found.ends))
        };
        let (points, distances, ends) = self::found(interruptible(py, || cancel.cancel(), quietly, work)?)?;
        let ends: Vec<u64> = ends.into_iter().map(|end| end as u64).collect();
        Ok((points, distances.into_pyarray(py), ends.into_pyarray(py)))
    }

    /// Counts, least and greatest heights of squares; the number of the first square and how many there are on each axis.
    fn density<'py>(&self, py: Python<'py>, options: Options, side: f64) -> PyResult<Squares<'py>> {
        let (snapshot, query, cancel) = self.asked(py, &options)?;
        let found = found(interruptible(py, || cancel.cancel(), quietly, || query.density(&snapshot, side))?)?;
        let counts = found.grid(0, |square| square.points).into_pyarray(py);
        let lowest = found.grid(f64::NAN, |square| square.lowest).into_pyarray(py);
        let arrays = (counts, lowest, found.grid(f64::NAN, |square| square.highest).into_pyarray(py));
        Ok((arrays, found.first, found.size))
    }

    /// JSON: what `esker verify --json` prints.
    fn verify(&self, py: Python<'_>, deep: bool) -> PyResult<String> {
        let (store, _) = self.current(py)?;
        let stop = AtomicBool::new(false);
        let ask = |_, _| if stop.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
        let work = || verify(&store, deep, &ask);
        let report = interruptible(py, || stop.store(true, Ordering::Relaxed), quietly, work)?;
        // Only what was interrupted has none.
        let report = report.ok_or_else(|| misuse("the check was ended"))?;
        let finding = |f: &Finding| serde_json::json!({ "table": f.table, "key": f.key, "what": f.what });
        json(&serde_json::json!({
            "whole": report.is_whole(),
            "findings": report.findings.iter().map(finding).collect::<Vec<_>>(),
            "more_findings": report.more_findings,
            "nodes": report.nodes,
            "points": report.points,
            "scans": report.scans,
        }))
    }
}

/// Which of these names a user means: as names of attributes are looked up in a filter.
#[pyfunction]
pub fn same_attribute(asked: &str, names: Vec<String>) -> Option<usize> {
    let exact = names.iter().position(|n| n == asked);
    let alike = || names.iter().position(|n| same_name(n, asked));
    let canonical = || canonical_name(asked).and_then(|c| names.iter().position(|n| n == c));
    exact.or_else(alike).or_else(canonical)
}

fn found<R>(result: Result<R, QueryError>) -> PyResult<R> {
    Ok(result.map_err(Failure::from)?)
}

/// A report for the package, which reads it.
pub fn json(report: &impl Serialize) -> PyResult<String> {
    serde_json::to_string(report).map_err(|e| misuse(e.to_string()))
}

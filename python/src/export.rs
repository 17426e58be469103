//! Answers to files.

use crate::changes::Listener;
use crate::errors::{Failure, bad_query, exists, misuse};
use crate::options::Options;
use crate::reader::Reader;
use crate::waiting::interruptible;
use esker::export::{self as library, ExportError, ExportOptions, Frame, SplitBy, Target};
use esker::formats::{FormatError, OutputFormat};
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};

/// The keywords of `esker.Store.export` that are about the file, all of them given.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Output {
    format: Option<String>,
    scale: Option<[f64; 3]>,
    frame: String,
    split_by: Option<String>,
    with_scan: bool,
    overwrite: bool,
}

impl Output {
    fn options(&self) -> PyResult<ExportOptions> {
        let one_of =
            |what: &str, given: &str, words: &str| bad_query(format!("{what} is '{given}'; it must be {words}"));
        let format = |word: &String| {
            let found = OutputFormat::of_extension(word.trim_start_matches('.'));
            found.ok_or_else(|| one_of("format", word, "las, laz, ply, csv, xyz, npy or npz"))
        };
        let split = |word: &String| match word.as_str() {
            "scan" => Ok(SplitBy::Scan),
            "class" => Ok(SplitBy::Class),
            _ => Err(one_of("split_by", word, "scan or class")),
        };
        Ok(ExportOptions {
            format: self.format.as_ref().map(format).transpose()?,
            scale: self.scale,
            frame: match self.frame.as_str() {
                "world" => Frame::World,
                "scan" => Frame::Scan,
                word => return Err(one_of("frame", word, "world or scan")),
            },
            split: self.split_by.as_ref().map(split).transpose()?,
            with_scan: self.with_scan,
            force: self.overwrite,
        })
    }
}

/// Writes the points of a query to a file; gives what `esker query -o --json` prints, and notes.
#[pyfunction]
pub fn export(
    py: Python<'_>,
    reader: &Bound<'_, Reader>,
    options: Options,
    path: PathBuf,
    output: Output,
    listener: Listener,
) -> PyResult<(String, Vec<String>)> {
    let how = output.options()?;
    let (snapshot, query, cancel) = reader.get().asked(py, &options)?;
    let written = AtomicU64::new(0);
    let tell = |points| written.store(points, Ordering::Relaxed);
    let work = || library::export(&snapshot, &query, Target::File(&path), &how, tell);
    let listen = listener.every_now_and_then(|py, listener| listener.points(py, &written));
    let done = interruptible(py, || cancel.cancel(), listen, work)?;
    listener.points(py, &written)?;
    let done = done.map_err(|error| match error {
        ExportError::Format(FormatError::AlreadyThere { path }) => {
            exists(format!("{}: exists already; overwrite=True replaces it", path.display()))
        }
        error => Failure::from(error).into(),
    })?;
    let mut report = serde_json::to_value(&done.answer).map_err(|e| misuse(e.to_string()))?;
    report["outputs"] = serde_json::to_value(&done.files).map_err(|e| misuse(e.to_string()))?;
    Ok((report.to_string(), done.notes))
}

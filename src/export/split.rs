//! One pass over the answer, a file per scan or per class.

use super::{ExportError, ExportOptions, Exported, PartOf, Shape, SplitBy, Target, Written, begin};
use crate::formats::{OutputFormat, PointWriter};
use crate::points::{Batch, Column};
use crate::query::Query;
use crate::store::Snapshot;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// Open files at a time; more classes than there can be.
const MOST_FILES: usize = 1024;

/// Writes the answer to files named after `path`.
pub(super) fn split(
    snapshot: &Snapshot,
    query: &Query,
    path: &Path,
    format: OutputFormat,
    by: SplitBy,
    options: &ExportOptions,
    progress: &mut dyn FnMut(u64),
) -> Result<Exported, ExportError> {
    let form = query.output_form(snapshot)?;
    let class = form.attributes.iter().position(|a| a.name == "Classification");
    if by == SplitBy::Class && class.is_none() {
        return Err(ExportError::NoClass);
    }
    let mut files = Files { snapshot, query, path, format, by, options, parts: BTreeMap::new() };
    let (mut failure, mut points) = (None, 0);
    let whole = query.clone().with_scans(true);
    let answer = whole.run(snapshot, |batch| {
        let keys: Vec<u64> = match (by, class.map(|c| &batch.columns[c])) {
            (SplitBy::Class, Some(column)) => (0..batch.len()).map(|i| column.as_f64(i) as u64).collect(),
            _ => batch.scans.iter().map(|&s| s.into()).collect(),
        };
        let mut indices: BTreeMap<u64, Vec<u32>> = BTreeMap::new();
        keys.iter().enumerate().for_each(|(i, &key)| indices.entry(key).or_default().push(i as u32));
        for (key, indices) in indices {
            let written = files.part(key).and_then(|part| part.write(&batch.gathered(&indices)));
            if let Err(error) = written {
                failure = Some(error);
                return ControlFlow::Break(());
            }
        }
        points += batch.len() as u64;
        progress(points);
        ControlFlow::Continue(())
    })?;
    if let Some(error) = failure {
        return Err(error);
    }
    let (mut written, mut notes) = (Vec::new(), Vec::new());
    for Part { path, of, writer, points, shape, .. } in files.parts.into_values() {
        notes.extend(shape.planned.notes);
        notes.extend(writer.finish()?);
        written.push(Written { path, points, part: Some(of) });
    }
    Ok(Exported { answer, files: written, notes })
}

/// The files that are being written.
struct Files<'a> {
    snapshot: &'a Snapshot,
    query: &'a Query,
    path: &'a Path,
    format: OutputFormat,
    by: SplitBy,
    options: &'a ExportOptions,
    /// By scan or class.
    parts: BTreeMap<u64, Part>,
}

/// A file that is being written.
struct Part {
    path: PathBuf,
    of: PartOf,
    writer: Box<dyn PointWriter>,
    points: u64,
    /// Which columns of the answer it has.
    columns: Vec<usize>,
    shape: Shape,
}

impl Files<'_> {
    /// The file of a scan or class, begun if it is not there.
    fn part(&mut self, key: u64) -> Result<&mut Part, ExportError> {
        // Begun before it is put in its place: that needs the others.
        let begun = if self.parts.contains_key(&key) { None } else { Some(self.begin(key)?) };
        Ok(match (self.parts.entry(key), begun) {
            (Entry::Vacant(place), Some(part)) => place.insert(part),
            (Entry::Vacant(_), None) => return Err(ExportError::NoScan(key as u32)),
            (Entry::Occupied(place), _) => place.into_mut(),
        })
    }

    fn begin(&self, key: u64) -> Result<Part, ExportError> {
        if self.parts.len() >= MOST_FILES {
            return Err(ExportError::TooManyFiles { most: MOST_FILES });
        }
        let (name, one, of) = match self.by {
            SplitBy::Class => (format!("class{key}"), self.query.clone(), PartOf::Class(key)),
            SplitBy::Scan => {
                let id = key as u32;
                let scan = self.snapshot.scan(id).ok_or(ExportError::NoScan(id))?;
                let fit = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' };
                let name = scan.name.chars().map(fit).collect();
                (name, self.query.clone().scans([id.to_string()]), PartOf::Scan(scan.name.clone()))
            }
        };
        let stem = self.path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let ending = self.path.extension().map(|e| format!(".{}", e.to_string_lossy())).unwrap_or_default();
        let mut path = self.path.with_file_name(format!("{stem}_{name}{ending}"));
        // Names that differ only in what a file name cannot have.
        if self.parts.values().any(|p| p.path == path) {
            path = self.path.with_file_name(format!("{stem}_{name}_{key}{ending}"));
        }
        let (shape, writer) = begin(self.snapshot, &one, Target::File(&path), self.format, self.options)?;
        let all = self.query.output_form(self.snapshot)?.attributes;
        let columns = shape.attributes.iter().filter_map(|a| all.iter().position(|b| a.identity() == b.identity()));
        let columns = columns.collect();
        Ok(Part { path, of, writer, points: 0, columns, shape })
    }
}

impl Part {
    fn write(&mut self, batch: &Batch) -> Result<(), ExportError> {
        let columns: Vec<Column> = self.columns.iter().map(|&c| batch.columns[c].clone()).collect();
        let mut own = Batch {
            attributes: self.shape.attributes.clone(),
            positions: batch.positions.clone(),
            scans: batch.scans.clone(),
            columns,
        };
        self.shape.apply(&mut own)?;
        self.points += own.len() as u64;
        Ok(self.writer.write(&own)?)
    }
}

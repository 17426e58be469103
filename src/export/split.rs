//! One pass over the answer, a file per scan or per class.

use super::{ExportError, ExportOptions, Exported, PartOf, Shape, SplitBy, Target, Written, begin};
use crate::formats::{OutputFormat, PointWriter};
use crate::points::{Attribute, Batch, Number, counted};
use crate::query::{OutputForm, Query};
use crate::store::Snapshot;
use crate::store::model::ScanId;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

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
    let mut whole = query.clone().with_scans(true);
    if by == SplitBy::Class {
        if !snapshot.attributes().iter().any(|a| a.attribute.name == CLASS) {
            return Err(ExportError::NoClass);
        }
        // Also where the files are not to have it.
        whole = whole.with_attribute(CLASS);
    }
    let form = whole.output_form(snapshot)?;
    let classes = Classes::of(snapshot, &form);
    if by == SplitBy::Class && classes.is_empty() {
        return Err(ExportError::NoClass);
    }
    let all = form.attributes;
    let mut files = Files { snapshot, query, path, format, options, all, parts: BTreeMap::new() };
    let (mut failure, mut points) = (None, 0);
    let answer = whole.run(snapshot, |batch| {
        let key = |i: usize| match by {
            SplitBy::Class => Key::Class(classes.class(&batch, i)),
            SplitBy::Scan => Key::Scan(batch.scans[i]),
        };
        let mut indices: BTreeMap<Key, Vec<u32>> = BTreeMap::new();
        (0..batch.len()).for_each(|i| indices.entry(key(i)).or_default().push(i as u32));
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
        if of == PartOf::Class(None) {
            notes.push(format!("{} without a class: {}", counted(points, "point"), path.display()));
        }
        notes.extend(shape.planned.notes);
        notes.extend(writer.finish()?);
        written.push(Written { path, points, part: Some(of) });
    }
    Ok(Exported { answer, files: written, notes })
}

/// What a file is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Key {
    Scan(ScanId),
    Class(Option<i64>),
}

/// The name of classes.
const CLASS: &str = "Classification";

/// Where the classes of points are: scans may have them in several types.
struct Classes(Vec<Column>);

struct Column {
    index: usize,
    no_data: Option<[u8; 8]>,
    /// The scans that have it, ascending.
    scans: Vec<ScanId>,
}

impl Classes {
    fn of(snapshot: &Snapshot, form: &OutputForm) -> Self {
        let column = |(index, attribute): (usize, &Attribute)| {
            let slot = snapshot.attributes().iter().find(|s| s.attribute.identity() == attribute.identity())?.id;
            let has = |id: &ScanId| snapshot.scan(*id).is_some_and(|s| s.attributes.contains(&slot));
            let scans: Vec<ScanId> = form.scans.iter().copied().filter(has).collect();
            Some(Column { index, no_data: attribute.no_data_bytes(), scans })
        };
        let named = form.attributes.iter().enumerate().filter(|(_, a)| a.name == CLASS);
        Self(named.filter_map(column).filter(|c| !c.scans.is_empty()).collect())
    }

    fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The class of a point; `None` if its scan has none, or it is no whole number.
    fn class(&self, batch: &Batch, i: usize) -> Option<i64> {
        let column = self.0.iter().find(|c| c.scans.binary_search(&batch.scans[i]).is_ok())?;
        let values = &batch.columns[column.index];
        if column.no_data.is_some_and(|no_data| values.raw(i) == no_data) {
            return None;
        }
        match values.number(i) {
            Number::Unsigned(v) => i64::try_from(v).ok(),
            Number::Signed(v) => Some(v),
            Number::Float(v) => (v.fract() == 0.0 && v.abs() < 1e15).then_some(v as i64),
        }
    }
}

/// The files that are being written.
struct Files<'a> {
    snapshot: &'a Snapshot,
    query: &'a Query,
    path: &'a Path,
    format: OutputFormat,
    options: &'a ExportOptions,
    /// The attributes of the batches.
    all: Arc<[Attribute]>,
    parts: BTreeMap<Key, Part>,
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
    fn part(&mut self, key: Key) -> Result<&mut Part, ExportError> {
        // Begun before it is put in its place: that needs the others.
        let begun = if self.parts.contains_key(&key) { None } else { Some(self.begin(key)?) };
        Ok(match (self.parts.entry(key), begun) {
            (Entry::Vacant(place), Some(part)) => place.insert(part),
            (Entry::Vacant(_), None) => return Err(ExportError::NoScan(0)),
            (Entry::Occupied(place), _) => place.into_mut(),
        })
    }

    fn begin(&self, key: Key) -> Result<Part, ExportError> {
        if self.parts.len() >= MOST_FILES {
            return Err(ExportError::TooManyFiles { most: MOST_FILES });
        }
        let (name, one, of) = match key {
            Key::Class(class) => {
                let name = class.map_or("noclass".into(), |class| format!("class{class}"));
                (name, self.query.clone(), PartOf::Class(class))
            }
            Key::Scan(id) => {
                let scan = self.snapshot.scan(id).ok_or(ExportError::NoScan(id))?;
                let fit = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' };
                let name = scan.name.chars().map(fit).collect();
                // By its name: another one may be called as its number is.
                (name, self.query.clone().scans([scan.name.clone()]), PartOf::Scan(scan.name.clone()))
            }
        };
        let stem = self.path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let ending = self.path.extension().map(|e| format!(".{}", e.to_string_lossy())).unwrap_or_default();
        let mut path = self.path.with_file_name(format!("{stem}_{name}{ending}"));
        // Names that differ only in what a file name cannot have.
        if let (Key::Scan(id), true) = (key, self.parts.values().any(|p| p.path == path)) {
            path = self.path.with_file_name(format!("{stem}_{name}_{id}{ending}"));
        }
        let (shape, writer) = begin(self.snapshot, &one, Target::File(&path), self.format, self.options)?;
        let columns =
            shape.attributes.iter().filter_map(|a| self.all.iter().position(|b| a.identity() == b.identity()));
        let columns = columns.collect();
        Ok(Part { path, of, writer, points: 0, columns, shape })
    }
}

impl Part {
    fn write(&mut self, batch: &Batch) -> Result<(), ExportError> {
        let columns = self.columns.iter().map(|&c| batch.columns[c].clone()).collect();
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

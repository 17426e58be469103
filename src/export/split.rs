//! One pass over the answer, a file per scan or per class.

use super::{ExportError, ExportOptions, Exported, PartOf, Shape, SplitBy, Target, Written, begin};
use crate::formats::{OutputFormat, PointWriter};
use crate::points::{Attribute, Batch, Number, counted};
use crate::query::kinds::Kinds;
use crate::query::{OutputForm, Query};
use crate::store::Snapshot;
use crate::store::model::{Scan, ScanId};
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Open files at a time; more classes than there can be.
const MOST_FILES: usize = 1024;

/// Bytes of a file's name that every file system takes.
const LONGEST_NAME: usize = 255;

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
    let paths = scan_paths(snapshot, &form.scans, path);
    let all = form.attributes;
    let mut files = Files { snapshot, query, path, paths, format, options, all, parts: BTreeMap::new() };
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
    if by == SplitBy::Scan && query.has_filter() && !Kinds::of(snapshot, &form.scans).is_empty() {
        notes.push(
            "scans differ in their kind of colours or angles: --where compared what all together have (16 bits, steps of 0.006 \
             degrees), and each file has its scan's own values"
                .to_owned(),
        );
    }
    let mut new = Vec::new();
    for Part { path, of, writer, points, shape, .. } in files.parts.into_values() {
        if of == PartOf::Class(None) {
            notes.push(format!("{} without a class: {}", counted(points, "point"), path.display()));
        }
        notes.extend(shape.planned.notes);
        let is_new = path.symlink_metadata().is_err();
        match writer.finish() {
            Ok(of_file) => notes.extend(of_file),
            Err(error) => {
                // All files or none; those that have replaced others are whole, and stay.
                new.iter().for_each(|path| drop(std::fs::remove_file(path)));
                return Err(error.into());
            }
        }
        if is_new {
            new.push(path.clone());
        }
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

/// A file for each scan, no two of one name, also where capital letters make no difference.
fn scan_paths(snapshot: &Snapshot, scans: &[ScanId], path: &Path) -> BTreeMap<ScanId, PathBuf> {
    let fit = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    let mut taken = BTreeSet::new();
    let mut of = |scan: &Scan| {
        let name: String = scan.name.chars().map(fit).collect();
        let mut take = |after: &str| {
            let (path, is_whole) = part_path(path, &name, after);
            // What is cut off may be all that tells two of them apart.
            let is_free = is_whole || !after.is_empty();
            (is_free && taken.insert(path.to_string_lossy().to_lowercase())).then_some(path)
        };
        let numbered = || (1_u64..).map(|n| if n == 1 { format!("_{}", scan.id) } else { format!("_{}_{n}", scan.id) });
        take("").or_else(|| numbered().find_map(|after| take(&after)))
    };
    scans.iter().filter_map(|&id| Some((id, of(snapshot.scan(id)?)?))).collect()
}

/// `out_NAME.las` for `out.las`, with `after` behind the name, which is cut to what a file's name may have; says if it is
/// whole.
fn part_path(path: &Path, name: &str, after: &str) -> (PathBuf, bool) {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let ending = path.extension().map(|e| format!(".{}", e.to_string_lossy())).unwrap_or_default();
    let room = LONGEST_NAME.saturating_sub(stem.len() + 1 + after.len() + ending.len());
    let cut = &name[..name.floor_char_boundary(room)];
    (path.with_file_name(format!("{stem}_{cut}{after}{ending}")), cut.len() == name.len())
}

/// The files that are being written.
struct Files<'a> {
    snapshot: &'a Snapshot,
    query: &'a Query,
    path: &'a Path,
    /// Those of the scans.
    paths: BTreeMap<ScanId, PathBuf>,
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
        let (path, one, of) = match key {
            Key::Class(class) => {
                let name = class.map_or("noclass".into(), |class| format!("class{class}"));
                (part_path(self.path, &name, "").0, self.query.clone(), PartOf::Class(class))
            }
            Key::Scan(id) => {
                let scan = self.snapshot.scan(id).ok_or(ExportError::NoScan(id))?;
                let path = self.paths.get(&id).ok_or(ExportError::NoScan(id))?.clone();
                // By its name: another one may be called as its number is.
                (path, self.query.clone().scans([scan.name.clone()]), PartOf::Scan(scan.name.clone()))
            }
        };
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

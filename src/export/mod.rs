//! Answers to files: what a file will be is decided from the scans that contribute to it, then the points are written as
//! they are decoded.

mod error;
mod frame;
mod joined;
mod meeting;
mod order;
mod plan;
mod returns;
mod split;

pub use error::ExportError;
pub use meeting::Meeting;
pub(crate) use order::Order;
pub(crate) use plan::plan;
use plan::{Planned, is_las};

use crate::formats::{CreateOptions, OutputFormat, PointWriter, create, create_standard_output};
use crate::points::{Attribute, Batch, Column, ScalarType};
use crate::query::{Answer, Query};
use crate::store::Snapshot;
use frame::ScanFrame;
use serde::Serialize;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Where points go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target<'p> {
    /// A file, which appears when it is complete, or not at all.
    File(&'p Path),
    /// The standard output.
    StandardOutput,
}

/// One file for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum SplitBy {
    /// `out_NAME.las` for `out.las`.
    Scan,
    /// `out_class2.las` for `out.las`.
    Class,
}

/// In which frame coordinates are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Frame {
    /// The world's.
    #[default]
    World,
    /// The one of the scan, where its scanner is the origin.
    Scan,
}

/// How an answer is written.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExportOptions {
    /// The form; what the name ends in, if nothing is said.
    pub format: Option<OutputFormat>,
    /// LAS and LAZ: coordinates in these steps, instead of those of the scans, if they agree, or the store's.
    pub scale: Option<[f64; 3]>,
    /// In which frame.
    pub frame: Frame,
    /// One file for each scan or class.
    pub split: Option<SplitBy>,
    /// A column `Scan`, the number of each point's scan?
    pub with_scan: bool,
    /// Replace files that are there?
    pub force: bool,
}

/// What was written.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Exported {
    /// The answer's report.
    pub answer: Answer,
    /// The files; none for the standard output.
    pub files: Vec<Written>,
    /// What a user should know of them.
    pub notes: Vec<String>,
}

/// A file that was written.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Written {
    /// The file.
    #[serde(serialize_with = "as_shown")]
    pub path: PathBuf,
    /// Its points.
    pub points: u64,
    /// What it holds of an answer that was split.
    #[serde(flatten)]
    pub part: Option<PartOf>,
}

/// A path as messages show it: JSON has no place for one that is no UTF-8.
fn as_shown<S: serde::Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(&path.display())
}

/// Which part of an answer a file holds.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum PartOf {
    /// The points of the scan of this name, which its file's name need not spell.
    Scan(String),
    /// The points of a class; `None`: those that have none.
    Class(Option<i64>),
}

/// The form of a file by what its name ends in.
///
/// # Errors
///
/// [`ExportError::Ending`]
pub fn format_of(path: &Path) -> Result<OutputFormat, ExportError> {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("");
    // A LAZ file without the octree that this name promises.
    let stem = path.file_stem().map(Path::new);
    if stem.and_then(Path::extension).is_some_and(|e| e.eq_ignore_ascii_case("copc")) {
        return Err(ExportError::Ending { path: path.into(), ending: format!("copc.{ending}") });
    }
    OutputFormat::of_extension(ending).ok_or_else(|| ExportError::Ending { path: path.into(), ending: ending.into() })
}

/// Writes the points of a query in its order, in bounded memory. `progress` is told the points written, now and then.
///
/// ```
/// use esker::export::{ExportOptions, Target, export};
/// use esker::lattice::Lattice;
/// use esker::query::{Filter, Query};
/// use esker::store::{SiteOptions, Store};
///
/// # let folder = std::env::temp_dir().join(format!("esker-export-{}", std::process::id()));
/// # std::fs::create_dir_all(&folder)?;
/// # let store = Store::in_memory(SiteOptions::new(Lattice::uniform(0.001)?))?;
/// let path = folder.join("low.laz");
/// let low = Query::new().filter(Filter::parse("Z < 10")?);
/// let done = export(&store.snapshot()?, &low, Target::File(&path), &ExportOptions::default(), |_| {})?;
/// assert_eq!((&done.files[0].path, done.files[0].points), (&path, done.answer.points));
/// # std::fs::remove_dir_all(&folder)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
///
/// [`ExportError`]; then no file is there that was not there before.
pub fn export(
    snapshot: &Snapshot,
    query: &Query,
    target: Target<'_>,
    options: &ExportOptions,
    mut progress: impl FnMut(u64),
) -> Result<Exported, ExportError> {
    let format = match (options.format, target) {
        (Some(format), _) => format,
        (None, Target::File(path)) => format_of(path)?,
        (None, Target::StandardOutput) => OutputFormat::Csv,
    };
    // The records of LAS have room for what the scans have that are in the file. Other forms have the same columns everywhere.
    let tight;
    let query = if is_las(format) {
        tight = query.clone().tight();
        &tight
    } else {
        query
    };
    match (options.split, target) {
        (Some(by), Target::File(path)) => split::split(snapshot, query, path, format, by, options, &mut progress),
        (Some(_), Target::StandardOutput) => Err(ExportError::SplitOfStandardOutput),
        (None, _) => write(snapshot, query, target, format, options, &mut progress),
    }
}

fn write(
    snapshot: &Snapshot,
    query: &Query,
    target: Target<'_>,
    format: OutputFormat,
    options: &ExportOptions,
    progress: &mut dyn FnMut(u64),
) -> Result<Exported, ExportError> {
    let (shape, mut writer) = begin(snapshot, query, target, format, options)?;
    let query = query.clone().with_scans(shape.needs_scans());
    let mut notes = shape.planned.notes.clone();
    let packer = writer.packer();
    let pack = move |mut batch: Batch| {
        shape.apply(&mut batch)?;
        let points = batch.len() as u64;
        Ok::<_, ExportError>((points, packer.pack(batch)?))
    };
    let (mut failure, mut points) = (None, 0);
    let answer = query.run_mapped(snapshot, pack, |packed| {
        let written = packed.and_then(|(more, packed)| {
            writer.write_packed(packed)?;
            points += more;
            progress(points);
            Ok(())
        });
        failure = written.err();
        if failure.is_some() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    if let Some(error) = failure {
        return Err(error);
    }
    notes.extend(writer.finish()?);
    let files = match target {
        Target::File(path) => vec![Written { path: path.into(), points: answer.points, part: None }],
        Target::StandardOutput => Vec::new(),
    };
    Ok(Exported { answer, files, notes })
}

/// What is decided of a file before its first point.
struct Shape {
    attributes: Arc<[Attribute]>,
    planned: Planned,
    frame: Option<ScanFrame>,
    order: Order,
    /// Is the scan of each point a column?
    with_scan: bool,
}

/// The name of the column of scans.
const SCAN: &str = "Scan";

/// Begins a file for the answer to a query.
fn begin(
    snapshot: &Snapshot,
    query: &Query,
    target: Target<'_>,
    format: OutputFormat,
    options: &ExportOptions,
) -> Result<(Shape, Box<dyn PointWriter>), ExportError> {
    let form = query.output_form(snapshot)?;
    let frame = (options.frame == Frame::Scan).then(|| ScanFrame::of(snapshot, &form)).transpose()?;
    // The records of a source have no place for its number.
    let all_attributes = query.asks_for_all_attributes() && !options.with_scan;
    let mut planned = plan(snapshot, &form, format, all_attributes, options.scale)?;
    if let Some(frame) = &frame {
        frame.plan(&mut planned, format, options.scale)?;
    }
    let order = Order::of(query, snapshot, &planned.plan.attributes, format);
    planned.plan.attributes = order.attributes(&planned.plan.attributes);
    if options.with_scan {
        planned.plan.attributes = with_scan(&planned.plan.attributes);
    }
    let create_options = CreateOptions {
        force: options.force,
        standard_gps_time: planned.standard_gps_time,
        las_values: planned.las_values.clone(),
        ..CreateOptions::default()
    };
    let writer = match target {
        Target::File(path) => create(path, format, &planned.plan, &create_options)?,
        Target::StandardOutput => create_standard_output(format, &planned.plan, &create_options)?,
    };
    Ok((Shape { attributes: form.attributes, planned, frame, order, with_scan: options.with_scan }, writer))
}

/// These, and the scan.
fn with_scan(attributes: &[Attribute]) -> Arc<[Attribute]> {
    attributes.iter().cloned().chain([Attribute::new(SCAN, ScalarType::U32)]).collect()
}

impl Shape {
    /// Must it be known which scan a point is of?
    fn needs_scans(&self) -> bool {
        self.with_scan || self.planned.meeting.needs_scans() || !self.planned.without_returns.is_empty()
    }

    /// Makes the points of a batch what the file has.
    fn apply(&self, batch: &mut Batch) -> Result<(), ExportError> {
        self.planned.meeting.apply(batch);
        self.planned.without_returns.apply(batch);
        self.frame.as_ref().map_or(Ok(()), |frame| frame.apply(batch))?;
        self.order.apply(batch);
        if self.with_scan {
            batch.columns.push(Column::U32(batch.scans.clone()));
            batch.attributes = with_scan(&batch.attributes);
        }
        Ok(())
    }
}

//! What every writer of point files takes: a plan that is fixed before the first point, then batches.

mod csv;
mod destination;
mod las;
mod names;
mod number;
mod numpy;
mod ply;
mod raster;
mod rows;

pub use destination::{OutputFile, check_output, is_database, remove_unfinished};
pub use las::{CreationDate, LasField, LasValues, las_field};
pub use raster::{Raster, RasterFormat, write_raster};

use super::FormatError;
use crate::lattice::Lattice;
use crate::points::{Attribute, Batch, Crs, LasFacts};
use csv::{CsvSink, CsvWriter, Lines};
use destination::Destination;
use las::{LasOptions, LasWriter, Records};
use numpy::{NpyWriter, NpzWriter};
use ply::PlyWriter;
use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The form of an output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
#[non_exhaustive]
pub enum OutputFormat {
    Las,
    Laz,
    Ply,
    Csv,
    Xyz,
    Npy,
    Npz,
}

impl OutputFormat {
    /// By the ending of a file name, case-insensitively.
    pub fn of_extension(extension: &str) -> Option<Self> {
        match extension.to_ascii_lowercase().as_str() {
            "las" => Some(Self::Las),
            "laz" => Some(Self::Laz),
            "ply" => Some(Self::Ply),
            "csv" => Some(Self::Csv),
            "xyz" | "txt" => Some(Self::Xyz),
            "npy" => Some(Self::Npy),
            "npz" => Some(Self::Npz),
            _ => None,
        }
    }
}

/// What a LAS or LAZ file will look like, decided from the contributing scans.
#[derive(Clone, Debug, PartialEq)]
pub enum LasTarget {
    /// All contributing scans agree on version, point format, scale, offset and extra bytes: theirs.
    AsSource(LasFacts),
    /// They disagree or are no LAS files: the smallest point format of LAS 1.4 that holds the attributes, at this scale
    /// and offset, other attributes as extra bytes.
    Merged {
        /// Scale per axis.
        scale: [f64; 3],
        /// Offset per axis.
        offset: [f64; 3],
    },
}

/// Everything that a writer needs to know before the first point.
#[derive(Clone, Debug)]
pub struct OutputPlan {
    /// What the positions mean.
    pub lattice: Lattice,
    /// The columns of every batch that will come, in this order.
    pub attributes: Arc<[Attribute]>,
    /// The CRS to write, if known. To [`LasTarget::AsSource`] it is given only in place of what the source's records say:
    /// without one these are written as they are.
    pub crs: Option<Crs>,
    /// For LAS and LAZ; other formats ignore it.
    pub las: LasTarget,
}

/// What may be said of an output beyond its plan.
#[derive(Clone, Debug, Default)]
pub struct CreateOptions {
    /// Replace an existing file?
    pub force: bool,
    /// The points that will come, where that is known: an output that cannot hold them is refused at once.
    pub points: Option<u64>,
    /// Are the GPS times of a merged LAS file adjusted standard ones, not seconds of a week? For
    /// [`LasTarget::AsSource`] the source says.
    pub standard_gps_time: bool,
    /// By its name, what is known of the values of an attribute that is called as a field of LAS but has another type, or
    /// values that may not fit ([`las_field`]): where they fit, a merged LAS file's own field has them, too.
    pub las_values: BTreeMap<String, LasValues>,
    /// The date in a LAS header; today, if `None`. For files that must be the same whenever they are made.
    pub creation_date: Option<CreationDate>,
}

impl CreateOptions {
    fn las(&self, format: OutputFormat) -> LasOptions<'_> {
        LasOptions {
            compressed: format == OutputFormat::Laz,
            date: self.creation_date.unwrap_or_else(CreationDate::today),
            standard_time: self.standard_gps_time,
            values: &self.las_values,
            points: self.points,
        }
    }
}

/// Begins the file `path` in the form `format`. It is written under a temporary name beside `path` and appears there when
/// it is finished; a writer that is dropped before leaves nothing. After an error a writer can only be dropped.
///
/// # Errors
///
/// [`FormatError::Unwritable`] if `path` exists and is not to be replaced, is no place for a file, or the plan does not
/// fit the format; [`FormatError::Io`] if the system refuses.
pub fn create(
    path: &Path,
    format: OutputFormat,
    plan: &OutputPlan,
    options: &CreateOptions,
) -> Result<Box<dyn PointWriter>, FormatError> {
    let (destination, file) = Destination::file(path, options.force)?;
    if let Some(lines) = lines(format) {
        return Ok(checked(path, plan, CsvWriter::create(CsvSink::File(file, destination), plan, lines)?));
    }
    create_counted(path, destination, file, format, plan, options)
}

/// As [`create`], to the standard output. Text goes there as it comes; the other forms have counts at their front, so they
/// are written to a temporary file first, in the system's folder for such.
///
/// # Errors
///
/// As [`create`].
pub fn create_standard_output(
    format: OutputFormat,
    plan: &OutputPlan,
    options: &CreateOptions,
) -> Result<Box<dyn PointWriter>, FormatError> {
    let shown = Path::new(STANDARD_OUTPUT);
    if let Some(lines) = lines(format) {
        return Ok(checked(shown, plan, CsvWriter::create(CsvSink::Standard(std::io::stdout()), plan, lines)?));
    }
    let (destination, file) = Destination::standard_output()?;
    create_counted(shown, destination, file, format, plan, options)
}

/// How the lines of a form of text are made; `None` for others.
fn lines(format: OutputFormat) -> Option<Lines> {
    match format {
        OutputFormat::Csv => Some(Lines::Csv),
        OutputFormat::Xyz => Some(Lines::Xyz),
        _ => None,
    }
}

/// What messages call the standard output.
const STANDARD_OUTPUT: &str = "standard output";

/// A writer of a form that has counts at its front, so that it needs a file.
fn create_counted(
    shown: &Path,
    destination: Destination,
    file: File,
    format: OutputFormat,
    plan: &OutputPlan,
    options: &CreateOptions,
) -> Result<Box<dyn PointWriter>, FormatError> {
    Ok(match format {
        OutputFormat::Ply => checked(shown, plan, PlyWriter::create(destination, file, plan)?),
        OutputFormat::Npy => checked(shown, plan, NpyWriter::create(destination, file, plan)?),
        OutputFormat::Npz => checked(shown, plan, NpzWriter::create(destination, file, plan)?),
        _ => checked(shown, plan, LasWriter::create(destination, file, plan, options.las(format))?),
    })
}

fn checked(shown: &Path, plan: &OutputPlan, writer: impl PointWriter + 'static) -> Box<dyn PointWriter> {
    let (shown, attributes) = (shown.into(), plan.attributes.clone());
    Box::new(Checked { writer: Box::new(writer), attributes, shown, failed: false })
}

/// A writer that is given nothing but what the plan announced, and nothing more after an error.
struct Checked<W> {
    writer: Box<W>,
    attributes: Arc<[Attribute]>,
    shown: PathBuf,
    failed: bool,
}

impl<W: PointWriter> Checked<W> {
    fn usable(&self) -> Result<(), FormatError> {
        let reason = "was given up after an error".into();
        if self.failed { Err(FormatError::Unwritable { path: self.shown.clone(), reason }) } else { Ok(()) }
    }
}

impl<W: PointWriter> PointWriter for Checked<W> {
    fn shown(&self) -> &Path {
        &self.shown
    }

    fn write(&mut self, batch: &Batch) -> Result<(), FormatError> {
        self.usable()?;
        let written = check_batch(batch, &self.attributes, &self.shown).and_then(|()| self.writer.write(batch));
        self.failed = written.is_err();
        written
    }

    fn packer(&self) -> Arc<dyn Packer> {
        let (shown, attributes) = (self.shown.clone(), self.attributes.clone());
        Arc::new(CheckedPacker { packer: self.writer.packer(), attributes, shown })
    }

    fn write_packed(&mut self, packed: Packed) -> Result<(), FormatError> {
        self.usable()?;
        let written = self.writer.write_packed(packed);
        self.failed = written.is_err();
        written
    }

    fn finish(self: Box<Self>) -> Result<Vec<String>, FormatError> {
        self.usable()?;
        self.writer.finish()
    }
}

/// A packer that is given nothing but what the plan announced.
struct CheckedPacker {
    packer: Arc<dyn Packer>,
    attributes: Arc<[Attribute]>,
    shown: PathBuf,
}

impl Packer for CheckedPacker {
    fn pack(&self, batch: Batch) -> Result<Packed, FormatError> {
        check_batch(&batch, &self.attributes, &self.shown)?;
        self.packer.pack(batch)
    }
}

/// Batches must be what the plan announced: types decide how bytes are laid out.
fn check_batch(batch: &Batch, attributes: &[Attribute], shown: &Path) -> Result<(), FormatError> {
    let same = batch.columns.len() == attributes.len()
        && batch.columns.iter().zip(attributes).all(|(c, a)| c.ty() == a.ty && c.len() == batch.len())
        && batch.positions.y.len() == batch.len()
        && batch.positions.z.len() == batch.len();
    if same {
        return Ok(());
    }
    Err(FormatError::Unwritable { path: shown.into(), reason: "a batch has other columns than announced".into() })
}

/// A batch in the form in which a writer appends it with the least work: made by its [`Packer`].
pub struct Packed(Form);

enum Form {
    Points(Batch),
    Records(Records),
}

impl Packed {
    fn records(records: Records) -> Self {
        Self(Form::Records(records))
    }
}

/// The part of a writer's work that does not depend on what came before: batches may be packed on several threads.
pub trait Packer: Send + Sync {
    /// Packs a batch for [`PointWriter::write_packed`] of the writer that this packer is of.
    ///
    /// # Errors
    ///
    /// [`FormatError::Unwritable`] if a value or a coordinate does not fit.
    fn pack(&self, batch: Batch) -> Result<Packed, FormatError>;
}

/// For writers that have nothing to do before.
struct AsItIs;

impl Packer for AsItIs {
    fn pack(&self, batch: Batch) -> Result<Packed, FormatError> {
        Ok(Packed(Form::Points(batch)))
    }
}

/// A file that is being written: it appears under its name when it is finished, or not at all.
pub trait PointWriter {
    /// What messages call the file.
    fn shown(&self) -> &Path;

    /// Appends the points of a batch.
    ///
    /// # Errors
    ///
    /// [`FormatError::Io`] if the disk refuses, [`FormatError::Unwritable`] if a coordinate does not fit.
    fn write(&mut self, batch: &Batch) -> Result<(), FormatError>;

    /// Packs batches for this writer.
    fn packer(&self) -> Arc<dyn Packer> {
        Arc::new(AsItIs)
    }

    /// Appends the points of a batch that its [`PointWriter::packer`] has packed.
    ///
    /// # Errors
    ///
    /// As [`PointWriter::write`].
    fn write_packed(&mut self, packed: Packed) -> Result<(), FormatError> {
        match packed.0 {
            Form::Points(batch) => self.write(&batch),
            Form::Records(_) => Err(FormatError::Unwritable {
                path: self.shown().into(),
                reason: "was given what was packed for another writer".into(),
            }),
        }
    }

    /// Completes header and tables, and gives the file its name. Returns what a user should know about the file.
    ///
    /// # Errors
    ///
    /// As [`PointWriter::write`].
    fn finish(self: Box<Self>) -> Result<Vec<String>, FormatError>;
}

#[cfg(test)]
mod tests;

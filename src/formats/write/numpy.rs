//! NumPy out: `.npy`, one structured array, and `.npz`, an archive of one array per field.
//!
//! The fields are X, Y and Z in world coordinates, then the attributes under their LAS names; `numpy.load` reads both. An
//! attribute with a scaling is its real value as a float, NaN where it is no data; all others are as they are stored. The form
//! is NEP 1 with its version 3 (names in UTF-8): a magic number, a dictionary as text, and the values in C order.

use super::destination::Destination;
use super::names::distinct;
use super::rows::{self, Put, Slot};
use super::{OutputPlan, PointWriter};
use crate::formats::FormatError;
use crate::lattice::Lattice;
use crate::points::{Attribute, Batch, Column, Real, ScalarType};
use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Points that become rows at a time.
const BLOCK: usize = 8192;

/// A field of the array.
struct Field {
    name: String,
    ty: ScalarType,
}

/// X, Y, Z, then the attributes; names are unique, as `plain` gives them.
fn fields(attributes: &[Attribute], plain: impl Fn(&Attribute) -> String, notes: &mut Vec<String>) -> Vec<Field> {
    const AXES: [&str; 3] = ["X", "Y", "Z"];
    let names = distinct(attributes, AXES, plain, "field", notes);
    let of_attribute = |(attribute, name): (&Attribute, String)| {
        let ty = if attribute.scaling.is_some() { ScalarType::F64 } else { attribute.ty };
        Field { name, ty }
    };
    let axes = AXES.map(|name| Field { name: name.into(), ty: ScalarType::F64 });
    axes.into_iter().chain(attributes.iter().zip(names).map(of_attribute)).collect()
}

/// NumPy's word for a type.
fn word(ty: ScalarType) -> &'static str {
    match ty {
        ScalarType::U8 => "|u1",
        ScalarType::I8 => "|i1",
        ScalarType::U16 => "<u2",
        ScalarType::I16 => "<i2",
        ScalarType::U32 => "<u4",
        ScalarType::I32 => "<i4",
        ScalarType::U64 => "<u8",
        ScalarType::I64 => "<i8",
        ScalarType::F32 => "<f4",
        ScalarType::F64 => "<f8",
    }
}

/// The head of an array of `points`; its length does not depend on their number.
fn head(descr: &str, points: u64) -> Vec<u8> {
    let dictionary = |points: u64| format!("{{'descr': {descr}, 'fortran_order': False, 'shape': ({points},), }}");
    let before = 12;
    let length = (before + dictionary(u64::MAX).len() + 1).next_multiple_of(64);
    let mut head = b"\x93NUMPY\x03\x00".to_vec();
    head.extend(((length - before) as u32).to_le_bytes());
    head.extend(dictionary(points).into_bytes());
    head.resize(length - 1, b' ');
    head.push(b'\n');
    head
}

fn structured(fields: &[Field]) -> String {
    let quoted = |name: &str| name.replace('\\', "\\\\").replace('\'', "\\'");
    let one = |f: &Field| format!("('{}', '{}')", quoted(&f.name), word(f.ty));
    format!("[{}]", fields.iter().map(one).collect::<Vec<_>>().join(", "))
}

/// The values of an attribute as they are written; `None` if that is how they are stored.
fn real(attribute: &Attribute, values: &Column) -> Option<Column> {
    attribute.scaling?;
    Some(Column::F64(Real::values(attribute, values, 0..values.len()).collect()))
}

fn world(lattice: &Lattice, batch: &Batch, axis: usize) -> Column {
    let indices = [&batch.positions.x, &batch.positions.y, &batch.positions.z][axis];
    Column::F64(indices.iter().map(|&i| lattice.world_on_axis(axis, i)).collect())
}

/// Puts values `range` into rows; whole values always fit.
fn put(column: &Column, offset: usize, range: std::ops::Range<usize>, rows: &mut [u8], stride: usize) {
    let _ = rows::put(Slot { column: 0, offset, put: Put::Whole }, column, range, rows, stride);
}

fn note_scaled(attributes: &[Attribute], notes: &mut Vec<String>) {
    let scaled: Vec<_> = attributes.iter().filter(|a| a.scaling.is_some()).map(|a| a.name.as_str()).collect();
    if !scaled.is_empty() {
        notes.push(format!("written as real values, scaled, NaN where there is no data: {}", scaled.join(", ")));
    }
}

/// Writes an NPY file.
pub(super) struct NpyWriter {
    file: File,
    lattice: Lattice,
    fields: Vec<Field>,
    stride: usize,
    points: u64,
    notes: Vec<String>,
    // Last, so that the file is closed before it is deleted.
    destination: Destination,
}

impl NpyWriter {
    /// Begins a file: the head is written, its count still open.
    pub fn create(destination: Destination, mut file: File, plan: &OutputPlan) -> Result<Self, FormatError> {
        let mut notes = Vec::new();
        let fields = fields(&plan.attributes, |a| a.name.replace(char::is_control, "_"), &mut notes);
        note_scaled(&plan.attributes, &mut notes);
        let stride = fields.iter().map(|f| f.ty.size()).sum();
        file.write_all(&head(&structured(&fields), 0)).map_err(|e| destination.error("writing", e))?;
        Ok(Self { file, lattice: plan.lattice.clone(), fields, stride, points: 0, notes, destination })
    }
}

impl PointWriter for NpyWriter {
    fn shown(&self) -> &Path {
        self.destination.shown()
    }

    fn write(&mut self, batch: &Batch) -> Result<(), FormatError> {
        let axes = (0..3).map(|axis| Some(world(&self.lattice, batch, axis)));
        let attributes = batch.attributes.iter().zip(&batch.columns).map(|(a, c)| real(a, c));
        let made: Vec<Option<Column>> = axes.chain(attributes).collect();
        let mut rows = Vec::new();
        let mut next = 0;
        while next < batch.len() {
            let range = next..batch.len().min(next + BLOCK);
            next = range.end;
            rows.clear();
            rows.resize(range.len() * self.stride, 0);
            let mut offset = 0;
            for (i, (field, made)) in self.fields.iter().zip(&made).enumerate() {
                let Some(column) = made.as_ref().or_else(|| batch.columns.get(i.checked_sub(3)?)) else { continue };
                put(column, offset, range.clone(), &mut rows, self.stride);
                offset += field.ty.size();
            }
            self.file.write_all(&rows).map_err(|e| self.destination.error("writing", e))?;
        }
        self.points += batch.len() as u64;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Vec<String>, FormatError> {
        let head = head(&structured(&self.fields), self.points);
        let written = self.file.seek(SeekFrom::Start(0)).and_then(|_| self.file.write_all(&head));
        written.map_err(|e| self.destination.error("writing", e))?;
        self.destination.finish(self.file)?;
        Ok(self.notes)
    }
}

/// Writes an NPZ file: columns go to temporary files of their own first, since an archive holds one after the other.
pub(super) struct NpzWriter {
    file: File,
    lattice: Lattice,
    columns: Vec<(Field, BufWriter<File>, Destination)>,
    points: u64,
    notes: Vec<String>,
    // Last, so that the file is closed before it is deleted.
    destination: Destination,
}

impl NpzWriter {
    /// Begins a file.
    pub fn create(destination: Destination, file: File, plan: &OutputPlan) -> Result<Self, FormatError> {
        let mut notes = Vec::new();
        let mut columns = Vec::new();
        // Of a path in an archive, tools make folders.
        let plain = |a: &Attribute| a.name.replace(['/', '\\'], "_");
        for field in fields(&plan.attributes, plain, &mut notes) {
            let (scratch, column) = destination.scratch()?;
            columns.push((field, BufWriter::new(column), scratch));
        }
        note_scaled(&plan.attributes, &mut notes);
        Ok(Self { file, lattice: plan.lattice.clone(), columns, points: 0, notes, destination })
    }

    fn archive(&mut self) -> io::Result<()> {
        let mut archive = ZipWriter::new(BufWriter::new(&mut self.file));
        for (field, column, _) in &mut self.columns {
            column.flush()?;
            let bytes = self.points * field.ty.size() as u64;
            // Plain values: `numpy.load` finds them without unpacking, and noise does not shrink.
            let options = SimpleFileOptions::default()
                .compression_method(CompressionMethod::Stored)
                .large_file(bytes >= u64::from(u32::MAX) - 4096);
            archive.start_file(format!("{}.npy", field.name), options)?;
            archive.write_all(&head(&format!("'{}'", word(field.ty)), self.points))?;
            let file = column.get_mut();
            file.seek(SeekFrom::Start(0))?;
            io::copy(file, &mut archive)?;
        }
        archive.finish()?.flush()
    }
}

impl PointWriter for NpzWriter {
    fn shown(&self) -> &Path {
        self.destination.shown()
    }

    fn write(&mut self, batch: &Batch) -> Result<(), FormatError> {
        let mut bytes = Vec::new();
        for (i, (field, file, _)) in self.columns.iter_mut().enumerate() {
            let made = match i.checked_sub(3) {
                None => Some(world(&self.lattice, batch, i)),
                Some(column) => real(&batch.attributes[column], &batch.columns[column]),
            };
            let Some(column) = made.as_ref().or_else(|| batch.columns.get(i.checked_sub(3)?)) else { continue };
            bytes.clear();
            bytes.resize(batch.len() * field.ty.size(), 0);
            put(column, 0, 0..batch.len(), &mut bytes, field.ty.size());
            file.write_all(&bytes).map_err(|e| self.destination.error("writing", e))?;
        }
        self.points += batch.len() as u64;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Vec<String>, FormatError> {
        self.archive().map_err(|e| self.destination.error("writing", e))?;
        self.destination.finish(self.file)?;
        Ok(self.notes)
    }
}

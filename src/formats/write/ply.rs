//! PLY out: binary, little-endian, points only.
//!
//! Coordinates are `double`; `red green blue` and `nx ny nz` have the names that other programs look for, all other
//! attributes their own. Values are as they are stored; a scaling is told in a comment.

use super::destination::Destination;
use super::names::distinct;
use super::rows::{self, Put, Slot};
use super::{OutputPlan, PointWriter};
use crate::formats::FormatError;
use crate::lattice::Lattice;
use crate::points::{Attribute, Batch, Column, ScalarType};
use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;

/// Points that become rows at a time.
const BLOCK: usize = 8192;
/// Digits of the count that is put in at the end.
const COUNT_DIGITS: usize = 20;

/// Names that other programs look for.
const CUSTOMARY: [(&str, &str); 6] =
    [("Red", "red"), ("Green", "green"), ("Blue", "blue"), ("NormalX", "nx"), ("NormalY", "ny"), ("NormalZ", "nz")];

/// Writes a PLY file.
pub(super) struct PlyWriter {
    file: File,
    lattice: Lattice,
    /// The place of each attribute in a row.
    offsets: Vec<usize>,
    /// The names in the file.
    names: Vec<String>,
    stride: usize,
    rows: Vec<u8>,
    points: u64,
    count_at: u64,
    notes: Vec<String>,
    // Last, so that the file is closed before it is deleted.
    destination: Destination,
}

impl PlyWriter {
    /// Begins a file: the header is written, its count still open.
    pub fn create(destination: Destination, mut file: File, plan: &OutputPlan) -> Result<Self, FormatError> {
        let mut notes = Vec::new();
        let names = names(&plan.attributes, &mut notes);
        let mut header = String::from("ply\nformat binary_little_endian 1.0\n");
        header += concat!("comment written by esker ", env!("CARGO_PKG_VERSION"), "\n");
        for (attribute, name) in plan.attributes.iter().zip(&names) {
            if let Some(scaling) = attribute.scaling {
                header += &format!("comment {name}: real value = stored * {} + {}\n", scaling.scale, scaling.offset);
                notes.push(format!("{name} is written as stored; its scaling is in a comment of the header"));
            }
        }
        header += "element vertex ";
        let count_at = header.len() as u64;
        header += &format!("{:<COUNT_DIGITS$}\n", 0);
        header += "property double x\nproperty double y\nproperty double z\n";
        let mut stride = 24;
        let mut offsets = Vec::new();
        for (attribute, name) in plan.attributes.iter().zip(&names) {
            let (word, size) = ply_type(attribute.ty);
            header += &format!("property {word} {name}\n");
            offsets.push(stride);
            stride += size;
        }
        header += "end_header\n";
        file.write_all(header.as_bytes()).map_err(|e| destination.error("writing", e))?;
        Ok(Self {
            file,
            lattice: plan.lattice.clone(),
            offsets,
            names,
            stride,
            rows: Vec::new(),
            points: 0,
            count_at,
            notes,
            destination,
        })
    }

    /// A column as PLY has it; `None` if it is so already.
    fn converted(&self, column: usize, values: &Column) -> Result<Option<Column>, FormatError> {
        let inexact = |value: String| {
            let name = &self.names[column];
            self.destination.unwritable(format!(
                "{name} {value} has more digits than a PLY number holds; leave the attribute out, or write LAS or CSV"
            ))
        };
        // All integers up to 2^53 are floats; beyond, some are.
        let double = |value: i128| {
            let float = value as f64;
            (float as i128 == value).then_some(float).ok_or_else(|| inexact(value.to_string()))
        };
        let converted: Result<Vec<f64>, _> = match values {
            Column::U64(v) => v.iter().map(|&x| double(x.into())).collect(),
            Column::I64(v) => v.iter().map(|&x| double(x.into())).collect(),
            _ => return Ok(None),
        };
        Ok(Some(Column::F64(converted?)))
    }
}

/// The type in PLY's words, and its bytes. There are no 64-bit integers.
fn ply_type(ty: ScalarType) -> (&'static str, usize) {
    let word = match ty {
        ScalarType::U8 => "uchar",
        ScalarType::I8 => "char",
        ScalarType::U16 => "ushort",
        ScalarType::I16 => "short",
        ScalarType::U32 => "uint",
        ScalarType::I32 => "int",
        ScalarType::F32 => "float",
        ScalarType::U64 | ScalarType::I64 | ScalarType::F64 => "double",
    };
    (word, ty.size())
}

/// Names without spaces, each once.
fn names(attributes: &[Attribute], notes: &mut Vec<String>) -> Vec<String> {
    let plain = |attribute: &Attribute| {
        let customary = CUSTOMARY.iter().find(|(a, _)| *a == attribute.name).map(|(_, b)| *b);
        let plain = customary.unwrap_or(&attribute.name);
        plain.chars().map(|c| if c.is_whitespace() || c.is_control() { '_' } else { c }).collect()
    };
    distinct(attributes, ["x", "y", "z"], plain, "property", notes)
}

impl PointWriter for PlyWriter {
    fn shown(&self) -> &Path {
        self.destination.shown()
    }

    fn write(&mut self, batch: &Batch) -> Result<(), FormatError> {
        let converted = (0..batch.columns.len()).map(|c| self.converted(c, &batch.columns[c]));
        let converted: Vec<_> = converted.collect::<Result<_, _>>()?;
        let stride = self.stride;
        let mut next = 0;
        while next < batch.len() {
            let range = next..batch.len().min(next + BLOCK);
            next = range.end;
            self.rows.clear();
            self.rows.resize(range.len() * stride, 0);
            let positions = [&batch.positions.x, &batch.positions.y, &batch.positions.z];
            for (axis, indices) in positions.into_iter().enumerate() {
                for (row, &index) in self.rows.chunks_exact_mut(stride).zip(&indices[range.clone()]) {
                    let world = self.lattice.world_on_axis(axis, index);
                    row[8 * axis..8 * axis + 8].copy_from_slice(&world.to_le_bytes());
                }
            }
            for (column, converted) in converted.iter().enumerate() {
                let values = converted.as_ref().unwrap_or(&batch.columns[column]);
                let slot = Slot { column, offset: self.offsets[column], put: Put::Whole };
                // Whole values always fit.
                let _ = rows::put(slot, values, range.clone(), &mut self.rows, stride);
            }
            self.file.write_all(&self.rows).map_err(|e| self.destination.error("writing", e))?;
        }
        self.points += batch.len() as u64;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Vec<String>, FormatError> {
        let count = format!("{:<COUNT_DIGITS$}", self.points);
        let mut complete = || {
            self.file.seek(SeekFrom::Start(self.count_at))?;
            self.file.write_all(count.as_bytes())
        };
        complete().map_err(|e| self.destination.error("writing", e))?;
        self.destination.finish(self.file)?;
        Ok(self.notes)
    }
}

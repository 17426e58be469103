//! Text out: as CSV, a line of names, then a line per point; as XYZ, blanks for commas and no names.
//!
//! X, Y and Z are the exact decimals that the coordinates are. An attribute with a scaling is written as its real value
//! (`raw * scale + offset`, in decimal where the raw value is an integer), one that is its no-data value as nothing (NaN in
//! XYZ). All others are written as they are stored, floats as the shortest text that reads back as the same number.

use super::destination::Destination;
use super::names::distinct;
use super::number::{Exact, push_f32, push_f64, push_signed, push_unsigned};
use super::{OutputPlan, PointWriter, STANDARD_OUTPUT};
use crate::formats::FormatError;
use crate::points::{Attribute, Batch, Column, Scaling};
use std::fs::File;
use std::io::{Stdout, Write};
use std::path::Path;
use std::sync::Arc;

/// Bytes of text that are collected before they are written.
const BUFFER_BYTES: usize = 1 << 20;

/// Where the text goes.
pub(super) enum CsvSink {
    /// To a file that gets its name at the end.
    File(File, Destination),
    /// Right to the standard output: nothing at the front of a CSV file has to wait for its end.
    Standard(Stdout),
}

impl CsvSink {
    /// What messages call it.
    fn shown(&self) -> &Path {
        match self {
            Self::File(_, destination) => destination.shown(),
            Self::Standard(_) => Path::new(STANDARD_OUTPUT),
        }
    }

    fn write(&mut self, text: &[u8]) -> Result<(), FormatError> {
        match self {
            Self::File(file, destination) => file.write_all(text).map_err(|e| destination.error("writing", e)),
            Self::Standard(out) => {
                let written = out.write_all(text).and_then(|()| out.flush());
                written.map_err(|source| FormatError::Io { path: STANDARD_OUTPUT.into(), action: "writing", source })
            }
        }
    }
}

/// How lines are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Lines {
    /// Commas, and names in the first line.
    Csv,
    /// Blanks, and points from the first line on, as most programs read it.
    Xyz,
}

impl Lines {
    fn separator(self) -> u8 {
        match self {
            Self::Csv => b',',
            Self::Xyz => b' ',
        }
    }
}

/// Writes a CSV or XYZ file.
pub(super) struct CsvWriter {
    lines: Lines,
    axes: [Exact; 3],
    attributes: Arc<[Attribute]>,
    /// How each scaled attribute is printed.
    scaled: Vec<Option<Scaled>>,
    text: Vec<u8>,
    notes: Vec<String>,
    sink: CsvSink,
}

/// How a scaled attribute is printed.
#[derive(Clone, Copy)]
enum Scaled {
    Exact(Exact),
    Float(Scaling),
}

impl CsvWriter {
    /// Begins a file, with its line of names if it has one.
    pub fn create(sink: CsvSink, plan: &OutputPlan, lines: Lines) -> Result<Self, FormatError> {
        let axis = |axis| {
            Exact::of_axis(&plan.lattice, axis).ok_or_else(|| FormatError::Unwritable {
                path: sink.shown().into(),
                reason: "the lattice's quantum and phase have too many digits".into(),
            })
        };
        let axes = [axis(0)?, axis(1)?, axis(2)?];
        let mut text = [b'X', lines.separator(), b'Y', lines.separator(), b'Z'].to_vec();
        let mut notes = Vec::new();
        for name in distinct(&plan.attributes, ["X", "Y", "Z"], |a| a.name.clone(), "column", &mut notes) {
            text.push(lines.separator());
            push_name(&mut text, &name);
        }
        text.push(b'\n');
        if lines == Lines::Xyz {
            if !plan.attributes.is_empty() {
                notes.push(format!("the columns are {}", String::from_utf8_lossy(&text).trim_end()));
            }
            text.clear();
        }
        let scaled = plan.attributes.iter().map(|a| {
            let scaling = a.scaling?;
            Some(Exact::of_scaling(scaling).map_or(Scaled::Float(scaling), Scaled::Exact))
        });
        Ok(Self { axes, attributes: plan.attributes.clone(), scaled: scaled.collect(), text, notes, sink, lines })
    }

    fn push_value(&mut self, column: usize, values: &Column, i: usize) {
        let attribute = &self.attributes[column];
        let size = attribute.ty.size();
        if attribute.no_data.is_some_and(|no_data| no_data[..size] == values.raw(i)[..size]) {
            if self.lines == Lines::Xyz {
                // Blanks next to each other are one.
                self.text.extend_from_slice(b"NaN");
            }
            return;
        }
        let out = &mut self.text;
        match (self.scaled[column], values.as_integer(i)) {
            (Some(Scaled::Exact(exact)), Some(n)) => exact.push(out, n),
            (Some(Scaled::Float(s)), _) => push_f64(out, values.as_f64(i) * s.scale + s.offset),
            (Some(Scaled::Exact(_)), None) => {
                if let Some(s) = attribute.scaling {
                    push_f64(out, values.as_f64(i) * s.scale + s.offset);
                }
            }
            (None, _) => match values {
                Column::U8(v) => push_unsigned(out, v[i].into()),
                Column::U16(v) => push_unsigned(out, v[i].into()),
                Column::U32(v) => push_unsigned(out, v[i].into()),
                Column::U64(v) => push_unsigned(out, v[i]),
                Column::I8(v) => push_signed(out, v[i].into()),
                Column::I16(v) => push_signed(out, v[i].into()),
                Column::I32(v) => push_signed(out, v[i].into()),
                Column::I64(v) => push_signed(out, v[i]),
                Column::F32(v) => push_f32(out, v[i]),
                Column::F64(v) => push_f64(out, v[i]),
            },
        }
    }

    fn flush(&mut self) -> Result<(), FormatError> {
        self.sink.write(&self.text)?;
        self.text.clear();
        Ok(())
    }
}

/// A name, in quotes if it needs them (RFC 4180).
fn push_name(text: &mut Vec<u8>, name: &str) {
    if name.contains([',', '"', '\n', '\r']) {
        text.push(b'"');
        text.extend_from_slice(name.replace('"', "\"\"").as_bytes());
        text.push(b'"');
    } else {
        text.extend_from_slice(name.as_bytes());
    }
}

impl PointWriter for CsvWriter {
    fn shown(&self) -> &Path {
        self.sink.shown()
    }

    fn write(&mut self, batch: &Batch) -> Result<(), FormatError> {
        let separator = self.lines.separator();
        let positions = [&batch.positions.x, &batch.positions.y, &batch.positions.z];
        for i in 0..batch.len() {
            for axis in 0..3 {
                if axis > 0 {
                    self.text.push(separator);
                }
                self.axes[axis].push_index(&mut self.text, positions[axis][i]);
            }
            for (column, values) in batch.columns.iter().enumerate() {
                self.text.push(separator);
                self.push_value(column, values, i);
            }
            self.text.push(b'\n');
            if self.text.len() >= BUFFER_BYTES {
                self.flush()?;
            }
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Vec<String>, FormatError> {
        self.flush()?;
        if let CsvSink::File(file, destination) = self.sink {
            destination.finish(file)?;
        }
        let mut notes = self.notes;
        let scaled: Vec<_> = self.attributes.iter().filter(|a| a.scaling.is_some()).map(|a| a.name.as_str()).collect();
        if !scaled.is_empty() {
            notes.push(format!("written as real values, scaled: {}", scaled.join(", ")));
        }
        Ok(notes)
    }
}

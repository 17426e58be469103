//! LAS and LAZ out: columns become records in blocks, records become the file's bytes, the header comes last.

mod crs;
mod encoder;
mod extra;
mod header;
mod integers;
mod plan;

use super::destination::Destination;
use super::rows::{self, Slot};
use super::{Form, LasTarget, OutputPlan, Packed, Packer, PointWriter};
use crate::formats::FormatError;
use crate::formats::las::tables::PointFormat;
use crate::points::{Attribute, Batch, Column, FieldKind, ScalarType};
use encoder::Encoder;
pub use header::CreationDate;
use header::{Header, Totals};
use integers::{BLOCK, Integers};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::Path;
use std::path::PathBuf;
use std::sync::Arc;

/// Bytes of records that are collected before they are written.
const BUFFER_BYTES: usize = 1 << 20;

/// How a LAS file is made, beyond the plan.
#[derive(Clone, Copy, Debug)]
pub(super) struct LasOptions<'a> {
    /// LAZ?
    pub compressed: bool,
    pub date: CreationDate,
    /// Are the GPS times of a merged file adjusted standard ones?
    pub standard_time: bool,
    /// The points that will come, if known.
    pub points: Option<u64>,
    /// By the names of LAS's fields.
    pub values: &'a BTreeMap<String, LasValues>,
}

/// What is known of the values of all attributes of one name, which is that of a field of LAS.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LasValues {
    /// The least and the greatest of those that have another type than the field.
    pub ends: Option<[f64; 2]>,
    /// The greatest of those that have the field's type.
    pub own_most: f64,
    /// Has every point one, and just one? Where another scan has another of them, or none, that is 0 here.
    pub is_one: bool,
    /// Has no point two of them? Then they may be added up.
    pub is_at_most_one: bool,
}

/// A field in the records of LAS 1.4's newer point formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LasField {
    /// The type of its values.
    pub ty: ScalarType,
    /// The greatest value, where it has fewer bits than its type.
    pub most: Option<u8>,
}

/// The field of this name.
pub fn las_field(name: &str) -> Option<LasField> {
    let dimension = PointFormat::new(8)?.dimensions().into_iter().find(|d| d.name == name)?;
    let most = match dimension.kind {
        FieldKind::Bits { mask, .. } => Some(mask),
        FieldKind::Whole => None,
    };
    Some(LasField { ty: dimension.ty, most })
}

/// Records of a LAS file, and what its header says of them.
pub(super) struct Records {
    bytes: Vec<u8>,
    totals: Totals,
}

/// How points become records; the same for all batches, so several may be packed at once.
struct Packing {
    integers: Integers,
    attributes: Arc<[Attribute]>,
    slots: Vec<Slot>,
    point_format: u8,
    stride: usize,
    /// Where the return number is, and its mask.
    returns: (usize, u8),
    /// The byte of both return numbers before a point's own are added: the only return, where points have none.
    blank_returns: u8,
    /// The column of GPS times, if the header wants their range.
    times: Option<usize>,
    /// What messages call the file.
    shown: PathBuf,
}

/// Writes a LAS or LAZ file.
pub(super) struct LasWriter {
    encoder: Encoder,
    header: Header,
    totals: Totals,
    packing: Arc<Packing>,
    /// Whole records.
    buffer: Vec<u8>,
    buffer_bytes: usize,
    notes: Vec<String>,
    // Last, so that the file is closed before it is deleted.
    destination: Destination,
}

impl LasWriter {
    /// Begins a file: header and VLRs are written, the counts are still zero.
    pub fn create(
        destination: Destination,
        mut file: File,
        output: &OutputPlan,
        options: LasOptions<'_>,
    ) -> Result<Self, FormatError> {
        let LasOptions { compressed, date, standard_time, points, values } = options;
        let plan = match &output.las {
            LasTarget::AsSource(facts) => plan::as_source(output, facts, compressed, date),
            LasTarget::Merged { scale, offset } => {
                plan::merged(output, *scale, *offset, compressed, date, standard_time, values)
            }
        };
        let plan::Plan { mut header, slots, notes } = plan.map_err(|reason| destination.unwritable(reason))?;
        check_count(&header, points.unwrap_or(0)).map_err(|reason| destination.unwritable(reason))?;
        if compressed {
            encoder::announce(&mut header).map_err(|e| e.into_format_error(&destination))?;
        }
        let integers = Integers::new(header.scale, header.offset, &output.lattice).ok_or_else(|| {
            let (scale, offset) = (header.scale, header.offset);
            destination
                .unwritable(format!("scale {scale:?} and offset {offset:?} are not usable; give another --scale"))
        })?;
        file.write_all(&header.to_bytes(&Totals::default())).map_err(|e| destination.error("writing", e))?;
        let times = (header.version.1 >= 5)
            .then(|| {
                output.attributes.iter().position(|a| a.name == "GpsTime" && a.ty == crate::points::ScalarType::F64)
            })
            .flatten();
        let record_bytes = usize::from(header.record_bytes);
        let encoder = Encoder::new(file, &header).map_err(|e| e.into_format_error(&destination))?;
        let buffer_bytes = encoder.preferred_bytes(record_bytes).unwrap_or(BUFFER_BYTES / record_bytes * record_bytes);
        let (returns_mask, returns_shift) = if header.point_format < 6 { (7, 3) } else { (15, 4) };
        let tells_returns =
            output.attributes.iter().any(|a| matches!(a.name.as_str(), "ReturnNumber" | "NumberOfReturns"));
        let packing = Packing {
            integers,
            attributes: output.attributes.clone(),
            slots,
            point_format: header.point_format,
            stride: record_bytes,
            returns: (14, returns_mask),
            // As PDAL has it: no pulse has returns 0 of 0, and readers that keep first or last returns would drop them.
            blank_returns: if tells_returns { 0 } else { 1 | 1 << returns_shift },
            times,
            shown: destination.shown().into(),
        };
        Ok(Self {
            packing: Arc::new(packing),
            buffer: Vec::with_capacity(buffer_bytes),
            totals: Totals::default(),
            destination,
            encoder,
            header,
            buffer_bytes,
            notes,
        })
    }

    /// Appends records that were packed.
    fn append(&mut self, records: &Records) -> Result<(), FormatError> {
        let points = self.totals.points.saturating_add(records.totals.points);
        check_count(&self.header, points).map_err(|reason| self.destination.unwritable(reason))?;
        self.totals.add(&records.totals);
        let mut rest = &records.bytes[..];
        while !rest.is_empty() {
            // What fills the buffer need not go through it.
            if self.buffer.is_empty() && rest.len() >= self.buffer_bytes {
                let (now, later) = rest.split_at(self.buffer_bytes);
                self.encoder.write(now).map_err(|e| e.into_format_error(&self.destination))?;
                rest = later;
                continue;
            }
            let (now, later) = rest.split_at(rest.len().min(self.buffer_bytes - self.buffer.len()));
            self.buffer.extend_from_slice(now);
            rest = later;
            if self.buffer.len() >= self.buffer_bytes {
                self.flush()?;
            }
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<(), FormatError> {
        let written = self.encoder.write(&self.buffer);
        self.buffer.clear();
        written.map_err(|e| e.into_format_error(&self.destination))
    }
}

impl Packing {
    fn records(&self, batch: &Batch) -> Result<Records, FormatError> {
        let mut totals = Totals { points: batch.len() as u64, ..Totals::default() };
        self.note_times(batch, &mut totals);
        let mut bytes = vec![0; batch.len() * self.stride];
        for start in (0..batch.len()).step_by(BLOCK) {
            let range = start..batch.len().min(start + BLOCK);
            let rows = &mut bytes[range.start * self.stride..range.end * self.stride];
            self.put_block(batch, range, rows, &mut totals)?;
        }
        Ok(Records { bytes, totals })
    }

    /// Puts points `range`, at most [`BLOCK`], into rows that are zero.
    fn put_block(
        &self,
        batch: &Batch,
        range: Range<usize>,
        rows: &mut [u8],
        totals: &mut Totals,
    ) -> Result<(), FormatError> {
        let stride = self.stride;
        let mut integers = [0; BLOCK];
        let positions = [&batch.positions.x, &batch.positions.y, &batch.positions.z];
        for (axis, indices) in positions.into_iter().enumerate() {
            self.integers.convert(axis, &indices[range.clone()], &mut integers, &self.shown)?;
            let integers = &integers[..range.len()];
            let (min, max) = integers.iter().fold((i32::MAX, i32::MIN), |(a, b), &x| (a.min(x), b.max(x)));
            totals.min[axis] = totals.min[axis].min(min);
            totals.max[axis] = totals.max[axis].max(max);
            for (row, x) in rows.chunks_exact_mut(stride).zip(integers) {
                row[4 * axis..4 * axis + 4].copy_from_slice(&x.to_le_bytes());
            }
        }
        if self.blank_returns != 0 {
            rows.chunks_exact_mut(stride).for_each(|row| row[self.returns.0] = self.blank_returns);
        }
        for slot in &self.slots {
            rows::put(*slot, &batch.columns[slot.column], range.clone(), rows, stride).map_err(|too_large| {
                let name = &self.attributes[slot.column].name;
                let (value, largest, format) = (too_large.value, too_large.largest, self.point_format);
                let reason = format!(
                    "{name} {value} does not fit LAS point format {format}, which holds 0 to {largest}; \
                     leave the attribute out, or write PLY or CSV"
                );
                FormatError::Unwritable { path: self.shown.clone(), reason }
            })?;
        }
        // Four counters each, so that equal neighbours do not wait for each other.
        let (at, mask) = self.returns;
        let mut counts = [[0_u32; 16]; 4];
        for (i, row) in rows.chunks_exact(stride).enumerate() {
            counts[i % 4][usize::from(row[at] & mask)] += 1;
        }
        for (number, total) in totals.by_return.iter_mut().enumerate() {
            *total += counts.iter().map(|c| u64::from(c[number + 1])).sum::<u64>();
        }
        Ok(())
    }

    fn note_times(&self, batch: &Batch, totals: &mut Totals) {
        let Some(Column::F64(times)) = self.times.map(|t| &batch.columns[t]) else { return };
        times.iter().filter(|t| t.is_finite()).for_each(|&time| totals.note_times(time, time));
    }
}

impl Packer for Packing {
    fn pack(&self, batch: Batch) -> Result<Packed, FormatError> {
        Ok(Packed::records(self.records(&batch)?))
    }
}

/// Can the header announce that many?
fn check_count(header: &Header, points: u64) -> Result<(), String> {
    let most = header.most_points();
    if points <= most {
        return Ok(());
    }
    let (major, minor) = header.version;
    Err(format!("LAS {major}.{minor} holds at most {most} points; use --split-by scan or a smaller region"))
}

impl PointWriter for LasWriter {
    fn shown(&self) -> &Path {
        self.destination.shown()
    }

    fn write(&mut self, batch: &Batch) -> Result<(), FormatError> {
        let records = self.packing.records(batch)?;
        self.append(&records)
    }

    fn packer(&self) -> Arc<dyn Packer> {
        self.packing.clone()
    }

    fn write_packed(&mut self, packed: Packed) -> Result<(), FormatError> {
        match packed.0 {
            Form::Records(records) => self.append(&records),
            Form::Points(batch) => self.write(&batch),
        }
    }

    fn finish(mut self: Box<Self>) -> Result<Vec<String>, FormatError> {
        self.flush()?;
        let Self { destination, encoder, header, mut totals, notes, .. } = *self;
        let mut file = encoder.finish().map_err(|e| e.into_format_error(&destination))?;
        let mut complete = || {
            totals.evlr_start = file.seek(SeekFrom::End(0))?;
            file.write_all(&header.evlrs.1)?;
            file.seek(SeekFrom::Start(0))?;
            file.write_all(&header.to_bytes(&totals))
        };
        complete().map_err(|e| destination.error("writing", e))?;
        destination.finish(file)?;
        Ok(notes)
    }
}

#[cfg(test)]
mod tests;

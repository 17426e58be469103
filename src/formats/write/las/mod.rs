//! LAS and LAZ out: columns become records in blocks, records become the file's bytes, the header comes last.

mod crs;
mod encoder;
mod extra;
mod header;
mod integers;
mod plan;

use super::destination::Destination;
use super::rows::{self, Slot};
use super::{LasTarget, OutputPlan, PointWriter};
use crate::formats::FormatError;
use crate::points::{Attribute, Batch, Column};
use encoder::Encoder;
pub use header::CreationDate;
use header::{Header, Totals};
use integers::{BLOCK, Integers};
use std::fs::File;
use std::io::{Seek, SeekFrom, Write};
use std::ops::Range;
use std::sync::Arc;

/// Bytes of records that are collected before they are written.
const BUFFER_BYTES: usize = 1 << 20;

/// How a LAS file is made, beyond the plan.
#[derive(Clone, Copy, Debug)]
pub(super) struct LasOptions {
    /// LAZ?
    pub compressed: bool,
    pub date: CreationDate,
    /// Are the GPS times of a merged file adjusted standard ones?
    pub standard_time: bool,
    /// The points that will come, if known.
    pub points: Option<u64>,
}

/// Writes a LAS or LAZ file.
pub(super) struct LasWriter {
    encoder: Encoder,
    header: Header,
    totals: Totals,
    integers: Integers,
    attributes: Arc<[Attribute]>,
    slots: Vec<Slot>,
    /// Where the return number is, and its mask.
    returns: (usize, u8),
    /// The column of GPS times, if the header wants their range.
    times: Option<usize>,
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
        options: LasOptions,
    ) -> Result<Self, FormatError> {
        let LasOptions { compressed, date, standard_time, points } = options;
        let plan = match &output.las {
            LasTarget::AsSource(facts) => plan::as_source(output, facts, compressed, date),
            LasTarget::Merged { scale, offset } => {
                plan::merged(output, *scale, *offset, compressed, date, standard_time)
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
        Ok(Self {
            returns: (14, if header.point_format < 6 { 7 } else { 15 }),
            attributes: output.attributes.clone(),
            buffer: Vec::with_capacity(buffer_bytes),
            totals: Totals::default(),
            destination,
            encoder,
            header,
            integers,
            slots,
            times,
            buffer_bytes,
            notes,
        })
    }

    fn stride(&self) -> usize {
        usize::from(self.header.record_bytes)
    }

    /// Appends points `range`, at most [`BLOCK`], to the buffer, which has room for them.
    fn append_block(&mut self, batch: &Batch, range: Range<usize>) -> Result<(), FormatError> {
        let stride = self.stride();
        let start = self.buffer.len();
        self.buffer.resize(start + range.len() * stride, 0);
        let rows = &mut self.buffer[start..];
        let mut integers = [0; BLOCK];
        let positions = [&batch.positions.x, &batch.positions.y, &batch.positions.z];
        for (axis, indices) in positions.into_iter().enumerate() {
            self.integers.convert(axis, &indices[range.clone()], &mut integers, &self.destination)?;
            let integers = &integers[..range.len()];
            let (min, max) = integers.iter().fold((i32::MAX, i32::MIN), |(a, b), &x| (a.min(x), b.max(x)));
            self.totals.min[axis] = self.totals.min[axis].min(min);
            self.totals.max[axis] = self.totals.max[axis].max(max);
            for (row, x) in rows.chunks_exact_mut(stride).zip(integers) {
                row[4 * axis..4 * axis + 4].copy_from_slice(&x.to_le_bytes());
            }
        }
        for slot in &self.slots {
            rows::put(*slot, &batch.columns[slot.column], range.clone(), rows, stride).map_err(|too_large| {
                let name = &self.attributes[slot.column].name;
                let (value, largest, format) = (too_large.value, too_large.largest, self.header.point_format);
                self.destination.unwritable(format!(
                    "{name} {value} does not fit LAS point format {format}, which holds 0 to {largest}; \
                     leave the attribute out, or write PLY or CSV"
                ))
            })?;
        }
        // Four counters each, so that equal neighbours do not wait for each other.
        let (at, mask) = self.returns;
        let mut counts = [[0_u32; 16]; 4];
        for (i, row) in rows.chunks_exact(stride).enumerate() {
            counts[i % 4][usize::from(row[at] & mask)] += 1;
        }
        for (number, total) in self.totals.by_return.iter_mut().enumerate() {
            *total += counts.iter().map(|c| u64::from(c[number + 1])).sum::<u64>();
        }
        self.totals.points += range.len() as u64;
        Ok(())
    }

    fn note_times(&mut self, batch: &Batch) {
        let Some(Column::F64(times)) = self.times.map(|t| &batch.columns[t]) else { return };
        for &time in times.iter().filter(|t| t.is_finite()) {
            let (least, greatest) = self.totals.time.unwrap_or((time, time));
            self.totals.time = Some((least.min(time), greatest.max(time)));
        }
    }

    fn flush(&mut self) -> Result<(), FormatError> {
        let written = self.encoder.write(&self.buffer);
        self.buffer.clear();
        written.map_err(|e| e.into_format_error(&self.destination))
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
    fn write(&mut self, batch: &Batch) -> Result<(), FormatError> {
        let points = self.totals.points.saturating_add(batch.len() as u64);
        check_count(&self.header, points).map_err(|reason| self.destination.unwritable(reason))?;
        self.note_times(batch);
        let mut next = 0;
        while next < batch.len() {
            let room = (self.buffer_bytes - self.buffer.len()) / self.stride();
            let end = batch.len().min(next + BLOCK.min(room));
            self.append_block(batch, next..end)?;
            next = end;
            if self.buffer.len() >= self.buffer_bytes {
                self.flush()?;
            }
        }
        Ok(())
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

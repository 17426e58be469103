//! Rows of text to records, from any row on.

use super::lines::{Line, Lines};
use super::number::{Number, parse};
use super::survey::{Chunk, Place};
use crate::formats::file::SourceFile;
use crate::formats::las::quoted;
use crate::formats::{FormatError, Piece, Tally};
use crate::points::{PositionKind, ScalarType};
use std::sync::Arc;

/// Bytes given to a sink at a time.
const RUN_BYTES: usize = 1 << 18;

/// Where a word goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cell {
    /// x, y or z.
    Axis(usize),
    /// A value of this type, at this byte of the record.
    Value(usize, ScalarType),
    /// A colour in one number: its bytes, from the lowest, go to these bytes of the record. PCD's way, where a word may be
    /// the bits of an `f32` or an integer.
    Packed([Option<usize>; 4], bool),
    /// Nowhere.
    Skip,
}

/// How coordinates are written into records.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Coordinates {
    /// As the nearest floats.
    World,
    /// As whole steps of `10^-decimals` from `center` steps.
    Grid { decimals: u8, center: [i128; 3] },
}

/// Rows of a file, and how each becomes a record.
#[derive(Debug)]
pub struct Table {
    pub file: Arc<SourceFile>,
    pub place: Place,
    pub chunks: Vec<Chunk>,
    pub cells: Vec<Cell>,
    pub coordinates: Coordinates,
    /// Bytes of a record.
    pub stride: usize,
}

impl Table {
    /// Pieces of about `target` rows, which begin where chunks do.
    pub fn pieces(&self, target: u64) -> Vec<Piece> {
        let mut pieces = Vec::new();
        let mut piece = Piece { first: 0, records: 0 };
        for chunk in &self.chunks {
            if piece.records > 0 && piece.records + chunk.rows > target {
                pieces.push(piece);
                piece = Piece { first: piece.first + piece.records, records: 0 };
            }
            piece.records += chunk.rows;
        }
        pieces.extend((piece.records > 0).then_some(piece));
        pieces
    }

    /// Gives the records of `piece` to `sink`.
    pub fn read(&self, piece: Piece, sink: &mut dyn FnMut(&[u8]) -> bool) -> Result<Tally, FormatError> {
        let mut skip = piece.first;
        let mut start = self.place.end;
        for chunk in &self.chunks {
            start = chunk.offset;
            if skip < chunk.rows {
                break;
            }
            skip -= chunk.rows;
        }
        let template = self.template();
        let run = (RUN_BYTES / self.stride).max(1) as u64;
        let mut records = Vec::new();
        let mut tally = Tally::default();
        let mut lines = Lines::new(&self.file, start, self.place.end);
        while tally.read + (records.len() / self.stride) as u64 != piece.records {
            let Some(line) = lines.next()? else { break };
            if line.bytes.trim_ascii_start().is_empty() || self.place.separator.is_comment(line.bytes) {
                continue;
            }
            if skip > 0 {
                skip -= 1;
                continue;
            }
            let at = records.len();
            records.extend_from_slice(&template);
            self.row(&line, &mut records[at..])?;
            if records.len() as u64 >= run * self.stride as u64 {
                tally.read += (records.len() / self.stride) as u64;
                if !sink(&records) {
                    return Ok(tally);
                }
                records.clear();
            }
        }
        if !records.is_empty() {
            tally.read += (records.len() / self.stride) as u64;
            if !sink(&records) {
                return Ok(tally);
            }
        }
        tally.truncated = piece.records - tally.read;
        Ok(tally)
    }

    /// A record without a word: floats are NaN.
    fn template(&self) -> Vec<u8> {
        let mut record = vec![0; self.stride];
        for cell in &self.cells {
            match *cell {
                Cell::Value(at, ScalarType::F32) => record[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes()),
                Cell::Value(at, ScalarType::F64) => record[at..at + 8].copy_from_slice(&f64::NAN.to_le_bytes()),
                _ => {}
            }
        }
        record
    }

    fn row(&self, line: &Line<'_>, record: &mut [u8]) -> Result<(), FormatError> {
        let bad = |word: &[u8], expected: &str| {
            self.file.malformed_line(line.offset, expected, quoted(&word[..word.len().min(40)]))
        };
        let mut position = [f64::NAN; 3];
        let mut cells = self.cells.iter();
        for word in self.place.separator.words(line.bytes) {
            let Some(cell) = cells.next() else { break };
            if *cell == Cell::Skip {
                continue;
            }
            let Some(number) = parse(word, self.place.comma) else {
                return Err(bad(word, "a row of numbers"));
            };
            match *cell {
                Cell::Axis(axis) => match self.coordinates {
                    Coordinates::World => position[axis] = number.value,
                    Coordinates::Grid { decimals, center } => {
                        let steps = number.decimal.and_then(|d| d.steps(decimals));
                        let index = steps.and_then(|s| i32::try_from(s - center[axis]).ok());
                        let index = index.ok_or_else(|| bad(word, "a coordinate like those of the other rows"))?;
                        record[4 * axis..4 * axis + 4].copy_from_slice(&index.to_le_bytes());
                    }
                },
                Cell::Value(at, ty) => {
                    let value =
                        bytes(word, number, ty).ok_or_else(|| bad(word, &format!("a value of type {}", ty.word())))?;
                    record[at..at + ty.size()].copy_from_slice(&value[..ty.size()]);
                }
                Cell::Packed(places, float) => {
                    let bits = packed(word, number, float).ok_or_else(|| bad(word, "a packed colour"))?;
                    for (place, byte) in places.iter().zip(bits.to_le_bytes()) {
                        if let Some(at) = place {
                            record[*at] = byte;
                        }
                    }
                }
                Cell::Skip => {}
            }
        }
        if self.coordinates == Coordinates::World {
            if self.place.zero_is_nothing && position == [0.0; 3] {
                position = [f64::NAN; 3];
            }
            for (place, value) in record[..PositionKind::World.size()].chunks_exact_mut(8).zip(position) {
                place.copy_from_slice(&value.to_le_bytes());
            }
        }
        Ok(())
    }
}

/// A number as a value of type `ty`, little-endian; `None` if it is none.
fn bytes(word: &[u8], number: Number, ty: ScalarType) -> Option<[u8; 8]> {
    let mut raw = [0; 8];
    match ty {
        ScalarType::F64 => raw = number.value.to_le_bytes(),
        ScalarType::F32 => raw[..4].copy_from_slice(&single(word, number).to_le_bytes()),
        _ => {
            let whole = match number.decimal {
                Some(digits) => digits.steps(0)?,
                // `1e3` is a whole number, too, and so is one of twenty digits.
                None => std::str::from_utf8(word).ok()?.parse().ok().or_else(|| {
                    let whole = number.value as i128;
                    (whole as f64 == number.value && number.value.abs() < 9e15).then_some(whole)
                })?,
            };
            macro_rules! integer {
                ($t:ty) => {
                    raw[..size_of::<$t>()].copy_from_slice(&<$t>::try_from(whole).ok()?.to_le_bytes())
                };
            }
            match ty {
                ScalarType::U8 => integer!(u8),
                ScalarType::I8 => integer!(i8),
                ScalarType::U16 => integer!(u16),
                ScalarType::I16 => integer!(i16),
                ScalarType::U32 => integer!(u32),
                ScalarType::I32 => integer!(i32),
                ScalarType::U64 => integer!(u64),
                _ => integer!(i64),
            }
        }
    }
    Some(raw)
}

/// The nearest f32 of a word.
fn single(word: &[u8], number: Number) -> f32 {
    const POWERS: [f32; 11] = [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10];
    let power = |decimals: u8| POWERS.get(usize::from(decimals)).copied();
    if let Some((digits, power)) = number.decimal.and_then(|d| Some((d, power(d.decimals)?)))
        && (1..1 << 24).contains(&digits.mantissa.unsigned_abs())
    {
        // Both are exact, so the division rounds once.
        return digits.mantissa as f32 / power;
    }
    // Once from the digits: by way of an f64 it would be rounded twice.
    let text = std::str::from_utf8(word).ok().and_then(|t| t.parse().ok());
    text.unwrap_or(number.value as f32)
}

/// The bits of a packed colour: of an `f32`, or an integer, which some writers put where they promised a float.
fn packed(word: &[u8], number: Number, float: bool) -> Option<u32> {
    match number.decimal {
        Some(digits) if !float || !digits.pointed => u32::try_from(digits.steps(0)?).ok(),
        _ if float => Some(single(word, number).to_bits()),
        _ => None,
    }
}

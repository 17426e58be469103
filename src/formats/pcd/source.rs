//! A PCD file as a [`PointSource`].

use super::header::{Encoding, Header};
use super::layout::Fields;
use super::lzf;
use crate::formats::file::SourceFile;
use crate::formats::las::even_pieces;
use crate::formats::ply::{self, Conversion};
use crate::formats::text::{Chunk, Coordinates, Place, Separator, Table, count_rows, first_row};
use crate::formats::{FormatError, Piece, PointSource, SourceInfo, Tally};
use crate::points::{ScalarType, counted};
use std::sync::{Arc, Mutex, PoisonError};

/// Bytes given to a sink at a time.
const RUN_BYTES: usize = 1 << 18;

struct PcdSource {
    file: Arc<SourceFile>,
    info: SourceInfo,
    points: Points,
}

/// How the points are read.
enum Points {
    /// Point by point, from this byte on.
    Rows(u64, Conversion),
    /// Field by field, compressed.
    Columns(Columns),
    /// As text.
    Text(Table),
}

/// All points field by field.
struct Columns {
    conversion: Conversion,
    /// Bytes of each field of a point.
    widths: Vec<usize>,
    /// Where the compressed bytes are, and how many.
    start: u64,
    compressed: u32,
    size: u32,
    plain: Mutex<Option<Plain>>,
}

/// The decompressed points, from the first piece that is read to the last: an ingest has many such files open, and memory
/// for those that are read.
struct Plain {
    /// `None`: they are broken.
    bytes: Option<Arc<Vec<u8>>>,
    /// Points that no piece has read yet.
    left: u64,
}

impl Columns {
    /// The decompressed points; `None` if they are broken.
    fn plain(&self, file: &SourceFile, points: u64) -> Result<Option<Arc<Vec<u8>>>, FormatError> {
        let mut held = self.plain.lock().unwrap_or_else(PoisonError::into_inner);
        if held.is_none() {
            let compressed = file.read_vec(self.start, self.compressed.into())?;
            let bytes = lzf::decompress(&compressed, self.size as usize).map(Arc::new);
            *held = Some(Plain { bytes, left: points });
        }
        Ok(held.as_ref().and_then(|plain| plain.bytes.clone()))
    }

    /// So many points more were read.
    fn was_read(&self, points: u64) {
        let mut held = self.plain.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(plain) = &mut *held {
            plain.left = plain.left.saturating_sub(points);
        }
        held.take_if(|plain| plain.left == 0);
    }
}

/// Opens a PCD file.
///
/// # Errors
///
/// [`FormatError::Malformed`] for a bad header, fields without x, y and z, or compressed sizes that lie.
pub fn open(file: SourceFile) -> Result<Box<dyn PointSource>, FormatError> {
    Ok(Box::new(source_of(file)?))
}

fn source_of(file: SourceFile) -> Result<PcdSource, FormatError> {
    let file = Arc::new(file);
    let header = Header::read(&file)?;
    let fields = Fields::new(&header.fields).ok_or_else(|| {
        let names: Vec<_> = header.fields.iter().map(|f| &*f.name).collect();
        file.malformed(header.data_offset, "fields x, y and z", names.join(", "))
    })?;
    let stride = fields.layout.stride();
    let room = file.bytes().saturating_sub(header.data_offset);
    let point_bytes = header.point_bytes();
    let broken = || file.malformed(header.data_offset, "fields of known size", "others");
    let conversion =
        || Conversion::new(&fields.element, &fields.targets, stride, ply::Encoding::Little).ok_or_else(broken);
    let mut warnings = Vec::new();
    let (points, found) = match header.encoding {
        Encoding::Binary => {
            (Points::Rows(header.data_offset, conversion()?), header.points.min(room / point_bytes.max(1)))
        }
        Encoding::Compressed => {
            let sizes = file.read_vec(header.data_offset, 8)?;
            let [a, b, c, d, e, f, g, h] = sizes[..] else {
                return Err(file.malformed(
                    header.data_offset,
                    "the sizes of the compressed points",
                    "the end of the file",
                ));
            };
            let (compressed, size) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]));
            let expected = header.points.checked_mul(point_bytes);
            if expected != Some(size.into()) {
                let expected = format!("{} of {point_bytes} bytes", counted(header.points, "point"));
                return Err(file.malformed(header.data_offset + 4, expected, format!("{size} bytes")));
            }
            if u64::from(compressed) > room - 8 {
                let found = format!("{} bytes", room - 8);
                return Err(file.malformed(header.data_offset, format!("{compressed} compressed bytes"), found));
            }
            let widths = header.fields.iter().map(|f| f.count as usize * f.ty.size()).collect();
            let start = header.data_offset + 8;
            let columns =
                Columns { conversion: conversion()?, widths, start, compressed, size, plain: Mutex::default() };
            (Points::Columns(columns), header.points)
        }
        Encoding::Ascii => {
            let (table, rows) = text(&file, &header, &fields)?;
            if rows > header.points {
                warnings.push(format!(
                    "the header announces {}, there are {rows} rows: all are read",
                    counted(header.points, "point")
                ));
            }
            (Points::Text(table), rows)
        }
    };
    let missing = header.points.saturating_sub(found);
    if missing > 0 {
        warnings.push(format!("the header announces {}, the file holds {found}", counted(header.points, "point")));
    }
    if !header.viewpoint.is_identity() {
        warnings.push("the points are placed by the file's VIEWPOINT".to_owned());
    }
    let mut info = SourceInfo::new(file.path(), "pcd", found, missing, fields.layout);
    info.pose = header.viewpoint;
    let is_axis = |name: &str| ["x", "y", "z"].iter().any(|axis| name.eq_ignore_ascii_case(axis));
    info.is_single =
        header.fields.iter().any(|f| is_axis(&f.name) && f.ty == ScalarType::F32) && header.encoding != Encoding::Ascii;
    info.warnings = warnings;
    Ok(PcdSource { file, info, points })
}

/// The table of an ascii file, and its rows.
fn text(file: &Arc<SourceFile>, header: &Header, fields: &Fields) -> Result<(Table, u64), FormatError> {
    let end = file.bytes();
    let separator = first_row(file, header.data_offset, end)?.unwrap_or(Separator::Blank);
    let place = Place { start: header.data_offset, end, separator, comma: false, axes: [0; 3], zero_is_nothing: false };
    let chunks: Vec<Chunk> = count_rows(file, &place, fields.cells.len())?;
    let rows = chunks.iter().map(|c| c.rows).sum();
    let stride = fields.layout.stride();
    let cells = fields.cells.clone();
    Ok((Table { file: file.clone(), place, chunks, cells, coordinates: Coordinates::World, stride }, rows))
}

impl PcdSource {
    fn read_rows(
        &self,
        start: u64,
        conversion: &Conversion,
        piece: Piece,
        sink: &mut dyn FnMut(&[u8]) -> bool,
    ) -> Result<Tally, FormatError> {
        let bytes = conversion.source_bytes();
        self.in_runs(conversion, piece, sink, |first, from| {
            let offset = start + first * bytes as u64;
            Ok(self.file.read_up_to(from, offset)? / bytes)
        })
    }

    fn read_columns(
        &self,
        columns: &Columns,
        piece: Piece,
        sink: &mut dyn FnMut(&[u8]) -> bool,
    ) -> Result<Tally, FormatError> {
        let plain = columns.plain(&self.file, self.info.records)?;
        let plain = plain.ok_or_else(|| {
            self.file.malformed(columns.start, format!("{} bytes compressed by LZF", columns.size), "others")
        })?;
        let bytes = columns.conversion.source_bytes();
        let total = self.info.records as usize;
        let tally = self.in_runs(&columns.conversion, piece, sink, |first, from| {
            let mut column = 0;
            let mut at = 0;
            for &width in &columns.widths {
                let values = &plain[column + first as usize * width..column + total * width];
                for (point, value) in from.chunks_exact_mut(bytes).zip(values.chunks_exact(width.max(1))) {
                    point[at..at + width].copy_from_slice(value);
                }
                column += total * width;
                at += width;
            }
            Ok(from.len() / bytes)
        })?;
        drop(plain);
        columns.was_read(piece.records);
        Ok(tally)
    }

    /// Gives the records of `piece` to `sink`; `fill` fills a buffer with binary points from one on, and says how many.
    fn in_runs(
        &self,
        conversion: &Conversion,
        piece: Piece,
        sink: &mut dyn FnMut(&[u8]) -> bool,
        fill: impl Fn(u64, &mut [u8]) -> Result<usize, FormatError>,
    ) -> Result<Tally, FormatError> {
        let (bytes, stride) = (conversion.source_bytes(), self.info.layout.stride());
        let run = ((RUN_BYTES / bytes.max(stride)).max(1) as u64).min(piece.records) as usize;
        let (mut from, mut to) = (vec![0; run * bytes], vec![0; run * stride]);
        let mut tally = Tally::default();
        while tally.read < piece.records {
            let wanted = (run as u64).min(piece.records - tally.read) as usize;
            let got = fill(piece.first + tally.read, &mut from[..wanted * bytes])?;
            // What a conversion leaves out is not to be of another point.
            to.fill(0);
            conversion.convert(&from[..got * bytes], &mut to[..got * stride]);
            tally.read += got as u64;
            if got > 0 && !sink(&to[..got * stride]) {
                break;
            }
            if got < wanted {
                tally.truncated = piece.records - tally.read;
                break;
            }
        }
        Ok(tally)
    }
}

impl PointSource for PcdSource {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn warn(&mut self, warning: String) {
        self.info.warnings.push(warning);
    }

    fn pieces(&self, target_records: u64) -> Vec<Piece> {
        match &self.points {
            Points::Text(table) => table.pieces(target_records),
            _ => even_pieces(self.info.records, target_records),
        }
    }

    fn read(&self, piece: Piece, sink: &mut dyn FnMut(&[u8]) -> bool) -> Result<Tally, FormatError> {
        let first = piece.first.min(self.info.records);
        let piece = Piece { first, records: piece.records.min(self.info.records - first) };
        if piece.records == 0 {
            return Ok(Tally::default());
        }
        match &self.points {
            Points::Rows(start, conversion) => self.read_rows(*start, conversion, piece, sink),
            Points::Columns(columns) => self.read_columns(columns, piece, sink),
            Points::Text(table) => table.read(piece, sink),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// They stayed for the life of the source: an ingest of many files had the points of all of them at once.
    #[test]
    fn decompressed_points_are_let_go_with_the_last_piece_and_come_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.pcd");
        let plain: Vec<u8> = (0..15_u8).flat_map(|i| f32::from(i).to_le_bytes()).collect();
        // Literal runs are valid LZF.
        let packed: Vec<u8> = plain.chunks(32).flat_map(|run| [&[run.len() as u8 - 1], run].concat()).collect();
        let head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 5\nHEIGHT 1\nPOINTS 5\n";
        let sizes = [packed.len() as u32, plain.len() as u32].map(u32::to_le_bytes).concat();
        std::fs::write(&path, [head.as_bytes(), b"DATA binary_compressed\n", &sizes, &packed].concat()).unwrap();
        let source = source_of(SourceFile::open(&path).unwrap()).unwrap();
        let Points::Columns(columns) = &source.points else { panic!("not by columns") };
        let held = || columns.plain.lock().unwrap().is_some();
        let mut before: Option<Vec<u8>> = None;
        for _ in 0..2 {
            let mut records = Vec::new();
            for (first, count) in [(0, 2), (2, 2), (4, 1)] {
                assert_eq!(held(), first > 0);
                let mut sink = |more: &[u8]| {
                    records.extend_from_slice(more);
                    true
                };
                source.read(Piece { first, records: count }, &mut sink).unwrap();
            }
            assert!(!held());
            assert_eq!(records.len(), 5 * source.info.layout.stride());
            assert!(before.replace(records.clone()).is_none_or(|same| same == records));
        }
    }
}

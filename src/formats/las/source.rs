//! A LAS or LAZ file as a [`PointSource`]: facts from header and VLRs; uncompressed records by position.

use super::chunks::Chunks;
use super::header::Header;
use super::layout::record_layout;
use super::laz::{Codec, LASZIP_RECORD_ID, LASZIP_USER_ID};
use super::records::Records;
use super::{crs, extra};
use crate::formats::file::SourceFile;
use crate::formats::{FormatError, Piece, PointSource, SourceInfo, Tally};
use crate::points::LasFacts;

/// Bytes given to a sink at a time: few enough that they stay in a core's second cache until they are taken.
pub(super) const RUN_BYTES: usize = 256 << 10;

/// An open LAS, LAZ or COPC file.
pub struct LasSource {
    file: SourceFile,
    info: SourceInfo,
    points: Points,
}

/// Where the records are.
enum Points {
    /// One after the other, from this byte on.
    Plain(u64),
    /// Compressed.
    Laz(Codec, Chunks),
}

impl LasSource {
    /// Reads header and VLRs.
    ///
    /// # Errors
    ///
    /// [`FormatError::Malformed`] where nothing can be read, [`FormatError::Unsupported`] for versions, point formats and
    /// compressors that are not known. Counts that lie become warnings.
    pub(in crate::formats) fn open(file: SourceFile) -> Result<Self, FormatError> {
        let header = Header::read(&file)?;
        let mut records = Records::read(&file, &header)?;
        let mut warnings = std::mem::take(&mut records.warnings);
        let room = header.record_bytes - header.point_format.record_bytes();
        let (described, cut) = extra::cut_to_fit(&mut records.vlrs, room);
        if cut {
            warnings.push(format!(
                "the extra-bytes record describes more than the {room} bytes that a record has for it, or an unknown type: the \
                 rest of it is dropped, the bytes themselves are kept as `ExtraBytes[i]`"
            ));
        }
        if records.waveforms || header.waveform_offset > 0 || header.global_encoding & 0b110 != 0 {
            warnings.push("waveform packets are not kept (the per-point wave fields are)".to_owned());
        }
        let crs = crs::read(&records, header.global_encoding);
        let end = points_end(&file, &header, records.extended_whole);
        let copc = records.find(b"copc", 1).is_some();
        let (points, format, found, missing) = if header.compressed {
            let vlr = records.find(LASZIP_USER_ID, LASZIP_RECORD_ID).ok_or_else(|| {
                file.malformed(
                    header.header_bytes.into(),
                    "a `laszip encoded` record, as the point format says",
                    "none",
                )
            })?;
            let codec = Codec::new(&file, &header, &vlr.data)?;
            let announced = announced(&header, |_| true, &mut warnings);
            let chunks = Chunks::find(&file, &header, &codec, announced, end, &mut warnings)?;
            let found = chunks.records();
            let format = if copc { "copc" } else { "laz" };
            (Points::Laz(codec, chunks), format, found, announced - found)
        } else {
            let room = (end - header.points_offset) / header.record_bytes as u64;
            let announced = announced(&header, |n| n <= room, &mut warnings);
            if room > announced && !records.extended_whole {
                warnings.push(format!(
                    "the header announces {announced} records, the file has room for {room}: what follows the announced ones is ignored"
                ));
            }
            let found = announced.min(room);
            (Points::Plain(header.points_offset), "las", found, announced - found)
        };
        if missing > 0 {
            warnings.push(format!("the header announces {} records, the file holds {found}", found + missing));
        }
        let facts = facts(&header, records.vlrs, (room - described) as u16);
        let layout = record_layout(&facts)
            .filter(|l| l.stride() == header.record_bytes)
            .ok_or_else(|| file.malformed(104, "a point format that agrees with its record length", "neither"))?;
        let info = SourceInfo {
            grid: Some(header.grid),
            bounds_hint: header.bounds_hint(),
            crs,
            las: Some(facts),
            warnings,
            ..SourceInfo::new(file.path(), format, found, missing, layout)
        };
        Ok(Self { file, info, points })
    }

    fn read_plain(&self, start: u64, piece: Piece, sink: &mut dyn FnMut(&[u8]) -> bool) -> Result<Tally, FormatError> {
        let stride = self.info.layout.stride();
        let run = (RUN_BYTES / stride).max(1) as u64;
        let mut buffer = vec![0; stride * run.min(piece.records) as usize];
        let mut tally = Tally::default();
        while tally.read < piece.records {
            let wanted = run.min(piece.records - tally.read) as usize * stride;
            let offset = start + (piece.first + tally.read) * stride as u64;
            let got = self.file.read_up_to(&mut buffer[..wanted], offset)? / stride;
            tally.read += got as u64;
            if got > 0 && !sink(&buffer[..got * stride]) {
                break;
            }
            if got * stride < wanted {
                // The file was shorter when it was read than when it was opened.
                tally.truncated = piece.records - tally.read;
                break;
            }
        }
        Ok(tally)
    }
}

impl PointSource for LasSource {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn warn(&mut self, warning: String) {
        self.info.warnings.push(warning);
    }

    fn pieces(&self, target_records: u64) -> Vec<Piece> {
        match &self.points {
            Points::Plain(_) => even_pieces(self.info.records, target_records),
            Points::Laz(_, chunks) => chunks.pieces(target_records),
        }
    }

    fn verbatim_from(&self) -> Option<u64> {
        match self.points {
            Points::Plain(start) => Some(start),
            Points::Laz(..) => None,
        }
    }

    fn read(&self, piece: Piece, sink: &mut dyn FnMut(&[u8]) -> bool) -> Result<Tally, FormatError> {
        let first = piece.first.min(self.info.records);
        let piece = Piece { first, records: piece.records.min(self.info.records - first) };
        match &self.points {
            Points::Plain(start) => self.read_plain(*start, piece, sink),
            Points::Laz(codec, chunks) => chunks.read(&self.file, codec, piece, sink),
        }
    }
}

/// `records` cut into pieces of `target` (at least one).
pub(in crate::formats) fn even_pieces(records: u64, target: u64) -> Vec<Piece> {
    let target = target.max(1);
    let starts = (0..records).step_by(usize::try_from(target).unwrap_or(usize::MAX));
    starts.map(|first| Piece { first, records: target.min(records - first) }).collect()
}

/// Where the points end at the latest: at the EVLRs or the waveform packets if they are where the header says, or with
/// the file.
fn points_end(file: &SourceFile, header: &Header, extended_whole: bool) -> u64 {
    let mut end = file.bytes();
    if extended_whole && header.evlr_offset >= header.points_offset {
        end = end.min(header.evlr_offset);
    }
    // LAS 1.3 has its waveform packets after the points, without a count of EVLRs.
    if header.version.1 == 3 && header.global_encoding & 2 != 0 && header.waveform_offset > header.points_offset {
        end = end.min(header.waveform_offset);
    }
    end
}

/// The number of records that the header announces, by the count that can be true where its two counts differ.
fn announced(header: &Header, fits: impl Fn(u64) -> bool, warnings: &mut Vec<String>) -> u64 {
    let legacy = u64::from(header.legacy_points);
    let Some(points) = header.points else { return legacy };
    if legacy == 0 || points == legacy {
        return points;
    }
    let chosen = if points == 0 || (!fits(points) && fits(legacy)) { legacy } else { points };
    warnings.push(format!("the header announces {points} records, and {legacy} in its legacy field: {chosen} it is"));
    chosen
}

fn facts(header: &Header, vlrs: Vec<crate::points::RawVlr>, undescribed_bytes: u16) -> LasFacts {
    LasFacts {
        version: header.version,
        point_format: header.point_format.number(),
        scale: header.scale,
        offset: header.offset,
        global_encoding: header.global_encoding,
        file_source_id: header.file_source_id,
        guid: header.guid,
        system_identifier: header.system_identifier,
        generating_software: header.generating_software,
        vlrs,
        undescribed_bytes,
    }
}

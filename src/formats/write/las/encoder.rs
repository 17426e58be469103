//! Records to the file: as they are, or through the LAZ codec.

use super::header::{Header, append_vlr, vlr};
use crate::formats::FormatError;
use crate::formats::guard::catching;
use crate::formats::write::destination::Destination;
use laz::laszip::parallel::ParLasZipCompressor;
use laz::{LazVlr, LazVlrBuilder};
use std::fs::File;
use std::io::{self, BufWriter, Write};

/// Points of a LAZ chunk, as LASzip has them.
const CHUNK_POINTS: usize = 50_000;
/// The codec is given several chunks per thread at a time, but no more bytes than this.
const MOST_BYTES: usize = 64 << 20;

/// Why records could not be encoded.
#[derive(Debug)]
pub(super) enum EncodeError {
    Io(io::Error),
    Codec(String),
}

impl EncodeError {
    pub fn into_format_error(self, destination: &Destination) -> FormatError {
        match self {
            Self::Io(source) => destination.error("writing", source),
            Self::Codec(message) => destination.unwritable(format!("the LAZ encoder broke down: {message}")),
        }
    }
}

impl From<io::Error> for EncodeError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

impl From<laz::LasZipError> for EncodeError {
    fn from(error: laz::LasZipError) -> Self {
        match error {
            laz::LasZipError::IoError(error) => Self::Io(error),
            other => Self::Codec(other.to_string()),
        }
    }
}

/// Takes records after a header.
pub(super) enum Encoder {
    Plain(File),
    Laz(Box<ParLasZipCompressor<BufWriter<File>>>),
}

/// The LASzip record of a file with these points.
fn laz_vlr(header: &Header) -> Result<LazVlr, EncodeError> {
    let format = header.point_format;
    let standard = crate::formats::las::tables::PointFormat::new(format).map_or(0, |f| f.record_bytes());
    let extra = header.record_bytes.saturating_sub(standard as u16);
    Ok(LazVlrBuilder::default().with_point_format(format, extra)?.with_fixed_chunk_size(CHUNK_POINTS as u32).build())
}

/// Adds the LASzip record to a header.
pub(super) fn announce(header: &mut Header) -> Result<(), EncodeError> {
    let mut bytes = Vec::new();
    laz_vlr(header)?.write_to(&mut bytes)?;
    name_wave_packets(&mut bytes);
    append_vlr(
        &mut header.vlrs.1,
        &vlr(LazVlr::USER_ID, LazVlr::RECORD_ID, LazVlr::DESCRIPTION, bytes),
        header.version,
    );
    header.vlrs.0 += 1;
    Ok(())
}

/// Bytes of a LASzip record before its items, of which each has 6: type, size, version.
const ITEMS_AT: usize = 34;
/// The type of an item of wave packets of point formats 4 and 5.
const WAVE_PACKETS: u16 = 9;

/// Gives wave packets of point formats 4 and 5 the version that they have: LASzip knows only the first, and refuses the
/// second, which the crate names here (its encoder of the two is one).
fn name_wave_packets(record: &mut [u8]) {
    let items = record.get_mut(ITEMS_AT..).unwrap_or_default();
    for item in items.as_chunks_mut::<6>().0 {
        if item[..2] == WAVE_PACKETS.to_le_bytes() {
            item[4..].copy_from_slice(&1_u16.to_le_bytes());
        }
    }
}

impl Encoder {
    /// An encoder that goes on where `file` is: right after the header.
    pub fn new(file: File, header: &Header) -> Result<Self, EncodeError> {
        if !header.compressed {
            return Ok(Self::Plain(file));
        }
        let mut codec = ParLasZipCompressor::new(BufWriter::new(file), laz_vlr(header)?)?;
        // Where there are no points, too.
        codec.reserve_offset_to_chunk_table()?;
        Ok(Self::Laz(Box::new(codec)))
    }

    /// How many bytes of records it likes to be given at a time, if it matters.
    pub fn preferred_bytes(&self, record_bytes: usize) -> Option<usize> {
        let Self::Laz(_) = self else { return None };
        let chunk = CHUNK_POINTS * record_bytes;
        let chunks = (2 * rayon::current_num_threads()).min(MOST_BYTES / chunk).max(1);
        Some(chunk * chunks)
    }

    /// Appends whole records.
    pub fn write(&mut self, records: &[u8]) -> Result<(), EncodeError> {
        match self {
            Self::Plain(file) => Ok(file.write_all(records)?),
            Self::Laz(_) if records.is_empty() => Ok(()),
            Self::Laz(codec) => guarded(|| Ok(codec.compress_many(records)?)),
        }
    }

    /// Completes what belongs to the records and gives the file back.
    pub fn finish(self) -> Result<File, EncodeError> {
        match self {
            Self::Plain(file) => Ok(file),
            Self::Laz(mut codec) => {
                guarded(|| Ok(codec.done()?))?;
                let buffered = codec.into_inner();
                buffered.into_inner().map_err(|e| EncodeError::Io(e.into_error()))
            }
        }
    }
}

/// Runs the codec; a panic of it is an error. The codec is not used again after one.
fn guarded(run: impl FnOnce() -> Result<(), EncodeError>) -> Result<(), EncodeError> {
    catching(run).unwrap_or_else(|message| Err(EncodeError::Codec(message)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// LASzip refused what was named after the crate's version of the item.
    #[test]
    fn items_have_the_versions_that_laszip_writes() {
        for (point_format, record_bytes, expected) in
            [(4, 57, &[2, 2, 1][..]), (5, 63, &[2, 2, 2, 1]), (3, 34, &[2, 2, 2]), (5, 65, &[2, 2, 2, 1, 2])]
        {
            let mut header = Header { point_format, record_bytes, version: (1, 3), ..Header::default() };
            announce(&mut header).unwrap();
            // Behind the head of the record.
            let written = LazVlr::from_buffer(&header.vlrs.1[54..]).unwrap();
            let versions: Vec<u16> = written.items().iter().map(|item| item.version()).collect();
            assert_eq!(versions, expected, "point format {point_format}");
        }
    }
}

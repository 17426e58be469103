//! The laszip VLR, checked against the point format, and decompressors for one chunk.

use super::header::Header;
use super::layered::{self, Layers};
use crate::formats::FormatError;
use crate::formats::file::SourceFile;
use laz::record::{LayeredPointRecordDecompressor, RecordDecompressor, SequentialPointRecordDecompressor};
use laz::{LazItem, LazItemType, LazVlr};
use std::io::{Cursor, ErrorKind, Read};

/// User id of the VLR that says how points are compressed.
pub const LASZIP_USER_ID: &[u8] = b"laszip encoded";
/// Its record id.
pub const LASZIP_RECORD_ID: u16 = LazVlr::RECORD_ID;

/// The crate keeps a model of some kilobytes for every extra byte, so their number is bounded.
const MOST_EXTRA_BYTES: usize = 4096;

const REMEDY: &str = "decompress it to LAS first, with LASzip for example";

/// How the points of a file are compressed; its items are those of the file's point format, in order.
#[derive(Debug)]
pub struct Codec {
    items: Vec<LazItem>,
    /// The layers of a chunk, where they are decoded here.
    decoded_here: Option<Layers>,
    /// Are fields compressed apart, with layer sizes at the head of each chunk (formats 6 to 10)?
    pub layered: bool,
    /// One chunk without a table (LASzip 1.0).
    pub point_wise: bool,
    /// Records of a chunk; `None` if chunks differ or there is but one.
    pub chunk_records: Option<u64>,
    /// Bytes of a record.
    pub record_bytes: usize,
}

impl Codec {
    /// Checks the data of the laszip VLR.
    ///
    /// # Errors
    ///
    /// [`FormatError::Unsupported`] for compressors and items that the `laz` crate does not decode or that are not those
    /// of the point format.
    pub(in crate::formats) fn new(file: &SourceFile, header: &Header, vlr: &[u8]) -> Result<Self, FormatError> {
        let parsed =
            LazVlr::from_buffer(vlr).map_err(|e| file.unsupported(format!("its LAZ compression ({e})"), REMEDY))?;
        // The crate keeps compressor and coder to itself.
        let word = |at: usize| u16::from_le_bytes([vlr[at], vlr[at + 1]]);
        let (compressor, coder) = (word(0), word(2));
        if !(1..=3).contains(&compressor) || coder != 0 {
            return Err(file.unsupported(format!("LAZ compressor {compressor} with coder {coder}"), REMEDY));
        }
        if header.record_bytes - header.point_format.record_bytes() > MOST_EXTRA_BYTES {
            return Err(file.unsupported(format!("a LAZ file with more than {MOST_EXTRA_BYTES} extra bytes"), REMEDY));
        }
        let layered = compressor == 3;
        let items = parsed.items().clone();
        let types: Vec<_> = items.iter().map(LazItem::item_type).collect();
        if types != expected_items(header) || items.iter().any(|i| i.size() != item_bytes(i.item_type())) {
            let what = format!(
                "a LAZ file of items {types:?} for point format {} with records of {} bytes",
                header.point_format.number(),
                header.record_bytes
            );
            return Err(file.unsupported(what, REMEDY));
        }
        let versions = if layered { 3..=4 } else { 1..=2 };
        if let Some(item) = items.iter().find(|i| !versions.contains(&i.version())) {
            let what = format!("LAZ item {:?} of version {}", item.item_type(), item.version());
            return Err(file.unsupported(what, REMEDY));
        }
        let codec = Self {
            decoded_here: Layers::new(&items).filter(|_| layered),
            items,
            layered,
            point_wise: compressor == 1,
            chunk_records: (!parsed.uses_variable_size_chunks()).then(|| parsed.chunk_size().into()),
            record_bytes: header.record_bytes,
        };
        // The crate refuses versions only when it sets up the fields.
        let probe = if layered {
            codec.crate_decompressor(Vec::new()).map(|_| ())
        } else {
            codec.sequential(Cursor::new(Vec::new())).map(|_| ())
        };
        probe.map_err(|e| file.unsupported(format!("its LAZ compression ({e})"), REMEDY))?;
        Ok(codec)
    }

    /// A decompressor of one chunk.
    ///
    /// # Errors
    ///
    /// What the crate refuses, and chunks that end before their layers.
    pub fn decompressor(&self, chunk: Vec<u8>) -> laz::Result<Decompressor> {
        if let Some(layers) = &self.decoded_here {
            let chunk = layers.open(chunk).ok_or_else(|| laz::LasZipError::IoError(ends_early()))?;
            return Ok(Decompressor::Here(Box::new(chunk)));
        }
        Ok(Decompressor::Crate(self.crate_decompressor(chunk)?))
    }

    /// The crate's decompressor of one chunk.
    fn crate_decompressor(&self, chunk: Vec<u8>) -> laz::Result<Box<dyn RecordDecompressor<Cursor<Vec<u8>>>>> {
        let chunk = Cursor::new(chunk);
        if self.layered {
            let mut decompressor = LayeredPointRecordDecompressor::new(chunk);
            decompressor.set_fields_from(&self.items)?;
            Ok(Box::new(decompressor))
        } else {
            Ok(Box::new(self.sequential(chunk)?))
        }
    }

    /// A decompressor of a stream of points that are not layered; it stands at the start of a chunk.
    pub fn sequential<'a, R: Read + 'a>(&self, source: R) -> laz::Result<SequentialPointRecordDecompressor<'a, R>> {
        let mut decompressor = SequentialPointRecordDecompressor::new(source);
        decompressor.set_fields_from(&self.items)?;
        Ok(decompressor)
    }

    /// Makes a sequential decompressor ready for the chunk that follows in its stream.
    pub fn restart<R: Read>(&self, decompressor: &mut SequentialPointRecordDecompressor<'_, R>) -> laz::Result<()> {
        decompressor.reset();
        decompressor.set_fields_from(&self.items)
    }

    /// Layers of a layered chunk: the `u32` sizes that follow its first record and its count.
    pub fn layers(&self) -> usize {
        let layers = |item: &LazItem| match item.item_type() {
            LazItemType::Point14 => 9,
            LazItemType::RGBNIR14 => 2,
            LazItemType::Byte14(bytes) => bytes.into(),
            _ => 1,
        };
        self.items.iter().map(layers).sum()
    }

    /// Bytes of a layered chunk up to its first layer.
    pub fn layered_head_bytes(&self) -> usize {
        self.record_bytes + 4 + 4 * self.layers()
    }

    /// What the head of a layered chunk says: its records, and its bytes altogether. `None` if the head is cut off.
    pub fn layered_head(&self, chunk: &[u8]) -> Option<(u64, u64)> {
        let head = chunk.get(..self.layered_head_bytes())?;
        let mut words = head[self.record_bytes..].as_chunks::<4>().0.iter().map(|w| u64::from(u32::from_le_bytes(*w)));
        let records = words.next()?;
        Some((records, head.len() as u64 + words.sum::<u64>()))
    }
}

/// Decodes the records of one chunk.
pub enum Decompressor {
    /// Layer by layer.
    Here(Box<layered::Chunk>),
    /// Record by record.
    Crate(Box<dyn RecordDecompressor<Cursor<Vec<u8>>>>),
}

impl Decompressor {
    /// Decodes as many records as `out` has room for.
    ///
    /// # Errors
    ///
    /// Where the chunk's data end before.
    pub fn decompress(&mut self, out: &mut [u8]) -> std::io::Result<()> {
        match self {
            Self::Here(chunk) => chunk.decode(out).then_some(()).ok_or_else(ends_early),
            Self::Crate(decompressor) => decompressor.decompress_many(out),
        }
    }
}

fn ends_early() -> std::io::Error {
    std::io::Error::new(ErrorKind::UnexpectedEof, "its data end early")
}

/// The items that LASzip writes for a point format.
fn expected_items(header: &Header) -> Vec<LazItemType> {
    let format = header.point_format;
    let extra = (header.record_bytes - format.record_bytes()) as u16;
    let mut items = Vec::new();
    if format.is_extended() {
        items.push(LazItemType::Point14);
        match (format.has_color(), format.has_infrared()) {
            (_, true) => items.push(LazItemType::RGBNIR14),
            (true, false) => items.push(LazItemType::RGB14),
            (false, false) => {}
        }
        items.extend(format.has_wave_packet().then_some(LazItemType::WavePacket14));
        items.extend((extra > 0).then_some(LazItemType::Byte14(extra)));
    } else {
        items.push(LazItemType::Point10);
        items.extend(format.has_gps_time().then_some(LazItemType::GpsTime));
        items.extend(format.has_color().then_some(LazItemType::RGB12));
        items.extend(format.has_wave_packet().then_some(LazItemType::WavePacket13));
        items.extend((extra > 0).then_some(LazItemType::Byte(extra)));
    }
    items
}

fn item_bytes(item: LazItemType) -> u16 {
    match item {
        LazItemType::Byte(bytes) | LazItemType::Byte14(bytes) => bytes,
        LazItemType::Point10 => 20,
        LazItemType::GpsTime | LazItemType::RGBNIR14 => 8,
        LazItemType::RGB12 | LazItemType::RGB14 => 6,
        LazItemType::WavePacket13 | LazItemType::WavePacket14 => 29,
        LazItemType::Point14 => 30,
    }
}

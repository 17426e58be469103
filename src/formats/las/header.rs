//! The public header block of LAS 1.0 to 1.5: first the fields as they are, then what must hold of them.
//!
//! Read here and not by a crate, because a field of LAS 1.5 and headers that end early must be told apart by byte.

use super::tables::PointFormat;
use crate::formats::FormatError;
use crate::formats::file::SourceFile;
use crate::lattice::SourceGrid;

/// Bytes of the header of LAS 1.0 to 1.2; the least that any version has.
const LEAST_BYTES: usize = 227;
/// Scale factors that a lattice may have, and nobody means others.
const LEAST_SCALE: f64 = 1e-12;
const GREATEST_SCALE: f64 = 1e6;

/// A header that has been checked.
#[derive(Clone, Debug)]
pub struct Header {
    /// Major and minor version.
    pub version: (u8, u8),
    /// File source id.
    pub file_source_id: u16,
    /// Global encoding bits.
    pub global_encoding: u16,
    /// Project GUID.
    pub guid: [u8; 16],
    /// System identifier.
    pub system_identifier: [u8; 32],
    /// Generating software.
    pub generating_software: [u8; 32],
    /// Bytes of the header.
    pub header_bytes: u16,
    /// Where the points begin.
    pub points_offset: u64,
    /// How many VLRs the header announces.
    pub vlrs: u32,
    /// Point format, without compression bits.
    pub point_format: PointFormat,
    /// Are the points compressed?
    pub compressed: bool,
    /// Bytes of a record; at least those of the format.
    pub record_bytes: usize,
    /// The 32-bit count of point records.
    pub legacy_points: u32,
    /// The 64-bit count of point records, from LAS 1.4.
    pub points: Option<u64>,
    /// Scale factors.
    pub scale: [f64; 3],
    /// Offsets.
    pub offset: [f64; 3],
    /// Scale and offset as decimals.
    pub grid: SourceGrid,
    /// Minimum and maximum, unchecked.
    pub bounds: ([f64; 3], [f64; 3]),
    /// Start of the waveform packets; 0 for none.
    pub waveform_offset: u64,
    /// Start of the EVLRs; 0 for none.
    pub evlr_offset: u64,
    /// How many EVLRs the header announces.
    pub evlrs: u32,
}

/// Little-endian fields of a header that may end early.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    /// The `N` bytes at `at`; zeros where the header ends before.
    fn bytes<const N: usize>(&self, at: usize) -> [u8; N] {
        self.0.get(at..at + N).and_then(|b| b.try_into().ok()).unwrap_or([0; N])
    }

    fn u8(&self, at: usize) -> u8 {
        self.bytes::<1>(at)[0]
    }

    fn u16(&self, at: usize) -> u16 {
        u16::from_le_bytes(self.bytes(at))
    }

    fn u32(&self, at: usize) -> u32 {
        u32::from_le_bytes(self.bytes(at))
    }

    fn u64(&self, at: usize) -> u64 {
        u64::from_le_bytes(self.bytes(at))
    }

    fn f64(&self, at: usize) -> f64 {
        f64::from_le_bytes(self.bytes(at))
    }

    fn f64x3(&self, at: usize, step: usize) -> [f64; 3] {
        std::array::from_fn(|i| self.f64(at + i * step))
    }
}

impl Header {
    /// Reads and checks the header of `file`.
    ///
    /// # Errors
    ///
    /// [`FormatError::Malformed`] with the byte of the field, [`FormatError::Unsupported`] for another major version or
    /// an unknown point format.
    pub(in crate::formats) fn read(file: &SourceFile) -> Result<Self, FormatError> {
        let raw = file.read_vec(0, 375 + 18)?;
        if !raw.starts_with(b"LASF") {
            return Err(file.malformed(0, "the signature `LASF`", quoted(&raw[..raw.len().min(4)])));
        }
        if raw.len() < LEAST_BYTES {
            let expected = format!("a header of at least {LEAST_BYTES} bytes");
            return Err(file.malformed(raw.len() as u64, expected, "the end of the file"));
        }
        let fields = Fields(&raw);
        let version = (fields.u8(24), fields.u8(25));
        if version.0 != 1 || version.1 > 5 {
            let what = format!("LAS version {}.{}", version.0, version.1);
            return Err(file.unsupported(what, "versions 1.0 to 1.5 are; convert it, with las2las or PDAL for example"));
        }
        let header_bytes = fields.u16(94);
        let least = match version.1 {
            0..=2 => LEAST_BYTES,
            3 => 235,
            _ => 375,
        };
        if usize::from(header_bytes) < least {
            let expected = format!("a header of at least {least} bytes for LAS 1.{}", version.1);
            return Err(file.malformed(94, expected, format!("{header_bytes}")));
        }
        // Fields that the header has no room for are absent, whatever follows it.
        let fields = Fields(&raw[..raw.len().min(header_bytes.into())]);
        if raw.len() < least {
            let expected = format!("a header of {least} bytes");
            return Err(file.malformed(raw.len() as u64, expected, "the end of the file"));
        }
        let points_offset = fields.u32(96);
        if points_offset < u32::from(header_bytes) {
            let expected = format!("an offset to points beyond the header of {header_bytes} bytes");
            return Err(file.malformed(96, expected, format!("{points_offset}")));
        }
        if u64::from(points_offset) > file.bytes() {
            let expected = format!("an offset to points within the file of {} bytes", file.bytes());
            return Err(file.malformed(96, expected, format!("{points_offset}")));
        }
        // LAZ sets bit 7 (old versions also bit 6) of the format.
        let format = fields.u8(104);
        let point_format = PointFormat::new(format & 0x3f).ok_or_else(|| {
            file.unsupported(format!("point format {}", format & 0x3f), "formats 0 to 10 are; is the file damaged?")
        })?;
        let record_bytes = usize::from(fields.u16(105));
        if record_bytes < point_format.record_bytes() {
            let expected =
                format!("records of at least {} bytes for point format {}", point_format.record_bytes(), format & 0x3f);
            return Err(file.malformed(105, expected, format!("{record_bytes}")));
        }
        let (scale, offset) = (fields.f64x3(131, 8), fields.f64x3(155, 8));
        let sensible = scale.iter().all(|s| (LEAST_SCALE..=GREATEST_SCALE).contains(s));
        let grid = SourceGrid::from_f64(scale, offset).filter(|_| sensible).ok_or_else(|| {
            let place = if sensible { 155 } else { 131 };
            let expected = "positive scale factors from 1e-12 to 1e6 and finite offsets";
            file.malformed(place, expected, format!("{scale:?} and {offset:?}"))
        })?;
        let large = version.1 >= 4;
        Ok(Self {
            version,
            file_source_id: fields.u16(4),
            global_encoding: fields.u16(6),
            guid: fields.bytes(8),
            system_identifier: fields.bytes(26),
            generating_software: fields.bytes(58),
            header_bytes,
            points_offset: points_offset.into(),
            vlrs: fields.u32(100),
            point_format,
            compressed: format & 0xc0 != 0,
            record_bytes,
            legacy_points: fields.u32(107),
            points: large.then(|| fields.u64(247)),
            scale,
            offset,
            grid,
            bounds: (fields.f64x3(187, 16), fields.f64x3(179, 16)),
            waveform_offset: if version.1 >= 3 { fields.u64(227) } else { 0 },
            evlr_offset: if large { fields.u64(235) } else { 0 },
            evlrs: if large { fields.u32(243) } else { 0 },
        })
    }

    /// The bounds, if they are numbers in order.
    pub fn bounds_hint(&self) -> Option<([f64; 3], [f64; 3])> {
        let (min, max) = self.bounds;
        (0..3).all(|i| min[i] <= max[i] && min[i].is_finite() && max[i].is_finite()).then_some((min, max))
    }
}

/// Bytes as text for a message.
pub(in crate::formats) fn quoted(raw: &[u8]) -> String {
    if raw.is_empty() { "nothing".to_owned() } else { format!("`{}`", raw.escape_ascii()) }
}

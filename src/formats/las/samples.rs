//! Small LAS and LAZ files, made in memory for tests.

use super::laz::LASZIP_USER_ID;
use super::tables::{PointFormat, XYZ_BYTES};
use laz::{LasZipCompressor, LazVlrBuilder};
use std::io::{Cursor, Seek, SeekFrom, Write};

/// What to put into a file.
#[derive(Clone, Debug)]
pub struct Sample {
    /// Minor version.
    pub minor: u8,
    /// Point format.
    pub format: u8,
    /// Extra bytes of a record.
    pub extra: usize,
    /// Records.
    pub points: u64,
    /// User id, record id, data.
    pub vlrs: Vec<(&'static [u8], u16, Vec<u8>)>,
    /// The same, after the points.
    pub evlrs: Vec<(&'static [u8], u16, Vec<u8>)>,
    /// Compressed in chunks of this many records.
    pub chunk: Option<u32>,
}

/// Where fields are in the header.
pub mod at {
    pub const ENCODING: usize = 6;
    pub const POINTS_OFFSET: usize = 96;
    pub const VLRS: usize = 100;
    pub const RECORD_BYTES: usize = 105;
    pub const LEGACY_POINTS: usize = 107;
    pub const SCALE: usize = 131;
    pub const EVLR_OFFSET: usize = 235;
    pub const POINTS: usize = 247;
}

impl Sample {
    /// `points` records of `format`, in the oldest version that has it.
    pub fn new(format: u8, points: u64) -> Self {
        let minor = match format {
            0 | 1 => 0,
            2 | 3 => 2,
            4 | 5 => 3,
            _ => 4,
        };
        Self { minor, format, extra: 0, points, vlrs: Vec::new(), evlrs: Vec::new(), chunk: None }
    }

    pub fn record_bytes(&self) -> usize {
        PointFormat::new(self.format).unwrap().record_bytes() + self.extra
    }

    /// The records as they lie in the file: positions that drift, other bytes of some entropy.
    pub fn records(&self) -> Vec<u8> {
        let mut out = Vec::new();
        let mut state = 1_u32;
        for i in 0..self.points as i32 {
            for axis in 0..3 {
                out.extend((i * (axis + 1) - 500).to_le_bytes());
            }
            for place in XYZ_BYTES..self.record_bytes() {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                out.push(if place % 3 == 0 { (state >> 24) as u8 } else { (i / 7) as u8 });
            }
        }
        out
    }

    pub fn file(&self) -> Vec<u8> {
        let header_bytes: u16 = match self.minor {
            0..=2 => 227,
            3 => 235,
            4 => 375,
            _ => 393,
        };
        let mut vlrs = self.vlrs.clone();
        let codec = self.chunk.map(|chunk| {
            let builder = LazVlrBuilder::default().with_point_format(self.format, self.extra as u16).unwrap();
            builder.with_fixed_chunk_size(chunk).build()
        });
        if let Some(codec) = &codec {
            let mut data = Vec::new();
            codec.write_to(&mut data).unwrap();
            vlrs.push((LASZIP_USER_ID, laz::LazVlr::RECORD_ID, data));
        }
        let points_offset = usize::from(header_bytes) + vlrs.iter().map(|v| 54 + v.2.len()).sum::<usize>();
        let mut file = vec![0; header_bytes.into()];
        let mut put = |at: usize, bytes: &[u8]| file[at..at + bytes.len()].copy_from_slice(bytes);
        put(0, b"LASF");
        put(24, &[1, self.minor]);
        put(94, &header_bytes.to_le_bytes());
        put(at::POINTS_OFFSET, &(points_offset as u32).to_le_bytes());
        put(at::VLRS, &(vlrs.len() as u32).to_le_bytes());
        put(104, &[self.format | if codec.is_some() { 0x80 } else { 0 }]);
        put(at::RECORD_BYTES, &(self.record_bytes() as u16).to_le_bytes());
        put(at::LEGACY_POINTS, &if self.format < 6 { self.points as u32 } else { 0 }.to_le_bytes());
        for axis in 0..3 {
            put(at::SCALE + 8 * axis, &0.01_f64.to_le_bytes());
            put(155 + 8 * axis, &1000.0_f64.to_le_bytes());
            put(179 + 16 * axis, &2000.0_f64.to_le_bytes());
        }
        if self.minor >= 4 {
            put(at::POINTS, &self.points.to_le_bytes());
        }
        for (user, id, data) in vlrs {
            push_vlr(&mut file, user, id, &(data.len() as u16).to_le_bytes(), &data);
        }
        let records = self.records();
        match codec {
            None => file.extend(records),
            Some(codec) => {
                let mut cursor = Cursor::new(file);
                cursor.seek(SeekFrom::End(0)).unwrap();
                let mut compressor = LasZipCompressor::new(cursor, codec).unwrap();
                compressor.compress_many(&records).unwrap();
                compressor.done().unwrap();
                let mut cursor = compressor.into_inner();
                cursor.flush().unwrap();
                file = cursor.into_inner();
            }
        }
        if self.minor >= 4 && !self.evlrs.is_empty() {
            let offset = file.len() as u64;
            file[at::EVLR_OFFSET..at::EVLR_OFFSET + 8].copy_from_slice(&offset.to_le_bytes());
            file[at::EVLR_OFFSET + 8..at::EVLR_OFFSET + 12].copy_from_slice(&(self.evlrs.len() as u32).to_le_bytes());
            for (user, id, data) in &self.evlrs {
                push_vlr(&mut file, user, *id, &(data.len() as u64).to_le_bytes(), data);
            }
        }
        file
    }
}

fn push_vlr(file: &mut Vec<u8>, user: &[u8], id: u16, length: &[u8], data: &[u8]) {
    file.extend([0; 2]);
    let mut user_id = [0; 16];
    user_id[..user.len()].copy_from_slice(user);
    file.extend(user_id);
    file.extend(id.to_le_bytes());
    file.extend(length);
    file.extend([0; 32]);
    file.extend(data);
}

//! The public header block and variable length records, as bytes.

use crate::points::RawVlr;
use std::time::{SystemTime, UNIX_EPOCH};

/// Global encoding: GPS times are adjusted standard ones.
pub(super) const STANDARD_TIME: u16 = 1;
/// Global encoding: waveform packets are in this file.
pub(super) const INTERNAL_WAVEFORMS: u16 = 1 << 1;
/// Global encoding: waveform packets are in a file beside this one.
pub(super) const EXTERNAL_WAVEFORMS: u16 = 1 << 2;
/// Global encoding: the CRS is WKT, as formats 6 to 10 demand (specification 1.4, section 2.4, table 4).
pub(super) const WKT: u16 = 1 << 4;
/// Global encoding: GPS times have an offset of their own (LAS 1.5).
pub(super) const TIME_OFFSET: u16 = 1 << 6;

/// A day, as LAS headers count them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CreationDate {
    /// January 1 is 1.
    pub day_of_year: u16,
    /// Four digits.
    pub year: u16,
}

impl CreationDate {
    /// Today, in Greenwich.
    pub fn today() -> Self {
        let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
        Self::of_unix_day(seconds / 86_400)
    }

    fn of_unix_day(mut days: u64) -> Self {
        let mut year = 1970;
        loop {
            let leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
            let length = if leap { 366 } else { 365 };
            if days < length || year == u16::MAX {
                return Self { day_of_year: days.min(365) as u16 + 1, year };
            }
            days -= length;
            year += 1;
        }
    }
}

/// What of a header is known before the first point.
#[derive(Clone, Debug, Default)]
pub(super) struct Header {
    pub version: (u8, u8),
    pub point_format: u8,
    pub compressed: bool,
    pub record_bytes: u16,
    pub scale: [f64; 3],
    pub offset: [f64; 3],
    pub global_encoding: u16,
    pub file_source_id: u16,
    pub guid: [u8; 16],
    pub system_identifier: [u8; 32],
    pub date: CreationDate,
    /// Number of VLRs, and their bytes with headers.
    pub vlrs: (u32, Vec<u8>),
    /// Number of EVLRs, and their bytes with headers.
    pub evlrs: (u32, Vec<u8>),
}

/// What of a header is known after the last point.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Totals {
    pub points: u64,
    /// Points of return 1 to 15; return 0 is none.
    pub by_return: [u64; 15],
    pub min: [i32; 3],
    pub max: [i32; 3],
    /// Least and greatest GPS time; `None` if there is none.
    pub time: Option<(f64, f64)>,
    /// Where the EVLRs begin.
    pub evlr_start: u64,
}

impl Default for Totals {
    fn default() -> Self {
        Self { points: 0, by_return: [0; 15], min: [i32::MAX; 3], max: [i32::MIN; 3], time: None, evlr_start: 0 }
    }
}

impl Totals {
    /// Takes in those of other points.
    pub fn add(&mut self, other: &Self) {
        self.points += other.points;
        self.by_return.iter_mut().zip(other.by_return).for_each(|(all, n)| *all += n);
        for axis in 0..3 {
            self.min[axis] = self.min[axis].min(other.min[axis]);
            self.max[axis] = self.max[axis].max(other.max[axis]);
        }
        other.time.into_iter().for_each(|(least, greatest)| self.note_times(least, greatest));
    }

    /// Takes in a range of finite times.
    pub fn note_times(&mut self, least: f64, greatest: f64) {
        let (a, b) = self.time.unwrap_or((least, greatest));
        self.time = Some((a.min(least), b.max(greatest)));
    }
}

impl Header {
    /// Bytes of the public header block.
    fn header_bytes(&self) -> u16 {
        match self.version.1 {
            0..=2 => 227,
            3 => 235,
            4 => 375,
            _ => 393,
        }
    }

    /// LAS 1.0 has a signature before the points.
    fn has_signature(&self) -> bool {
        self.version == (1, 0)
    }

    /// Where the points begin.
    pub fn offset_to_points(&self) -> u64 {
        u64::from(self.header_bytes()) + self.vlrs.1.len() as u64 + if self.has_signature() { 2 } else { 0 }
    }

    /// The most points that the version can announce.
    pub fn most_points(&self) -> u64 {
        if self.version.1 >= 4 { u64::MAX } else { u64::from(u32::MAX) }
    }

    /// Everything before the points.
    pub fn to_bytes(&self, totals: &Totals) -> Vec<u8> {
        let mut out = Vec::with_capacity(self.offset_to_points() as usize);
        let put16 = |out: &mut Vec<u8>, v: u16| out.extend_from_slice(&v.to_le_bytes());
        let put32 = |out: &mut Vec<u8>, v: u32| out.extend_from_slice(&v.to_le_bytes());
        let put64 = |out: &mut Vec<u8>, v: u64| out.extend_from_slice(&v.to_le_bytes());
        let put_float = |out: &mut Vec<u8>, v: f64| out.extend_from_slice(&v.to_le_bytes());

        out.extend_from_slice(b"LASF");
        put16(&mut out, self.file_source_id);
        put16(&mut out, self.global_encoding);
        out.extend_from_slice(&self.guid);
        out.extend_from_slice(&[self.version.0, self.version.1]);
        out.extend_from_slice(&self.system_identifier);
        out.extend_from_slice(&padded::<32>(concat!("esker ", env!("CARGO_PKG_VERSION"))));
        put16(&mut out, self.date.day_of_year);
        put16(&mut out, self.date.year);
        put16(&mut out, self.header_bytes());
        // Checked when the VLRs were put together: they fit 32 bits.
        put32(&mut out, self.offset_to_points() as u32);
        put32(&mut out, self.vlrs.0);
        out.push(self.point_format | if self.compressed { 0x80 } else { 0 });
        put16(&mut out, self.record_bytes);
        // Legacy counts are for formats 0 to 5 and numbers that fit, otherwise zero (specification 1.4, section 2.4).
        let legacy = self.point_format < 6 && totals.points <= u64::from(u32::MAX);
        put32(&mut out, if legacy { totals.points as u32 } else { 0 });
        for count in &totals.by_return[..5] {
            put32(&mut out, if legacy { *count as u32 } else { 0 });
        }
        for v in self.scale.iter().chain(&self.offset) {
            put_float(&mut out, *v);
        }
        for axis in 0..3 {
            let world =
                |x: i32| if totals.points == 0 { 0.0 } else { self.scale[axis] * f64::from(x) + self.offset[axis] };
            put_float(&mut out, world(totals.max[axis]));
            put_float(&mut out, world(totals.min[axis]));
        }
        if self.version.1 >= 3 {
            // Waveform packets are not kept.
            put64(&mut out, 0);
        }
        if self.version.1 >= 4 {
            put64(&mut out, if self.evlrs.0 == 0 { 0 } else { totals.evlr_start });
            put32(&mut out, self.evlrs.0);
            put64(&mut out, totals.points);
            for count in &totals.by_return {
                put64(&mut out, *count);
            }
        }
        if self.version.1 >= 5 {
            let (least, greatest) = totals.time.unwrap_or_default();
            put_float(&mut out, greatest);
            put_float(&mut out, least);
            put16(&mut out, 0);
        }
        out.extend_from_slice(&self.vlrs.1);
        if self.has_signature() {
            out.extend_from_slice(&[0xDD, 0xCC]);
        }
        out
    }
}

/// Text in a fixed field, cut or filled with zeros.
pub(super) fn padded<const N: usize>(text: &str) -> [u8; N] {
    let mut bytes = [0; N];
    let cut = text.floor_char_boundary(N);
    bytes[..cut].copy_from_slice(&text.as_bytes()[..cut]);
    bytes
}

/// A record of our own making.
pub(super) fn vlr(user_id: &str, record_id: u16, description: &str, data: Vec<u8>) -> RawVlr {
    // Only an extended record has a 64-bit length.
    let extended = data.len() > usize::from(u16::MAX);
    RawVlr { extended, user_id: padded(user_id), record_id, description: padded(description), data }
}

/// Is it for `user_id`?
pub(super) fn is_for(vlr: &RawVlr, user_id: &str) -> bool {
    let end = vlr.user_id.iter().position(|&b| b == 0).unwrap_or(vlr.user_id.len());
    vlr.user_id[..end].trim_ascii().eq_ignore_ascii_case(user_id.as_bytes())
}

/// Appends a record with its header.
pub(super) fn append_vlr(out: &mut Vec<u8>, vlr: &RawVlr, version: (u8, u8)) {
    // The first two bytes are reserved; in LAS 1.0 they hold a signature.
    let reserved: u16 = if version == (1, 0) { 0xAABB } else { 0 };
    out.extend_from_slice(&reserved.to_le_bytes());
    out.extend_from_slice(&vlr.user_id);
    out.extend_from_slice(&vlr.record_id.to_le_bytes());
    if vlr.extended {
        out.extend_from_slice(&(vlr.data.len() as u64).to_le_bytes());
    } else {
        out.extend_from_slice(&(vlr.data.len() as u16).to_le_bytes());
    }
    out.extend_from_slice(&vlr.description);
    out.extend_from_slice(&vlr.data);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_of_the_year_know_leap_years() {
        let day = |days| {
            let d = CreationDate::of_unix_day(days);
            (d.year, d.day_of_year)
        };
        assert_eq!(day(0), (1970, 1));
        assert_eq!(day(364), (1970, 365));
        assert_eq!(day(365), (1971, 1));
        assert_eq!(day(19_782), (2024, 60));
        assert_eq!(day(20_088), (2024, 366));
        assert_eq!(day(20_089), (2025, 1));
    }

    #[test]
    fn text_is_cut_between_characters() {
        assert_eq!(&padded::<4>("ab"), b"ab\0\0");
        assert_eq!(padded::<4>("abc\u{e9}"), *b"abc\0");
    }
}

//! What the LAS specification says of point records: fields of formats 0 to 10, and types of extra bytes.
//!
//! Offsets count from the end of X, Y and Z, as they do in a [`RecordLayout`](crate::points::RecordLayout).

use crate::points::{FieldKind, ScalarType, canonical_name};

/// The highest point data record format.
pub const MAX_POINT_FORMAT: u8 = 10;
/// Bytes of X, Y and Z at the start of every record.
pub const XYZ_BYTES: usize = 12;

/// A field of a standard point record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Dimension {
    /// PDAL's name.
    pub name: &'static str,
    /// The type of its values.
    pub ty: ScalarType,
    /// First byte after X, Y and Z.
    pub offset: usize,
    /// A value of its own, or bits of a byte.
    pub kind: FieldKind,
}

const fn whole(name: &'static str, ty: ScalarType, offset: usize) -> Dimension {
    Dimension { name, ty, offset, kind: FieldKind::Whole }
}

const fn bits(name: &'static str, offset: usize, shift: u8, mask: u8) -> Dimension {
    Dimension { name, ty: ScalarType::U8, offset, kind: FieldKind::Bits { shift, mask } }
}

/// Formats 0 to 5 begin with these 8 bytes (specification 1.4, table 7).
const LEGACY_CORE: [Dimension; 12] = [
    whole("Intensity", ScalarType::U16, 0),
    bits("ReturnNumber", 2, 0, 7),
    bits("NumberOfReturns", 2, 3, 7),
    bits("ScanDirectionFlag", 2, 6, 1),
    bits("EdgeOfFlightLine", 2, 7, 1),
    bits("Classification", 3, 0, 31),
    bits("Synthetic", 3, 5, 1),
    bits("KeyPoint", 3, 6, 1),
    bits("Withheld", 3, 7, 1),
    whole("ScanAngleRank", ScalarType::I8, 4),
    whole("UserData", ScalarType::U8, 5),
    whole("PointSourceId", ScalarType::U16, 6),
];

/// Formats 6 to 10 begin with these 18 bytes (specification 1.4, table 14).
const EXTENDED_CORE: [Dimension; 15] = [
    whole("Intensity", ScalarType::U16, 0),
    bits("ReturnNumber", 2, 0, 15),
    bits("NumberOfReturns", 2, 4, 15),
    bits("Synthetic", 3, 0, 1),
    bits("KeyPoint", 3, 1, 1),
    bits("Withheld", 3, 2, 1),
    bits("Overlap", 3, 3, 1),
    bits("ScanChannel", 3, 4, 3),
    bits("ScanDirectionFlag", 3, 6, 1),
    bits("EdgeOfFlightLine", 3, 7, 1),
    whole("Classification", ScalarType::U8, 4),
    whole("UserData", ScalarType::U8, 5),
    whole("ScanAngleRank", ScalarType::I16, 6),
    whole("PointSourceId", ScalarType::U16, 8),
    whole("GpsTime", ScalarType::F64, 10),
];

const fn color(offset: usize) -> [Dimension; 3] {
    [
        whole("Red", ScalarType::U16, offset),
        whole("Green", ScalarType::U16, offset + 2),
        whole("Blue", ScalarType::U16, offset + 4),
    ]
}

const fn wave_packet(offset: usize) -> [Dimension; 7] {
    [
        whole("WavePacketDescriptorIndex", ScalarType::U8, offset),
        whole("WaveformDataOffset", ScalarType::U64, offset + 1),
        whole("WaveformPacketSize", ScalarType::U32, offset + 9),
        whole("WaveformReturnPointLocation", ScalarType::F32, offset + 13),
        whole("WaveformXt", ScalarType::F32, offset + 17),
        whole("WaveformYt", ScalarType::F32, offset + 21),
        whole("WaveformZt", ScalarType::F32, offset + 25),
    ]
}

/// One of the eleven point data record formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PointFormat(u8);

impl PointFormat {
    /// Format `number`, without compression bits; `None` above [`MAX_POINT_FORMAT`].
    pub fn new(number: u8) -> Option<Self> {
        (0..=MAX_POINT_FORMAT).contains(&number).then_some(Self(number))
    }

    /// Its number.
    pub fn number(self) -> u8 {
        self.0
    }

    /// Formats 6 to 10, which LAS 1.4 brought.
    pub fn is_extended(self) -> bool {
        self.0 >= 6
    }

    /// Has it GPS time?
    pub fn has_gps_time(self) -> bool {
        !matches!(self.0, 0 | 2)
    }

    /// Has it red, green and blue?
    pub fn has_color(self) -> bool {
        matches!(self.0, 2 | 3 | 5 | 7 | 8 | 10)
    }

    /// Has it near infrared?
    pub fn has_infrared(self) -> bool {
        matches!(self.0, 8 | 10)
    }

    /// Has it a wave packet?
    pub fn has_wave_packet(self) -> bool {
        matches!(self.0, 4 | 5 | 9 | 10)
    }

    /// Bytes of a standard record, X, Y and Z included.
    pub fn record_bytes(self) -> usize {
        let core = if self.is_extended() { 30 } else { 20 };
        let time = if self.has_gps_time() && !self.is_extended() { 8 } else { 0 };
        let color = if self.has_color() { 6 } else { 0 };
        let infrared = if self.has_infrared() { 2 } else { 0 };
        let wave = if self.has_wave_packet() { 29 } else { 0 };
        core + time + color + infrared + wave
    }

    /// Its fields after X, Y and Z, in the order of the specification.
    pub fn dimensions(self) -> Vec<Dimension> {
        let mut fields = Vec::with_capacity(27);
        let mut end = if self.is_extended() {
            fields.extend(EXTENDED_CORE);
            18
        } else {
            fields.extend(LEGACY_CORE);
            8
        };
        if self.has_gps_time() && !self.is_extended() {
            fields.push(whole("GpsTime", ScalarType::F64, end));
            end += 8;
        }
        if self.has_color() {
            fields.extend(color(end));
            end += 6;
        }
        if self.has_infrared() {
            fields.push(whole("Infrared", ScalarType::U16, end));
            end += 2;
        }
        if self.has_wave_packet() {
            fields.extend(wave_packet(end));
        }
        fields
    }
}

/// Is `name`, or what PDAL calls it, a field of some point format? An extra byte must not take such a name.
pub fn is_las_dimension(name: &str) -> bool {
    // Format 10 has all fields that any format has.
    canonical_name(name).is_some_and(|n| PointFormat(10).dimensions().iter().any(|d| d.name == n))
}

/// The type and the number of members of extra-bytes data type `code` (specification 1.4, table 25); 11 to 30 are the
/// deprecated arrays of two and three. `None` for 0 (undocumented bytes) and for reserved codes.
pub fn extra_type(code: u8) -> Option<(ScalarType, usize)> {
    let (index, members) = match code {
        1..=10 => (code - 1, 1),
        11..=20 => (code - 11, 2),
        21..=30 => (code - 21, 3),
        _ => return None,
    };
    Some((ScalarType::ALL[usize::from(index)], members))
}

/// The extra-bytes data type of single values of type `ty`.
pub fn extra_code(ty: ScalarType) -> u8 {
    ty as u8 + 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_are_as_long_as_the_specification_says() {
        let bytes = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67];
        for (number, bytes) in (0..).zip(bytes) {
            assert_eq!(PointFormat::new(number).unwrap().record_bytes(), bytes, "format {number}");
        }
        assert_eq!(PointFormat::new(11), None);
    }

    #[test]
    fn fields_cover_every_bit_of_a_record_once() {
        for number in 0..=MAX_POINT_FORMAT {
            let format = PointFormat::new(number).unwrap();
            let mut taken = vec![0_u8; format.record_bytes() - XYZ_BYTES];
            for d in format.dimensions() {
                let masks = match d.kind {
                    FieldKind::Whole => vec![255; d.ty.size()],
                    FieldKind::Bits { shift, mask } => vec![mask << shift],
                };
                for (byte, mask) in taken[d.offset..].iter_mut().zip(masks) {
                    assert_eq!(*byte & mask, 0, "format {number}, {}", d.name);
                    *byte |= mask;
                }
            }
            assert!(taken.iter().all(|&b| b == 255), "format {number}: {taken:?}");
        }
    }

    #[test]
    fn names_are_canonical_and_clashes_are_seen() {
        for d in PointFormat::new(10).unwrap().dimensions() {
            assert_eq!(canonical_name(d.name), Some(d.name));
            assert!(is_las_dimension(d.name));
        }
        assert!(is_las_dimension("nir"));
        assert!(!is_las_dimension("NormalX"));
        assert!(!is_las_dimension("treeID"));
    }

    #[test]
    fn extra_codes_come_back() {
        for ty in ScalarType::ALL {
            assert_eq!(extra_type(extra_code(ty)), Some((ty, 1)));
            assert_eq!(extra_type(extra_code(ty) + 20), Some((ty, 3)));
        }
        assert_eq!(extra_type(0), None);
        assert_eq!(extra_type(31), None);
    }
}

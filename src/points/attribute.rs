//! What an attribute is: a name in PDAL's LAS dimension words, and a type.

use super::{Column, Number};
use serde::{Deserialize, Serialize};

/// The type of one value, little-endian wherever it is bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[allow(missing_docs)]
pub enum ScalarType {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

impl ScalarType {
    /// All types.
    pub const ALL: [Self; 10] =
        [Self::U8, Self::I8, Self::U16, Self::I16, Self::U32, Self::I32, Self::U64, Self::I64, Self::F32, Self::F64];

    /// Bytes of a value.
    pub fn size(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    /// `u8`, `i16`, `f64`, ...: the word in the store and in reports.
    pub fn word(self) -> &'static str {
        match self {
            Self::U8 => "u8",
            Self::I8 => "i8",
            Self::U16 => "u16",
            Self::I16 => "i16",
            Self::U32 => "u32",
            Self::I32 => "i32",
            Self::U64 => "u64",
            Self::I64 => "i64",
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }

    /// The reverse of [`ScalarType::word`].
    pub fn from_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|t| t.word() == word)
    }

    /// Is it a floating-point type?
    pub fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }
}

/// `value = raw * scale + offset`, for extra bytes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scaling {
    /// Multiplied first.
    pub scale: f64,
    /// Added after.
    pub offset: f64,
}

/// What makes an attribute another one, in canonical order: name, type, scaling (its bits), no-data value (the bytes that
/// count).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Identity<'a> {
    /// The name.
    pub name: &'a str,
    /// The type of the stored values.
    pub ty: ScalarType,
    /// The bits of scale and offset.
    pub scaling: Option<[u64; 2]>,
    /// The value that means "no data", zero beyond the bytes of the type.
    pub no_data: Option<[u8; 8]>,
}

/// A named, typed value per point. Its [`Identity`] is all but the description.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Attribute {
    /// PDAL's LAS dimension name where there is one: `Intensity`, `ReturnNumber`, `NumberOfReturns`,
    /// `ScanDirectionFlag`, `EdgeOfFlightLine`, `Classification`, `Synthetic`, `KeyPoint`, `Withheld`, `Overlap`,
    /// `ScanChannel`, `ScanAngleRank` (i8, formats 0 to 5; i16 in steps of 0.006 degrees in formats 6 to 10), `UserData`,
    /// `PointSourceId`, `GpsTime`, `Red`, `Green`, `Blue`, `Infrared`, `NormalX`, ...; else the source's own name, with
    /// `NAME[0]` for array members and `extra.NAME` where an extra byte takes a canonical name.
    pub name: String,
    /// The type of the stored values.
    pub ty: ScalarType,
    /// Scale and offset of an extra byte.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scaling: Option<Scaling>,
    /// The value that means "no data", as it is stored: the first `ty.size()` bytes count.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub no_data: Option<[u8; 8]>,
    /// The source's description.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub description: String,
}

impl Attribute {
    /// An attribute without scaling, no-data and description.
    pub fn new(name: impl Into<String>, ty: ScalarType) -> Self {
        Self { name: name.into(), ty, scaling: None, no_data: None, description: String::new() }
    }

    /// What makes it another attribute. The attributes of one scan differ in name or type already.
    pub fn identity(&self) -> Identity<'_> {
        let scaling = self.scaling.map(|s| [s.scale.to_bits(), s.offset.to_bits()]);
        Identity { name: &self.name, ty: self.ty, scaling, no_data: self.no_data_bytes() }
    }

    /// The stored bytes that mean "no data", as [`Column::raw`](super::Column::raw) gives them: zero beyond those of the type.
    pub fn no_data_bytes(&self) -> Option<[u8; 8]> {
        self.no_data.map(|mut bytes| {
            bytes[self.ty.size()..].fill(0);
            bytes
        })
    }

    /// The stored value that means "no data".
    pub fn no_data_value(&self) -> Option<Number> {
        let mut one = Column::with_capacity(self.ty, 1);
        one.push_raw(self.no_data?);
        Some(one.number(0))
    }

    /// How stored values become real ones, where these are others.
    pub fn real_scaling(&self) -> Option<Scaling> {
        self.scaling.filter(|s| (s.scale, s.offset) != (1.0, 0.0))
    }
}

/// laspy's and other tools' names for PDAL's, in the form of [`fold`].
const SYNONYMS: &[(&str, &str)] = &[
    ("returnnum", "ReturnNumber"),
    ("numreturns", "NumberOfReturns"),
    ("ptsrcid", "PointSourceId"),
    ("pointsourceid", "PointSourceId"),
    ("nir", "Infrared"),
    ("nearinfrared", "Infrared"),
    ("scanangle", "ScanAngleRank"),
    ("scannerchannel", "ScanChannel"),
    ("rawclassification", "Classification"),
    ("class", "Classification"),
    ("edgeofflight", "EdgeOfFlightLine"),
    ("time", "GpsTime"),
    ("keypointflag", "KeyPoint"),
    ("syntheticflag", "Synthetic"),
    ("withheldflag", "Withheld"),
    ("overlapflag", "Overlap"),
];

/// PDAL's names for what a LAS record holds.
const CANONICAL: &[&str] = &[
    "Intensity",
    "ReturnNumber",
    "NumberOfReturns",
    "ScanDirectionFlag",
    "EdgeOfFlightLine",
    "Classification",
    "Synthetic",
    "KeyPoint",
    "Withheld",
    "Overlap",
    "ScanChannel",
    "ScanAngleRank",
    "UserData",
    "PointSourceId",
    "GpsTime",
    "Red",
    "Green",
    "Blue",
    "Infrared",
    "WavePacketDescriptorIndex",
    "WaveformDataOffset",
    "WaveformPacketSize",
    "WaveformReturnPointLocation",
    "WaveformXt",
    "WaveformYt",
    "WaveformZt",
    "NormalX",
    "NormalY",
    "NormalZ",
];

/// Case and underscores do not count when names are looked up.
fn fold(name: &str) -> String {
    name.chars().filter(|c| *c != '_').flat_map(char::to_lowercase).collect()
}

/// Do two names mean the same to a user: equal but for case and underscores?
pub fn same_name(a: &str, b: &str) -> bool {
    fold(a) == fold(b)
}

/// PDAL's name for what a user may call otherwise (`return_num`, `nir`, `gps_time`); `None` if it is no LAS dimension.
pub fn canonical_name(name: &str) -> Option<&'static str> {
    let folded = fold(name);
    let canonical = CANONICAL.iter().find(|c| fold(c) == folded).copied();
    canonical.or_else(|| SYNONYMS.iter().find(|(s, _)| *s == folded).map(|(_, c)| *c))
}

/// The type to which an attribute of this name and type is brought where scans have it in two: colours of 8 bits to 16, scan
/// angles in whole degrees to finer steps.
pub fn wider_type(name: &str, ty: ScalarType) -> Option<ScalarType> {
    match (name, ty) {
        ("Red" | "Green" | "Blue" | "Infrared", ScalarType::U8) => Some(ScalarType::U16),
        ("ScanAngleRank", ScalarType::I8) => Some(ScalarType::I16),
        _ => None,
    }
}

/// A scan angle in whole degrees in steps of 0.006 degrees: the nearest one.
pub fn angle_steps(degrees: i8) -> i16 {
    // A degree is 1000/6 steps: add half a step away from zero, then cut.
    let sixths = 1000 * i32::from(degrees) + 3 * i32::from(degrees.signum());
    (sixths / 6) as i16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn degrees_become_the_nearest_steps() {
        for degrees in i8::MIN..=i8::MAX {
            assert_eq!(angle_steps(degrees), (f64::from(degrees) / 0.006).round() as i16, "{degrees}");
        }
    }

    #[test]
    fn users_names_find_the_canonical_ones() {
        assert_eq!(canonical_name("gps_time"), Some("GpsTime"));
        assert_eq!(canonical_name("NIR"), Some("Infrared"));
        assert_eq!(canonical_name("return_number"), Some("ReturnNumber"));
        assert_eq!(canonical_name("treeID"), None);
        assert!(same_name("tree_id", "TreeID"));
        assert!(!same_name("tree", "TreeID"));
    }
}

//! The extra-bytes VLR of a merged file.

use super::header;
use crate::formats::las::tables::{extra_code, is_las_dimension};
use crate::points::{Attribute, RawVlr, ScalarType};
use std::collections::HashSet;

/// Bytes of one descriptor.
const DESCRIPTOR_BYTES: usize = 192;
/// Bytes of a name in it.
const NAME_BYTES: usize = 32;

/// What laspy calls fields of formats 6 to 8, parts of them and coordinates: it refuses files with extra bytes of these names,
/// or gives the field instead.
const LASPY_NAMES: [&str; 32] = [
    "X",
    "Y",
    "Z",
    "x",
    "y",
    "z",
    "intensity",
    "bit_fields",
    "return_number",
    "return_num",
    "number_of_returns",
    "num_returns",
    "classification_flags",
    "synthetic",
    "key_point",
    "withheld",
    "overlap",
    "scanner_channel",
    "scan_direction_flag",
    "edge_of_flight_line",
    "classification",
    "raw_classification",
    "user_data",
    "scan_angle",
    "scan_angle_rank",
    "point_source_id",
    "pt_src_id",
    "gps_time",
    "red",
    "green",
    "blue",
    "nir",
];

/// An extra byte under the name that it has in the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct ExtraField {
    pub name: String,
    /// Is that another name than the attribute's?
    pub renamed: bool,
}

/// Gives out names that are unique in a file.
#[derive(Debug, Default)]
pub(super) struct Names(HashSet<String>);

impl Names {
    /// The name of `attribute`: without the `extra.` that a reader gives it again, but with it where laspy has the name;
    /// cut to what fits, and with a number if it is taken.
    pub fn field(&mut self, attribute: &Attribute) -> ExtraField {
        let short = attribute.name.strip_prefix("extra.").filter(|n| is_las_dimension(n)).unwrap_or(&attribute.name);
        let reserved = LASPY_NAMES.contains(&short).then(|| format!("extra.{short}"));
        let plain = reserved.as_deref().unwrap_or(short);
        let cut = |bytes: usize| &plain[..plain.floor_char_boundary(bytes)];
        let mut name = cut(NAME_BYTES).to_owned();
        let mut number = 2;
        while !self.0.insert(name.clone()) {
            let suffix = format!(".{number}");
            name = format!("{}{suffix}", cut(NAME_BYTES - suffix.len()));
            number += 1;
        }
        ExtraField { renamed: name != short && name != attribute.name, name }
    }
}

impl ExtraField {
    /// Its descriptor (specification 1.4, table 24).
    pub fn descriptor(&self, attribute: &Attribute) -> [u8; DESCRIPTOR_BYTES] {
        let mut raw = [0; DESCRIPTOR_BYTES];
        raw[2] = extra_code(attribute.ty);
        raw[4..36].copy_from_slice(&header::padded::<NAME_BYTES>(&self.name));
        if let Some(no_data) = attribute.no_data {
            raw[3] |= 1;
            raw[40..48].copy_from_slice(&upcast(attribute.ty, no_data));
        }
        if let Some(scaling) = attribute.scaling {
            raw[3] |= 0b1_1000;
            raw[112..120].copy_from_slice(&scaling.scale.to_le_bytes());
            raw[136..144].copy_from_slice(&scaling.offset.to_le_bytes());
        }
        raw[160..192].copy_from_slice(&header::padded::<32>(&attribute.description));
        raw
    }
}

/// A value as the eight bytes of the widest type of its kind.
fn upcast(ty: ScalarType, raw: [u8; 8]) -> [u8; 8] {
    let [a, b, c, d, ..] = raw;
    match ty {
        ScalarType::U8 => u64::from(a).to_le_bytes(),
        ScalarType::I8 => i64::from(a.cast_signed()).to_le_bytes(),
        ScalarType::U16 => u64::from(u16::from_le_bytes([a, b])).to_le_bytes(),
        ScalarType::I16 => i64::from(i16::from_le_bytes([a, b])).to_le_bytes(),
        ScalarType::U32 => u64::from(u32::from_le_bytes([a, b, c, d])).to_le_bytes(),
        ScalarType::I32 => i64::from(i32::from_le_bytes([a, b, c, d])).to_le_bytes(),
        ScalarType::F32 => f64::from(f32::from_le_bytes([a, b, c, d])).to_le_bytes(),
        ScalarType::U64 | ScalarType::I64 | ScalarType::F64 => raw,
    }
}

/// The VLR of these descriptors.
pub(super) fn vlr(descriptors: Vec<u8>) -> RawVlr {
    header::vlr("LASF_Spec", 4, "Extra Bytes Record", descriptors)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_fit() {
        let mut names = Names::default();
        let mut name = |n: &str, ty| names.field(&Attribute::new(n, ty));
        assert_eq!(name("height", ScalarType::F32), ExtraField { name: "height".into(), renamed: false });
        assert_eq!(name("height", ScalarType::F64), ExtraField { name: "height.2".into(), renamed: true });
        assert_eq!(name("extra.Intensity", ScalarType::U32).name, "Intensity");
        assert_eq!(name("Intensity", ScalarType::F32).name, "Intensity.2");
        assert_eq!(name("extra.mine", ScalarType::F32).name, "extra.mine");
        let long = "n".repeat(40);
        assert_eq!(name(&long, ScalarType::U8).name, "n".repeat(32));
        assert_eq!(name(&long, ScalarType::I8).name, format!("{}.2", "n".repeat(30)));
    }

    /// laspy refuses a second `scan_angle`.
    #[test]
    fn names_that_laspy_has_are_made_apart() {
        let mut names = Names::default();
        let mut field = |n: &str, ty| names.field(&Attribute::new(n, ty));
        let renamed = |name: &str| ExtraField { name: name.into(), renamed: true };
        let kept = |name: &str| ExtraField { name: name.into(), renamed: false };
        assert_eq!(field("extra.scan_angle", ScalarType::F32), kept("extra.scan_angle"));
        assert_eq!(field("scan_angle", ScalarType::F64), renamed("extra.scan_angle.2"));
        assert_eq!(field("bit_fields", ScalarType::U8), renamed("extra.bit_fields"));
        assert_eq!(field("Scan_Angle", ScalarType::F32), kept("Scan_Angle"));
        for name in LASPY_NAMES {
            assert!(!LASPY_NAMES.contains(&names.field(&Attribute::new(name, ScalarType::I8)).name.as_str()), "{name}");
        }
    }

    #[test]
    fn no_data_is_widened_by_value() {
        let raw = |bytes: &[u8]| std::array::from_fn(|i| bytes.get(i).copied().unwrap_or(0xAA));
        assert_eq!(upcast(ScalarType::I16, raw(&(-2_i16).to_le_bytes())), (-2_i64).to_le_bytes());
        assert_eq!(upcast(ScalarType::U8, raw(&[255])), 255_u64.to_le_bytes());
        assert_eq!(upcast(ScalarType::F32, raw(&(-9999_f32).to_le_bytes())), (-9999_f64).to_le_bytes());
    }
}

//! Extra bytes: what the extra-bytes VLR (`LASF_Spec`, 4) says of the bytes after the standard fields.

use super::tables::extra_type;
use crate::points::{Attribute, RawVlr, ScalarType, Scaling};

/// User id of the VLRs that the specification defines.
pub const SPEC_USER_ID: &[u8] = b"LASF_Spec";
/// Record id of the extra-bytes VLR.
pub const EXTRA_BYTES_RECORD_ID: u16 = 4;
/// Bytes of one descriptor in that VLR.
pub const DESCRIPTOR_BYTES: usize = 192;

/// Is this VLR an extra-bytes VLR?
pub fn is_extra_bytes_vlr(vlr: &RawVlr) -> bool {
    vlr.record_id == EXTRA_BYTES_RECORD_ID && has_user_id(vlr, SPEC_USER_ID)
}

/// Is `user_id` the VLR's user id, up to the first zero byte?
pub fn has_user_id(vlr: &RawVlr, user_id: &[u8]) -> bool {
    vlr.user_id.split(|&b| b == 0).next() == Some(user_id)
}

/// One descriptor of an extra-bytes VLR.
#[derive(Clone, Debug, PartialEq)]
pub struct ExtraBytes {
    /// Its attributes, one per member, by the source's name (not yet made unique), in the order of the bytes.
    pub attributes: Vec<Attribute>,
}

impl ExtraBytes {
    /// Reads a descriptor; `None` if its data type is a reserved one.
    pub fn parse(raw: &[u8; DESCRIPTOR_BYTES]) -> Option<Self> {
        let (code, options) = (raw[2], raw[3]);
        let name = text(&raw[4..36]);
        let name = if name.is_empty() { "unnamed".to_owned() } else { name };
        let description = text(&raw[160..192]);
        if code == 0 {
            let member = |i| Attribute {
                description: description.clone(),
                ..Attribute::new(format!("{name}[{i}]"), ScalarType::U8)
            };
            return Some(Self { attributes: (0..options).map(member).collect() });
        }
        let (ty, members) = extra_type(code)?;
        let number = |at: usize, i: usize| f64::from_le_bytes(eight(&raw[at + 8 * i..]));
        let attributes = (0..members).map(|i| {
            let usable = |bit: u8, value: f64, otherwise: f64| {
                if options >> bit & 1 == 1 && value.is_finite() { value } else { otherwise }
            };
            let scale = match usable(3, number(112, i), 1.0) {
                0.0 => 1.0,
                scale => scale,
            };
            let offset = usable(4, number(136, i), 0.0);
            Attribute {
                name: if members == 1 { name.clone() } else { format!("{name}[{i}]") },
                ty,
                scaling: (options & 0b1_1000 != 0).then_some(Scaling { scale, offset }),
                no_data: (options & 1 == 1).then(|| no_data(ty, eight(&raw[40 + 8 * i..]))),
                description: description.clone(),
            }
        });
        Some(Self { attributes: attributes.collect() })
    }

    /// Bytes of a record that it describes.
    pub fn bytes(&self) -> usize {
        self.attributes.iter().map(|a| a.ty.size()).sum()
    }
}

/// The descriptors of all extra-bytes VLRs, in the file's order.
pub fn descriptors(vlrs: &[RawVlr]) -> impl Iterator<Item = Option<ExtraBytes>> + '_ {
    vlrs.iter()
        .filter(|v| is_extra_bytes_vlr(v))
        .flat_map(|v| v.data.as_chunks::<DESCRIPTOR_BYTES>().0)
        .map(ExtraBytes::parse)
}

/// Cuts the extra-bytes VLRs after the last descriptor that is valid and fits into `room` bytes of a record. Gives the
/// number of bytes that are described then, and whether anything was cut.
pub fn cut_to_fit(vlrs: &mut Vec<RawVlr>, room: usize) -> (usize, bool) {
    let (mut described, mut cut) = (0, false);
    for vlr in vlrs.iter_mut().filter(|v| is_extra_bytes_vlr(v)) {
        let mut kept = 0;
        for raw in vlr.data.as_chunks::<DESCRIPTOR_BYTES>().0 {
            let bytes = ExtraBytes::parse(raw).map(|d| d.bytes()).filter(|b| described + b <= room && !cut);
            let Some(bytes) = bytes else {
                cut = true;
                break;
            };
            described += bytes;
            kept += DESCRIPTOR_BYTES;
        }
        if cut {
            vlr.data.truncate(kept);
        }
    }
    if cut {
        vlrs.retain(|v| !is_extra_bytes_vlr(v) || !v.data.is_empty());
    }
    (described, cut)
}

fn eight(bytes: &[u8]) -> [u8; 8] {
    std::array::from_fn(|i| bytes[i])
}

/// The descriptor holds a value of its type's widest relative; an attribute holds one of its own type.
fn no_data(ty: ScalarType, wide: [u8; 8]) -> [u8; 8] {
    // Some writers put the four bytes of an f32 there as they are; as an f64 that would be next to nothing.
    if ty != ScalarType::F32 || wide[4..] == [0; 4] {
        return wide;
    }
    let mut narrow = [0; 8];
    narrow[..4].copy_from_slice(&(f64::from_le_bytes(wide) as f32).to_le_bytes());
    narrow
}

/// Text up to the first zero byte, trimmed: UTF-8 if it is, else Latin-1; control characters become `_`.
pub(super) fn text(raw: &[u8]) -> String {
    let raw = raw.split(|&b| b == 0).next().unwrap_or_default();
    let text = match std::str::from_utf8(raw) {
        Ok(text) => text.to_owned(),
        Err(_) => raw.iter().map(|&b| char::from(b)).collect(),
    };
    text.trim().chars().map(|c| if c.is_control() { '_' } else { c }).collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A descriptor with the fields that matter here.
    pub fn descriptor(code: u8, options: u8, name: &str) -> [u8; DESCRIPTOR_BYTES] {
        let mut raw = [0; DESCRIPTOR_BYTES];
        (raw[2], raw[3]) = (code, options);
        raw[4..4 + name.len()].copy_from_slice(name.as_bytes());
        raw
    }

    /// An extra-bytes VLR.
    pub fn vlr(descriptors: &[[u8; DESCRIPTOR_BYTES]]) -> RawVlr {
        let mut user_id = [0; 16];
        user_id[..SPEC_USER_ID.len()].copy_from_slice(SPEC_USER_ID);
        let data = descriptors.concat();
        RawVlr { extended: false, user_id, record_id: EXTRA_BYTES_RECORD_ID, description: [0; 32], data }
    }

    #[test]
    fn members_have_their_own_scale_and_no_data() {
        let mut raw = descriptor(22 + 1, 0b1_1001, "rgb");
        for i in 0..3 {
            raw[40 + 8 * i..48 + 8 * i].copy_from_slice(&(i as u64 + 7).to_le_bytes());
            raw[112 + 8 * i..120 + 8 * i].copy_from_slice(&(i as f64).to_le_bytes());
            raw[136 + 8 * i..144 + 8 * i].copy_from_slice(&f64::NAN.to_le_bytes());
        }
        let attributes = ExtraBytes::parse(&raw).unwrap().attributes;
        assert_eq!(attributes.len(), 3);
        assert_eq!(attributes[2].name, "rgb[2]");
        assert_eq!(attributes[2].ty, ScalarType::U16);
        assert_eq!(attributes[2].no_data, Some(9_u64.to_le_bytes()));
        // A scale of zero and an offset that is no number would destroy the values.
        assert_eq!(attributes[0].scaling, Some(Scaling { scale: 1.0, offset: 0.0 }));
        assert_eq!(attributes[2].scaling, Some(Scaling { scale: 2.0, offset: 0.0 }));
    }

    #[test]
    fn no_data_of_a_float_comes_in_two_spellings() {
        let wide = no_data(ScalarType::F32, (-9999.0_f64).to_le_bytes());
        let mut raw = [0; 8];
        raw[..4].copy_from_slice(&(-9999.0_f32).to_le_bytes());
        assert_eq!(wide, raw);
        assert_eq!(no_data(ScalarType::F32, raw), raw);
    }

    #[test]
    fn what_does_not_fit_is_cut() {
        let two = vlr(&[descriptor(5, 0, "a"), descriptor(0, 3, "b")]);
        let mut vlrs = vec![two.clone(), vlr(&[descriptor(1, 0, "c")])];
        assert_eq!(cut_to_fit(&mut vlrs.clone(), 8), (8, false));
        assert_eq!(cut_to_fit(&mut vlrs, 6), (4, true));
        assert_eq!(descriptors(&vlrs).count(), 1);
        let mut reserved = vec![vlr(&[descriptor(1, 0, "c"), descriptor(31, 0, "d"), descriptor(1, 0, "e")])];
        assert_eq!(cut_to_fit(&mut reserved, 100), (1, true));
        assert_eq!(reserved[0].data.len(), DESCRIPTOR_BYTES);
    }

    #[test]
    fn text_is_tolerant() {
        assert_eq!(text(b" treeID \0junk"), "treeID");
        assert_eq!(text(&[0xe9, b'\n', b'a']), "é_a");
    }
}

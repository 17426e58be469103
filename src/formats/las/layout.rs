//! The layout of LAS records as they lie in the file: X, Y, Z, standard fields, extra bytes.

use super::extra::{self, ExtraBytes};
use super::tables::{PointFormat, XYZ_BYTES, is_las_dimension};
use crate::points::{Attribute, Field, FieldKind, LasFacts, PositionKind, RecordLayout, ScalarType};
use std::collections::{HashMap, HashSet};

/// The layout of the records of a file with these facts: what its reader gives and its writer must make again.
/// `None` if the facts name no known point format.
///
/// Extra bytes are named as [`unique_names`] says; bytes that nothing describes are `ExtraBytes[0]` and on, as `u8`.
pub fn record_layout(facts: &LasFacts) -> Option<RecordLayout> {
    let format = PointFormat::new(facts.point_format)?;
    let mut fields: Vec<(Attribute, Field)> = format
        .dimensions()
        .into_iter()
        .map(|d| (Attribute::new(d.name, d.ty), Field { offset: d.offset, kind: d.kind }))
        .collect();
    let described = extra::descriptors(&facts.vlrs).map_while(|d| d).flat_map(|ExtraBytes { attributes }| attributes);
    let undescribed = (0..facts.undescribed_bytes).map(|i| Attribute::new(format!("ExtraBytes[{i}]"), ScalarType::U8));
    let mut offset = format.record_bytes() - XYZ_BYTES;
    for attribute in unique_names(described.chain(undescribed)) {
        let field = Field { offset, kind: FieldKind::Whole };
        offset += attribute.ty.size();
        fields.push((attribute, field));
    }
    Some(RecordLayout::new(PositionKind::Grid, offset, fields))
}

/// Extra bytes under the names that they have in a store: `extra.NAME` for one that takes the name of a LAS dimension,
/// `NAME.2`, `NAME.3` for repeated names.
pub fn unique_names(attributes: impl IntoIterator<Item = Attribute>) -> Vec<Attribute> {
    let mut taken = HashSet::new();
    // Where the search for a free number goes on, or thousands of equal names would cost their square.
    let mut numbers: HashMap<String, usize> = HashMap::new();
    let unique = |mut attribute: Attribute| {
        if is_las_dimension(&attribute.name) {
            attribute.name = format!("extra.{}", attribute.name);
        }
        let number = numbers.entry(attribute.name.clone()).or_insert(0);
        let mut name = attribute.name.clone();
        *number += 1;
        while *number > 1 || taken.contains(&name) {
            name = format!("{}.{}", attribute.name, (*number).max(2));
            if !taken.contains(&name) {
                break;
            }
            *number += 1;
        }
        taken.insert(name.clone());
        attribute.name = name;
        attribute
    };
    attributes.into_iter().map(unique).collect()
}

#[cfg(test)]
mod tests {
    use super::super::extra::tests::{descriptor, vlr};
    use super::*;

    fn facts(point_format: u8, vlrs: Vec<crate::points::RawVlr>, undescribed_bytes: u16) -> LasFacts {
        LasFacts {
            version: (1, 4),
            point_format,
            scale: [0.01; 3],
            offset: [0.0; 3],
            global_encoding: 0,
            file_source_id: 0,
            guid: [0; 16],
            system_identifier: [0; 32],
            generating_software: [0; 32],
            vlrs,
            undescribed_bytes,
        }
    }

    #[test]
    fn standard_records_fill_their_layout() {
        for number in 0..=10 {
            let layout = record_layout(&facts(number, Vec::new(), 0)).unwrap();
            assert_eq!(layout.stride(), PointFormat::new(number).unwrap().record_bytes());
        }
        assert!(record_layout(&facts(11, Vec::new(), 0)).is_none());
    }

    #[test]
    fn extra_bytes_follow_under_unique_names() {
        let described = vlr(&[
            descriptor(5, 0, "Intensity"),
            descriptor(0, 2, "ExtraBytes"),
            descriptor(23, 0, "c"),
            descriptor(1, 0, "nir"),
            descriptor(1, 0, "x"),
            descriptor(2, 0, "x"),
        ]);
        let layout = record_layout(&facts(0, vec![described], 2)).unwrap();
        let field = |name: &str| {
            let i = layout.attributes.iter().position(|a| a.name == name).unwrap_or_else(|| panic!("no {name}"));
            (layout.attributes[i].ty, layout.fields[i].offset)
        };
        assert_eq!(field("Intensity"), (ScalarType::U16, 0));
        assert_eq!(field("extra.Intensity"), (ScalarType::U32, 8));
        assert_eq!(field("ExtraBytes[1]"), (ScalarType::U8, 13));
        assert_eq!(field("c[2]"), (ScalarType::U16, 18));
        assert_eq!(field("extra.nir"), (ScalarType::U8, 20));
        assert_eq!(field("x.2"), (ScalarType::I8, 22));
        assert_eq!(field("ExtraBytes[0].2"), (ScalarType::U8, 23));
        assert_eq!(layout.payload, 25);
    }
}

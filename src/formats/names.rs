//! What the properties and columns of files without LAS's dimensions are called.

use crate::points::{ScalarType, canonical_name, same_name, wider_type};
use std::collections::HashSet;

const COLOURS: [&str; 3] = ["Red", "Green", "Blue"];

/// PDAL's name where the property is that, by its name and, for colours, its type.
pub(super) fn attribute_name(name: &str, ty: ScalarType) -> String {
    // CloudCompare's PLY files say so of every scalar field.
    let dimension = name
        .strip_prefix("scalar_")
        .filter(|rest| canonical_name(rest).is_some_and(|c| same_name(c, rest) && !COLOURS.contains(&c)));
    let name = dimension.unwrap_or(name);
    let colour = |canonical: &str, old: &str| {
        let named = same_name(name, canonical) || name == old;
        (named && matches!(ty, ScalarType::U8 | ScalarType::U16)).then(|| canonical.to_owned())
    };
    let colours = [("Red", "diffuse_red"), ("Green", "diffuse_green"), ("Blue", "diffuse_blue")];
    if let Some(name) = colours.iter().find_map(|(canonical, old)| colour(canonical, old)) {
        return name;
    }
    let normals = [("nx", "NormalX"), ("ny", "NormalY"), ("nz", "NormalZ")];
    if let Some((_, canonical)) = normals.iter().find(|(short, _)| name.eq_ignore_ascii_case(short)) {
        return (*canonical).to_owned();
    }
    // Not by synonyms that may mean anything: `time`, a `class` that is no byte, angles in any unit. And colours of other types are
    // no LAS colours.
    let is_meant = |canonical: &&str| {
        same_name(canonical, name)
            || match *canonical {
                "GpsTime" | "ScanAngleRank" => false,
                "Classification" | "Infrared" => matches!(ty, ScalarType::U8 | ScalarType::U16),
                _ => true,
            }
    };
    let canonical = canonical_name(name).filter(|c| is_meant(c) && !colours.iter().any(|(c2, _)| c == c2));
    canonical.map_or_else(|| name.to_owned(), str::to_owned)
}

/// `name`, or else the source's name, or that with a number: none that has been taken with this type, or with one that
/// becomes one column with it where scans meet, such as a colour of 8 bits beside one of 16.
pub(super) fn unique(name: String, source: &str, ty: ScalarType, taken: &mut HashSet<(String, ScalarType)>) -> String {
    let numbered = (2..).map(|n: u64| format!("{source}.{n}"));
    let mut free = [name, source.to_owned()].into_iter().chain(numbered).filter(|n| {
        let kind = wider_type(n, ty).unwrap_or(ty);
        taken.insert((n.clone(), kind))
    });
    free.next().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An answer has one column for both kinds, and added them up.
    #[test]
    fn no_scan_has_two_attributes_that_become_one() {
        let mut taken = HashSet::new();
        let mut name = |source: &str, ty| unique(attribute_name(source, ty), source, ty, &mut taken);
        assert_eq!(name("red", ScalarType::U8), "Red");
        assert_eq!(name("Red", ScalarType::U16), "Red.2");
        assert_eq!(name("diffuse_red", ScalarType::U8), "diffuse_red");
        assert_eq!(name("scalar_ScanAngleRank", ScalarType::I16), "ScanAngleRank");
        assert_eq!(name("ScanAngleRank", ScalarType::I8), "ScanAngleRank.2");
        assert_eq!(name("Class", ScalarType::U8), "Classification");
        assert_eq!(name("class", ScalarType::F32), "class");
        assert_eq!(name("num_returns", ScalarType::U8), "NumberOfReturns");
        assert_eq!(name("time", ScalarType::F64), "time");
        // These never do.
        assert_eq!((name("v", ScalarType::U8), name("v", ScalarType::U16)), ("v".into(), "v".into()));
    }
}

//! What the properties and columns of files without LAS's dimensions are called.

use crate::points::{ScalarType, canonical_name, same_name, wider_type};
use std::collections::HashSet;

const COLOURS: [&str; 3] = ["Red", "Green", "Blue"];

/// The dimension of LAS that a file's name means, whatever its case, blanks and underscores; by a synonym, too.
pub(super) fn dimension(name: &str) -> Option<&'static str> {
    canonical_name(&name.replace(' ', "_"))
}

/// PDAL's name where the property is called so, but for case, blanks and underscores, and, for colours, is of their type.
pub(super) fn attribute_name(name: &str, ty: ScalarType) -> String {
    let name = bare(name);
    let is_called = |canonical: &str| same_name(&name.replace(' ', "_"), canonical);
    let colour = |canonical: &str, old: &str| {
        let named = is_called(canonical) || name == old;
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
    // Colours of other types are no LAS colours.
    let canonical = dimension(name).filter(|c| is_called(c) && !COLOURS.contains(c));
    canonical.map_or_else(|| name.to_owned(), str::to_owned)
}

/// Without what CloudCompare's PLY files put before every scalar field, where a dimension is behind it.
fn bare(name: &str) -> &str {
    let is_dimension =
        |rest: &&str| dimension(rest).is_some_and(|c| same_name(c, &rest.replace(' ', "_")) && !COLOURS.contains(&c));
    name.strip_prefix("scalar_").filter(is_dimension).unwrap_or(name)
}

/// Names for all properties of a file, by synonyms, too (`Class`, `NumReturns`), where none is called exactly what they mean.
pub(super) struct Namer {
    /// What properties are called exactly.
    exact: HashSet<&'static str>,
}

impl Namer {
    /// For the properties of these names.
    pub fn of<'n>(names: impl IntoIterator<Item = &'n str>) -> Self {
        let exact = |name: &'n str| {
            let name = bare(name);
            dimension(name).filter(|c| same_name(c, &name.replace(' ', "_")))
        };
        Self { exact: names.into_iter().filter_map(exact).collect() }
    }

    /// PDAL's name where the property means that, else its own. Not by synonyms that may mean anything: `time`, a `class` that is no
    /// byte, angles in any unit.
    pub fn name(&self, name: &str, ty: ScalarType) -> String {
        let own = attribute_name(name, ty);
        let is_meant = |canonical: &&str| match *canonical {
            "GpsTime" | "ScanAngleRank" | "Red" | "Green" | "Blue" => false,
            "Classification" | "Infrared" => matches!(ty, ScalarType::U8 | ScalarType::U16),
            _ => true,
        };
        match dimension(name).filter(|c| own == name && is_meant(c) && !self.exact.contains(c)) {
            Some(canonical) => canonical.to_owned(),
            None => own,
        }
    }
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
        let namer = Namer::of(["red", "scalar_ScanAngleRank"]);
        let mut name = |source: &str, ty| unique(namer.name(source, ty), source, ty, &mut taken);
        assert_eq!(name("red", ScalarType::U8), "Red");
        assert_eq!(name("Red", ScalarType::U16), "Red.2");
        assert_eq!(name("diffuse_red", ScalarType::U8), "diffuse_red");
        assert_eq!(name("scalar_ScanAngleRank", ScalarType::I16), "ScanAngleRank");
        assert_eq!(name("ScanAngleRank", ScalarType::I8), "ScanAngleRank.2");
        assert_eq!(name("Class", ScalarType::U8), "Classification");
        assert_eq!(name("class", ScalarType::F32), "class");
        assert_eq!(name("num_returns", ScalarType::U8), "NumberOfReturns");
        assert_eq!(name("time", ScalarType::F64), "time");
        assert_eq!(name("Point Source ID", ScalarType::U16), "PointSourceId");
        // What a file calls exactly so goes before a synonym, whichever comes first.
        let namer = Namer::of(["class", "scalar_Classification", "NumReturns"]);
        assert_eq!(namer.name("class", ScalarType::U8), "class");
        assert_eq!(namer.name("NumReturns", ScalarType::U8), "NumberOfReturns");
        // These never do.
        assert_eq!((name("v", ScalarType::U8), name("v", ScalarType::U16)), ("v".into(), "v".into()));
    }
}

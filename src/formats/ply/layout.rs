//! From the properties of a vertex to the layout of a record.

use super::header::{Element, Kind};
use crate::points::{Attribute, Field, FieldKind, PositionKind, RecordLayout, ScalarType, canonical_name, same_name};
use std::collections::HashSet;

/// Where a property's value goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// A coordinate, as `f64`: 0, 1, 2 for x, y, z.
    Axis(usize),
    /// An attribute, at this byte of the record.
    Record(usize),
    /// Nowhere: a list.
    Skip,
}

/// The layout of the records of `vertex`, and the target of each of its properties; `None` without x, y and z.
pub fn record_layout(vertex: &Element) -> Option<(RecordLayout, Vec<Target>)> {
    let scalars = || vertex.properties.iter().enumerate().filter(|(_, p)| matches!(p.kind, Kind::Scalar(_)));
    let axis = |name: &str| {
        let exact = scalars().find(|(_, p)| p.name == name);
        exact.or_else(|| scalars().find(|(_, p)| p.name.eq_ignore_ascii_case(name))).map(|(i, _)| i)
    };
    let axes = [axis("x")?, axis("y")?, axis("z")?];
    let start = PositionKind::World.size();
    let mut end = start;
    let mut taken = HashSet::new();
    let mut fields = Vec::new();
    let mut targets = Vec::with_capacity(vertex.properties.len());
    for (i, property) in vertex.properties.iter().enumerate() {
        let Kind::Scalar(ty) = property.kind else {
            targets.push(Target::Skip);
            continue;
        };
        if let Some(axis) = axes.iter().position(|&a| a == i) {
            targets.push(Target::Axis(axis));
            continue;
        }
        let name = unique(attribute_name(&property.name, ty), &property.name, ty, &mut taken);
        fields.push((Attribute::new(name, ty), Field { offset: end - start, kind: FieldKind::Whole }));
        targets.push(Target::Record(end));
        end += ty.size();
    }
    Some((RecordLayout::new(PositionKind::World, end - start, fields), targets))
}

/// PDAL's name where the property is that, by its name and, for colours, its type.
fn attribute_name(name: &str, ty: ScalarType) -> String {
    let colour = |canonical: &str, old: &str| {
        let named = same_name(name, canonical) || name == old;
        (named && matches!(ty, ScalarType::U8 | ScalarType::U16)).then(|| canonical.to_owned())
    };
    let colours = [("Red", "diffuse_red"), ("Green", "diffuse_green"), ("Blue", "diffuse_blue")];
    if let Some(name) = colours.iter().find_map(|(canonical, old)| colour(canonical, old)) {
        return name;
    }
    let normals = [("nx", "NormalX"), ("ny", "NormalY"), ("nz", "NormalZ")];
    if let Some((_, canonical)) = normals.iter().find(|(short, _)| *short == name) {
        return (*canonical).to_owned();
    }
    // Not by synonyms: `time` or `class` may mean anything. And colours of other types are no LAS colours.
    let canonical = canonical_name(name).filter(|c| same_name(c, name) && !colours.iter().any(|(c2, _)| c == c2));
    canonical.map_or_else(|| name.to_owned(), str::to_owned)
}

/// `name`, or else the source's name, or that with a number: none that has been taken with this type.
fn unique(name: String, source: &str, ty: ScalarType, taken: &mut HashSet<(String, ScalarType)>) -> String {
    let numbered = (2..).map(|n: u64| format!("{source}.{n}"));
    let mut free = [name, source.to_owned()].into_iter().chain(numbered).filter(|n| taken.insert((n.clone(), ty)));
    free.next().unwrap_or_default()
}

//! From the properties of a vertex to the layout of a record.

use super::header::{Element, Kind};
use crate::formats::names::{Namer, unique};
use crate::points::{Attribute, Field, FieldKind, PositionKind, RecordLayout};
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
    let namer = Namer::of(vertex.properties.iter().map(|p| p.name.as_str()));
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
        let name = unique(namer.name(&property.name, ty), &property.name, ty, &mut taken);
        fields.push((Attribute::new(name, ty), Field { offset: end - start, kind: FieldKind::Whole }));
        targets.push(Target::Record(end));
        end += ty.size();
    }
    Some((RecordLayout::new(PositionKind::World, end - start, fields), targets))
}

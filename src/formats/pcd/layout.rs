//! From the fields of a point to the layout of a record.

use super::header::PcdField;
use crate::formats::names::{Namer, unique};
use crate::formats::ply::{Element, Kind, Property, Target};
use crate::formats::text::Cell;
use crate::points::{Attribute, Field, FieldKind, PositionKind, RecordLayout, ScalarType};
use std::collections::HashSet;

/// How points become records.
#[derive(Debug)]
pub struct Fields {
    pub layout: RecordLayout,
    /// The values of a binary point, one property each; a packed colour is four bytes.
    pub element: Element,
    /// Where each of those goes.
    pub targets: Vec<Target>,
    /// Where each word of a text row goes.
    pub cells: Vec<Cell>,
}

struct Builder {
    end: usize,
    taken: HashSet<(String, ScalarType)>,
    fields: Vec<(Attribute, Field)>,
    namer: Namer,
    properties: Vec<Property>,
    targets: Vec<Target>,
    cells: Vec<Cell>,
}

impl Builder {
    /// A value of the binary point.
    fn value(&mut self, ty: ScalarType, target: Target) {
        self.properties.push(Property { name: String::new(), kind: Kind::Scalar(ty) });
        self.targets.push(target);
    }

    /// Room for an attribute: its byte in the record.
    fn attribute(&mut self, name: &str, ty: ScalarType) -> usize {
        let start = PositionKind::World.size();
        let canonical = unique(self.namer.name(name, ty), name, ty, &mut self.taken);
        let at = self.end;
        self.end += ty.size();
        let field = Field { offset: at - start, kind: FieldKind::Whole };
        self.fields.push((Attribute::new(canonical, ty), field));
        at
    }
}

impl Fields {
    /// For these fields; `None` without x, y and z.
    pub fn new(fields: &[PcdField]) -> Option<Self> {
        let axis = |name: &str| fields.iter().position(|f| f.count == 1 && f.name.eq_ignore_ascii_case(name));
        let axes = [axis("x")?, axis("y")?, axis("z")?];
        let mut builder = Builder {
            end: PositionKind::World.size(),
            taken: HashSet::new(),
            fields: Vec::new(),
            namer: Namer::of(fields.iter().map(|f| f.name.as_str())),
            properties: Vec::new(),
            targets: Vec::new(),
            cells: Vec::new(),
        };
        for (i, field) in fields.iter().enumerate() {
            let PcdField { name, ty, count } = field;
            if let Some(axis) = axes.iter().position(|&a| a == i) {
                builder.value(*ty, Target::Axis(axis));
                builder.cells.push(Cell::Axis(axis));
            } else if name == "_" {
                for _ in 0..*count {
                    builder.value(*ty, Target::Skip);
                    builder.cells.push(Cell::Skip);
                }
            } else if matches!(&**name, "rgb" | "rgba") && ty.size() == 4 && *count == 1 {
                // 0xAARRGGBB, in the bits of a float or an integer; alpha means something in `rgba` alone.
                let [red, green, blue] = ["Red", "Green", "Blue"].map(|n| builder.attribute(n, ScalarType::U8));
                let alpha = (name == "rgba").then(|| builder.attribute("Alpha", ScalarType::U8));
                let places = [Some(blue), Some(green), Some(red), alpha];
                for place in places {
                    builder.value(ScalarType::U8, place.map_or(Target::Skip, Target::Record));
                }
                builder.cells.push(Cell::Packed(places, ty.is_float()));
            } else {
                for member in 0..*count {
                    let name = if *count == 1 { name.clone() } else { format!("{name}[{member}]") };
                    let at = builder.attribute(&name, *ty);
                    builder.value(*ty, Target::Record(at));
                    builder.cells.push(Cell::Value(at, *ty));
                }
            }
        }
        let Builder { end, fields, properties, targets, cells, .. } = builder;
        let layout = RecordLayout::new(PositionKind::World, end - PositionKind::World.size(), fields);
        let element = Element { name: String::new(), count: 0, properties };
        Some(Self { layout, element, targets, cells })
    }
}

//! One column of an attribute that scans have with different scales, offsets or no-data values.
//!
//! Where only the no-data values differ, stored values stay as they are, and one value that is no valid one of any scan
//! means "no data" in all. Else the column has the real values as `f64`: of integers those nearest to the exact decimals;
//! NaN is "no data" there. Integers that an `f64` does not hold are not joined.
//!
//! Points whose scan has no such attribute have no data in such a column, nor in one of a single scaling or no-data value: what is
//! stored for them, 0, would be some height or other.

use crate::points::{Attribute, Column, Real, ScalarType};
use crate::store::Snapshot;
use crate::store::model::{Range, ScanId, Slot, Zones};
use std::sync::Arc;

/// One of the attributes that are joined.
pub(super) struct Member<'a> {
    /// Its column.
    pub column: usize,
    pub attribute: &'a Attribute,
    /// The contributing scans that have it, ascending.
    pub scans: Vec<ScanId>,
}

/// How the column is made.
#[derive(Clone, Debug)]
pub(super) struct Joined {
    ty: ScalarType,
    no_data: Option<[u8; 8]>,
    parts: Vec<Part>,
}

/// What one of the attributes gives to it.
#[derive(Clone, Debug)]
struct Part {
    column: usize,
    scans: Vec<ScanId>,
    no_data: Option<[u8; 8]>,
    /// How real values are made; `None`: they are kept as they are stored.
    real: Option<Real>,
}

/// The column of these attributes, of one name and one type; `None` if one column cannot hold their values. `lacking`: there
/// are scans that have none of them.
pub(super) fn joined(snapshot: &Snapshot, members: &[&Member<'_>], lacking: bool) -> Option<(Attribute, Joined)> {
    let ranges = Ranges::of(snapshot);
    let first = members.first()?.attribute;
    let all_have = |same: &dyn Fn(&Attribute) -> bool| members.iter().all(|m| same(m.attribute));
    let is_needed = lacking && first.real_scaling().is_some();
    let stored = all_have(&|a| a.real_scaling() == first.real_scaling())
        .then(|| one_no_data(members, is_needed, &ranges))
        .flatten();
    let ty = if stored.is_some() { first.ty } else { ScalarType::F64 };
    if stored.is_none() && !members.iter().all(|m| ranges.fit_f64(m.attribute)) {
        return None;
    }
    let has_no_data = lacking || members.iter().any(|m| m.attribute.no_data.is_some());
    let no_data = stored.unwrap_or_else(|| has_no_data.then(|| f64::NAN.to_le_bytes()));
    let part = |m: &&Member<'_>| Part {
        column: m.column,
        scans: m.scans.clone(),
        no_data: m.attribute.no_data_bytes(),
        real: stored.is_none().then(|| Real::new(m.attribute.scaling)),
    };
    let attribute = Attribute {
        name: first.name.clone(),
        ty,
        scaling: if stored.is_some() { first.real_scaling() } else { None },
        no_data,
        description: if all_have(&|a| a.description == first.description) {
            first.description.clone()
        } else {
            String::new()
        },
    };
    Some((attribute, Joined { ty, no_data, parts: members.iter().map(part).collect() }))
}

/// A no-data value for all, if there is one that is no valid value of any; `Some(None)` if none has one and none is needed.
fn one_no_data(members: &[&Member<'_>], is_needed: bool, ranges: &Ranges) -> Option<Option<[u8; 8]>> {
    let own = |m: &&Member<'_>| m.attribute.no_data_bytes();
    let ty = members.first()?.attribute.ty;
    if members.iter().all(|m| own(m) == own(&members[0])) && (own(&members[0]).is_some() || !is_needed) {
        return Some(own(&members[0]));
    }
    let free =
        |value: &[u8; 8]| members.iter().all(|m| own(m) == Some(*value) || !ranges.may_hold(m.attribute, *value));
    members.iter().filter_map(own).chain(extremes(ty)).find(free).map(Some)
}

/// What hardly is a valid value.
fn extremes(ty: ScalarType) -> [[u8; 8]; 2] {
    let mut column = Column::with_capacity(ty, 2);
    match &mut column {
        Column::U8(v) => v.extend([u8::MAX, 0]),
        Column::U16(v) => v.extend([u16::MAX, 0]),
        Column::U32(v) => v.extend([u32::MAX, 0]),
        Column::U64(v) => v.extend([u64::MAX, 0]),
        Column::I8(v) => v.extend([i8::MIN, i8::MAX]),
        Column::I16(v) => v.extend([i16::MIN, i16::MAX]),
        Column::I32(v) => v.extend([i32::MIN, i32::MAX]),
        Column::I64(v) => v.extend([i64::MIN, i64::MAX]),
        Column::F32(v) => v.extend([f32::MIN, f32::MAX]),
        Column::F64(v) => v.extend([f64::MIN, f64::MAX]),
    }
    [column.raw(0), column.raw(1)]
}

/// What values there are in the store, by its zone maps.
struct Ranges {
    slots: Vec<(Slot, Attribute)>,
    /// Of the root of each layer; `None` if they can't be read: then any value may be there.
    zones: Option<Vec<Arc<Zones>>>,
}

impl Ranges {
    fn of(snapshot: &Snapshot) -> Self {
        let nodes = snapshot.nodes();
        let zones = nodes.roots().and_then(|roots| roots.iter().map(|root| nodes.zones(root)).collect());
        let slots = snapshot.attributes().iter().map(|a| (a.id, a.attribute.clone())).collect();
        Self { slots, zones: zones.ok() }
    }

    /// The ranges of an attribute; `None` if they are not known.
    fn of_attribute(&self, attribute: &Attribute) -> Option<impl Iterator<Item = Range>> {
        let slot = self.slots.iter().find(|(_, a)| a.identity() == attribute.identity())?.0;
        let find = move |zones: &Arc<Zones>| {
            let found = zones.subtree.binary_search_by_key(&slot, |z| z.0).ok()?;
            Some(zones.subtree[found].1)
        };
        Some(self.zones.as_ref()?.iter().filter_map(find))
    }

    /// Can a point have this stored value?
    fn may_hold(&self, attribute: &Attribute, value: [u8; 8]) -> bool {
        let mut one = Column::with_capacity(attribute.ty, 1);
        one.push_raw(value);
        let (integer, float) = (one.as_integer(0).unwrap_or(0), one.as_f64(0));
        let holds = |range| match range {
            Range::OnlyNan => float.is_nan(),
            Range::Unsigned(least, greatest) => (i128::from(least)..=i128::from(greatest)).contains(&integer),
            Range::Signed(least, greatest) => (i128::from(least)..=i128::from(greatest)).contains(&integer),
            Range::Float(least, greatest) => float.is_nan() || (least..=greatest).contains(&float),
        };
        self.of_attribute(attribute).is_none_or(|mut ranges| ranges.any(holds))
    }

    /// Is every stored value an `f64`?
    fn fit_f64(&self, attribute: &Attribute) -> bool {
        const MOST: u64 = 1 << 53;
        let fits = |range| match range {
            Range::Unsigned(_, greatest) => greatest <= MOST,
            Range::Signed(least, greatest) => least.unsigned_abs().max(greatest.unsigned_abs()) <= MOST,
            Range::OnlyNan | Range::Float(..) => true,
        };
        !matches!(attribute.ty, ScalarType::U64 | ScalarType::I64)
            || self.of_attribute(attribute).is_some_and(|mut ranges| ranges.all(fits))
    }
}

impl Joined {
    /// The columns that it is made of, in the order in which [`Joined::column`] takes them.
    pub fn columns(&self) -> impl Iterator<Item = usize> {
        self.parts.iter().map(|part| part.column)
    }

    /// Its values, from these columns and the scan of each point; where a point's scan has none no data, or zero if there is no
    /// value for that.
    pub fn column(&self, columns: &[Column], scans: &[ScanId]) -> Column {
        let mut out = Column::with_capacity(self.ty, scans.len());
        for run in scans.chunk_by(|a, b| a == b) {
            let start = out.len();
            let found = self.parts.iter().zip(columns).find(|(part, _)| part.scans.binary_search(&run[0]).is_ok());
            let Some((part, column)) = found else {
                match self.no_data {
                    Some(no_data) => run.iter().for_each(|_| out.push_raw(no_data)),
                    None => out.resize(start + run.len()),
                }
                continue;
            };
            for i in start..start + run.len() {
                match (self.no_data, &part.real, &mut out) {
                    (Some(no_data), ..) if part.no_data == Some(column.raw(i)) => out.push_raw(no_data),
                    (_, Some(real), Column::F64(out)) => out.push(real.value(column, i)),
                    (_, _, out) => out.push_from(column, i),
                }
            }
        }
        out
    }

    /// What a user should know of it.
    pub fn note(&self, attribute: &Attribute) -> Option<String> {
        let name = &attribute.name;
        if let [only] = self.parts.as_slice() {
            let real = || format!("{name}: real values (f64), since no stored value is free to mean \"no data\"");
            return only.real.is_some().then(real);
        }
        Some(match (self.parts.iter().any(|p| p.real.is_some()), attribute.no_data_value()) {
            (true, Some(_)) => {
                format!("{name} is scaled in different ways: real values (f64), NaN where there is no data")
            }
            (true, None) => format!("{name} is scaled in different ways: real values (f64)"),
            (false, Some(value)) => format!("{name} has several no-data values: one for all, {value} as it is stored"),
            (false, None) => format!("{name} is described in different ways and has one column"),
        })
    }
}

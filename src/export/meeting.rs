//! One column of each attribute where scans have it in several kinds: colours of 8 and of 16 bits, scan angles in degrees
//! and in finer steps, and values with another scale, offset or no-data value (`joined.rs`).
//!
//! Whoever looks at the points of several scans together wants one column of each, as merged LAS files have it.

use super::joined::{Joined, Member, joined};
use crate::points::{Attribute, Batch, Column, Identity, ScalarType, angle_steps};
use crate::query::OutputForm;
use crate::query::kinds::{DEEPER, Kinds, has_depth, may_be_narrower, wider};
use crate::store::Snapshot;
use crate::store::model::{Scan, ScanId, Slot};
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

/// What is done where kinds meet.
#[derive(Clone, Debug)]
pub struct Meeting {
    /// What batches have then, in this order.
    pub attributes: Arc<[Attribute]>,
    /// What a user should know.
    pub notes: Vec<String>,
    /// How each of them is made of the columns that are there before.
    made: Vec<Made>,
    /// What each of them is made of, as scans have it.
    kinds: Vec<Vec<Attribute>>,
    /// The scans whose colours have 8 bits in fields of 16 and are to be brought to 16, ascending.
    brighten: Vec<ScanId>,
}

/// How a column is made.
#[derive(Clone, Debug)]
enum Made {
    /// It is there.
    Kept(usize),
    /// A narrow kind is added to the wide one: each point has one of the two, and zero in the other.
    Widened { narrow: usize, wide: usize },
    /// Each point has the value of its scan's column.
    Joined(Joined),
}

impl Meeting {
    /// For an answer of this form.
    pub fn of(snapshot: &Snapshot, form: &OutputForm) -> Self {
        let there = There::of(snapshot, form);
        let mut columns = Columns::default();
        // Canonical order: those of one name and type are neighbours.
        let mut first = 0;
        for same in there.all.chunk_by(|a, b| (&a.name, a.ty) == (&b.name, b.ty)) {
            let members = there.members(first, same);
            first += same.len();
            let present: Vec<&Member<'_>> = members.iter().filter(|m| !m.scans.is_empty()).collect();
            let becomes_wider = |wide: usize| there.has(wide) || present.is_empty();
            if there.wider(&same[0]).is_some_and(becomes_wider) {
                continue;
            }
            match (there.narrower(&same[0]), present.as_slice()) {
                (Some(_), []) => {}
                (Some(narrow), [wide, ..]) => columns.widen(narrow, &there.all[narrow], wide),
                (None, []) => members.iter().take(1).for_each(|one| columns.keep(one)),
                (None, [one]) if !there.lack(one) => columns.keep(one),
                (None, some) => columns.join(snapshot, some, there.lack_all(some)),
            }
        }
        let Columns { attributes, made, kinds, mut notes } = columns;
        let brighten = Kinds::of(snapshot, &form.scans).brightened().to_vec();
        let is_there = |a: &Attribute| a.ty == ScalarType::U16 && has_depth(a);
        if !brighten.is_empty() && attributes.iter().any(is_there) {
            notes.push(
                "colours of 8 and of 16 bits meet, in their values or their fields: all are written with 16".to_owned(),
            );
        }
        Self { attributes: attributes.into(), notes, made, kinds, brighten }
    }

    /// Must it be known which scan a point is of?
    pub fn needs_scans(&self) -> bool {
        !self.brighten.is_empty() || self.made.iter().any(|m| matches!(m, Made::Joined(_)))
    }

    /// The attributes, as scans have them, that the answer's `attribute` holds.
    pub fn kinds<'m>(&'m self, attribute: &'m Attribute) -> impl Iterator<Item = &'m Attribute> {
        let found = self.attributes.iter().position(|a| a == attribute);
        found.map_or(std::slice::from_ref(attribute), |i| &self.kinds[i]).iter()
    }

    /// Makes the points of a batch what the answer has.
    pub fn apply(&self, batch: &mut Batch) {
        if !self.brighten.is_empty() {
            self.brighten(batch);
        }
        let unchanged = |(i, made): (usize, &Made)| matches!(made, Made::Kept(column) if *column == i);
        if self.made.len() == batch.columns.len() && self.made.iter().enumerate().all(unchanged) {
            return;
        }
        let mut before = std::mem::take(&mut batch.columns);
        let mut take = |column: usize| std::mem::replace(&mut before[column], Column::U8(Vec::new()));
        let make = |made: &Made| match made {
            Made::Kept(column) => take(*column),
            Made::Widened { narrow, wide } => widened(&take(*narrow), take(*wide)),
            Made::Joined(joined) => {
                let columns: Vec<Column> = joined.columns().map(&mut take).collect();
                joined.column(&columns, &batch.scans)
            }
        };
        batch.columns = self.made.iter().map(make).collect();
        batch.attributes = self.attributes.clone();
    }

    fn brighten(&self, batch: &mut Batch) {
        for (attribute, column) in batch.attributes.iter().zip(&mut batch.columns) {
            if let (true, Column::U16(values)) = (has_depth(attribute), column) {
                for (value, scan) in values.iter_mut().zip(&batch.scans) {
                    if self.brighten.binary_search(scan).is_ok() {
                        *value = value.saturating_mul(DEEPER);
                    }
                }
            }
        }
    }
}

/// What the scans of an answer have.
struct There<'a> {
    slots: HashMap<Identity<'a>, Slot>,
    all: &'a [Attribute],
    scans: Vec<&'a Scan>,
    /// What each of the scans has.
    have: Vec<HashSet<Slot>>,
}

impl<'a> There<'a> {
    fn of(snapshot: &'a Snapshot, form: &'a OutputForm) -> Self {
        let scans: Vec<&Scan> = form.scans.iter().filter_map(|&id| snapshot.scan(id)).collect();
        let slots = snapshot.attributes().iter().map(|s| (s.attribute.identity(), s.id)).collect();
        let have = scans.iter().map(|s| s.attributes.iter().copied().collect()).collect();
        Self { slots, all: &form.attributes, scans, have }
    }

    /// The scans that have the attribute, ascending.
    fn having(&self, attribute: &Attribute) -> Vec<ScanId> {
        let Some(slot) = self.slots.get(&attribute.identity()) else { return Vec::new() };
        let having = self.scans.iter().zip(&self.have).filter(|(_, has)| has.contains(slot));
        having.map(|(scan, _)| scan.id).collect()
    }

    /// Has a scan the attribute of this column?
    fn has(&self, column: usize) -> bool {
        !self.having(&self.all[column]).is_empty()
    }

    /// Do some scans lack this attribute, whose points then have no data and not 0?
    fn lack(&self, one: &Member<'_>) -> bool {
        let attribute = one.attribute;
        (attribute.no_data.is_some() || attribute.real_scaling().is_some()) && self.lack_all(&[one])
    }

    /// Do some scans have none of these attributes?
    fn lack_all(&self, members: &[&Member<'_>]) -> bool {
        self.scans.iter().any(|s| members.iter().all(|m| m.scans.binary_search(&s.id).is_err()))
    }

    /// Neighbouring attributes, from column `first` on, with their columns and scans.
    fn members(&self, first: usize, same: &'a [Attribute]) -> Vec<Member<'a>> {
        let member = |(column, attribute)| Member { column, attribute, scans: self.having(attribute) };
        (first..).zip(same).map(member).collect()
    }

    /// The column of the kind that this one is brought to.
    fn wider(&self, attribute: &Attribute) -> Option<usize> {
        let (ty, _) = wider(attribute)?;
        self.all.iter().position(|a| a.name == attribute.name && a.ty == ty)
    }

    /// The column of the kind that is brought to this one, if a scan has it.
    fn narrower(&self, attribute: &Attribute) -> Option<usize> {
        if !matches!(attribute.ty, ScalarType::U16 | ScalarType::I16) || !may_be_narrower(attribute) {
            return None;
        }
        let is_narrower = |a: &Attribute| wider(a).is_some_and(|(ty, _)| ty == attribute.ty);
        let column = self.all.iter().position(|a| a.name == attribute.name && is_narrower(a))?;
        self.has(column).then_some(column)
    }
}

/// The columns that come out, as they are found.
#[derive(Default)]
struct Columns {
    attributes: Vec<Attribute>,
    made: Vec<Made>,
    kinds: Vec<Vec<Attribute>>,
    notes: Vec<String>,
}

impl Columns {
    fn put(&mut self, attribute: &Attribute, made: Made, kinds: Vec<Attribute>) {
        self.attributes.push(attribute.clone());
        self.made.push(made);
        self.kinds.push(kinds);
    }

    /// As it is.
    fn keep(&mut self, one: &Member<'_>) {
        self.put(one.attribute, Made::Kept(one.column), vec![one.attribute.clone()]);
    }

    /// A narrow kind and a wide one as the wide one.
    fn widen(&mut self, narrow: usize, attribute: &Attribute, wide: &Member<'_>) {
        let name = &attribute.name;
        self.notes.push(match attribute.ty {
            ScalarType::U8 => format!("{name} of 8 bits became 16 bits: times {DEEPER}"),
            _ => format!("{name} in whole degrees became steps of 0.006 degrees, rounded"),
        });
        let kinds = vec![wide.attribute.clone(), attribute.clone()];
        self.put(wide.attribute, Made::Widened { narrow, wide: wide.column }, kinds);
    }

    /// Several scalings and no-data values as one, or each for itself where one column can't hold them.
    fn join(&mut self, snapshot: &Snapshot, several: &[&Member<'_>], lacking: bool) {
        if let Some((attribute, column)) = joined(snapshot, several, lacking) {
            let kinds = several.iter().map(|m| m.attribute.clone()).collect();
            self.notes.extend(column.note(&attribute));
            self.put(&attribute, Made::Joined(column), kinds);
            return;
        }
        if let [one] = several {
            return self.keep(one);
        }
        let name = several.first().map_or("", |m| &m.attribute.name);
        self.notes.push(format!(
            "{name} has another scale, offset or no-data value in some scans, and too many digits to be one column: each kind \
             has its own"
        ));
        for one in several {
            // Whatever is joined, the points of the other scans have none of it.
            if one.attribute.no_data.is_some() { self.join(snapshot, &[one], true) } else { self.keep(one) }
        }
    }
}

fn widened(narrow: &Column, mut wide: Column) -> Column {
    match (narrow, &mut wide) {
        (Column::U8(narrow), Column::U16(wide)) => {
            wide.iter_mut().zip(narrow).for_each(|(w, &n)| *w = w.wrapping_add(u16::from(n) * DEEPER));
        }
        (Column::I8(narrow), Column::I16(wide)) => {
            wide.iter_mut().zip(narrow).for_each(|(w, &n)| *w = w.wrapping_add(angle_steps(n)));
        }
        _ => {}
    }
    wide
}

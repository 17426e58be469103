//! One column of each attribute where scans have it in several kinds: colours of 8 and of 16 bits, scan angles in degrees
//! and in finer steps, and values with another scale, offset or no-data value (`joined.rs`).
//!
//! Whoever looks at the points of several scans together wants one column of each, as merged LAS files have it.

use super::joined::{Joined, Member, joined};
use crate::points::{Attribute, Batch, Column, ScalarType, angle_steps};
use crate::query::OutputForm;
use crate::query::kinds::{DEEPER, Kinds, is_color, wider};
use crate::store::Snapshot;
use crate::store::model::{Scan, ScanId};
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
        let all = &form.attributes;
        let scans: Vec<&Scan> = form.scans.iter().filter_map(|&id| snapshot.scan(id)).collect();
        let having = |a: &Attribute| -> Vec<ScanId> {
            let slot = snapshot.attributes().iter().find(|s| s.attribute.identity() == a.identity()).map(|s| s.id);
            let has = |s: &&&Scan| slot.is_some_and(|slot| s.attributes.contains(&slot));
            scans.iter().filter(has).map(|s| s.id).collect()
        };
        let mut meeting = Self {
            attributes: Arc::new([]),
            notes: Vec::new(),
            made: Vec::new(),
            kinds: Vec::new(),
            brighten: Vec::new(),
        };
        let mut attributes = Vec::with_capacity(all.len());
        let mut put = |meeting: &mut Self, attribute: &Attribute, made: Made, kinds: Vec<Attribute>| {
            attributes.push(attribute.clone());
            meeting.made.push(made);
            meeting.kinds.push(kinds);
        };
        // Canonical order: those of one name and type are neighbours.
        for same in all.chunk_by(|a, b| (&a.name, a.ty) == (&b.name, b.ty)) {
            let first = all.iter().position(|a| a.identity() == same[0].identity()).unwrap_or(0);
            let there: Vec<Member<'_>> = (first..)
                .zip(same)
                .map(|(column, attribute)| Member { column, attribute, scans: having(attribute) })
                .collect();
            let present: Vec<&Member<'_>> = there.iter().filter(|m| !m.scans.is_empty()).collect();
            // The narrower or wider kind of the same, and whether a scan has it.
            let other = |other: &dyn Fn(&Attribute) -> bool| {
                let column = all.iter().position(|a| a.name == same[0].name && other(a))?;
                Some((column, !having(&all[column]).is_empty()))
            };
            let is_wider = |a: &Attribute| wider(&same[0]).is_some_and(|(ty, _)| a.ty == ty);
            let is_narrower = |a: &Attribute| wider(a).is_some_and(|(ty, _)| ty == same[0].ty);
            if let Some((_, wide_is_there)) = other(&is_wider) {
                // Becomes the wider one.
                if wide_is_there || present.is_empty() {
                    continue;
                }
            } else if let Some((narrow, true)) = other(&is_narrower) {
                let Some(wide) = present.first() else { continue };
                meeting.notes.push(match all[narrow].ty {
                    ScalarType::U8 => format!("{} of 8 bits became 16 bits: times {DEEPER}", all[narrow].name),
                    _ => format!("{} in whole degrees became steps of 0.006 degrees, rounded", all[narrow].name),
                });
                let kinds = vec![wide.attribute.clone(), all[narrow].clone()];
                put(&mut meeting, wide.attribute, Made::Widened { narrow, wide: wide.column }, kinds);
                continue;
            }
            match present.as_slice() {
                [] | [_] => {
                    if let Some(one) = present.first().copied().or(there.first()) {
                        put(&mut meeting, one.attribute, Made::Kept(one.column), vec![one.attribute.clone()]);
                    }
                }
                several => match joined(snapshot, several) {
                    Some((attribute, column)) => {
                        let kinds = several.iter().map(|m| m.attribute.clone()).collect();
                        meeting.notes.push(column.note(&attribute));
                        put(&mut meeting, &attribute, Made::Joined(column), kinds);
                    }
                    None => {
                        let name = &same[0].name;
                        meeting.notes.push(format!(
                            "{name} has another scale, offset or no-data value in some scans, and too many digits to be \
                             one column: each kind has its own"
                        ));
                        for one in several {
                            put(&mut meeting, one.attribute, Made::Kept(one.column), vec![one.attribute.clone()]);
                        }
                    }
                },
            }
        }
        let brighten = Kinds::of(snapshot, &form.scans).brightened().to_vec();
        if !brighten.is_empty() {
            meeting.notes.push("colours of 8 and of 16 bits meet: all are written with 16".to_owned());
        }
        Self { attributes: attributes.into(), brighten, ..meeting }
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
            if let (true, Column::U16(values)) = (is_color(attribute), column) {
                for (value, scan) in values.iter_mut().zip(&batch.scans) {
                    if self.brighten.binary_search(scan).is_ok() {
                        *value = value.saturating_mul(DEEPER);
                    }
                }
            }
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

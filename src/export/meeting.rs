//! One attribute where scans have it in two kinds: colours of 8 and of 16 bits, scan angles in degrees and in finer steps.
//!
//! Whoever looks at the points of several scans together wants one column of each, as merged LAS files have it: the wider
//! kind, to which the other is brought.

use crate::points::{Attribute, Batch, Column, ScalarType, angle_steps};
use crate::query::OutputForm;
use crate::store::Snapshot;
use crate::store::model::{Scan, ScanId};
use std::sync::Arc;

/// The names of colours.
const COLORS: [&str; 4] = ["Red", "Green", "Blue", "Infrared"];

/// A level of 8 bits times this is the same of 16.
const DEEPER: u16 = 257;

/// What is done where kinds meet.
#[derive(Clone, Debug)]
pub struct Meeting {
    /// What batches have then, in this order.
    pub attributes: Arc<[Attribute]>,
    /// What a user should know.
    pub notes: Vec<String>,
    /// The columns that are taken away, ascending by `column`.
    gone: Vec<Gone>,
    /// The scans whose colours have 8 bits in fields of 16 and are to be brought to 16, ascending.
    brighten: Vec<ScanId>,
}

/// A column that is taken away.
#[derive(Clone, Debug)]
struct Gone {
    column: usize,
    /// The one to which it is added before: each point has one of the two, and zero in the other. `None`: no point has it.
    into: Option<usize>,
    attribute: Attribute,
}

/// The type of the kind to which this one is brought.
fn wider(attribute: &Attribute) -> Option<ScalarType> {
    match (attribute.name.as_str(), attribute.ty) {
        (name, ScalarType::U8) if COLORS.contains(&name) => Some(ScalarType::U16),
        ("ScanAngleRank", ScalarType::I8) => Some(ScalarType::I16),
        _ => None,
    }
}

impl Meeting {
    /// For an answer of this form.
    pub fn of(snapshot: &Snapshot, form: &OutputForm) -> Self {
        let all = &form.attributes;
        let mut notes = Vec::new();
        let mut gone: Vec<Gone> = Vec::new();
        let stored = snapshot.attributes();
        let scans = || form.scans.iter().filter_map(|&id| snapshot.scan(id));
        let is_there = |a: &Attribute| {
            let slot = stored.iter().find(|s| s.attribute.identity() == a.identity()).map(|s| s.id);
            scans().any(|scan| slot.is_some_and(|slot| scan.attributes.contains(&slot)))
        };
        for (from, narrow) in all.iter().enumerate() {
            let wide = |a: &Attribute| a.name == narrow.name && Some(a.ty) == wider(narrow);
            let Some(into) = all.iter().position(wide) else { continue };
            gone.push(match (is_there(narrow), is_there(&all[into])) {
                (true, true) => {
                    notes.push(match narrow.ty {
                        ScalarType::U8 => format!("{} of 8 bits became 16 bits: times {DEEPER}", narrow.name),
                        _ => format!("{} in whole degrees became steps of 0.006 degrees, rounded", narrow.name),
                    });
                    Gone { column: from, into: Some(into), attribute: narrow.clone() }
                }
                (true, false) => Gone { column: into, into: None, attribute: all[into].clone() },
                (false, _) => Gone { column: from, into: None, attribute: narrow.clone() },
            });
        }
        gone.sort_by_key(|g| g.column);
        let is_gone = |i: &usize| gone.iter().any(|g| g.column == *i);
        let attributes = (0..all.len()).filter(|i| !is_gone(i)).map(|i| all[i].clone()).collect();

        let fields = stored.iter().filter(|a| a.attribute.name == "Red" && a.attribute.ty == ScalarType::U16);
        let fields: Vec<_> = fields.map(|a| a.id).collect();
        let of_depth =
            |s: &&Scan, bits: u8| s.color_depth == Some(bits) && s.attributes.iter().any(|a| fields.contains(a));
        let deep = scans().any(|s| of_depth(&s, 16))
            || gone.iter().any(|g| g.into.is_some() && g.attribute.ty == ScalarType::U8);
        let brighten: Vec<ScanId> = scans().filter(|s| deep && of_depth(s, 8)).map(|s| s.id).collect();
        if !brighten.is_empty() {
            notes.push("colours of 8 and of 16 bits meet: all are written with 16".to_owned());
        }
        Self { attributes, notes, gone, brighten }
    }

    /// Must it be known which scan a point is of?
    pub fn needs_scans(&self) -> bool {
        !self.brighten.is_empty()
    }

    /// The attributes, as scans have them, that the answer's `attribute` holds.
    pub fn kinds<'m>(&'m self, attribute: &'m Attribute) -> impl Iterator<Item = &'m Attribute> {
        let narrow = self.gone.iter().filter(|g| g.into.is_some()).map(|g| &g.attribute);
        let joined = narrow.filter(|n| n.name == attribute.name && wider(n) == Some(attribute.ty));
        [attribute].into_iter().chain(joined)
    }

    /// Makes the points of a batch what the answer has.
    pub fn apply(&self, batch: &mut Batch) {
        if self.needs_scans() {
            self.brighten(batch);
        }
        if self.gone.is_empty() {
            return;
        }
        for Gone { column, into, .. } in &self.gone {
            let Some(into) = into else { continue };
            let narrow = std::mem::replace(&mut batch.columns[*column], Column::U8(Vec::new()));
            match (&narrow, &mut batch.columns[*into]) {
                (Column::U8(narrow), Column::U16(wide)) => {
                    wide.iter_mut().zip(narrow).for_each(|(w, &n)| *w = w.wrapping_add(u16::from(n) * DEEPER));
                }
                (Column::I8(narrow), Column::I16(wide)) => {
                    wide.iter_mut().zip(narrow).for_each(|(w, &n)| *w = w.wrapping_add(angle_steps(n)));
                }
                _ => {}
            }
        }
        // Only now, since places count from the front.
        self.gone.iter().rev().for_each(|g| drop(batch.columns.remove(g.column)));
        batch.attributes = self.attributes.clone();
    }

    fn brighten(&self, batch: &mut Batch) {
        for (attribute, column) in batch.attributes.iter().zip(&mut batch.columns) {
            if let (true, Column::U16(values)) = (COLORS.contains(&attribute.name.as_str()), column) {
                for (value, scan) in values.iter_mut().zip(&batch.scans) {
                    if self.brighten.binary_search(scan).is_ok() {
                        *value = value.saturating_mul(DEEPER);
                    }
                }
            }
        }
    }
}

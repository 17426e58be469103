//! Two kinds of one attribute in the scans of an answer: colours of 8 and of 16 bits, scan angles in degrees and in finer
//! steps. Where both are there, the answer has the wider kind, and the other is brought to it.

use crate::points::{Attribute, ScalarType, angle_steps, wider_type};
use crate::store::Snapshot;
use crate::store::model::{Scan, ScanId, Slot, StoredAttribute};

/// A level of 8 bits times this is the same of 16.
pub(crate) const DEEPER: u16 = 257;

/// What a stored integer becomes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Widening {
    /// A colour of 8 bits one of 16.
    Color,
    /// An angle in whole degrees the nearest of the steps of 0.006 degrees.
    Degrees,
}

impl Widening {
    /// Of a stored value of 8 bits, or of a colour's field of 16.
    pub fn of(self, stored: i128) -> i128 {
        match self {
            Self::Color => (stored * i128::from(DEEPER)).min(u16::MAX.into()),
            Self::Degrees => i8::try_from(stored).map_or(stored, |degrees| angle_steps(degrees).into()),
        }
    }
}

/// Is it a colour?
pub(crate) fn is_color(attribute: &Attribute) -> bool {
    wider_type(&attribute.name, ScalarType::U8).is_some()
}

/// Is it a colour of which the depth of a scan's colours is told? Near infrared may have another one.
pub(crate) fn has_depth(attribute: &Attribute) -> bool {
    is_color(attribute) && attribute.name != "Infrared"
}

/// Is there a narrower kind of attributes of this name?
pub(crate) fn may_be_narrower(attribute: &Attribute) -> bool {
    [ScalarType::U8, ScalarType::I8].into_iter().any(|ty| wider_type(&attribute.name, ty).is_some())
}

/// The type of the kind to which this one is brought, and how.
pub(crate) fn wider(attribute: &Attribute) -> Option<(ScalarType, Widening)> {
    let ty = wider_type(&attribute.name, attribute.ty)?;
    Some((ty, if ty == ScalarType::U16 { Widening::Color } else { Widening::Degrees }))
}

/// The kinds that meet in some scans.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Kinds {
    /// The narrow ones.
    narrow: Vec<(Slot, Widening)>,
    /// Red, green and blue in fields of 16 bits.
    fields: Vec<Slot>,
    /// The scans whose colours have 8 bits in such fields, where others have 16; ascending.
    brightened: Vec<ScanId>,
}

impl Kinds {
    /// Of these scans.
    pub fn of(snapshot: &Snapshot, scans: &[ScanId]) -> Self {
        Self::of_scans(snapshot.attributes(), scans.iter().filter_map(|&id| snapshot.scan(id)))
    }

    /// The same, of a store's attributes.
    pub fn of_scans<'s>(attributes: &[StoredAttribute], scans: impl Iterator<Item = &'s Scan> + Clone) -> Self {
        let is_there = |slot: Slot| scans.clone().any(|scan| scan.attributes.contains(&slot));
        let there: Vec<&StoredAttribute> = attributes.iter().filter(|a| is_there(a.id)).collect();
        let narrow: Vec<_> = there
            .iter()
            .filter_map(|a| {
                let (ty, widening) = wider(&a.attribute)?;
                let wide = |b: &&&StoredAttribute| b.attribute.name == a.attribute.name && b.attribute.ty == ty;
                there.iter().find(wide).map(|_| (a.id, widening))
            })
            .collect();
        let wide_colors = there.iter().filter(|a| has_depth(&a.attribute) && a.attribute.ty == ScalarType::U16);
        let fields: Vec<Slot> = wide_colors.map(|a| a.id).collect();
        let of_depth =
            |s: &&Scan, bits: u8| s.color_depth == Some(bits) && s.attributes.iter().any(|slot| fields.contains(slot));
        let is_deep = |slot: Slot| there.iter().any(|a| a.id == slot && has_depth(&a.attribute));
        let deep = narrow.iter().any(|(slot, _)| is_deep(*slot)) || scans.clone().any(|s| of_depth(&s, 16));
        let mut brightened: Vec<ScanId> = scans.filter(|s| deep && of_depth(s, 8)).map(|s| s.id).collect();
        brightened.sort_unstable();
        Self { narrow, fields, brightened }
    }

    /// Is all of one kind?
    pub fn is_empty(&self) -> bool {
        self.narrow.is_empty() && self.brightened.is_empty()
    }

    /// What becomes of the values that a scan has of an attribute.
    pub fn widening(&self, slot: Slot, scan: ScanId) -> Option<Widening> {
        let narrow = self.narrow.iter().find(|(narrow, _)| *narrow == slot).map(|(_, widening)| *widening);
        let bright = || self.fields.contains(&slot) && self.brightened.binary_search(&scan).is_ok();
        narrow.or_else(|| bright().then_some(Widening::Color))
    }

    /// The scans whose colours have 8 bits in fields of 16 and are brought to 16, ascending.
    pub fn brightened(&self) -> &[ScanId] {
        &self.brightened
    }
}

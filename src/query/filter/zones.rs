//! What a filter can be over a node, from its zone maps, scans and bounds alone.

use super::bind::Bound;
use super::set::ValueSet;
use crate::lattice::LatticeBox;
use crate::store::model::{Range, ScanId, Slot};

/// What is known of a set of points without decoding any.
pub(crate) struct Known<'a> {
    /// The range of each attribute, ascending by slot; an attribute that is missing has no value in any of the points.
    pub ranges: &'a [(Slot, Range)],
    /// The scans that have points here, ascending.
    pub scans: &'a [ScanId],
    /// Where the points are.
    pub bounds: &'a LatticeBox,
}

/// Can the filter be true for a point; can it be false for one? Both may be said too often, never too seldom.
pub(super) fn possible(bound: &Bound, known: &Known) -> (bool, bool) {
    match bound {
        Bound::Not(inner) => {
            let (yes, no) = possible(inner, known);
            (no, yes)
        }
        Bound::And(terms) => {
            terms.iter().map(|t| possible(t, known)).fold((true, false), |a, b| (a.0 && b.0, a.1 || b.1))
        }
        Bound::Or(terms) => {
            terms.iter().map(|t| possible(t, known)).fold((false, true), |a, b| (a.0 || b.0, a.1 && b.1))
        }
        Bound::Scans(set) => {
            let inside = |s: &ScanId| set.binary_search(s).is_ok();
            (known.scans.iter().any(inside), !known.scans.iter().all(inside))
        }
        Bound::Axis(axis, set) => {
            let index = |v: u64| i128::from(v);
            set.meets_integers(index(known.bounds.min.0[*axis]), index(known.bounds.max.0[*axis]))
        }
        Bound::Null(_) => (true, true),
        Bound::Values(tests) => tests.iter().fold((false, false), |(yes, no), (source, set)| {
            let (y, n) = possible_values(known, source.slot, set);
            (yes || y, no || n)
        }),
        Bound::Pair(left, _, right) => {
            let any = |sources: &[super::bind::Source]| sources.iter().any(|s| range(known, s.slot).is_some());
            let both = any(left) && any(right);
            (both, both)
        }
    }
}

fn range(known: &Known, slot: Slot) -> Option<Range> {
    known.ranges.binary_search_by_key(&slot, |(s, _)| *s).ok().map(|i| known.ranges[i].1)
}

fn possible_values(known: &Known, slot: Slot, set: &ValueSet) -> (bool, bool) {
    match range(known, slot) {
        None | Some(Range::OnlyNan) => (false, false),
        Some(Range::Unsigned(low, high)) => set.meets_integers(low.into(), high.into()),
        Some(Range::Signed(low, high)) => set.meets_integers(low.into(), high.into()),
        Some(Range::Float(low, high)) => set.meets_floats(low, high),
    }
}

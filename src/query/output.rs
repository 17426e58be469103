//! What an answer's batches will look like, before the first of them: for those who write files.

use super::filter::Known;
use super::kinds::Kinds;
use super::plan::Plan;
use super::region::LatticeRegion;
use super::{Query, QueryError};
use crate::geometry::Containment;
use crate::lattice::LatticeBox;
use crate::points::Attribute;
use crate::store::Snapshot;
use crate::store::model::{FIRST_ATTRIBUTE, Range, Scan, ScanId, Slot};
use std::sync::Arc;

/// The form of an answer.
#[derive(Clone, Debug, PartialEq)]
pub struct OutputForm {
    /// The attributes of every batch, in this order.
    pub attributes: Arc<[Attribute]>,
    /// The scans that can contribute, ascending: those asked for whose bounds meet the region and whose values may pass the filter,
    /// or all that were asked for if there is none.
    pub scans: Vec<ScanId>,
    /// Where all points of the answer are: as close around the region as can be told from the bounds of these scans; `None` if
    /// there are none.
    pub bounds: Option<LatticeBox>,
}

impl Query {
    /// The form of this query's answer; reads the index, but no points.
    ///
    /// # Errors
    ///
    /// As [`Query::run`].
    pub fn output_form(&self, snapshot: &Snapshot) -> Result<OutputForm, QueryError> {
        let plan = Plan::new(self, snapshot)?;
        let scans = passing(&plan, contributing(snapshot, plan.scans.as_deref(), &plan.region))?;
        let stored = snapshot.scans().iter().filter(|s| scans.binary_search(&s.id).is_ok()).filter_map(|s| s.bounds);
        let bounds = stored.reduce(|a, b| a.union(&b)).map(|all| close_around(all, &plan.region));
        Ok(OutputForm { attributes: plan.attributes.clone(), scans, bounds })
    }
}

/// The scans that can contribute: those of `asked` (`None`: all) whose bounds meet the region; all of them if there is none.
pub(super) fn contributing(snapshot: &Snapshot, asked: Option<&[ScanId]>, region: &LatticeRegion) -> Vec<ScanId> {
    let asked = || snapshot.scans().iter().filter(|s| asked.is_none_or(|ids| ids.binary_search(&s.id).is_ok()));
    let meets = |s: &&Scan| s.bounds.is_some_and(|b| region.classify(&b) != Containment::Outside);
    let scans: Vec<ScanId> = asked().filter(meets).map(|s| s.id).collect();
    if scans.is_empty() { asked().map(|s| s.id).collect() } else { scans }
}

/// Those of some scans of which a point may pass the plan's filter, by the ranges of all of the store; all if there is none. Also
/// where they differ in a kind of attribute: the filter compares what all together have, and so do the points go out.
pub(super) fn passing(plan: &Plan, scans: Vec<ScanId>) -> Result<Vec<ScanId>, QueryError> {
    let Some(filter) = plan.filter.as_ref().filter(|_| Kinds::of(&plan.snapshot, &scans).is_empty()) else {
        return Ok(scans);
    };
    let zones = plan.roots.iter().map(|root| plan.nodes.zones(root)).collect::<Result<Vec<_>, _>>()?;
    let may_pass = |&id: &ScanId| {
        let Some(scan) = plan.snapshot.scan(id) else { return true };
        let Some(bounds) = &scan.bounds else { return true };
        zones.iter().any(|zones| {
            let has = |(slot, _): &&(Slot, Range)| *slot < FIRST_ATTRIBUTE || scan.attributes.contains(slot);
            let ranges: Vec<(Slot, Range)> = zones.subtree.iter().filter(has).copied().collect();
            filter.may_match(&Known { ranges: &ranges, scans: &[id], bounds })
        })
    };
    let those: Vec<ScanId> = scans.iter().copied().filter(may_pass).collect();
    Ok(if those.is_empty() { scans } else { those })
}

/// A box that holds all of `region` that is in `all`: each side is brought in as far as what it leaves is certainly outside.
fn close_around(all: LatticeBox, region: &LatticeRegion) -> LatticeBox {
    let mut close = all;
    for axis in 0..3 {
        let outside = |low: u64, high: u64| {
            let mut slab = close;
            (slab.min.0[axis], slab.max.0[axis]) = (low, high);
            region.classify(&slab) == Containment::Outside
        };
        let (low, high) = (close.min.0[axis], close.max.0[axis]);
        // The first place from below, and the last one, that may not be left out.
        let first = bisect(low, high, |place| !outside(low, place));
        let last = high - bisect(0, high - first, |back| !outside(high - back, high));
        (close.min.0[axis], close.max.0[axis]) = (first, last);
    }
    close
}

/// The least number of `low ..= high` from which on `holds` is true; `high` if it is nowhere before.
fn bisect(mut low: u64, mut high: u64, holds: impl Fn(u64) -> bool) -> u64 {
    while low < high {
        let middle = low + (high - low) / 2;
        if holds(middle) { high = middle } else { low = middle + 1 }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::{BIAS, Lattice, LatticePoint};
    use crate::query::{Polygons, Region};
    use proptest::prelude::*;

    fn at(place: [i32; 3]) -> LatticePoint {
        LatticePoint(place.map(|v| (BIAS + i64::from(v)) as u64))
    }

    proptest! {
        #[test]
        fn the_box_around_an_answer_holds_all_of_it(
            kind in 0..7,
            a in prop::array::uniform3(-60_i32..60),
            b in prop::array::uniform3(-60_i32..60),
            points in prop::collection::vec(prop::array::uniform3(-50_i32..50), 1..60),
        ) {
            let lattice = Lattice::uniform(1.0).unwrap();
            let (low, high) = (std::array::from_fn(|i| a[i].min(b[i])), std::array::from_fn(|i| a[i].max(b[i]) + 1));
            let world = |c: [i32; 3]| c.map(f64::from);
            let inside = Region::new_box(world(low), world(high)).unwrap();
            let ball = Region::new_sphere(world(a), f64::from(b[0].abs())).unwrap();
            let [[x0, y0, _], [x1, y1, _]] = [low, high];
            let triangle = Polygons::parse(&format!("POLYGON(({x0} {y0}, {x1} {y0}, {x1} {y1}, {x0} {y0}))")).unwrap();
            let region = match kind {
                0 => Region::Everything,
                1 => inside,
                2 => ball,
                3 => Region::new_prism(triangle, [low[2], high[2]].map(f64::from)).unwrap(),
                4 => Region::any([inside, ball]),
                5 => Region::all([inside, ball]),
                _ => inside.inverted(),
            };
            let region = region.on_lattice(&lattice).unwrap();
            let all = points.iter().map(|&p| LatticeBox::of(at(p))).reduce(|a, b| a.union(&b)).unwrap();
            let close = close_around(all, &region);
            prop_assert!(all.contains_box(&close));
            for &p in &points {
                prop_assert!(!region.contains(at(p)) || close.contains(at(p)), "{p:?} is outside of {close:?}");
            }
            let meets = all.meets(&LatticeBox { min: at(low), max: at(high.map(|v| v - 1)) });
            if kind == 1 && meets {
                let expected = LatticeBox {
                    min: LatticePoint(std::array::from_fn(|i| all.min.0[i].max(at(low).0[i]))),
                    max: LatticePoint(std::array::from_fn(|i| all.max.0[i].min(at(high).0[i] - 1))),
                };
                prop_assert_eq!(close, expected);
            }
        }
    }
}

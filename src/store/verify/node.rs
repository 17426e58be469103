//! One node: its chunks decode, and its row and zone maps say of its points what is true.

use super::super::decode::{DecodedPart, decode_part};
use super::super::encode::{ColumnSlices, ScanTable};
use super::super::model::{NodeHead, ScanId, Slot, Zones};
use super::super::own_points::{Describer, Description};
use super::super::rows;
use super::super::shape::Relative;
use super::super::snapshot::Snapshot;
use super::{Finding, finding};
use crate::codec::{BlockSize, Decoder};
use crate::lattice::{Cube, Key, LOW_DIGITS, LatticeBox, LatticePoint, SortKey};
use crate::octree::Params;
use std::collections::BTreeMap;

/// What was found of one node.
#[derive(Debug, Default)]
pub(super) struct NodeTally {
    /// Scan, points, their bounds.
    pub scans: Vec<(ScanId, u64, LatticeBox)>,
    /// The zone maps, if they can be read.
    pub zones: Option<Zones>,
    pub findings: Vec<Finding>,
}

/// What checking keeps from node to node.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    decoder: Decoder,
    relative: Relative,
    /// The points of a part.
    points: Vec<LatticePoint>,
}

/// Checks the nodes of a snapshot.
#[derive(Debug)]
pub(super) struct Checker<'a> {
    snapshot: &'a Snapshot,
    table: ScanTable,
    params: Params,
}

impl<'a> Checker<'a> {
    pub fn new(snapshot: &'a Snapshot) -> Self {
        let mut table = ScanTable::new(snapshot.attributes());
        snapshot.scans().iter().for_each(|s| table.insert(s.id, &s.attributes, s.color_depth));
        let site = snapshot.site();
        Self { snapshot, table, params: Params { g: site.g, leaf_capacity: site.leaf_capacity } }
    }

    pub fn check(&self, head: &NodeHead, scratch: &mut Scratch) -> NodeTally {
        let mut tally = NodeTally::default();
        let wrong = |table: &str, what: String| Finding { table: table.into(), key: rows::name_of(head), what };
        if head.leaf != self.params.is_leaf(head.cube.k(), head.subtree_points) {
            tally.findings.push(wrong("node", "whether it is a leaf does not follow from its count".into()));
        }
        let mut parts = Vec::with_capacity(head.parts.len());
        for part in 0..head.parts.len() {
            match decode_part(self.snapshot, head, part, &mut scratch.decoder) {
                Ok(decoded) => parts.push(decoded),
                Err(e) => tally.findings.push(finding(e)),
            }
        }
        for (i, part) in parts.iter().enumerate() {
            fill_points(head.cube, &part.keys, &mut scratch.points);
            let found = self.check_part(head, (part, head.parts[i].block_size), &scratch.points);
            tally.findings.extend(found.map(|what| wrong("chunk", format!("part {i}: {what}"))));
            count(part, &scratch.points, &mut tally.scans);
        }
        match self.snapshot.with(|c| rows::load_zones(c, head.layer, head.cube)) {
            Ok(zones) => tally.zones = Some(zones),
            Err(e) => tally.findings.push(finding(e)),
        }
        if parts.len() == head.parts.len() {
            let description = self.describe(head, &parts, scratch);
            let what = differences(head, tally.zones.as_ref(), &description);
            tally.findings.extend(what.map(|(table, what)| wrong(table, what.into())));
        }
        tally
    }

    /// Order, containment, blocks, and which columns there are.
    fn check_part(
        &self,
        head: &NodeHead,
        (part, size): (&DecodedPart, BlockSize),
        points: &[LatticePoint],
    ) -> Option<String> {
        if !part.keys.is_sorted() {
            return Some("the points are not in key order".into());
        }
        if !inside(head.cube, &part.keys) {
            return Some("a point is outside of the node's cube".into());
        }
        if !points.chunks(size.points()).map(bounds).eq(part.blocks.iter().map(|b| Some(*b))) {
            return Some("the bounds of a block are not those of its points".into());
        }
        let present = runs(&part.scans);
        if let Some(scan) = present.keys().find(|s| self.snapshot.scan(**s).is_none()) {
            return Some(format!("there are points of scan {scan}, which is not there"));
        }
        let has = |slot: Slot| present.keys().any(|&s| self.table.has(s, slot));
        let expected = self.snapshot.attributes().iter().map(|a| a.id).filter(|&s| has(s));
        if !expected.eq(part.columns.iter().map(|c| c.0)) {
            return Some("the columns are not those of its scans' attributes".into());
        }
        for (slot, column) in &part.columns {
            let lacks = |i: &usize| !self.table.has(part.scans[*i], *slot);
            if present.keys().all(|&s| self.table.has(s, *slot)) {
                continue;
            }
            if (0..part.scans.len()).filter(lacks).any(|i| column.raw(i) != [0; 8]) {
                return Some(format!("column {slot} has a value at a point whose scan lacks it"));
            }
        }
        None
    }

    /// What the row and the zone maps should say.
    fn describe(&self, head: &NodeHead, parts: &[DecodedPart], scratch: &mut Scratch) -> Description {
        let mut describer = Describer::new(&self.table);
        parts.iter().for_each(|p| describer.add(&ColumnSlices { scans: &p.scans, columns: &p.columns }));
        if head.cube.k() <= LOW_DIGITS {
            let keys = merged(parts, |key| key.low);
            describer.finish(head.cube, &keys, &mut scratch.relative)
        } else {
            let keys = merged(parts, |key| key);
            describer.finish(head.cube, &keys, &mut scratch.relative)
        }
    }
}

/// The keys of all parts in order.
fn merged<K: SortKey>(parts: &[DecodedPart], of: impl Fn(Key) -> K) -> Vec<K> {
    let mut keys = Vec::with_capacity(parts.iter().map(|p| p.keys.len()).sum());
    parts.iter().for_each(|p| keys.extend(p.keys.iter().map(|key| of(*key))));
    // Stable, and quick on a few runs.
    keys.sort();
    keys
}

/// Do all these keys belong to the cube?
fn inside(cube: Cube, keys: &[Key]) -> bool {
    let all = cube.first_key()..=cube.last_key();
    keys.iter().all(|key| all.contains(key))
}

/// The points with these keys; of those inside `cube` the digits above its own are known.
fn fill_points(cube: Cube, keys: &[Key], points: &mut Vec<LatticePoint>) {
    points.clear();
    if cube.k() <= LOW_DIGITS && inside(cube, keys) {
        points.extend(keys.iter().map(|key| cube.point_of_low_key(key.low)));
    } else {
        points.extend(keys.iter().map(|key| key.point()));
    }
}

/// The tight bounds of some points, if there are any.
fn bounds(points: &[LatticePoint]) -> Option<LatticeBox> {
    let first = points.first()?;
    Some(points.iter().fold(LatticeBox::of(*first), |bounds, point| bounds.with(*point)))
}

/// What a node's rows say wrongly.
fn differences(
    head: &NodeHead,
    zones: Option<&Zones>,
    description: &Description,
) -> Option<(&'static str, &'static str)> {
    let own: Vec<_> = head.scans.iter().filter(|s| s.own > 0).map(|s| (s.scan, s.own)).collect();
    if own != description.scans.iter().map(|s| (s.scan, s.own)).collect::<Vec<_>>() {
        Some(("node", "the counts by scan are not those of its points"))
    } else if head.own_bounds != description.bounds {
        Some(("node", "the bounds are not those of its points"))
    } else if head.shape != description.shape {
        Some(("node", "spacing, moments, radius or colour are not those of its points"))
    } else if zones.is_some_and(|z| z.own != description.zones) {
        Some(("zone", "the zone maps are not those of its points"))
    } else {
        None
    }
}

/// Points by scan.
fn runs(scans: &[ScanId]) -> BTreeMap<ScanId, u64> {
    let mut counts = BTreeMap::new();
    for run in scans.chunk_by(|a, b| a == b) {
        *counts.entry(run[0]).or_default() += run.len() as u64;
    }
    counts
}

/// Adds a part's points and their bounds.
fn count(part: &DecodedPart, points: &[LatticePoint], scans: &mut Vec<(ScanId, u64, LatticeBox)>) {
    let mut start = 0;
    for run in part.scans.chunk_by(|a, b| a == b) {
        let end = start + run.len();
        let bounds = bounds(&points[start..end]);
        start = end;
        let Some(bounds) = bounds else { continue };
        match scans.iter_mut().find(|s| s.0 == run[0]) {
            Some(entry) => {
                entry.1 += run.len() as u64;
                entry.2 = entry.2.union(&bounds);
            }
            None => scans.push((run[0], run.len() as u64, bounds)),
        }
    }
}

//! The sampling rule: every point is stored in the coarsest node in whose grid it wins, and parts follow the order of
//! detail (OCTREE sections 1 and 7).
//!
//! Top-down with the ancestors' points at hand. A node's points get their wins from their predecessors among these and
//! the own points; the wins then say whether each belongs here. That suffices for the whole subtree, since cells nest: a
//! point that follows its parent's winner follows all winners above.

use super::super::decode::{DecodedPart, decode_part};
use super::super::digest::ScanFacts;
use super::super::error::StoreError;
use super::super::index::{NodeIndex, NodeIx};
use super::super::model::{NodeHead, ScanId};
use super::super::rows;
use super::super::snapshot::Snapshot;
use super::{Finding, Progress, finding};
use crate::codec::Decoder;
use crate::lattice::{Key, SortKey};
use crate::octree::{self, Params};
use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::ops::ControlFlow;

/// A point of a node: everything that orders it.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Point {
    key: Key,
    record: Box<[u8]>,
    identity: [u8; 32],
}

/// A point of a node of the path.
#[derive(Clone, Copy, Debug)]
struct Entry {
    key: Key,
    /// Which node of the path, and which of its points.
    depth: usize,
    index: usize,
}

/// A node's points in order, and which part each is in.
type Own = (Vec<Point>, Vec<u32>);

struct Walk<'a> {
    snapshot: &'a Snapshot,
    index: &'a NodeIndex,
    scans: BTreeMap<ScanId, ScanFacts>,
    params: Params,
    decoder: Decoder,
    /// The points of the nodes from the root down to here, in order.
    path: Vec<Vec<Point>>,
    findings: Vec<Finding>,
    progress: Progress<'a>,
    done: u64,
    total: u64,
}

/// Checks all layers, until `progress` breaks.
pub(super) fn check(snapshot: &Snapshot, index: &NodeIndex, progress: Progress<'_>) -> ControlFlow<(), Vec<Finding>> {
    let site = snapshot.site();
    let points: u64 = index.heads().iter().map(|h| h.own_points).sum();
    let mut walk = Walk {
        snapshot,
        index,
        scans: BTreeMap::new(),
        params: Params { g: site.g, leaf_capacity: site.leaf_capacity },
        decoder: Decoder::new(),
        path: Vec::new(),
        findings: Vec::new(),
        progress,
        done: points,
        total: 2 * points,
    };
    for scan in snapshot.scans() {
        match ScanFacts::of(snapshot, scan) {
            Ok(facts) => {
                walk.scans.insert(scan.id, facts);
            }
            Err(e) => walk.findings.push(finding(e)),
        }
    }
    index.roots().try_for_each(|root| walk.node(root, &[]))?;
    ControlFlow::Continue(walk.findings)
}

impl Walk<'_> {
    /// `above`: the points of proper ancestors inside the node's cube, in order.
    fn node(&mut self, node: NodeIx, above: &[Entry]) -> ControlFlow<()> {
        let index = self.index;
        let head = index.head(node);
        self.done += head.own_points;
        (self.progress)(self.done, self.total)?;
        let (own, parts) = match self.read(head) {
            Ok(Some(read)) => read,
            // Told already by the check of the node itself; below it nothing can be decided.
            Ok(None) | Err(_) => return ControlFlow::Continue(()),
        };
        let depth = self.path.len();
        let mine: Vec<Entry> = own.iter().enumerate().map(|(index, p)| Entry { key: p.key, depth, index }).collect();
        self.path.push(own);
        let merged = self.merged(above, &mine);
        let wins = self.wins(head, &merged, depth);
        self.check_home(head, &wins, index.parent(node).is_none());
        self.check_ties(head, &merged, depth);
        check_parts(head, &mine, &wins, &parts, &mut self.findings);
        for child in index.children(node) {
            let cube = index.head(child).cube;
            let (first, last) = (cube.first_key(), cube.last_key());
            let from = merged.partition_point(|e| e.key < first);
            let to = merged.partition_point(|e| e.key <= last);
            self.node(child, &merged[from..to])?;
        }
        self.path.pop();
        ControlFlow::Continue(())
    }

    /// The node's points in order, and which part each is in; `None` if a scan or a column is missing.
    fn read(&mut self, head: &NodeHead) -> Result<Option<Own>, StoreError> {
        let mut points: Vec<(Point, u32)> = Vec::new();
        for part in 0..head.parts.len() {
            let decoded = decode_part(self.snapshot, head, part, &mut self.decoder)?;
            for i in 0..decoded.keys.len() {
                let Some(point) = self.point(&decoded, i) else { return Ok(None) };
                points.push((point, part as u32));
            }
        }
        points.sort();
        Ok(Some(points.into_iter().unzip()))
    }

    fn point(&self, part: &DecodedPart, i: usize) -> Option<Point> {
        let facts = self.scans.get(&part.scans[i])?;
        let mut record = Vec::new();
        for &(slot, size) in &facts.attributes {
            let column = part.columns.binary_search_by_key(&slot, |c| c.0).ok()?;
            record.extend_from_slice(&part.columns[column].1.raw(i)[..size]);
        }
        Some(Point { key: part.keys[i], record: record.into(), identity: facts.identity })
    }

    fn compare(&self, a: Entry, b: Entry) -> Ordering {
        a.key.cmp(&b.key).then_with(|| self.path[a.depth][a.index].cmp(&self.path[b.depth][b.index]))
    }

    /// Both in order; of equal points the ancestors' first.
    fn merged(&self, above: &[Entry], mine: &[Entry]) -> Vec<Entry> {
        let mut merged = Vec::with_capacity(above.len() + mine.len());
        merged.extend_from_slice(above);
        merged.extend_from_slice(mine);
        // Stable, and quick on two runs.
        merged.sort_by(|a, b| self.compare(*a, *b));
        merged
    }

    /// The wins of the own points, in order; the first of the cube counts as winning the cube.
    fn wins(&self, head: &NodeHead, merged: &[Entry], depth: usize) -> Vec<i8> {
        let win = |i: usize| match i.checked_sub(1) {
            None => head.cube.k() as i8,
            Some(before) => merged[before].key.differing_digit(merged[i].key),
        };
        (0..merged.len()).filter(|&i| merged[i].depth == depth).map(win).collect()
    }

    /// Does every own point belong here?
    fn check_home(&mut self, head: &NodeHead, wins: &[i8], is_root: bool) {
        let cell = self.params.cell(head.cube.k());
        let too_coarse = wins.iter().filter(|&&w| !is_root && w > cell).count();
        let too_fine = wins.iter().filter(|&&w| !head.leaf && w < cell).count();
        for (n, where_to) in [(too_coarse, "above"), (too_fine, "below")] {
            if n > 0 {
                let what = format!("{n} points belong into a node {where_to}");
                self.findings.push(Finding { table: "node".into(), key: rows::name_of(head), what });
            }
        }
    }

    /// Where an ancestor's point and own ones are in one place, the ancestor's is the least.
    fn check_ties(&mut self, head: &NodeHead, merged: &[Entry], depth: usize) {
        let out_of_order = merged.windows(2).any(|w| w[0].key == w[1].key && w[0].depth == depth && w[1].depth < depth);
        if out_of_order {
            let what = "of points in one place, one that is not the least is stored above".into();
            self.findings.push(Finding { table: "node".into(), key: rows::name_of(head), what });
        }
    }
}

/// Are the parts those of the order of detail?
fn check_parts(head: &NodeHead, own: &[Entry], wins: &[i8], parts: &[u32], findings: &mut Vec<Finding>) {
    let keys: Vec<Key> = own.iter().map(|e| e.key).collect();
    let plan = octree::split(wins, &octree::steps(&keys, wins));
    let same_heads = plan.len() == head.parts.len()
        && plan.iter().zip(&head.parts).all(|(p, h)| {
            (p.first_step, p.last_step, p.points.len()) == (h.first_step, h.last_step, h.points as usize)
        });
    let same_points =
        plan.iter().enumerate().all(|(i, p)| p.points.iter().all(|&point| parts[point as usize] == i as u32));
    if !same_heads || !same_points {
        let what = "the parts are not those of the order of detail".into();
        findings.push(Finding { table: "node".into(), key: rows::name_of(head), what });
    }
}

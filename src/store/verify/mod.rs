//! Is a store whole? Every invariant of `docs/format.md`, checked row by row; what is damaged is named.

mod node;
mod sampling;
mod tables;

use super::error::StoreError;
use super::handle::Store;
use super::index::NodeIndex;
use super::interrupt::unless;
use super::model::{ScanId, Zones};
use super::rows;
use super::snapshot::Snapshot;
use super::summary::Summary;
use crate::lattice::LatticeBox;
use node::{Checker, NodeTally};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicU64, Ordering};

/// More findings than this are only counted.
const MOST_FINDINGS: usize = 1000;

/// Something that is not as it should be.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The table; `SQLite` for the file's own structure.
    pub table: String,
    /// Which row.
    pub key: String,
    /// What is wrong.
    pub what: String,
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "table {}, {}: {}", self.table, self.key, self.what)
    }
}

/// What `verify` has looked at and found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Report {
    /// What is wrong, at most a thousand; none if the store is whole.
    pub findings: Vec<Finding>,
    /// Findings beyond those.
    pub more_findings: u64,
    /// Nodes looked at.
    pub nodes: u64,
    /// Points decoded.
    pub points: u64,
    /// Scans whose points were counted.
    pub scans: u64,
}

impl Report {
    /// Nothing found?
    pub fn is_whole(&self) -> bool {
        self.findings.is_empty()
    }

    fn add(&mut self, found: impl IntoIterator<Item = Finding>) {
        for finding in found {
            if self.findings.len() < MOST_FINDINGS {
                self.findings.push(finding);
            } else {
                self.more_findings += 1;
            }
        }
    }

    fn add_error(&mut self, error: StoreError) {
        self.add([finding(error)]);
    }
}

/// An error of reading as a finding.
fn finding(error: StoreError) -> Finding {
    match error {
        StoreError::Damaged { table, key, what, .. } => Finding { table: table.into(), key, what },
        error => {
            let cause = std::error::Error::source(&error).map_or(String::new(), |e| format!(": {e}"));
            Finding { table: "SQLite".into(), key: "file".into(), what: format!("{error}{cause}") }
        }
    }
}

/// Who is told how far the check is, and may end it.
type Progress<'a> = &'a (dyn Fn(u64, u64) -> ControlFlow<()> + Sync);

/// Checks a store. With `deep` also that every point is stored where the sampling rule puts it, and that the parts are
/// those of the order of detail. `progress` is told the points checked and the points there are, from any thread; by a
/// break it ends the check, and then there is no report.
pub fn verify(store: &Store, deep: bool, progress: &(dyn Fn(u64, u64) -> ControlFlow<()> + Sync)) -> Option<Report> {
    check(store, deep, progress).continue_value()
}

fn check(store: &Store, deep: bool, progress: Progress<'_>) -> ControlFlow<(), Report> {
    let mut report = Report::default();
    let snapshot = match store.snapshot() {
        Ok(snapshot) => snapshot,
        Err(e) => {
            report.add_error(e);
            return ControlFlow::Continue(report);
        }
    };
    let total = snapshot.scans().iter().map(|s| s.stored).sum::<u64>() * if deep { 2 } else { 1 };
    progress(0, total)?;
    let found = snapshot.with(|c| unless(c, || progress(0, total).is_break(), tables::integrity));
    // If it was ended, that is no finding.
    progress(0, total)?;
    match found {
        Ok(found) => report.add(found),
        Err(e) => report.add_error(e),
    }
    let (index, damage) = match snapshot.readable_index() {
        Ok(found) => found,
        Err(e) => {
            report.add_error(e);
            return ControlFlow::Continue(report);
        }
    };
    let all_nodes = damage.is_empty();
    damage.into_iter().for_each(|e| report.add_error(e));
    let found = snapshot.with(|c| tables::check(c, snapshot.site_row(), &index, all_nodes));
    if snapshot.generation() == 0 && store.changed(&snapshot).unwrap_or(false) {
        // The first commit came between: of a store without one no transaction is held.
        return check(store, deep, progress);
    }
    match found {
        Ok(found) => report.add(found),
        Err(e) => report.add_error(e),
    }
    let checker = Checker::new(&snapshot);
    let tally = check_nodes(&checker, &index, deep, progress, &mut report)?;
    if all_nodes {
        check_scans(&snapshot, &index, &tally, &mut report);
    }
    if deep {
        let found = sampling::check(&snapshot, &index, progress)?;
        report.add(found);
    }
    if let Err(e) = snapshot.bookmarks() {
        report.add_error(e);
    }
    ControlFlow::Continue(report)
}

/// Content and zone maps of every node; gives the points and bounds found by scan.
fn check_nodes(
    checker: &Checker<'_>,
    index: &NodeIndex,
    deep: bool,
    progress: Progress<'_>,
    report: &mut Report,
) -> ControlFlow<(), BTreeMap<ScanId, (u64, Option<LatticeBox>)>> {
    let points: u64 = index.heads().iter().map(|h| h.own_points).sum();
    let total = points * if deep { 2 } else { 1 };
    let done = AtomicU64::new(0);
    let tallies: Option<Vec<NodeTally>> = index
        .heads()
        .par_iter()
        .map_init(node::Scratch::default, |scratch, head| {
            let tally = checker.check(head, scratch);
            let now = done.fetch_add(head.own_points, Ordering::Relaxed) + head.own_points;
            progress(now, total).is_continue().then_some(tally)
        })
        .collect();
    let Some(tallies) = tallies else { return ControlFlow::Break(()) };
    let mut scans: BTreeMap<ScanId, (u64, Option<LatticeBox>)> = BTreeMap::new();
    let mut zones = Vec::with_capacity(tallies.len());
    for tally in tallies {
        report.nodes += 1;
        for (scan, n, bounds) in tally.scans {
            report.points += n;
            let entry = scans.entry(scan).or_default();
            entry.0 += n;
            entry.1 = Some(entry.1.map_or(bounds, |b| b.union(&bounds)));
        }
        zones.push(tally.zones);
        report.add(tally.findings);
    }
    check_subtree_zones(index, &zones, report);
    ControlFlow::Continue(scans)
}

/// A node's zone maps of its subtree are those of its own points and of its children's subtrees.
fn check_subtree_zones(index: &NodeIndex, zones: &[Option<Zones>], report: &mut Report) {
    for (node, head) in index.heads().iter().enumerate() {
        let Some(mine) = &zones[node] else { continue };
        let children: Option<Vec<Summary>> = index
            .children(node as u32)
            .map(|c| zones[c as usize].as_ref().map(|z| Summary::of(index.head(c), z)))
            .collect();
        let Some(children) = children else { continue };
        if children.len() != head.children.count_ones() as usize {
            continue;
        }
        let mut expected = Zones { own: mine.own.clone(), subtree: Vec::new() };
        super::summary::merge_subtree(&mut head.clone(), &mut expected, &children);
        if expected.subtree != mine.subtree {
            let what = "the subtree's zone maps are not those of its parts".into();
            report.add([Finding { table: "zone".into(), key: rows::name_of(head), what }]);
        }
    }
}

/// Conservation, scan by scan, by the rows and by the points that were found; and the scans' bounds.
fn check_scans(
    snapshot: &Snapshot,
    index: &NodeIndex,
    tally: &BTreeMap<ScanId, (u64, Option<LatticeBox>)>,
    report: &mut Report,
) {
    let of_scan = |id: ScanId, what: String| Finding { table: "scan".into(), key: format!("scan {id}"), what };
    report.add(
        super::flip::conservation(index.roots().map(|root| index.head(root)), snapshot.scans())
            .into_iter()
            .map(|(id, what)| of_scan(id, what)),
    );
    for scan in snapshot.scans() {
        report.scans += 1;
        let (points, bounds) = tally.get(&scan.id).copied().unwrap_or_default();
        if points != scan.stored {
            let what = format!("{} points stored, but {points} can be read", scan.stored);
            report.add([of_scan(scan.id, what)]);
        } else if bounds != scan.bounds {
            report.add([of_scan(scan.id, "the bounds are not those of its points".into())]);
        }
    }
}

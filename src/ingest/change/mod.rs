//! Changes in place: a tree in the store takes points in or gives points up, and only the nodes that this touches are
//! read, encoded and written.
//!
//! [`crate::octree::Tree`] says what happens to which node; here are the nodes of a snapshot under a layer of changes
//! ([`nodes`]), the points that travel through them ([`point`]), and what the changes come to as rows ([`finish`]).

mod finish;
mod nodes;
mod point;

pub(super) use finish::Edit;
pub(super) use point::{NewRows, Point, ScanOrder, gathered};

use super::IngestError;
use super::gather::ScanColumns;
use crate::lattice::Cube;
use crate::lattice::Key;
use crate::octree::{Doomed, Params, Tree};
use crate::store::model::ScanId;
use crate::store::{NodeIndex, ScanTable, Snapshot, Writer};
use nodes::{Blocks, Stored};

/// Bytes of memory that a point takes while it is changed: in the store's block, in its node, and encoded.
pub(super) const POINT_BYTES: u64 = 200;

/// What a change is made on.
pub(super) struct Ground<'a> {
    pub snapshot: &'a Snapshot,
    pub index: &'a NodeIndex,
    pub params: Params,
    /// All scans of the store and the new ones.
    pub scans: &'a ScanOrder<'a>,
    pub table: &'a ScanTable,
}

/// Takes the points of `doomed` scans out of a layer, then puts `points` in; what that comes to is encoded and written
/// by `writer`, and counts once the edit is committed.
pub(super) fn change(
    ground: &Ground<'_>,
    writer: &mut Writer,
    layer: u16,
    doomed: &[ScanId],
    points: Vec<Point<'_>>,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Result<Edit, IngestError> {
    let blocks = Blocks::new(ground.index, layer);
    let stored = Stored::new(ground, layer, &blocks, cancelled);
    let root = ground.snapshot.site().roots.get(usize::from(layer)).copied().flatten();
    let mut tree = Tree::existing(ground.params, root, stored);
    if !doomed.is_empty() {
        tree.remove(&mut DoomedScans { scans: doomed, order: ground.scans })?;
    }
    if !points.is_empty() {
        tree.nodes().prefetch(&points)?;
        tree.insert(points)?;
    }
    finish::finish(ground, writer, layer, tree)
}

/// How many stored points of a layer lie in nodes that would receive at least one of `keys`, which ascend: what putting
/// them in there would rewrite, about.
pub(super) fn touched(index: &NodeIndex, layer: u16, keys: &[Key]) -> u64 {
    let Some(root) = index.root(layer) else { return 0 };
    let mut open = vec![(root, inside(keys, index.head(root).cube))];
    let mut points = 0;
    while let Some((node, keys)) = open.pop() {
        if keys.is_empty() {
            continue;
        }
        points += index.head(node).own_points;
        open.extend(index.children(node).map(|child| (child, inside(keys, index.head(child).cube))));
    }
    points
}

/// How many stored points of a layer lie where `scans` have points, or below: what taking them out may rewrite, at most.
pub(super) fn touched_by_removal(index: &NodeIndex, layer: u16, scans: &[ScanId]) -> u64 {
    let Some(root) = index.root(layer) else { return 0 };
    let has = |node, own: bool| {
        let counts = &index.head(node).scans;
        counts.iter().any(|c| scans.binary_search(&c.scan).is_ok() && (!own || c.own > 0))
    };
    // A node is touched if it or an ancestor loses a point inside its cube; that ancestors lose one is a guess.
    let mut open = vec![root];
    let mut points = 0;
    while let Some(node) = open.pop() {
        if has(node, false) {
            points += index.head(node).own_points;
            open.extend(index.children(node));
        }
    }
    points
}

fn inside(keys: &[Key], cube: Cube) -> &[Key] {
    let (first, last) = (cube.first_key(), cube.last_key());
    &keys[keys.partition_point(|k| *k < first)..keys.partition_point(|k| *k <= last)]
}

/// All points of some scans.
struct DoomedScans<'a> {
    /// Ascending.
    scans: &'a [ScanId],
    order: &'a ScanOrder<'a>,
}

impl<'a> Doomed<Stored<'a>> for DoomedScans<'_> {
    // A node is asked for before anything in it changes, so what the store's row says is still true.
    fn own(&self, nodes: &Stored<'a>, cube: Cube) -> Result<u64, IngestError> {
        let counts = nodes.stored_scans(cube);
        Ok(counts.iter().filter(|c| self.scans.binary_search(&c.scan).is_ok()).map(|c| c.own).sum())
    }

    fn subtree(&self, nodes: &Stored<'a>, cube: Cube) -> Result<u64, IngestError> {
        let counts = nodes.stored_scans(cube);
        Ok(counts.iter().filter(|c| self.scans.binary_search(&c.scan).is_ok()).map(|c| c.subtree).sum())
    }

    fn takes(&mut self, point: &Point<'a>) -> bool {
        self.scans.binary_search(&self.order.columns(point.scan).id).is_ok()
    }
}

/// The columns of a scan, by its place in the order of scans.
impl<'a> ScanOrder<'a> {
    fn columns(&self, place: u32) -> &ScanColumns<'a> {
        &self.all()[place as usize]
    }
}

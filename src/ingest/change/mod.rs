//! Changes in place: a tree in the store takes points in or gives points up, and only the nodes that this touches are
//! read, encoded and written.
//!
//! [`crate::octree::Tree`] says what happens to which node; here are the nodes of a snapshot under a layer of changes
//! ([`nodes`]), the points that travel through them ([`point`]), the columns that they become ([`columns`]), and what
//! the changes come to as rows ([`finish`]).

mod columns;
mod finish;
mod nodes;
mod point;
mod pool;
#[cfg(test)]
mod tests;

pub(super) use finish::Edit;
pub(super) use point::{NewPoints, Point, ScanOrder};

use super::IngestError;
use super::progress::{Progress, Stage};
use crate::lattice::Cube;
use crate::octree::{Doomed, Params, Tree, TreePoint};
use crate::store::model::{NodeHead, ScanId, StoredAttribute};
use crate::store::{Nodes, ScanTable, Snapshot, StoreError, Writer};
use nodes::{Blocks, Stored};
use std::sync::Arc;

/// Bytes of memory that a point takes while it is changed: in the store's block, in its node, and encoded. Where scans of
/// many kinds are mixed it has a value of every attribute.
pub(super) fn point_bytes(attributes: &[StoredAttribute]) -> u64 {
    // With the attributes of LAS 140.
    78 + 2 * attributes.iter().map(|a| a.attribute.ty.size() as u64).sum::<u64>().max(31)
}

/// What a change is made on.
pub(super) struct Ground<'a> {
    pub snapshot: &'a Snapshot,
    pub params: Params,
    /// All scans of the store and the new ones.
    pub scans: &'a Arc<ScanOrder>,
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
    progress: &dyn Progress,
) -> Result<Edit, IngestError> {
    let blocks = Blocks::new(&ground.snapshot.nodes());
    let stored = Stored::new(ground, layer, &blocks, progress);
    let root = ground.snapshot.site().roots.get(usize::from(layer)).copied().flatten();
    let mut tree = Tree::existing(ground.params, root, stored);
    if !doomed.is_empty() {
        let doomed = DoomedScans { scans: doomed, order: ground.scans };
        tree.nodes().prefetch_where(|head| doomed.own(head) > 0, |head| doomed.subtree(head) > 0)?;
        tree.remove(&doomed)?;
    }
    if !points.is_empty() {
        tree.nodes().prefetch(&points, ground.params)?;
        tree.insert(points)?;
    }
    progress.stage(Stage::Build, tree.nodes().written_points());
    finish::finish(ground, writer, layer, &tree, progress)
}

/// How many stored points of a layer lie in nodes that would receive at least one of `points`, which ascend: what
/// putting them in there would rewrite, about. `None` if they are more than `most`.
pub(super) fn touched(nodes: &Nodes, layer: u16, points: &[Point<'_>], most: u64) -> Result<Option<u64>, StoreError> {
    let Some(root) = nodes.root(layer)? else { return Ok(Some(0)) };
    let mut open = vec![(inside(points, root.cube), root)];
    let mut touched = 0;
    while let Some((points, node)) = open.pop() {
        if points.is_empty() {
            continue;
        }
        touched += node.own_points;
        if touched > most {
            return Ok(None);
        }
        open.extend(nodes.children(&node)?.map(|child| (inside(points, child.cube), child)));
    }
    Ok(Some(touched))
}

/// How many stored points of a layer lie where `scans` have points, or below: what taking them out may rewrite, at most.
pub(super) fn touched_by_removal(nodes: &Nodes, layer: u16, scans: &[ScanId]) -> Result<u64, StoreError> {
    let has = |node: &NodeHead| node.scans.iter().any(|c| scans.binary_search(&c.scan).is_ok());
    // A node is touched if it or an ancestor loses a point inside its cube; that ancestors lose one is a guess.
    let mut open: Vec<_> = nodes.root(layer)?.into_iter().collect();
    let mut points = 0;
    while let Some(node) = open.pop() {
        if has(&node) {
            points += node.own_points;
            open.extend(nodes.children(&node)?);
        }
    }
    Ok(points)
}

/// Those of ascending points that lie in a cube.
fn inside<P: TreePoint>(points: &[P], cube: Cube) -> &[P] {
    let (first, last) = (cube.first_key(), cube.last_key());
    &points[points.partition_point(|p| p.key() < first)..points.partition_point(|p| p.key() <= last)]
}

/// All points of some scans.
struct DoomedScans<'a> {
    /// Ascending.
    scans: &'a [ScanId],
    order: &'a ScanOrder,
}

impl DoomedScans<'_> {
    fn has(&self, scan: ScanId) -> bool {
        self.scans.binary_search(&scan).is_ok()
    }

    fn own(&self, head: &NodeHead) -> u64 {
        head.scans.iter().filter(|c| self.has(c.scan)).map(|c| c.own).sum()
    }

    fn subtree(&self, head: &NodeHead) -> u64 {
        head.scans.iter().filter(|c| self.has(c.scan)).map(|c| c.subtree).sum()
    }
}

impl<'a> Doomed<Stored<'a>> for DoomedScans<'_> {
    // A node is asked for before anything in it changes, so what the store's row says is still true.
    fn own(&self, nodes: &Stored<'a>, cube: Cube) -> Result<u64, IngestError> {
        Ok(nodes.stored(cube)?.map_or(0, |node| self.own(&node)))
    }

    fn subtree(&self, nodes: &Stored<'a>, cube: Cube) -> Result<u64, IngestError> {
        Ok(nodes.stored(cube)?.map_or(0, |node| self.subtree(&node)))
    }

    fn takes(&self, point: &Point<'a>) -> bool {
        self.has(self.order.id(point.place()))
    }
}

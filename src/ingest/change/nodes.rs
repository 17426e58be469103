//! The nodes of one layer of a snapshot, under the changes that were made to them.

use super::super::IngestError;
use super::super::stored::records;
use super::Ground;
use super::point::{Point, ScanOrder};
use crate::codec::Decoder;
use crate::lattice::{Cube, Key, LatticeBox, NodeKey};
use crate::octree::{Nodes, Row, TreePoint};
use crate::store::model::{NodeHead, ScanCount};
use crate::store::{NodeIndex, NodeIx, Snapshot, decode_part};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::OnceLock;

/// The stored points of the nodes that were read; each node is read once.
pub(super) struct Blocks {
    first: NodeIx,
    cells: Vec<OnceLock<Block>>,
}

/// A node's points as canonical records, part after part.
#[derive(Debug, Default)]
struct Block {
    keys: Vec<Key>,
    scans: Vec<u32>,
    records: Vec<u8>,
    /// Where each record begins, and the end of the last.
    starts: Vec<u32>,
    /// The points in canonical order.
    order: Vec<u32>,
}

impl Blocks {
    pub fn new(index: &NodeIndex, layer: u16) -> Self {
        let nodes = index.layer(layer);
        Self { first: nodes.start, cells: nodes.map(|_| OnceLock::new()).collect() }
    }
}

/// What became of a node.
#[derive(Debug)]
pub(super) enum Change<'a> {
    Gone,
    Here { leaf: bool, rem: u64, own: Own<'a> },
}

/// The points that a node stores.
#[derive(Debug)]
pub(super) enum Own<'a> {
    /// Those that the store has.
    Kept,
    /// These, ascending.
    New(Vec<Point<'a>>),
}

/// See the module.
pub(super) struct Stored<'a> {
    snapshot: &'a Snapshot,
    pub index: &'a NodeIndex,
    pub layer: u16,
    scans: &'a ScanOrder<'a>,
    blocks: &'a Blocks,
    pub changes: BTreeMap<NodeKey, Change<'a>>,
    cancelled: &'a (dyn Fn() -> bool + Sync),
}

impl<'a> Stored<'a> {
    pub fn new(ground: &Ground<'a>, layer: u16, blocks: &'a Blocks, cancelled: &'a (dyn Fn() -> bool + Sync)) -> Self {
        let Ground { snapshot, index, scans, .. } = *ground;
        Self { snapshot, index, layer, scans, blocks, changes: BTreeMap::new(), cancelled }
    }

    /// The row of the store.
    pub fn head(&self, cube: Cube) -> Option<&'a NodeHead> {
        self.index.find(self.layer, cube).map(|node| self.index.head(node))
    }

    /// Points by scan, as the store has them.
    pub fn stored_scans(&self, cube: Cube) -> &'a [ScanCount] {
        self.head(cube).map_or(&[], |head| &head.scans)
    }

    /// Reads the nodes that will receive at least one of `points`, which ascend, on all threads.
    pub fn prefetch(&self, points: &[Point<'_>]) -> Result<(), IngestError> {
        let Some(root) = self.index.root(self.layer) else { return Ok(()) };
        let inside = |points: &'_ [Point<'_>], node| {
            let cube = self.index.head(node).cube;
            let (first, last) = (cube.first_key(), cube.last_key());
            points.partition_point(|p| p.key < first)..points.partition_point(|p| p.key <= last)
        };
        let mut nodes = Vec::new();
        let mut open = vec![(root, inside(points, root))];
        while let Some((node, range)) = open.pop() {
            if range.is_empty() {
                continue;
            }
            nodes.push(node);
            open.extend(self.index.children(node).map(|child| {
                let below = inside(&points[range.clone()], child);
                (child, below.start + range.start..below.end + range.start)
            }));
        }
        nodes.into_par_iter().try_for_each(|node| self.block(node).map(drop))
    }

    fn block(&self, node: NodeIx) -> Result<&'a Block, IngestError> {
        let cell = &self.blocks.cells[(node - self.blocks.first) as usize];
        if let Some(block) = cell.get() {
            return Ok(block);
        }
        if (self.cancelled)() {
            return Err(IngestError::Interrupted);
        }
        let head = self.index.head(node);
        let mut block = Block::default();
        let mut decoder = Decoder::new();
        for part in 0..head.parts.len() {
            block.append(&decode_part(self.snapshot, head, part, &mut decoder)?, self.scans)?;
        }
        block.starts.push(block.records.len() as u32);
        block.sort();
        // Another thread may have been faster; it has read the same.
        Ok(cell.get_or_init(|| block))
    }

    fn stored_points(&self, cube: Cube) -> Result<Vec<Point<'a>>, IngestError> {
        let Some(node) = self.index.find(self.layer, cube) else { return Ok(Vec::new()) };
        if self.index.head(node).own_points == 0 {
            return Ok(Vec::new());
        }
        Ok(self.block(node)?.points())
    }

    /// The keys of the points that a node stores, ascending.
    pub fn keys(&self, cube: Cube) -> Result<Vec<Key>, IngestError> {
        Ok(self.read(cube)?.iter().map(TreePoint::key).collect())
    }

    /// Takes the store's points for those of these nodes, which are the same.
    pub fn keep(&mut self, nodes: &[NodeKey]) {
        for key in nodes {
            if let Some(Change::Here { own, .. }) = self.changes.get_mut(key) {
                *own = Own::Kept;
            }
        }
    }

    /// Does the store have just these points in this node?
    pub fn has_just(&self, cube: Cube, points: &[Point<'_>]) -> Result<bool, IngestError> {
        let same_number = self.head(cube).is_some_and(|head| head.own_points == points.len() as u64);
        Ok(same_number && self.stored_points(cube)? == points)
    }
}

impl Block {
    fn append(&mut self, part: &crate::store::DecodedPart, scans: &ScanOrder<'_>) -> Result<(), IngestError> {
        self.keys.extend_from_slice(&part.keys);
        let mut last = None;
        for &scan in &part.scans {
            let place = match last {
                Some((id, place)) if id == scan => place,
                _ => {
                    let place = scans.place(scan);
                    place.ok_or_else(|| IngestError::Internal(format!("points of scan {scan}, which is not there")))?
                }
            };
            last = Some((scan, place));
            self.scans.push(place);
        }
        let of_part = &self.scans[self.scans.len() - part.scans.len()..];
        records(part, of_part, scans.all(), &mut self.records, &mut self.starts);
        if u32::try_from(self.records.len()).is_err() {
            return Err(IngestError::Internal("a node's records take more than 4 GiB".into()));
        }
        Ok(())
    }

    fn point(&self, i: u32) -> Point<'_> {
        let i = i as usize;
        let record = &self.records[self.starts[i] as usize..self.starts[i + 1] as usize];
        Point { key: self.keys[i], record, scan: self.scans[i] }
    }

    /// Done where the node is read, on all threads: changes of the tree come one after the other.
    fn sort(&mut self) {
        let mut order: Vec<u32> = (0..).take(self.keys.len()).collect();
        // Parts are in order each; a stable sort merges them.
        order.sort_by(|&a, &b| self.point(a).cmp(&self.point(b)));
        self.order = order;
    }

    fn points(&self) -> Vec<Point<'_>> {
        self.order.iter().map(|&i| self.point(i)).collect()
    }
}

impl<'a> Nodes for Stored<'a> {
    type Point = Point<'a>;
    type Error = IngestError;

    fn row(&self, cube: Cube) -> Result<Option<Row>, IngestError> {
        let stored = || self.head(cube);
        Ok(match self.changes.get(&cube.node_key()) {
            Some(Change::Gone) => None,
            Some(Change::Here { leaf, rem, own }) => {
                let own = match own {
                    Own::Kept => stored().map_or(0, |h| h.own_points),
                    Own::New(points) => points.len() as u64,
                };
                Some(Row { leaf: *leaf, rem: *rem, own })
            }
            None => stored().map(|h| Row { leaf: h.leaf, rem: h.subtree_points, own: h.own_points }),
        })
    }

    fn read(&self, cube: Cube) -> Result<Vec<Point<'a>>, IngestError> {
        match self.changes.get(&cube.node_key()) {
            Some(Change::Gone) => Ok(Vec::new()),
            Some(Change::Here { own: Own::New(points), .. }) => Ok(points.clone()),
            Some(Change::Here { own: Own::Kept, .. }) | None => self.stored_points(cube),
        }
    }

    fn write(&mut self, cube: Cube, leaf: bool, rem: u64, points: Vec<Point<'a>>) -> Result<(), IngestError> {
        if (self.cancelled)() {
            return Err(IngestError::Interrupted);
        }
        self.changes.insert(cube.node_key(), Change::Here { leaf, rem, own: Own::New(points) });
        Ok(())
    }

    fn set_rem(&mut self, cube: Cube, new: u64) -> Result<(), IngestError> {
        match self.changes.get_mut(&cube.node_key()) {
            Some(Change::Here { rem, .. }) => *rem = new,
            Some(Change::Gone) => {}
            None => {
                if let Some(head) = self.head(cube) {
                    let change = Change::Here { leaf: head.leaf, rem: new, own: Own::Kept };
                    self.changes.insert(cube.node_key(), change);
                }
            }
        }
        Ok(())
    }

    fn delete(&mut self, cube: Cube) -> Result<(), IngestError> {
        if self.head(cube).is_some() {
            self.changes.insert(cube.node_key(), Change::Gone);
        } else {
            self.changes.remove(&cube.node_key());
        }
        Ok(())
    }

    fn bounds(&self, cube: Cube) -> Result<Option<LatticeBox>, IngestError> {
        let mut bounds: Option<LatticeBox> = None;
        let mut open = vec![cube];
        while let Some(cube) = open.pop() {
            let changed = self.changes.range(cube.node_key()..=cube.last_node_key()).next().is_some();
            let found = match (self.changes.get(&cube.node_key()), self.head(cube)) {
                (None, Some(head)) if !changed => Some(head.subtree_bounds),
                (Some(Change::Here { own: Own::New(points), .. }), _) => {
                    points.iter().map(|p| LatticeBox::of(p.key.point())).reduce(|a, b| a.union(&b))
                }
                (None | Some(Change::Here { .. }), head) => head.and_then(|h| h.own_bounds),
                (Some(Change::Gone), _) => None,
            };
            bounds = match (bounds, found) {
                (Some(a), Some(b)) => Some(a.union(&b)),
                (a, b) => a.or(b),
            };
            if changed {
                // A node that is gone may leave children: the abandoned chain of a root that shrinks.
                open.extend((0..8).filter_map(|octant| cube.child(octant)).filter(|c| self.reaches(*c)));
            }
        }
        Ok(bounds)
    }
}

impl Stored<'_> {
    /// Is anything at or below this cube, or was it changed?
    fn reaches(&self, cube: Cube) -> bool {
        self.changes.range(cube.node_key()..=cube.last_node_key()).next().is_some() || self.head(cube).is_some()
    }
}

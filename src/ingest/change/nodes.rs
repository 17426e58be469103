//! The nodes of one layer of a snapshot, under the changes that were made to them.

use super::super::IngestError;
use super::Ground;
use super::point::{Block, Point, ScanOrder};
use super::pool::Pool;
use crate::codec::Decoder;
use crate::lattice::{Cube, Key, LatticeBox, NodeKey, SortKey};
use crate::octree::{Nodes, Params, Row, TreePoint};
use crate::store::model::NodeHead;
use crate::store::{NodeIndex, NodeIx, Snapshot, decode_part, decode_part_keys};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

/// The stored points of the nodes that were read; each node is read once.
pub(super) struct Blocks {
    first: NodeIx,
    cells: Vec<OnceLock<Block>>,
    decoders: Pool<Decoder>,
}

impl Blocks {
    pub fn new(index: &NodeIndex, layer: u16) -> Self {
        let nodes = index.layer(layer);
        Self { first: nodes.start, cells: nodes.map(|_| OnceLock::new()).collect(), decoders: Pool::default() }
    }

    fn cell(&self, node: NodeIx) -> &OnceLock<Block> {
        &self.cells[(node - self.first) as usize]
    }
}

/// What became of a node.
#[derive(Debug)]
pub(super) enum Change<'a> {
    Gone,
    Here { leaf: bool, rem: u64, own: Own<'a> },
}

/// The points that a node stores.
#[derive(Clone, Debug)]
pub(super) enum Own<'a> {
    /// Those that the store has.
    Kept,
    /// These, ascending.
    New(Arc<Vec<Point<'a>>>),
}

/// See the module.
pub(super) struct Stored<'a> {
    snapshot: &'a Snapshot,
    pub index: &'a NodeIndex,
    pub layer: u16,
    scans: &'a Arc<ScanOrder>,
    blocks: &'a Blocks,
    changes: Mutex<BTreeMap<NodeKey, Change<'a>>>,
    cancelled: &'a (dyn Fn() -> bool + Sync),
}

impl<'a> Stored<'a> {
    pub fn new(ground: &Ground<'a>, layer: u16, blocks: &'a Blocks, cancelled: &'a (dyn Fn() -> bool + Sync)) -> Self {
        let Ground { snapshot, index, scans, .. } = *ground;
        Self { snapshot, index, layer, scans, blocks, changes: Mutex::default(), cancelled }
    }

    /// An error if the change is to stop.
    pub fn go_on(&self) -> Result<(), IngestError> {
        if (self.cancelled)() { Err(IngestError::Interrupted) } else { Ok(()) }
    }

    /// The row of the store.
    pub fn head(&self, cube: Cube) -> Option<&'a NodeHead> {
        self.index.find(self.layer, cube).map(|node| self.index.head(node))
    }

    /// What was changed, by node.
    pub fn changes(&self) -> MutexGuard<'_, BTreeMap<NodeKey, Change<'a>>> {
        // Every change is whole after one statement.
        self.changes.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The points of a node that was written.
    pub fn written(&self, cube: Cube) -> Option<Arc<Vec<Point<'a>>>> {
        match self.changes().get(&cube.node_key()) {
            Some(Change::Here { own: Own::New(points), .. }) => Some(points.clone()),
            _ => None,
        }
    }

    /// Reads, on all threads, nodes that are certain to receive at least one of `points`, which ascend: of two points in
    /// one of the parent's cells one goes down. Others are read when a point arrives.
    pub fn prefetch(&self, points: &[Point<'_>], params: Params) -> Result<(), IngestError> {
        let Some(root) = self.index.root(self.layer) else { return Ok(()) };
        let mut nodes = Vec::new();
        let mut open = vec![(root, super::inside(points, self.index.head(root).cube))];
        while let Some((node, points)) = open.pop() {
            let cell = params.cell(self.index.head(node).cube.k() + 1);
            if points.windows(2).any(|pair| pair[0].key().differing_digit(pair[1].key()) < cell) {
                nodes.push(node);
                let inside = |child| (child, super::inside(points, self.index.head(child).cube));
                open.extend(self.index.children(node).map(inside));
            }
        }
        self.read_all(nodes)
    }

    /// Reads the nodes whose row passes `test`, on all threads.
    pub fn prefetch_where(&self, test: impl Fn(&NodeHead) -> bool) -> Result<(), IngestError> {
        self.read_all(self.index.layer(self.layer).filter(|&node| test(self.index.head(node))).collect())
    }

    fn read_all(&self, nodes: Vec<NodeIx>) -> Result<(), IngestError> {
        nodes.into_par_iter().try_for_each(|node| self.block(node).map(drop))
    }

    fn block(&self, node: NodeIx) -> Result<&'a Block, IngestError> {
        let cell = self.blocks.cell(node);
        if let Some(block) = cell.get() {
            return Ok(block);
        }
        self.go_on()?;
        let head = self.index.head(node);
        let parts = self.blocks.decoders.lend(|decoder| {
            let parts = (0..head.parts.len()).map(|part| decode_part(self.snapshot, head, part, decoder));
            parts.collect::<Result<_, _>>()
        });
        let block = Block::of_parts(self.scans, head.cube, parts?)?;
        // Another thread may have been faster; it has read the same.
        Ok(cell.get_or_init(|| block))
    }

    fn stored_points(&self, cube: Cube) -> Result<Vec<Point<'a>>, IngestError> {
        let Some(node) = self.index.find(self.layer, cube) else { return Ok(Vec::new()) };
        if self.index.head(node).own_points == 0 {
            return Ok(Vec::new());
        }
        Ok(self.block(node)?.points().collect())
    }

    /// The keys of the points that a node stores, ascending. Of a node that was not read, the positions alone are.
    pub fn keys(&self, cube: Cube) -> Result<Vec<Key>, IngestError> {
        if let Some(points) = self.written(cube) {
            return Ok(points.iter().map(TreePoint::key).collect());
        }
        let Some(node) = self.index.find(self.layer, cube) else { return Ok(Vec::new()) };
        if let Some(block) = self.blocks.cell(node).get() {
            return Ok(block.points().map(|p| p.key()).collect());
        }
        let head = self.index.head(node);
        let mut decoder = Decoder::new();
        let mut keys = Vec::new();
        for part in 0..head.parts.len() {
            keys.append(&mut decode_part_keys(self.snapshot, head, part, &mut decoder)?);
        }
        keys.sort_unstable();
        Ok(keys)
    }

    /// Does the store have just these points in this node?
    pub fn has_just(&self, cube: Cube, points: &[Point<'_>]) -> bool {
        let block = self.index.find(self.layer, cube).and_then(|node| self.blocks.cell(node).get());
        block.is_some_and(|b| b.points().len() == points.len() && b.points().zip(points).all(|(a, b)| a.is(b)))
    }
}

impl<'a> Nodes for Stored<'a> {
    type Point = Point<'a>;
    type Error = IngestError;

    fn row(&self, cube: Cube) -> Result<Option<Row>, IngestError> {
        let stored = || self.head(cube);
        Ok(match self.changes().get(&cube.node_key()) {
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
        let written = match self.changes().get(&cube.node_key()) {
            Some(Change::Gone) => return Ok(Vec::new()),
            Some(Change::Here { own: Own::New(points), .. }) => Some(points.clone()),
            Some(Change::Here { own: Own::Kept, .. }) | None => None,
        };
        // Not under the lock, which all threads want.
        written.map_or_else(|| self.stored_points(cube), |points| Ok(points.to_vec()))
    }

    fn write(&self, cube: Cube, leaf: bool, rem: u64, points: Vec<Point<'a>>) -> Result<(), IngestError> {
        self.go_on()?;
        self.changes().insert(cube.node_key(), Change::Here { leaf, rem, own: Own::New(Arc::new(points)) });
        Ok(())
    }

    fn set_rem(&self, cube: Cube, new: u64) -> Result<(), IngestError> {
        let mut changes = self.changes();
        match changes.get_mut(&cube.node_key()) {
            Some(Change::Here { rem, .. }) => *rem = new,
            Some(Change::Gone) => {}
            None => {
                if let Some(head) = self.head(cube) {
                    let change = Change::Here { leaf: head.leaf, rem: new, own: Own::Kept };
                    changes.insert(cube.node_key(), change);
                }
            }
        }
        Ok(())
    }

    fn delete(&self, cube: Cube) -> Result<(), IngestError> {
        if self.head(cube).is_some() {
            self.changes().insert(cube.node_key(), Change::Gone);
        } else {
            self.changes().remove(&cube.node_key());
        }
        Ok(())
    }

    fn bounds(&self, cube: Cube) -> Result<Option<LatticeBox>, IngestError> {
        let changes = self.changes();
        let reaches = |cube: Cube| {
            changes.range(cube.node_key()..=cube.last_node_key()).next().is_some() || self.head(cube).is_some()
        };
        let mut bounds: Option<LatticeBox> = None;
        let mut open = vec![cube];
        while let Some(cube) = open.pop() {
            let changed = changes.range(cube.node_key()..=cube.last_node_key()).next().is_some();
            let found = match (changes.get(&cube.node_key()), self.head(cube)) {
                (None, Some(head)) if !changed => Some(head.subtree_bounds),
                (Some(Change::Here { own: Own::New(points), .. }), _) => {
                    points.iter().map(|p| LatticeBox::of(p.key().point())).reduce(|a, b| a.union(&b))
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
                open.extend((0..8).filter_map(|octant| cube.child(octant)).filter(|c| reaches(*c)));
            }
        }
        Ok(bounds)
    }
}

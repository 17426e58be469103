//! The nodes of one layer of a snapshot, under the changes that were made to them.

use super::super::IngestError;
use super::super::progress::Progress;
use super::Ground;
use super::point::{Block, Point, ScanOrder};
use super::pool::Pool;
use crate::codec::Decoder;
use crate::lattice::{Cube, Key, LatticeBox, NodeKey, SortKey};
use crate::octree::{Nodes, Params, Row, TreePoint};
use crate::store::model::NodeHead;
use crate::store::{self, NodeIx, Snapshot, decode_part, decode_part_keys};
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, RwLock};

/// Neighbouring nodes whose cells are made together.
const CELLS: usize = 64;

/// The stored points of the nodes that were read; each node is read once.
pub(super) struct Blocks {
    /// By the nodes' numbers; those of most nodes are never made.
    cells: Vec<OnceLock<Box<[OnceLock<Block>]>>>,
    decoders: Pool<Decoder>,
}

impl Blocks {
    pub fn new(nodes: &store::Nodes) -> Self {
        let groups = usize::try_from(nodes.len()).unwrap_or(usize::MAX).div_ceil(CELLS);
        Self { cells: (0..groups).map(|_| OnceLock::new()).collect(), decoders: Pool::default() }
    }

    fn cell(&self, node: NodeIx) -> &OnceLock<Block> {
        let group = self.cells[node as usize / CELLS].get_or_init(|| (0..CELLS).map(|_| OnceLock::new()).collect());
        &group[node as usize % CELLS]
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
    nodes: store::Nodes,
    pub layer: u16,
    scans: &'a Arc<ScanOrder>,
    blocks: &'a Blocks,
    /// The store's rows that were looked for, also in vain.
    known: RwLock<HashMap<NodeKey, Option<store::Node>>>,
    changes: Mutex<BTreeMap<NodeKey, Change<'a>>>,
    progress: &'a dyn Progress,
}

impl<'a> Stored<'a> {
    pub fn new(ground: &Ground<'a>, layer: u16, blocks: &'a Blocks, progress: &'a dyn Progress) -> Self {
        let Ground { snapshot, scans, .. } = *ground;
        let (nodes, known) = (snapshot.nodes(), RwLock::default());
        Self { snapshot, nodes, layer, scans, blocks, known, changes: Mutex::default(), progress }
    }

    /// So many points are encoded.
    pub fn advance(&self, points: usize) {
        self.progress.advance(points as u64);
    }

    /// An error if the change is to stop.
    pub fn go_on(&self) -> Result<(), IngestError> {
        if self.progress.cancelled() { Err(IngestError::Interrupted) } else { Ok(()) }
    }

    /// The row of the store.
    pub fn stored(&self, cube: Cube) -> Result<Option<store::Node>, IngestError> {
        let key = cube.node_key();
        if let Some(known) = self.known.read().unwrap_or_else(PoisonError::into_inner).get(&key) {
            return Ok(known.clone());
        }
        let found = self.nodes.find(self.layer, cube)?;
        self.known.write().unwrap_or_else(PoisonError::into_inner).insert(key, found.clone());
        Ok(found)
    }

    /// What was changed, by node.
    pub fn changes(&self) -> MutexGuard<'_, BTreeMap<NodeKey, Change<'a>>> {
        // Every change is whole after one statement.
        self.changes.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Points of all nodes that were written.
    pub fn written_points(&self) -> u64 {
        let points = |change: &Change<'_>| match change {
            Change::Here { own: Own::New(points), .. } => points.len() as u64,
            Change::Here { own: Own::Kept, .. } | Change::Gone => 0,
        };
        self.changes().values().map(points).sum()
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
        let Some(root) = self.nodes.root(self.layer)? else { return Ok(()) };
        let mut certain = Vec::new();
        let mut open = vec![(super::inside(points, root.cube), root)];
        while let Some((points, node)) = open.pop() {
            let cell = params.cell(node.cube.k() + 1);
            if points.windows(2).any(|pair| pair[0].key().differing_digit(pair[1].key()) < cell) {
                open.extend(self.nodes.children(&node)?.map(|child| (super::inside(points, child.cube), child)));
                certain.push(node);
            }
        }
        self.read_all(&certain)
    }

    /// Reads, on all threads, the nodes whose row passes `own`, of subtrees whose row passes `any`.
    pub fn prefetch_where(
        &self,
        own: impl Fn(&NodeHead) -> bool,
        any: impl Fn(&NodeHead) -> bool,
    ) -> Result<(), IngestError> {
        let mut found = Vec::new();
        let mut open: Vec<store::Node> = self.nodes.root(self.layer)?.into_iter().collect();
        while let Some(node) = open.pop().filter(|node| any(node)) {
            open.extend(self.nodes.children(&node)?.filter(|child| any(child)));
            if own(&node) {
                found.push(node);
            }
        }
        self.read_all(&found)
    }

    fn read_all(&self, nodes: &[store::Node]) -> Result<(), IngestError> {
        nodes.par_iter().try_for_each(|node| self.block(node).map(drop))
    }

    fn block(&self, node: &store::Node) -> Result<&'a Block, IngestError> {
        let cell = self.blocks.cell(node.ix());
        if let Some(block) = cell.get() {
            return Ok(block);
        }
        self.go_on()?;
        let parts = self.blocks.decoders.lend(|decoder| {
            let parts = (0..node.parts.len()).map(|part| decode_part(self.snapshot, node, part, decoder));
            parts.collect::<Result<_, _>>()
        });
        let block = Block::of_parts(self.scans, node.cube, parts?)?;
        // Another thread may have been faster; it has read the same.
        Ok(cell.get_or_init(|| block))
    }

    fn stored_points(&self, cube: Cube) -> Result<Vec<Point<'a>>, IngestError> {
        match self.stored(cube)? {
            Some(node) if node.own_points > 0 => Ok(self.block(&node)?.points().collect()),
            _ => Ok(Vec::new()),
        }
    }

    /// The keys of the points that a node stores, ascending. Of a node that was not read, the positions alone are.
    pub fn keys(&self, cube: Cube) -> Result<Vec<Key>, IngestError> {
        if let Some(points) = self.written(cube) {
            return Ok(points.iter().map(TreePoint::key).collect());
        }
        let Some(node) = self.stored(cube)? else { return Ok(Vec::new()) };
        if let Some(block) = self.blocks.cell(node.ix()).get() {
            return Ok(block.points().map(|p| p.key()).collect());
        }
        let mut decoder = Decoder::new();
        let mut keys = Vec::new();
        for part in 0..node.parts.len() {
            keys.append(&mut decode_part_keys(self.snapshot, &node, part, &mut decoder)?);
        }
        keys.sort_unstable();
        Ok(keys)
    }

    /// Does the store have just these points in this node?
    pub fn has_just(&self, node: &store::Node, points: &[Point<'_>]) -> bool {
        let block = self.blocks.cell(node.ix()).get();
        block.is_some_and(|b| b.points().len() == points.len() && b.points().zip(points).all(|(a, b)| a.is(b)))
    }
}

impl<'a> Nodes for Stored<'a> {
    type Point = Point<'a>;
    type Error = IngestError;

    fn row(&self, cube: Cube) -> Result<Option<Row>, IngestError> {
        let changed = match self.changes().get(&cube.node_key()) {
            Some(Change::Gone) => return Ok(None),
            Some(Change::Here { leaf, rem, own: Own::New(points) }) => {
                return Ok(Some(Row { leaf: *leaf, rem: *rem, own: points.len() as u64 }));
            }
            Some(Change::Here { leaf, rem, own: Own::Kept }) => Some((*leaf, *rem)),
            None => None,
        };
        // Not under the lock, which all threads want.
        let stored = self.stored(cube)?;
        let own = stored.as_ref().map_or(0, |node| node.own_points);
        let unchanged = stored.map(|node| (node.leaf, node.subtree_points));
        Ok(changed.or(unchanged).map(|(leaf, rem)| Row { leaf, rem, own }))
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
        let stored = self.stored(cube)?;
        let mut changes = self.changes();
        match (changes.get_mut(&cube.node_key()), stored) {
            (Some(Change::Here { rem, .. }), _) => *rem = new,
            (None, Some(node)) => {
                changes.insert(cube.node_key(), Change::Here { leaf: node.leaf, rem: new, own: Own::Kept });
            }
            (Some(Change::Gone), _) | (None, None) => {}
        }
        Ok(())
    }

    fn delete(&self, cube: Cube) -> Result<(), IngestError> {
        if self.stored(cube)?.is_some() {
            self.changes().insert(cube.node_key(), Change::Gone);
        } else {
            self.changes().remove(&cube.node_key());
        }
        Ok(())
    }

    fn bounds(&self, cube: Cube) -> Result<Option<LatticeBox>, IngestError> {
        let changes = self.changes();
        let is_changed = |cube: Cube| changes.range(cube.node_key()..=cube.last_node_key()).next().is_some();
        let mut bounds: Option<LatticeBox> = None;
        let mut open = vec![cube];
        while let Some(cube) = open.pop() {
            let changed = is_changed(cube);
            let found = match (changes.get(&cube.node_key()), self.stored(cube)?) {
                (None, Some(node)) if !changed => Some(node.subtree_bounds),
                (Some(Change::Here { own: Own::New(points), .. }), _) => {
                    points.iter().map(|p| LatticeBox::of(p.key().point())).reduce(|a, b| a.union(&b))
                }
                (None | Some(Change::Here { .. }), node) => node.and_then(|node| node.own_bounds),
                (Some(Change::Gone), _) => None,
            };
            bounds = match (bounds, found) {
                (Some(a), Some(b)) => Some(a.union(&b)),
                (a, b) => a.or(b),
            };
            if changed {
                // A node that is gone may leave children: the abandoned chain of a root that shrinks.
                for child in (0..8).filter_map(|octant| cube.child(octant)) {
                    if is_changed(child) || self.stored(child)?.is_some() {
                        open.push(child);
                    }
                }
            }
        }
        Ok(bounds)
    }
}

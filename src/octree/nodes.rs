//! Where the nodes of a tree are: the storage that changes run on, and the one in memory.

use crate::lattice::{Cube, Key, LatticeBox, NodeKey};
use std::collections::{BTreeMap, BTreeSet};
use std::convert::Infallible;
use std::ops::Deref;
use std::sync::{Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

/// A point of a tree. Its order is by key, then record bytes, then scan; points equal in all of that are interchangeable.
pub trait TreePoint: Clone + Ord + Send + Sync {
    /// The key of its position: `a < b` implies `a.key() <= b.key()`.
    fn key(&self) -> Key;
}

/// What is known of a node without reading its points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Row {
    /// Does it store everything that remains in its cube?
    pub leaf: bool,
    /// Points stored here or below.
    pub rem: u64,
    /// Points stored here.
    pub own: u64,
}

/// The nodes of one tree. Changes are seen by later calls; those of disjoint subtrees may come from several threads at
/// once.
pub trait Nodes: Sync {
    /// The points.
    type Point: TreePoint;
    /// What can go wrong.
    type Error: Send;

    /// The row of the node of this cube; `None` if there is no such node.
    ///
    /// # Errors
    ///
    /// The storage's.
    fn row(&self, cube: Cube) -> Result<Option<Row>, Self::Error>;
    /// The points stored in an existing node, ascending: a read of payload.
    ///
    /// # Errors
    ///
    /// The storage's.
    fn read(&self, cube: Cube) -> Result<Vec<Self::Point>, Self::Error>;
    /// Creates or replaces a node; `points` are ascending.
    ///
    /// # Errors
    ///
    /// The storage's.
    fn write(&self, cube: Cube, leaf: bool, rem: u64, points: Vec<Self::Point>) -> Result<(), Self::Error>;
    /// Changes only how many points remain in an existing node's cube.
    ///
    /// # Errors
    ///
    /// The storage's.
    fn set_rem(&self, cube: Cube, rem: u64) -> Result<(), Self::Error>;
    /// Removes a node, not its descendants.
    ///
    /// # Errors
    ///
    /// The storage's.
    fn delete(&self, cube: Cube) -> Result<(), Self::Error>;
    /// Tight bounds of the points stored in an existing node or below, without reading them.
    ///
    /// # Errors
    ///
    /// The storage's.
    fn bounds(&self, cube: Cube) -> Result<Option<LatticeBox>, Self::Error>;
}

/// A node in memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Node<P> {
    /// Does it store everything that remains in its cube?
    pub leaf: bool,
    /// Points stored here or below.
    pub rem: u64,
    /// Its own points, ascending.
    pub points: Vec<P>,
}

/// Nodes in memory, with a record of whose points were read.
#[derive(Debug)]
pub struct MemoryNodes<P> {
    nodes: RwLock<BTreeMap<NodeKey, Node<P>>>,
    reads: Mutex<BTreeSet<NodeKey>>,
}

impl<P> Default for MemoryNodes<P> {
    fn default() -> Self {
        Self { nodes: RwLock::default(), reads: Mutex::default() }
    }
}

impl<P: TreePoint> Clone for MemoryNodes<P> {
    fn clone(&self) -> Self {
        Self { nodes: RwLock::new(self.nodes().clone()), reads: Mutex::new(self.reads().clone()) }
    }
}

impl<P: TreePoint> MemoryNodes<P> {
    /// All nodes, in pre-order.
    pub fn all(&self) -> impl Deref<Target = BTreeMap<NodeKey, Node<P>>> {
        self.nodes()
    }

    /// The nodes whose points were read since the last call.
    pub fn take_reads(&self) -> BTreeSet<NodeKey> {
        std::mem::take(&mut *self.reads())
    }

    /// How many points that pass `test` the node of `cube` stores itself, and with all below it. Stands for what rows
    /// say of each scan: not a read of payload.
    pub fn count(&self, cube: Cube, test: impl Fn(&P) -> bool) -> (u64, u64) {
        let passing = |node: &Node<P>| node.points.iter().filter(|p| test(p)).count() as u64;
        let nodes = self.nodes();
        let own = nodes.get(&cube.node_key()).map_or(0, passing);
        (own, nodes.range(cube.node_key()..=cube.last_node_key()).map(|(_, node)| passing(node)).sum())
    }

    fn nodes(&self) -> RwLockReadGuard<'_, BTreeMap<NodeKey, Node<P>>> {
        self.nodes.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn nodes_mut(&self) -> RwLockWriteGuard<'_, BTreeMap<NodeKey, Node<P>>> {
        self.nodes.write().unwrap_or_else(PoisonError::into_inner)
    }

    fn reads(&self) -> MutexGuard<'_, BTreeSet<NodeKey>> {
        self.reads.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<P: TreePoint> Nodes for MemoryNodes<P> {
    type Point = P;
    type Error = Infallible;

    fn row(&self, cube: Cube) -> Result<Option<Row>, Infallible> {
        let row = |n: &Node<P>| Row { leaf: n.leaf, rem: n.rem, own: n.points.len() as u64 };
        Ok(self.nodes().get(&cube.node_key()).map(row))
    }

    fn read(&self, cube: Cube) -> Result<Vec<P>, Infallible> {
        let key = cube.node_key();
        self.reads().insert(key);
        Ok(self.nodes().get(&key).map_or_else(Vec::new, |n| n.points.clone()))
    }

    fn write(&self, cube: Cube, leaf: bool, rem: u64, points: Vec<P>) -> Result<(), Infallible> {
        self.nodes_mut().insert(cube.node_key(), Node { leaf, rem, points });
        Ok(())
    }

    fn set_rem(&self, cube: Cube, rem: u64) -> Result<(), Infallible> {
        if let Some(node) = self.nodes_mut().get_mut(&cube.node_key()) {
            node.rem = rem;
        }
        Ok(())
    }

    fn delete(&self, cube: Cube) -> Result<(), Infallible> {
        self.nodes_mut().remove(&cube.node_key());
        Ok(())
    }

    fn bounds(&self, cube: Cube) -> Result<Option<LatticeBox>, Infallible> {
        let nodes = self.nodes();
        let below = nodes.range(cube.node_key()..=cube.last_node_key()).flat_map(|(_, node)| &node.points);
        Ok(below.map(|p| LatticeBox::of(p.key().point())).reduce(|a, b| a.union(&b)))
    }
}

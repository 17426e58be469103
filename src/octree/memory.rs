//! A tree in memory and what can be taken out of it, for tests of the rules alone.

use super::Params;
use super::nodes::{Nodes, Row, TreePoint};
use super::remove::Doomed;
use super::tree::Tree;
use crate::lattice::{Cube, LatticeBox, NodeKey};
use std::collections::{BTreeMap, BTreeSet};
use std::convert::Infallible;
use std::ops::Deref;
use std::sync::{Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

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

/// A tree in memory.
pub type MemoryTree<P> = Tree<MemoryNodes<P>>;

impl<P: TreePoint> MemoryTree<P> {
    /// Builds the tree of `points` in memory.
    pub fn of(points: Vec<P>, params: Params) -> Self {
        let mut tree = Self::existing(params, None, MemoryNodes::default());
        match tree.rebuild(points) {
            Ok(()) => tree,
            Err(never) => match never {},
        }
    }
}

/// All points that pass a test go: those of a scan, say.
#[derive(Clone, Copy, Debug)]
pub struct Matching<F>(pub F);

impl<P: TreePoint, F: Fn(&P) -> bool + Sync> Doomed<MemoryNodes<P>> for Matching<F> {
    fn own(&self, nodes: &MemoryNodes<P>, cube: Cube) -> Result<u64, Infallible> {
        Ok(nodes.count(cube, &self.0).0)
    }

    fn subtree(&self, nodes: &MemoryNodes<P>, cube: Cube) -> Result<u64, Infallible> {
        Ok(nodes.count(cube, &self.0).1)
    }

    fn takes(&self, point: &P) -> bool {
        self.0(point)
    }
}

/// These points go, each request once: of several identical points no more than are asked for.
#[derive(Debug)]
pub struct Requests<P>(Mutex<BTreeMap<P, u64>>);

impl<P: Ord> FromIterator<P> for Requests<P> {
    fn from_iter<I: IntoIterator<Item = P>>(points: I) -> Self {
        let mut requests = BTreeMap::new();
        points.into_iter().for_each(|p| *requests.entry(p).or_default() += 1);
        Self(Mutex::new(requests))
    }
}

impl<P> Requests<P> {
    fn left(&self) -> MutexGuard<'_, BTreeMap<P, u64>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<P: TreePoint> Doomed<MemoryNodes<P>> for Requests<P> {
    fn own(&self, nodes: &MemoryNodes<P>, cube: Cube) -> Result<u64, Infallible> {
        Ok(nodes.count(cube, |p| self.left().contains_key(p)).0)
    }

    fn subtree(&self, nodes: &MemoryNodes<P>, cube: Cube) -> Result<u64, Infallible> {
        Ok(nodes.count(cube, |p| self.left().contains_key(p)).1)
    }

    fn takes(&self, point: &P) -> bool {
        let mut requests = self.left();
        let Some(left) = requests.get_mut(point) else { return false };
        *left -= 1;
        if *left == 0 {
            requests.remove(point);
        }
        true
    }
}

//! Where the nodes of a tree are: the storage that changes run on.

use crate::lattice::{Cube, Key, LatticeBox};

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

//! Is the tree whole after a flip? Looked at where nodes were written or removed.
//!
//! Before the flip the tree was whole: what a row said of its subtree was what its children's rows said. That goes on to
//! hold wherever neither the row nor one of its children has changed, so it is enough to look at the rows that changed
//! and at those above them. Nodes that nothing leads to are seen by the count of all.

use super::error::RowError;
use super::model::NodeHead;
use super::nodes::roots_of;
use super::rows::{self, SiteRow};
use super::tree_check::{Sum, check_alone, damage};
use crate::lattice::{BITS, Cube, NodeKey};
use rusqlite::Connection;
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

/// Nodes that were written or removed, and those above them: what is to be looked at.
#[derive(Debug, Default)]
pub(super) struct Changed(BTreeSet<(u16, NodeKey)>);

impl Changed {
    /// This node was written or removed.
    pub fn note(&mut self, layer: u16, cube: Cube) {
        self.0.insert((layer, cube.node_key()));
        if cube.k() < BITS {
            self.0.insert((layer, cube.ancestor(cube.k() + 1).node_key()));
        }
    }
}

/// Reads the rows back that changed and what lies next to them; gives the rows of all roots.
pub(super) fn check(connection: &Connection, site: &SiteRow, changed: &Changed) -> Result<Vec<NodeHead>, RowError> {
    let mut known: BTreeMap<(u16, NodeKey), Option<Rc<NodeHead>>> = BTreeMap::new();
    let mut read = |layer: u16, cube: Cube| {
        Ok::<_, RowError>(match known.entry((layer, cube.node_key())) {
            Entry::Occupied(known) => known.get().clone(),
            Entry::Vacant(new) => new.insert(rows::load_node(connection, layer, cube)?.map(Rc::new)).clone(),
        })
    };
    for &(layer, key) in &changed.0 {
        let Some(cube) = Cube::from_node_key(&key) else { continue };
        // A node that is gone, or that there never was above a root.
        let Some(head) = read(layer, cube)? else { continue };
        check_alone(&head, site)?;
        let mut sum = Sum::of(&head);
        for child in (0..8).filter(|octant| head.children & 1 << octant != 0).filter_map(|octant| cube.child(octant)) {
            let child = read(layer, child)?.ok_or_else(|| damage(&head, "a child that it names is missing"))?;
            sum.add(&head, &child)?;
        }
        sum.check(&head)?;
    }
    roots_of(connection, site)
}

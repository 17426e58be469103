//! The whole tree of a snapshot at once, for work on all of it; what looks at some of it asks `nodes`.

use super::error::RowError;
use super::model::NodeHead;
use super::rows::{SiteRow, load_nodes};
use super::tree_check::Checker;
use crate::lattice::Cube;
use rusqlite::Connection;
use std::ops::Range;

/// Position of a node in a [`NodeIndex`].
pub type NodeIx = u32;

/// All nodes of all layers, by layer and within a layer in pre-order (of node keys: plain octant order).
///
/// Its tree is known to be whole: every child that a node names is there and no other, counts and bounds of a subtree
/// are those of its parts.
#[derive(Debug, Default)]
pub struct NodeIndex {
    heads: Vec<NodeHead>,
    /// The node after the subtree.
    ends: Vec<NodeIx>,
    parents: Vec<Option<NodeIx>>,
    layers: Vec<Range<NodeIx>>,
}

impl NodeIndex {
    /// The number of nodes.
    pub fn len(&self) -> usize {
        self.heads.len()
    }

    /// No nodes?
    pub fn is_empty(&self) -> bool {
        self.heads.is_empty()
    }

    /// All heads.
    pub fn heads(&self) -> &[NodeHead] {
        &self.heads
    }

    /// The head of a node.
    ///
    /// # Panics
    ///
    /// If there is no such node.
    pub fn head(&self, node: NodeIx) -> &NodeHead {
        &self.heads[node as usize]
    }

    /// The number of layers, empty ones included.
    pub fn layers(&self) -> usize {
        self.layers.len()
    }

    /// The nodes of a layer; none if there is no such layer.
    pub fn layer(&self, layer: u16) -> Range<NodeIx> {
        self.layers.get(usize::from(layer)).cloned().unwrap_or(0..0)
    }

    /// The root of a layer.
    pub fn root(&self, layer: u16) -> Option<NodeIx> {
        Some(self.layer(layer)).filter(|r| !r.is_empty()).map(|r| r.start)
    }

    /// The roots of all layers that have one.
    pub fn roots(&self) -> impl Iterator<Item = NodeIx> + '_ {
        self.layers.iter().filter(|r| !r.is_empty()).map(|r| r.start)
    }

    /// The node and all below it.
    ///
    /// # Panics
    ///
    /// If there is no such node.
    pub fn subtree(&self, node: NodeIx) -> Range<NodeIx> {
        node..self.ends[node as usize]
    }

    /// The parent; none for a root.
    ///
    /// # Panics
    ///
    /// If there is no such node.
    pub fn parent(&self, node: NodeIx) -> Option<NodeIx> {
        self.parents[node as usize]
    }

    /// The children, in octant order.
    ///
    /// # Panics
    ///
    /// If there is no such node.
    pub fn children(&self, node: NodeIx) -> impl Iterator<Item = NodeIx> + '_ {
        let Range { start, end } = self.subtree(node);
        let below = move |at: NodeIx| (at < end).then_some(at);
        std::iter::successors(below(start + 1), move |&child| below(self.ends[child as usize]))
    }

    /// The node of a cube.
    pub fn find(&self, layer: u16, cube: Cube) -> Option<NodeIx> {
        let Range { start, end } = self.layer(layer);
        let nodes = &self.heads[start as usize..end as usize];
        let found = nodes.binary_search_by_key(&cube.node_key(), |h| h.cube.node_key());
        found.ok().map(|i| start + i as NodeIx)
    }

    /// Reads and checks all nodes. What is damaged is left out, with all that lies below it, and told: the index is
    /// whole only if nothing is.
    pub(super) fn load(connection: &Connection, site: &SiteRow) -> (Self, Vec<RowError>) {
        let mut checker = Checker::new(site);
        let loaded = load_nodes(connection, |head| match head {
            Ok(head) => checker.push(head),
            Err(e) => checker.damage.push(e),
        });
        checker.damage.extend(loaded.err());
        checker.close();
        let Checker { heads, parents, mut damage, .. } = checker;
        let index = Self::of(heads, parents, site.site.roots.len());
        for (layer, root) in site.site.roots.iter().enumerate() {
            if root.is_some() && index.layers[layer].is_empty() {
                damage.push(RowError::damage("node", format!("layer {layer}"), "the root is missing"));
            }
        }
        let (found, expected) = (index.heads.len() as u64, site.nodes);
        if found != expected && damage.is_empty() {
            let what = format!("there are {found}, but {expected} were written");
            damage.push(RowError::damage("node", "all rows", what));
        }
        (index, damage)
    }

    /// Of nodes in pre-order, by layer.
    fn of(heads: Vec<NodeHead>, parents: Vec<Option<NodeIx>>, layers: usize) -> Self {
        // Not from the rows' own counts: of a damaged tree some nodes are missing.
        let mut ends: Vec<NodeIx> = (1..=heads.len() as NodeIx).collect();
        for node in (0..heads.len()).rev() {
            if let Some(parent) = parents[node] {
                ends[parent as usize] = ends[parent as usize].max(ends[node]);
            }
        }
        let from = |layer: usize| heads.partition_point(|h| usize::from(h.layer) < layer) as NodeIx;
        let layers = (0..layers).map(|layer| from(layer)..from(layer + 1)).collect();
        Self { heads, ends, parents, layers }
    }
}

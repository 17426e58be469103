//! The tree of a snapshot: all node heads in pre-order, their structure checked.

use super::error::RowError;
use super::model::{NodeHead, ScanCount};
use super::rows::{SiteRow, load_nodes};
use crate::lattice::{Cube, LatticeBox};
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
        let mut builder = Builder { site, index: Self::default(), path: Vec::new(), damage: Vec::new() };
        let loaded = load_nodes(connection, |head| {
            let pushed = head.and_then(|head| builder.push(head));
            builder.damage.extend(pushed.err());
        });
        builder.damage.extend(loaded.err());
        builder.finish()
    }
}

/// Checks each node against the path above it, in pre-order.
struct Builder<'a> {
    site: &'a SiteRow,
    index: NodeIndex,
    /// From a root down to the last node: what is still missing of each.
    path: Vec<Open>,
    damage: Vec<RowError>,
}

/// A node whose subtree is not complete yet.
struct Open {
    node: NodeIx,
    children_seen: u8,
    points: u64,
    scans: Vec<ScanCount>,
    bounds: Option<LatticeBox>,
}

fn damage(head: &NodeHead, what: impl Into<String>) -> RowError {
    RowError::damage("node", super::rows::name_of(head), what)
}

impl Builder<'_> {
    fn push(&mut self, head: NodeHead) -> Result<(), RowError> {
        let layer = usize::from(head.layer);
        if layer >= self.site.site.roots.len() {
            return Err(damage(&head, "the site has no such layer"));
        }
        if layer >= self.index.layers.len() {
            self.close_all();
            self.open_layers(layer);
        }
        while self.path.last().is_some_and(|open| !self.index.head(open.node).cube.contains_cube(head.cube)) {
            self.close_last();
        }
        check_alone(&head, self.site)?;
        let node = self.index.heads.len() as NodeIx;
        let parent = match self.path.last_mut() {
            Some(open) => {
                let parent = &self.index.heads[open.node as usize];
                let bit = 1 << head.cube.octant();
                if parent.cube.k() != head.cube.k() + 1 || parent.children & bit == 0 {
                    return Err(damage(&head, "its parent is missing or does not name it"));
                }
                open.children_seen |= bit;
                Some(open.node)
            }
            None if self.site.site.roots[layer] == Some(head.cube) => None,
            None => return Err(damage(&head, "is neither the root of its layer nor below it")),
        };
        self.path.push(Open {
            node,
            children_seen: 0,
            points: head.own_points,
            scans: head.scans.iter().map(|s| ScanCount { subtree: s.own, ..*s }).collect(),
            bounds: head.own_bounds,
        });
        self.index.heads.push(head);
        self.index.parents.push(parent);
        self.index.ends.push(node + 1);
        Ok(())
    }

    /// Layers without nodes before `layer`, then that one.
    fn open_layers(&mut self, layer: usize) {
        let here = self.index.heads.len() as NodeIx;
        self.index.layers.resize(layer + 1, here..here);
    }

    fn close_all(&mut self) {
        while !self.path.is_empty() {
            self.close_last();
        }
    }

    /// The last node of the path is complete: is it what its row says?
    fn close_last(&mut self) {
        let Some(open) = self.path.pop() else { return };
        let end = self.index.heads.len() as NodeIx;
        self.index.ends[open.node as usize] = end;
        if let Some(layer) = self.index.layers.last_mut() {
            layer.end = end;
        }
        let head = &self.index.heads[open.node as usize];
        let missing = head.children & !open.children_seen;
        let same_scans = open.scans.iter().filter(|s| s.subtree > 0).eq(&head.scans);
        self.damage.extend(if missing != 0 {
            Some(damage(head, format!("the child in octant {} is missing", missing.trailing_zeros())))
        } else if open.points != head.subtree_points || open.bounds != Some(head.subtree_bounds) || !same_scans {
            Some(damage(head, "counts or bounds of the subtree are not those of its parts"))
        } else {
            None
        });
        // What the row says goes up, so that one damage is told once.
        let Some(parent) = self.path.last_mut() else { return };
        parent.points = parent.points.saturating_add(head.subtree_points);
        let bounds = head.subtree_bounds;
        parent.bounds = Some(parent.bounds.map_or(bounds, |p| p.union(&bounds)));
        for scan in &head.scans {
            match parent.scans.binary_search_by_key(&scan.scan, |s| s.scan) {
                Ok(i) => parent.scans[i].subtree = parent.scans[i].subtree.saturating_add(scan.subtree),
                Err(i) => parent.scans.insert(i, ScanCount { own: 0, ..*scan }),
            }
        }
    }

    fn finish(mut self) -> (NodeIndex, Vec<RowError>) {
        self.close_all();
        let layers = self.site.site.roots.len();
        if self.index.layers.len() < layers {
            self.open_layers(layers - 1);
        }
        for (layer, root) in self.site.site.roots.iter().enumerate() {
            if root.is_some() && self.index.layers[layer].is_empty() {
                self.damage.push(RowError::damage("node", format!("layer {layer}"), "the root is missing"));
            }
        }
        let (found, expected) = (self.index.heads.len() as u64, self.site.nodes);
        if found != expected && self.damage.is_empty() {
            let what = format!("there are {found}, but {expected} were written");
            self.damage.push(RowError::damage("node", "all rows", what));
        }
        (self.index, self.damage)
    }
}

/// What must hold of a node by itself.
fn check_alone(head: &NodeHead, site: &SiteRow) -> Result<(), RowError> {
    let holds = |ok: bool, what: &str| if ok { Ok(()) } else { Err(damage(head, what)) };
    let cube = head.cube.to_box();
    holds(head.cube.k() >= site.site.g, "the cube is smaller than the sampling grid")?;
    holds(!(head.leaf && head.children != 0), "a leaf has children")?;
    holds(head.subtree_points > 0, "the subtree has no points")?;
    holds(cube.contains_box(&head.subtree_bounds), "the subtree's bounds are not in the cube")?;
    holds(head.own_bounds.is_some() == (head.own_points > 0), "own bounds without own points, or the reverse")?;
    holds(head.own_bounds.is_none_or(|b| head.subtree_bounds.contains_box(&b)), "own bounds are not in the subtree's")?;
    holds(head.scans.is_sorted_by(|a, b| a.scan < b.scan), "the scans are not ascending")?;
    let own: u128 = head.scans.iter().map(|s| u128::from(s.own)).sum();
    let subtree: u128 = head.scans.iter().map(|s| u128::from(s.subtree)).sum();
    holds(own == head.own_points.into(), "the own points are not those of the scans")?;
    holds(subtree == head.subtree_points.into(), "the subtree's points are not those of the scans")?;
    let parts: u64 = head.parts.iter().map(|p| u64::from(p.points)).sum();
    holds(parts == head.own_points, "the parts do not hold the own points")?;
    holds(head.parts.iter().all(|p| p.points > 0), "a part is empty")?;
    let ids = head.chunk_ids();
    holds(0 <= ids.start && ids.end <= site.next_chunk, "the chunk rows' ids were never given out")
}

//! The tree of a snapshot: all node heads in pre-order, their structure checked.

use super::error::RowError;
use super::model::{NodeHead, ScanCount};
use super::rows::{SiteRow, load_nodes};
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

    /// Reads and checks all nodes.
    pub(super) fn load(connection: &Connection, site: &SiteRow) -> Result<Self, RowError> {
        let mut builder = Builder::new(site);
        load_nodes(connection, |head| builder.push(head?))?;
        builder.finish()
    }
}

/// Checks each node against the path above it, in pre-order.
struct Builder<'a> {
    site: &'a SiteRow,
    index: NodeIndex,
    /// From a root down to the last node: what is still missing of each.
    path: Vec<Open>,
}

/// A node whose subtree is not complete yet.
struct Open {
    node: NodeIx,
    children_seen: u8,
    points: u64,
    scans: Vec<ScanCount>,
    bounds: Option<crate::lattice::LatticeBox>,
}

fn damage(head: &NodeHead, what: impl Into<String>) -> RowError {
    RowError::damage("node", super::rows::name_of(head), what)
}

impl<'a> Builder<'a> {
    fn new(site: &'a SiteRow) -> Self {
        Self { site, index: NodeIndex::default(), path: Vec::new() }
    }

    fn push(&mut self, head: NodeHead) -> Result<(), RowError> {
        let layer = usize::from(head.layer);
        if layer >= self.site.site.roots.len() {
            return Err(damage(&head, "the site has no such layer"));
        }
        if layer >= self.index.layers.len() {
            self.close_to(0)?;
            self.open_layers(layer)?;
        }
        while self.path.last().is_some_and(|open| !self.head(open).cube.contains_cube(head.cube)) {
            self.close_last()?;
        }
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
        check_alone(&head, self.site)?;
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

    fn head(&self, open: &Open) -> &NodeHead {
        &self.index.heads[open.node as usize]
    }

    /// Empty layers up to `layer`, then that one.
    fn open_layers(&mut self, layer: usize) -> Result<(), RowError> {
        let here = self.index.heads.len() as NodeIx;
        for empty in self.index.layers.len()..layer {
            if self.site.site.roots[empty].is_some() {
                return Err(RowError::damage("node", format!("layer {empty}"), "the root is missing"));
            }
            self.index.layers.push(here..here);
        }
        self.index.layers.push(here..here);
        Ok(())
    }

    fn close_to(&mut self, depth: usize) -> Result<(), RowError> {
        while self.path.len() > depth {
            self.close_last()?;
        }
        Ok(())
    }

    /// The last node of the path is complete: is it what its row says?
    fn close_last(&mut self) -> Result<(), RowError> {
        let Some(open) = self.path.pop() else { return Ok(()) };
        let end = self.index.heads.len() as NodeIx;
        let head = &self.index.heads[open.node as usize];
        let missing = head.children & !open.children_seen;
        if missing != 0 {
            return Err(damage(head, format!("the child in octant {} is missing", missing.trailing_zeros())));
        }
        if open.points != head.subtree_points || open.bounds != Some(head.subtree_bounds) {
            return Err(damage(head, "count or bounds of the subtree are not those of its parts"));
        }
        if !open.scans.iter().eq(&head.scans) {
            return Err(damage(head, "the counts by scan are not those of the subtree's parts"));
        }
        self.index.ends[open.node as usize] = end;
        if let Some(parent) = self.path.last_mut() {
            let above = &self.index.heads[parent.node as usize];
            parent.points = parent.points.saturating_add(open.points);
            let bounds = head.subtree_bounds;
            parent.bounds = Some(parent.bounds.map_or(bounds, |p| p.union(&bounds)));
            for scan in &open.scans {
                match parent.scans.binary_search_by_key(&scan.scan, |s| s.scan) {
                    Ok(i) => {
                        parent.scans[i].subtree = parent.scans[i].subtree.saturating_add(scan.subtree);
                    }
                    Err(_) => return Err(damage(above, format!("points of scan {} below are not counted", scan.scan))),
                }
            }
        }
        if let Some(layer) = self.index.layers.last_mut() {
            layer.end = end;
        }
        Ok(())
    }

    fn finish(mut self) -> Result<NodeIndex, RowError> {
        self.close_to(0)?;
        let layers = self.site.site.roots.len();
        if self.index.layers.len() < layers {
            self.open_layers(layers - 1)?;
            if self.site.site.roots[layers - 1].is_some() {
                return Err(RowError::damage("node", format!("layer {}", layers - 1), "the root is missing"));
            }
        }
        let (found, expected) = (self.index.heads.len() as u64, self.site.nodes);
        if found != expected {
            return Err(RowError::damage(
                "node",
                "all rows",
                format!("there are {found}, but {expected} were written"),
            ));
        }
        Ok(self.index)
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

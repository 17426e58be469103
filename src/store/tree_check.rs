//! Node rows in pre-order, each checked against the path above it: the tree is whole, and counts and bounds of a subtree
//! are those of its parts.

use super::error::RowError;
use super::index::NodeIx;
use super::model::{NodeHead, ScanCount};
use super::rows::SiteRow;
use crate::lattice::LatticeBox;

pub(super) fn damage(head: &NodeHead, what: impl Into<String>) -> RowError {
    RowError::damage("node", super::rows::name_of(head), what)
}

/// What the parts of a subtree add up to, as far as they have been seen.
#[derive(Debug)]
pub(super) struct Sum {
    children_seen: u8,
    nodes: u64,
    points: u64,
    scans: Vec<ScanCount>,
    bounds: Option<LatticeBox>,
}

impl Sum {
    /// Of the node alone.
    pub fn of(head: &NodeHead) -> Self {
        Self {
            children_seen: 0,
            nodes: 1,
            points: head.own_points,
            scans: head.scans.iter().map(|s| ScanCount { subtree: s.own, ..*s }).collect(),
            bounds: head.own_bounds,
        }
    }

    /// Takes in what a child's row says of its subtree; it must be a child that `parent` names.
    pub fn add(&mut self, parent: &NodeHead, child: &NodeHead) -> Result<(), RowError> {
        let bit = 1 << child.cube.octant();
        if parent.cube.k() != child.cube.k() + 1 || parent.children & bit == 0 {
            return Err(damage(child, "its parent is missing or does not name it"));
        }
        self.children_seen |= bit;
        self.nodes = self.nodes.saturating_add(child.subtree_nodes);
        self.points = self.points.saturating_add(child.subtree_points);
        let bounds = child.subtree_bounds;
        self.bounds = Some(self.bounds.map_or(bounds, |b| b.union(&bounds)));
        for scan in &child.scans {
            match self.scans.binary_search_by_key(&scan.scan, |s| s.scan) {
                Ok(i) => self.scans[i].subtree = self.scans[i].subtree.saturating_add(scan.subtree),
                Err(i) => self.scans.insert(i, ScanCount { own: 0, ..*scan }),
            }
        }
        Ok(())
    }

    /// Is it what the node's row says?
    pub fn check(&self, head: &NodeHead) -> Result<(), RowError> {
        let missing = head.children & !self.children_seen;
        let same_scans = self.scans.iter().filter(|s| s.subtree > 0).eq(&head.scans);
        if missing != 0 {
            return Err(damage(head, format!("the child in octant {} is missing", missing.trailing_zeros())));
        }
        if self.points != head.subtree_points || self.bounds != Some(head.subtree_bounds) || !same_scans {
            return Err(damage(head, "counts or bounds of the subtree are not those of its parts"));
        }
        if self.nodes != head.subtree_nodes {
            let (nodes, said) = (self.nodes, head.subtree_nodes);
            return Err(damage(head, format!("the subtree has {nodes} nodes, but the row says {said}")));
        }
        Ok(())
    }
}

/// Checks nodes as they come in pre-order. What is wrong is told and left out, with all that lies below it.
#[derive(Debug)]
pub(super) struct Checker<'a> {
    site: &'a SiteRow,
    pub heads: Vec<NodeHead>,
    pub parents: Vec<Option<NodeIx>>,
    pub damage: Vec<RowError>,
    /// From a root down to the last node: what has been seen of each.
    path: Vec<(NodeIx, Sum)>,
}

impl<'a> Checker<'a> {
    /// Before any node.
    pub fn new(site: &'a SiteRow) -> Self {
        Self { site, heads: Vec::new(), parents: Vec::new(), damage: Vec::new(), path: Vec::new() }
    }

    /// Below a node whose row is known to be right.
    pub fn below(site: &'a SiteRow, top: NodeHead) -> Self {
        let path = vec![(0, Sum::of(&top))];
        Self { heads: vec![top], parents: vec![None], path, ..Self::new(site) }
    }

    /// The next node.
    pub fn push(&mut self, head: NodeHead) {
        if let Err(damage) = self.take(head) {
            self.damage.push(damage);
        }
    }

    fn take(&mut self, head: NodeHead) -> Result<(), RowError> {
        let above = |open: &NodeHead| open.layer == head.layer && open.cube.contains_cube(head.cube);
        while self.path.last().is_some_and(|(open, _)| !above(&self.heads[*open as usize])) {
            self.close_last();
        }
        check_alone(&head, self.site)?;
        let node = self.heads.len() as NodeIx;
        // What the row says goes up at once, so that one damage is told once.
        let parent = match self.path.last_mut() {
            Some((open, sum)) => {
                sum.add(&self.heads[*open as usize], &head)?;
                Some(*open)
            }
            None if self.site.site.roots.get(usize::from(head.layer)) == Some(&Some(head.cube)) => None,
            None => return Err(damage(&head, "is neither the root of its layer nor below it")),
        };
        self.path.push((node, Sum::of(&head)));
        self.heads.push(head);
        self.parents.push(parent);
        Ok(())
    }

    fn close_last(&mut self) {
        let Some((node, sum)) = self.path.pop() else { return };
        self.damage.extend(sum.check(&self.heads[node as usize]).err());
    }

    /// No more nodes come.
    pub fn close(&mut self) {
        while !self.path.is_empty() {
            self.close_last();
        }
    }
}

/// What must hold of a node by itself.
pub(super) fn check_alone(head: &NodeHead, site: &SiteRow) -> Result<(), RowError> {
    let holds = |ok: bool, what: &str| if ok { Ok(()) } else { Err(damage(head, what)) };
    let cube = head.cube.to_box();
    holds(usize::from(head.layer) < site.site.roots.len(), "the site has no such layer")?;
    holds(head.cube.k() >= site.site.g, "the cube is smaller than the sampling grid")?;
    holds(!(head.leaf && head.children != 0), "a leaf has children")?;
    holds(head.subtree_points > 0, "the subtree has no points")?;
    let nodes = 1 + u64::from(head.children.count_ones());
    holds((nodes..).contains(&head.subtree_nodes), "the subtree's count of nodes cannot be")?;
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

//! What a node's row says of its subtree, gathered from the leaves up.

use super::model::{NodeHead, Range, ScanCount, ScanId, Slot, Zones};
use super::zones::merge_ranges;
use crate::lattice::LatticeBox;

/// What a parent needs to know of a child's subtree.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Nodes of the subtree, its root included.
    pub nodes: u64,
    /// Points of the subtree.
    pub points: u64,
    /// Tight bounds.
    pub bounds: Option<LatticeBox>,
    /// Points by scan, ascending by scan.
    pub scans: Vec<(ScanId, u64)>,
    /// Zone maps, ascending by slot.
    pub zones: Vec<(Slot, Range)>,
}

/// Fills in what a node says of its subtree, from its own points and its children's subtrees; gives the summary of its
/// own. What was there of the subtree before does not matter.
pub fn merge_subtree(head: &mut NodeHead, zones: &mut Zones, children: &[Summary]) -> Summary {
    let mut nodes = 1;
    let mut points = head.own_points;
    let mut bounds = head.own_bounds;
    let mut scans: Vec<ScanCount> =
        head.scans.iter().filter(|s| s.own > 0).map(|s| ScanCount { subtree: s.own, ..*s }).collect();
    let mut ranges = zones.own.clone();
    for child in children {
        nodes += child.nodes;
        points += child.points;
        bounds = match (bounds, child.bounds) {
            (Some(a), Some(b)) => Some(a.union(&b)),
            (a, b) => a.or(b),
        };
        for &(scan, n) in &child.scans {
            match scans.binary_search_by_key(&scan, |s| s.scan) {
                Ok(i) => scans[i].subtree += n,
                Err(i) => scans.insert(i, ScanCount { scan, own: 0, subtree: n }),
            }
        }
        merge_ranges(&mut ranges, &child.zones);
    }
    head.subtree_nodes = nodes;
    head.subtree_points = points;
    head.subtree_bounds = bounds.unwrap_or(LatticeBox::of(head.cube.low()));
    head.scans = scans;
    zones.subtree = ranges;
    Summary {
        nodes,
        points,
        bounds,
        scans: head.scans.iter().map(|s| (s.scan, s.subtree)).collect(),
        zones: zones.subtree.clone(),
    }
}

impl Summary {
    /// Of a node whose row is complete.
    pub fn of(head: &NodeHead, zones: &Zones) -> Self {
        Self {
            nodes: head.subtree_nodes,
            points: head.subtree_points,
            bounds: (head.subtree_points > 0).then_some(head.subtree_bounds),
            scans: head.scans.iter().map(|s| (s.scan, s.subtree)).collect(),
            zones: zones.subtree.clone(),
        }
    }
}

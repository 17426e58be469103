//! What node rows say of their subtrees, once all nodes are there.

use crate::lattice::Cube;
use crate::store::model::{NodeHead, Zones};
use crate::store::{Summary, merge_subtree};
use std::collections::HashMap;

/// Fills in the subtree's part of all rows, children before parents.
pub(super) fn with_subtrees(mut nodes: Vec<(NodeHead, Zones)>) -> Vec<(NodeHead, Zones)> {
    // Pre-order backwards: children come before their parent.
    nodes.sort_unstable_by_key(|(head, _)| std::cmp::Reverse(head.cube.node_key()));
    let mut children: HashMap<Cube, Vec<Summary>> = HashMap::new();
    for (head, zones) in &mut nodes {
        let below = children.remove(&head.cube).unwrap_or_default();
        let summary = merge_subtree(head, zones, &below);
        children.entry(head.cube.parent()).or_default().push(summary);
    }
    nodes
}

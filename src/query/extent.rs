//! What node rows alone say of all points of a snapshot: where they are, and which attributes tell nothing.

use super::strays::{Place, without_strays};
use crate::lattice::{Cube, Lattice, LatticeBox, LatticePoint};
use crate::octree::Metric;
use crate::store::model::{Range, ScanId};
use crate::store::{Node, Snapshot, StoreError};
use std::collections::{BTreeMap, BinaryHeap};

/// So many boxes are enough for the outline of a site.
const MOST_BOXES: usize = 256;
/// So small a share of the points may be left out of the outline, if it is far smaller without them.
const STRAY_SHARE: f64 = 1e-3;

/// Lengths in CRS units. No two points are farther apart than all points are wide, and so no bound is larger than that.
pub(crate) fn metric(lattice: &Lattice, roots: &[Node]) -> Metric {
    let metric = Metric::new(lattice.quantum_f64());
    let all = roots.iter().map(|root| root.subtree_bounds).reduce(|a, b| a.union(&b));
    all.map_or(metric, |all| metric.within(&all))
}

/// A subtree, by the size of its box.
struct Largest(u64, Node);

impl PartialEq for Largest {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Largest {}

impl PartialOrd for Largest {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Largest {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.0, other.1.cube.node_key(), other.1.layer).cmp(&(other.0, self.1.cube.node_key(), self.1.layer))
    }
}

/// Boxes that together hold the points of the scans that `shows` says are seen, about 256 of them: much closer to the points
/// than one box of a site that lies aslant. Points of coarse nodes are taken to lie among the finer ones around them, so a
/// few may be outside by about the spacing there. Strays are outside, too: less than a thousandth of the points, without
/// which the site is less than half as large.
///
/// # Errors
///
/// [`StoreError`] if rows can't be read.
pub fn occupied_boxes(snapshot: &Snapshot, shows: impl Fn(ScanId) -> bool) -> Result<Vec<LatticeBox>, StoreError> {
    let nodes = snapshot.nodes();
    let seen = |node: &Node| node.scans.iter().any(|count| shows(count.scan));
    let bounds = snapshot.scans().iter().filter(|s| shows(s.id)).filter_map(|s| s.bounds).reduce(|a, b| a.union(&b));
    let Some(bounds) = bounds else { return Ok(Vec::new()) };
    let side = |b: &LatticeBox| (0..3).map(|i| b.max.0[i] - b.min.0[i]).max().unwrap_or(0);
    let mut heap: BinaryHeap<Largest> = BinaryHeap::new();
    heap.extend(nodes.roots()?.into_iter().filter(seen).map(|root| Largest(side(&root.subtree_bounds), root)));
    let mut boxes = Vec::new();
    while let Some(Largest(_, node)) = heap.pop() {
        if node.children == 0 || boxes.len() + heap.len() >= MOST_BOXES {
            let points = node.scans.iter().filter(|count| shows(count.scan)).map(|count| count.subtree).sum();
            boxes.extend(common(&node.subtree_bounds, &bounds).map(|bounds| Place { bounds, node: node.ix(), points }));
            continue;
        }
        // What lies in octants without a child is the node's own.
        let alone =
            (0..8).filter(|octant| node.children >> octant & 1 == 0).filter_map(|octant| node.cube.child(octant));
        let own = |cube: Cube| common(&cube.to_box(), node.own_bounds.as_ref()?).and_then(|b| common(&b, &bounds));
        let points = node.scans.iter().filter(|count| shows(count.scan)).map(|count| count.own).sum();
        boxes.extend(alone.filter_map(own).map(|bounds| Place { bounds, node: node.ix(), points }));
        for child in nodes.children(&node)?.filter(seen) {
            heap.push(Largest(side(&child.subtree_bounds), child));
        }
    }
    let stored: u64 = snapshot.scans().iter().filter(|s| shows(s.id)).map(|s| s.stored).sum();
    let kept = without_strays(boxes, (stored as f64 * STRAY_SHARE) as u64);
    Ok(kept.into_iter().map(|place| place.bounds).collect())
}

/// Attributes that have one value everywhere, and that; by the zone maps of the roots.
///
/// # Errors
///
/// [`StoreError`] if rows can't be read.
pub fn flat_attributes(snapshot: &Snapshot) -> Result<BTreeMap<String, f64>, StoreError> {
    let nodes = snapshot.nodes();
    let mut ranges: BTreeMap<String, [f64; 2]> = BTreeMap::new();
    for root in nodes.roots()? {
        for (slot, range) in &nodes.zones(&root)?.subtree {
            let ends = match *range {
                Range::Unsigned(low, high) => [low as f64, high as f64],
                Range::Signed(low, high) => [low as f64, high as f64],
                Range::Float(low, high) => [low, high],
                _ => continue,
            };
            let Some(attribute) = snapshot.attribute(*slot) else { continue };
            let all = ranges.entry(attribute.attribute.name.clone()).or_insert(ends);
            *all = [all[0].min(ends[0]), all[1].max(ends[1])];
        }
    }
    let flat = ranges.into_iter().filter(|(_, [low, high])| low == high);
    Ok(flat.map(|(name, [value, _])| (name, value)).collect())
}

fn common(a: &LatticeBox, b: &LatticeBox) -> Option<LatticeBox> {
    let min = LatticePoint(std::array::from_fn(|i| a.min.0[i].max(b.min.0[i])));
    let max = LatticePoint(std::array::from_fn(|i| a.max.0[i].min(b.max.0[i])));
    (0..3).all(|i| min.0[i] <= max.0[i]).then_some(LatticeBox { min, max })
}

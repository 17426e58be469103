//! What is too far away from everything else to be part of a site's outline: a point at the origin among coordinates of
//! millions, a bird high above. It is stored and drawn as all others are, but does not make the site a dot.

use crate::lattice::LatticeBox;
use crate::store::NodeIx;
use std::collections::BTreeSet;

/// A box that holds points of one node, or of its subtree.
pub(super) struct Place {
    pub bounds: LatticeBox,
    /// Which node.
    pub node: NodeIx,
    /// How many points all boxes of this node hold together, at most.
    pub points: u64,
}

/// Leaves out places at the ends of the longest side, as many as it takes to halve it, and again, as long as they hold no more
/// than `few` points together.
pub(super) fn without_strays(mut places: Vec<Place>, few: u64) -> Vec<Place> {
    let mut left_out = Strays { nodes: BTreeSet::new(), points: 0 };
    while let Some(all) = places.iter().map(|p| p.bounds).reduce(|a, b| a.union(&b)) {
        let axis = (0..3).max_by_key(|&axis| side(&all, axis)).unwrap_or(0);
        let from_the_low_end = |b: &LatticeBox| b.max.0[axis];
        let from_the_high_end = |b: &LatticeBox| u64::MAX - b.min.0[axis];
        let ends: [&dyn Fn(&LatticeBox) -> u64; 2] = [&from_the_low_end, &from_the_high_end];
        let halved = ends.into_iter().find_map(|end| {
            // In whatever order they came.
            places.sort_by_key(|p| (end(&p.bounds), p.bounds.min.0, p.bounds.max.0, p.node));
            halving(&places, axis, side(&all, axis) / 2, few, &left_out)
        });
        let Some((strays, now)) = halved else { return places };
        places.drain(..strays);
        left_out = now;
    }
    places
}

#[derive(Clone)]
struct Strays {
    nodes: BTreeSet<NodeIx>,
    points: u64,
}

fn side(bounds: &LatticeBox, axis: usize) -> u64 {
    bounds.max.0[axis] - bounds.min.0[axis]
}

/// How many of the first places must go for the others to be less than `half` wide, and what has gone then; `None` if these
/// would be too many points.
fn halving(places: &[Place], axis: usize, half: u64, few: u64, before: &Strays) -> Option<(usize, Strays)> {
    // From the last place on: what it and those after it span.
    let mut rests: Vec<LatticeBox> = Vec::with_capacity(places.len());
    for place in places.iter().rev() {
        rests.push(rests.last().map_or(place.bounds, |rest| rest.union(&place.bounds)));
    }
    let mut strays = before.clone();
    for (i, place) in places.iter().enumerate().take(places.len().saturating_sub(1)) {
        if strays.nodes.insert(place.node) {
            strays.points = strays.points.saturating_add(place.points);
        }
        if strays.points > few {
            return None;
        }
        if side(&rests[places.len() - 2 - i], axis) < half {
            return Some((i + 1, strays));
        }
    }
    None
}

//! Invariant 6 for closed cuts: nodes taken best-first or in any other order, part by part.

use super::*;
use crate::octree::naive::hausdorff;
use crate::octree::{Frontier, Metric, Step, steps, wins};
use std::collections::BTreeMap;

/// A node as a viewer sees it: its points in the order of detail, with their steps.
struct Taken {
    cube: Cube,
    leaf: bool,
    points: Vec<(Step, LatticePoint)>,
    taken: usize,
}

/// Every node of the tree with the order of detail of its points.
fn nodes(tree: &MemoryTree<Point>, points: &[Point]) -> Vec<Taken> {
    let mut keys: Vec<Key> = points.iter().map(|p| p.0).collect();
    keys.sort_unstable();
    let all: Vec<i8> = wins(&keys, tree.root().unwrap().k() as i8);
    // Of points with equal keys the first wins: which of them is stored higher.
    let mut first: BTreeMap<Key, i8> = BTreeMap::new();
    for (key, win) in keys.iter().zip(&all) {
        first.entry(*key).or_insert(*win);
    }
    let node = |(key, node): (&crate::lattice::NodeKey, &crate::octree::Node<Point>)| {
        let keys: Vec<Key> = node.points.iter().map(|p| p.0).collect();
        // In pre-order, and in key order in a node: so the first met is the first of its equals.
        let wins: Vec<i8> = keys.iter().map(|key| first.insert(*key, -1).unwrap_or(-1)).collect();
        let groups = steps(&keys, &wins);
        let mut points: Vec<_> =
            (0..keys.len()).map(|i| (Step { win: wins[i], group: groups[i] }, keys[i].point())).collect();
        points.sort_by_key(|p| p.0);
        Taken { cube: Cube::from_node_key(key).unwrap(), leaf: node.leaf, points, taken: 0 }
    };
    tree.nodes().all().iter().map(node).collect()
}

/// The edge of the cut.
fn edge(nodes: &[Taken], params: Params) -> Vec<Frontier> {
    let state = |n: &Taken| {
        let child = |c: &&Taken| c.cube.k() + 1 == n.cube.k() && n.cube.contains_cube(c.cube);
        match n.points.get(n.taken) {
            Some(_) if n.taken == 0 => None,
            Some(next) => Some(Frontier::Begun { next: next.0 }),
            None if !begun(nodes, n) => None,
            None if n.leaf => Some(Frontier::Complete),
            None => {
                let cell = params.cell(n.cube.k());
                nodes.iter().filter(child).any(|c| !begun(nodes, c)).then_some(Frontier::Refinable { cell })
            }
        }
    };
    nodes.iter().filter_map(state).collect()
}

/// Is the node begun? One without points is with its parent's end.
fn begun(nodes: &[Taken], n: &Taken) -> bool {
    if n.taken > 0 {
        return true;
    }
    let parent = nodes.iter().find(|p| p.cube.k() == n.cube.k() + 1 && p.cube.contains_cube(n.cube));
    n.points.is_empty() && parent.is_none_or(|p| p.taken == p.points.len() && begun(nodes, p))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn every_closed_cut_is_within_its_bound_which_never_grows(
        points in given::numbered(60),
        params in given::params(),
        choices in prop::collection::vec(any::<prop::sample::Index>(), 61),
    ) {
        let tree = MemoryTree::of(points.clone(), params);
        let mut nodes = nodes(&tree, &points);
        let all: Vec<LatticePoint> = points.iter().map(given::at).collect();
        let mut last = f64::INFINITY;
        for choice in choices {
            let some: Vec<LatticePoint> = nodes.iter().flat_map(|n| n.points[..n.taken].iter().map(|p| p.1)).collect();
            let bound = Metric::STEPS.cut(some.len() as u64, edge(&nodes, params));
            if some.is_empty() {
                prop_assert_eq!(bound, f64::INFINITY);
            } else {
                let distance = hausdorff(&all, &some, [1.0; 3]);
                prop_assert!(distance <= bound * (1.0 + 1e-12), "{distance} > {bound}");
                prop_assert!(bound <= last);
                last = bound;
            }
            // One more point of a node that is begun or may be.
            let may = |n: &Taken| {
                let parent = nodes.iter().find(|p| p.cube.k() == n.cube.k() + 1 && p.cube.contains_cube(n.cube));
                n.taken < n.points.len()
                    && parent.is_none_or(|p| p.taken == p.points.len() && begun(&nodes, p))
            };
            let open: Vec<usize> = (0..nodes.len()).filter(|&i| may(&nodes[i])).collect();
            if open.is_empty() {
                prop_assert_eq!(bound, 0.0);
                break;
            }
            nodes[open[choice.index(open.len())]].taken += 1;
        }
    }
}

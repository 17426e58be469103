//! The invariants of OCTREE section 8 and the traps of section 9, on random and on the smallest trees.

mod change;
mod cuts;
mod layers;
mod traps;

use super::naive::{self, tests as given};
use super::{MemoryTree, Params, TreePoint};
use crate::lattice::{Cube, Key, LatticePoint};
use proptest::prelude::*;

type Point = given::Numbered;

impl TreePoint for Point {
    fn key(&self) -> Key {
        self.0
    }
}

/// Is the tree what the definition says of these points? With invariants 2 and 3 checked on their own.
fn check(tree: &MemoryTree<Point>, points: &[Point]) {
    let params = tree.params();
    assert_eq!(tree.root(), naive::root(points, given::at, params.g));
    let expected = naive::tree(points, given::at, params);
    let found: std::collections::BTreeMap<_, _> =
        tree.nodes().all().iter().map(|(key, n)| (*key, (n.leaf, n.rem, n.points.clone()))).collect();
    assert!(found == expected, "{params:?}\nfound {found:?}\nexpected {expected:?}");
    let cube = |key| Cube::from_node_key(key).unwrap();
    let all = tree.nodes().all();
    for (key, node) in all.iter() {
        let (k, below) = (cube(key).k(), (0..8).filter_map(|o| all.get(&cube(key).child(o)?.node_key())));
        assert_eq!(node.rem, node.points.len() as u64 + below.map(|n| n.rem).sum::<u64>());
        assert_eq!(node.leaf, node.rem <= u64::from(params.leaf_capacity) || k == params.g);
        assert!(node.points.iter().all(|p| cube(key).contains(given::at(p))));
        if !node.leaf {
            // One owner, the least of all, in every occupied cell.
            let c = k - params.g;
            let ancestors = all.iter().filter(|(a, _)| cube(a).contains_cube(cube(key)));
            let mut owners: Vec<_> = ancestors.flat_map(|(_, n)| n.points.clone()).collect();
            owners.retain(|p| cube(key).contains(given::at(p)));
            owners.sort();
            let inside: Vec<_> = points.iter().copied().filter(|p| cube(key).contains(given::at(p))).collect();
            assert_eq!(owners, naive::level(&inside, given::at, c, |_| true));
        }
    }
    if let Some(root) = tree.root() {
        assert_eq!(tree.nodes().all()[&root.node_key()].rem, points.len() as u64);
    }
}

/// Removes `gone` from `points`, each request once.
fn without(points: &[Point], gone: &[Point]) -> Vec<Point> {
    let mut rest = points.to_vec();
    for p in gone {
        if let Some(i) = rest.iter().position(|q| q == p) {
            rest.swap_remove(i);
        }
    }
    rest
}

/// Points on one site, in groups: so that batches make the root grow and removals make it shrink, some groups are small
/// corners of the site.
fn batches(most: usize) -> impl Strategy<Value = Vec<Vec<Point>>> {
    let cut = (0_usize..4, prop::collection::vec(0_u8..6, most));
    (given::numbered(most), cut).prop_map(|(points, (kind, numbers))| {
        let mut points = points;
        if kind == 1 {
            // Each batch spans more than the one before.
            let first = given::at(&points[0]);
            points.sort_by_key(|p| Cube::spanning(first, given::at(p), 0).k());
        } else if kind == 2 {
            points.sort_unstable();
        }
        let mut batches: Vec<Vec<Point>> = vec![Vec::new()];
        for (point, number) in points.into_iter().zip(numbers) {
            if number == 0 {
                batches.push(Vec::new());
            }
            batches.last_mut().unwrap().push(point);
        }
        batches
    })
}

/// A point in the plane z = 0.
fn at(x: u64, y: u64) -> Point {
    (Key::of(LatticePoint([x, y, 0])), 0)
}

/// The parameters of most traps.
const TINY: Params = Params { g: 1, leaf_capacity: 1 };

//! Invariants 1, 4 and 7: insert, remove, merge.

use super::*;
use crate::lattice::NodeKey;
use crate::octree::{Matching, Requests};
use std::collections::BTreeSet;

fn empty(params: Params) -> MemoryTree<Point> {
    MemoryTree::of(Vec::new(), params)
}

fn cube(key: &NodeKey) -> Cube {
    Cube::from_node_key(key).unwrap()
}

/// What an insertion may read, from the trees before and after.
fn check_insert_reads(before: &MemoryTree<Point>, after: &MemoryTree<Point>, reads: &BTreeSet<NodeKey>) {
    let rem = |tree: &MemoryTree<Point>, key| tree.nodes().all().get(key).map_or(0, |n| n.rem);
    let grown = before.root().filter(|_| before.root() != after.root());
    // Old root and chain that became leaves: what was below is taken over.
    let absorbed = |key: &NodeKey| {
        let over = |(k, n): (&NodeKey, &super::super::Node<Point>)| {
            n.leaf && grown.is_some_and(|old| cube(k).contains_cube(old)) && cube(k).contains_cube(cube(key))
        };
        grown.is_some() && after.nodes().all().iter().any(over)
    };
    for (key, node) in before.nodes().all().iter() {
        let receives = rem(after, key) > rem(before, key);
        let is_old_root = grown == Some(cube(key));
        let allowed = receives || is_old_root || absorbed(key);
        assert!(!reads.contains(key) || allowed, "{} was read for nothing", cube(key).k());
        if grown.is_none() {
            assert_eq!(reads.contains(key), receives && !node.points.is_empty());
        }
    }
}

/// What a removal may read, from the trees before and after.
fn check_remove_reads(
    before: &MemoryTree<Point>,
    after: &MemoryTree<Point>,
    gone: impl Fn(&Point) -> bool,
    reads: &BTreeSet<NodeKey>,
) {
    let mut allowed = BTreeSet::new();
    let all = before.nodes().all();
    for (key, node) in all.iter() {
        for p in node.points.iter().filter(|p| gone(p)) {
            allowed.insert(*key);
            if !node.leaf {
                let below = all.range(*key..=cube(key).last_node_key());
                allowed.extend(below.filter(|(k, _)| cube(k).contains(given::at(p))).map(|(k, _)| *k));
            }
        }
    }
    let shrunk = before.root() != after.root();
    for key in reads {
        let collapsed = after.nodes().all().iter().any(|(k, n)| n.leaf && cube(k).contains_cube(cube(key)));
        // The chain that is given up, with the new root; and all of it where the new root is built anew.
        let chain = shrunk && after.root().is_none_or(|root| cube(key).contains_cube(root));
        let rebuilt = shrunk
            && after.root().is_some_and(|root| before.nodes().all().get(&root.node_key()).is_none_or(|n| n.leaf));
        assert!(allowed.contains(key) || collapsed || chain || rebuilt, "read for nothing");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn inserting_in_batches_gives_the_tree_of_all_and_reads_what_it_must(batches in batches(60), params in given::params()) {
        let mut tree = empty(params);
        let mut points: Vec<Point> = Vec::new();
        for batch in batches {
            let before = tree.clone();
            tree.nodes().take_reads();
            tree.insert(batch.clone()).unwrap();
            let reads = tree.nodes().take_reads();
            check_insert_reads(&before, &tree, &reads);
            points.extend(batch);
            check(&tree, &points);
        }
        check(&MemoryTree::of(points.clone(), params), &points);
    }

    #[test]
    fn removing_a_scan_gives_the_tree_of_the_others_and_reads_what_it_must(
        points in given::numbered(60),
        params in given::params(),
        order in prop::collection::vec(0_u8..4, 1..5),
    ) {
        let mut tree = MemoryTree::of(points.clone(), params);
        let mut points = points;
        for scan in order {
            let before = tree.clone();
            tree.nodes().take_reads();
            let gone = |p: &Point| p.1 == scan;
            let count = tree.remove(&Matching(gone)).unwrap();
            let reads = tree.nodes().take_reads();
            prop_assert_eq!(count as usize, points.iter().filter(|p| gone(p)).count());
            points.retain(|p| !gone(p));
            check(&tree, &points);
            check_remove_reads(&before, &tree, gone, &reads);
        }
    }

    #[test]
    fn removing_what_was_inserted_gives_the_tree_back(batches in batches(60), params in given::params()) {
        let mut tree = empty(params);
        let mut points: Vec<Point> = Vec::new();
        for batch in &batches {
            tree.insert(batch.clone()).unwrap();
            points.extend(batch);
        }
        for batch in batches.iter().rev() {
            let requests: Requests<Point> = batch.iter().copied().collect();
            prop_assert_eq!(tree.remove(&requests).unwrap() as usize, batch.len());
            points = without(&points, batch);
            check(&tree, &points);
        }
        prop_assert_eq!(tree.root(), None);
    }

    #[test]
    fn removing_some_of_many_identical_points_takes_each_request_once(
        points in given::numbered(40),
        params in given::params(),
        keep in prop::collection::vec(any::<bool>(), 40),
    ) {
        let doubled: Vec<Point> = points.iter().flat_map(|p| [*p, *p]).collect();
        let mut tree = MemoryTree::of(doubled.clone(), params);
        let gone: Vec<Point> = points.iter().zip(&keep).filter(|(_, keep)| !**keep).map(|(p, _)| *p).collect();
        tree.remove(&gone.iter().copied().collect::<Requests<_>>()).unwrap();
        check(&tree, &without(&doubled, &gone));
    }

    #[test]
    fn changes_in_any_order_give_the_tree_of_what_is_left(
        batches in batches(80),
        params in given::params(),
        undo in prop::collection::vec((any::<bool>(), any::<prop::sample::Index>()), 20),
    ) {
        let mut tree = empty(params);
        let mut there: Vec<Vec<Point>> = Vec::new();
        for (batch, (undo, which)) in batches.into_iter().zip(undo) {
            tree.insert(batch.clone()).unwrap();
            there.push(batch);
            if undo {
                let batch = there.swap_remove(which.index(there.len()));
                tree.remove(&batch.into_iter().collect::<Requests<_>>()).unwrap();
            }
            check(&tree, &there.concat());
        }
    }

    #[test]
    fn merging_two_trees_either_way_gives_the_tree_of_the_union(a in given::numbered(50), b in given::numbered(50), params in given::params()) {
        let (mut ab, mut ba) = (MemoryTree::of(a.clone(), params), MemoryTree::of(b.clone(), params));
        ab.insert(b.clone()).unwrap();
        ba.insert(a.clone()).unwrap();
        let all = [a, b].concat();
        check(&ab, &all);
        check(&ba, &all);
    }
}

#[test]
fn the_real_parameters_give_the_tree_of_the_definition() {
    let params = Params { g: 7, leaf_capacity: 32_768 };
    let mut state = 7_u64;
    let mut random = |bits: u32| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        state >> (64 - bits)
    };
    let corner = crate::lattice::BIAS as u64;
    let mut scan = |n: usize, bits: u32, number: u8| -> Vec<Point> {
        let mut point = || {
            let (x, y) = (random(bits), random(bits));
            (Key::of(LatticePoint([corner + x, corner + y, corner + (x / 7 + y / 9 + random(6)) / 5])), number)
        };
        (0..n).map(|_| point()).collect()
    };
    let (a, b) = (scan(50_000, 16, 1), scan(40_000, 19, 2));
    let nodes = |tree: &MemoryTree<Point>| -> std::collections::BTreeMap<_, _> {
        tree.nodes().all().iter().map(|(key, n)| (*key, (n.leaf, n.rem, n.points.clone()))).collect()
    };
    let mut tree = MemoryTree::of(a.clone(), params);
    let only_a = nodes(&tree);
    assert!(only_a == naive::tree(&a, given::at, params));
    tree.insert(b.clone()).unwrap();
    assert!(nodes(&tree) == naive::tree(&[a, b].concat(), given::at, params));
    tree.remove(&Matching(|p: &Point| p.1 == 2)).unwrap();
    assert!(nodes(&tree) == only_a);
}

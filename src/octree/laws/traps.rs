//! Section 9: each mistake's smallest counterexample.

use super::*;
use crate::octree::{Matching, Requests, filtered, level, wins};

fn added(params: Params, a: &[Point], b: &[Point]) {
    let mut tree = MemoryTree::of(a.to_vec(), params);
    tree.insert(b.to_vec()).unwrap();
    check(&tree, &[a, b].concat());
}

fn removed(params: Params, keep: &[Point], gone: &[Point]) {
    let all = [keep, gone].concat();
    let mut tree = MemoryTree::of(all.clone(), params);
    tree.remove(&gone.iter().copied().collect::<Requests<_>>()).unwrap();
    check(&tree, keep);
    // The same with the points that go as a scan of their own, which follow or precede their equals.
    for scan in [1, 0] {
        let mark = |points: &[Point], number| points.iter().map(|p| (p.0, number)).collect::<Vec<_>>();
        let (keep, gone) = (mark(keep, 1 - scan), mark(gone, scan));
        let mut tree = MemoryTree::of([keep.clone(), gone].concat(), params);
        tree.remove(&Matching(|p: &Point| p.1 == scan)).unwrap();
        check(&tree, &keep);
    }
}

#[test]
fn growth_tests_the_chain_and_the_old_root_for_leaves() {
    added(TINY, &[at(13, 4), at(9, 5)], &[at(8, 12)]);
}

#[test]
fn growth_moves_the_old_roots_coarser_winners_up() {
    added(TINY, &[at(3, 0), at(4, 0)], &[at(8, 0)]);
}

#[test]
fn growth_absorbs_an_inner_node_with_few_remaining() {
    added(TINY, &[at(4, 1), at(6, 3)], &[at(2, 6)]);
}

#[test]
fn insert_compares_with_the_ancestors_points() {
    added(TINY, &[at(4, 0), at(4, 0), at(5, 0)], &[at(9, 0)]);
}

#[test]
fn remove_follows_a_vacancy_where_the_scan_has_no_points() {
    removed(TINY, &[at(7, 3), at(3, 5), at(0, 4)], &[at(1, 4)]);
}

#[test]
fn remove_repairs_children_before_it_pulls_from_them() {
    removed(Params { g: 2, ..TINY }, &[at(14, 0)], &[at(6, 0), at(5, 0)]);
}

#[test]
fn remove_pulls_before_it_tests_the_child_for_a_leaf() {
    removed(TINY, &[at(11, 0), at(1, 0), at(1, 0)], &[at(4, 0)]);
}

#[test]
fn remove_tests_for_leaves() {
    removed(Params { g: 2, ..TINY }, &[at(1, 0), at(2, 0), at(12, 0)], &[at(1, 0)]);
}

#[test]
fn shrink_rebuilds_a_new_root_that_was_a_leaf() {
    removed(TINY, &[at(4, 15), at(7, 8)], &[at(12, 9)]);
}

#[test]
fn the_order_is_tied_to_absolute_bits_and_not_to_the_root() {
    added(TINY, &[at(7, 0), at(1, 0)], &[at(9, 0)]);
}

#[test]
fn a_level_reads_a_layer_whose_root_is_smaller_than_the_levels_nodes() {
    let (large, small) = ([at(0, 0), at(100, 0), at(90, 40)], [at(33, 20)]);
    let trees = [MemoryTree::of(large.to_vec(), TINY), MemoryTree::of(small.to_vec(), TINY)];
    let root = trees[0].root().unwrap();
    for c in 0..=root.k() {
        let found = level(&[&trees[0], &trees[1]], root, c).unwrap();
        assert_eq!(found, naive::level(&[&large[..], &small[..]].concat(), given::at, c, |_| true));
    }
    let alone = level(&[&trees[1]], root, 2).unwrap();
    assert_eq!(alone, small);
}

#[test]
fn a_fill_takes_the_least_match_and_not_the_first_met() {
    let points = [(at(4, 0).0, 1), (at(7, 0).0, 0), (at(0, 0).0, 0)];
    let tree = MemoryTree::of(points.to_vec(), TINY);
    let matches = |p: &Point| p.1 == 0;
    assert_eq!(naive::level(&points, given::at, 3, matches), [points[1]], "the right answer is 7");
    assert_eq!(filtered(&[&tree], 3, matches, |_, _| true).unwrap(), [points[1]]);
}

#[test]
fn a_fill_keeps_cells_open_whose_best_match_has_an_equal_key() {
    let p = |x, number| (Key::of(LatticePoint([x, 1, 1])), number);
    // Matching are the numbers 1 and 3; whether the tie is on one side or the other.
    for (inner, outer) in [(1, 3), (3, 1)] {
        let one = [p(1, 0), p(1, inner), p(3, 0)];
        let two = [p(1, outer)];
        let trees = [MemoryTree::of(one.to_vec(), TINY), MemoryTree::of(two.to_vec(), TINY)];
        let matches = |p: &Point| p.1 % 2 == 1;
        for trees in [[&trees[0], &trees[1]], [&trees[1], &trees[0]]] {
            for c in 0..=2 {
                let expected = naive::level(&[&one[..], &two[..]].concat(), given::at, c, matches);
                assert_eq!(filtered(&trees, c, matches, |_, _| true).unwrap(), expected, "c = {c}");
            }
        }
    }
}

#[test]
fn a_leafs_virtual_levels_need_the_ancestors_points() {
    // In the leaf alone its first point would win the leaf's whole cube; but the root's point wins that.
    let points: Vec<Point> = [at(0, 0), at(1, 0), at(8, 0), at(9, 1)].to_vec();
    let tree = MemoryTree::of(points.clone(), Params { g: 1, leaf_capacity: 2 });
    let mut keys: Vec<Key> = points.iter().map(|p| p.0).collect();
    keys.sort_unstable();
    let all = tree.nodes().all();
    let (key, leaf) = all.iter().find(|(_, n)| n.leaf).expect("there is a leaf");
    let k = Cube::from_node_key(key).unwrap().k() as i8;
    let own: Vec<Key> = leaf.points.iter().map(|p| p.0).collect();
    let right = wins(&keys, 4)[keys.iter().position(|key| *key == own[0]).unwrap()];
    assert!(right < k, "a leaf's points win no cell of its parent");
    assert_ne!(wins(&own, k)[0], right);
}

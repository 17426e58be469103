//! The nodes above the buckets: subtrees joined in key order.

use super::{Params, Place};
use crate::lattice::Cube;

/// Points of one bucket that one node above it will store, in key order, on their way up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block<T> {
    /// The exponent of the largest cell that each of them wins. If that is a cell of the bucket's own node, the points
    /// may also be such that win a smaller one only.
    pub win: i8,
    /// How many they are.
    pub points: u64,
    /// What the caller carries.
    pub item: T,
}

/// What is known of an aligned cube below the root after all nodes inside that are sure have been given out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Subtree<T> {
    /// The cube.
    pub cube: Cube,
    /// The remaining points of the cube's own node, if it was given out.
    pub built: Option<u64>,
    /// The points not stored in any node given out: bucket after bucket in key order, those of a bucket by ascending wins.
    pub blocks: Vec<Block<T>>,
}

/// A node above the buckets, given out after all of its children.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OwnedNode<T> {
    /// The cube.
    pub cube: Cube,
    /// Does it store everything that remains in its cube?
    pub leaf: bool,
    /// Bit `octant` (plain, as in [`Cube::child`]) is set where there is a child.
    pub children: u8,
    /// Points stored here or below.
    pub rem: u64,
    /// Its own points: bucket after bucket in key order. Of those of one bucket several blocks may have to be merged; of
    /// equal keys the one with the largest win is the first, and the others are all in one block.
    pub blocks: Vec<Block<T>>,
}

/// Joins subtrees, given in key order, up to the root.
///
/// At any time it holds the blocks of points that belong above what was given, and those with the at most `leaf_capacity`
/// waiting points of each open cube.
#[derive(Debug)]
pub struct Assembler<T> {
    root: Cube,
    params: Params,
    /// In key order. Of two neighbours, the first is a child of the smallest cube that holds both.
    open: Vec<Subtree<T>>,
}

impl<T> Assembler<T> {
    /// For a tree with this root.
    pub fn new(root: Cube, params: Params) -> Self {
        Self { root, params, open: Vec::new() }
    }

    /// Takes the next subtree; gives out the nodes that became sure.
    ///
    /// # Panics
    ///
    /// Unless the cube is smaller than the root and lies after all cubes before it in key order. (A bucket that holds
    /// the root is built by [`build_bucket`](super::build_bucket) as [`Place::Root`].)
    pub fn push(&mut self, subtree: Subtree<T>, emit: &mut impl FnMut(OwnedNode<T>)) {
        let cube = subtree.cube;
        assert!(cube != self.root && self.root.contains_cube(cube), "a bucket must be smaller than the root");
        if let Some(last) = self.open.last() {
            assert!(last.cube.last_key() < cube.first_key(), "buckets must come in key order");
            let shared = Cube::spanning(last.cube.low(), cube.low(), 0);
            self.close(shared.k().saturating_sub(1), emit);
        }
        self.open.push(subtree);
    }

    /// Gives out what is left, the root last. Nothing at all if nothing was pushed.
    pub fn finish(mut self, emit: &mut impl FnMut(OwnedNode<T>)) {
        if !self.open.is_empty() {
            self.close(self.root.k().saturating_sub(1), emit);
            combine(self.root, self.open, Place::Root, self.params, emit);
        }
    }

    /// Joins the last subtree with its siblings until its exponent is `k`.
    fn close(&mut self, k: u8, emit: &mut impl FnMut(OwnedNode<T>)) {
        while let Some(last) = self.open.last().filter(|s| s.cube.k() < k) {
            let parent = last.cube.parent();
            let siblings = self.open.iter().rev().take_while(|s| parent.contains_cube(s.cube)).count();
            let children = self.open.split_off(self.open.len() - siblings);
            self.open.push(combine(parent, children, Place::Below, self.params, emit));
        }
    }
}

/// Joins the subtrees of the octants of `cube`, in key order, those without points left out.
///
/// If the cube's node is sure it is given out, and before it the leaves among its children that were waiting for that.
/// At the root everything is sure.
fn combine<T>(
    cube: Cube,
    children: Vec<Subtree<T>>,
    place: Place,
    params: Params,
    emit: &mut impl FnMut(OwnedNode<T>),
) -> Subtree<T> {
    let k = cube.k();
    let taken = place.taken(k, params);
    let waiting = |s: &Subtree<T>| s.blocks.iter().filter(|b| b.win < taken).map(|b| b.points).sum::<u64>();
    let rem = children.iter().map(|s| s.built.unwrap_or(0) + waiting(s)).sum();
    let leaf = params.is_leaf(k, rem);
    let waits = rem <= u64::from(params.leaf_capacity) || k < params.g;
    let mut mask = 0;
    let mut blocks = Vec::new();
    for mut child in children {
        let mut present = child.built.is_some();
        if !leaf && !present {
            // Its parent is no leaf, so it is a node: a leaf, because it waited.
            let (own, above): (Vec<_>, _) = child.blocks.into_iter().partition(|b| b.win < params.cell(k));
            child.blocks = above;
            present = !own.is_empty();
            if present {
                let rem = own.iter().map(|b| b.points).sum();
                emit(OwnedNode { cube: child.cube, leaf: true, children: 0, rem, blocks: own });
            }
        }
        mask |= u8::from(present) << child.cube.octant();
        blocks.append(&mut child.blocks);
    }
    if rem == 0 || place == Place::Below && waits {
        return Subtree { cube, built: None, blocks };
    }
    let (own, above) = blocks.into_iter().partition(|b| b.win < taken);
    emit(OwnedNode { cube, leaf, children: mask, rem, blocks: own });
    Subtree { cube, built: Some(rem), blocks: above }
}

#[cfg(test)]
mod tests {
    use super::super::{EmittedNode, build_bucket};
    use super::*;
    use crate::lattice::{Key, LOW_DIGITS, LatticeBox, LatticePoint, NodeKey};
    use crate::octree::naive::{self, NaiveNode, tests as given};
    use crate::octree::{first_win, root_of, wins};
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    /// A node of [`assemble`], given out after all of its children.
    #[derive(Clone, Debug, PartialEq, Eq)]
    struct WholeNode<T> {
        /// The cube.
        pub cube: Cube,
        /// Does it store everything that remains in its cube?
        pub leaf: bool,
        /// Bit `octant` is set where there is a child.
        pub children: u8,
        /// Points stored here or below.
        pub rem: u64,
        /// Its own points, in key order.
        pub points: Vec<(Key, T)>,
    }

    /// Builds a whole tree in memory from buckets in key order, each with its points sorted by key: the reference of how
    /// ingest drives [`build_bucket`] and [`Assembler`].
    ///
    /// `root` is [`root_of`] the points. Nodes come after their children.
    ///
    /// # Panics
    ///
    /// If the buckets overlap, are out of order or leave the root (one bucket may hold the whole root), or a bucket has 2^32
    /// points or more.
    fn assemble<T: Copy>(
        root: Cube,
        buckets: impl IntoIterator<Item = (Cube, Vec<(Key, T)>)>,
        params: Params,
        mut emit: impl FnMut(WholeNode<T>),
    ) {
        // Points with their wins.
        let whole = |OwnedNode { cube, leaf, children, rem, blocks }: OwnedNode<Vec<(Key, i8, T)>>| {
            let mut points: Vec<_> = blocks.into_iter().flat_map(|b| b.item).collect();
            points.sort_by_key(|&(key, win, _)| (key, std::cmp::Reverse(win)));
            let points = points.into_iter().map(|(key, _, item)| (key, item)).collect();
            WholeNode { cube, leaf, children, rem, points }
        };
        let mut assembler = Assembler::new(root, params);
        let mut previous = None;
        for (cube, points) in buckets.into_iter().filter(|(_, points)| !points.is_empty()) {
            let is_root = cube.contains_cube(root);
            let (cube, place) = if is_root { (root, Place::Root) } else { (cube, Place::Below) };
            let first = first_win(previous.replace(cube), cube, root);
            let keys: Vec<Key> = points.iter().map(|p| p.0).collect();
            let mut owned = |node: EmittedNode| {
                let EmittedNode { cube, leaf, children, rem, points: own } = node;
                let points = own.iter().map(|&i| points[i as usize]).collect();
                emit(WholeNode { cube, leaf, children, rem, points });
            };
            let (wins, rest) = if cube.k() <= LOW_DIGITS {
                let keys: Vec<u64> = keys.iter().map(|k| k.low).collect();
                let wins = wins(&keys, first);
                let rest = build_bucket(cube, &keys, &wins, place, params, &mut owned);
                (wins, rest)
            } else {
                let wins = wins(&keys, first);
                let rest = build_bucket(cube, &keys, &wins, place, params, &mut owned);
                (wins, rest)
            };
            if !is_root {
                let block = |(win, own): (i8, Vec<u32>)| {
                    let point = |&i: &u32| (keys[i as usize], wins[i as usize], points[i as usize].1);
                    Block { win, points: own.len() as u64, item: own.iter().map(point).collect() }
                };
                let blocks = rest.by_node(cube, &wins, params).map(block).collect();
                assembler.push(Subtree { cube, built: rest.built, blocks }, &mut |node| emit(whole(node)));
            }
        }
        assembler.finish(&mut |node| emit(whole(node)));
    }

    type Nodes = BTreeMap<NodeKey, NaiveNode<given::Numbered>>;

    /// The root, from bounds.
    fn root(points: &[given::Numbered], params: Params) -> Cube {
        let bounds = points.iter().fold(LatticeBox::of(given::at(&points[0])), |b, p| b.with(given::at(p)));
        root_of(&bounds, params)
    }

    /// Disjoint cubes around all points, in key order, of exponents that the hash of their corner picks from `ks`.
    fn buckets(points: &[given::Numbered], root: Cube, ks: &[u8]) -> Vec<(Cube, Vec<given::Numbered>)> {
        let mut buckets: Vec<(Cube, Vec<given::Numbered>)> = Vec::new();
        for &p in points {
            if let Some((cube, members)) = buckets.last_mut()
                && cube.contains(given::at(&p))
            {
                members.push(p);
                continue;
            }
            // The largest cube around the point whose own corner asks for exactly its exponent.
            let asks = |c: &Cube| {
                let mix = c.low().0.iter().fold(7_u64, |h, x| (h ^ x).wrapping_mul(0x9e37_79b9_7f4a_7c15));
                ks[(mix >> 33) as usize % ks.len()] == c.k()
            };
            let least = *ks.iter().min().unwrap();
            let cube = (least..=root.k()).rev().map(|k| Cube::containing(given::at(&p), k)).find(asks);
            buckets.push((cube.unwrap_or(Cube::containing(given::at(&p), least)), vec![p]));
        }
        buckets
    }

    fn built(points: &[given::Numbered], ks: &[u8], params: Params) -> Nodes {
        let mut points = points.to_vec();
        points.sort();
        let root = root(&points, params);
        let mut nodes = Nodes::new();
        assemble(root, buckets(&points, root, ks), params, |node| {
            let mut children = 0;
            for octant in 0..8 {
                if node.cube.child(octant).is_some_and(|c| nodes.contains_key(&c.node_key())) {
                    children |= 1 << octant;
                }
            }
            assert_eq!(children, node.children, "children come before their parent, and the mask names them");
            // Equal keys are in the order in which they were given, too.
            assert!(node.points.is_sorted());
            assert!(nodes.insert(node.cube.node_key(), (node.leaf, node.rem, node.points)).is_none());
        });
        nodes
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(600))]
        #[test]
        fn any_buckets_give_the_tree_of_the_definition(
            points in given::numbered(120),
            params in given::params(),
            ks in prop::collection::vec(0_u8..=24, 1..4),
        ) {
            prop_assert_eq!(built(&points, &ks, params), naive::tree(&points, given::at, params));
        }
    }

    #[test]
    fn more_coincident_points_than_a_leaf_holds_make_a_chain_down_to_the_finest_node() {
        let params = Params { g: 2, leaf_capacity: 3 };
        let mut points = vec![(Key::of(LatticePoint([5000, 6000, 7000])), 0); 10];
        points.push((Key::of(LatticePoint([0, 0, 0])), 0));
        for k in [0, 1, 2, 3, 9, 13, 48] {
            let nodes = built(&points, &[k], params);
            assert_eq!(nodes, naive::tree(&points, given::at, params));
            assert!(nodes.values().filter(|n| n.2.is_empty()).count() > 5);
        }
    }

    #[test]
    fn real_parameters_and_both_kinds_of_keys_give_the_tree_of_the_definition() {
        // A rough surface of 120,000 points, denser in one corner, with a pile of 40,000 on one position.
        let params = Params { g: 7, leaf_capacity: 32_768 };
        let mut state = 1_u64;
        let mut random = |bits: u32| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            state >> (64 - bits)
        };
        let corner = crate::lattice::BIAS as u64;
        let mut points = vec![(Key::of(LatticePoint([corner + 5; 3])), 1); 40_000];
        for i in 0..120_000 {
            let bits = if i % 3 == 0 { 23 } else { 12 };
            let (x, y) = (random(bits), random(bits));
            let z = (x / 7 + y / 9 + random(6)) / 5;
            points.push((Key::of(LatticePoint([corner + x, corner + y, corner + z])), random(2) as u8));
        }
        let expected = naive::tree(&points, given::at, params);
        assert!(expected.len() > 20);
        for ks in [&[24_u8][..], &[22], &[20], &[16, 19], &[6, 12]] {
            assert!(built(&points, ks, params) == expected, "buckets of {ks:?}");
        }
    }
}

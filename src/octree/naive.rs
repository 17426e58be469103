//! The definition of the tree and nothing else: hash maps of cells, no sort, no prefix. What the fast code is tested
//! against.

use super::Params;
use crate::lattice::{Cube, Key, LatticePoint, NodeKey};
use std::collections::{BTreeMap, HashMap};

/// A node as the definition gives it: leaf flag, remaining points, own points in ascending order.
pub type NaiveNode<P> = (bool, u64, Vec<P>);

/// The smallest aligned cube of exponent at least `g` that holds all points, found by trying.
pub fn root<P>(points: &[P], at: impl Fn(&P) -> LatticePoint, g: u8) -> Option<Cube> {
    let first = at(points.first()?);
    (g..=48).map(|k| Cube::containing(first, k)).find(|cube| points.iter().all(|p| cube.contains(at(p))))
}

/// Every node of the tree of `points`, from the definition in OCTREE section 1.
pub fn tree<P: Clone + Ord>(
    points: &[P],
    at: impl Fn(&P) -> LatticePoint,
    params: Params,
) -> BTreeMap<NodeKey, NaiveNode<P>> {
    let mut nodes = BTreeMap::new();
    let Some(root) = root(points, &at, params.g) else { return nodes };
    let mut winners = HashMap::new();
    for c in 0..=root.k() - params.g {
        for (i, p) in points.iter().enumerate() {
            let winner = winners.entry((c, at(p).0.map(|x| x >> c))).or_insert(i);
            if (p, i) < (&points[*winner], *winner) {
                *winner = i;
            }
        }
    }
    let mut open = vec![(root, (0..points.len()).collect::<Vec<_>>())];
    while let Some((cube, remaining)) = open.pop() {
        let rem = remaining.len() as u64;
        let leaf = rem <= u64::from(params.leaf_capacity) || cube.k() == params.g;
        let c = cube.k() - params.g;
        let (own, below): (Vec<_>, Vec<_>) =
            remaining.into_iter().partition(|&i| leaf || winners[&(c, at(&points[i]).0.map(|x| x >> c))] == i);
        let mut own: Vec<P> = own.into_iter().map(|i| points[i].clone()).collect();
        own.sort();
        nodes.insert(cube.node_key(), (leaf, rem, own));
        let mut children: HashMap<u8, Vec<usize>> = HashMap::new();
        for i in below {
            children.entry(cube.octant_of(at(&points[i]))).or_default().push(i);
        }
        open.extend(children.into_iter().filter_map(|(octant, indices)| Some((cube.child(octant)?, indices))));
    }
    nodes
}

/// The least matching point of every occupied cell of exponent `c`, in ascending order.
pub fn level<P: Clone + Ord>(
    points: &[P],
    at: impl Fn(&P) -> LatticePoint,
    c: u8,
    matches: impl Fn(&P) -> bool,
) -> Vec<P> {
    let mut best: HashMap<[u64; 3], &P> = HashMap::new();
    for p in points.iter().filter(|p| matches(p)) {
        let least = best.entry(at(p).0.map(|x| x >> c)).or_insert(p);
        *least = (*least).min(p);
    }
    let mut level: Vec<P> = best.into_values().cloned().collect();
    level.sort_by(|a, b| Key::of(at(a)).cmp(&Key::of(at(b))).then(a.cmp(b)));
    level
}

/// The largest distance from a point of `all` to its nearest point of `some`, each axis scaled by `quantum`.
pub fn hausdorff(all: &[LatticePoint], some: &[LatticePoint], quantum: [f64; 3]) -> f64 {
    let distance = |a: &LatticePoint, b: &LatticePoint| {
        (0..3).map(|i| (a.0[i].abs_diff(b.0[i]) as f64 * quantum[i]).powi(2)).sum::<f64>()
    };
    let nearest = |a| some.iter().map(|b| distance(a, b)).fold(f64::INFINITY, f64::min);
    all.iter().map(nearest).fold(0.0, f64::max).sqrt()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Up to `most` points on a small site of 1 to 16 bits anywhere in the lattice, around BIAS, or across one of the
    /// largest boundaries; many repeated.
    pub(crate) fn points(most: usize) -> impl Strategy<Value = Vec<LatticePoint>> {
        let around = prop_oneof![
            prop::array::uniform3(0_u64..1 << 48),
            Just([crate::lattice::BIAS as u64; 3]),
            Just([1 << 47; 3]),
            prop::array::uniform3(prop::sample::select(vec![1_u64 << 46, 1 << 47, 3 << 46, 5 << 30])),
            Just([0; 3]),
            Just([(1 << 48) - 1; 3]),
        ];
        let shape = prop::sample::select(vec![[1_u64, 1, 1], [1, 1, 0], [1, 0, 0], [0, 0, 1]]);
        (around, 1_u32..=16, shape).prop_flat_map(move |(middle, bits, shape)| {
            let side = 1_i64 << bits;
            let offset = prop_oneof![
                3 => prop::array::uniform3(-side / 2..side / 2),
                1 => prop::array::uniform3(0_i64..2),
                1 => prop::array::uniform3(prop::sample::select(vec![-1, -side / 2, side / 4, 0])),
            ];
            prop::collection::vec(offset, 1..=most).prop_map(move |offsets| {
                let place = |o: [i64; 3]| {
                    std::array::from_fn(|i| {
                        let x = middle[i] as i64 + o[i] * shape[i] as i64;
                        x.clamp(0, (1 << 48) - 1) as u64
                    })
                };
                offsets.into_iter().map(|o| LatticePoint(place(o))).collect()
            })
        })
    }

    /// A point with a number that stands for its record and scan.
    pub(crate) type Numbered = (Key, u8);

    /// Where a numbered point is.
    pub(crate) fn at(p: &Numbered) -> LatticePoint {
        p.0.point()
    }

    /// [`points`] with records of few different values, so that some are equal.
    pub(crate) fn numbered(most: usize) -> impl Strategy<Value = Vec<Numbered>> {
        (points(most), prop::collection::vec(0_u8..4, most))
            .prop_map(|(points, numbers)| points.into_iter().map(Key::of).zip(numbers).collect())
    }

    /// Small parameters.
    pub(crate) fn params() -> impl Strategy<Value = Params> {
        (1_u8..=3, 1_u32..=20).prop_map(|(g, leaf_capacity)| Params { g, leaf_capacity })
    }

    proptest! {
        #[test]
        fn the_definition_stores_every_point_once(points in numbered(40), params in params()) {
            let mut all: Vec<_> = tree(&points, at, params).into_values().flat_map(|n| n.2).collect();
            let mut points = points;
            all.sort();
            points.sort();
            prop_assert_eq!(all, points);
        }
    }
}

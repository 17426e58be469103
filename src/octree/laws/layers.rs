//! Invariant 5: levels and filtered levels of one to four layers, against brute force.

use super::*;
use crate::octree::{filtered, level};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn a_level_of_layers_is_the_first_point_of_every_cell_of_the_union(
        points in given::numbered(80),
        params in given::params(),
        layer_of in prop::collection::vec(0_usize..4, 80),
        count in 1_usize..=4,
        pick in any::<prop::sample::Index>(),
    ) {
        let trees = layers(&points, &layer_of, count, params);
        let trees: Vec<_> = trees.iter().collect();
        let root = naive::root(&points, given::at, params.g).unwrap();
        // The whole, and a smaller cube around some point.
        let around = given::at(&points[pick.index(points.len())]);
        for within in [root, Cube::containing(around, root.k() / 2), Cube::containing(around, 1)] {
            let inside: Vec<_> = points.iter().copied().filter(|p| within.contains(given::at(p))).collect();
            let mut finer: Option<Vec<Point>> = None;
            for c in 0..=within.k() {
                let found = level(&trees, within, c).unwrap();
                prop_assert_eq!(&found, &naive::level(&inside, given::at, c, |_| true));
                prop_assert!(finer.is_none_or(|finer| found.iter().all(|p| finer.contains(p))), "levels nest");
                finer = Some(found);
            }
        }
    }

    #[test]
    fn a_filtered_level_is_the_least_match_of_every_cell_of_the_union(
        points in given::numbered(80),
        params in given::params(),
        layer_of in prop::collection::vec(0_usize..4, 80),
        count in 1_usize..=4,
        hidden in 0_u8..16,
        west in any::<bool>(),
    ) {
        let trees = layers(&points, &layer_of, count, params);
        let trees: Vec<_> = trees.iter().collect();
        let root = naive::root(&points, given::at, params.g).unwrap();
        let middle = root.low().0[0] + root.side() / 2;
        let matches = |p: &Point| hidden >> p.1 & 1 == 0 && (!west || given::at(p).0[0] < middle);
        let may = |layer: usize, cube: Cube| {
            trees[layer].nodes().count(cube, matches).1 > 0
        };
        let mut finer: Option<Vec<Point>> = None;
        for c in 0..=root.k() {
            let expected = naive::level(&points, given::at, c, matches);
            let found = filtered(&trees, c, matches, may).unwrap();
            prop_assert_eq!(&found, &expected);
            prop_assert_eq!(&filtered(&trees, c, matches, |_, _| true).unwrap(), &expected, "may only saves work");
            prop_assert!(finer.is_none_or(|finer| found.iter().all(|p| finer.contains(p))), "levels nest");
            finer = Some(found);
        }
    }
}

/// The points as that many layers.
fn layers(points: &[Point], layer_of: &[usize], count: usize, params: Params) -> Vec<MemoryTree<Point>> {
    let of = |layer| points.iter().zip(layer_of).filter(move |(_, l)| **l % count == layer).map(|(p, _)| *p).collect();
    (0..count).map(|layer| MemoryTree::of(of(layer), params)).collect()
}

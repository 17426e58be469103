//! Which cells a point wins, and its rank among the winners around it: all of the level of detail from one sort.

use crate::lattice::{BITS, Cube, SortKey};

/// The exponent of the largest cell that each point wins: the highest digit in which its key differs from its
/// predecessor's, -1 if they are equal; `first` for the first.
///
/// `keys` are sorted. `first` is the root's exponent for the first point of the tree, [`first_win`] for a bucket's.
pub fn wins<K: SortKey>(keys: &[K], first: i8) -> Vec<i8> {
    let mut wins = Vec::new();
    put_wins(keys, first, &mut wins);
    wins
}

/// [`wins`] in place of what `wins` held.
pub fn put_wins<K: SortKey>(keys: &[K], first: i8, wins: &mut Vec<i8>) {
    wins.clear();
    if !keys.is_empty() {
        wins.reserve(keys.len());
        wins.push(first);
        wins.extend(keys.windows(2).map(|w| w[0].differing_digit(w[1])));
    }
}

/// The win of the first point in `bucket`, whose predecessor lies in `previous`, the last bucket before it that holds
/// points; `None` for the first bucket of a tree with this root.
///
/// Which points they are does not matter: points of disjoint aligned cubes all differ first in the same digit.
pub fn first_win(previous: Option<Cube>, bucket: Cube, root: Cube) -> i8 {
    match previous {
        None => root.k() as i8,
        Some(previous) => previous.first_key().differing_digit(bucket.first_key()),
    }
}

/// The group (1, 2, 3 for ranks {1}, {2-4}, {5-7}) of each of a node's own points, which are in key order with their
/// wins; 1 for repeated positions.
///
/// The rank of a point of win `c` is its position among the node's points of equal win in its cell of exponent `c + 1`:
/// all of the tree's, since a node stores either all or none of them.
pub fn steps<K: SortKey>(keys: &[K], wins: &[i8]) -> Vec<u8> {
    /// Groups by rank, from rank 1; a rank beyond 7 does not occur.
    const GROUPS: [u8; 8] = [1, 2, 2, 2, 3, 3, 3, 3];
    let Some((&first, &win)) = keys.first().zip(wins.first()) else { return Vec::new() };
    if wins.iter().all(|&w| w == win) {
        // An inner node, or repeated positions: what is kept from point to point stays in registers.
        let (mut previous, mut next) = (first, 0_u8);
        let group = |&key: &K| {
            let rank = if previous.differs_above(key, win) { 0 } else { next };
            (previous, next) = (key, (rank + 1).min(7));
            GROUPS[usize::from(rank & 7)]
        };
        return if win < 0 { vec![1; keys.len()] } else { keys.iter().map(group).collect() };
    }
    // Per win: the last point that had it, and the rank after it, from 0.
    let mut last = [(first, 0_u8); BITS as usize + 1];
    let group = |(&key, &win): (&K, &i8)| {
        let Ok(c) = usize::try_from(win) else { return 1 };
        let (previous, rank) = last[c.min(BITS as usize)];
        // A choice of values, not of ways: which it is can't be predicted.
        let rank = if previous.differs_above(key, win) { 0 } else { rank };
        last[c.min(BITS as usize)] = (key, (rank + 1).min(7));
        GROUPS[usize::from(rank & 7)]
    };
    keys.iter().zip(wins).map(group).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::{Key, LatticePoint};
    use crate::octree::naive::tests::points;
    use proptest::prelude::*;
    use std::collections::{HashMap, HashSet};

    proptest! {
        #[test]
        fn a_point_wins_the_cells_in_which_it_is_first(mut points in points(60)) {
            points.sort_by_key(|p| Key::of(*p));
            let keys: Vec<_> = points.iter().map(|p| Key::of(*p)).collect();
            let mut seen = HashSet::new();
            let naive: Vec<i8> = points
                .iter()
                .enumerate()
                .map(|(i, p)| {
                    let won = (0..=48).filter(|&c| seen.insert((c, p.0.map(|x| x >> c)))).max();
                    if i == 0 { 30 } else { won.map_or(-1, |c: i32| c as i8) }
                })
                .collect();
            prop_assert_eq!(wins(&keys, 30), naive);
        }

        #[test]
        fn groups_follow_the_rank_in_the_parent_cell(mut points in points(200)) {
            points.sort_by_key(|p| Key::of(*p));
            let keys: Vec<_> = points.iter().map(|p| Key::of(*p)).collect();
            let wins = wins(&keys, 48);
            let mut ranks = HashMap::new();
            let naive: Vec<u8> = points
                .iter()
                .zip(&wins)
                .map(|(p, &win)| {
                    if win < 0 {
                        return 1;
                    }
                    let rank: &mut u32 = ranks.entry((win, p.0.map(|x| x >> (win + 1)))).or_default();
                    *rank += 1;
                    match *rank {
                        1 => 1,
                        2..=4 => 2,
                        5..=7 => 3,
                        _ => panic!("rank {rank}"),
                    }
                })
                .collect();
            prop_assert_eq!(steps(&keys, &wins), naive.clone());
            // Points of one win alone, as an inner node has them.
            for win in -1..=48 {
                let of_win = || (0..keys.len()).filter(|&i| wins[i] == win);
                let some: Vec<_> = of_win().map(|i| keys[i]).collect();
                let expected: Vec<_> = of_win().map(|i| naive[i]).collect();
                prop_assert_eq!(steps(&some, &vec![win; some.len()]), expected);
            }
            // Truncated keys serve where the points share the digits above.
            let span = points.iter().fold(0, |s, p| (0..3).fold(s, |s, i| s | p.0[i] ^ points[0].0[i]));
            if span < 1 << 21 {
                let low: Vec<_> = points.iter().map(|p| p.low_key()).collect();
                prop_assert_eq!(super::wins(&low, 48), wins.clone());
                prop_assert_eq!(steps(&low, &wins), naive);
            }
        }
    }

    #[test]
    fn the_first_win_of_a_bucket_needs_only_the_cubes() {
        let a = Cube::containing(LatticePoint([9, 77, 3]), 2);
        let b = Cube::containing(LatticePoint([900, 7, 30]), 5);
        let (a, b) = if a.first_key() < b.first_key() { (a, b) } else { (b, a) };
        let root = Cube::containing(LatticePoint([0; 3]), 20);
        assert_eq!(first_win(None, a, root), 20);
        for p in [a.low(), a.high()] {
            for q in [b.low(), b.high()] {
                assert_eq!(Key::of(p).differing_digit(Key::of(q)), first_win(Some(a), b, root));
            }
        }
    }
}

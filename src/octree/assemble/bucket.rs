//! The nodes inside one bucket.

use super::{Params, Place};
use crate::lattice::{Cube, SortKey};

/// A node of a bucket, given out after all of its children. Points are indices into the bucket.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EmittedNode<'a> {
    /// The cube.
    pub cube: Cube,
    /// Does it store everything that remains in its cube?
    pub leaf: bool,
    /// Bit `octant` (plain, as in [`Cube::child`]) is set where there is a child.
    pub children: u8,
    /// Points stored here or below.
    pub rem: u64,
    /// Its own points, ascending: in key order.
    pub points: &'a [u32],
}

/// What a bucket leaves to the nodes above it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BucketRest {
    /// The remaining points of the node of the bucket's own cube, if it was given out; else it may still turn out to be
    /// part of a larger leaf.
    pub built: Option<u64>,
    /// The points not stored in any node given out, ascending: those that belong above, and those that wait.
    pub points: Vec<u32>,
}

impl BucketRest {
    /// The points by the node that will store them: what each of its points wins at the largest, as in
    /// [`Block::win`](super::Block::win), ascending, and the points. `wins` are the bucket's, and `cube` is its cube.
    pub fn by_node(&self, cube: Cube, wins: &[i8], params: Params) -> impl Iterator<Item = (i8, Vec<u32>)> + use<> {
        let least = params.cell(cube.k());
        let mut of_win: Vec<Vec<u32>> = Vec::new();
        for &i in &self.points {
            let place = usize::from(wins[i as usize].max(least).abs_diff(least));
            if of_win.len() <= place {
                of_win.resize_with(place + 1, Vec::new);
            }
            of_win[place].push(i);
        }
        (least..=i8::MAX).zip(of_win).filter(|(_, points)| !points.is_empty())
    }
}

/// Gives out the nodes of a bucket and returns the rest.
///
/// `keys` are sorted and all inside `cube`; `wins` are theirs with respect to the whole tree ([`super::super::wins`] with
/// [`super::super::first_win`]). Keys may be truncated if the exponent of `cube` allows it. With [`Place::Root`] the
/// bucket is the whole tree, and nothing is left. The time is a few passes over the wins per level.
///
/// # Panics
///
/// If there are 2^32 points or more, or the lengths differ.
pub fn build_bucket<K: SortKey>(
    cube: Cube,
    keys: &[K],
    wins: &[i8],
    place: Place,
    params: Params,
    mut emit: impl FnMut(EmittedNode),
) -> BucketRest {
    assert!(keys.len() == wins.len() && u32::try_from(keys.len()).is_ok(), "a bucket's keys and wins must match");
    let taken = place.taken(cube.k(), params);
    let rem = count_below(wins, taken);
    let waits = place == Place::Below && (rem <= u64::from(params.leaf_capacity) || cube.k() < params.g);
    let mut scratch = Vec::new();
    if waits || rem == 0 {
        return BucketRest { built: None, points: (0..keys.len() as u32).collect() };
    }
    let mut run = Run { keys, wins, params, scratch: &mut scratch };
    run.node(cube, 0, keys.len(), taken, rem, &mut emit);
    let above = select(wins, 0, i8::MAX, taken, &mut scratch).to_vec();
    BucketRest { built: Some(rem), points: above }
}

/// A sorted run of points while its nodes are given out.
struct Run<'a, K> {
    keys: &'a [K],
    wins: &'a [i8],
    params: Params,
    scratch: &'a mut Vec<u32>,
}

impl<K: SortKey> Run<'_, K> {
    /// Gives out the node of `cube`, which has `rem > 0` points with win < `taken` in `from..to`, and all below it.
    fn node(&mut self, cube: Cube, from: usize, to: usize, taken: i8, rem: u64, emit: &mut impl FnMut(EmittedNode)) {
        let k = cube.k();
        let leaf = self.params.is_leaf(k, rem);
        let least = if leaf { i8::MIN } else { self.params.cell(k) };
        let mut children = 0;
        if !leaf {
            let mut start = from;
            for (digit, octant) in cube.octants_in_key_order().into_iter().enumerate() {
                let Some(child) = cube.child(octant) else { break };
                let end = start + self.keys[start..to].partition_point(|key| usize::from(key.digit(k - 1)) <= digit);
                let child_rem = count_below(&self.wins[start..end], least);
                if child_rem > 0 {
                    children |= 1 << octant;
                    self.node(child, start, end, least, child_rem, emit);
                }
                start = end;
            }
        }
        let points = select(&self.wins[from..to], from, taken, least, self.scratch);
        emit(EmittedNode { cube, leaf, children, rem, points });
    }
}

/// How many wins are less than `bound`.
fn count_below(wins: &[i8], bound: i8) -> u64 {
    // Sums that fit a byte, so that a register holds as many lanes as there are bytes in it.
    wins.chunks(128).map(|c| u64::from(c.iter().map(|&w| u8::from(w < bound)).sum::<u8>())).sum()
}

/// The indices, counted from `first`, of the wins in `least..below`; in `out`.
fn select<'a>(wins: &[i8], first: usize, below: i8, least: i8, out: &'a mut Vec<u32>) -> &'a [u32] {
    let count = (count_below(wins, below) - count_below(wins, least)) as usize;
    out.clear();
    // One more: the place where an index is written that is not kept.
    out.resize(count + 1, 0);
    if count > 0 {
        // `least <= win < below` as one comparison, and no branch on its outcome.
        let width = below.wrapping_sub(least) as u8;
        let mut n = 0;
        for (i, &win) in wins.iter().enumerate() {
            // The bucket has fewer than 2^32 points.
            out[n] = (first + i) as u32;
            n += usize::from((win.wrapping_sub(least) as u8) < width);
        }
    }
    &out[..count]
}

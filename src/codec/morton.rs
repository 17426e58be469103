//! Many keys of one cube back to coordinates at once.

use super::lines::Place;
use crate::lattice::{Cube, LatticeBox, LatticePoint, PRIORITY_MASK};
use crate::points::Positions;

/// Appends the points of `cube`, of exponent at most 21, with these low keys.
///
/// `keys` need only hold the digits below the cube's exponent. One axis after the other, so that the compiler takes
/// several keys at a time; [`Cube::point_of_low_key`] is the same for one key.
pub(super) fn append_points(cube: Cube, keys: &[u64], out: &mut Positions) {
    let inside = cube.side() - 1;
    for (axis, column) in [&mut out.x, &mut out.y, &mut out.z].into_iter().enumerate() {
        // The reflection's bits above the cube are the corner's business.
        let fixed = cube.low().0[axis] ^ (PRIORITY_MASK & inside);
        column.extend(keys.iter().map(|key| (compact(key >> axis) & inside) ^ fixed));
    }
}

/// Where the points of a cube of exponent at most 21 with these keys are, relative to its low corner; replaces what `out`
/// holds.
pub(super) fn places(cube: Cube, keys: impl ExactSizeIterator<Item = u64>, out: &mut Vec<Place>) {
    let inside = cube.side() - 1;
    out.clear();
    out.resize(keys.len(), Place::default());
    // One axis after the other, so that the compiler takes several keys at a time.
    let mut keys = keys;
    for places in out.chunks_mut(LANES) {
        let mut few = [0; LANES];
        few.iter_mut().zip(&mut keys).for_each(|(few, key)| *few = key);
        let axes: [[u64; LANES]; 3] =
            std::array::from_fn(|axis| few.map(|key| (compact(key >> axis) ^ PRIORITY_MASK) & inside));
        for (i, place) in places.iter_mut().enumerate() {
            *place = [axes[0][i] as i32, axes[1][i] as i32, axes[2][i] as i32];
        }
    }
}

/// Keys taken at a time.
const LANES: usize = 16;

/// The tight bounds of the points of `cube`, of exponent at most 21, with these keys relative to the cube's first.
///
/// One axis' bits of a key order as the coordinate does, so only the results are gathered.
pub(super) fn bounds(cube: Cube, keys: &[u64]) -> LatticeBox {
    let inside = cube.side() - 1;
    let low = cube.low().0;
    let mut corners = [[0; 3]; 2];
    for axis in 0..3 {
        let mask = AXIS << axis;
        // The reflection swaps the order within every other digit; undone before comparing.
        let reflection = REFLECTION & mask;
        let (mut least, mut greatest) = (u64::MAX, 0);
        for key in keys {
            let bits = (key ^ reflection) & mask;
            least = least.min(bits);
            greatest = greatest.max(bits);
        }
        corners[0][axis] = low[axis] | compact(least >> axis) & inside;
        corners[1][axis] = low[axis] | compact(greatest >> axis) & inside;
    }
    LatticeBox { min: LatticePoint(corners[0]), max: LatticePoint(corners[1]) }
}

/// The bits of the first axis in a key.
const AXIS: u64 = 0x1249_2492_4924_9249;

/// All bits of every other digit, from the lowest on: what [`PRIORITY_MASK`] becomes in a key.
const REFLECTION: u64 = 0x71c7_1c71_c71c_71c7;

/// Gathers every third bit of the low 63 bits of `v`.
#[inline]
fn compact(v: u64) -> u64 {
    let mut x = v & 0x1249_2492_4924_9249;
    x = (x | x >> 2) & 0x10c3_0c30_c30c_30c3;
    x = (x | x >> 4) & 0x100f_00f0_0f00_f00f;
    x = (x | x >> 8) & 0x001f_0000_ff00_00ff;
    x = (x | x >> 16) & 0x001f_0000_0000_ffff;
    (x | x >> 32) & 0x1f_ffff
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn many_keys_give_the_points_of_each(
            p in prop::array::uniform3(0_u64..1 << 48),
            k in 0_u8..=21,
            keys in prop::collection::vec(any::<u64>(), 0..40),
        ) {
            let cube = Cube::containing(LatticePoint(p), k);
            let prefix = cube.first_key().low;
            let inside = (1 << (3 * k)) - 1;
            let mut positions = Positions::default();
            append_points(cube, &keys, &mut positions);
            let naive: Vec<_> = keys.iter().map(|key| cube.point_of_low_key(prefix | key & inside)).collect();
            prop_assert_eq!(positions.iter().collect::<Vec<_>>(), &naive[..]);
            let mut places = Vec::new();
            super::places(cube, keys.iter().copied(), &mut places);
            for (place, point) in places.iter().zip(&naive) {
                prop_assert_eq!(place.map(|c| c as u64), std::array::from_fn(|i| point.0[i] - cube.low().0[i]));
            }
            if let Some(first) = naive.first() {
                let naive = naive.iter().fold(LatticeBox::of(*first), |b, p| b.with(*p));
                let keys: Vec<_> = keys.iter().map(|key| key & inside).collect();
                prop_assert_eq!(bounds(cube, &keys), naive);
            }
        }
    }
}

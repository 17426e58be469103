//! Aligned cubes, their keys in the file, and boxes of lattice points.

use super::{BITS, Key, LatticePoint, morton};

/// An aligned cube: side `2^k` lattice steps, low corner a multiple of the side on every axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Cube {
    k: u8,
    low: LatticePoint,
}

/// A cube's key in the file: the 144-bit plain Morton code of its low corner, big-endian, then `48 - k`.
///
/// Byte order is pre-order: a cube comes right before its descendants, siblings in octant order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct NodeKey(pub [u8; 19]);

impl Cube {
    /// The aligned cube of exponent `k` that holds `point`; `k` is cut to [`BITS`].
    pub fn containing(point: LatticePoint, k: u8) -> Self {
        let k = k.min(BITS);
        Self { k, low: LatticePoint(point.0.map(|c| c >> k << k)) }
    }

    /// The smallest aligned cube of exponent at least `min_k` that holds both points.
    pub fn spanning(a: LatticePoint, b: LatticePoint, min_k: u8) -> Self {
        let different = (0..3).fold(0, |d, i| d | (a.0[i] ^ b.0[i]));
        let k = (64 - different.leading_zeros()) as u8;
        Self::containing(a, k.max(min_k))
    }

    /// The side's exponent.
    pub fn k(self) -> u8 {
        self.k
    }

    /// The low corner, inside the cube.
    pub fn low(self) -> LatticePoint {
        self.low
    }

    /// The side in lattice steps.
    pub fn side(self) -> u64 {
        1 << self.k
    }

    /// The high corner, inside the cube.
    pub fn high(self) -> LatticePoint {
        LatticePoint(self.low.0.map(|c| c + (self.side() - 1)))
    }

    /// All points of the cube.
    pub fn to_box(self) -> LatticeBox {
        LatticeBox { min: self.low, max: self.high() }
    }

    /// Does the cube hold `point`?
    pub fn contains(self, point: LatticePoint) -> bool {
        (0..3).all(|i| point.0[i] >> self.k == self.low.0[i] >> self.k)
    }

    /// Does the cube hold all of `other`?
    pub fn contains_cube(self, other: Self) -> bool {
        other.k <= self.k && self.contains(other.low)
    }

    /// The cube of twice the side that holds this one; itself if it is the whole lattice.
    pub fn parent(self) -> Self {
        Self::containing(self.low, (self.k + 1).min(BITS))
    }

    /// The aligned cube of exponent `k >= self.k()` that holds this one.
    pub fn ancestor(self, k: u8) -> Self {
        Self::containing(self.low, k.max(self.k))
    }

    /// The child at `octant` (bit 0 x, bit 1 y, bit 2 z; plain, not reflected); `None` at exponent 0.
    pub fn child(self, octant: u8) -> Option<Self> {
        let k = self.k.checked_sub(1)?;
        let low = LatticePoint(std::array::from_fn(|i| self.low.0[i] | u64::from(octant >> i & 1) << k));
        Some(Self { k, low })
    }

    /// Which child of its parent this cube is.
    pub fn octant(self) -> u8 {
        (0..3).fold(0, |o, i| o | ((self.low.0[i] >> self.k & 1) as u8) << i)
    }

    /// The octant of this cube's children that holds `point`, which must be inside.
    pub fn octant_of(self, point: LatticePoint) -> u8 {
        let k = self.k.saturating_sub(1);
        (0..3).fold(0, |o, i| o | ((point.0[i] >> k & 1) as u8) << i)
    }

    /// The octants in the order of the points' keys: octant = digit, with all bits flipped where the digit's position is even.
    pub fn octants_in_key_order(self) -> [u8; 8] {
        let flip = if self.k % 2 == 1 { 7 } else { 0 };
        std::array::from_fn(|digit| digit as u8 ^ flip)
    }

    /// The least key of the cube's points.
    pub fn first_key(self) -> Key {
        Key::of(self.low).floor(self.k)
    }

    /// The greatest key of the cube's points.
    pub fn last_key(self) -> Key {
        Key::of(self.low).ceil(self.k)
    }

    /// The key in the file.
    pub fn node_key(self) -> NodeKey {
        let code = Key::interleave(self.low.0);
        // 144 bits: 81 of `high`, then 63 of `low`.
        let top = code.high >> 1;
        let rest = ((code.high & 1) as u64) << 63 | code.low;
        let mut bytes = [0; 19];
        bytes[..10].copy_from_slice(&top.to_be_bytes()[6..]);
        bytes[10..18].copy_from_slice(&rest.to_be_bytes());
        bytes[18] = BITS - self.k;
        NodeKey(bytes)
    }

    /// The cube with this key; `None` if the key is not one of an aligned cube.
    pub fn from_node_key(key: &NodeKey) -> Option<Self> {
        let mut top = [0; 16];
        top[6..].copy_from_slice(&key.0[..10]);
        let mut rest = [0; 8];
        rest.copy_from_slice(&key.0[10..18]);
        let rest = u64::from_be_bytes(rest);
        let code = Key { high: u128::from_be_bytes(top) << 1 | u128::from(rest >> 63), low: rest & (u64::MAX >> 1) };
        let k = BITS.checked_sub(key.0[18])?;
        let low = LatticePoint(code.deinterleave());
        let cube = Self::containing(low, k);
        (cube.low == low).then_some(cube)
    }

    /// The last key in the file that a descendant of this cube can have: a subtree is the range from
    /// [`Cube::node_key`] to this, both included.
    pub fn last_node_key(self) -> NodeKey {
        Self { k: 0, low: self.high() }.node_key()
    }

    /// `level-x-y-z` below `root`, level 0 being the root itself: for display only, since the root may grow.
    pub fn display_name(self, root: Self) -> String {
        let [x, y, z]: [u64; 3] = std::array::from_fn(|i| self.low.0[i].wrapping_sub(root.low.0[i]) >> self.k);
        format!("{}-{x}-{y}-{z}", root.k.saturating_sub(self.k))
    }

    /// The point in this cube of exponent at most [`super::LOW_DIGITS`] whose key ends in `low_key`.
    #[inline]
    pub fn point_of_low_key(self, low_key: u64) -> LatticePoint {
        let low = morton::low_coordinates(low_key);
        LatticePoint(std::array::from_fn(|i| self.low.0[i] >> 21 << 21 | low[i]))
    }
}

impl NodeKey {
    /// Reads 19 bytes; `None` if there are more or fewer.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        bytes.try_into().ok().map(Self)
    }
}

/// A box of lattice points, both corners inside. Never empty: `min <= max` on every axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LatticeBox {
    /// The least index on each axis.
    pub min: LatticePoint,
    /// The greatest index on each axis, inside.
    pub max: LatticePoint,
}

impl LatticeBox {
    /// The box of one point.
    #[inline]
    pub fn of(point: LatticePoint) -> Self {
        Self { min: point, max: point }
    }

    /// Does it hold `point`?
    #[inline]
    pub fn contains(&self, point: LatticePoint) -> bool {
        (0..3).all(|i| (self.min.0[i]..=self.max.0[i]).contains(&point.0[i]))
    }

    /// Does it hold all of `other`?
    #[inline]
    pub fn contains_box(&self, other: &Self) -> bool {
        (0..3).all(|i| self.min.0[i] <= other.min.0[i] && other.max.0[i] <= self.max.0[i])
    }

    /// Do they share a point?
    #[inline]
    pub fn meets(&self, other: &Self) -> bool {
        (0..3).all(|i| self.min.0[i] <= other.max.0[i] && other.min.0[i] <= self.max.0[i])
    }

    /// The smallest box that holds both.
    #[inline]
    pub fn union(&self, other: &Self) -> Self {
        Self {
            min: LatticePoint(std::array::from_fn(|i| self.min.0[i].min(other.min.0[i]))),
            max: LatticePoint(std::array::from_fn(|i| self.max.0[i].max(other.max.0[i]))),
        }
    }

    /// The smallest box that holds this one and `point`.
    #[inline]
    pub fn with(&self, point: LatticePoint) -> Self {
        self.union(&Self::of(point))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::SortKey;
    use proptest::prelude::*;

    fn any_cube() -> impl Strategy<Value = Cube> {
        (prop::array::uniform3(0_u64..1 << 48), 0_u8..=48).prop_map(|(p, k)| Cube::containing(LatticePoint(p), k))
    }

    proptest! {
        #[test]
        fn node_keys_are_reversible_and_in_pre_order(a in any_cube(), b in any_cube()) {
            prop_assert_eq!(Cube::from_node_key(&a.node_key()), Some(a));
            let (key, last) = (a.node_key(), a.last_node_key());
            prop_assert_eq!((key..=last).contains(&b.node_key()), a.contains_cube(b));
            for o in 0..8 {
                if let Some(child) = a.child(o) {
                    prop_assert!(key < child.node_key() && child.last_node_key() <= last);
                    prop_assert_eq!(child.octant(), o);
                    prop_assert_eq!(child.parent(), a);
                    prop_assert_eq!(a.octant_of(child.high()), o);
                }
            }
        }

        #[test]
        fn octants_in_key_order_are_in_key_order(a in any_cube()) {
            prop_assume!(a.k() > 0);
            let keys: Vec<_> = a.octants_in_key_order().map(|o| a.child(o).unwrap()).into();
            prop_assert!(keys.windows(2).all(|w| w[0].last_key() < w[1].first_key()));
            prop_assert_eq!(a.first_key(), keys[0].first_key());
            prop_assert_eq!(a.last_key(), keys[7].last_key());
            for (digit, cube) in keys.iter().enumerate() {
                prop_assert_eq!(usize::from(cube.first_key().digit(a.k() - 1)), digit);
            }
        }

        #[test]
        fn low_keys_come_back_as_points(p in prop::array::uniform3(0_u64..1 << 48), k in 0_u8..=21) {
            let p = LatticePoint(p);
            prop_assert_eq!(Cube::containing(p, k).point_of_low_key(p.low_key()), p);
        }
    }
}

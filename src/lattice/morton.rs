//! Reflected Morton keys: the fixed priority of points (OCTREE section 1).

use super::{BITS, LatticePoint};

/// `0101...01`: bit i is 1 iff i is even, tied to absolute bit positions.
pub const PRIORITY_MASK: u64 = 0x5555_5555_5555;

/// Digits of a key held in [`Key::low`]: what a truncated sort key orders by.
pub const LOW_DIGITS: u8 = 21;

/// The 144-bit reflected Morton code of a lattice point: 48 digits of three bits, coarsest first.
///
/// `digit_i = bit_i(x ^ M) | bit_i(y ^ M) << 1 | bit_i(z ^ M) << 2`. Keys order as `(high, low)`; point and key determine
/// each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Key {
    /// Digits 47 to 21, 81 bits.
    pub high: u128,
    /// Digits 20 to 0, 63 bits.
    pub low: u64,
}

/// Something that orders the points of one aligned cube as their full keys do.
///
/// `u64` is [`Key::low`] and serves cubes of exponent at most [`LOW_DIGITS`]; [`Key`] serves any.
pub trait SortKey: Copy + Ord + Send + Sync + std::fmt::Debug {
    /// The highest digit in which the two differ; -1 if they are equal.
    fn differing_digit(self, other: Self) -> i8;
    /// Do the two differ in a digit above the one at `index`, which is at least 0?
    fn differs_above(self, other: Self, index: i8) -> bool {
        self.differing_digit(other) > index
    }
    /// The digit at `index`, 0 being the finest.
    fn digit(self, index: u8) -> u8;
    /// The digits from [`LOW_DIGITS`] up, zero where they are not kept, and those below.
    fn halves(self) -> (u128, u64);
    /// The reverse of [`SortKey::halves`]; digits that are not kept are dropped.
    fn from_halves(high: u128, low: u64) -> Self;
}

impl SortKey for u64 {
    #[inline]
    fn differing_digit(self, other: Self) -> i8 {
        match self ^ other {
            0 => -1,
            // At most bit 62, so the quotient is at most 20.
            x => (x.ilog2() / 3) as i8,
        }
    }

    #[inline]
    fn differs_above(self, other: Self, index: i8) -> bool {
        (self ^ other).checked_shr(3 * (u32::from(index.unsigned_abs()) + 1)).is_some_and(|above| above != 0)
    }

    #[inline]
    fn digit(self, index: u8) -> u8 {
        (self >> (3 * index)) as u8 & 7
    }

    #[inline]
    fn halves(self) -> (u128, u64) {
        (0, self)
    }

    #[inline]
    fn from_halves(_: u128, low: u64) -> Self {
        low
    }
}

impl SortKey for Key {
    #[inline]
    fn differing_digit(self, other: Self) -> i8 {
        match self.high ^ other.high {
            0 => self.low.differing_digit(other.low),
            x => (x.ilog2() / 3) as i8 + LOW_DIGITS as i8,
        }
    }

    #[inline]
    fn digit(self, index: u8) -> u8 {
        if index < LOW_DIGITS { self.low.digit(index) } else { (self.high >> (3 * (index - LOW_DIGITS))) as u8 & 7 }
    }

    #[inline]
    fn halves(self) -> (u128, u64) {
        (self.high, self.low)
    }

    #[inline]
    fn from_halves(high: u128, low: u64) -> Self {
        Self { high, low }
    }
}

impl Key {
    /// The key of `point`.
    #[inline]
    pub fn of(point: LatticePoint) -> Self {
        Self::interleave(point.0.map(|c| c ^ PRIORITY_MASK))
    }

    /// The point with this key.
    #[inline]
    pub fn point(self) -> LatticePoint {
        LatticePoint(self.deinterleave().map(|c| c ^ PRIORITY_MASK))
    }

    /// Plain Morton code, without the reflection: the order of node keys.
    #[inline]
    pub(super) fn interleave(c: [u64; 3]) -> Self {
        let [x, y, z] = c.map(spread_low);
        let low = x | y << 1 | z << 2;
        let [x, y, z] = c.map(|c| u128::from(spread_low(c >> 21)) | u128::from(spread_low(c >> 42)) << 63);
        Self { high: x | y << 1 | z << 2, low }
    }

    /// The coordinates of a plain Morton code.
    #[inline]
    pub(super) fn deinterleave(self) -> [u64; 3] {
        [0, 1, 2].map(|axis| {
            let high = self.high >> axis;
            compact(self.low >> axis)
                | compact(high as u64 & (u64::MAX >> 1)) << 21
                | compact((high >> 63) as u64) << 42
        })
    }

    /// The key with its lowest `3 k` bits removed: equal for exactly the points of one aligned cube of exponent `k`.
    #[inline]
    pub fn prefix(self, k: u8) -> Self {
        let bits = 3 * u32::from(k.min(BITS));
        if bits >= 63 {
            Self { high: self.high >> (bits - 63), low: 0 }
        } else {
            Self { high: self.high, low: self.low >> bits }
        }
    }

    /// The least key of the aligned cube of exponent `k` that holds this key.
    #[inline]
    pub fn floor(self, k: u8) -> Self {
        let bits = 3 * u32::from(k.min(BITS));
        if bits >= 63 {
            let shift = bits - 63;
            Self { high: self.high.checked_shr(shift).map_or(0, |h| h << shift), low: 0 }
        } else {
            Self { high: self.high, low: self.low >> bits << bits }
        }
    }

    /// The greatest key of the aligned cube of exponent `k` that holds this key.
    #[inline]
    pub fn ceil(self, k: u8) -> Self {
        let bits = 3 * u32::from(k.min(BITS));
        if bits >= 63 {
            Self { high: self.high | ((1_u128 << (bits - 63)) - 1), low: (1 << 63) - 1 }
        } else {
            Self { high: self.high, low: self.low | ((1_u64 << bits) - 1) }
        }
    }
}

impl LatticePoint {
    /// The low 63 bits of the point's key.
    #[inline]
    pub fn low_key(self) -> u64 {
        let [x, y, z] = self.0.map(|c| spread_low(c ^ PRIORITY_MASK));
        x | y << 1 | z << 2
    }
}

/// Spreads the low 21 bits of `v` to every third bit.
#[inline]
fn spread_low(v: u64) -> u64 {
    let mut x = v & 0x1f_ffff;
    x = (x | x << 32) & 0x001f_0000_0000_ffff;
    x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

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

/// The low 63 bits of a reflected key back to the low 21 bits of each coordinate.
#[inline]
pub(super) fn low_coordinates(low: u64) -> [u64; 3] {
    [0, 1, 2].map(|axis| (compact(low >> axis) ^ PRIORITY_MASK) & 0x1f_ffff)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn naive(point: LatticePoint) -> [u8; 48] {
        std::array::from_fn(|i| {
            let bit = |c: u64| ((c ^ PRIORITY_MASK) >> (47 - i) & 1) as u8;
            bit(point.0[0]) | bit(point.0[1]) << 1 | bit(point.0[2]) << 2
        })
    }

    fn any_point() -> impl Strategy<Value = LatticePoint> {
        prop::array::uniform3(0_u64..1 << 48).prop_map(LatticePoint)
    }

    proptest! {
        #[test]
        fn keys_order_and_differ_as_their_digits_do(a in any_point(), b in any_point(), keep in 0_u8..=48) {
            // Points that share a prefix of random length.
            let mask = if keep == 48 { 0 } else { (1_u64 << (48 - keep)) - 1 };
            let b = LatticePoint(std::array::from_fn(|i| a.0[i] & !mask | b.0[i] & mask));
            let (ka, kb) = (Key::of(a), Key::of(b));
            prop_assert_eq!(ka.point(), a);
            prop_assert_eq!(ka.cmp(&kb), naive(a).cmp(&naive(b)));
            let digit = naive(a).iter().zip(naive(b)).position(|(x, y)| *x != y).map_or(-1, |i| 47 - i as i8);
            prop_assert_eq!(ka.differing_digit(kb), digit);
            for i in 0..48 {
                prop_assert_eq!(ka.digit(i), naive(a)[47 - usize::from(i)]);
            }
            if digit < i8::try_from(LOW_DIGITS).unwrap() {
                prop_assert_eq!(a.low_key().cmp(&b.low_key()), ka.cmp(&kb));
                prop_assert_eq!(a.low_key().differing_digit(b.low_key()), digit);
                for index in 0..=48 {
                    prop_assert_eq!(a.low_key().differs_above(b.low_key(), index), digit > index);
                    prop_assert_eq!(ka.differs_above(kb, index), digit > index);
                }
            }
            for k in 0..=48_u8 {
                let same = i16::from(digit) < i16::from(k);
                prop_assert_eq!(ka.prefix(k) == kb.prefix(k), same);
                prop_assert!(ka.floor(k) <= ka && ka <= ka.ceil(k));
                prop_assert_eq!(ka.floor(k).prefix(k), ka.prefix(k));
                prop_assert_eq!(ka.ceil(k).prefix(k), ka.prefix(k));
            }
        }
    }
}

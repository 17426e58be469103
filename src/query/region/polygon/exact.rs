//! Exact signs: products of 128-bit integers are compared in 256 bits.

use std::cmp::Ordering;

/// A place in the plane, in integer units that may differ between the axes.
pub(crate) type Place = [i128; 2];

/// The most that a coordinate may be from zero, so that differences of two fit.
pub(crate) const REACH: i128 = 1 << 125;

/// `a * b` without loss: the high and the low half of the magnitude.
fn wide(a: u128, b: u128) -> (u128, u128) {
    let half = |v: u128| (v >> 64, v & u128::from(u64::MAX));
    let ((ah, al), (bh, bl)) = (half(a), half(b));
    let (low, middle, other, high) = (al * bl, ah * bl, al * bh, ah * bh);
    let carry = (low >> 64) + (middle & u128::from(u64::MAX)) + (other & u128::from(u64::MAX));
    let low = (low & u128::from(u64::MAX)) | carry << 64;
    (high + (middle >> 64) + (other >> 64) + (carry >> 64), low)
}

/// How `a * b` compares with `c * d`.
pub(crate) fn compare_products(a: i128, b: i128, c: i128, d: i128) -> Ordering {
    if let (Some(left), Some(right)) = (a.checked_mul(b), c.checked_mul(d)) {
        return left.cmp(&right);
    }
    let (left, right) = (a.signum() * b.signum(), c.signum() * d.signum());
    if left != right || left == 0 {
        return left.cmp(&right);
    }
    let magnitudes = wide(a.unsigned_abs(), b.unsigned_abs()).cmp(&wide(c.unsigned_abs(), d.unsigned_abs()));
    if left > 0 { magnitudes } else { magnitudes.reverse() }
}

/// On which side of the line from `a` to `b` a place lies: `Greater` is to the left, `Equal` on the line.
pub(crate) fn side(a: Place, b: Place, p: Place) -> Ordering {
    compare_products(b[0] - a[0], p[1] - a[1], b[1] - a[1], p[0] - a[0])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn products_beyond_128_bits_are_compared_exactly() {
        let big = REACH - 1;
        assert_eq!(compare_products(big, big, big, big), Ordering::Equal);
        assert_eq!(compare_products(big, big, big, big - 1), Ordering::Greater);
        assert_eq!(compare_products(-big, big, big, big), Ordering::Less);
        assert_eq!(compare_products(-big, big, -big, big - 1), Ordering::Less);
        assert_eq!(compare_products(-big, -big, big, big), Ordering::Equal);
        assert_eq!(compare_products(0, big, -big, big), Ordering::Greater);
        assert_eq!(wide(u128::MAX, u128::MAX), (u128::MAX - 1, 1));
    }

    proptest! {
        #[test]
        fn the_wide_product_is_the_sum_of_narrow_ones(a in any::<u128>(), b in any::<u64>(), shift in 0_u32..64) {
            // a * (b << shift) computed by shifting the product of a and b.
            let (high, low) = wide(a, u128::from(b));
            let (sh, sl) = wide(a, u128::from(b) << shift);
            let carried = if shift == 0 { 0 } else { low >> (128 - shift) };
            prop_assert_eq!((sh, sl), (high << shift | carried, low << shift));
            let (ah, al) = (a >> 64, a & u128::from(u64::MAX));
            let lower = al * u128::from(b);
            prop_assert_eq!(high, (ah * u128::from(b) + (lower >> 64)) >> 64);
        }
    }
}

//! Values of any type as unsigned integers in the order of the values, and back, bit for bit.

/// One value of a column.
pub(super) trait Value: Copy + Default {
    /// The value as an unsigned integer of the type's width. Integers and finite floats keep their order; every NaN
    /// and both zeros stay apart.
    fn ordered(self) -> u64;
    /// The reverse of [`Value::ordered`]; bits above the type's width are ignored.
    fn from_ordered(ordered: u64) -> Self;
    /// The value's own bits.
    fn bits(self) -> u64;
    /// The reverse of [`Value::bits`]; bits above the type's width are ignored.
    fn of_bits(bits: u64) -> Self;
    /// How values lie, of which there is at least one.
    fn survey(values: &[Self]) -> Survey;
    /// Are all values the same, bit for bit?
    fn all_same(values: &[Self]) -> bool;
    /// Appends how many steps each value is above `least`: `odd * inverse` is 1 modulo 2^64, and a step is `odd << zeros`.
    fn append_steps(values: &[Self], least: u64, zeros: u32, inverse: u64, out: &mut Vec<u64>);
    /// The same where there are at most 255 of them.
    fn append_few_steps(values: &[Self], least: u64, zeros: u32, inverse: u64, out: &mut Vec<u8>);
    /// The reverse: appends the values that are so many steps above `least`, of which none leaves the type's range.
    fn append_stepped<N: Copy + Into<u64>>(numbers: &[N], least: u64, step: u64, out: &mut Vec<Self>);
}

/// How a block's values lie, by [`Value::ordered`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Survey {
    pub(super) least: u64,
    pub(super) greatest: u64,
    /// The bits in which some value is not as the first.
    pub(super) differing: u64,
}

/// What is done with all values of a block, in the type's own width, so that the compiler may take many at once. For that,
/// closures own what they need: what they borrow might change with every value that is appended, as far as it can tell.
macro_rules! of_blocks {
    ($u:ty) => {
        fn all_same(values: &[Self]) -> bool {
            let native = |v: &Self| v.bits() as $u;
            let Some(first) = values.first().map(native) else { return true };
            // In runs, so that a difference is seen soon.
            values.chunks(256).all(|run| run.iter().map(native).fold(0, |d, v| d | (v ^ first)) == 0)
        }

        fn append_steps(values: &[Self], least: u64, zeros: u32, inverse: u64, out: &mut Vec<u64>) {
            let (least, inverse) = (least as $u, inverse as $u);
            let steps = move |v: &Self| ((v.ordered() as $u).wrapping_sub(least) >> zeros).wrapping_mul(inverse);
            out.extend(values.iter().map(move |v| u64::from(steps(v))));
        }

        fn append_few_steps(values: &[Self], least: u64, zeros: u32, inverse: u64, out: &mut Vec<u8>) {
            let (least, inverse) = (least as $u, inverse as $u);
            if inverse == 1 && zeros == 0 {
                out.extend(values.iter().map(move |v| (v.ordered() as $u).wrapping_sub(least) as u8));
            } else {
                let steps = move |v: &Self| ((v.ordered() as $u).wrapping_sub(least) >> zeros).wrapping_mul(inverse);
                out.extend(values.iter().map(move |v| steps(v) as u8));
            }
        }

        fn append_stepped<N: Copy + Into<u64>>(numbers: &[N], least: u64, step: u64, out: &mut Vec<Self>) {
            let (least, step) = (least as $u, step as $u);
            let ordered = move |n: &N| least.wrapping_add(step.wrapping_mul((*n).into() as $u));
            out.extend(numbers.iter().map(move |n| Self::from_ordered(u64::from(ordered(n)))));
        }

        fn survey(values: &[Self]) -> Survey {
            let native = |v: &Self| v.ordered() as $u;
            let first = native(&values[0]);
            let (mut least, mut greatest, mut differing) = (first, first, 0);
            for value in values.iter().map(native) {
                least = least.min(value);
                greatest = greatest.max(value);
                differing |= value ^ first;
            }
            Survey { least: u64::from(least), greatest: u64::from(greatest), differing: u64::from(differing) }
        }
    };
}

macro_rules! unsigned {
    ($($t:ty),*) => {$(
        impl Value for $t {
            #[inline]
            fn ordered(self) -> u64 {
                u64::from(self)
            }

            #[inline]
            fn from_ordered(ordered: u64) -> Self {
                ordered as $t
            }

            #[inline]
            fn bits(self) -> u64 {
                u64::from(self)
            }

            #[inline]
            fn of_bits(bits: u64) -> Self {
                bits as $t
            }

            of_blocks!($t);
        }
    )*};
}

macro_rules! signed {
    ($($t:ty as $u:ty),*) => {$(
        impl Value for $t {
            #[inline]
            fn ordered(self) -> u64 {
                u64::from((self ^ <$t>::MIN) as $u)
            }

            #[inline]
            fn from_ordered(ordered: u64) -> Self {
                ordered as $t ^ <$t>::MIN
            }

            #[inline]
            fn bits(self) -> u64 {
                u64::from(self as $u)
            }

            #[inline]
            fn of_bits(bits: u64) -> Self {
                bits as $t
            }

            of_blocks!($u);
        }
    )*};
}

macro_rules! float {
    ($($t:ty as $u:ty),*) => {$(
        impl Value for $t {
            #[inline]
            fn ordered(self) -> u64 {
                let bits = self.to_bits();
                let sign = 1 << (<$u>::BITS - 1);
                // Negative numbers grow downwards.
                u64::from(if bits & sign == 0 { bits | sign } else { !bits })
            }

            #[inline]
            fn from_ordered(ordered: u64) -> Self {
                let ordered = ordered as $u;
                let sign = 1 << (<$u>::BITS - 1);
                Self::from_bits(if ordered & sign == 0 { !ordered } else { ordered ^ sign })
            }

            #[inline]
            fn bits(self) -> u64 {
                u64::from(self.to_bits())
            }

            #[inline]
            fn of_bits(bits: u64) -> Self {
                Self::from_bits(bits as $u)
            }

            of_blocks!($u);
        }
    )*};
}

unsigned!(u8, u16, u32, u64);
signed!(i8 as u8, i16 as u16, i32 as u32, i64 as u64);
float!(f32 as u32, f64 as u64);

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn check<T: Value + PartialOrd>(a: T, b: T) {
        for value in [a, b] {
            assert_eq!(T::from_ordered(value.ordered()).bits(), value.bits());
            assert_eq!(T::of_bits(value.bits()).bits(), value.bits());
            assert!(value.ordered() >> (8 * size_of::<T>() - 1) <= 1);
        }
        if a < b {
            assert!(a.ordered() < b.ordered());
        }
    }

    proptest! {
        #[test]
        fn ordered_integers_keep_bits_and_order(a: u64, b: u64) {
            check(a as u8, b as u8);
            check(a as i8, b as i8);
            check(a as u16, b as u16);
            check(a as i16, b as i16);
            check(a as u32, b as u32);
            check(a as i32, b as i32);
            check(a, b);
            check(a as i64, b as i64);
            check(f32::from_bits(a as u32), f32::from_bits(b as u32));
            check(f64::from_bits(a), f64::from_bits(b));
        }
    }

    #[test]
    fn special_floats_stay_apart() {
        for bits in [0, 1 << 63, f64::NAN.to_bits(), 0x7ff0_0000_0000_0001, u64::MAX] {
            check(f64::from_bits(bits), f64::from_bits(!bits));
        }
        assert_ne!(0.0_f64.ordered(), (-0.0_f64).ordered());
    }
}

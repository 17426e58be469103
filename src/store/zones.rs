//! Zone maps: the least and the greatest value of a column over the points that have it.

use super::model::{Range, Slot};
use crate::points::Column;

impl Range {
    /// The smallest range that holds both. Ranges of one attribute have one kind; of two kinds the first is taken.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        match (self, other) {
            (Self::OnlyNan, other) => other,
            (Self::Unsigned(a, b), Self::Unsigned(c, d)) => Self::Unsigned(a.min(c), b.max(d)),
            (Self::Signed(a, b), Self::Signed(c, d)) => Self::Signed(a.min(c), b.max(d)),
            (Self::Float(a, b), Self::Float(c, d)) => Self::Float(a.min(c), b.max(d)),
            (this, _) => this,
        }
    }
}

/// Adds ranges to ranges; both ascend by slot.
pub(super) fn merge_ranges(into: &mut Vec<(Slot, Range)>, other: &[(Slot, Range)]) {
    for &(slot, range) in other {
        match into.binary_search_by_key(&slot, |r| r.0) {
            Ok(i) => into[i].1 = into[i].1.union(range),
            Err(i) => into.insert(i, (slot, range)),
        }
    }
}

/// The range of the values for which `has` is true; `None` if there are none.
///
/// Negative zero counts as zero, so that the range does not depend on the order of the values.
pub(super) fn range_where(column: &Column, has: impl Fn(usize) -> bool) -> Option<Range> {
    let picked = || (0..column.len()).filter(|&i| has(i));
    range_of(column, picked)
}

/// The range of all values.
pub(super) fn range_of_all(column: &Column) -> Option<Range> {
    // In lanes: the compiler may not change the order of comparisons with NaN, so one lane would wait for itself.
    macro_rules! floats {
        ($v:expr, $t:ty) => {{
            const LANES: usize = 8;
            let (mut low, mut high) = ([<$t>::INFINITY; LANES], [<$t>::NEG_INFINITY; LANES]);
            let mut real = [false; LANES];
            for values in $v.chunks(LANES) {
                for (lane, &v) in values.iter().enumerate() {
                    low[lane] = if v < low[lane] { v } else { low[lane] };
                    high[lane] = if v > high[lane] { v } else { high[lane] };
                    real[lane] |= !v.is_nan();
                }
            }
            let low = low.into_iter().fold(<$t>::INFINITY, <$t>::min);
            let high = high.into_iter().fold(<$t>::NEG_INFINITY, <$t>::max);
            let range = Range::Float(f64::from(low) + 0.0, f64::from(high) + 0.0);
            (!$v.is_empty()).then_some(if real.contains(&true) { range } else { Range::OnlyNan })
        }};
    }
    macro_rules! integers {
        ($v:expr, $t:ty, $kind:ident) => {{
            let (low, high) = $v.iter().fold((<$t>::MAX, <$t>::MIN), |(low, high), &v| (low.min(v), high.max(v)));
            (!$v.is_empty()).then_some(Range::$kind(low.into(), high.into()))
        }};
    }
    match column {
        Column::U8(v) => integers!(v, u8, Unsigned),
        Column::U16(v) => integers!(v, u16, Unsigned),
        Column::U32(v) => integers!(v, u32, Unsigned),
        Column::U64(v) => integers!(v, u64, Unsigned),
        Column::I8(v) => integers!(v, i8, Signed),
        Column::I16(v) => integers!(v, i16, Signed),
        Column::I32(v) => integers!(v, i32, Signed),
        Column::I64(v) => integers!(v, i64, Signed),
        Column::F32(v) => floats!(v, f32),
        Column::F64(v) => floats!(v, f64),
    }
}

fn range_of<I: Iterator<Item = usize>>(column: &Column, picked: impl Fn() -> I) -> Option<Range> {
    macro_rules! integers {
        ($v:expr, $t:ty, $kind:ident, $wide:ty) => {{
            let mut any = false;
            let (mut low, mut high) = (<$t>::MAX, <$t>::MIN);
            for i in picked() {
                let v = $v[i];
                low = low.min(v);
                high = high.max(v);
                any = true;
            }
            any.then_some(Range::$kind(<$wide>::from(low), <$wide>::from(high)))
        }};
    }
    macro_rules! floats {
        ($v:expr, $t:ty) => {{
            let mut any = false;
            let (mut low, mut high) = (<$t>::INFINITY, <$t>::NEG_INFINITY);
            let mut real = false;
            for i in picked() {
                let v = $v[i];
                // Comparisons with NaN are false.
                low = if v < low { v } else { low };
                high = if v > high { v } else { high };
                real |= v == v;
                any = true;
            }
            any.then_some(if real { Range::Float(f64::from(low) + 0.0, f64::from(high) + 0.0) } else { Range::OnlyNan })
        }};
    }
    match column {
        Column::U8(v) => integers!(v, u8, Unsigned, u64),
        Column::U16(v) => integers!(v, u16, Unsigned, u64),
        Column::U32(v) => integers!(v, u32, Unsigned, u64),
        Column::U64(v) => integers!(v, u64, Unsigned, u64),
        Column::I8(v) => integers!(v, i8, Signed, i64),
        Column::I16(v) => integers!(v, i16, Signed, i64),
        Column::I32(v) => integers!(v, i32, Signed, i64),
        Column::I64(v) => integers!(v, i64, Signed, i64),
        Column::F32(v) => floats!(v, f32),
        Column::F64(v) => floats!(v, f64),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_float_range_is_that_of_the_numbers_in_any_order(
            mut v in prop::collection::vec(prop_oneof![any::<f64>(), Just(f64::NAN), Just(-0.0), Just(0.0), Just(f64::INFINITY)], 0..40)
        ) {
            let numbers: Vec<f64> = v.iter().copied().filter(|x| !x.is_nan()).collect();
            let found = range_of_all(&Column::F64(v.clone()));
            match found {
                None => prop_assert!(v.is_empty()),
                Some(Range::OnlyNan) => prop_assert!(numbers.is_empty() && !v.is_empty()),
                Some(Range::Float(a, b)) => {
                    prop_assert!(numbers.iter().all(|x| (a..=b).contains(x)));
                    prop_assert!(numbers.contains(&a) && numbers.contains(&b));
                }
                other => prop_assert!(false, "{other:?}"),
            }
            let bits = |r| format!("{r:?}");
            prop_assert_eq!(bits(range_where(&Column::F64(v.clone()), |_| true)), bits(found));
            v.reverse();
            prop_assert_eq!(bits(range_of_all(&Column::F64(v))), bits(found));
        }

        #[test]
        fn a_part_of_the_values_counts(v in prop::collection::vec(any::<i16>(), 0..20), mask: u32) {
            let has = |i: usize| mask >> i & 1 == 1;
            let picked: Vec<i16> = v.iter().enumerate().filter(|(i, _)| has(*i)).map(|(_, x)| *x).collect();
            let naive = picked.iter().min().zip(picked.iter().max());
            let naive = naive.map(|(a, b)| Range::Signed((*a).into(), (*b).into()));
            prop_assert_eq!(range_where(&Column::I16(v.clone()), has), naive);
            prop_assert_eq!(range_of_all(&Column::I16(v.clone())), range_where(&Column::I16(v), |_| true));
        }
    }
}

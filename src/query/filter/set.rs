//! Sets of numbers, as a comparison gives them, on the stored values of one attribute.

use super::parser::Relation;
use crate::lattice::Decimal;
use crate::points::{ScalarType, Scaling};
use crate::query::kinds::Widening;
use std::cmp::Ordering;

/// One end of an interval of exact decimals.
#[derive(Clone, Copy, Debug, PartialEq)]
enum End {
    Open,
    At { value: Decimal, inside: bool },
}

/// A union of intervals of exact decimals.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct DecimalSet(Vec<(End, End)>);

/// The same set on stored values, ready to test. Intervals are ascending and apart.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum ValueSet {
    /// Stored integers within one of these, both ends inside. Exact at any size.
    Integers(Vec<(i128, i128)>),
    /// Values `stored * scale + offset` in f64 (as they are if there is no scaling) within one of these, both ends inside.
    Floats { scaling: Option<Scaling>, intervals: Vec<(f64, f64)> },
}

impl DecimalSet {
    pub fn of_relation(relation: Relation, value: Decimal) -> Self {
        let at = |inside| End::At { value, inside };
        Self(match relation {
            Relation::Equal => vec![(at(true), at(true))],
            Relation::NotEqual => vec![(End::Open, at(false)), (at(false), End::Open)],
            Relation::Less => vec![(End::Open, at(false))],
            Relation::LessOrEqual => vec![(End::Open, at(true))],
            Relation::Greater => vec![(at(false), End::Open)],
            Relation::GreaterOrEqual => vec![(at(true), End::Open)],
        })
    }

    pub fn between(low: Decimal, high: Decimal) -> Self {
        let at = |value| End::At { value, inside: true };
        Self(vec![(at(low), at(high))])
    }

    pub fn any_of(values: impl Iterator<Item = Decimal>) -> Self {
        let at = |value| End::At { value, inside: true };
        Self(values.map(|v| (at(v), at(v))).collect())
    }

    /// The set on stored integers with `value = scale * stored + offset` in exact decimals; `None` if the numbers have
    /// too many digits for that, or the scale is zero.
    pub fn on_integers(&self, scale: Decimal, offset: Decimal) -> Option<ValueSet> {
        let mut intervals = Vec::with_capacity(self.0.len());
        for &(low, high) in &self.0 {
            // With a negative scale the ends change places.
            let (low, high) = if scale < Decimal::ZERO { (high, low) } else { (low, high) };
            let least = match low {
                End::Open => i128::MIN,
                End::At { value, inside } => {
                    let (floor, exact) = quotient(value, scale, offset)?;
                    if exact && inside { floor } else { floor.saturating_add(1) }
                }
            };
            let greatest = match high {
                End::Open => i128::MAX,
                End::At { value, inside } => {
                    let (floor, exact) = quotient(value, scale, offset)?;
                    if exact && !inside { floor.saturating_sub(1) } else { floor }
                }
            };
            if least <= greatest {
                intervals.push((least, greatest));
            }
        }
        Some(ValueSet::Integers(union(intervals)))
    }

    /// The set on values in f64: every bound is the float nearest to it.
    pub fn on_floats(&self, scaling: Option<Scaling>) -> ValueSet {
        let mut intervals = Vec::with_capacity(self.0.len());
        for &(low, high) in &self.0 {
            let least = match low {
                End::Open => f64::NEG_INFINITY,
                End::At { value, inside: true } => value.to_f64(),
                End::At { value, inside: false } => value.to_f64().next_up(),
            };
            let greatest = match high {
                End::Open => f64::INFINITY,
                End::At { value, inside: true } => value.to_f64(),
                End::At { value, inside: false } => value.to_f64().next_down(),
            };
            if least <= greatest {
                intervals.push((least, greatest));
            }
        }
        ValueSet::Floats { scaling, intervals: union(intervals) }
    }
}

/// The same numbers in intervals that are ascending and apart.
fn union<T: PartialOrd + Copy>(mut intervals: Vec<(T, T)>) -> Vec<(T, T)> {
    // No end is NaN.
    intervals.sort_unstable_by(|a, b| a.partial_cmp(b).unwrap_or(Ordering::Equal));
    intervals.dedup_by(|next, last| {
        let meets = next.0 <= last.1;
        if meets && next.1 > last.1 {
            last.1 = next.1;
        }
        meets
    });
    intervals
}

/// Up to so many intervals are quicker tried one after the other.
const FEW: usize = 8;

/// Is a number in one of these intervals, which are ascending and apart? NaN is in none.
#[inline(always)]
pub(super) fn in_any<T: PartialOrd + Copy>(value: T, intervals: &[(T, T)]) -> bool {
    if intervals.len() <= FEW {
        return intervals.iter().any(|&(low, high)| low <= value && value <= high);
    }
    let at = intervals.partition_point(|&(_, high)| high < value);
    intervals.get(at).is_some_and(|&(low, high)| low <= value && value <= high)
}

/// `(value - offset) / scale` rounded down, and whether that was exact.
fn quotient(value: Decimal, scale: Decimal, offset: Decimal) -> Option<(i128, bool)> {
    if scale == Decimal::new(1, 0) && offset == Decimal::ZERO {
        return Some(floor(value));
    }
    let difference = value.checked_sub(offset)?;
    let exponent = difference.common_exponent(scale);
    let (dividend, divisor) = (difference.scaled_to(exponent)?, scale.scaled_to(exponent)?);
    // Rounded down also where the divisor is negative.
    let (dividend, divisor) =
        if divisor < 0 { (dividend.checked_neg()?, divisor.checked_neg()?) } else { (dividend, divisor) };
    Some((dividend.checked_div_euclid(divisor)?, dividend.checked_rem_euclid(divisor)? == 0))
}

/// The number rounded down, saturating, and whether it was whole.
fn floor(value: Decimal) -> (i128, bool) {
    let beyond = if value.mantissa() < 0 { i128::MIN } else { i128::MAX };
    if value.exponent() >= 0 {
        (value.scaled_to(0).unwrap_or(beyond), true)
    } else {
        match 10_i128.checked_pow(value.exponent().unsigned_abs()) {
            Some(d) => (value.mantissa().div_euclid(d), value.mantissa().rem_euclid(d) == 0),
            None => (if value.mantissa() < 0 { -1 } else { 0 }, false),
        }
    }
}

impl ValueSet {
    /// The stored integers of a type that become one of these.
    pub fn before(&self, widening: Widening, ty: ScalarType) -> Self {
        let (low, high) = match ty {
            ScalarType::I8 => (-128, 127),
            ScalarType::U8 => (0, 255),
            _ => (0, 65_535),
        };
        let mut intervals: Vec<(i128, i128)> = Vec::new();
        for stored in low..=high {
            let value = widening.of(stored);
            match intervals.last_mut() {
                _ if !self.meets_integers(value, value).0 => {}
                Some(last) if last.1 + 1 == stored => last.1 = stored,
                _ => intervals.push((stored, stored)),
            }
        }
        Self::Integers(intervals)
    }

    /// Can a stored value within `[low, high]` be in the set; can one be outside it? Both conservative.
    pub fn meets_integers(&self, low: i128, high: i128) -> (bool, bool) {
        match self {
            Self::Integers(intervals) => meets(intervals, low, high),
            Self::Floats { scaling, intervals } => meets_scaled(*scaling, intervals, low as f64, high as f64),
        }
    }

    /// The same for floats.
    pub fn meets_floats(&self, low: f64, high: f64) -> (bool, bool) {
        match self {
            // Integers are never stored as floats; be conservative all the same.
            Self::Integers(_) => (true, true),
            Self::Floats { scaling, intervals } => meets_scaled(*scaling, intervals, low, high),
        }
    }
}

fn meets<T: PartialOrd + Copy>(intervals: &[(T, T)], low: T, high: T) -> (bool, bool) {
    // The first that does not end before.
    let Some(&(a, b)) = intervals.get(intervals.partition_point(|&(_, end)| end < low)) else { return (false, true) };
    (a <= high, !(a <= low && high <= b))
}

fn meets_scaled(scaling: Option<Scaling>, intervals: &[(f64, f64)], low: f64, high: f64) -> (bool, bool) {
    let (a, b) = (scaled(scaling, low), scaled(scaling, high));
    // An infinite end times a zero scale, say: nothing can be excluded.
    if a.is_nan() || b.is_nan() {
        return (true, true);
    }
    meets(intervals, a.min(b), a.max(b))
}

/// The value of a stored number.
#[inline]
pub(super) fn scaled(scaling: Option<Scaling>, stored: f64) -> f64 {
    scaling.map_or(stored, |s| stored * s.scale + s.offset)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const RELATIONS: [Relation; 6] = [
        Relation::Equal,
        Relation::NotEqual,
        Relation::Less,
        Relation::LessOrEqual,
        Relation::Greater,
        Relation::GreaterOrEqual,
    ];

    fn holds(relation: Relation, order: Ordering) -> bool {
        match relation {
            Relation::Equal => order.is_eq(),
            Relation::NotEqual => order.is_ne(),
            Relation::Less => order.is_lt(),
            Relation::LessOrEqual => order.is_le(),
            Relation::Greater => order.is_gt(),
            Relation::GreaterOrEqual => order.is_ge(),
        }
    }

    proptest! {
        #[test]
        fn integer_sets_are_decided_in_exact_decimals(
            relation in prop::sample::select(RELATIONS.to_vec()),
            (m, e) in (-5000_i128..5000, -3_i32..3),
            (sm, se) in (prop::sample::select(vec![-25_i128, -1, 1, 3, 125]), -3_i32..2),
            offset in prop::sample::select(vec![0_i128, 7, -12345]),
            stored in -3000_i128..3000,
        ) {
            let (value, scale, offset) = (Decimal::new(m, e), Decimal::new(sm, se), Decimal::new(offset, -2));
            let Some(ValueSet::Integers(intervals)) =
                DecimalSet::of_relation(relation, value).on_integers(scale, offset) else { panic!("small numbers fit") };
            let inside = intervals.iter().any(|&(a, b)| (a..=b).contains(&stored));
            // stored * scale + offset, exactly.
            let product = Decimal::new(stored * scale.mantissa(), scale.exponent());
            let exact = product.checked_sub(Decimal::new(-offset.mantissa(), offset.exponent())).unwrap();
            prop_assert_eq!(inside, holds(relation, exact.cmp(&value)));
        }

        #[test]
        fn float_sets_compare_as_floats_do(
            relation in prop::sample::select(RELATIONS.to_vec()),
            stored in prop_oneof![any::<f64>(), (-9_i32..9).prop_map(|i| f64::from(i) / 10.0)],
            m in -90_i128..90,
        ) {
            let value = Decimal::new(m, -1);
            let ValueSet::Floats { intervals, .. } = DecimalSet::of_relation(relation, value).on_floats(None)
                else { panic!("floats were asked for") };
            let inside = intervals.iter().any(|&(a, b)| a <= stored && stored <= b);
            let order = stored.partial_cmp(&value.to_f64());
            prop_assert_eq!(inside, order.is_some_and(|o| holds(relation, o)));
        }
    }

    proptest! {
        #[test]
        fn many_intervals_are_searched_as_each_of_them_is_tried(
            values in prop::collection::vec(-300_i128..300, 0..60),
            (low, span) in (-320_i128..320, 0_i128..40),
        ) {
            let set = DecimalSet::any_of(values.iter().map(|&v| Decimal::new(v, -1)));
            let ValueSet::Floats { intervals, .. } = set.on_floats(None) else { panic!("floats were asked for") };
            let tenths = Decimal::new(1, -1);
            let Some(ValueSet::Integers(integers)) = set.on_integers(tenths, Decimal::ZERO) else { panic!("they fit") };
            for v in -320..320 {
                prop_assert_eq!(in_any(Decimal::new(v, -1).to_f64(), &intervals), values.contains(&v));
                prop_assert_eq!(in_any(v, &integers), values.contains(&v));
            }
            prop_assert!(!in_any(f64::NAN, &intervals));
            let high = low + span;
            let some = values.iter().any(|v| (low..=high).contains(v));
            let only = span == 0 && some;
            prop_assert_eq!(ValueSet::Integers(integers).meets_integers(low, high), (some, !only));
        }
    }

    #[test]
    fn intervals_that_meet_become_one() {
        assert_eq!(union(vec![(5, 9), (0, 3), (2, 4), (9, 9), (1, 2)]), [(0, 4), (5, 9)]);
        assert_eq!(
            union(vec![(0.0, 1.0), (-0.0, -0.0), (f64::NEG_INFINITY, -3.0)]),
            [(f64::NEG_INFINITY, -3.0), (0.0, 1.0)]
        );
        assert_eq!(union::<i128>(vec![]), []);
    }

    #[test]
    fn numbers_beyond_every_integer_are_compared_all_the_same() {
        let one = Decimal::new(1, 0);
        let set = |relation, value| DecimalSet::of_relation(relation, value).on_integers(one, Decimal::ZERO).unwrap();
        let huge = Decimal::new(1, 300);
        assert_eq!(set(Relation::Greater, huge).meets_integers(i64::MIN.into(), u64::MAX.into()), (false, true));
        assert_eq!(set(Relation::Less, huge).meets_integers(i64::MIN.into(), u64::MAX.into()), (true, false));
        let tiny = Decimal::new(-1, -300);
        assert_eq!(set(Relation::Greater, tiny), ValueSet::Integers(vec![(0, i128::MAX)]));
        assert_eq!(set(Relation::Equal, Decimal::new(25, -1)), ValueSet::Integers(vec![]));
    }
}

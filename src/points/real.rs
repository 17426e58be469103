//! Stored values of an attribute with a scale and an offset to real ones.

use super::{Attribute, Column, Scaling};
use crate::lattice::Decimal;
use std::ops::Range;

/// How stored values become real ones, `stored * scale + offset`: of integers the `f64` nearest to the exact decimal, as filters
/// compare them and text has them; of floats in `f64`.
#[derive(Clone, Copy, Debug)]
pub struct Real {
    scaling: Option<Scaling>,
    exact: Option<Exact>,
}

/// The real value of integer `n` is `(factor * n + addend) * 10^exponent`.
#[derive(Clone, Copy, Debug)]
struct Exact {
    factor: i128,
    addend: i128,
    exponent: i32,
}

impl Real {
    /// By a scaling; without one values are what is stored.
    pub fn new(scaling: Option<Scaling>) -> Self {
        let exact = |s: Scaling| {
            let (scale, offset) = (Decimal::from_f64(s.scale)?, Decimal::from_f64(s.offset)?);
            let exponent = scale.common_exponent(offset);
            let units = |d: Decimal| d.scaled_to(exponent).filter(|m| m.unsigned_abs() < 1 << 62);
            Some(Exact { factor: units(scale)?, addend: units(offset)?, exponent })
        };
        Self { scaling, exact: scaling.and_then(exact) }
    }

    /// The real value of a stored integer of at most 64 bits.
    #[inline]
    pub fn of_integer(&self, stored: i128) -> f64 {
        let Some(Exact { factor, addend, exponent }) = self.exact else { return self.of_float(stored as f64) };
        let units = factor * stored + addend;
        // Both are floats, so their quotient is the nearest one; a power of ten is up to the 22nd.
        if (-22..=0).contains(&exponent) && units.unsigned_abs() <= 1 << 53 {
            units as f64 / 10_f64.powi(-exponent)
        } else {
            Decimal::new(units, exponent).to_f64()
        }
    }

    /// The real value of a stored float.
    #[inline]
    pub fn of_float(&self, stored: f64) -> f64 {
        self.scaling.map_or(stored, |s| stored * s.scale + s.offset)
    }

    /// The real value of point `i` of a column.
    #[inline]
    pub fn value(&self, column: &Column, i: usize) -> f64 {
        column.as_integer(i).map_or_else(|| self.of_float(column.as_f64(i)), |n| self.of_integer(n))
    }

    /// The real values of these points of a column of `attribute`; NaN for its no-data value.
    pub fn values(attribute: &Attribute, column: &Column, range: Range<usize>) -> impl Iterator<Item = f64> {
        let (real, no_data) = (Self::new(attribute.scaling), attribute.no_data_bytes());
        range.map(move |i| if no_data == Some(column.raw(i)) { f64::NAN } else { real.value(column, i) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn integers_become_the_floats_that_their_decimals_are_read_as(
            stored in prop_oneof![-40_000_i64..40_000, any::<i64>()],
            (mantissa, digits) in (-9_999_i64..10_000, 0_i32..9),
            (offset, offset_digits) in (-99_999_i64..100_000, 0_i32..5),
        ) {
            let text = |m: i64, digits: i32| format!("{m}e-{digits}").parse::<f64>().unwrap();
            let scaling = Scaling { scale: text(mantissa, digits), offset: text(offset, offset_digits) };
            let most = digits.max(offset_digits) as u32;
            let units = i128::from(stored) * i128::from(mantissa) * 10_i128.pow(most - digits as u32)
                + i128::from(offset) * 10_i128.pow(most - offset_digits as u32);
            let expected: f64 = format!("{units}e-{most}").parse().unwrap();
            prop_assert_eq!(Real::new(Some(scaling)).value(&Column::I64(vec![stored]), 0), expected);
        }
    }

    #[test]
    fn no_data_is_nan_and_floats_are_scaled_in_f64() {
        let scaling = Some(Scaling { scale: 0.05, offset: 0.0 });
        let no_data = Some([0xff, 0xff, 9, 9, 9, 9, 9, 9]);
        let attribute = Attribute { scaling, no_data, ..Attribute::new("height", super::super::ScalarType::I16) };
        let values: Vec<f64> = Real::values(&attribute, &Column::I16(vec![7, -1, 2999]), 1..3).collect();
        assert!(values[0].is_nan());
        assert_eq!(values[1], 149.95);
        assert_eq!(Real::new(scaling).value(&Column::F64(vec![2999.0]), 0), 2999.0 * 0.05);
        assert_eq!(Real::new(None).value(&Column::U8(vec![7]), 0), 7.0);
    }
}

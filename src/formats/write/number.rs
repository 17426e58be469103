//! Numbers as text, into a buffer that is used again: integers, exact decimals, shortest floats.

use crate::lattice::{BIAS, Decimal, Lattice};
use crate::points::Scaling;
use std::io::Write;

/// Appends an unsigned integer.
pub(super) fn push_unsigned(out: &mut Vec<u8>, mut value: u64) {
    let mut digits = [0; 20];
    let mut start = digits.len();
    loop {
        start -= 1;
        digits[start] = b'0' + (value % 10) as u8;
        value /= 10;
        if value == 0 {
            break;
        }
    }
    out.extend_from_slice(&digits[start..]);
}

/// Appends a signed integer.
pub(super) fn push_signed(out: &mut Vec<u8>, value: i64) {
    if value < 0 {
        out.push(b'-');
    }
    push_unsigned(out, value.unsigned_abs());
}

/// Appends the shortest text that reads back as `value`.
pub(super) fn push_f64(out: &mut Vec<u8>, value: f64) {
    let magnitude = value.abs();
    // Writing to a vector cannot fail.
    let _ = if (1e-5..1e16).contains(&magnitude) || value == 0.0 || !value.is_finite() {
        write!(out, "{value}")
    } else {
        write!(out, "{value:e}")
    };
}

/// Appends the shortest text that reads back as `value`.
pub(super) fn push_f32(out: &mut Vec<u8>, value: f32) {
    let magnitude = value.abs();
    // Writing to a vector cannot fail.
    let _ = if (1e-5..1e16).contains(&magnitude) || value == 0.0 || !value.is_finite() {
        write!(out, "{value}")
    } else {
        write!(out, "{value:e}")
    };
}

/// Prints `(factor * n + addend) * 10^exponent` for integers `n`, exactly and without trailing zeros.
#[derive(Clone, Copy, Debug)]
pub(super) struct Exact {
    factor: i128,
    addend: i128,
    exponent: i32,
}

impl Exact {
    /// For `scale * n + offset`; `None` if these have too many digits for `n` of 64 bits.
    fn new(scale: Decimal, offset: Decimal) -> Option<Self> {
        let exponent = scale.common_exponent(offset);
        let fits = |d: Decimal| d.scaled_to(exponent).filter(|m| m.unsigned_abs() < 1 << 62);
        (-40..=40).contains(&exponent).then_some(())?;
        Some(Self { factor: fits(scale)?, addend: fits(offset)?, exponent })
    }

    /// For the lattice's coordinates on `axis`, where `n` is the index less [`BIAS`].
    pub fn of_axis(lattice: &Lattice, axis: usize) -> Option<Self> {
        Self::new(lattice.quantum()[axis], lattice.phase()[axis])
    }

    /// For scaled extra bytes of an integer type.
    pub fn of_scaling(scaling: Scaling) -> Option<Self> {
        Self::new(Decimal::from_f64(scaling.scale)?, Decimal::from_f64(scaling.offset)?)
    }

    /// Appends the coordinate of lattice index `index`.
    pub fn push_index(&self, out: &mut Vec<u8>, index: u64) {
        self.push(out, i128::from(index) - i128::from(BIAS));
    }

    /// Appends the number for `n`, of 64 bits.
    pub fn push(&self, out: &mut Vec<u8>, n: i128) {
        let units = self.factor * n + self.addend;
        if units < 0 {
            out.push(b'-');
        }
        let units = units.unsigned_abs();
        let start = out.len();
        // 128-bit divisions are slow, and hardly ever needed.
        match u64::try_from(units) {
            Ok(units) => push_unsigned(out, units),
            Err(_) => {
                let _ = write!(out, "{units}");
            }
        }
        if units == 0 {
            return;
        }
        if self.exponent >= 0 {
            out.resize(out.len() + self.exponent as usize, b'0');
            return;
        }
        let decimals = self.exponent.unsigned_abs() as usize;
        let digits = out.len() - start;
        if digits <= decimals {
            // Zeros in front, one of them before the point.
            let zeros = decimals + 1 - digits;
            out.resize(out.len() + zeros, b'0');
            out[start..].rotate_right(zeros);
        }
        let point = out.len() - decimals;
        out.insert(point, b'.');
        while out.last() == Some(&b'0') {
            out.pop();
        }
        if out.last() == Some(&b'.') {
            out.pop();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn text(push: impl FnOnce(&mut Vec<u8>)) -> String {
        let mut out = b"before".to_vec();
        push(&mut out);
        String::from_utf8(out).unwrap().strip_prefix("before").unwrap().to_owned()
    }

    /// `number` read as a decimal, digit by digit.
    fn parse(number: &str) -> Decimal {
        let (whole, fraction) = number.split_once('.').unwrap_or((number, ""));
        assert!(!fraction.ends_with('0') && !number.ends_with('.'), "{number}");
        Decimal::new(format!("{whole}{fraction}").parse().unwrap(), -(fraction.len() as i32))
    }

    proptest! {
        #[test]
        fn coordinates_are_the_exact_decimals(
            quantum in prop::sample::select(vec![1e-6, 0.00025, 0.001, 0.3, 1.0, 1000.0]),
            phase in prop::sample::select(vec![0_i128, 123, 500, 999]),
            index in prop_oneof![0_u64..1 << 48, (BIAS as u64 - 20_000)..(BIAS as u64 + 20_000)],
        ) {
            let quantum = Decimal::from_f64(quantum).unwrap();
            let phase = Decimal::new(quantum.mantissa() * phase, quantum.exponent() - 3);
            let lattice = Lattice::new([quantum; 3], [phase; 3]).unwrap();
            let written = text(|out| Exact::of_axis(&lattice, 2).unwrap().push_index(out, index));
            prop_assert_eq!(parse(&written), lattice.decimal_on_axis(2, index), "{}", written);
        }

        #[test]
        fn floats_and_integers_read_back(bits in any::<u64>(), i in any::<i64>()) {
            let (double, single) = (f64::from_bits(bits), f32::from_bits(bits as u32));
            let back: f64 = text(|out| push_f64(out, double)).parse().unwrap();
            prop_assert!(back.to_bits() == double.to_bits() || double.is_nan() && back.is_nan());
            let back: f32 = text(|out| push_f32(out, single)).parse().unwrap();
            prop_assert!(back.to_bits() == single.to_bits() || single.is_nan() && back.is_nan());
            prop_assert_eq!(text(|out| push_signed(out, i)), i.to_string());
        }
    }

    #[test]
    fn numbers_look_plain() {
        let exact = |scale: f64, offset: f64, n| {
            let exact = Exact::of_scaling(Scaling { scale, offset }).unwrap();
            text(|out| exact.push(out, n))
        };
        assert_eq!(exact(0.1, 0.0, 3), "0.3");
        assert_eq!(exact(0.001, 0.0, -5), "-0.005");
        assert_eq!(exact(0.001, 0.0, 5_000_000), "5000");
        assert_eq!(exact(0.25, -1.0, 4), "0");
        assert_eq!(exact(100.0, 0.0, 12), "1200");
        assert_eq!(exact(0.01, 0.0, i128::from(i64::MIN)), "-92233720368547758.08");
        assert_eq!(text(|out| push_f64(out, 0.1)), "0.1");
        assert_eq!(text(|out| push_f64(out, 1e300)), "1e300");
        assert_eq!(text(|out| push_f64(out, f64::NAN)), "NaN");
        assert_eq!(text(|out| push_signed(out, i64::MIN)), "-9223372036854775808");
    }
}

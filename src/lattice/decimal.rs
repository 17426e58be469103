//! Exact decimal numbers: what a quantum, an offset or the face of a box *is*.

use std::cmp::Ordering;
use std::fmt;

/// `mantissa * 10^exponent`, with no trailing zero in the mantissa (zero has exponent 0), so that equality is structural.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Decimal {
    mantissa: i128,
    exponent: i32,
}

impl Decimal {
    /// Zero.
    pub const ZERO: Self = Self { mantissa: 0, exponent: 0 };

    /// `mantissa * 10^exponent`, normalised.
    pub fn new(mut mantissa: i128, mut exponent: i32) -> Self {
        if mantissa == 0 {
            return Self::ZERO;
        }
        while mantissa % 10 == 0 {
            mantissa /= 10;
            exponent += 1;
        }
        Self { mantissa, exponent }
    }

    /// The shortest decimal that reads back as `value`; `None` for NaN and infinities.
    pub fn from_f64(value: f64) -> Option<Self> {
        if !value.is_finite() {
            return None;
        }
        let text = format!("{value:e}");
        let (digits, exponent) = text.split_once('e')?;
        let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
        let mantissa: i128 = format!("{whole}{fraction}").parse().ok()?;
        let exponent: i32 = exponent.parse().ok()?;
        Some(Self::new(mantissa, exponent - fraction.len() as i32))
    }

    /// The mantissa, without trailing zeros.
    pub fn mantissa(self) -> i128 {
        self.mantissa
    }

    /// The power of ten.
    pub fn exponent(self) -> i32 {
        self.exponent
    }

    /// The integer `n` with `self = n * 10^exponent`; `None` if there is none or it does not fit.
    pub fn scaled_to(self, exponent: i32) -> Option<i128> {
        if self.mantissa == 0 {
            return Some(0);
        }
        let shift = self.exponent.checked_sub(exponent)?;
        self.mantissa.checked_mul(10_i128.checked_pow(u32::try_from(shift).ok()?)?)
    }

    /// The difference, if it fits.
    pub fn checked_sub(self, other: Self) -> Option<Self> {
        let exponent = self.common_exponent(other);
        let difference = self.scaled_to(exponent)?.checked_sub(other.scaled_to(exponent)?)?;
        Some(Self::new(difference, exponent))
    }

    /// `self` modulo `modulus`, in `[0, modulus)`, if the arithmetic fits and the modulus is positive.
    pub fn checked_rem_euclid(self, modulus: Self) -> Option<Self> {
        let exponent = self.common_exponent(modulus);
        let m = modulus.scaled_to(exponent).filter(|&m| m > 0)?;
        Some(Self::new(self.scaled_to(exponent)?.rem_euclid(m), exponent))
    }

    /// The finest power of ten that both numbers are multiples of (zero is a multiple of any).
    pub fn common_exponent(self, other: Self) -> i32 {
        match (self.mantissa, other.mantissa) {
            (0, 0) => 0,
            (0, _) => other.exponent,
            (_, 0) => self.exponent,
            _ => self.exponent.min(other.exponent),
        }
    }

    /// The nearest `f64`.
    pub fn to_f64(self) -> f64 {
        // The standard library's parser rounds correctly; this is not on a hot path.
        format!("{}e{}", self.mantissa, self.exponent).parse().unwrap_or(f64::NAN)
    }
}

impl fmt::Display for Decimal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.to_f64())
    }
}

impl PartialOrd for Decimal {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Decimal {
    fn cmp(&self, other: &Self) -> Ordering {
        let sign = self.mantissa.signum().cmp(&other.mantissa.signum());
        if sign != Ordering::Equal {
            return sign;
        }
        let exponent = self.common_exponent(*other);
        match (self.scaled_to(exponent), other.scaled_to(exponent)) {
            (Some(a), Some(b)) => a.cmp(&b),
            // Only the one with the larger exponent can overflow, so it is the larger in magnitude.
            (None, _) if self.mantissa > 0 => Ordering::Greater,
            (None, _) => Ordering::Less,
            (_, None) if self.mantissa > 0 => Ordering::Less,
            (_, None) => Ordering::Greater,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_the_shortest_decimal() {
        assert_eq!(Decimal::from_f64(0.01), Some(Decimal::new(1, -2)));
        assert_eq!(Decimal::from_f64(-1250.0), Some(Decimal::new(-125, 1)));
        assert_eq!(Decimal::from_f64(0.00025), Some(Decimal::new(25, -5)));
        assert_eq!(Decimal::from_f64(f64::NAN), None);
        assert_eq!(Decimal::from_f64(-0.0), Some(Decimal::ZERO));
    }

    #[test]
    fn orders_numbers_of_any_magnitude() {
        let sorted = [-1e300, -2.0, -1e-300, 0.0, 1e-300, 0.5, 3.0, 1e300].map(|v| Decimal::from_f64(v).unwrap());
        assert!(sorted.is_sorted());
        assert!(sorted.windows(2).all(|w| w[0] < w[1]));
    }

    #[test]
    fn remainder_is_in_range() {
        let r = |a: f64, b: f64| {
            Decimal::from_f64(a).unwrap().checked_rem_euclid(Decimal::from_f64(b).unwrap()).unwrap().to_f64()
        };
        assert_eq!(r(-0.003, 0.01), 0.007);
        assert_eq!(r(1234.5678, 0.01), 0.0078);
        assert_eq!(r(5.0, 0.01), 0.0);
    }
}

//! A word as a number: the digits as they stand, where they are few enough, and the nearest float.

/// Powers of ten that f64 holds exactly.
const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20,
    1e21, 1e22,
];

/// A number that was read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Number {
    /// The nearest f64.
    pub value: f64,
    /// The digits, if they are written without an exponent and at most 18 count.
    pub decimal: Option<Digits>,
}

/// `mantissa / 10^decimals`, as it was written: with trailing zeros.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Digits {
    /// All digits, with the sign.
    pub mantissa: i64,
    /// Digits behind the point.
    pub decimals: u8,
    /// Is there a point?
    pub pointed: bool,
}

impl Digits {
    /// The integer `n` with `self = n / 10^decimals`; `None` if there is none.
    #[inline]
    pub fn steps(self, decimals: u8) -> Option<i128> {
        let shift = u32::from(decimals.abs_diff(self.decimals));
        let power = 10_i128.checked_pow(shift)?;
        if decimals >= self.decimals {
            i128::from(self.mantissa).checked_mul(power)
        } else {
            (i128::from(self.mantissa) % power == 0).then(|| i128::from(self.mantissa) / power)
        }
    }
}

/// Whole numbers up to this are floats of 64 bits.
pub const MOST_EXACT: u64 = 1 << 53;

/// Does the float that a decimal was read as, written with as many digits, give that decimal again? Numbers that a program
/// wrote with 17 digits so that they would do; most with more don't.
pub fn comes_back(word: &[u8], value: f64) -> bool {
    let end = word.iter().position(|b| matches!(b, b'e' | b'E')).unwrap_or(word.len());
    let digits: Vec<u8> = word[..end].iter().copied().filter(u8::is_ascii_digit).collect();
    let Some(first) = digits.iter().position(|&d| d != b'0') else { return true };
    let last = digits.iter().rposition(|&d| d != b'0').unwrap_or(first);
    let digits = &digits[first..=last];
    if digits.len() <= 15 || !value.is_finite() {
        return true;
    }
    let written = format!("{:.*e}", digits.len() - 1, value);
    written.bytes().take_while(|&b| b != b'e').filter(u8::is_ascii_digit).eq(digits.iter().copied())
}

/// Reads a number; a comma is a point where `comma` says so. Empty words and `NA` are NaN; `-` is not, which may be the
/// beginning of a number whose line is cut.
#[inline]
pub fn parse(word: &[u8], comma: bool) -> Option<Number> {
    let (negative, digits) = match word {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        rest => (false, rest),
    };
    let mut mantissa = 0_u64;
    let mut pointed = false;
    let mut decimals = 0_u8;
    // Nineteen digits, leading zeros counted, always fit; longer words take the slow way.
    if digits.is_empty() || digits.len() > 19 {
        return slow(word, comma);
    }
    for &b in digits {
        match b {
            b'0'..=b'9' => {
                mantissa = 10 * mantissa + u64::from(b - b'0');
                decimals += u8::from(pointed);
            }
            b'.' if !pointed => pointed = true,
            b',' if comma && !pointed => pointed = true,
            _ => return slow(word, comma),
        }
    }
    if pointed && digits.len() == 1 || mantissa >= 1 << 60 {
        return slow(word, comma);
    }
    let size = mantissa as i64;
    let signed = if negative { -size } else { size };
    let value = if mantissa < 1 << 53 {
        // Both are exact, so one division rounds once. A negative zero keeps its sign.
        let size = mantissa as f64 / POWERS[usize::from(decimals)];
        if negative { -size } else { size }
    } else {
        slow(word, comma)?.value
    };
    Some(Number { value, decimal: Some(Digits { mantissa: signed, decimals, pointed }) })
}

#[cold]
fn slow(word: &[u8], comma: bool) -> Option<Number> {
    let text = std::str::from_utf8(word).ok()?;
    let pointed;
    let text = if comma && text.contains(',') {
        pointed = text.replacen(',', ".", 1);
        &pointed
    } else {
        text
    };
    let missing = text.is_empty() || ["na", "n/a", "null", "none"].iter().any(|n| text.eq_ignore_ascii_case(n));
    let value = if missing { f64::NAN } else { text.parse().ok().or_else(|| odd_float(text))? };
    Some(Number { value, decimal: None })
}

/// What C libraries print for what is no number: `-nan(ind)`, `1.#INF`, `-1.#IND`.
pub fn odd_float(text: &str) -> Option<f64> {
    let lower = text.to_ascii_lowercase();
    let (sign, rest) = match lower.strip_prefix('-') {
        Some(rest) => (-1.0, rest),
        None => (1.0, &*lower),
    };
    if rest.starts_with("1.#inf") {
        Some(sign * f64::INFINITY)
    } else if rest.starts_with("nan(") || rest.starts_with("1.#") {
        Some(f64::NAN)
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_is_no_number_is_refused() {
        for word in ["", "NA", "n/a", "nan", "-nan(ind)", "NULL", "none"] {
            assert!(parse(word.as_bytes(), false).unwrap().value.is_nan(), "{word}");
        }
        for word in [".", "-", "+", "1.2.3", "0x10", "1,5", "abc", "1e", "--1", "1 2"] {
            assert_eq!(parse(word.as_bytes(), false), None, "{word}");
        }
        assert_eq!(parse(b"-1,5", true).unwrap().value, -1.5);
        assert_eq!(parse(b"1.#INF", false).unwrap().value, f64::INFINITY);
        assert_eq!(parse(b"-0.0", false).unwrap().value.to_bits(), (-0.0_f64).to_bits());
    }

    #[test]
    fn digits_stay_as_written() {
        let digits = |word: &str| parse(word.as_bytes(), false).unwrap().decimal;
        assert_eq!(digits("-12.340"), Some(Digits { mantissa: -12340, decimals: 3, pointed: true }));
        assert_eq!(digits("12").unwrap().steps(3), Some(12000));
        assert_eq!(digits("1.50").unwrap().steps(1), Some(15));
        assert_eq!(digits("1.55").unwrap().steps(1), None);
        assert_eq!(digits("1e3"), None);
        assert_eq!(digits("9999999999999999999"), None);
    }

    proptest! {
        /// The standard library is the judge.
        #[test]
        fn values_are_the_nearest_floats(whole in "[+-]?[0-9]{0,12}", fraction in "(\\.[0-9]{0,12})?", e in "(e-?[0-9]{1,2})?") {
            let word = format!("{whole}{fraction}{e}");
            let expected: Option<f64> = word.parse().ok();
            let found = parse(word.as_bytes(), false).map(|n| n.value).filter(|_| !word.is_empty());
            prop_assert_eq!(found.map(f64::to_bits), expected.map(f64::to_bits), "{}", word);
        }
    }
}

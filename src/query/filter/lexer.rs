//! Text to tokens.

use super::FilterError;
use crate::lattice::Decimal;
use crate::points::ScalarType;

/// The most digits of a number that are kept exactly; more is refused.
const MAX_DIGITS: usize = 36;

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Kind {
    /// A bare word: a keyword or a name.
    Word(String),
    /// A name in double quotes or backticks; where a text is due, a text.
    Quoted(String),
    /// A text in single quotes.
    Text(String),
    /// A number, as the decimal that was written.
    Number(Decimal),
    /// `=`, `<=`, `(`, ...: the normal form of it.
    Symbol(&'static str),
    /// After the last token.
    End,
}

#[derive(Clone, Debug)]
pub(super) struct Token {
    pub kind: Kind,
    /// The first character's place, in characters.
    pub at: usize,
}

/// What may be written, and its normal form; longer ones first.
const SYMBOLS: &[(&str, &str)] = &[
    ("==", "="),
    ("!=", "<>"),
    ("<>", "<>"),
    ("<=", "<="),
    (">=", ">="),
    ("&&", "and"),
    ("||", "or"),
    ("=", "="),
    ("<", "<"),
    (">", ">"),
    ("!", "not"),
    ("(", "("),
    (")", ")"),
    (",", ","),
    ("-", "-"),
    ("+", "+"),
];

pub(super) fn tokens(text: &str) -> Result<Vec<Token>, FilterError> {
    let chars: Vec<char> = text.chars().collect();
    let mut tokens = Vec::new();
    let mut i = 0;
    while i < chars.len() {
        let at = i;
        let c = chars[i];
        let kind = if c.is_whitespace() {
            i += 1;
            continue;
        } else if c == '\'' || c == '"' || c == '`' {
            let quoted = quoted(&chars, &mut i).ok_or_else(|| FilterError::new("this quote has no end", text, at))?;
            if c == '\'' { Kind::Text(quoted) } else { Kind::Quoted(quoted) }
        } else if c.is_ascii_digit() || (c == '.' && chars.get(i + 1).is_some_and(char::is_ascii_digit)) {
            let digits = number(&chars, &mut i);
            if chars.get(i).is_some_and(|c| c.is_alphanumeric() || *c == '_' || *c == '.') {
                return Err(FilterError::new("this is not a number", text, at));
            }
            let value = decimal(&digits).ok_or_else(|| {
                FilterError::new(format!("\"{digits}\" is not a number of at most {MAX_DIGITS} digits"), text, at)
            })?;
            Kind::Number(value)
        } else if c.is_alphabetic() || c == '_' {
            Kind::Word(word(&chars, &mut i))
        } else {
            let rest: String = chars[i..chars.len().min(i + 2)].iter().collect();
            let Some((written, symbol)) = SYMBOLS.iter().find(|(s, _)| rest.starts_with(s)) else {
                return Err(FilterError::new(format!("\"{c}\" has no meaning here"), text, at));
            };
            i += written.len();
            Kind::Symbol(symbol)
        };
        tokens.push(Token { kind, at });
    }
    tokens.push(Token { kind: Kind::End, at: chars.len() });
    Ok(tokens)
}

/// The text between two quotes of one kind; a doubled quote stands for one.
fn quoted(chars: &[char], i: &mut usize) -> Option<String> {
    let quote = chars[*i];
    let mut text = String::new();
    loop {
        *i += 1;
        let c = *chars.get(*i)?;
        if c == quote {
            *i += 1;
            if chars.get(*i) != Some(&quote) {
                return Some(text);
            }
        }
        text.push(c);
    }
}

/// A name: letters, digits, `_`, `.`, an index in brackets, and the word of a type behind a colon.
fn word(chars: &[char], i: &mut usize) -> String {
    let start = *i;
    while chars.get(*i).is_some_and(|c| c.is_alphanumeric() || *c == '_' || *c == '.') {
        *i += 1;
    }
    if chars.get(*i) == Some(&'[') {
        let digits = chars[*i + 1..].iter().take_while(|c| c.is_ascii_digit()).count();
        if digits > 0 && chars.get(*i + 1 + digits) == Some(&']') {
            *i += digits + 2;
        }
    }
    if chars.get(*i) == Some(&':') {
        let letters = chars[*i + 1..].iter().take_while(|c| c.is_alphanumeric()).count();
        let word: String = chars[*i + 1..*i + 1 + letters].iter().collect();
        if ScalarType::from_word(&word).is_some() {
            *i += letters + 1;
        }
    }
    chars[start..*i].iter().collect()
}

fn number(chars: &[char], i: &mut usize) -> String {
    let start = *i;
    let digits = |i: &mut usize| {
        while chars.get(*i).is_some_and(char::is_ascii_digit) {
            *i += 1;
        }
    };
    digits(i);
    if chars.get(*i) == Some(&'.') {
        *i += 1;
        digits(i);
    }
    if chars.get(*i).is_some_and(|c| matches!(c, 'e' | 'E')) {
        let sign = usize::from(chars.get(*i + 1).is_some_and(|c| matches!(c, '+' | '-')));
        if chars.get(*i + 1 + sign).is_some_and(char::is_ascii_digit) {
            *i += 1 + sign;
            digits(i);
        }
    }
    chars[start..*i].iter().collect()
}

fn decimal(text: &str) -> Option<Decimal> {
    let (mantissa, exponent) = text.split_once(['e', 'E']).unwrap_or((text, "0"));
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    let digits = format!("{whole}{fraction}");
    let significant = digits.trim_start_matches('0');
    if significant.len() > MAX_DIGITS {
        return None;
    }
    let mantissa: i128 = if significant.is_empty() { 0 } else { significant.parse().ok()? };
    let exponent: i32 = exponent.parse().ok().filter(|e: &i32| (-1000..=1000).contains(e))?;
    Some(Decimal::new(mantissa, exponent.checked_sub(i32::try_from(fraction.len()).ok()?)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_the_decimals_that_were_written() {
        let one = |text: &str| match tokens(text).unwrap().remove(0).kind {
            Kind::Number(d) => d,
            other => panic!("{other:?}"),
        };
        assert_eq!(one("1.50"), Decimal::new(15, -1));
        assert_eq!(one(".25e2"), Decimal::new(25, 0));
        assert_eq!(one("18446744073709551615"), Decimal::new(u64::MAX.into(), 0));
        assert_eq!(one("0.000"), Decimal::ZERO);
        assert_eq!(one("1e-3"), Decimal::new(1, -3));
        for bad in ["1.2.3", "12abc", "1e99999", "1234567890123456789012345678901234567890"] {
            assert!(tokens(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn quotes_and_indices_are_part_of_names() {
        let kinds: Vec<_> = tokens("\"my \"\"x\"\"\" 'it''s' flow[2] extra.Red Intensity:f32 n[0]:u8>1 a<>b").unwrap();
        let kinds: Vec<_> = kinds.into_iter().map(|t| t.kind).collect();
        let word = |s: &str| Kind::Word(s.into());
        let expected = vec![
            Kind::Quoted("my \"x\"".into()),
            Kind::Text("it's".into()),
            word("flow[2]"),
            word("extra.Red"),
            word("Intensity:f32"),
            word("n[0]:u8"),
            Kind::Symbol(">"),
            Kind::Number(Decimal::new(1, 0)),
            word("a"),
            Kind::Symbol("<>"),
            word("b"),
            Kind::End,
        ];
        assert_eq!(kinds, expected);
        assert!(tokens("'open").is_err());
        assert!(tokens("a # b").is_err());
        assert!(tokens("a:f33").is_err() && tokens("a:f32x").is_err() && tokens("a:").is_err());
    }
}

//! What goes to stdout and stderr, and how errors read.

use crate::points::Number;
use std::io::{self, Write};

/// The error and its causes on one line, without saying anything twice. What is wrong with a filter keeps its second and
/// third line, which point at the place.
pub(super) fn one_line(error: &anyhow::Error) -> String {
    let mut line = String::new();
    for cause in error.chain() {
        let text = cause.to_string();
        if line.is_empty() {
            line = text;
        } else if !line.contains(&text) {
            line.push_str(": ");
            line.push_str(&text);
        }
    }
    if line.starts_with("filter: ") { line } else { line.replace('\n', " ") }
}

/// Prints a line to stderr. That it can't be written is nobody's loss: there is no other place to say so.
macro_rules! tell {
    ($($words:tt)*) => {{
        use std::io::Write;
        let _ = writeln!(std::io::stderr().lock(), $($words)*);
    }};
}
pub(super) use tell;

/// Was the reader of our stdout gone?
pub(super) fn is_closed_pipe(error: &anyhow::Error) -> bool {
    error.chain().any(|c| c.downcast_ref::<io::Error>().is_some_and(|e| e.kind() == io::ErrorKind::BrokenPipe))
}

/// Prints a line to stdout; a closed pipe is an error, not a panic.
pub(super) fn line(text: impl std::fmt::Display) -> io::Result<()> {
    writeln!(io::stdout().lock(), "{text}").map_err(named)
}

/// Names what could not be written.
fn named(error: io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("writing to the standard output failed: {error}"))
}

/// Prints one JSON value on stdout.
pub(super) fn json(value: &serde_json::Value) -> io::Result<()> {
    let mut out = io::stdout().lock();
    serde_json::to_writer_pretty(&mut out, value).map_err(|e| named(e.into()))?;
    writeln!(out).map_err(named)
}

/// `1234567` as `1,234,567`.
pub(super) fn grouped(n: u64) -> String {
    let digits = n.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(c);
    }
    text
}

/// `1 point`, `2,000 points`.
pub(super) fn counted(n: u64, what: &str) -> String {
    format!("{} {what}{}", grouped(n), if n == 1 { "" } else { "s" })
}

/// `1 point lies`, `2,000 points lie`.
pub(super) fn agreeing(n: u64, what: &str, [one, many]: [&str; 2]) -> String {
    format!("{} {}", counted(n, what), if n == 1 { one } else { many })
}

/// A number for people: floats far from one with an exponent.
pub(super) fn number(n: Number) -> String {
    match n {
        Number::Float(v) if is_far(v) => format!("{v:e}"),
        _ => n.to_string(),
    }
}

/// A mean, to six digits behind the point.
pub(super) fn mean(v: f64) -> String {
    if is_far(v) { format!("{v:.6e}") } else { format!("{v:.6}") }
}

/// Is it easier to read with an exponent?
fn is_far(v: f64) -> bool {
    v.is_finite() && v != 0.0 && !(1e-5..1e16).contains(&v.abs())
}

/// A size for people: `12.3 MiB`.
pub(super) fn bytes(n: u64) -> String {
    let mut value = n as f64;
    for unit in ["B", "KiB", "MiB", "GiB"] {
        if value < 1024.0 {
            return if unit == "B" { format!("{n} B") } else { format!("{value:.1} {unit}") };
        }
        value /= 1024.0;
    }
    format!("{value:.1} TiB")
}

/// A name from a file, fit for a terminal: control characters are replaced.
pub(super) fn clean(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect()
}

/// Several lines of names and words, fit for a terminal.
pub(super) fn clean_lines(text: &str) -> String {
    text.lines().map(clean).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_and_sizes_read_well() {
        assert_eq!(grouped(0), "0");
        assert_eq!(grouped(1_234_567), "1,234,567");
        assert_eq!([0, 1, 2000].map(|n| counted(n, "node")), ["0 nodes", "1 node", "2,000 nodes"]);
        assert_eq!([1, 2].map(|n| agreeing(n, "point", ["lies", "lie"])), ["1 point lies", "2 points lie"]);
        let shown = |v: f64| [number(Number::Float(v)), mean(v)];
        assert_eq!(shown(0.0), ["0", "0.000000"]);
        assert_eq!(shown(-1234.5), ["-1234.5", "-1234.500000"]);
        assert_eq!(shown(1e15), ["1000000000000000", "1000000000000000.000000"]);
        assert_eq!(shown(-1.7976931348623157e308), ["-1.7976931348623157e308", "-1.797693e308"]);
        assert_eq!(shown(1e16), ["1e16", "1.000000e16"]);
        assert_eq!(shown(2.5e-40), ["2.5e-40", "2.500000e-40"]);
        assert_eq!(shown(f64::INFINITY), ["inf", "inf"]);
        assert_eq!(number(Number::Unsigned(u64::MAX)), "18446744073709551615");
        assert_eq!(bytes(1023), "1023 B");
        assert_eq!(bytes(1536), "1.5 KiB");
        assert_eq!(clean("a\u{1b}[31m\n"), "a\u{fffd}[31m\u{fffd}");
    }

    #[test]
    fn an_error_is_one_line_with_its_causes() {
        let error = anyhow::anyhow!("no space left").context("a.las: writing failed");
        assert_eq!(one_line(&error), "a.las: writing failed: no space left");
    }
}

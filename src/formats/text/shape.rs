//! What the first lines of a text look like.

use super::columns::{axes, roles};
use super::number::parse;
use super::words::{Separator, is_comment, without_mark};

/// Bytes that are looked at.
pub const HEAD_BYTES: u64 = 1 << 16;

/// What a text may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// Columns, rows, four lines of three numbers, four of four: a block of PTX.
    Ptx,
    /// A number alone, then rows: a block of PTS.
    Pts,
    /// Rows, with or without a line of names.
    Rows,
}

/// The shape of a text that begins with `head`.
pub fn shape(head: &[u8]) -> Option<Shape> {
    let head = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head);
    if head.iter().any(|b| b.is_ascii_control() && !b.is_ascii_whitespace()) {
        return None;
    }
    let mut lines = head.split(|&b| b == b'\n').filter(|l| !l.trim_ascii().is_empty());
    let named = |line: &[u8]| names(line).and_then(|n| axes(&roles(&n)));
    let mut header = None;
    let first = lines.by_ref().find(|l| {
        header = named(l).or(header);
        !is_comment(l)
    })?;
    if let Some(axes) = header {
        // CloudCompare writes how many points there are below the names of the columns.
        let mut rows = [first].into_iter().chain(lines).skip_while(|l| named(l).is_some() || is_count(l));
        return rows.next().is_none_or(|l| row_at(l, axes).is_some()).then_some(Shape::Rows);
    }
    if is_count(first) {
        let next: Vec<_> = lines.take(9).collect();
        let numbers = |line: &[u8]| Separator::Blank.words(line).map(|w| parse(w, false)).collect::<Option<Vec<_>>>();
        let words = |i: usize| next.get(i).and_then(|l| numbers(l)).map_or(0, |n| n.len());
        return match next.len() {
            0 => Some(Shape::Pts),
            9 if is_count(next[0]) && (1..5).all(|i| words(i) == 3) && (5..9).all(|i| words(i) == 4) => {
                Some(Shape::Ptx)
            }
            _ if words(0) >= 3 => Some(Shape::Pts),
            _ => None,
        };
    }
    row(first).map(|_| Shape::Rows)
}

/// Is it one whole number, alone?
pub fn is_count(line: &[u8]) -> bool {
    let line = line.trim_ascii();
    !line.is_empty() && line.len() < 20 && line.iter().all(u8::is_ascii_digit)
}

/// How the words of a row of numbers are separated, and whether a comma is a decimal point; `None` if it is no such row.
pub fn row(line: &[u8]) -> Option<(Separator, bool)> {
    row_at(line, [0, 1, 2]).filter(|(separator, _)| separator.words(line).take(3).all(|w| !w.is_empty()))
}

/// As [`row`], where it is known that coordinates are at these places; each may be missing.
pub fn row_at(line: &[u8], axes: [usize; 3]) -> Option<(Separator, bool)> {
    Separator::styles(line).find(|&(separator, comma)| {
        let number = |at: usize| separator.words(line).nth(at).is_some_and(|w| parse(w, comma).is_some());
        axes.into_iter().all(number)
    })
}

/// The words of a line as names; `None` unless there are three at least.
pub fn names(line: &[u8]) -> Option<Vec<String>> {
    let line = without_mark(line).trim_ascii();
    // What is not UTF-8 is Latin-1 most likely.
    let text = |word: Vec<u8>| {
        String::from_utf8(word).unwrap_or_else(|e| e.as_bytes().iter().map(|&b| char::from(b)).collect())
    };
    let mut words = Separator::of(line).words(line);
    let words: Vec<_> = std::iter::from_fn(|| words.next_name()).map(text).collect();
    (words.len() >= 3).then_some(words)
}

//! The words of a row.

use super::number::parse;

/// What stands between the words of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Separator {
    /// Blanks and tabs, any number of them.
    Blank,
    /// One of these; two next to each other have an empty word between them.
    Byte(u8),
}

impl Separator {
    /// The one that `line` uses, if it is a row of names or of numbers with decimal points.
    pub fn of(line: &[u8]) -> Self {
        let line = line.trim_ascii();
        if line.contains(&b';') {
            Self::Byte(b';')
        } else if line.contains(&b',') {
            Self::Byte(b',')
        } else if has_cells(line) {
            Self::Byte(b'\t')
        } else {
            Self::Blank
        }
    }

    /// How a row of numbers may be meant, the likeliest first: what separates them, and whether a comma is a decimal point.
    pub fn styles(line: &[u8]) -> impl Iterator<Item = (Self, bool)> {
        let (semicolons, commas, cells) = (line.contains(&b';'), line.contains(&b','), has_cells(line));
        let styles = [
            (semicolons, Self::Byte(b';'), true),
            (commas, Self::Byte(b','), false),
            (cells, Self::Byte(b'\t'), commas),
            (true, Self::Blank, commas),
        ];
        let count = if semicolons { 1 } else { styles.len() };
        styles.into_iter().take(count).filter(|s| s.0).map(|(_, separator, comma)| (separator, comma))
    }

    /// Is the line a remark among rows? No row is taken for one.
    pub fn is_comment(self, line: &[u8]) -> bool {
        match line.trim_ascii_start() {
            [b';', ..] => self != Self::Byte(b';'),
            line => is_comment(line),
        }
    }

    /// The words of `line`, without blanks and quotes around them.
    pub fn words(self, line: &[u8]) -> Words<'_> {
        let trimmed = line.trim_ascii();
        // A tab at the front has an empty cell before it.
        let line = if self == Self::Byte(b'\t') { line.trim_ascii_end() } else { trimmed };
        Words { rest: (!trimmed.is_empty()).then_some(line), separator: self }
    }
}

/// Are the words between tabs what belongs together? Not where blanks stand between numbers, too, nor where tabs are many to
/// make columns even.
fn has_cells(line: &[u8]) -> bool {
    let number = |word: &[u8]| parse(word, true).is_some();
    let apart = |cell: &[u8]| {
        let mut words = cell.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty());
        words.next().is_some_and(number) && words.next().is_some()
    };
    let line = line.trim_ascii();
    line.contains(&b'\t')
        && !line.split(|&b| b == b'\t').any(apart)
        && line.split(|&b| b == b'\t').take(3).all(|cell| !cell.trim_ascii().is_empty())
}

/// The words of a line.
#[derive(Clone, Debug)]
pub struct Words<'a> {
    rest: Option<&'a [u8]>,
    separator: Separator,
}

impl<'a> Iterator for Words<'a> {
    type Item = &'a [u8];

    #[inline]
    fn next(&mut self) -> Option<&'a [u8]> {
        let rest = self.rest?;
        match self.separator {
            Separator::Blank => {
                let length = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
                let after = rest[length..].trim_ascii_start();
                self.rest = (!after.is_empty()).then_some(after);
                Some(unquoted(&rest[..length]))
            }
            Separator::Byte(byte) => {
                if let Some((word, after)) = in_quotes(rest, byte) {
                    self.rest = after;
                    return Some(word);
                }
                let length = rest.iter().position(|&b| b == byte);
                self.rest = length.map(|n| &rest[n + 1..]);
                Some(unquoted(rest[..length.unwrap_or(rest.len())].trim_ascii()))
            }
        }
    }
}

impl Words<'_> {
    /// The next word as a name: as [`Iterator::next`] gives it, but two quotes inside quotes are one.
    pub fn next_name(&mut self) -> Option<Vec<u8>> {
        let is_in_quotes = match (self.separator, self.rest) {
            (Separator::Byte(byte), Some(rest)) => in_quotes(rest, byte).is_some(),
            _ => false,
        };
        let mut name = self.next()?.to_vec();
        if is_in_quotes {
            let mut is_second = false;
            name.retain(|&b| {
                is_second = b == b'"' && !is_second;
                b != b'"' || is_second
            });
        }
        Some(name)
    }
}

/// A first word in double quotes, which may hold separators (RFC 4180), and what follows it.
fn in_quotes(rest: &[u8], separator: u8) -> Option<(&[u8], Option<&[u8]>)> {
    let first = rest.iter().position(|&b| b != b' ')?;
    let inside = rest[first..].strip_prefix(b"\"")?;
    let mut end = 0;
    loop {
        end += inside[end..].iter().position(|&b| b == b'"')?;
        // Two quotes are one that belongs to the word.
        if inside.get(end + 1) != Some(&b'"') {
            break;
        }
        end += 2;
    }
    let (word, after) = (inside[..end].trim_ascii(), &inside[end + 1..]);
    let blanks = after.iter().take_while(|&&b| b == b' ').count();
    match after.get(blanks) {
        None => Some((word, None)),
        Some(&b) if b == separator => Some((word, Some(&after[blanks + 1..]))),
        Some(_) => None,
    }
}

fn unquoted(word: &[u8]) -> &[u8] {
    match word {
        [b'"', inside @ .., b'"'] | [b'\'', inside @ .., b'\''] => inside.trim_ascii(),
        _ => word,
    }
}

/// Is the line a remark, where it is not known what separates words?
pub fn is_comment(line: &[u8]) -> bool {
    let line = line.trim_ascii_start();
    match line {
        [b'#' | b'%', ..] | [b'/', b'/', ..] => true,
        // With others after it, it may separate a first word that is not there from the second.
        [b';', rest @ ..] => !rest.contains(&b';'),
        _ => false,
    }
}

/// A remark without the mark before it; other lines as they are.
pub fn without_mark(line: &[u8]) -> &[u8] {
    let line = line.trim_ascii();
    match line {
        [b'/', b'/', rest @ ..] => rest,
        [_, rest @ ..] if is_comment(line) => rest,
        _ => line,
    }
}

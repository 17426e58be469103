//! How the vertices of a PLY text lie on its lines.

use super::ascii::Words;
use super::header::{Element, Header, Kind};
use crate::formats::FormatError;
use crate::formats::file::SourceFile;

/// Lines that are looked at.
const SAMPLE: u64 = 16;

/// A vertex has no more words than that.
const LONGEST_LINE: usize = 1 << 16;

/// How a text has its vertices.
///
/// The format's description has one a line. Some programs read words and don't look at lines, so a file of theirs may have
/// them otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextLines {
    /// Each on a line of its own.
    OnePerVertex,
    /// Otherwise.
    Any,
}

impl TextLines {
    /// As most of the first vertices are.
    pub fn of(file: &SourceFile, header: &Header, vertex: usize) -> Result<Self, FormatError> {
        let mut words = Words::new(file, header.data_offset);
        for element in &header.elements[..vertex] {
            // What can't be passed over is told when it is read.
            if !skip_text(&mut words, element).unwrap_or(false) {
                return Ok(Self::OnePerVertex);
            }
        }
        if words.peek()?.is_some_and(|(_, begins_line)| !begins_line) {
            return Ok(Self::Any);
        }
        let element = &header.elements[vertex];
        let (mut lines, mut fitting) = (0, 0);
        let mut line = Vec::new();
        while lines < SAMPLE.min(element.count) {
            let next = words.peek()?;
            if !line.is_empty() && next.is_none_or(|(_, begins_line)| begins_line) {
                let length = record_words(element, &line);
                // A file may end in the middle of a line.
                lines += u64::from(next.is_some() || length.is_some_and(|length| length <= line.len()));
                fitting += u64::from(length == Some(line.len()));
                line.clear();
            }
            let Some((word, _)) = words.next()? else { break };
            if line.len() == LONGEST_LINE {
                return Ok(Self::Any);
            }
            // Of a list nothing but its count matters.
            line.push(std::str::from_utf8(word).ok().and_then(|w| w.parse::<usize>().ok()));
        }
        Ok(if fitting * 2 >= lines { Self::OnePerVertex } else { Self::Any })
    }
}

/// How many words a record has that begins with these, read as whole numbers where they are such; `None` if they end before
/// that is known.
fn record_words(element: &Element, words: &[Option<usize>]) -> Option<usize> {
    element.properties.iter().try_fold(0_usize, |at, property| match property.kind {
        Kind::Scalar(_) => Some(at + 1),
        Kind::List { .. } => words.get(at).copied().flatten().and_then(|count| count.checked_add(at + 1)),
    })
}

/// Passes over an element in text; false if the file ends before.
pub fn skip_text(words: &mut Words<'_>, element: &Element) -> Result<bool, FormatError> {
    if element.properties.is_empty() {
        return Ok(true);
    }
    for _ in 0..element.count {
        for property in &element.properties {
            let there = match property.kind {
                Kind::Scalar(_) => words.skip(1)?,
                Kind::List { .. } => words.skip_list()?,
            };
            if !there {
                return Ok(false);
            }
        }
    }
    Ok(true)
}

//! The words of a row.

/// What stands between the words of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Separator {
    /// Blanks and tabs, any number of them.
    Blank,
    /// One of these; two next to each other have an empty word between them.
    Byte(u8),
}

impl Separator {
    /// The one that `line` uses.
    pub fn of(line: &[u8]) -> Self {
        let line = line.trim_ascii();
        if line.contains(&b';') {
            Self::Byte(b';')
        } else if line.contains(&b',') {
            Self::Byte(b',')
        } else {
            Self::Blank
        }
    }

    /// The words of `line`, without blanks and quotes around them.
    pub fn words(self, line: &[u8]) -> Words<'_> {
        let line = line.trim_ascii();
        Words { rest: (!line.is_empty()).then_some(line), separator: self }
    }
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
                let length = rest.iter().position(|&b| b == byte);
                self.rest = length.map(|n| &rest[n + 1..]);
                Some(unquoted(rest[..length.unwrap_or(rest.len())].trim_ascii()))
            }
        }
    }
}

fn unquoted(word: &[u8]) -> &[u8] {
    match word {
        [b'"', inside @ .., b'"'] | [b'\'', inside @ .., b'\''] => inside.trim_ascii(),
        _ => word,
    }
}

/// Is the line a remark?
pub fn is_comment(line: &[u8]) -> bool {
    let line = line.trim_ascii_start();
    line.starts_with(b"#") || line.starts_with(b"//")
}

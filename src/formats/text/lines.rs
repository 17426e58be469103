//! The lines of a part of a file.

use crate::formats::FormatError;
use crate::formats::file::SourceFile;
use crate::formats::las::quoted;

/// Bytes read at a time.
const BUFFER_BYTES: usize = 1 << 18;
/// No row of a point file is longer.
pub const LONGEST_LINE: usize = 1 << 16;

/// The lines that begin in a range of bytes. The last of them is given whole, also where it ends behind the range.
pub struct Lines<'a> {
    file: &'a SourceFile,
    buffer: Vec<u8>,
    filled: usize,
    at: usize,
    /// Byte of the file at the start of the buffer.
    base: u64,
    end: u64,
}

/// A line without its end.
#[derive(Clone, Copy, Debug)]
pub struct Line<'b> {
    pub bytes: &'b [u8],
    /// Where it begins in the file.
    pub offset: u64,
    /// Does the file end without a line end after it?
    pub unfinished: bool,
}

impl<'a> Lines<'a> {
    /// The lines that begin at `start` or later and before `end`; a line begins at `start`.
    pub fn new(file: &'a SourceFile, start: u64, end: u64) -> Self {
        let room = usize::try_from(end.saturating_sub(start)).unwrap_or(usize::MAX).min(BUFFER_BYTES);
        Self { file, buffer: vec![0; room + LONGEST_LINE + 2], filled: 0, at: 0, base: start, end }
    }

    /// The first byte at or after `place`, and at `first` or later, where a line begins.
    pub fn start_from(file: &SourceFile, first: u64, place: u64) -> Result<u64, FormatError> {
        if place <= first {
            return Ok(first);
        }
        let mut raw = [0; 4096];
        let mut at = place - 1;
        loop {
            let read = file.read_up_to(&mut raw, at)?;
            if read == 0 {
                return Ok(file.bytes());
            }
            if let Some(i) = raw[..read].iter().position(|&b| b == b'\n') {
                return Ok(at + i as u64 + 1);
            }
            at += read as u64;
        }
    }

    /// Where the next line begins.
    pub fn offset(&self) -> u64 {
        self.base + self.at as u64
    }

    /// The next line; `None` when the next one begins behind the range, or there is none.
    pub fn next(&mut self) -> Result<Option<Line<'_>>, FormatError> {
        if self.offset() >= self.end {
            return Ok(None);
        }
        loop {
            let rest = &self.buffer[self.at..self.filled];
            let offset = self.offset();
            let (length, unfinished) = match rest.iter().position(|&b| b == b'\n') {
                Some(length) => (length, false),
                None if rest.len() > LONGEST_LINE => {
                    let shown = quoted(&rest[..20]);
                    return Err(self.file.malformed_line(
                        offset,
                        "a line of text",
                        format!("{shown} and no end of it"),
                    ));
                }
                None if self.refill()? => continue,
                None if self.at == self.filled => return Ok(None),
                None => (self.filled - self.at, true),
            };
            let start = self.at;
            self.at = (start + length + usize::from(!unfinished)).min(self.filled);
            let bytes = &self.buffer[start..start + length];
            let bytes = bytes.strip_suffix(b"\r").unwrap_or(bytes);
            return Ok(Some(Line { bytes, offset, unfinished }));
        }
    }

    /// Moves what is left to the front and reads on; false if there is no more.
    fn refill(&mut self) -> Result<bool, FormatError> {
        self.buffer.copy_within(self.at..self.filled, 0);
        self.base += self.at as u64;
        self.filled -= self.at;
        self.at = 0;
        let read = self.file.read_up_to(&mut self.buffer[self.filled..], self.base + self.filled as u64)?;
        self.filled += read;
        Ok(read > 0)
    }
}

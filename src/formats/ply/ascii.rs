//! Text records of a PLY file: words separated by white space, and the lines that they are on.

use crate::formats::FormatError;
use crate::formats::file::SourceFile;
use crate::formats::las::quoted;
use crate::formats::text::odd_float;
use crate::points::ScalarType;

/// Bytes read at a time.
const BUFFER_BYTES: usize = 1 << 20;
/// No number is longer.
const LONGEST_WORD: usize = 1024;

/// The words of a file from some byte on.
pub struct Words<'a> {
    file: &'a SourceFile,
    buffer: Vec<u8>,
    /// Bytes of the buffer that are filled, and the next of them.
    filled: usize,
    at: usize,
    /// Byte of the file at the start of the buffer.
    base: u64,
    /// Is there a line's end, or the beginning, between the last word and what comes next?
    begins_line: bool,
    /// Words so far that begin a line.
    lines: u64,
}

impl<'a> Words<'a> {
    /// From byte `offset` of `file` on, where a line begins.
    pub fn new(file: &'a SourceFile, offset: u64) -> Self {
        let room = usize::try_from(file.bytes()).unwrap_or(usize::MAX).min(BUFFER_BYTES);
        Self {
            file,
            buffer: vec![0; room.max(LONGEST_WORD + 1)],
            filled: 0,
            at: 0,
            base: offset,
            begins_line: true,
            lines: 0,
        }
    }

    /// How many of the words so far begin a line.
    pub fn lines(&self) -> u64 {
        self.lines
    }

    /// Where the next word begins, and if it begins a line; `None` at the end of the file.
    pub fn peek(&mut self) -> Result<Option<(u64, bool)>, FormatError> {
        Ok(self.reach()?.then(|| (self.base + self.at as u64, self.begins_line)))
    }

    /// Passes over white space; false at the end of the file.
    fn reach(&mut self) -> Result<bool, FormatError> {
        loop {
            let rest = &self.buffer[self.at..self.filled];
            let skip = rest.iter().position(|b| !b.is_ascii_whitespace());
            let space = &rest[..skip.unwrap_or(rest.len())];
            self.begins_line |= space.iter().any(|b| matches!(b, b'\n' | b'\r'));
            self.at += space.len();
            if skip.is_some() {
                return Ok(true);
            }
            if !self.refill()? {
                return Ok(false);
            }
        }
    }

    /// The next word and the byte where it begins; `None` at the end of the file.
    pub fn next(&mut self) -> Result<Option<(&[u8], u64)>, FormatError> {
        if !self.reach()? {
            return Ok(None);
        }
        let length = loop {
            let word = &self.buffer[self.at..self.filled];
            match word.iter().position(u8::is_ascii_whitespace) {
                Some(length) => break length,
                None if word.len() > LONGEST_WORD => {
                    let offset = self.base + self.at as u64;
                    return Err(self.file.malformed_line(offset, "a number", quoted(&word[..20])));
                }
                // The word may go on beyond the buffer.
                None if self.refill()? => {}
                None => break self.filled - self.at,
            }
        };
        let (start, offset) = (self.at, self.base + self.at as u64);
        self.at += length;
        self.lines += u64::from(std::mem::take(&mut self.begins_line));
        Ok(Some((&self.buffer[start..self.at], offset)))
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

    /// The next word as a value of type `ty`, little-endian; `None` at the end of the file.
    pub fn scalar(&mut self, ty: ScalarType) -> Result<Option<[u8; 8]>, FormatError> {
        let file = self.file;
        let Some((word, offset)) = self.next()? else { return Ok(None) };
        let value = parse(word, ty).ok_or_else(|| {
            file.malformed_line(offset, format!("a value of type {}", ty.word()), quoted(&word[..word.len().min(40)]))
        })?;
        Ok(Some(value))
    }

    /// The next word as a coordinate: the number as it is written, also where the property is said to be an `f32`.
    pub fn coordinate(&mut self, ty: ScalarType) -> Result<Option<f64>, FormatError> {
        let ty = if ty.is_float() { ScalarType::F64 } else { ty };
        Ok(self.scalar(ty)?.map(|raw| super::binary::to_f64(ty, raw)))
    }

    /// Passes over `words`; false if the file ends before.
    pub fn skip(&mut self, words: u64) -> Result<bool, FormatError> {
        for _ in 0..words {
            if self.next()?.is_none() {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Passes over a list; false if the file ends before.
    pub fn skip_list(&mut self) -> Result<bool, FormatError> {
        match self.scalar(ScalarType::U64)? {
            Some(count) => self.skip(u64::from_le_bytes(count)),
            None => Ok(false),
        }
    }
}

fn parse(word: &[u8], ty: ScalarType) -> Option<[u8; 8]> {
    let text = std::str::from_utf8(word).ok()?;
    let mut raw = [0; 8];
    macro_rules! integer {
        ($t:ty) => {{
            // Some writers put `255.0` where they promised an integer.
            let value: $t = text.parse().ok().or_else(|| {
                let float: f64 = text.parse().ok()?;
                let value = float as $t;
                (value as f64 == float && float.abs() < 9e15).then_some(value)
            })?;
            raw[..size_of::<$t>()].copy_from_slice(&value.to_le_bytes());
        }};
    }
    match ty {
        ScalarType::U8 => integer!(u8),
        ScalarType::I8 => integer!(i8),
        ScalarType::U16 => integer!(u16),
        ScalarType::I16 => integer!(i16),
        ScalarType::U32 => integer!(u32),
        ScalarType::I32 => integer!(i32),
        ScalarType::U64 => integer!(u64),
        ScalarType::I64 => integer!(i64),
        ScalarType::F32 => {
            let value = text.parse().ok().or_else(|| odd_float(text).map(|v| v as f32))?;
            raw[..4].copy_from_slice(&f32::to_le_bytes(value));
        }
        ScalarType::F64 => {
            let value = text.parse().ok().or_else(|| odd_float(text))?;
            raw = f64::to_le_bytes(value);
        }
    }
    Some(raw)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_fit_their_type_or_are_refused() {
        let small = |text: &str| parse(text.as_bytes(), ScalarType::U8).map(|v| v[0]);
        assert_eq!(small("255"), Some(255));
        assert_eq!(small("255.0"), Some(255));
        for bad in ["256", "-1", "1.5", "x", "", "nan", "1e9"] {
            assert_eq!(small(bad), None, "{bad}");
        }
        let int = |text: &str| parse(text.as_bytes(), ScalarType::I32).map(i64::from_le_bytes);
        assert_eq!(int("2147483648"), None);
        assert_eq!(parse(b"18446744073709551615", ScalarType::U64), Some([255; 8]));
        assert_eq!(parse(b"18446744073709551616", ScalarType::U64), None);
        let float = |text: &str| parse(text.as_bytes(), ScalarType::F64).map(f64::from_le_bytes);
        assert!(float("-nan(ind)").unwrap().is_nan() && float("NaN").unwrap().is_nan());
        assert_eq!(float("-1.#INF"), Some(f64::NEG_INFINITY));
        assert_eq!(float("0x10"), None);
    }

    #[test]
    fn words_may_lie_across_buffers() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("f");
        let text: String = (0..300_000).map(|i| format!("{i}{}", [" ", "\r\n", "\t"][i % 3])).collect();
        std::fs::write(&path, &text).unwrap();
        let file = SourceFile::open(&path).unwrap();
        let mut words = Words::new(&file, 0);
        for i in 0..300_000_u64 {
            let (word, offset) = words.next().unwrap().unwrap();
            assert_eq!(word, i.to_string().as_bytes());
            assert_eq!(&text.as_bytes()[offset as usize..][..word.len()], i.to_string().as_bytes());
        }
        assert!(words.next().unwrap().is_none());
        std::fs::write(&path, "7".repeat(5000)).unwrap();
        let file = SourceFile::open(&path).unwrap();
        assert!(Words::new(&file, 0).next().is_err());
    }
}

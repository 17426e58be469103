//! What the rows of a file hold: how many there are, and what is known of each column.

use super::lines::{Line, Lines};
use super::number::{MOST_EXACT, Number, comes_back, parse};
use super::words::{Separator, is_comment};
use crate::formats::FormatError;
use crate::formats::file::SourceFile;
use crate::formats::las::quoted;
use rayon::prelude::*;

/// Bytes looked through as one job. Pieces for reading begin where these do.
const CHUNK_BYTES: u64 = 1 << 20;
/// Columns of a row at most.
pub const MOST_COLUMNS: usize = 1024;

/// Rows that begin in one stretch of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chunk {
    /// Byte where a line begins.
    pub offset: u64,
    /// Rows that begin there or later, and before the next chunk.
    pub rows: u64,
}

/// What the values of a column have in common.
#[derive(Clone, Debug)]
pub struct Column {
    /// Numbers, NaN left out.
    pub numbers: u64,
    /// Rows in which the word is missing, empty or NaN.
    pub absent: u64,
    /// The first word that is no number.
    pub text: Option<(u64, String)>,
    /// Are all numbers whole, however they are written?
    pub whole: bool,
    /// Are all numbers written without a point and an exponent?
    pub plain: bool,
    /// The least and the greatest of those that have too many digits for [`Number::decimal`].
    pub wide: Option<(i128, i128)>,
    /// Are all numbers written without an exponent, and finite?
    pub decimal: bool,
    /// The most digits behind the point that are not trailing zeros, of the decimal ones.
    pub decimals: u8,
    /// The largest mantissa, trailing zeros left out, of the decimal ones.
    pub largest_mantissa: u64,
    /// Has a number more digits than an `f64` gives back?
    pub rounded: bool,
    pub min: f64,
    pub max: f64,
}

impl Default for Column {
    fn default() -> Self {
        Self {
            numbers: 0,
            absent: 0,
            text: None,
            whole: true,
            plain: true,
            wide: None,
            decimal: true,
            decimals: 0,
            largest_mantissa: 0,
            rounded: false,
            min: f64::INFINITY,
            max: f64::NEG_INFINITY,
        }
    }
}

impl Column {
    #[inline]
    fn add(&mut self, number: Number, word: &[u8]) {
        if number.value.is_nan() {
            self.absent += 1;
            return;
        }
        self.numbers += 1;
        self.min = self.min.min(number.value);
        self.max = self.max.max(number.value);
        match number.decimal {
            Some(digits) => {
                let (mut mantissa, mut decimals) = (digits.mantissa.unsigned_abs(), digits.decimals);
                while decimals > 0 && mantissa % 10 == 0 {
                    mantissa /= 10;
                    decimals -= 1;
                }
                self.decimals = self.decimals.max(decimals);
                self.largest_mantissa = self.largest_mantissa.max(mantissa);
                self.rounded |= mantissa > MOST_EXACT && !self.rounded && !comes_back(word, number.value);
                self.whole &= decimals == 0;
                self.plain &= !digits.pointed;
            }
            None => {
                self.decimal = false;
                self.rounded |= !self.rounded && !comes_back(word, number.value);
                match std::str::from_utf8(word).ok().and_then(|w| w.parse::<i128>().ok()) {
                    Some(whole) => self.widen((whole, whole)),
                    None => self.plain = false,
                }
                self.whole &= number.value.fract() == 0.0;
            }
        }
    }

    fn widen(&mut self, (min, max): (i128, i128)) {
        let (least, greatest) = self.wide.unwrap_or((min, max));
        self.wide = Some((least.min(min), greatest.max(max)));
    }

    /// Adds what another part of the rows holds in this column.
    pub fn merge(&mut self, other: Self) {
        self.numbers += other.numbers;
        self.absent += other.absent;
        self.text = self.text.take().or(other.text);
        self.whole &= other.whole;
        self.plain &= other.plain;
        if let Some(wide) = other.wide {
            self.widen(wide);
        }
        self.decimal &= other.decimal;
        self.decimals = self.decimals.max(other.decimals);
        self.largest_mantissa = self.largest_mantissa.max(other.largest_mantissa);
        self.rounded |= other.rounded;
        self.min = self.min.min(other.min);
        self.max = self.max.max(other.max);
    }

    /// Are all values whole and within these limits?
    pub fn within(&self, min: f64, max: f64) -> bool {
        self.numbers > 0 && self.whole && min <= self.min && self.max <= max
    }
}

/// Where rows are, and how they are to be looked at.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Where the first line of the rows begins.
    pub start: u64,
    /// Where the rows end.
    pub end: u64,
    pub separator: Separator,
    /// Is a comma a decimal point?
    pub comma: bool,
    /// Which columns are x, y and z.
    pub axes: [usize; 3],
    /// Does a row whose coordinates are all zero say that nothing came back?
    pub zero_is_nothing: bool,
}

/// What looking through the rows found.
#[derive(Clone, Debug, Default)]
pub struct Survey {
    pub chunks: Vec<Chunk>,
    pub rows: u64,
    pub columns: Vec<Column>,
    /// Rows of zeros that say that nothing came back.
    pub nothing: u64,
    /// Did the file end in the middle of a row? It is not among the rows.
    pub cut: bool,
    /// Words of the longest and of the shortest row.
    pub words: (usize, usize),
}

impl Survey {
    /// What the next stretch of rows holds.
    fn append(&mut self, part: Self) {
        if part.rows > 0 {
            self.words = (self.words.0.max(part.words.0), self.words.1.min(part.words.1));
        }
        // Columns that a row lacks are absent there.
        if part.columns.len() > self.columns.len() {
            let column = Column { absent: self.rows, ..Column::default() };
            self.columns.resize(part.columns.len(), column);
        }
        for i in part.columns.len()..self.columns.len() {
            self.columns[i].absent += part.rows;
        }
        for (column, other) in self.columns.iter_mut().zip(part.columns) {
            column.merge(other);
        }
        self.rows += part.rows;
        self.nothing += part.nothing;
        self.cut |= part.cut;
        self.chunks.extend(part.chunks);
    }
}

/// Looks through the rows at `place`, on all threads.
///
/// # Errors
///
/// [`FormatError::Malformed`] for a row whose coordinates are no numbers.
pub fn survey(file: &SourceFile, place: &Place) -> Result<Survey, FormatError> {
    let starts: Vec<u64> = (place.start..place.end).step_by(CHUNK_BYTES as usize).collect();
    let mut whole = Survey { words: (0, usize::MAX), ..Survey::default() };
    // So many at a time: what is known of each must not add up in memory.
    for starts in starts.chunks(1024) {
        let parts: Vec<Survey> = starts
            .par_iter()
            .map(|&start| {
                let begin = Lines::start_from(file, place.start, start)?;
                chunk(file, place, begin, start.saturating_add(CHUNK_BYTES).min(place.end))
            })
            .collect::<Result<_, _>>()?;
        parts.into_iter().for_each(|part| whole.append(part));
    }
    Ok(whole)
}

/// How many rows there are and where, without a look at their words. A last row of fewer than `words` words that just
/// ends with the file is not among them.
///
/// # Errors
///
/// [`FormatError`] if the file can't be read, or is no text.
pub fn count_rows(file: &SourceFile, place: &Place, words: usize) -> Result<Vec<Chunk>, FormatError> {
    let starts: Vec<u64> = (place.start..place.end).step_by(CHUNK_BYTES as usize).collect();
    let count = |start: u64| {
        let begin = Lines::start_from(file, place.start, start)?;
        let mut lines = Lines::new(file, begin, start.saturating_add(CHUNK_BYTES).min(place.end));
        let mut rows = 0;
        while let Some(line) = lines.next()? {
            let row = !line.bytes.trim_ascii_start().is_empty() && !place.separator.is_comment(line.bytes);
            let cut = line.unfinished && place.separator.words(line.bytes).count() < words;
            rows += u64::from(row && !cut);
        }
        Ok(Chunk { offset: begin, rows })
    };
    starts.into_par_iter().map(count).collect()
}

/// How the words of the first row between `start` and `end` are separated.
///
/// # Errors
///
/// As [`count_rows`].
pub fn first_row(file: &SourceFile, start: u64, end: u64) -> Result<Option<Separator>, FormatError> {
    let mut lines = Lines::new(file, start, end);
    while let Some(line) = lines.next()? {
        if !line.bytes.trim_ascii().is_empty() && !is_comment(line.bytes) {
            return Ok(Some(Separator::of(line.bytes)));
        }
    }
    Ok(None)
}

fn chunk(file: &SourceFile, place: &Place, start: u64, end: u64) -> Result<Survey, FormatError> {
    let mut found = Survey { words: (0, usize::MAX), ..Survey::default() };
    let mut lines = Lines::new(file, start, end);
    let mut coordinates = [0.0; 3];
    while let Some(line) = lines.next()? {
        if line.bytes.trim_ascii_start().is_empty() || place.separator.is_comment(line.bytes) {
            continue;
        }
        // Of a row that may be cut nothing must stay behind.
        let before = line.unfinished.then(|| found.columns.clone());
        let mut words = 0;
        let mut bad = None;
        let mut last_is_start = false;
        for word in place.separator.words(line.bytes) {
            if words == MOST_COLUMNS {
                return Err(file.malformed_line(line.offset, format!("a row of at most {MOST_COLUMNS} words"), "more"));
            }
            if words == found.columns.len() {
                found.columns.push(Column { absent: found.rows, ..Column::default() });
            }
            let number = parse(word, place.comma);
            last_is_start = number.is_none() && word.iter().all(|b| b.is_ascii_digit() || b"+-.,eE".contains(b));
            let axis = place.axes.iter().position(|&a| a == words);
            let column = &mut found.columns[words];
            match number {
                Some(number) => {
                    column.add(number, word);
                    if let Some(axis) = axis {
                        coordinates[axis] = number.value;
                    }
                }
                None if axis.is_some() => bad = bad.or(Some(word)),
                None => {
                    column.absent += 1;
                    if column.text.is_none() {
                        column.text =
                            Some((line.offset, String::from_utf8_lossy(&word[..word.len().min(20)]).into_owned()));
                    }
                }
            }
            words += 1;
        }
        let short = place.axes.iter().any(|&a| a >= words);
        let shorter = found.rows > 0 && words < found.words.1;
        if let Some(before) = before {
            // `-` may be what is left of `-20`, where all rows before have numbers.
            let of_numbers = |column: &Column| column.text.is_none() && column.numbers > 0;
            let cut_word = last_is_start && words > 0 && before.get(words - 1).is_some_and(of_numbers);
            if short || bad.is_some() || shorter || cut_word {
                found.cut = true;
                found.columns = before;
                break;
            }
        }
        if short || bad.is_some() {
            return Err(no_row(file, &line, bad));
        }
        for column in &mut found.columns[words..] {
            column.absent += 1;
        }
        found.nothing += u64::from(place.zero_is_nothing && coordinates == [0.0; 3]);
        found.rows += 1;
        found.words = (found.words.0.max(words), found.words.1.min(words));
    }
    found.chunks.push(Chunk { offset: start, rows: found.rows });
    Ok(found)
}

fn no_row(file: &SourceFile, line: &Line<'_>, bad: Option<&[u8]>) -> FormatError {
    let shown = line.bytes.trim_ascii();
    let found = bad.unwrap_or(shown);
    file.malformed_line(line.offset, "a row of numbers with x, y and z", quoted(&found[..found.len().min(40)]))
}

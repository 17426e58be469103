//! Blocks of PTS and PTX: each begins with a line that holds one number.

use super::lines::Lines;
use super::number::parse;
use super::shape::is_count;
use super::words::{Separator, is_comment};
use crate::formats::FormatError;
use crate::formats::file::SourceFile;
use crate::formats::las::quoted;
use crate::geometry::Pose;
use rayon::prelude::*;

/// Bytes looked through as one job.
const CHUNK_BYTES: u64 = 4 << 20;
/// More lines of one word than this make no point file.
const MOST_MARKS: usize = 1 << 20;

/// A block: where its rows are, how many it announces, where it stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Section {
    pub start: u64,
    pub end: u64,
    pub announced: Option<u64>,
    pub pose: Pose,
}

/// A line that holds one number.
#[derive(Clone, Copy, Debug)]
struct Mark {
    start: u64,
    end: u64,
    count: u64,
}

/// The blocks of a PTS file: a count, then rows. A file without counts is one block.
///
/// # Errors
///
/// [`FormatError`] if it can't be read, or there is no end of counts.
pub fn pts(file: &SourceFile, start: u64) -> Result<Vec<Section>, FormatError> {
    let marks = marks(file, start)?;
    let first = marks.first().map_or(file.bytes(), |m| m.start);
    let mut sections = Vec::new();
    if has_rows(file, start, first)? {
        sections.push(Section { start, end: first, announced: None, pose: Pose::IDENTITY });
    }
    for (i, mark) in marks.iter().enumerate() {
        let end = marks.get(i + 1).map_or(file.bytes(), |m| m.start);
        sections.push(Section { start: mark.end, end, announced: Some(mark.count), pose: Pose::IDENTITY });
    }
    Ok(sections)
}

/// The blocks of a PTX file: columns, rows, the scanner's place and axes, its transform, then the rows of points.
///
/// # Errors
///
/// [`FormatError::Malformed`] for a header that is cut or has no transform.
pub fn ptx(file: &SourceFile, start: u64) -> Result<Vec<Section>, FormatError> {
    let marks = marks(file, start)?;
    let mut sections: Vec<Section> = Vec::new();
    let mut pairs = marks.chunks_exact(2);
    for pair in pairs.by_ref() {
        if let Some(before) = sections.last_mut() {
            before.end = pair[0].start;
        }
        sections.push(header(file, &pair[0], &pair[1])?);
    }
    if let [mark] = pairs.remainder() {
        return Err(file.malformed_line(mark.start, "the columns and the rows of a block, a line each", "one number"));
    }
    Ok(sections)
}

/// The block whose header begins with these two lines.
fn header(file: &SourceFile, columns: &Mark, rows: &Mark) -> Result<Section, FormatError> {
    let mut lines = Lines::new(file, rows.end, file.bytes());
    let (mut matrix, mut transform) = ([[0.0; 4]; 4], columns.start);
    // The scanner's place and axes say what the transform says again.
    for number in 0..8_usize {
        let width = if number < 4 { 3 } else { 4 };
        let (numbers, offset, shown) = loop {
            let Some(line) = lines.next()? else {
                return Err(file.malformed_line(file.bytes(), "the transform of a block", "the end of the file"));
            };
            if !line.bytes.trim_ascii().is_empty() {
                let numbers: Option<Vec<f64>> =
                    Separator::Blank.words(line.bytes).map(|w| parse(w, false).map(|n| n.value)).collect();
                let shown = line.bytes.trim_ascii();
                break (numbers, line.offset, quoted(&shown[..shown.len().min(40)]));
            }
        };
        if number == 4 {
            transform = offset;
        }
        match numbers.as_deref() {
            Some(numbers) if numbers.len() == width => {
                if let (Some(row), 4..) = (number.checked_sub(4), number) {
                    matrix[row].copy_from_slice(numbers);
                }
            }
            _ => return Err(file.malformed_line(offset, format!("{width} numbers of a block's header"), shown)),
        }
    }
    if matrix.iter().map(|row| row[3]).ne([0.0, 0.0, 0.0, 1.0]) {
        let expected =
            "a transform whose last column is 0, 0, 0, 1 (PTX has row vectors: the translation is its last row)";
        return Err(file.malformed_line(transform, expected, format!("{:?}", matrix.map(|row| row[3]))));
    }
    // The file has row vectors: the translation is its last row.
    let m: [f64; 16] = std::array::from_fn(|i| matrix[i % 4][i / 4]);
    let pose = Pose::from_matrix(&m)
        .map_err(|e| file.malformed_line(columns.start, "a block with a transform", e.to_string()))?;
    let start = lines.offset();
    Ok(Section { start, end: file.bytes(), announced: Some(columns.count.saturating_mul(rows.count)), pose })
}

fn has_rows(file: &SourceFile, start: u64, end: u64) -> Result<bool, FormatError> {
    let mut lines = Lines::new(file, start, end);
    while let Some(line) = lines.next()? {
        if !line.bytes.trim_ascii().is_empty() && !is_comment(line.bytes) {
            return Ok(true);
        }
    }
    Ok(false)
}

/// All lines from `start` on that hold one whole number and nothing else.
fn marks(file: &SourceFile, start: u64) -> Result<Vec<Mark>, FormatError> {
    let starts: Vec<u64> = (start..file.bytes()).step_by(CHUNK_BYTES as usize).collect();
    let parts: Vec<Vec<Mark>> = starts
        .into_par_iter()
        .map(|at| {
            let mut found = Vec::new();
            let begin = Lines::start_from(file, start, at)?;
            let mut lines = Lines::new(file, begin, at.saturating_add(CHUNK_BYTES).min(file.bytes()));
            while let Some(line) = lines.next()? {
                if line.bytes.len() < 24 && is_count(line.bytes) {
                    let count = parse(line.bytes.trim_ascii(), false).map_or(f64::INFINITY, |n| n.value);
                    let (start, count) = (line.offset, count as u64);
                    if found.len() == MOST_MARKS {
                        return Err(file.malformed_line(start, "rows of points", "one number a line"));
                    }
                    found.push(Mark { start, end: lines.offset(), count });
                }
            }
            Ok(found)
        })
        .collect::<Result<_, FormatError>>()?;
    let all: Vec<Mark> = parts.into_iter().flatten().collect();
    match all.get(MOST_MARKS) {
        Some(mark) => Err(file.malformed_line(mark.start, "rows of points", "one number a line")),
        None => Ok(all),
    }
}

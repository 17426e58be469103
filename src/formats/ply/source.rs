//! A PLY file as a [`PointSource`].

use super::ascii::Words;
use super::binary::{Conversion, Stop, Values, to_f64};
use super::header::{Element, Encoding, Header, Kind, Property};
use super::layout::{Target, record_layout};
use super::lines::{TextLines, skip_text};
use crate::formats::file::SourceFile;
use crate::formats::las::even_pieces;
use crate::formats::{FormatError, Piece, PointSource, SourceInfo, Tally};
use crate::points::ScalarType;
use std::sync::OnceLock;

/// Bytes given to a sink at a time.
const RUN_BYTES: usize = 1 << 20;

/// An open PLY file.
pub struct PlySource {
    file: SourceFile,
    info: SourceInfo,
    header: Header,
    /// Which element is the vertices.
    vertex: usize,
    targets: Vec<Target>,
    records: Records,
    /// Where there is more, in a text, than the header announces: found when it is read.
    beyond: OnceLock<u64>,
}

/// How the vertices are read.
enum Records {
    /// Binary, all of one size, from this byte on.
    Fixed(u64, Conversion),
    /// Binary with lists, from this byte on: one after the other.
    Varying(u64),
    /// Text, from the start of the data on.
    Text(TextLines),
}

impl PlySource {
    /// Reads the header, and passes over elements before the vertices.
    ///
    /// # Errors
    ///
    /// [`FormatError::Malformed`] for a bad header, or one without vertices that have x, y and z.
    pub(in crate::formats) fn open(file: SourceFile) -> Result<Self, FormatError> {
        let header = Header::read(&file)?;
        let names = |names: Vec<&str>| if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        let vertex = header.elements.iter().position(|e| e.name == "vertex").ok_or_else(|| {
            let found = names(header.elements.iter().map(|e| &*e.name).collect());
            file.malformed(header.data_offset, "an element `vertex` in the header", found)
        })?;
        let element = &header.elements[vertex];
        let (layout, targets) = record_layout(element).ok_or_else(|| {
            let found = names(element.properties.iter().map(|p| &*p.name).collect());
            file.malformed(header.data_offset, "scalar properties x, y and z of the vertices", found)
        })?;
        let mut warnings = not_kept(&header, vertex);
        let (records, found) = if header.encoding == Encoding::Ascii {
            // The least text that a vertex takes: a digit and a separator per value, the last one without.
            let text = file.bytes().saturating_sub(header.data_offset) + 1;
            let lines = TextLines::of(&file, &header, vertex)?;
            if lines == TextLines::Any {
                warnings.push("the vertices are not one a line: they are read word by word, whatever the lines".into());
            }
            (Records::Text(lines), element.count.min(text / (2 * element.properties.len() as u64)))
        } else {
            let start = vertices_start(&file, &header, vertex)?;
            let room = file.bytes().saturating_sub(start);
            match Conversion::new(element, &targets, layout.stride(), header.encoding) {
                Some(c) => {
                    let found = element.count.min(room / c.source_bytes() as u64);
                    (Records::Fixed(start, c), found)
                }
                None => {
                    // A list takes at least its count.
                    let least = element.properties.iter().map(|p| match p.kind {
                        Kind::Scalar(ty) | Kind::List { count: ty, .. } => ty.size() as u64,
                    });
                    (Records::Varying(start), element.count.min(room / least.sum::<u64>()))
                }
            }
        };
        if found < element.count {
            warnings.push(format!("the header announces {} vertices, the file holds at most {found}", element.count));
        }
        let is_single = |(property, target): (&Property, &Target)| {
            matches!((property.kind, target), (Kind::Scalar(ScalarType::F32), Target::Axis(_)))
        };
        // Text has as many digits as it has.
        let is_single = header.encoding != Encoding::Ascii && element.properties.iter().zip(&targets).any(is_single);
        let missing = element.count - found;
        let info = SourceInfo { warnings, is_single, ..SourceInfo::new(file.path(), "ply", found, missing, layout) };
        Ok(Self { file, info, header, vertex, targets, records, beyond: OnceLock::new() })
    }

    fn element(&self) -> &Element {
        &self.header.elements[self.vertex]
    }

    fn read_fixed(
        &self,
        start: u64,
        conversion: &Conversion,
        piece: Piece,
        sink: &mut dyn FnMut(&[u8]) -> bool,
    ) -> Result<Tally, FormatError> {
        let (from_bytes, stride) = (conversion.source_bytes(), self.info.layout.stride());
        let run = (RUN_BYTES / from_bytes.max(stride)).max(1) as u64;
        let room = run.min(piece.records) as usize;
        let (mut from, mut to) = (vec![0; room * from_bytes], vec![0; room * stride]);
        let mut tally = Tally::default();
        while tally.read < piece.records {
            let wanted = run.min(piece.records - tally.read) as usize;
            let offset = start + (piece.first + tally.read) * from_bytes as u64;
            let got = self.file.read_up_to(&mut from[..wanted * from_bytes], offset)? / from_bytes;
            conversion.convert(&from[..got * from_bytes], &mut to[..got * stride]);
            tally.read += got as u64;
            if got > 0 && !sink(&to[..got * stride]) {
                break;
            }
            if got < wanted {
                tally.truncated = piece.records - tally.read;
                break;
            }
        }
        Ok(tally)
    }

    fn read_varying(
        &self,
        start: u64,
        piece: Piece,
        sink: &mut dyn FnMut(&[u8]) -> bool,
    ) -> Result<Tally, FormatError> {
        let mut values = Values::new(&self.file, start, self.header.encoding);
        self.one_by_one(piece, sink, |record| {
            let whole = self.read_varying_record(&mut values, record);
            match whole {
                Ok(()) => Ok(true),
                Err(Stop::End) => Ok(false),
                Err(stop) => Err(refused(&self.file, stop)),
            }
        })
    }

    fn read_varying_record(&self, values: &mut Values<'_>, record: &mut [u8]) -> Result<(), Stop> {
        for (property, &target) in self.element().properties.iter().zip(&self.targets) {
            match property.kind {
                Kind::Scalar(ty) => {
                    let raw = values.scalar(ty)?;
                    put(record, target, ty.size(), raw, || to_f64(ty, raw));
                }
                Kind::List { count, item } => values.skip_list(count, item)?,
            }
        }
        Ok(())
    }

    fn read_text(
        &self,
        lines: TextLines,
        piece: Piece,
        sink: &mut dyn FnMut(&[u8]) -> bool,
    ) -> Result<Tally, FormatError> {
        let mut words = Words::new(&self.file, self.header.data_offset);
        for element in &self.header.elements[..self.vertex] {
            if !skip_text(&mut words, element)? {
                return Ok(Tally { read: 0, truncated: piece.records });
            }
        }
        let start = words.peek()?.map_or(self.file.bytes(), |(at, _)| at);
        let tally = self.one_by_one(piece, sink, |record| {
            let Some((at, begins_line)) = words.peek()? else { return Ok(false) };
            let before = words.lines();
            if !self.read_text_record(&mut words, record)? {
                return Ok(false);
            }
            if lines == TextLines::OnePerVertex && !(begins_line && words.lines() == before + 1) {
                return Err(self.not_a_line(at, begins_line));
            }
            Ok(true)
        })?;
        let is_short = tally.truncated > 0 || self.info.missing > 0;
        let is_to_its_end = piece.first + tally.read == self.info.records && tally.truncated == 0;
        match lines {
            TextLines::OnePerVertex if is_to_its_end => self.check_last_line(&mut words)?,
            // A value too many or too few would have shifted all that came after it.
            TextLines::Any if is_short || is_to_its_end && !self.is_read_up(&mut words)? => {
                let expected = "one vertex a line, or just as many values as the header announces";
                return Err(self.file.malformed_line(start, expected, if is_short { "fewer" } else { "others" }));
            }
            _ => {}
        }
        Ok(tally)
    }

    /// Reads one vertex; false if the file ends before.
    fn read_text_record(&self, words: &mut Words<'_>, record: &mut [u8]) -> Result<bool, FormatError> {
        for (property, &target) in self.element().properties.iter().zip(&self.targets) {
            let there = match (property.kind, target) {
                (Kind::List { .. }, _) => words.skip_list()?,
                (Kind::Scalar(ty), Target::Axis(_)) => {
                    let value = words.coordinate(ty)?;
                    value.inspect(|v| put(record, target, 8, [0; 8], || *v)).is_some()
                }
                (Kind::Scalar(ty), _) => {
                    let value = words.scalar(ty)?;
                    value.inspect(|raw| put(record, target, ty.size(), *raw, || 0.0)).is_some()
                }
            };
            if !there {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// The line that holds byte `at` has too many values or too few for a vertex.
    fn not_a_line(&self, at: u64, begins_line: bool) -> FormatError {
        let expected = "one vertex a line, with the values that the header names";
        self.file.malformed_line(at, expected, if begins_line { "fewer values" } else { "more values" })
    }

    /// After the last vertex: its line has ended, and so has the file unless other elements follow.
    fn check_last_line(&self, words: &mut Words<'_>) -> Result<(), FormatError> {
        match words.peek()? {
            Some((at, false)) => Err(self.not_a_line(at, false)),
            Some((at, true)) if self.info.missing == 0 && self.elements_after().next().is_none() => {
                let _ = self.beyond.set(at);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// After the last vertex: does the file hold what it announces, and nothing more?
    fn is_read_up(&self, words: &mut Words<'_>) -> Result<bool, FormatError> {
        for element in self.elements_after() {
            if !skip_text(words, element)? {
                return Ok(false);
            }
        }
        Ok(words.peek()?.is_none())
    }

    fn elements_after(&self) -> impl Iterator<Item = &Element> {
        self.header.elements[self.vertex + 1..].iter().filter(|e| e.count > 0 && !e.properties.is_empty())
    }

    /// Reads records from the first on and gives those of the piece to `sink`; `next` fills one, or says that there are no
    /// more.
    fn one_by_one(
        &self,
        piece: Piece,
        sink: &mut dyn FnMut(&[u8]) -> bool,
        mut next: impl FnMut(&mut [u8]) -> Result<bool, FormatError>,
    ) -> Result<Tally, FormatError> {
        let stride = self.info.layout.stride();
        let run = ((RUN_BYTES / stride).max(1) as u64).min(piece.records) as usize;
        let mut buffer = vec![0; run * stride];
        let mut filled = 0;
        let mut tally = Tally::default();
        for number in 0..piece.first + piece.records {
            let outcome = next(&mut buffer[filled..filled + stride]);
            let there = *outcome.as_ref().unwrap_or(&false);
            if there && number >= piece.first {
                filled += stride;
            }
            let last = number + 1 == piece.first + piece.records;
            if filled > 0 && (filled == buffer.len() || last || !there) {
                tally.read += (filled / stride) as u64;
                if !sink(&buffer[..filled]) {
                    return Ok(tally);
                }
                filled = 0;
            }
            if !outcome? {
                tally.truncated = piece.records - tally.read;
                break;
            }
        }
        Ok(tally)
    }
}

impl PointSource for PlySource {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn warn(&mut self, warning: String) {
        self.info.warnings.push(warning);
    }

    fn found_while_reading(&self) -> Option<String> {
        let line = self.file.line_at(*self.beyond.get()?).ok()?;
        Some(format!("line {line} and what follows are more than the header announces, and are not kept"))
    }

    fn pieces(&self, target_records: u64) -> Vec<Piece> {
        let target = match self.records {
            Records::Fixed(..) => target_records,
            Records::Varying(_) | Records::Text(_) => u64::MAX,
        };
        even_pieces(self.info.records, target)
    }

    fn read(&self, piece: Piece, sink: &mut dyn FnMut(&[u8]) -> bool) -> Result<Tally, FormatError> {
        let first = piece.first.min(self.info.records);
        let piece = Piece { first, records: piece.records.min(self.info.records - first) };
        if piece.records == 0 {
            return Ok(Tally::default());
        }
        match &self.records {
            Records::Fixed(start, conversion) => self.read_fixed(*start, conversion, piece, sink),
            Records::Varying(start) => self.read_varying(*start, piece, sink),
            Records::Text(lines) => self.read_text(*lines, piece, sink),
        }
    }
}

/// Puts a value where it belongs.
#[inline]
fn put(record: &mut [u8], target: Target, size: usize, raw: [u8; 8], coordinate: impl FnOnce() -> f64) {
    match target {
        Target::Axis(axis) => record[8 * axis..8 * axis + 8].copy_from_slice(&coordinate().to_le_bytes()),
        Target::Record(at) => record[at..at + size].copy_from_slice(&raw[..size]),
        Target::Skip => {}
    }
}

/// Where binary vertices begin: after the elements before them, or at the end of the file if those are cut off.
fn vertices_start(file: &SourceFile, header: &Header, vertex: usize) -> Result<u64, FormatError> {
    let mut offset = header.data_offset;
    for element in &header.elements[..vertex] {
        let fixed = element.fixed_bytes().map(|bytes| bytes.checked_mul(element.count));
        offset = match fixed {
            Some(bytes) => bytes.and_then(|b| offset.checked_add(b)).unwrap_or(u64::MAX).min(file.bytes()),
            None => {
                let mut values = Values::new(file, offset, header.encoding);
                match values.skip_element(element) {
                    Ok(()) => values.offset,
                    Err(Stop::End) => file.bytes(),
                    Err(stop) => return Err(refused(file, stop)),
                }
            }
        };
    }
    Ok(offset)
}

fn refused(file: &SourceFile, stop: Stop) -> FormatError {
    match stop {
        Stop::Io(source) => FormatError::Io { path: file.path().to_owned(), action: "reading", source },
        Stop::NegativeCount(at) => file.malformed(at, "a list with a count", "a negative count"),
        Stop::End => file.malformed(file.bytes(), "more values", "the end of the file"),
    }
}

/// A word for everything in the file that does not become points.
fn not_kept(header: &Header, vertex: usize) -> Vec<String> {
    let others = header.elements.iter().enumerate().filter(|(i, e)| *i != vertex && e.count > 0);
    let mut warnings: Vec<_> =
        others.map(|(_, e)| format!("{} records of element `{}` are not kept", e.count, e.name)).collect();
    let lists = header.elements[vertex].properties.iter().filter(|p| matches!(p.kind, Kind::List { .. }));
    warnings.extend(lists.map(|p| format!("list property `{}` of the vertices is not kept", p.name)));
    warnings
}

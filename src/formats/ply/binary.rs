//! Binary records of a PLY file to our records: block by block where all have one size, else one by one.

use super::header::{Element, Encoding, Kind};
use super::layout::Target;
use crate::formats::file::{SourceFile, Window};
use crate::points::ScalarType;
use std::io::{self, BufReader, ErrorKind, Read};

/// A run of bytes of a source record that goes to one place.
#[derive(Clone, Copy, Debug)]
struct Step {
    from: usize,
    ty: ScalarType,
    target: Target,
    /// Values, all next to each other on both sides.
    values: usize,
}

/// How fixed-size records are turned into ours.
#[derive(Debug)]
pub struct Conversion {
    steps: Vec<Step>,
    big: bool,
    source_bytes: usize,
    record_bytes: usize,
}

impl Conversion {
    /// For `vertex`, whose properties go to `targets` in records of `record_bytes`; `None` if it has lists.
    pub fn new(vertex: &Element, targets: &[Target], record_bytes: usize, encoding: Encoding) -> Option<Self> {
        let source_bytes = usize::try_from(vertex.fixed_bytes()?).ok()?;
        let mut steps: Vec<Step> = Vec::new();
        let mut from = 0;
        for (property, &target) in vertex.properties.iter().zip(targets) {
            let Kind::Scalar(ty) = property.kind else { return None };
            match (steps.last_mut(), target) {
                (Some(last), Target::Record(to)) if last.ty == ty && last.follows(from, to) => last.values += 1,
                _ => steps.push(Step { from, ty, target, values: 1 }),
            }
            from += ty.size();
        }
        Some(Self { steps, big: encoding == Encoding::Big, source_bytes, record_bytes })
    }

    /// Bytes of a source record.
    pub fn source_bytes(&self) -> usize {
        self.source_bytes
    }

    /// Converts whole source records; `to` has room for as many of ours.
    pub fn convert(&self, from: &[u8], to: &mut [u8]) {
        // One step over many records: the decision is made once, and the records stay in the nearest cache.
        const BLOCK: usize = 256;
        let from = from.chunks(BLOCK * self.source_bytes);
        for (from, to) in from.zip(to.chunks_mut(BLOCK * self.record_bytes)) {
            for step in &self.steps {
                self.run(step, from, to);
            }
        }
    }

    fn run(&self, step: &Step, from: &[u8], to: &mut [u8]) {
        macro_rules! axis {
            ($axis:expr, $t:ty) => {{
                let convert = |value: [u8; size_of::<$t>()]| {
                    let value = if self.big { <$t>::from_be_bytes(value) } else { <$t>::from_le_bytes(value) };
                    (value as f64).to_le_bytes()
                };
                self.each(from, to, step.from, 8 * $axis, convert);
            }};
        }
        macro_rules! swapped {
            ($to:expr, $n:literal) => {
                for i in 0..step.values {
                    let reverse = |mut value: [u8; $n]| {
                        value.reverse();
                        value
                    };
                    self.each(from, to, step.from + $n * i, $to + $n * i, reverse);
                }
            };
        }
        match (step.target, step.ty) {
            (Target::Skip, _) => {}
            (Target::Axis(axis), ScalarType::U8) => axis!(axis, u8),
            (Target::Axis(axis), ScalarType::I8) => axis!(axis, i8),
            (Target::Axis(axis), ScalarType::U16) => axis!(axis, u16),
            (Target::Axis(axis), ScalarType::I16) => axis!(axis, i16),
            (Target::Axis(axis), ScalarType::U32) => axis!(axis, u32),
            (Target::Axis(axis), ScalarType::I32) => axis!(axis, i32),
            (Target::Axis(axis), ScalarType::U64) => axis!(axis, u64),
            (Target::Axis(axis), ScalarType::I64) => axis!(axis, i64),
            (Target::Axis(axis), ScalarType::F32) => axis!(axis, f32),
            (Target::Axis(axis), ScalarType::F64) => axis!(axis, f64),
            (Target::Record(at), ty) if self.big && ty.size() > 1 => match ty.size() {
                2 => swapped!(at, 2),
                4 => swapped!(at, 4),
                _ => swapped!(at, 8),
            },
            (Target::Record(at), ty) => {
                let bytes = ty.size() * step.values;
                macro_rules! copied {
                    ($($n:literal)*) => {
                        match bytes {
                            // Sizes that the compiler knows are one or two moves.
                            $($n => return self.each(from, to, step.from, at, |value: [u8; $n]| value),)*
                            _ => {}
                        }
                    };
                }
                copied!(1 2 3 4 6 8 12 16 24);
                for (from, to) in from.chunks_exact(self.source_bytes).zip(to.chunks_exact_mut(self.record_bytes)) {
                    to[at..at + bytes].copy_from_slice(&from[step.from..step.from + bytes]);
                }
            }
        }
    }

    #[inline(always)]
    fn each<const N: usize, const M: usize>(
        &self,
        from: &[u8],
        to: &mut [u8],
        from_at: usize,
        to_at: usize,
        convert: impl Fn([u8; N]) -> [u8; M],
    ) {
        for (from, to) in from.chunks_exact(self.source_bytes).zip(to.chunks_exact_mut(self.record_bytes)) {
            let mut value = [0; N];
            value.copy_from_slice(&from[from_at..from_at + N]);
            to[to_at..to_at + M].copy_from_slice(&convert(value));
        }
    }
}

impl Step {
    /// Is a value at `from` that goes to `to` the next one after this step's?
    fn follows(&self, from: usize, to: usize) -> bool {
        let bytes = self.values * self.ty.size();
        matches!(self.target, Target::Record(at) if at + bytes == to) && self.from + bytes == from
    }
}

/// Reads binary values one after the other.
pub struct Values<'a> {
    source: BufReader<Window<'a>>,
    big: bool,
    /// Byte of the next value.
    pub offset: u64,
}

/// What can stop a [`Values`].
#[derive(Debug)]
pub enum Stop {
    /// The file ended.
    End,
    /// A list at this byte has a negative count.
    NegativeCount(u64),
    /// The system refused.
    Io(io::Error),
}

impl From<io::Error> for Stop {
    fn from(error: io::Error) -> Self {
        if error.kind() == ErrorKind::UnexpectedEof { Self::End } else { Self::Io(error) }
    }
}

impl<'a> Values<'a> {
    /// From byte `offset` of `file` on.
    pub fn new(file: &'a SourceFile, offset: u64, encoding: Encoding) -> Self {
        let source = BufReader::with_capacity(1 << 18, file.reader(offset, u64::MAX));
        Self { source, big: encoding == Encoding::Big, offset }
    }

    /// The next value, little-endian.
    pub fn scalar(&mut self, ty: ScalarType) -> Result<[u8; 8], Stop> {
        let mut value = [0; 8];
        let bytes = &mut value[..ty.size()];
        self.source.read_exact(bytes)?;
        if self.big {
            bytes.reverse();
        }
        self.offset += ty.size() as u64;
        Ok(value)
    }

    /// Passes over a list.
    pub fn skip_list(&mut self, count: ScalarType, item: ScalarType) -> Result<(), Stop> {
        let at = self.offset;
        let raw = self.scalar(count)?;
        let unused = 64 - 8 * count.size() as u32;
        let wide = i64::from_le_bytes(raw);
        let signed = matches!(count, ScalarType::I8 | ScalarType::I16 | ScalarType::I32 | ScalarType::I64);
        if signed && wide << unused < 0 {
            return Err(Stop::NegativeCount(at));
        }
        let bytes = u64::from_le_bytes(raw).checked_mul(item.size() as u64).ok_or(Stop::End)?;
        self.skip(bytes)
    }

    /// Passes over `bytes`.
    fn skip(&mut self, bytes: u64) -> Result<(), Stop> {
        let skipped = io::copy(&mut self.source.by_ref().take(bytes), &mut io::sink())?;
        self.offset += skipped;
        if skipped < bytes { Err(Stop::End) } else { Ok(()) }
    }

    /// Passes over all records of an element.
    pub fn skip_element(&mut self, element: &Element) -> Result<(), Stop> {
        if element.properties.is_empty() {
            return Ok(());
        }
        for _ in 0..element.count {
            for property in &element.properties {
                match property.kind {
                    Kind::Scalar(ty) => drop(self.scalar(ty)?),
                    Kind::List { count, item } => self.skip_list(count, item)?,
                }
            }
        }
        Ok(())
    }
}

/// A little-endian value as `f64`.
pub fn to_f64(ty: ScalarType, raw: [u8; 8]) -> f64 {
    let [a, b, c, d, ..] = raw;
    match ty {
        ScalarType::U8 => f64::from(a),
        ScalarType::I8 => f64::from(a as i8),
        ScalarType::U16 => f64::from(u16::from_le_bytes([a, b])),
        ScalarType::I16 => f64::from(i16::from_le_bytes([a, b])),
        ScalarType::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
        ScalarType::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
        ScalarType::U64 => u64::from_le_bytes(raw) as f64,
        ScalarType::I64 => i64::from_le_bytes(raw) as f64,
        ScalarType::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
        ScalarType::F64 => f64::from_le_bytes(raw),
    }
}

//! Chunks of attributes.

use super::block::{put_block, read_block};
use super::directory::{Directory, put_head, read_head};
use super::morton;
use super::passes::{Beside, BlockPasses, Passes};
use super::reader::{Reader, put_uint};
use super::value::Value;
use super::{BLOCK_POINTS, CodecError, Decoder, Encoder, PositionChunk, block_count, block_range};
use crate::lattice::{Cube, LOW_DIGITS, SortKey};
use crate::points::{Column, ScalarType};
use crate::with_column;

/// The codec byte of attributes, version 1.
const CODEC: u8 = 2;

/// Set in the type's byte where one value stands for all.
const CONSTANT: u8 = 0x80;

const TYPE: &str = "type of the values";

/// The byte that stands for a type.
fn type_code(ty: ScalarType) -> u8 {
    match ty {
        ScalarType::U8 => 0,
        ScalarType::I8 => 1,
        ScalarType::U16 => 2,
        ScalarType::I16 => 3,
        ScalarType::U32 => 4,
        ScalarType::I32 => 5,
        ScalarType::U64 => 6,
        ScalarType::I64 => 7,
        ScalarType::F32 => 8,
        ScalarType::F64 => 9,
    }
}

/// Are all values the same, bit for bit?
fn is_constant<T: Value>(values: &[T]) -> bool {
    // In runs, so that the compiler may compare many at once and a difference is seen soon.
    values
        .first()
        .is_none_or(|first| values.chunks(64).all(|run| run.iter().fold(0, |d, v| d | (v.bits() ^ first.bits())) == 0))
}

impl Encoder {
    /// Appends the chunk of a column's values, which decode without positions.
    ///
    /// # Errors
    ///
    /// [`CodecError::TooManyPoints`]; `out` is then as it was.
    pub fn column(&mut self, column: &Column, out: &mut Vec<u8>) -> Result<(), CodecError> {
        put_head(CODEC, column.len(), out)?;
        with_column!(column, values => self.put_values(column.ty(), values, Beside::Passes(&Passes::default()), out));
        Ok(())
    }

    /// The same for the times of points with these keys of `cube`, one for each, where they may follow from positions. Gives
    /// the passes that they show, which positions and other columns are to be encoded with.
    ///
    /// # Errors
    ///
    /// [`CodecError::TooManyPoints`]; `out` is then as it was.
    pub fn times<K: SortKey>(
        &mut self,
        column: &Column,
        cube: Cube,
        keys: &[K],
        out: &mut Vec<u8>,
    ) -> Result<Passes, CodecError> {
        if cube.k() > LOW_DIGITS || keys.len() != column.len() {
            return self.column(column, out).map(|()| Passes::default());
        }
        put_head(CODEC, column.len(), out)?;
        let prefix = cube.first_key().low;
        let blocks = keys.chunks(BLOCK_POINTS).map(|keys| {
            let mut places = Vec::new();
            morton::places(cube, keys.iter().map(|key| key.halves().1 ^ prefix), &mut places);
            BlockPasses { places, ..BlockPasses::default() }
        });
        let mut passes = Passes { blocks: blocks.collect() };
        with_column!(column, values => self.put_values(column.ty(), values, Beside::Times(&mut passes), out));
        Ok(passes)
    }

    /// The same for values of points whose passes are known: what is steady within a pass takes next to nothing.
    ///
    /// # Errors
    ///
    /// [`CodecError::TooManyPoints`]; `out` is then as it was.
    pub fn column_beside(&mut self, column: &Column, passes: &Passes, out: &mut Vec<u8>) -> Result<(), CodecError> {
        put_head(CODEC, column.len(), out)?;
        with_column!(column, values => self.put_values(column.ty(), values, Beside::Passes(passes), out));
        Ok(())
    }

    fn put_values<T: Value>(&mut self, ty: ScalarType, values: &[T], mut beside: Beside, out: &mut Vec<u8>) {
        if let Some(first) = values.first()
            && is_constant(values)
        {
            out.push(type_code(ty) | CONSTANT);
            put_uint(first.bits(), ty.size(), out);
            return;
        }
        out.push(type_code(ty));
        self.blocks.clear();
        self.ends.clear();
        for (block, values) in values.chunks(BLOCK_POINTS).enumerate() {
            put_block(&mut self.streams, &mut self.buffers, ty, values, beside.block(block), &mut self.blocks);
            self.ends.push(self.blocks.len());
        }
        self.put_blocks(out);
    }
}

/// The values of a part, still encoded. Where the blocks lie is checked, their content is not yet.
#[derive(Clone, Debug)]
pub struct ColumnChunk<'a> {
    ty: ScalarType,
    count: usize,
    content: Content<'a>,
    positions: Option<&'a PositionChunk<'a>>,
}

#[derive(Clone, Debug)]
enum Content<'a> {
    /// The bits of every value.
    Constant(u64),
    Blocks(Directory<'a>),
}

impl<'a> ColumnChunk<'a> {
    /// Reads the head of the chunk of `count` values.
    ///
    /// # Errors
    ///
    /// [`CodecError`] if the head is not that of such a chunk.
    pub fn parse(bytes: &'a [u8], ty: ScalarType, count: usize) -> Result<Self, CodecError> {
        let mut reader = Reader::new(bytes);
        read_head(&mut reader, CODEC, count)?;
        let kind = reader.u8(TYPE)?;
        let found = ScalarType::ALL.into_iter().find(|t| type_code(*t) == kind & !CONSTANT);
        if found != Some(ty) {
            let found = found.map_or("an unknown type", ScalarType::word);
            return Err(CodecError::Type { expected: ty.word(), found });
        }
        let content = if kind & CONSTANT == 0 {
            Content::Blocks(Directory::read(reader, block_count(count))?)
        } else {
            let bits = reader.uint(ty.size(), "constant value")?;
            reader.end("bytes after a constant value")?;
            Content::Constant(bits)
        };
        Ok(Self { ty, count, content, positions: None })
    }

    /// Says where the positions of the same points are, which some blocks need.
    #[must_use]
    pub fn at(self, positions: &'a PositionChunk<'a>) -> Self {
        Self { positions: Some(positions), ..self }
    }

    /// The number of values.
    pub fn count(&self) -> usize {
        self.count
    }

    /// The number of blocks.
    pub fn blocks(&self) -> usize {
        block_count(self.count)
    }

    /// The bytes of the value that all points have, little-endian, if the chunk says so; the rest is zero.
    pub fn constant(&self) -> Option<[u8; 8]> {
        match self.content {
            Content::Constant(bits) => Some(bits.to_le_bytes()),
            Content::Blocks(_) => None,
        }
    }

    /// Appends the values of one block.
    ///
    /// # Errors
    ///
    /// [`CodecError`] if there is no such block, its bytes are not one, or `out` has another type;
    /// [`CodecError::NoPositions`] if the block needs them. `out` is then as it was.
    pub fn decode_block(&self, decoder: &mut Decoder, block: usize, out: &mut Column) -> Result<(), CodecError> {
        if out.ty() != self.ty {
            return Err(CodecError::Type { expected: self.ty.word(), found: out.ty().word() });
        }
        if block >= self.blocks() {
            return Err(CodecError::Block { block, blocks: self.blocks() });
        }
        let count = block_range(block, self.count).len();
        match &self.content {
            Content::Constant(bits) => {
                with_column!(out, values => values.resize(values.len() + count, Value::of_bits(*bits)));
                Ok(())
            }
            Content::Blocks(directory) => {
                let bytes = directory.block(block)?;
                let beside = self.positions.map(|positions| (positions, block));
                with_column!(out, values => read_block(decoder, self.ty, bytes, count, beside, values))
            }
        }
    }

    /// Appends all values.
    ///
    /// # Errors
    ///
    /// As [`ColumnChunk::decode_block`]; `out` then has the blocks before the damaged one.
    pub fn decode(&self, decoder: &mut Decoder, out: &mut Column) -> Result<(), CodecError> {
        with_column!(&mut *out, values => values.reserve(self.count));
        (0..self.blocks()).try_for_each(|block| self.decode_block(decoder, block, out))
    }
}

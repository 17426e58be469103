//! Chunks of attributes.

use super::block::{needs_passes, put_block, read_block};
use super::directory::{Cut, Directory, put_head, read_head};
use super::joint::{Leaders, MAX_LEADERS};
use super::leaders::Kept;
use super::morton;
use super::passes::{Beside, BlockPasses, Passes};
use super::reader::{Reader, put_uint};
use super::value::Value;
use super::{Blocks, CodecError, Decoder, Encoder, PositionChunk};
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
        let blocks = keys.chunks(self.size.points()).map(|keys| {
            let mut places = Vec::new();
            morton::places(cube, keys.iter().map(|key| key.halves().1 ^ prefix), &mut places);
            BlockPasses { places, ..BlockPasses::default() }
        });
        let mut passes = Passes { blocks: blocks.collect() };
        with_column!(column, values => self.put_values(column.ty(), values, Beside::Times(&mut passes), out));
        Ok(passes)
    }

    /// The same for values of points whose passes are known: what is steady within a pass takes next to nothing. Of a column
    /// that follows others of the same points, at most two, of `u8` or `u16`, what is alike in them is stored once: it can be
    /// decoded only with theirs ([`ColumnChunk::after`]), in the same order.
    ///
    /// # Errors
    ///
    /// [`CodecError::TooManyPoints`]; `out` is then as it was.
    pub fn column_after(
        &mut self,
        column: &Column,
        passes: &Passes,
        leaders: &[&Column],
        out: &mut Vec<u8>,
    ) -> Result<(), CodecError> {
        put_head(CODEC, column.len(), out)?;
        let mut all = std::mem::take(&mut self.leaders);
        let mut given = 0;
        for (values, leader) in all.iter_mut().zip(leaders) {
            values.clear();
            match leader {
                Column::U8(narrow) => values.extend(narrow.iter().map(|v| u16::from(*v))),
                Column::U16(wide) => values.extend_from_slice(wide),
                _ => {}
            }
            // Others can't be followed, nor what comes after them.
            if values.len() != column.len() {
                break;
            }
            given += 1;
        }
        let slices = std::array::from_fn(|i| (i < given).then_some(&all[i][..]));
        with_column!(column, values => self.put_after(column.ty(), values, Beside::Passes(passes), slices, out));
        self.leaders = all;
        Ok(())
    }

    fn put_values<T: Value>(&mut self, ty: ScalarType, values: &[T], beside: Beside, out: &mut Vec<u8>) {
        self.put_after(ty, values, beside, [None; MAX_LEADERS], out);
    }

    fn put_after<T: Value>(
        &mut self,
        ty: ScalarType,
        values: &[T],
        mut beside: Beside,
        leaders: Leaders,
        out: &mut Vec<u8>,
    ) {
        if let Some(first) = values.first()
            && T::all_same(values)
        {
            out.push(type_code(ty) | CONSTANT);
            put_uint(first.bits(), ty.size(), out);
            return;
        }
        out.push(type_code(ty));
        self.blocks.clear();
        self.ends.clear();
        self.buffers.joint = None;
        let cut = Blocks::new(values.len(), self.size);
        for block in 0..cut.count() {
            let Self { streams, buffers, blocks, .. } = self;
            let own = &values[cut.range(block)];
            let leaders = leaders.map(|leader| leader.map(|leader| &leader[cut.range(block)]));
            put_block(streams, buffers, ty, own, beside.block(block), leaders, blocks);
            self.ends.push(self.blocks.len());
        }
        self.put_blocks(out);
    }
}

/// The values of a part, still encoded. Where the blocks lie is checked, their content is not yet.
#[derive(Clone, Debug)]
pub struct ColumnChunk<'a> {
    ty: ScalarType,
    blocks: Blocks,
    content: Content<'a>,
    positions: Option<&'a PositionChunk<'a>>,
    leaders: Vec<ColumnChunk<'a>>,
    /// Do others follow this one?
    leads: bool,
}

#[derive(Clone, Debug)]
enum Content<'a> {
    /// The bits of every value.
    Constant(u64),
    Blocks(Directory<'a>),
}

/// See [`cuts`](super::cuts).
pub(super) fn cuts(bytes: &[u8], blocks: Blocks) -> Result<Vec<Cut>, CodecError> {
    let mut reader = Reader::new(bytes);
    read_head(&mut reader, CODEC, blocks.points())?;
    if reader.u8(TYPE)? & CONSTANT != 0 {
        return Ok(vec![Cut { end: bytes.len(), block: None }]);
    }
    Ok(Directory::read(reader, blocks.count())?.cuts(blocks.count(), bytes.len()))
}

impl<'a> ColumnChunk<'a> {
    /// Reads the head of the chunk of the values of a part with these blocks.
    ///
    /// # Errors
    ///
    /// [`CodecError`] if the head is not that of such a chunk.
    pub fn parse(bytes: &'a [u8], ty: ScalarType, blocks: Blocks) -> Result<Self, CodecError> {
        let mut reader = Reader::new(bytes);
        read_head(&mut reader, CODEC, blocks.points())?;
        let kind = reader.u8(TYPE)?;
        let found = ScalarType::ALL.into_iter().find(|t| type_code(*t) == kind & !CONSTANT);
        if found != Some(ty) {
            let found = found.map_or("an unknown type", ScalarType::word);
            return Err(CodecError::Type { expected: ty.word(), found });
        }
        let content = if kind & CONSTANT == 0 {
            Content::Blocks(Directory::read(reader, blocks.count())?)
        } else {
            let bits = reader.uint(ty.size(), "constant value")?;
            reader.end("bytes after a constant value")?;
            Content::Constant(bits)
        };
        Ok(Self { ty, blocks, content, positions: None, leaders: Vec::new(), leads: false })
    }

    /// Says where the positions of the same points are, which some blocks need.
    #[must_use]
    pub fn at(self, positions: &'a PositionChunk<'a>) -> Self {
        let leaders = self.leaders.into_iter().map(|leader| leader.at(positions)).collect();
        Self { positions: Some(positions), leaders, ..self }
    }

    /// Says which column, of the same points, this one follows; of two the first is said first.
    #[must_use]
    pub fn after(mut self, leader: Self) -> Self {
        self.leaders.push(Self { leads: true, ..leader });
        self
    }

    /// Says that others follow this one: a block that is decoded is then kept for theirs.
    #[must_use]
    pub fn leading(self) -> Self {
        Self { leads: true, ..self }
    }

    /// The number of values.
    pub fn count(&self) -> usize {
        self.blocks.points()
    }

    /// The number of blocks.
    pub fn blocks(&self) -> usize {
        self.blocks.count()
    }

    /// The bytes of the value that all points have, little-endian, if the chunk says so; the rest is zero.
    pub fn constant(&self) -> Option<[u8; 8]> {
        match self.content {
            Content::Constant(bits) => Some(bits.to_le_bytes()),
            Content::Blocks(_) => None,
        }
    }

    /// Appends the value that all points have so many times, if the chunk says so and `out` has its type.
    pub fn repeat(&self, count: usize, out: &mut Column) -> bool {
        let Content::Constant(bits) = self.content else { return false };
        let same = out.ty() == self.ty;
        if same {
            with_column!(out, values => values.resize(values.len() + count, Value::of_bits(bits)));
        }
        same
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
        let count = self.blocks.len_of(block);
        match (&self.content, &mut *out) {
            (Content::Constant(bits), out) => {
                with_column!(out, values => values.resize(values.len() + count, Value::of_bits(*bits)));
                Ok(())
            }
            (Content::Blocks(_), Column::U8(values)) if self.leads => {
                let kept = self.take_leader(decoder, block)?;
                values.extend(kept.values.iter().map(|v| *v as u8));
                decoder.leaders.put(kept);
                Ok(())
            }
            (Content::Blocks(_), Column::U16(values)) if self.leads => {
                let kept = self.take_leader(decoder, block)?;
                values.extend_from_slice(&kept.values);
                decoder.leaders.put(kept);
                Ok(())
            }
            (Content::Blocks(directory), out) => {
                let bytes = directory.block(block)?;
                with_column!(out, values => self.read_block(decoder, block, bytes, values))
            }
        }
    }

    /// Appends a block that is not of one value for all points of the chunk.
    fn read_block<T: Value>(
        &self,
        decoder: &mut Decoder,
        block: usize,
        bytes: &[u8],
        out: &mut Vec<T>,
    ) -> Result<(), CodecError> {
        let count = self.blocks.len_of(block);
        let beside = self.positions.map(|positions| (positions, block));
        let mut kept: [Option<Kept>; MAX_LEADERS] = Default::default();
        // The last one may follow those before it, and then finds them where they are kept.
        for (kept, leader) in kept.iter_mut().zip(&self.leaders).rev() {
            *kept = Some(leader.take_leader(decoder, block)?);
        }
        let leaders = kept.each_ref().map(|kept| kept.as_ref().map(|kept| &kept.values[..]));
        let result = read_block(decoder, self.ty, bytes, count, beside, leaders, out);
        kept.into_iter().flatten().for_each(|kept| decoder.leaders.put(kept));
        result
    }

    /// A block of a column that others follow, as it is kept or decoded anew; to be put back.
    fn take_leader(&self, decoder: &mut Decoder, block: usize) -> Result<Kept, CodecError> {
        let mut fresh = decoder.leaders.fresh();
        self.put_key(block, &mut fresh.key)?;
        if let Some(found) = decoder.leaders.take(&fresh.key) {
            decoder.leaders.put_spare(fresh);
            return Ok(found);
        }
        let count = self.blocks.len_of(block);
        match (&self.content, self.ty) {
            (Content::Constant(bits), ScalarType::U8 | ScalarType::U16) => fresh.values.resize(count, *bits as u16),
            (Content::Blocks(directory), ScalarType::U16) => {
                self.read_block(decoder, block, directory.block(block)?, &mut fresh.values)?;
            }
            (Content::Blocks(directory), ScalarType::U8) => {
                let mut narrow: Vec<u8> = Vec::with_capacity(count);
                self.read_block(decoder, block, directory.block(block)?, &mut narrow)?;
                fresh.values.extend(narrow.into_iter().map(u16::from));
            }
            _ => return Err(CodecError::Type { expected: "u8 or u16", found: self.ty.word() }),
        }
        Ok(fresh)
    }

    /// All that the values of a block are a function of.
    fn put_key(&self, block: usize, key: &mut Vec<u8>) -> Result<(), CodecError> {
        let (kind, bytes) = match &self.content {
            Content::Constant(bits) => (CONSTANT, &bits.to_le_bytes()[..]),
            Content::Blocks(directory) => (0, directory.block(block)?),
        };
        key.push(type_code(self.ty) | kind);
        key.extend_from_slice(&(self.blocks.len_of(block) as u32).to_le_bytes());
        key.extend_from_slice(&(bytes.len() as u64).to_le_bytes());
        key.extend_from_slice(bytes);
        if let Some(positions) = self.positions.filter(|_| kind == 0 && needs_passes(bytes)) {
            positions.put_key(block, key)?;
        }
        self.leaders.iter().take(MAX_LEADERS).try_for_each(|leader| leader.put_key(block, key))
    }

    /// Appends all values.
    ///
    /// # Errors
    ///
    /// As [`ColumnChunk::decode_block`]; `out` then has the blocks before the damaged one.
    pub fn decode(&self, decoder: &mut Decoder, out: &mut Column) -> Result<(), CodecError> {
        with_column!(&mut *out, values => values.reserve(self.blocks.points()));
        (0..self.blocks()).try_for_each(|block| self.decode_block(decoder, block, out))
    }
}

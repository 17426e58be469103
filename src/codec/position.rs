//! Chunks of positions: sorted Morton keys of one cube.
//!
//! Keys are stored relative to the cube's first, so in `3 k` bits. A block has its first key as it is and then the
//! differences from key to key, which are small and often zero, as residuals. Cubes whose keys have more than 63 bits
//! go through [`wide`](super::wide).

use super::directory::{Cut, Directory, put_head, read_head};
use super::passes::{self, Passes};
use super::reader::{Reader, put_uint, put_varint};
use super::residual::{plan_all, put_residuals, read_residuals};
use super::{Blocks, CodecError, Decoder, Encoder, morton};
use crate::lattice::{Cube, LOW_DIGITS, LatticeBox, LatticePoint, SortKey};
use crate::points::Positions;

/// The codec byte of positions, version 1.
const CODEC: u8 = 1;

const FIRST_KEY: &str = "first key of a block";

/// Bytes of a coordinate relative to the cube's corner.
fn coordinate_bytes(cube: Cube) -> usize {
    usize::from(cube.k()).div_ceil(8)
}

/// Bytes of a key relative to the cube's first.
pub(super) fn key_bytes(cube: Cube) -> usize {
    (3 * usize::from(cube.k())).div_ceil(8)
}

impl Encoder {
    /// Appends the chunk of the points with these keys, which must be ascending and inside `cube`.
    ///
    /// `K` is `u64` (the low keys) for cubes of exponent at most [`LOW_DIGITS`], and
    /// [`Key`](crate::lattice::Key) for any.
    ///
    /// # Errors
    ///
    /// [`CodecError::TooManyPoints`]; [`CodecError::Key`] if a key is smaller than the one before it or outside the
    /// cube. `out` is then as it was.
    pub fn positions<K: SortKey>(&mut self, cube: Cube, keys: &[K], out: &mut Vec<u8>) -> Result<(), CodecError> {
        self.positions_with(cube, keys, &Passes::default(), out)
    }

    /// The same with the passes of the points, which columns encoded beside them need.
    ///
    /// # Errors
    ///
    /// As [`Encoder::positions`].
    pub fn positions_with<K: SortKey>(
        &mut self,
        cube: Cube,
        keys: &[K],
        passes: &Passes,
        out: &mut Vec<u8>,
    ) -> Result<(), CodecError> {
        let mut head = Vec::with_capacity(64);
        put_head(CODEC, keys.len(), &mut head)?;
        self.blocks.clear();
        self.ends.clear();
        let mut before = None;
        let cut = Blocks::new(keys.len(), self.size);
        for block in 0..cut.count() {
            let range = cut.range(block);
            let first = range.start;
            let keys = &keys[range];
            if before.is_some_and(|before| keys[0] < before) {
                return Err(CodecError::Key { index: first });
            }
            before = keys.last().copied();
            let bounds = if cube.k() <= LOW_DIGITS {
                self.narrow_block(cube, keys)
            } else {
                super::wide::put_block(&mut self.streams, cube, keys, &mut self.buffers, &mut self.blocks)
            };
            let bounds = bounds.map_err(|index| CodecError::Key { index: first + index })?;
            for corner in [bounds.min, bounds.max] {
                for (c, low) in corner.0.iter().zip(cube.low().0) {
                    put_uint(c - low, coordinate_bytes(cube), &mut head);
                }
            }
            self.ends.push(self.blocks.len());
        }
        for block in 0..cut.count() {
            if let Some(passes) = passes.blocks.get(block) {
                passes.put(&mut self.streams, &mut self.buffers.packed, &mut self.blocks);
            }
            self.ends.push(self.blocks.len());
        }
        out.extend_from_slice(&head);
        self.put_blocks(out);
        Ok(())
    }

    /// Appends the lengths of the blocks and the blocks.
    pub(super) fn put_blocks(&self, out: &mut Vec<u8>) {
        let mut start = 0;
        for &end in &self.ends {
            put_varint((end - start) as u64, out);
            start = end;
        }
        out.extend_from_slice(&self.blocks);
    }

    /// Encodes a block of a cube of exponent at most 21; an error is the index of the key that is wrong.
    fn narrow_block<K: SortKey>(&mut self, cube: Cube, keys: &[K]) -> Result<LatticeBox, usize> {
        let (prefix, inside) = (cube.first_key(), (1_u64 << (3 * cube.k())) - 1);
        let relative = &mut self.buffers.values;
        relative.clear();
        relative.extend(keys.iter().map(|key| key.halves().1 ^ prefix.low));
        let outside = |key: &K| {
            let (high, low) = key.halves();
            // A truncated key has nothing above.
            (high != 0 && high != prefix.high) || (low ^ prefix.low) > inside
        };
        if let Some(index) = keys.iter().position(outside) {
            return Err(index);
        }
        let differences = &mut self.buffers.residuals;
        differences.clear();
        differences.extend(relative.windows(2).map(|w| w[1].wrapping_sub(w[0])));
        if let Some(index) = relative.windows(2).position(|w| w[1] < w[0]) {
            return Err(index + 1);
        }
        put_uint(relative[0], key_bytes(cube), &mut self.blocks);
        let (plan, bits) = plan_all(differences);
        put_residuals(&mut self.streams, differences.iter().copied(), bits, plan.mantissa, &mut self.blocks);
        Ok(morton::bounds(cube, relative))
    }
}

/// The positions of a part, still encoded. Blocks and bounds are checked, the blocks' content is not yet.
#[derive(Clone, Debug)]
pub struct PositionChunk<'a> {
    cube: Cube,
    blocks: Blocks,
    bounds: Vec<LatticeBox>,
    directory: Directory<'a>,
}

impl<'a> PositionChunk<'a> {
    /// Reads the head of the chunk of the points of a part, with these blocks, inside `cube`.
    ///
    /// # Errors
    ///
    /// [`CodecError`] if the head is not that of such a chunk.
    pub fn parse(bytes: &'a [u8], cube: Cube, blocks: Blocks) -> Result<Self, CodecError> {
        let mut reader = Reader::new(bytes);
        read_head(&mut reader, CODEC, blocks.points())?;
        let mut bounds = Vec::with_capacity(blocks.count());
        for _ in 0..blocks.count() {
            let min = read_corner(&mut reader, cube)?;
            let max = read_corner(&mut reader, cube)?;
            if let Some(axis) = (0..3).find(|i| min.0[*i] > max.0[*i]) {
                let (found, limit) = (min.0[axis], max.0[axis]);
                return Err(CodecError::Range { place: "lower bound of a block", found, limit });
            }
            bounds.push(LatticeBox { min, max });
        }
        Ok(Self { cube, blocks, bounds, directory: Directory::read(reader, 2 * blocks.count())? })
    }

    /// See [`cuts`](super::cuts).
    pub(super) fn cuts(&self, chunk_bytes: usize) -> Vec<Cut> {
        self.directory.cuts(self.bounds.len(), chunk_bytes)
    }

    /// The number of points.
    pub fn count(&self) -> usize {
        self.blocks.points()
    }

    /// The tight bounds of each block, in key order.
    pub fn blocks(&self) -> &[LatticeBox] {
        &self.bounds
    }

    /// Appends the points of one block.
    ///
    /// # Errors
    ///
    /// [`CodecError`] if there is no such block or its bytes are not one; `out` is then as it was.
    pub fn decode_block(&self, decoder: &mut Decoder, block: usize, out: &mut Positions) -> Result<(), CodecError> {
        let (bytes, count) = self.block(block)?;
        if self.cube.k() <= LOW_DIGITS {
            self.read_narrow(decoder, bytes, count)?;
            morton::append_points(self.cube, &decoder.keys.keys, out);
            Ok(())
        } else {
            let start = out.len();
            let result = super::wide::read_block(decoder, self.cube, bytes, count, |key| out.push(key.point()));
            if result.is_err() {
                out.x.truncate(start);
                out.y.truncate(start);
                out.z.truncate(start);
            }
            result
        }
    }

    /// Appends all points.
    ///
    /// # Errors
    ///
    /// As [`PositionChunk::decode_block`]; `out` then has the blocks before the damaged one.
    pub fn decode(&self, decoder: &mut Decoder, out: &mut Positions) -> Result<(), CodecError> {
        [&mut out.x, &mut out.y, &mut out.z].into_iter().for_each(|axis| axis.reserve(self.blocks.points()));
        (0..self.bounds.len()).try_for_each(|block| self.decode_block(decoder, block, out))
    }

    /// Appends the keys of one block, whole or truncated as the type has it.
    ///
    /// # Errors
    ///
    /// As [`PositionChunk::decode_block`].
    pub fn decode_block_keys<K: SortKey>(
        &self,
        decoder: &mut Decoder,
        block: usize,
        out: &mut Vec<K>,
    ) -> Result<(), CodecError> {
        let (bytes, count) = self.block(block)?;
        if self.cube.k() <= LOW_DIGITS {
            self.read_narrow(decoder, bytes, count)?;
            let prefix = self.cube.first_key();
            out.extend(decoder.keys.keys.iter().map(|key| K::from_halves(prefix.high, prefix.low | key)));
            Ok(())
        } else {
            let start = out.len();
            let push = |key: crate::lattice::Key| out.push(K::from_halves(key.high, key.low));
            let result = super::wide::read_block(decoder, self.cube, bytes, count, push);
            if result.is_err() {
                out.truncate(start);
            }
            result
        }
    }

    /// Appends all keys.
    ///
    /// # Errors
    ///
    /// As [`PositionChunk::decode`].
    pub fn decode_keys<K: SortKey>(&self, decoder: &mut Decoder, out: &mut Vec<K>) -> Result<(), CodecError> {
        out.reserve(self.blocks.points());
        (0..self.bounds.len()).try_for_each(|block| self.decode_block_keys(decoder, block, out))
    }

    /// Decodes where the points of one block are into `decoder.places`.
    pub(super) fn places(&self, decoder: &mut Decoder, block: usize) -> Result<(), CodecError> {
        let (bytes, count) = self.block(block)?;
        let (found, limit) = (u64::from(self.cube.k()), u64::from(LOW_DIGITS));
        if found > limit {
            return Err(CodecError::Range { place: "side of a cube with lines", found, limit });
        }
        self.read_narrow(decoder, bytes, count)?;
        morton::places(self.cube, decoder.keys.keys.iter().copied(), &mut decoder.places);
        Ok(())
    }

    /// Decodes the passes of the points of one block into `decoder.passes`, unless they are there, and gives their number.
    pub(super) fn passes(&self, decoder: &mut Decoder, block: usize) -> Result<usize, CodecError> {
        let bytes = self.directory.block(self.bounds.len() + block)?;
        let count = self.blocks.len_of(block);
        let Decoder { streams, passes, passes_of: (of, found), .. } = decoder;
        if *found > 0 && passes.len() == count && of == bytes {
            return Ok(*found);
        }
        *found = 0;
        *found = passes::read(streams, bytes, count, passes)?;
        of.clear();
        of.extend_from_slice(bytes);
        Ok(*found)
    }

    /// Appends all that positions and passes of one block are a function of.
    pub(super) fn put_key(&self, block: usize, key: &mut Vec<u8>) -> Result<(), CodecError> {
        key.push(self.cube.k());
        for index in [block, self.bounds.len() + block] {
            let bytes = self.directory.block(index)?;
            key.extend_from_slice(&(bytes.len() as u64).to_le_bytes());
            key.extend_from_slice(bytes);
        }
        Ok(())
    }

    fn block(&self, block: usize) -> Result<(&'a [u8], usize), CodecError> {
        if block >= self.bounds.len() {
            return Err(CodecError::Block { block, blocks: self.bounds.len() });
        }
        Ok((self.directory.block(block)?, self.blocks.len_of(block)))
    }

    /// Reads a block's keys, relative to the cube's first, into `decoder.keys`, unless they are there.
    fn read_narrow(&self, decoder: &mut Decoder, bytes: &[u8], count: usize) -> Result<(), CodecError> {
        let bits = 3 * u32::from(self.cube.k());
        let mut reader = Reader::new(bytes);
        let mut key = reader.uint(key_bytes(self.cube), FIRST_KEY)?;
        let Decoder { streams, keys: kept, .. } = decoder;
        if kept.keys.len() == count && kept.bits == bits && kept.of == bytes {
            return Ok(());
        }
        kept.of.clear();
        kept.of.extend_from_slice(bytes);
        kept.bits = bits;
        let keys = &mut kept.keys;
        let mut all = key;
        if let Err(error) = read_residuals(streams, reader, count - 1, bits, keys) {
            keys.clear();
            return Err(error);
        }
        // Keys and differences have at most 63 bits, so the first sum that leaves the cube shows before any overflows;
        // those after it may wrap.
        for value in keys.iter_mut() {
            let next = key.wrapping_add(*value);
            *value = key;
            key = next;
            all |= key;
        }
        keys.push(key);
        if all >> bits == 0 {
            Ok(())
        } else {
            let index = keys.iter().position(|key| key >> bits != 0).unwrap_or(0);
            keys.clear();
            Err(CodecError::Key { index })
        }
    }
}

fn read_corner(reader: &mut Reader, cube: Cube) -> Result<LatticePoint, CodecError> {
    const PLACE: &str = "bounds of a block";
    let mut corner = cube.low();
    for c in &mut corner.0 {
        let (found, limit) = (reader.uint(coordinate_bytes(cube), PLACE)?, cube.side() - 1);
        if found > limit {
            return Err(CodecError::Range { place: PLACE, found, limit });
        }
        *c += found;
    }
    Ok(corner)
}

//! Entropy decoding as LASzip has it: an arithmetic decoder over adaptive models (A. Said, *Introduction to Arithmetic Coding*,
//! HPL-2004-76: 32-bit range, renewed by bytes, models brought up to date from time to time).
//!
//! A symbol is found by counting the cumulative frequencies that do not exceed the target, sixteen at a time: a search with
//! branches is foretold wrong about once a symbol, which costs more than all of the rest.

use std::hint::select_unpredictable;
use wide::u16x16;

/// Bits of a range that cumulative frequencies are given in.
const FREQUENCY_BITS: u32 = 15;
/// Bits of a range that the probability of a bit is given in.
const BIT_BITS: u32 = 13;
/// Frequencies that are counted together.
const LANES: usize = 16;

/// Where a layer's decoder stands.
#[derive(Clone, Copy, Debug)]
pub struct State {
    /// The next byte of the chunk.
    at: usize,
    /// Behind the layer's last byte.
    end: usize,
    value: u32,
    range: u32,
}

impl State {
    /// At the start of a layer that takes bytes `start` to `end` of a chunk.
    pub fn new(chunk: &[u8], start: usize, end: usize) -> Self {
        Self { at: start + 4, end, value: word(chunk, start), range: u32::MAX }
    }

    /// Has more been read than the layer has?
    pub fn is_exhausted(&self) -> bool {
        self.at > self.end
    }
}

/// Four bytes as they are shifted into a value; zeros behind the end.
#[inline(always)]
fn word(chunk: &[u8], at: usize) -> u32 {
    chunk
        .get(at..)
        .and_then(|rest| rest.first_chunk())
        .map_or_else(|| last_word(chunk, at), |bytes| u32::from_be_bytes(*bytes))
}

#[cold]
fn last_word(chunk: &[u8], at: usize) -> u32 {
    u32::from_be_bytes(std::array::from_fn(|i| chunk.get(at + i).copied().unwrap_or(0)))
}

/// Decodes symbols of one layer of a chunk.
///
/// Behind the layer's end it reads what follows, so whoever decodes asks [`is_exhausted`](Self::is_exhausted) before what
/// was decoded is used.
pub struct Coder<'a> {
    chunk: &'a [u8],
    state: &'a mut State,
}

impl<'a> Coder<'a> {
    /// Goes on from `state`.
    pub fn new(chunk: &'a [u8], state: &'a mut State) -> Self {
        Self { chunk, state }
    }

    /// Has more been read than the layer has?
    pub fn is_exhausted(&self) -> bool {
        self.state.is_exhausted()
    }

    /// Widens the range again, by whole bytes.
    #[inline(always)]
    fn renew(&mut self) {
        let bytes = self.state.range.leading_zeros() / 8;
        let following = u64::from(word(self.chunk, self.state.at));
        self.state.at += bytes as usize;
        let shift = 8 * bytes;
        self.state.range <<= shift;
        let value = u64::from(self.state.value) << 32 | following;
        self.state.value = (value << shift >> 32) as u32;
    }

    /// The next symbol of a model.
    #[inline(always)]
    pub fn symbol<const ROWS: usize, const TOPS: usize>(&mut self, model: &mut Model<ROWS, TOPS>) -> usize {
        let range = self.state.range;
        let step = range >> FREQUENCY_BITS;
        // A range has at least 24 bits, so a step is never 0; targets are below 2^15 + 2^7.
        let target = self.state.value.checked_div(step).unwrap_or(0) as u16;
        let symbol = model.find(target);
        let below = model.below.as_flattened();
        let low = u32::from(below[symbol]) * step;
        // Not used behind the last symbol.
        let next = below.get(symbol + 1).map_or(0, |&below| u32::from(below)).wrapping_mul(step);
        let high = select_unpredictable(symbol == model.last, range, next);
        self.state.value = self.state.value.wrapping_sub(low);
        self.state.range = high.wrapping_sub(low);
        self.renew();
        model.count(symbol);
        symbol
    }

    /// The next bit of a model.
    #[inline(always)]
    pub fn bit(&mut self, model: &mut BitModel) -> bool {
        let low = model.zero * (self.state.range >> BIT_BITS);
        let bit = self.state.value >= low;
        self.state.value -= select_unpredictable(bit, low, 0);
        self.state.range = select_unpredictable(bit, self.state.range - low, low);
        self.renew();
        model.count(bit);
        bit
    }

    /// The next `bits` bits, all equally probable; at most 32, possibly none.
    #[inline(always)]
    pub fn bits(&mut self, bits: u32) -> u32 {
        // More than 19 at once would leave the range too narrow. Of damaged bytes the lower 16 may be 17, and are cut.
        if bits > 19 { self.few_bits(16) & 0xffff | self.few_bits(bits - 16) << 16 } else { self.few_bits(bits) }
    }

    #[inline(always)]
    fn few_bits(&mut self, bits: u32) -> u32 {
        let step = self.state.range >> bits;
        let symbol = self.state.value.checked_div(step).unwrap_or(0);
        self.state.value -= symbol * step;
        self.state.range = step;
        self.renew();
        symbol
    }
}

/// Adaptive frequencies of up to `16 * ROWS` symbols. A symbol is looked for in all rows at once, or, where there are `TOPS`,
/// first among the rows' first entries.
#[derive(Clone, Debug)]
pub struct Model<const ROWS: usize, const TOPS: usize> {
    /// Cumulative frequencies in 2^15, ascending from 0; behind the last symbol the highest number.
    below: [[u16; LANES]; ROWS],
    /// The first entry of each row.
    tops: [[u16; LANES]; TOPS],
    counts: [[u16; LANES]; ROWS],
    last: usize,
    total: u32,
    cycle: u32,
    left: u32,
}

/// Up to 16 symbols.
pub type Model16 = Model<1, 0>;
/// Up to 48 symbols.
pub type Model48 = Model<3, 0>;
/// Up to 64 symbols.
pub type Model64 = Model<4, 0>;
/// Up to 128 symbols.
pub type Model128 = Model<8, 1>;
/// Up to 256 symbols.
pub type Model256 = Model<16, 1>;
/// Up to 528 symbols.
pub type Model528 = Model<33, 3>;

impl<const ROWS: usize, const TOPS: usize> Model<ROWS, TOPS> {
    /// Of so many symbols, all equally frequent.
    pub fn new(symbols: usize) -> Self {
        let mut model = Self {
            below: [[u16::MAX; LANES]; ROWS],
            tops: [[u16::MAX; LANES]; TOPS],
            counts: [[1; LANES]; ROWS],
            last: symbols - 1,
            total: 0,
            cycle: symbols as u32,
            left: 0,
        };
        model.update();
        model.cycle = (symbols as u32 + 6) >> 1;
        model.left = model.cycle;
        model
    }

    /// The last symbol whose cumulative frequency is not above `target`.
    #[inline(always)]
    fn find(&self, target: u16) -> usize {
        // The first entry is 0, so one at least is not above.
        if TOPS == 0 {
            return not_above(&self.below, target) - 1;
        }
        let row = not_above(&self.tops, target) - 1;
        let entries = self.below.get(row).map_or(0, |entries| not_above(&[*entries], target));
        row * LANES + entries - 1
    }

    #[inline(always)]
    fn count(&mut self, symbol: usize) {
        self.counts.as_flattened_mut()[symbol] += 1;
        self.left -= 1;
        if self.left == 0 {
            self.update();
        }
    }

    #[cold]
    #[inline(never)]
    fn update(&mut self) {
        let symbols = self.last + 1;
        let counts = &mut self.counts.as_flattened_mut()[..symbols];
        self.total += self.cycle;
        if self.total > 1 << FREQUENCY_BITS {
            self.total = 0;
            for count in &mut *counts {
                *count = (*count + 1) >> 1;
                self.total += u32::from(*count);
            }
        }
        let scale = (1 << 31) / self.total;
        let mut sum = 0;
        for (below, count) in self.below.as_flattened_mut().iter_mut().zip(counts) {
            *below = ((scale * sum) >> (31 - FREQUENCY_BITS)) as u16;
            sum += u32::from(*count);
        }
        for (top, row) in self.tops.as_flattened_mut().iter_mut().zip(&self.below) {
            *top = row[0];
        }
        self.cycle = ((5 * self.cycle) >> 2).min((symbols as u32 + 6) << 3);
        self.left = self.cycle;
    }
}

/// How many entries are not above `target`.
#[inline(always)]
fn not_above<const ROWS: usize>(rows: &[[u16; LANES]; ROWS], target: u16) -> usize {
    let count =
        |row: &[u16; LANES]| u16x16::new(*row).simd_le(u16x16::splat(target)).to_bitmask().count_ones() as usize;
    rows.iter().map(count).sum()
}

/// The adaptive frequency of a bit.
#[derive(Clone, Debug)]
pub struct BitModel {
    zeros: u32,
    bits: u32,
    /// Probability of 0 in 2^13.
    zero: u32,
    cycle: u32,
    left: u32,
}

impl Default for BitModel {
    fn default() -> Self {
        Self { zeros: 1, bits: 2, zero: 1 << (BIT_BITS - 1), cycle: 4, left: 4 }
    }
}

impl BitModel {
    fn count(&mut self, bit: bool) {
        self.zeros += u32::from(!bit);
        self.left -= 1;
        if self.left == 0 {
            self.update();
        }
    }

    fn update(&mut self) {
        self.bits += self.cycle;
        if self.bits > 1 << BIT_BITS {
            self.bits = (self.bits + 1) >> 1;
            self.zeros = (self.zeros + 1) >> 1;
            if self.zeros == self.bits {
                self.bits += 1;
            }
        }
        let scale = (1 << 31) / self.bits;
        self.zero = (self.zeros * scale) >> (31 - BIT_BITS);
        self.cycle = ((5 * self.cycle) >> 2).min(64);
        self.left = self.cycle;
    }
}

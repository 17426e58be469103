//! Blocks of positions in cubes above exponent 21, whose keys have up to 144 bits.
//!
//! Few points are in such cubes, so this is made to be small rather than fast. A difference has the number of its bits
//! as symbol, and the bits after the leading one as they are.

use super::bits::{BitWriter, PADDING, wide_bits_at};
use super::position::key_bytes;
use super::reader::Reader;
use super::scratch::Buffers;
use super::stream::StreamWriter;
use super::{CodecError, Decoder};
use crate::lattice::{Cube, Key, LatticeBox, SortKey};

/// Digits of [`Key::low`] hold this many bits.
const LOW_BITS: u32 = 63;
const LOW_MASK: u64 = (1 << LOW_BITS) - 1;

/// `a - b`, for `a >= b`.
fn difference(a: Key, b: Key) -> Key {
    let borrow = u128::from(a.low < b.low);
    Key { high: a.high - b.high - borrow, low: a.low.wrapping_sub(b.low) & LOW_MASK }
}

/// `a + b`, if the sum has at most 144 bits.
fn sum(a: Key, b: Key) -> Key {
    // Two numbers of 63 bits.
    let low = a.low + b.low;
    Key { high: a.high + b.high + u128::from(low >> LOW_BITS), low: low & LOW_MASK }
}

/// How many bits `key` has, as a number.
fn bit_length(key: Key) -> u32 {
    if key.high != 0 { LOW_BITS + 128 - key.high.leading_zeros() } else { 64 - key.low.leading_zeros() }
}

/// Appends the low `bits` bits of `key`.
fn put_key(writer: &mut BitWriter, key: Key, bits: u32) {
    let cut = |value: u64, bits: u32| if bits >= 64 { value } else { value & ((1 << bits) - 1) };
    writer.put_wide(cut(key.low, bits.min(LOW_BITS)), bits.min(LOW_BITS));
    let high = bits.saturating_sub(LOW_BITS);
    writer.put_wide(cut(key.high as u64, high.min(64)), high.min(64));
    let top = high.saturating_sub(64);
    writer.put_wide(cut((key.high >> 64) as u64, top), top);
}

/// The reverse of [`put_key`], for bits at bit `at`.
fn key_at(bytes: &[u8], at: usize, bits: u32) -> Key {
    let low = wide_bits_at(bytes, at, bits.min(LOW_BITS));
    let high = bits.saturating_sub(LOW_BITS);
    let at = at + LOW_BITS.min(bits) as usize;
    let middle = if high == 0 { 0 } else { wide_bits_at(bytes, at, high.min(64)) };
    let top = high.saturating_sub(64);
    let top = if top == 0 { 0 } else { wide_bits_at(bytes, at + 64, top) };
    Key { high: u128::from(top) << 64 | u128::from(middle), low }
}

/// Key bit `i` of a number of so many bits, the leading one set.
fn leading_one(bits: u32) -> Key {
    match bits.checked_sub(1) {
        None => Key::default(),
        Some(bit) if bit < LOW_BITS => Key { high: 0, low: 1 << bit },
        Some(bit) => Key { high: 1 << (bit - LOW_BITS), low: 0 },
    }
}

/// Encodes a block; an error is the index of the key that is wrong.
pub(super) fn put_block<K: SortKey>(
    streams: &mut StreamWriter,
    cube: Cube,
    keys: &[K],
    buffers: &mut Buffers,
    out: &mut Vec<u8>,
) -> Result<LatticeBox, usize> {
    let (first, last) = (cube.first_key(), cube.last_key());
    let whole = |key: &K| {
        let (high, low) = key.halves();
        Key { high, low }
    };
    let start = whole(&keys[0]);
    let mut before = start;
    let mut bounds = LatticeBox::of(start.point());
    let symbols = &mut buffers.bytes;
    symbols.clear();
    for (index, key) in keys.iter().map(whole).enumerate() {
        if key < before || !(first..=last).contains(&key) {
            return Err(index);
        }
        if index > 0 {
            symbols.push(bit_length(difference(key, before)) as u8);
            bounds = bounds.with(key.point());
        }
        before = key;
    }
    let mut packed = std::mem::take(&mut streams.tails);
    let mut writer = BitWriter::new(&mut packed, 8 * key_bytes(cube));
    put_key(&mut writer, difference(start, first), 8 * key_bytes(cube) as u32);
    let written = writer.finish();
    out.extend_from_slice(&packed[..written]);
    streams.put(symbols, out);
    let open = symbols.iter().map(|s| usize::from(s.saturating_sub(1))).sum();
    let mut writer = BitWriter::new(&mut packed, open);
    for pair in keys.windows(2) {
        let difference = difference(whole(&pair[1]), whole(&pair[0]));
        put_key(&mut writer, difference, bit_length(difference).saturating_sub(1));
    }
    let written = writer.finish();
    out.extend_from_slice(&packed[..written]);
    streams.tails = packed;
    Ok(bounds)
}

/// Decodes a block of `count >= 1` points and gives its keys one by one. Before an error, some may have been given.
pub(super) fn read_block(
    decoder: &mut Decoder,
    cube: Cube,
    bytes: &[u8],
    count: usize,
    mut push: impl FnMut(Key),
) -> Result<(), CodecError> {
    let mut reader = Reader::new(bytes);
    let bits = &mut decoder.streams.bits;
    bits.clear();
    bits.extend_from_slice(reader.take(key_bytes(cube), "first key of a block")?);
    bits.extend([0; 3 * PADDING]);
    let last = cube.last_key();
    let limit = difference(last, cube.first_key());
    let mut key = key_at(bits, 0, 8 * key_bytes(cube) as u32);
    if key > limit {
        return Err(CodecError::Key { index: 0 });
    }
    key = sum(cube.first_key(), key);
    push(key);

    decoder.streams.read(&mut reader, count - 1, &mut decoder.bytes)?;
    let symbols = &decoder.bytes;
    let most = bit_length(limit);
    if let Some(found) = symbols.iter().find(|s| u32::from(**s) > most) {
        let (found, limit) = (u64::from(*found), u64::from(most));
        return Err(CodecError::Range { place: "bits of a difference", found, limit });
    }
    let bits = &mut decoder.streams.bits;
    let open: usize = symbols.iter().map(|s| usize::from(s.saturating_sub(1))).sum();
    let expected = open.div_ceil(8);
    let found = reader.rest().len();
    if found != expected {
        return Err(CodecError::Length { place: "open bits", expected, found });
    }
    bits.clear();
    bits.extend_from_slice(reader.rest());
    bits.extend([0; 3 * PADDING]);
    let mut at = 0;
    for (index, &symbol) in symbols.iter().enumerate() {
        let tail = symbol.saturating_sub(1);
        let difference = sum(leading_one(u32::from(symbol)), key_at(bits, at, u32::from(tail)));
        at += usize::from(tail);
        key = sum(key, difference);
        if key > last {
            return Err(CodecError::Key { index: index + 1 });
        }
        push(key);
    }
    Ok(())
}

//! Blocks of few different values: a table of them, ascending, and an index for each point.
//!
//! `values - 1 u8`, the first value as a varint and the others as varints of the distance from the one before; then
//! *indices*: how they are stored as a byte, and a stream of indices of 1, 2 or 4 bits, packed lowest first, or coded
//! symbols. A point is mostly of the class of the one before; how many returns a pulse has hangs on which of them it is.

use super::CodecError;
use super::reader::{Reader, put_varint};
use super::stream::{StreamReader, StreamWriter};
use super::symbols::{FEW_SYMBOLS, run_of};
use super::value::Value;

/// How indices are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    /// A stream, several to a byte.
    Packed,
    /// Coded, each in the context of the one before.
    Before,
    /// Coded, each in the context of the one before and of what the column that is followed has at the point.
    Both,
}

impl Way {
    const ALL: [Self; 3] = [Self::Packed, Self::Before, Self::Both];
}

/// One more than the greatest number of a column that is followed, if they are few enough for contexts.
fn sides(followed: &[u16]) -> Option<usize> {
    let sides = followed.iter().fold(0, |most, n| most.max(*n)) as usize + 1;
    (sides <= FEW_SYMBOLS).then_some(sides)
}

/// The context of each index, below `values`.
fn fill_contexts(indices: &[u8], values: usize, followed: Option<&[u16]>, contexts: &mut Vec<u8>) {
    contexts.clear();
    for run in indices.chunks(run_of(indices.len())) {
        contexts.push(0);
        contexts.extend_from_slice(&run[..run.len() - 1]);
    }
    if let Some(followed) = followed {
        contexts.iter_mut().zip(followed).for_each(|(context, side)| *context += *side as u8 * values as u8);
    }
}

/// The most values of a table.
pub(super) const MAX_VALUES: usize = 16;

/// The different values of a block, ascending.
pub(super) type Table = Vec<u64>;

fn index_bits(values: usize) -> u32 {
    match values {
        0..=2 => 1,
        3..=4 => 2,
        5..=MAX_VALUES => 4,
        _ => 8,
    }
}

/// The same as [`build`] for values of a byte.
pub(super) fn build_bytes(values: &[u8], indices: &mut Vec<u8>) -> Option<Table> {
    // Two maps, since a store that waits for the one before it is slow. Flags, not bits: the place is all there is to find.
    let mut there = [[0_u8; 256]; 2];
    let (first, rest) = values.split_at(values.len().min(256));
    for values in [first, rest] {
        let (pairs, last) = values.as_chunks::<2>();
        for pair in pairs {
            there.iter_mut().zip(pair).for_each(|(there, value)| there[usize::from(*value)] = 1);
        }
        last.iter().for_each(|value| there[0][usize::from(*value)] = 1);
        // Most have too many soon.
        if there[0].iter().zip(&there[1]).map(|(a, b)| usize::from(a | b)).sum::<usize>() > MAX_VALUES {
            return None;
        }
    }
    let mut rank = [0; 256];
    let mut table = Vec::with_capacity(MAX_VALUES);
    for value in 0..256 {
        if there[0][value] | there[1][value] != 0 {
            if table.len() == MAX_VALUES {
                return None;
            }
            rank[value] = table.len() as u8;
            table.push(value as u64);
        }
    }
    indices.clear();
    indices.extend(values.iter().map(|v| rank[usize::from(*v)]));
    Some(table)
}

/// Finds the different values and the index of each; `None` if there are more than [`MAX_VALUES`].
pub(super) fn build(values: &[u64], indices: &mut Vec<u8>) -> Option<Table> {
    indices.clear();
    let mut table = Vec::with_capacity(MAX_VALUES);
    let mut before = None;
    for &value in values {
        if before != Some(value) && !table.contains(&value) {
            if table.len() == MAX_VALUES {
                return None;
            }
            table.push(value);
        }
        before = Some(value);
    }
    table.sort_unstable();
    // How many are smaller: the compiler compares several values at a time.
    indices.resize(values.len(), 0);
    for limit in &table[1..] {
        indices.iter_mut().zip(values).for_each(|(index, value)| *index += u8::from(value >= limit));
    }
    Some(table)
}

/// Appends the table and the indices, which may be packed in place. `followed` is what the column that this one follows
/// has at each point.
pub(super) fn put(
    streams: &mut StreamWriter,
    table: &[u64],
    indices: &mut Vec<u8>,
    followed: Option<&[u16]>,
    out: &mut Vec<u8>,
) {
    out.push((table.len() - 1) as u8);
    let mut before = 0;
    for &value in table {
        put_varint(value - before, out);
        before = value;
    }
    put_indices(streams, table.len(), indices, followed, out);
}

/// Appends indices below `values`, which may be packed in place.
pub(super) fn put_indices(
    streams: &mut StreamWriter,
    values: usize,
    indices: &mut Vec<u8>,
    followed: Option<&[u16]>,
    out: &mut Vec<u8>,
) {
    let bits = index_bits(values);
    let per_byte = (8 / bits) as usize;
    if values <= FEW_SYMBOLS {
        let mut contexts = std::mem::take(&mut streams.tails);
        fill_contexts(indices, values, None, &mut contexts);
        let mut best = streams.coder.count_in(indices, &contexts, values, values);
        let mut way = Way::Before;
        // What has one value tells nothing.
        let followed = followed.and_then(|followed| sides(followed).map(|sides| (followed, sides)));
        if let Some((followed, sides)) = followed.filter(|(followed, _)| followed.iter().any(|n| *n != followed[0])) {
            fill_contexts(indices, values, Some(followed), &mut contexts);
            let both = streams.coder.count_in(indices, &contexts, values, values * sides);
            if both < best {
                (best, way) = (both, Way::Both);
            } else {
                fill_contexts(indices, values, None, &mut contexts);
                streams.coder.count_in(indices, &contexts, values, values);
            }
        }
        if best < indices.len().div_ceil(per_byte) {
            out.push(way as u8);
            streams.coder.put_in(indices, &contexts, out);
            streams.tails = contexts;
            return;
        }
        streams.tails = contexts;
    }
    out.push(Way::Packed as u8);
    if per_byte > 1 {
        let packed = indices.len().div_ceil(per_byte);
        indices.resize(packed * per_byte, 0);
        match bits {
            1 => pack::<8>(indices),
            2 => pack::<4>(indices),
            _ => pack::<2>(indices),
        }
        indices.truncate(packed);
    }
    streams.put(indices, out);
}

/// The reverse of [`put_indices`]: reads `count` indices below `values` into `out`, whose content is replaced.
pub(super) fn read_indices(
    streams: &mut StreamReader,
    mut reader: Reader,
    values: usize,
    count: usize,
    followed: Option<&[u16]>,
    out: &mut Vec<u8>,
) -> Result<(), CodecError> {
    const WAY: &str = "way of indices";
    let code = reader.u8(WAY)?;
    let error = CodecError::Range { place: WAY, found: u64::from(code), limit: Way::ALL.len() as u64 - 1 };
    let way = *Way::ALL.get(usize::from(code)).ok_or(error)?;
    if way != Way::Packed && values > FEW_SYMBOLS {
        return Err(CodecError::Range { place: "symbols", found: values as u64, limit: FEW_SYMBOLS as u64 });
    }
    match way {
        Way::Packed => read_packed(streams, reader, index_bits(values), count, out)?,
        Way::Before => streams.coder.read_in(reader.rest(), count, values, |before, _| usize::from(before), out)?,
        Way::Both => {
            let followed = followed.filter(|f| f.len() == count).ok_or(CodecError::NoLeader)?;
            let (found, limit) = (FEW_SYMBOLS as u64, FEW_SYMBOLS as u64 - 1);
            let error = CodecError::Range { place: "number that is followed", found, limit };
            let sides = sides(followed).ok_or(error)?;
            let context = |before, i: usize| usize::from(followed[i]) * values + usize::from(before);
            streams.coder.read_in(reader.rest(), count, values * sides, context, out)?;
        }
    }
    let largest = out.iter().copied().max().unwrap_or(0);
    if usize::from(largest) >= values {
        return Err(outside(largest, values));
    }
    out.truncate(count);
    Ok(())
}

/// Reads indices of so many bits, and those that fill the last byte.
fn read_packed(
    streams: &mut StreamReader,
    mut reader: Reader,
    bits: u32,
    count: usize,
    out: &mut Vec<u8>,
) -> Result<(), CodecError> {
    let per_byte = (8 / bits) as usize;
    let mut packed = std::mem::take(&mut streams.symbols);
    let result = streams.read(&mut reader, count.div_ceil(per_byte), &mut packed);
    out.clear();
    out.resize(packed.len() * per_byte, 0);
    match bits {
        1 => unpack::<8>(&packed, out),
        2 => unpack::<4>(&packed, out),
        4 => unpack::<2>(&packed, out),
        _ => out.copy_from_slice(&packed),
    }
    streams.symbols = packed;
    result?;
    reader.end("bytes after the indices")
}

fn outside(index: u8, values: usize) -> CodecError {
    CodecError::Range { place: "index of a value", found: u64::from(index), limit: values as u64 - 1 }
}

/// Packs `N` indices into each byte, from the first on.
fn pack<const N: usize>(indices: &mut [u8]) {
    for byte in 0..indices.len() / N {
        let group = &indices[byte * N..(byte + 1) * N];
        indices[byte] = group.iter().rev().fold(0, |b, i| b << (8 / N) | i);
    }
}

/// The reverse of [`pack`].
fn unpack<const N: usize>(packed: &[u8], indices: &mut [u8]) {
    for (group, byte) in indices.chunks_exact_mut(N).zip(packed) {
        for (place, index) in group.iter_mut().enumerate() {
            *index = byte >> (place * 8 / N) & u8::MAX >> (8 - 8 / N);
        }
    }
}

/// Reads a table, and `count` indices into it, up to the end of the block, into `indices`, whose content is replaced. Where
/// no index leads the table is 0; how many it has comes with it.
pub(super) fn read(
    streams: &mut StreamReader,
    mut reader: Reader,
    count: usize,
    followed: Option<&[u16]>,
    indices: &mut Vec<u8>,
) -> Result<([u64; MAX_VALUES], usize), CodecError> {
    const TABLE: &str = "table of values";
    let len = usize::from(reader.u8(TABLE)?) + 1;
    if !(1..=MAX_VALUES).contains(&len) {
        return Err(CodecError::Range { place: TABLE, found: len as u64, limit: MAX_VALUES as u64 });
    }
    let mut table = [0_u64; MAX_VALUES];
    let mut before = 0_u64;
    for value in &mut table[..len] {
        let distance = reader.varint(TABLE)?;
        let error = CodecError::Range { place: TABLE, found: distance, limit: u64::MAX - before };
        before = before.checked_add(distance).ok_or(error)?;
        *value = before;
    }
    read_indices(streams, reader, len, count, followed, indices)?;
    Ok((table, len))
}

/// Appends the value of each index below `len`.
pub(super) fn append_values<T: Value>(table: &[T; MAX_VALUES], len: usize, indices: &[u8], out: &mut Vec<T>) {
    let one_by_one = |indices: &[u8], out: &mut Vec<T>| {
        out.extend(indices.iter().map(|index| table[usize::from(*index) % MAX_VALUES]));
    };
    if len * size_of::<T>() > QUICK_BYTES {
        return one_by_one(indices, out);
    }
    // If values are few, one of them after the other for many points at a time is quicker than point after point.
    let (many, rest) = indices.as_chunks::<AT_ONCE>();
    out.reserve(indices.len());
    for indices in many {
        let mut values = [table[0]; AT_ONCE];
        for (index, value) in (1..).zip(table[1..len].iter().copied()) {
            for (out, i) in values.iter_mut().zip(indices) {
                *out = if *i == index { value } else { *out };
            }
        }
        out.extend_from_slice(&values);
    }
    one_by_one(rest, out);
}

/// Bytes of a table of few values.
const QUICK_BYTES: usize = 8;

/// Points that are looked up at a time.
const AT_ONCE: usize = 32;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn few_values_come_back(
            table in prop_oneof![
                prop::collection::vec(any::<u64>(), 1..20),
                prop::collection::vec(0_u64..64, 1..20),
            ],
            picks in prop::collection::vec(any::<prop::sample::Index>(), 1..600),
            few in 1_usize..20,
            sides in 1_u16..20,
        ) {
            let table = &table[..few.min(table.len())];
            let values: Vec<_> = picks.iter().map(|i| *i.get(table)).collect();
            let mut distinct = values.clone();
            distinct.sort_unstable();
            distinct.dedup();
            let mut indices = Vec::new();
            let Some(found) = build(&values, &mut indices) else {
                prop_assert!(distinct.len() > MAX_VALUES);
                return Ok(());
            };
            prop_assert_eq!(&found, &distinct);
            if distinct.iter().all(|v| *v < 256) {
                let narrow: Vec<_> = values.iter().map(|v| *v as u8).collect();
                let mut same = Vec::new();
                prop_assert_eq!(build_bytes(&narrow, &mut same), Some(found.clone()));
                prop_assert_eq!(&same, &indices);
            }
            // Another column that tells much, and one that tells nothing.
            for noise in [0, 7] {
                let followed: Vec<_> = indices.iter().zip(0..).map(|(v, i)| (u16::from(*v) + noise * i) % sides).collect();
                let (mut bytes, mut same) = (Vec::new(), indices.clone());
                put(&mut StreamWriter::default(), &found, &mut same, Some(&followed), &mut bytes);
                let (mut streams, mut back) = (StreamReader::default(), Vec::new());
                let mut read = |followed: Option<&[u16]>| {
                    let (table, len) = read(&mut streams, Reader::new(&bytes), values.len(), followed, &mut back)?;
                    let mut values = vec![7];
                    append_values(&table, len, &back, &mut values);
                    Ok::<Vec<u64>, CodecError>(values.split_off(1))
                };
                prop_assert_eq!(&read(Some(&followed)).unwrap(), &values);
                for followed in [None, Some(&followed[1..])] {
                    if let Err(error) = read(followed) {
                        prop_assert_eq!(error, CodecError::NoLeader);
                    }
                }
            }
            let mut bytes = Vec::new();
            put(&mut StreamWriter::default(), &found, &mut indices, None, &mut bytes);
            let read = read(&mut StreamReader::default(), Reader::new(&bytes), values.len(), None, &mut indices);
            let (table, len) = read.unwrap();
            prop_assert_eq!(indices.iter().map(|i| table[usize::from(*i)]).collect::<Vec<_>>(), values.clone());
            // Values of a byte, of which more are few.
            let (mut narrow, bytes) = (Vec::new(), table.map(|n| n as u8));
            append_values(&bytes, len, &indices, &mut narrow);
            prop_assert_eq!(narrow, values.iter().map(|n| *n as u8).collect::<Vec<_>>());
        }
    }

    #[test]
    fn symbols_that_are_no_index_are_errors() {
        // Contexts of two values, of which only the first occurs, with a weight for the third symbol alone: bits 1, 0, 0, 100 00, 0.
        let states = [0x8000_u32; 4].map(u32::to_le_bytes).concat();
        let bytes = [&[Way::Before as u8, 2, 0b1001, 0], &states[..]].concat();
        let result = read_indices(&mut StreamReader::default(), Reader::new(&bytes), 2, 4, None, &mut vec![]);
        assert_eq!(result, Err(outside(2, 2)));
    }
}

//! Blocks of few different values: a table of them, ascending, and an index for each point.
//!
//! `values - 1 u8`, the first value as a varint and the others as varints of the distance from the one before; then a
//! stream of indices of 1, 2 or 4 bits, packed lowest first. Several points in one symbol are worth less than a bit each
//! where one value prevails, which single symbols are not.

use super::CodecError;
use super::reader::{Reader, put_varint};
use super::stream::{StreamReader, StreamWriter};

/// The most values of a table.
const MAX_VALUES: usize = 16;

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
    for pair in values.chunks(2) {
        there.iter_mut().zip(pair).for_each(|(there, value)| there[usize::from(*value)] = 1);
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

/// Appends the table and the indices, which are packed in place.
pub(super) fn put(streams: &mut StreamWriter, table: &[u64], indices: &mut Vec<u8>, out: &mut Vec<u8>) {
    out.push((table.len() - 1) as u8);
    let mut before = 0;
    for &value in table {
        put_varint(value - before, out);
        before = value;
    }
    put_indices(streams, table.len(), indices, out);
}

/// Appends the stream of indices below `values`, which are packed in place.
pub(super) fn put_indices(streams: &mut StreamWriter, values: usize, indices: &mut Vec<u8>, out: &mut Vec<u8>) {
    let bits = index_bits(values);
    let per_byte = (8 / bits) as usize;
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

/// The reverse of [`put_indices`], for `count` indices: gives `each` of them, in order, and what fills the last byte;
/// `packed` is for its use.
pub(super) fn read_indices(
    streams: &mut StreamReader,
    mut reader: Reader,
    values: usize,
    count: usize,
    packed: &mut Vec<u8>,
    mut each: impl FnMut(u8),
) -> Result<(), CodecError> {
    let bits = index_bits(values);
    let per_byte = (8 / bits) as usize;
    streams.read(&mut reader, count.div_ceil(per_byte), packed)?;
    reader.end("bytes after the indices")?;
    let mask = u8::MAX >> (8 - bits);
    let mut largest = 0;
    for byte in packed.iter() {
        for place in 0..per_byte {
            let index = byte >> (place as u32 * bits) & mask;
            largest = largest.max(index);
            each(index);
        }
    }
    if usize::from(largest) >= values {
        let limit = values as u64 - 1;
        return Err(CodecError::Range { place: "index of a value", found: u64::from(largest), limit });
    }
    Ok(())
}

/// Packs `N` indices into each byte, from the first on.
fn pack<const N: usize>(indices: &mut [u8]) {
    for byte in 0..indices.len() / N {
        let group = &indices[byte * N..(byte + 1) * N];
        indices[byte] = group.iter().rev().fold(0, |b, i| b << (8 / N) | i);
    }
}

/// Reads `count` values, up to the end of the block, into `out`, whose content is replaced.
pub(super) fn read(
    streams: &mut StreamReader,
    mut reader: Reader,
    indices: &mut Vec<u8>,
    count: usize,
    out: &mut Vec<u64>,
) -> Result<(), CodecError> {
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
    out.clear();
    // A table has at most 16 values, and their indices at most 4 bits.
    read_indices(streams, reader, len, count, indices, |index| out.push(table[usize::from(index)]))?;
    out.truncate(count);
    Ok(())
}

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
            let mut bytes = Vec::new();
            put(&mut StreamWriter::default(), &found, &mut indices, &mut bytes);
            let mut back = Vec::new();
            read(&mut StreamReader::default(), Reader::new(&bytes), &mut indices, values.len(), &mut back).unwrap();
            prop_assert_eq!(back, values);
        }
    }
}

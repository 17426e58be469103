//! Blocks of few different values: a table of them, ascending, and an index for each point.
//!
//! `values - 1 u8`, the first value as a varint and the others as varints of the distance from the one before; then a
//! stream of indices of 1, 2, 4 or 8 bits, packed lowest first. Several points in one symbol are worth less than a bit
//! each where one value prevails, which single symbols are not.

use super::CodecError;
use super::reader::{Reader, put_varint, varint_bytes};
use super::residual::entropy_bits;
use super::stream::{StreamReader, StreamWriter};

/// The most values of a table.
const MAX_VALUES: usize = 256;

/// Slots of the hash table, four times [`MAX_VALUES`].
const SLOTS: usize = 4 * MAX_VALUES;

/// The different values of a block.
#[derive(Clone, Debug)]
pub(super) struct Table {
    /// Ascending.
    values: Vec<u64>,
    /// Points with each of them.
    counts: Vec<u32>,
}

impl Table {
    /// Bits of an index.
    fn index_bits(&self) -> u32 {
        index_bits(self.values.len())
    }

    /// An estimate of the whole.
    pub(super) fn cost_bits(&self) -> f32 {
        let entropy = entropy_bits(self.counts.iter().copied());
        let packed: u32 = self.counts.iter().sum::<u32>() * self.index_bits();
        let distances = self.values.iter().scan(0, |before, v| Some(v - std::mem::replace(before, *v)));
        let table: usize = distances.map(varint_bytes).sum();
        entropy.min(packed as f32) + (8 * table) as f32
    }
}

fn index_bits(values: usize) -> u32 {
    match values {
        0..=2 => 1,
        3..=4 => 2,
        5..=16 => 4,
        _ => 8,
    }
}

/// Finds the different values and the index of each; `None` if there are more than [`MAX_VALUES`].
pub(super) fn build(values: &[u64], indices: &mut Vec<u8>) -> Option<Table> {
    let mut slots = [u16::MAX; SLOTS];
    let mut found: Vec<(u64, u32)> = Vec::with_capacity(MAX_VALUES);
    indices.clear();
    for &value in values {
        let mut slot = (value.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 54) as usize;
        let index = loop {
            if let Some((there, count)) = found.get_mut(usize::from(slots[slot])) {
                if *there == value {
                    *count += 1;
                    break slots[slot];
                }
                slot = (slot + 1) % SLOTS;
            } else if found.len() < MAX_VALUES {
                slots[slot] = found.len() as u16;
                found.push((value, 1));
                break slots[slot];
            } else {
                return None;
            }
        };
        indices.push(index as u8);
    }
    let mut order: Vec<u16> = (0..found.len() as u16).collect();
    order.sort_unstable_by_key(|i| found[usize::from(*i)].0);
    let mut rank = [0_u8; MAX_VALUES];
    order.iter().enumerate().for_each(|(r, i)| rank[usize::from(*i)] = r as u8);
    indices.iter_mut().for_each(|i| *i = rank[usize::from(*i)]);
    let (values, counts) = order.iter().map(|i| found[usize::from(*i)]).unzip();
    Some(Table { values, counts })
}

/// Appends the table and the indices, which are packed in place.
pub(super) fn put(streams: &mut StreamWriter, table: &Table, indices: &mut Vec<u8>, out: &mut Vec<u8>) {
    out.push((table.values.len() - 1) as u8);
    let mut before = 0;
    for &value in &table.values {
        put_varint(value - before, out);
        before = value;
    }
    let bits = table.index_bits();
    let per_byte = (8 / bits) as usize;
    if per_byte > 1 {
        let packed = indices.len().div_ceil(per_byte);
        for byte in 0..packed {
            let end = indices.len().min((byte + 1) * per_byte);
            indices[byte] = indices[byte * per_byte..end].iter().rev().fold(0, |b, i| b << bits | i);
        }
        indices.truncate(packed);
    }
    streams.put(indices, out);
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
    let mut table = [0_u64; MAX_VALUES];
    let mut before = 0_u64;
    for value in &mut table[..len] {
        let distance = reader.varint(TABLE)?;
        let error = CodecError::Range { place: TABLE, found: distance, limit: u64::MAX - before };
        before = before.checked_add(distance).ok_or(error)?;
        *value = before;
    }
    let bits = index_bits(len);
    let per_byte = (8 / bits) as usize;
    streams.read(&mut reader, count.div_ceil(per_byte), indices)?;
    reader.end("bytes after the indices")?;
    let mask = (u16::MAX >> (16 - bits)) as u8;
    out.clear();
    let mut largest = 0;
    match bits {
        8 => out.extend(indices.iter().map(|i| {
            largest = largest.max(*i);
            table[usize::from(*i)]
        })),
        _ => {
            for byte in indices.iter() {
                for place in 0..per_byte {
                    let index = byte >> (place as u32 * bits) & mask;
                    largest = largest.max(index);
                    out.push(table[usize::from(index)]);
                }
            }
            out.truncate(count);
        }
    }
    if usize::from(largest) >= len {
        return Err(CodecError::Range { place: "index of a value", found: u64::from(largest), limit: len as u64 - 1 });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn few_values_come_back(
            table in prop::collection::vec(any::<u64>(), 1..300),
            picks in prop::collection::vec(any::<prop::sample::Index>(), 1..600),
            few in 1_usize..300,
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
            prop_assert_eq!(&found.values, &distinct);
            let mut bytes = Vec::new();
            put(&mut StreamWriter::default(), &found, &mut indices, &mut bytes);
            let mut back = Vec::new();
            read(&mut StreamReader::default(), Reader::new(&bytes), &mut indices, values.len(), &mut back).unwrap();
            prop_assert_eq!(back, values);
        }
    }
}

//! Blocks whose values are worth less than their order: all different values, ascending, and the rank of each point's.
//!
//! Times of flight come in key order, where neighbours are of other scan lines and other flights, so a difference takes
//! nearly as many bits as the value. Sorted, the differences are small, pulses with several returns fall together, and a
//! rank takes at most 12 bits.
//!
//! `values varint`, `table length varint`, the table's differences as residuals, and the ranks as numbers.

use super::numbers::{self, Numbers};
use super::reader::{Reader, put_varint};
use super::residual::{plan, put_residuals, read_residuals};
use super::scratch::{Buffers, Decoder};
use super::stream::StreamWriter;
use super::{BLOCK_POINTS, CodecError};

/// Bits of an index into a block.
const INDEX_BITS: u32 = BLOCK_POINTS.ilog2();

/// Bits that one pass of sorting orders by.
const DIGIT_BITS: u32 = 11;

/// Values below this are ranked by a bitmap, which costs less than sorting.
const BITMAP_BITS: usize = 1 << 16;

/// Finds the table's differences and the ranks of `values`; `false` if values are too large.
fn rank(values: &[u64], buffers: &mut RankBuffers) -> bool {
    let all = values.iter().fold(0, |all, v| all | v);
    if all >> (u64::BITS - INDEX_BITS) != 0 {
        return false;
    }
    buffers.table.clear();
    buffers.ranks.clear();
    if all < BITMAP_BITS as u64 {
        rank_by_bitmap(values, buffers)
    } else {
        rank_by_sorting(values, all, buffers)
    }
    true
}

fn rank_by_bitmap(values: &[u64], buffers: &mut RankBuffers) {
    let RankBuffers { table, ranks, bitmap, .. } = buffers;
    // A word of the map, and how many values are before it.
    bitmap.clear();
    bitmap.resize(BITMAP_BITS / 64, (0, 0));
    values.iter().for_each(|v| bitmap[(v >> 6) as usize].0 |= 1 << (v & 63));
    let mut before = 0;
    for (index, (word, less)) in bitmap.iter_mut().enumerate() {
        *less = table.len() as u64;
        let mut rest = *word;
        while rest != 0 {
            let value = (index * 64) as u64 + u64::from(rest.trailing_zeros());
            table.push(value - before);
            before = value;
            rest &= rest - 1;
        }
    }
    ranks.extend(values.iter().map(|v| {
        let (word, less) = bitmap[(v >> 6) as usize];
        less + u64::from((word & ((1 << (v & 63)) - 1)).count_ones())
    }));
}

fn rank_by_sorting(values: &[u64], all: u64, buffers: &mut RankBuffers) {
    let RankBuffers { table, ranks, sorted, other, .. } = buffers;
    sorted.clear();
    sorted.extend(values.iter().zip(0_u64..).map(|(v, i)| v << INDEX_BITS | i));
    other.resize(sorted.len(), 0);
    // Lowest digit first; each pass keeps the order of the one before.
    for shift in (INDEX_BITS..u64::BITS - all.leading_zeros() + INDEX_BITS).step_by(DIGIT_BITS as usize) {
        let digit = |entry: u64| (entry >> shift) as usize & ((1 << DIGIT_BITS) - 1);
        let mut places = [0_u32; 1 << DIGIT_BITS];
        sorted.iter().for_each(|entry| places[digit(*entry)] += 1);
        let mut sum = 0;
        places.iter_mut().for_each(|place| sum += std::mem::replace(place, sum));
        for &entry in sorted.iter() {
            let place = &mut places[digit(entry)];
            other[*place as usize] = entry;
            *place += 1;
        }
        std::mem::swap(sorted, other);
    }
    ranks.resize(values.len(), 0);
    let mut before = None;
    for &entry in sorted.iter() {
        let value = entry >> INDEX_BITS;
        if before != Some(value) {
            table.push(value - before.unwrap_or(0));
            before = Some(value);
        }
        ranks[(entry & ((1 << INDEX_BITS) - 1)) as usize] = table.len() as u64 - 1;
    }
}

/// What ranking needs.
#[derive(Debug, Default)]
pub(super) struct RankBuffers {
    /// Differences between all different values.
    table: Vec<u64>,
    /// The rank of each point's value.
    ranks: Vec<u64>,
    /// Values and places.
    sorted: Vec<u64>,
    other: Vec<u64>,
    bitmap: Vec<(u64, u64)>,
    /// The table's bytes, whose length comes first.
    packed: Vec<u8>,
}

/// Appends `buffers.values` after `head` if that is estimated to take less than `limit_bits`, and says if it did.
pub(super) fn try_put(
    streams: &mut StreamWriter,
    buffers: &mut Buffers,
    limit_bits: f32,
    head: impl Fn(&mut Vec<u8>),
    out: &mut Vec<u8>,
) -> bool {
    let Buffers { values, rank: ranking, rank_numbers, .. } = buffers;
    if !rank(values, ranking) {
        return false;
    }
    let RankBuffers { table, ranks, packed, .. } = ranking;
    let table_plan = plan(table);
    let choice = numbers::choose(ranks, rank_numbers);
    if table_plan.cost_bits + choice.cost_bits >= limit_bits {
        return false;
    }
    head(out);
    put_varint(table.len() as u64, out);
    packed.clear();
    put_residuals(streams, table, table_plan.mantissa, packed);
    put_varint(packed.len() as u64, out);
    out.extend_from_slice(packed);
    numbers::put(streams, ranks, rank_numbers, choice, out);
    true
}

/// Reads `count` values, up to the end of the block, into `decoder.values`, whose content is replaced.
pub(super) fn read(decoder: &mut Decoder, mut reader: Reader, count: usize) -> Result<(), CodecError> {
    const TABLE: &str = "table of values";
    let Decoder { streams, bytes, values, table, wide } = decoder;
    let found = reader.varint(TABLE)?;
    // A value that no point has would be of no use.
    let len = usize::try_from(found).ok().filter(|len| (1..=count).contains(len));
    let len = len.ok_or(CodecError::Range { place: TABLE, found, limit: count as u64 })?;
    let length = usize::try_from(reader.varint(TABLE)?).unwrap_or(usize::MAX);
    let bits = u64::BITS - INDEX_BITS;
    read_residuals(streams, Reader::new(reader.take(length, TABLE)?), len, bits, table)?;
    // At most 4,096 numbers of 52 bits: no sum overflows.
    let mut sum = 0;
    for value in table.iter_mut() {
        sum += *value;
        *value = sum;
    }
    values.clear();
    match numbers::read(streams, reader, count, len as u64 - 1, bytes, wide)? {
        Numbers::Bytes(ranks) => values.extend(ranks.iter().map(|rank| table[usize::from(*rank)])),
        Numbers::Wide(ranks) => values.extend(ranks.iter().map(|rank| table[*rank as usize])),
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn jumbled_values_come_back(
            values in prop::collection::vec(any::<u64>(), 1..500),
            bits in 1_u32..=52,
            repeat in 1_usize..5,
        ) {
            let values: Vec<_> = (0..values.len()).map(|i| values[i / repeat] >> (64 - bits)).collect();
            let mut buffers = Buffers { values: values.clone(), ..Buffers::default() };
            let (mut bytes, mut writer) = (Vec::new(), StreamWriter::default());
            prop_assert!(try_put(&mut writer, &mut buffers, f32::INFINITY, |_| (), &mut bytes));
            let mut decoder = Decoder::new();
            read(&mut decoder, Reader::new(&bytes), values.len()).unwrap();
            prop_assert_eq!(&decoder.values, &values);
            let mut distinct = values.clone();
            distinct.sort_unstable();
            distinct.dedup();
            prop_assert_eq!(&decoder.table, &distinct);
            prop_assert!(!try_put(&mut writer, &mut buffers, 0.0, |_| (), &mut bytes));
        }
    }
}

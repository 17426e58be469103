//! Blocks whose values are worth less than their order: all different values, ascending, and the rank of each point's.
//!
//! Times of flight come in key order, where neighbours are of other scan lines and other flights, so a difference takes
//! nearly as many bits as the value. Sorted, the differences are small, pulses with several returns fall together, and a
//! rank takes at most 12 bits.
//!
//! `values varint`, `table length varint`, the table's differences as residuals, and the ranks as numbers.

use super::numbers::{self, Numbers};
use super::reader::{Reader, put_varint};
use super::residual::{plan_all, put_residuals, read_residuals};
use super::scratch::{Buffers, Decoder};
use super::stream::StreamWriter;
use super::{BLOCK_POINTS, CodecError};

/// Bits of an index into a block.
const INDEX_BITS: u32 = BLOCK_POINTS.ilog2();

/// The most bits that one pass of sorting orders by.
const DIGIT_BITS: u32 = 11;

/// Values below this are ranked by a bitmap, which costs less than sorting.
const BITMAP_BITS: u64 = 1 << 16;

/// A number of at most 52 bits and its place in the block, in the order of the numbers.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Entry(u64);

impl Entry {
    fn new(number: u64, index: u64) -> Self {
        Self(number << INDEX_BITS | index)
    }

    #[inline]
    pub(super) fn number(self) -> i64 {
        (self.0 >> INDEX_BITS) as i64
    }

    #[inline]
    pub(super) fn index(self) -> usize {
        (self.0 & ((1 << INDEX_BITS) - 1)) as usize
    }
}

/// What ranking needs.
#[derive(Debug, Default)]
pub(super) struct RankBuffers {
    /// Differences between all different values.
    table: Vec<u64>,
    /// The rank of each point's value.
    ranks: Vec<u16>,
    /// Values and places, sorted.
    sorted: Vec<Entry>,
    other: Vec<Entry>,
    /// Which values there are.
    bitmap: Vec<u64>,
    /// The ranks of those.
    rank_of: Vec<u16>,
    /// The table's bytes, whose length comes first.
    packed: Vec<u8>,
}

impl RankBuffers {
    /// Finds the table and the rank of each value of it, for values up to `most`, if ranks may be worth it: they save
    /// at most what their share of all values up to `most` is in bits, and the table takes some bits a value.
    fn rank_by_bitmap(&mut self, values: &[u64], most: u64, sure: bool) -> bool {
        let Self { table, bitmap, rank_of, .. } = self;
        bitmap.clear();
        bitmap.resize(most as usize / 64 + 1, 0);
        values.iter().for_each(|v| bitmap[(v >> 6) as usize] |= 1 << (v & 63));
        let distinct: u32 = bitmap.iter().map(|word| word.count_ones()).sum();
        let saved = values.len() as f32 * ((most + 1) as f32 / distinct as f32).log2();
        if !sure && saved < (TABLE_BITS * distinct) as f32 {
            return false;
        }
        table.clear();
        if rank_of.len() <= most as usize {
            rank_of.resize(most as usize + 1, 0);
        }
        let mut before = 0;
        for (index, word) in bitmap.iter().enumerate() {
            let mut rest = *word;
            while rest != 0 {
                let value = (index * 64) as u64 + u64::from(rest.trailing_zeros());
                rank_of[value as usize] = table.len() as u16;
                table.push(value - before);
                before = value;
                rest &= rest - 1;
            }
        }
        true
    }

    /// Sorts values up to `most`, of at most 52 bits.
    pub(super) fn sort(&mut self, values: &[u64], most: u64) {
        let Self { sorted, other, .. } = self;
        let bits = (u64::BITS - most.leading_zeros()).max(1);
        let digit_bits = bits.div_ceil(bits.div_ceil(DIGIT_BITS).max(1));
        let digit = |entry: Entry, shift: u32| (entry.0 >> shift) as usize & ((1 << digit_bits) - 1) & (DIGITS - 1);
        let mut counts = [0_u16; DIGITS];
        sorted.clear();
        sorted.extend(values.iter().zip(0_u64..).map(|(v, i)| {
            let entry = Entry::new(*v, i);
            counts[digit(entry, INDEX_BITS)] += 1;
            entry
        }));
        other.resize(sorted.len(), Entry::default());
        // Lowest digit first; each pass keeps the order of the one before, and counts for the next.
        for shift in (INDEX_BITS..bits + INDEX_BITS).step_by(digit_bits as usize) {
            let mut places = counts;
            let mut sum = 0;
            places[..1 << digit_bits].iter_mut().for_each(|place| sum += std::mem::replace(place, sum));
            counts[..1 << digit_bits].fill(0);
            for &entry in sorted.iter() {
                let place = &mut places[digit(entry, shift)];
                other[usize::from(*place)] = entry;
                *place += 1;
                counts[digit(entry, (shift + digit_bits).min(u64::BITS - 1))] += 1;
            }
            std::mem::swap(sorted, other);
        }
    }

    /// What [`RankBuffers::sort`] sorted.
    pub(super) fn sorted(&self) -> &[Entry] {
        &self.sorted
    }

    /// Finds the table and the rank of each point of what is sorted.
    fn rank_sorted(&mut self) {
        let Self { table, ranks, sorted, .. } = self;
        ranks.clear();
        ranks.resize(sorted.len(), 0);
        table.clear();
        let mut before = None;
        for &entry in sorted.iter() {
            let value = entry.number() as u64;
            if before != Some(value) {
                table.push(value - before.unwrap_or(0));
                before = Some(value);
            }
            ranks[entry.index()] = (table.len() - 1) as u16;
        }
    }
}

/// Do numbers up to `most` fit beside their index?
pub(super) fn is_sortable(most: u64) -> bool {
    most >> (u64::BITS - INDEX_BITS) == 0
}

/// All digits of one pass.
const DIGITS: usize = 1 << DIGIT_BITS;

/// The least that a value of the table costs, in bits.
const TABLE_BITS: u32 = 2;

/// Appends `buffers.values`, the greatest of them `most`, after `head` if that is estimated to take less than
/// `limit_bits`, and says if it did. Those above 16 bits must have been sorted.
pub(super) fn try_put(
    streams: &mut StreamWriter,
    buffers: &mut Buffers,
    most: u64,
    limit_bits: f32,
    head: impl Fn(&mut Vec<u8>),
    out: &mut Vec<u8>,
) -> bool {
    let Buffers { values, rank: ranking, packed: symbols, .. } = buffers;
    let choice;
    if most < BITMAP_BITS {
        if !ranking.rank_by_bitmap(values, most, limit_bits == f32::INFINITY) {
            return false;
        }
        let greatest = ranking.table.len() as u64 - 1;
        let rank_of = &ranking.rank_of;
        choice = numbers::choose(values.len(), greatest, |i| u64::from(rank_of[values[i] as usize]));
    } else if is_sortable(most) {
        ranking.rank_sorted();
        let greatest = ranking.table.len() as u64 - 1;
        choice = numbers::choose(values.len(), greatest, |i| u64::from(ranking.ranks[i]));
    } else {
        return false;
    }
    let RankBuffers { table, ranks, rank_of, packed, .. } = ranking;
    let (table_plan, table_bits) = plan_all(table);
    if table_plan.cost_bits + choice.cost_bits >= limit_bits {
        return false;
    }
    if most < BITMAP_BITS {
        ranks.clear();
        ranks.extend(values.iter().map(|v| rank_of[*v as usize]));
    }
    head(out);
    put_varint(table.len() as u64, out);
    packed.clear();
    put_residuals(streams, table.iter().copied(), table_bits, table_plan.mantissa, packed);
    put_varint(packed.len() as u64, out);
    out.extend_from_slice(packed);
    numbers::put(streams, ranks, symbols, choice, out);
    true
}

/// Reads `count` values, up to the end of the block, into `decoder.values`, whose content is replaced.
pub(super) fn read(decoder: &mut Decoder, mut reader: Reader, count: usize) -> Result<(), CodecError> {
    const TABLE: &str = "table of values";
    let Decoder { streams, bytes, values, table, wide, .. } = decoder;
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
            let most = values.iter().copied().max().unwrap();
            let mut buffers = Buffers { values: values.clone(), ..Buffers::default() };
            buffers.rank.sort(&values, most);
            let (mut bytes, mut writer) = (Vec::new(), StreamWriter::default());
            prop_assert!(try_put(&mut writer, &mut buffers, most, f32::INFINITY, |_| (), &mut bytes));
            let mut decoder = Decoder::new();
            read(&mut decoder, Reader::new(&bytes), values.len()).unwrap();
            prop_assert_eq!(&decoder.values, &values);
            let mut distinct = values.clone();
            distinct.sort_unstable();
            distinct.dedup();
            prop_assert_eq!(&decoder.table, &distinct);
            prop_assert!(!try_put(&mut writer, &mut buffers, most, 0.0, |_| (), &mut bytes));
        }
    }

    /// A property test met it once in thousands of cases: no bits are no digits, and no way to go through them.
    #[test]
    fn nothing_but_zeros_is_sorted() {
        let mut rank = RankBuffers::default();
        rank.sort(&[0; 3], 0);
        assert_eq!(rank.sorted().iter().map(|e| (e.number(), e.index())).collect::<Vec<_>>(), [(0, 0), (0, 1), (0, 2)]);
    }
}

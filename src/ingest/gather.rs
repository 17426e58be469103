//! From rows to the columns of a node's parts.

use super::partition::RowPlan;
use super::rows::with_payload_words;
use crate::points::{Attribute, Column, RecordLayout};
use crate::store::PointColumns;
use crate::store::model::{ScanId, Slot};

/// Rows that are looked at together: few enough that their payloads stay in the fastest cache, column after column.
const BLOCK: usize = 256;

/// What is known of a scan while its rows become columns.
#[derive(Debug)]
pub(super) struct ScanColumns<'a> {
    /// Its id in the store.
    pub id: ScanId,
    /// Its identity: the last tie-break.
    pub identity: [u8; 32],
    /// How its rows are laid out.
    pub plan: &'a RowPlan,
    /// The store's ids of its attributes, in the order of its layout.
    pub slots: Vec<Slot>,
    /// Names and types of its attributes, as bytes: breaks ties between scans with different attributes.
    pub signature: Vec<u8>,
}

impl<'a> ScanColumns<'a> {
    pub fn new(id: ScanId, identity: [u8; 32], plan: &'a RowPlan, slots: Vec<Slot>) -> Self {
        let signature = Self::signature_of(plan.layout.attributes.iter());
        Self { id, identity, plan, slots, signature }
    }

    /// Names and types of attributes, as bytes.
    pub fn signature_of<'s>(attributes: impl IntoIterator<Item = &'s Attribute>) -> Vec<u8> {
        let mut signature = Vec::new();
        for attribute in attributes {
            signature.extend_from_slice(attribute.name.as_bytes());
            signature.push(0);
            signature.extend_from_slice(attribute.ty.word().as_bytes());
            signature.push(0);
        }
        signature
    }
}

/// Buffers that live from node to node.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    /// Payloads of one scan's rows in a block, one after the other.
    payloads: Vec<u8>,
    /// The bits in which they differ.
    varying: Vec<u8>,
    /// Where in a block the rows of a scan are.
    places: Vec<u32>,
}

/// Where rows are.
pub(super) trait RowSource<'r> {
    /// The scan slot and the payload of row `row`. To be inlined wherever it is called: a call for each row costs as much as
    /// what is done with it.
    fn row(&self, row: u32) -> (u32, &'r [u8]);
}

impl<'r, F: Fn(u32) -> (u32, &'r [u8])> RowSource<'r> for F {
    #[inline(always)]
    fn row(&self, row: u32) -> (u32, &'r [u8]) {
        self(row)
    }
}

/// Gathers the columns of `rows` of `source`, in their order. Columns of attributes that a point's scan lacks hold zero
/// there. What `into` held before is replaced; its memory is used again.
pub(super) fn gather<'r>(
    scans: &[ScanColumns<'_>],
    rows: &[u32],
    source: impl RowSource<'r>,
    scratch: &mut Scratch,
    into: &mut PointColumns,
) {
    into.scans.clear();
    into.columns.iter_mut().for_each(|(_, column)| column.clear());
    for block in rows.chunks(BLOCK) {
        let slot = |i: &u32| source.row(*i).0;
        let first = slot(&block[0]);
        if scans.len() == 1 || block.iter().all(|i| slot(i) == first) {
            gather_one_scan(&scans[first as usize], block, &source, scratch, into);
        } else {
            gather_mixed(scans, block, &source, scratch, into);
        }
    }
    let n = into.scans.len();
    // A column that nothing was put into is of attributes that no scan here has.
    into.columns.retain(|(_, column)| !column.is_empty());
    into.columns.iter_mut().for_each(|(_, column)| column.resize(n));
    into.columns.sort_by_key(|(slot, _)| *slot);
}

/// Appends rows that are all of one scan.
fn gather_one_scan<'r>(
    scan: &ScanColumns<'_>,
    rows: &[u32],
    source: &impl RowSource<'r>,
    scratch: &mut Scratch,
    into: &mut PointColumns,
) {
    let start = into.scans.len();
    into.scans.resize(start + rows.len(), scan.id);
    let layout = &scan.plan.layout;
    if scan.slots.is_empty() {
        return;
    }
    let Scratch { payloads, varying, .. } = scratch;
    let bytes = rows.len() * layout.payload;
    if payloads.len() < bytes {
        payloads.resize(bytes, 0);
    }
    copy_payloads(layout.payload, rows, source, &mut payloads[..bytes], varying);
    let payloads = payloads[..bytes].chunks_exact(layout.payload);
    for field in 0..scan.slots.len() {
        let column = column_of(into, scan, field, start);
        if layout.varies(field, varying) {
            layout.extract(field, payloads.clone(), column);
        } else {
            layout.extract(field, payloads.clone().take(1), column);
            column.repeat_last(rows.len() - 1);
        }
    }
}

/// Appends rows of several scans.
fn gather_mixed<'r>(
    scans: &[ScanColumns<'_>],
    rows: &[u32],
    source: &impl RowSource<'r>,
    scratch: &mut Scratch,
    into: &mut PointColumns,
) {
    let start = into.scans.len();
    into.scans.extend(rows.iter().map(|&i| scans[source.row(i).0 as usize].id));
    let mut slots: Vec<u32> = rows.iter().map(|&i| source.row(i).0).collect();
    slots.sort_unstable();
    slots.dedup();
    for slot in slots {
        let scan = &scans[slot as usize];
        let Scratch { payloads, places, .. } = &mut *scratch;
        places.clear();
        payloads.clear();
        for (place, &i) in (0_u32..).zip(rows) {
            let (of, payload) = source.row(i);
            if of == slot {
                places.push(place);
                payloads.extend_from_slice(payload);
            }
        }
        let RecordLayout { payload, attributes, .. } = &scan.plan.layout;
        for field in 0..scan.slots.len() {
            let mut values = Column::with_capacity(attributes[field].ty, places.len());
            scan.plan.layout.extract(field, payloads.chunks_exact(*payload), &mut values);
            let column = column_of(into, scan, field, start);
            column.resize(start + rows.len());
            scatter(column, start, &values, places);
        }
    }
}

/// The column of an attribute, at least `len` long: zeros stand where rows before these had no such attribute.
fn column_of<'c>(into: &'c mut PointColumns, scan: &ScanColumns<'_>, field: usize, len: usize) -> &'c mut Column {
    let slot = scan.slots[field];
    let columns = &mut into.columns;
    // Of a store with one kind of scan, attributes and columns are the same in number and order.
    let guess = columns.get(field).is_some_and(|(s, _)| *s == slot).then_some(field);
    let place = guess.or_else(|| columns.iter().position(|(s, _)| *s == slot)).unwrap_or_else(|| {
        columns.push((slot, Column::with_capacity(scan.plan.layout.attributes[field].ty, len + BLOCK)));
        columns.len() - 1
    });
    let column = &mut columns[place].1;
    if column.len() < len {
        column.resize(len);
    }
    column
}

/// Puts the payloads of `rows`, `bytes` each, one after the other into `to`, which has their size, and into `varying` the
/// bits in which they are not as the first.
fn copy_payloads<'r>(bytes: usize, rows: &[u32], source: &impl RowSource<'r>, to: &mut [u8], varying: &mut Vec<u8>) {
    fn copy<'r, R: RowSource<'r>, const WORDS: usize>(
        bytes: usize,
        rows: &[u32],
        source: &R,
        to: &mut [u8],
        varying: &mut Vec<u8>,
    ) {
        match WORDS {
            0 => copy_bytes(rows, source, to, varying),
            _ => copy_words::<WORDS>(bytes, rows, source, to, varying),
        }
    }
    with_payload_words!(bytes, copy::<_>(bytes, rows, source, to, varying));
}

fn copy_bytes<'r>(rows: &[u32], source: &impl RowSource<'r>, to: &mut [u8], varying: &mut Vec<u8>) {
    let first = source.row(rows[0]).1;
    varying.clear();
    varying.resize(first.len(), 0);
    for (to, &row) in to.chunks_exact_mut(first.len()).zip(rows) {
        let from = source.row(row).1;
        to.copy_from_slice(from);
        varying.iter_mut().zip(from).zip(first).for_each(|((v, a), b)| *v |= a ^ b);
    }
}

fn copy_words<'r, const WORDS: usize>(
    bytes: usize,
    rows: &[u32],
    source: &impl RowSource<'r>,
    to: &mut [u8],
    varying: &mut Vec<u8>,
) {
    let start = |word: usize| if word + 1 == WORDS { bytes - 8 } else { 8 * word };
    let words = |from: &[u8]| -> [u64; WORDS] {
        std::array::from_fn(|w| {
            let mut word = [0; 8];
            word.copy_from_slice(&from[start(w)..start(w) + 8]);
            u64::from_le_bytes(word)
        })
    };
    let first = words(source.row(rows[0]).1);
    let mut differing = [0; WORDS];
    for (to, &row) in to.chunks_exact_mut(bytes).zip(rows) {
        let from = words(&source.row(row).1[..bytes]);
        for w in 0..WORDS {
            to[start(w)..start(w) + 8].copy_from_slice(&from[w].to_le_bytes());
            differing[w] |= from[w] ^ first[w];
        }
    }
    varying.clear();
    varying.resize(bytes, 0);
    for w in 0..WORDS {
        varying[start(w)..start(w) + 8].copy_from_slice(&differing[w].to_le_bytes());
    }
}

/// `to[start + places[i]] = from[i]`. The types are equal, since a slot has one type.
fn scatter(to: &mut Column, start: usize, from: &Column, places: &[u32]) {
    macro_rules! scatter {
        ($($variant:ident),*) => {
            match (to, from) {
                $((Column::$variant(to), Column::$variant(from)) => {
                    for (&place, &value) in places.iter().zip(from) {
                        to[start + place as usize] = value;
                    }
                })*
                _ => {}
            }
        };
    }
    scatter!(U8, I8, U16, I16, U32, I32, U64, I64, F32, F64);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::{Attribute, Field, FieldKind, PositionKind, ScalarType};
    use proptest::prelude::*;

    #[test]
    fn mixed_scans_keep_their_values_and_get_zeros_elsewhere() {
        let plan = |slot, names: &[(&str, ScalarType)]| {
            let attributes = names.iter().map(|(n, t)| Attribute::new(*n, *t));
            RowPlan::new(slot, RecordLayout::canonical(PositionKind::Lattice, attributes), None)
        };
        let a = plan(0, &[("A", ScalarType::U8), ("B", ScalarType::U16)]);
        let b = plan(1, &[("B", ScalarType::U16)]);
        let c = plan(2, &[]);
        let scans = [
            ScanColumns::new(7, [0; 32], &a, vec![2, 3]),
            ScanColumns::new(8, [1; 32], &b, vec![3]),
            ScanColumns::new(9, [2; 32], &c, vec![]),
        ];
        let rows: [(u32, &[u8]); 5] = [(0, &[1, 2, 0]), (1, &[3, 1]), (2, &[]), (0, &[4, 5, 0]), (1, &[6, 0])];
        let mut scratch = Scratch::default();
        let mut got = PointColumns::default();
        let mut gather = |order: &[u32], got: &mut PointColumns| {
            gather(&scans, order, |i| rows[i as usize], &mut scratch, got);
        };
        for _ in 0..2 {
            gather(&[0, 1, 2, 3, 4], &mut got);
            assert_eq!(got.scans, [7, 8, 9, 7, 8]);
            assert_eq!(got.columns[0], (2, Column::U8(vec![1, 0, 0, 4, 0])));
            assert_eq!(got.columns[1], (3, Column::U16(vec![2, 259, 0, 5, 6])));
            // What no scan has leaves no column, whatever was there before.
            gather(&[4, 2], &mut got);
            assert_eq!(got.scans, [8, 9]);
            assert_eq!(got.columns, [(3, Column::U16(vec![6, 0]))]);
        }
        // One scan after the other, each in blocks of its own.
        let order: Vec<u32> = [2, 0, 1].iter().flat_map(|&i| std::iter::repeat_n(i, BLOCK)).collect();
        gather(&order, &mut got);
        let expected =
            |a: u16, b: u16| -> Vec<u16> { [0, a, b].iter().flat_map(|&v| std::iter::repeat_n(v, BLOCK)).collect() };
        let first = expected(1, 0).iter().map(|&v| v as u8).collect();
        assert_eq!(got.columns, [(2, Column::U8(first)), (3, Column::U16(expected(2, 259)))]);
    }

    proptest! {
        #[test]
        fn payloads_of_any_size_become_the_columns_of_their_values(
            size in 1_usize..80,
            fields in prop::collection::vec((0_usize..80, 0_u8..8), 1..6),
            n in 1_u32..600,
            fixed: u64,
            seed: u64,
        ) {
            let fields: Vec<_> = fields
                .into_iter()
                .enumerate()
                .map(|(i, (offset, shift))| {
                    let name = format!("a{i}");
                    let offset = offset % size;
                    if i % 2 == 0 && offset + 8 <= size {
                        (Attribute::new(name, ScalarType::U64), Field { offset, kind: FieldKind::Whole })
                    } else {
                        let kind = FieldKind::Bits { shift, mask: 0xff >> shift };
                        (Attribute::new(name, ScalarType::U8), Field { offset, kind })
                    }
                })
                .collect();
            let layout = RecordLayout::new(PositionKind::Grid, size, fields);
            // Some bytes are the same in all payloads.
            let mix = |i: u32, at: usize| if fixed >> (at % 64) & 1 == 1 { 7 } else { (seed.rotate_left(i % 61) >> (at % 50)) as u8 };
            let payloads: Vec<Vec<u8>> = (0..n).map(|i| (0..size).map(|at| mix(i, at)).collect()).collect();
            let plan = RowPlan::new(0, layout.clone(), None);
            let slots: Vec<Slot> = (2..).take(layout.fields.len()).collect();
            let scans = [ScanColumns::new(1, [0; 32], &plan, slots)];
            let mut got = PointColumns::default();
            let order: Vec<u32> = (0..n).rev().collect();
            gather(&scans, &order, |i| (0, &payloads[i as usize][..]), &mut Scratch::default(), &mut got);
            prop_assert_eq!(got.columns.len(), layout.fields.len());
            for (index, (_, column)) in got.columns.iter().enumerate() {
                let mut naive = Column::with_capacity(layout.attributes[index].ty, 0);
                layout.extract(index, payloads.iter().rev().map(Vec::as_slice), &mut naive);
                prop_assert_eq!(column, &naive);
            }
        }
    }
}

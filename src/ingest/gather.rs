//! From rows to the columns of one node.

use super::partition::RowPlan;
use crate::points::Column;
use crate::store::model::{ScanId, Slot};

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
        let mut signature = Vec::new();
        for attribute in plan.layout.attributes.iter() {
            signature.extend_from_slice(attribute.name.as_bytes());
            signature.push(0);
            signature.extend_from_slice(attribute.ty.word().as_bytes());
            signature.push(0);
        }
        Self { id, identity, plan, slots, signature }
    }
}

/// The attribute columns of a node's points and the scan of each.
#[derive(Debug, Default)]
pub(super) struct NodeColumns {
    pub scans: Vec<ScanId>,
    pub columns: Vec<(Slot, Column)>,
}

/// Buffers that live from node to node.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    by_slot: Vec<ScanRows>,
}

/// The rows of one scan in a node.
#[derive(Debug, Default)]
struct ScanRows {
    /// Their places in the node.
    indices: Vec<u32>,
    payloads: Vec<u8>,
}

/// Gathers the columns of the rows given as `(scan slot, payload)`, in their order. Columns of attributes that a point's
/// scan lacks hold zero there.
pub(super) fn gather<'r>(
    scans: &[ScanColumns<'_>],
    rows: impl ExactSizeIterator<Item = (u32, &'r [u8])>,
    scratch: &mut Scratch,
) -> NodeColumns {
    let n = rows.len();
    scratch.by_slot.resize_with(scans.len(), ScanRows::default);
    for of_scan in &mut scratch.by_slot {
        of_scan.indices.clear();
        of_scan.payloads.clear();
    }
    let mut result = NodeColumns { scans: Vec::with_capacity(n), columns: Vec::new() };
    for (i, (slot, payload)) in (0_u32..).zip(rows) {
        let of_scan = &mut scratch.by_slot[slot as usize];
        of_scan.indices.push(i);
        of_scan.payloads.extend_from_slice(payload);
        result.scans.push(scans[slot as usize].id);
    }
    for (scan, ScanRows { indices, payloads }) in scans.iter().zip(&scratch.by_slot) {
        if indices.is_empty() || scan.slots.is_empty() {
            continue;
        }
        let layout = &scan.plan.layout;
        for (field, (&column_slot, attribute)) in scan.slots.iter().zip(layout.attributes.iter()).enumerate() {
            let mut values = Column::with_capacity(attribute.ty, indices.len());
            layout.extract(field, payloads.chunks_exact(layout.payload), &mut values);
            if indices.len() == n {
                result.columns.push((column_slot, values));
                continue;
            }
            let place = result.columns.iter().position(|(s, _)| *s == column_slot).unwrap_or_else(|| {
                result.columns.push((column_slot, Column::zeros(attribute.ty, n)));
                result.columns.len() - 1
            });
            scatter(&mut result.columns[place].1, &values, indices);
        }
    }
    result.columns.sort_by_key(|(slot, _)| *slot);
    result
}

/// `to[indices[i]] = from[i]`. The types are equal, since a slot has one type.
fn scatter(to: &mut Column, from: &Column, indices: &[u32]) {
    macro_rules! scatter {
        ($($variant:ident),*) => {
            match (to, from) {
                $((Column::$variant(to), Column::$variant(from)) => {
                    for (&i, &value) in indices.iter().zip(from) {
                        to[i as usize] = value;
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
    use crate::points::{Attribute, PositionKind, RecordLayout, ScalarType};

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
        for _ in 0..2 {
            let got = gather(&scans, rows.into_iter(), &mut scratch);
            assert_eq!(got.scans, [7, 8, 9, 7, 8]);
            assert_eq!(got.columns[0], (2, Column::U8(vec![1, 0, 0, 4, 0])));
            assert_eq!(got.columns[1], (3, Column::U16(vec![2, 259, 0, 5, 6])));
        }
    }
}

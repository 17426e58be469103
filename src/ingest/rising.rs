//! Points that left their bucket for a coarser node, until that node is complete: in memory, or in the temporary file, where
//! the rows that were read have left room for them.

use super::IngestError;
use super::gather::ScanColumns;
use super::loaded::{RowForm, Rows};
use super::rows::RowKey;
use super::spill::{Place, Spill};
use crate::lattice::Cube;
use crate::octree::assemble::Block;
use std::cmp::Reverse;

/// Blocks smaller than this stay in memory: reading one takes a call.
const LEAST_SPILLED: usize = 1 << 10;

/// Some points of a bucket, in key order.
#[derive(Debug)]
pub(super) struct Held {
    /// The bucket's cube.
    cube: Cube,
    form: RowForm,
    /// All keys, then all wins, then all rows.
    place: Place,
}

/// The points of a bucket.
#[derive(Clone, Copy)]
pub(super) struct BucketPoints<'a, K> {
    pub cube: Cube,
    pub keys: &'a [K],
    pub wins: &'a [i8],
    pub rows: Rows<'a>,
}

impl<K: RowKey> BucketPoints<'_, K> {
    /// Copies these `points`, to the temporary file if there is one and it has room.
    pub fn held(&self, points: &[u32], spill: Option<&Spill>) -> Result<Held, IngestError> {
        let form = self.rows.form;
        let mut bytes = vec![0; points.len() * K::BYTES];
        bytes.reserve_exact(points.len() * (1 + form.stride));
        for (to, &i) in bytes.chunks_exact_mut(K::BYTES).zip(points) {
            self.keys[i as usize].write(to);
        }
        bytes.extend(points.iter().map(|&i| self.wins[i as usize] as u8));
        for &i in points {
            bytes.extend_from_slice(self.rows.whole(i));
        }
        let place = match spill {
            Some(_) if bytes.len() >= LEAST_SPILLED => Place::again(&bytes, spill)?,
            _ => Place::Memory(bytes),
        };
        Ok(Held { cube: self.cube, form, place })
    }
}

/// The points of a node above the buckets, in key order.
#[derive(Debug)]
pub(super) struct Risen<K> {
    pub keys: Vec<K>,
    pub wins: Vec<i8>,
    bytes: Vec<u8>,
    form: RowForm,
}

impl<N: RowKey> Risen<N> {
    /// Collects the blocks of a node, whose buckets have keys `K`; `N` does for the node.
    pub fn collect<K: RowKey>(blocks: Vec<Block<Held>>, spill: Option<&Spill>) -> Result<Self, IngestError> {
        let form = RowForm::union(blocks.iter().map(|b| b.item.form));
        let points = blocks.iter().map(|b| b.points as usize).sum();
        let (keys, wins) = (Vec::with_capacity(points), Vec::with_capacity(points));
        let mut risen = Self { keys, wins, bytes: Vec::with_capacity(points * form.stride), form };
        let mut buffer = Vec::new();
        // The last bucket, where its points begin, and whether they are of several blocks.
        let (mut last, mut start, mut several) = (None, 0, false);
        for Block { points, item: Held { cube, form: of_rows, place }, .. } in blocks {
            if last.replace(cube) == Some(cube) {
                several = true;
            } else {
                risen.settle(start, several);
                (start, several) = (risen.keys.len(), false);
            }
            let bytes = place.take(spill, &mut buffer)?;
            let (keys, rest) = bytes.split_at(points as usize * K::BYTES);
            let (wins, rows) = rest.split_at(points as usize);
            let first = cube.first_key();
            let keys = keys.chunks_exact(K::BYTES).map(|key| {
                let full = K::read(key).full(first);
                N::from_halves(full.high, full.low)
            });
            risen.keys.extend(keys);
            risen.wins.extend(wins.iter().map(|&win| win as i8));
            form.append(rows, points as usize, of_rows, &mut risen.bytes);
        }
        risen.settle(start, several);
        Ok(risen)
    }

    /// Puts the points from `start` on in order, if they are of `several` blocks.
    fn settle(&mut self, start: usize, several: bool) {
        if !several {
            return;
        }
        let Self { keys, wins, bytes, form } = self;
        let mut order: Vec<usize> = (start..keys.len()).collect();
        order.sort_by_key(|&i| (keys[i], Reverse(wins[i])));
        let sorted: Vec<_> = order.iter().map(|&i| (keys[i], wins[i])).collect();
        let stride = form.stride;
        let rows: Vec<u8> = order.iter().flat_map(|&i| &bytes[i * stride..(i + 1) * stride]).copied().collect();
        bytes[start * stride..].copy_from_slice(&rows);
        for (i, (key, win)) in (start..).zip(sorted) {
            (keys[i], wins[i]) = (key, win);
        }
    }

    /// Their rows.
    pub fn rows<'a>(&'a self, scans: &'a [ScanColumns<'a>]) -> Rows<'a> {
        Rows { bytes: &self.bytes, form: self.form, scans }
    }
}

#[cfg(test)]
mod tests {
    use super::super::gather::RowSource;
    use super::super::partition::RowPlan;
    use super::*;
    use crate::lattice::{BIAS, Key, LatticePoint};
    use crate::octree::assemble::BucketRest;
    use crate::octree::{Params, first_win, wins};
    use crate::points::{Attribute, PositionKind, RecordLayout, ScalarType};
    use proptest::prelude::*;

    const PARAMS: Params = Params { g: 2, leaf_capacity: 4 };

    /// A point: its key, its scan, and a number that its payload repeats as far as it is long.
    type Numbered = (Key, u32, u8);

    /// All points of some buckets of exponent `k`, which are held, collected.
    fn risen<K: RowKey, N: RowKey>(
        scans: &[ScanColumns<'_>],
        points: &[Numbered],
        k: u8,
        spill: Option<&Spill>,
    ) -> Vec<Numbered> {
        let root = Cube::spanning(points[0].0.point(), points[points.len() - 1].0.point(), k + 1);
        let cube_of = |p: &Numbered| Cube::containing(p.0.point(), k);
        let mut previous = None;
        let mut blocks = Vec::new();
        let mut expected_wins: Vec<i8> = Vec::new();
        for bucket in points.chunk_by(|a, b| cube_of(a) == cube_of(b)) {
            let cube = cube_of(&bucket[0]);
            let keys: Vec<K> = bucket.iter().map(|p| K::of(p.0.point())).collect();
            let wins = wins(&keys, first_win(previous.replace(cube), cube, root));
            expected_wins.extend(&wins);
            let payload = |p: &Numbered| scans[p.1 as usize].plan.layout.payload;
            let form = RowForm::of(bucket.iter().map(|p| (p.1, payload(p))));
            let mut bytes = Vec::new();
            for p in bucket {
                form.append(&vec![p.2; payload(p)], 1, RowForm::of([(p.1, payload(p))].into_iter()), &mut bytes);
            }
            let of_bucket = BucketPoints { cube, keys: &keys, wins: &wins, rows: Rows { bytes: &bytes, form, scans } };
            let rest = BucketRest { built: None, points: (0..).take(bucket.len()).collect() };
            for (win, own) in rest.by_node(cube, &wins, PARAMS) {
                blocks.push(Block { win, points: own.len() as u64, item: of_bucket.held(&own, spill).unwrap() });
            }
        }
        if spill.is_some_and(|s| s.bytes() > 0) {
            let large = blocks.iter().filter(|b| b.points * K::BYTES as u64 >= LEAST_SPILLED as u64);
            assert!(large.clone().all(|b| !matches!(b.item.place, Place::Memory(_))), "it has room for them");
        }
        let risen = Risen::<N>::collect::<K>(blocks, spill).unwrap();
        let rows = risen.rows(scans);
        let full = |key: N| key.full(root.first_key());
        let point = |(i, &key): (u32, &N)| {
            let (slot, payload) = rows.row(i);
            assert_eq!(payload.len(), scans[slot as usize].plan.layout.payload);
            assert!(payload.iter().all(|b| *b == payload[0]));
            (full(key), slot, payload.first().copied().unwrap_or(0))
        };
        let got = (0..).zip(&risen.keys).map(point).collect();
        assert_eq!(risen.wins, expected_wins);
        got
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(150))]
        #[test]
        fn what_was_held_comes_back_in_the_order_of_all_points(
            // Few places, so that some are taken more than once.
            places in prop::collection::vec(([0_u64..20, 0..20, 0..3], 0_u32..3, 1_u8..), 1..700),
            k in 3_u8..=5,
            most_scans in 1_u32..=3,
            room in prop_oneof![Just(None), Just(Some(0)), Just(Some(1_usize << 20))],
        ) {
            let plan = |slot, types: &[ScalarType]| {
                let attributes = types.iter().map(|ty| Attribute::new(ty.word(), *ty));
                RowPlan::new(slot, RecordLayout::canonical(PositionKind::Lattice, attributes), None)
            };
            let plans = [plan(0, &[ScalarType::U16, ScalarType::U8]), plan(1, &[]), plan(2, &[ScalarType::F64])];
            let scans = [0, 1, 2].map(|i| ScanColumns::new(i, [0; 32], &plans[i as usize], Vec::new()));
            let mut points: Vec<Numbered> = places
                .into_iter()
                .map(|(xyz, slot, number)| {
                    let slot = slot % most_scans;
                    let at = LatticePoint(xyz.map(|c| BIAS as u64 + c));
                    (Key::of(at), slot, if slot == 1 { 0 } else { number })
                })
                .collect();
            points.sort();
            let folder = tempfile::tempdir().unwrap();
            let spill = || room.map(|room| {
                let spill = Spill::create(&folder.path().join("a.esker")).unwrap();
                Place::Spilled(spill.append(&vec![0; room]).unwrap()).give_back(Some(&spill));
                spill
            });
            prop_assert_eq!(&risen::<u64, u64>(&scans, &points, k, spill().as_ref()), &points);
            prop_assert_eq!(&risen::<Key, Key>(&scans, &points, k, spill().as_ref()), &points);
            prop_assert_eq!(&risen::<u64, Key>(&scans, &points, k, spill().as_ref()), &points);
        }
    }
}

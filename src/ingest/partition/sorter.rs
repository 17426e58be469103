//! One thread's work on one scan: records come in, are moved to the lattice and keyed, and leave as rows in the buffers of their
//! buckets.

use super::{Partition, Segment};
use crate::ingest::IngestError;
use crate::ingest::rows::{RowKey, copy_payload, with_payload_words};
use crate::ingest::spill::Place;
use crate::lattice::{BITS, Cube, LOW_DIGITS, LatticeBox, LatticePoint, SourceMap};
use crate::points::{FieldKind, PositionKind, RecordLayout, ScalarType};
use crate::store::model::Rejected;
use std::collections::HashMap;
use std::sync::atomic::Ordering;

/// Bytes of a bucket's first buffer; each next one is twice the size, up to [`LARGEST_BUFFER`]. Buffers are handed over
/// when they are full and never grow: fresh memory is dear, and one that doubles in place touches it twice. (What is
/// fresh is zero already.)
const FIRST_BUFFER: usize = 4 << 10;
const LARGEST_BUFFER: usize = 64 << 10;

/// How the points of one scan become rows.
#[derive(Debug)]
pub struct RowPlan {
    /// The scan's number in this run.
    pub slot: u32,
    /// The layout of its records.
    pub layout: RecordLayout,
    /// From its grid to the lattice, for [`PositionKind::Grid`].
    pub map: Option<SourceMap>,
    /// Offsets of Red, Green and Blue in the payload, where they are `u16`.
    color_offsets: Option<[usize; 3]>,
}

impl RowPlan {
    pub fn new(slot: u32, layout: RecordLayout, map: Option<SourceMap>) -> Self {
        let offset = |name: &str| {
            let i = layout.attributes.iter().position(|a| a.name == name && a.ty == ScalarType::U16)?;
            (layout.fields[i].kind == FieldKind::Whole).then_some(layout.fields[i].offset)
        };
        let color_offsets = (|| Some([offset("Red")?, offset("Green")?, offset("Blue")?]))();
        Self { slot, layout, map, color_offsets }
    }
}

/// What became of the records of a scan.
#[derive(Clone, Copy, Debug, Default)]
pub struct ScanTally {
    pub read: u64,
    pub stored: u64,
    pub rejected: Rejected,
    pub bounds: Option<LatticeBox>,
    pub largest_error: f64,
    /// All 16-bit colour values of the scan, or-ed.
    pub color_bits: u16,
}

impl ScanTally {
    pub fn merge(&mut self, other: &Self) {
        self.read += other.read;
        self.stored += other.stored;
        self.rejected.not_finite += other.rejected.not_finite;
        self.rejected.out_of_range += other.rejected.out_of_range;
        self.rejected.truncated += other.rejected.truncated;
        self.bounds = match (self.bounds, other.bounds) {
            (Some(a), Some(b)) => Some(a.union(&b)),
            (a, b) => a.or(b),
        };
        self.largest_error = self.largest_error.max(other.largest_error);
        self.color_bits |= other.color_bits;
    }
}

struct Open {
    corner: [u64; 3],
    rows: u32,
    /// The buffer: room for whole rows, of which `used` bytes are taken. Empty if there is none.
    bytes: Vec<u8>,
    used: usize,
    /// Size of the next buffer.
    next_bytes: usize,
}

/// Buckets that were looked up last, by a few bits of their corner.
const RECENT: usize = 64;

fn take_run<K: RowKey, const WORDS: usize>(sorter: &mut Sorter<'_, '_>, records: &[u8]) -> Result<(), IngestError> {
    sorter.take_run::<K, WORDS>(records)
}

/// Turns records of one scan into rows of buckets; one thread has one for all pieces of a scan.
pub struct Sorter<'a, 'b> {
    partition: &'b Partition<'a>,
    plan: &'b RowPlan,
    affine: Option<[(i64, i64); 3]>,
    k: u8,
    open: Vec<Open>,
    by_corner: HashMap<[u64; 3], usize>,
    /// Places in `open`, or beyond it.
    recent: [usize; RECENT],
    current: usize,
    open_bytes: usize,
    /// What was handed over since `k` was looked at.
    handed: Handed,
    tally: ScanTally,
    min: [u64; 3],
    max: [u64; 3],
    block: Block,
}

/// Segments and their bytes.
#[derive(Clone, Copy, Debug, Default)]
struct Handed {
    segments: usize,
    bytes: usize,
}

/// Segments of fewer bytes on average are too small: each takes memory of its own, and a call to be read back.
const LEAST_SEGMENT_BYTES: usize = 2 << 10;

/// Records that are looked at together.
const BLOCK: usize = 256;

/// Positions of a block, by axis, and their keys.
struct Block {
    positions: [[i32; BLOCK]; 3],
    keys: [u64; BLOCK],
}

impl<'a, 'b> Sorter<'a, 'b> {
    /// Begins the work of one thread on one scan.
    pub(super) fn new(partition: &'b Partition<'a>, plan: &'b RowPlan) -> Self {
        let k = partition.k.load(Ordering::Relaxed);
        let affine = plan.map.as_ref().and_then(SourceMap::affine);
        Self {
            partition,
            plan,
            affine,
            k,
            open: Vec::new(),
            by_corner: HashMap::new(),
            recent: [usize::MAX; RECENT],
            current: usize::MAX,
            open_bytes: 0,
            handed: Handed::default(),
            tally: ScanTally::default(),
            min: [u64::MAX; 3],
            max: [0; 3],
            block: Block { positions: [[0; BLOCK]; 3], keys: [0; BLOCK] },
        }
    }
}

impl Sorter<'_, '_> {
    /// Takes a run of whole records; `most_open_bytes` limits what is held in buffers that are not full yet.
    pub fn take<K: RowKey>(&mut self, records: &[u8], most_open_bytes: usize) -> Result<(), IngestError> {
        with_payload_words!(self.plan.layout.payload, take_run::<K>(self, records))?;
        if self.open_bytes > most_open_bytes {
            self.flush()?;
            // Points that come in no order fill all buckets at once; then fewer are better.
            let Handed { segments, bytes } = std::mem::take(&mut self.handed);
            if bytes < segments * LEAST_SEGMENT_BYTES {
                self.partition.coarsen(self.k);
            }
            self.k = self.partition.k.load(Ordering::Relaxed);
        }
        Ok(())
    }

    /// Takes records whose payload is copied as so many words, or in any way if that is 0.
    fn take_run<K: RowKey, const WORDS: usize>(&mut self, records: &[u8]) -> Result<(), IngestError> {
        let stride = self.plan.layout.stride();
        let narrow = K::BYTES == <u64 as RowKey>::BYTES && WORDS > 0;
        for block in records.chunks(BLOCK * stride) {
            let taken = match self.affine {
                Some(affine) if narrow => self.take_block::<WORDS>(block, affine)?,
                _ => false,
            };
            if !taken {
                self.take_one_by_one::<K, WORDS>(block)?;
            }
        }
        self.tally.read += (records.len() / stride) as u64;
        Ok(())
    }

    /// Takes records in any way.
    fn take_one_by_one<K: RowKey, const WORDS: usize>(&mut self, records: &[u8]) -> Result<(), IngestError> {
        let head = self.plan.layout.position.size();
        for record in records.chunks_exact(self.plan.layout.stride()) {
            let (position, payload) = record.split_at(head);
            let Some(point) = self.position(position) else { continue };
            self.tally.stored += 1;
            self.widen(point, point);
            self.note_colors(payload);
            self.turn_to(point.0.map(|c| c >> self.k));
            let room = self.room(K::BYTES + payload.len());
            let row = &mut room.bytes[room.used..];
            K::of(point).write(row);
            copy_payload::<WORDS>(payload, &mut row[K::BYTES..K::BYTES + payload.len()]);
            self.filled(K::BYTES + payload.len(), 1)?;
        }
        Ok(())
    }

    /// Takes a block of records on a grid that coincides with the lattice, or none of it: false if one of them lies
    /// outside of the lattice, or they are not all in one cube of the 21 levels that keys tell apart.
    fn take_block<const WORDS: usize>(&mut self, block: &[u8], affine: [(i64, i64); 3]) -> Result<bool, IngestError> {
        let layout = &self.plan.layout;
        let (stride, head, payload) = (layout.stride(), layout.position.size(), layout.payload);
        let n = block.len() / stride;
        let Block { positions, keys } = &mut self.block;
        for (i, record) in block.chunks_exact(stride).enumerate() {
            for (axis, positions) in positions.iter_mut().enumerate() {
                positions[i] = grid_coordinate(record, axis);
            }
        }
        // The map ascends, so the extremes tell of all.
        let index = |axis: usize, x: i32| i64::from(x) * affine[axis].0 + affine[axis].1;
        let (mut min, mut max) = ([0; 3], [0; 3]);
        for axis in 0..3 {
            let (low, high) = positions[axis][..n].iter().fold((i32::MAX, i32::MIN), |(l, h), &x| (l.min(x), h.max(x)));
            (min[axis], max[axis]) = (index(axis, low) as u64, index(axis, high) as u64);
            // A negative index has high bits set, too.
            if (min[axis] | max[axis]) >> BITS != 0 || min[axis] >> LOW_DIGITS != max[axis] >> LOW_DIGITS {
                return Ok(false);
            }
        }
        let [x, y, z] = positions;
        for (((key, &x), &y), &z) in keys[..n].iter_mut().zip(&*x).zip(&*y).zip(&*z) {
            *key = LatticePoint([index(0, x) as u64, index(1, y) as u64, index(2, z) as u64]).low_key();
        }
        self.tally.stored += n as u64;
        self.widen(LatticePoint(min), LatticePoint(max));
        let mut colors = Ored([0; WORDS]);
        let below = 3 * u32::from(self.k);
        let mut start = 0;
        while start < n {
            let cube = self.block.keys[start] >> below;
            let run = self.block.keys[start..n].iter().take_while(|&&key| key >> below == cube).count();
            let corner = |axis| index(axis, self.block.positions[axis][start]) as u64 >> self.k;
            self.turn_to([corner(0), corner(1), corner(2)]);
            let mut left = start..start + run;
            while !left.is_empty() {
                let row_bytes = <u64 as RowKey>::BYTES + payload;
                let room = self.room(row_bytes);
                let count = left.len().min((room.bytes.len() - room.used) / row_bytes);
                let (now, rest) = (left.start..left.start + count, left.start + count..left.end);
                let open = &mut self.open[self.current];
                let rows = open.bytes[open.used..].chunks_exact_mut(row_bytes);
                let records = block[now.start * stride..now.end * stride].chunks_exact(stride);
                for ((row, key), record) in rows.zip(&self.block.keys[now]).zip(records) {
                    let (to_key, to) = row.split_at_mut(<u64 as RowKey>::BYTES);
                    key.write(to_key);
                    colors.copy(&record[head..], to);
                }
                self.filled(row_bytes, count)?;
                left = rest;
            }
            start += run;
        }
        self.note_colors(&colors.bytes(payload));
        Ok(true)
    }

    fn widen(&mut self, low: LatticePoint, high: LatticePoint) {
        for axis in 0..3 {
            self.min[axis] = self.min[axis].min(low.0[axis]);
            self.max[axis] = self.max[axis].max(high.0[axis]);
        }
    }

    /// Notes the colours of a payload, or of several that are or-ed.
    fn note_colors(&mut self, payload: &[u8]) {
        for o in self.plan.color_offsets.into_iter().flatten() {
            self.tally.color_bits |= u16::from_le_bytes([payload[o], payload[o + 1]]);
        }
    }

    #[inline]
    fn position(&mut self, bytes: &[u8]) -> Option<LatticePoint> {
        match self.plan.layout.position {
            PositionKind::Grid => {
                let x: [i32; 3] = std::array::from_fn(|axis| grid_coordinate(bytes, axis));
                if let Some(affine) = self.affine {
                    let index: [u64; 3] = std::array::from_fn(|i| (i64::from(x[i]) * affine[i].0 + affine[i].1) as u64);
                    // A negative index has high bits set, too.
                    if (index[0] | index[1] | index[2]) >> BITS == 0 {
                        return Some(LatticePoint(index));
                    }
                    self.tally.rejected.out_of_range += 1;
                    return None;
                }
                self.inexact(x)
            }
            PositionKind::World => {
                let world: [f64; 3] = std::array::from_fn(|i| {
                    let mut value = [0; 8];
                    value.copy_from_slice(&bytes[8 * i..8 * i + 8]);
                    f64::from_le_bytes(value)
                });
                self.world(world)
            }
            PositionKind::Lattice => {
                let index: [u64; 3] = std::array::from_fn(|i| {
                    let mut value = [0; 8];
                    value.copy_from_slice(&bytes[8 * i..8 * i + 8]);
                    u64::from_le_bytes(value)
                });
                Some(LatticePoint(index))
            }
        }
    }

    fn inexact(&mut self, x: [i32; 3]) -> Option<LatticePoint> {
        let map = self.plan.map.as_ref()?;
        let mut point = LatticePoint::default();
        for axis in 0..3 {
            let Some(index) = map.to_lattice(axis, x[axis]) else {
                self.tally.rejected.out_of_range += 1;
                return None;
            };
            point.0[axis] = index;
        }
        for axis in 0..3 {
            let error = map.error(axis, x[axis], point.0[axis], self.partition.lattice);
            self.tally.largest_error = self.tally.largest_error.max(error);
        }
        Some(point)
    }

    fn world(&mut self, world: [f64; 3]) -> Option<LatticePoint> {
        if world.iter().any(|v| !v.is_finite()) {
            self.tally.rejected.not_finite += 1;
            return None;
        }
        let lattice = self.partition.lattice;
        let Ok(point) = lattice.lattice_from_world(world) else {
            self.tally.rejected.out_of_range += 1;
            return None;
        };
        let stored = lattice.world_from_lattice(point);
        for axis in 0..3 {
            self.tally.largest_error = self.tally.largest_error.max((world[axis] - stored[axis]).abs());
        }
        Some(point)
    }

    /// The current bucket with room for one row more.
    #[inline]
    fn room(&mut self, row_bytes: usize) -> &mut Open {
        let open = &mut self.open[self.current];
        if open.bytes.is_empty() {
            let rows = (open.next_bytes / row_bytes).max(1);
            open.next_bytes = (2 * open.next_bytes).min(LARGEST_BUFFER);
            open.bytes = vec![0; rows * row_bytes];
            self.open_bytes += open.bytes.len();
        }
        open
    }

    /// Rows have been put into the current bucket; when its buffer is full it is handed over.
    #[inline]
    fn filled(&mut self, row_bytes: usize, rows: usize) -> Result<(), IngestError> {
        let open = &mut self.open[self.current];
        open.used += rows * row_bytes;
        open.rows += rows as u32;
        if open.used < open.bytes.len() {
            return Ok(());
        }
        open.used = 0;
        let (corner, rows, bytes) = (open.corner, std::mem::take(&mut open.rows), std::mem::take(&mut open.bytes));
        self.open_bytes -= bytes.len();
        self.hand_over(corner, rows, bytes)
    }

    /// Makes the bucket at `corner` the current one.
    #[inline]
    fn turn_to(&mut self, corner: [u64; 3]) {
        if self.open.get(self.current).is_none_or(|o| !same(o.corner, corner)) {
            self.look_up(corner);
        }
    }

    fn look_up(&mut self, corner: [u64; 3]) {
        let recent = (corner[0] ^ corner[1] << 3 ^ corner[2] << 5) as usize % RECENT;
        self.current = self.recent[recent];
        if self.open.get(self.current).is_none_or(|o| !same(o.corner, corner)) {
            self.current = *self.by_corner.entry(corner).or_insert_with(|| {
                self.open.push(Open { corner, rows: 0, bytes: Vec::new(), used: 0, next_bytes: FIRST_BUFFER });
                self.open.len() - 1
            });
            self.recent[recent] = self.current;
        }
    }

    fn hand_over(&mut self, corner: [u64; 3], rows: u32, bytes: Vec<u8>) -> Result<(), IngestError> {
        self.handed.segments += 1;
        self.handed.bytes += bytes.len();
        let cube = Cube::containing(LatticePoint(corner.map(|c| c << self.k)), self.k);
        self.partition.hand_over(cube, Segment { slot: self.plan.slot, rows, place: Place::Memory(bytes) })
    }

    fn flush(&mut self) -> Result<(), IngestError> {
        self.by_corner.clear();
        self.recent = [usize::MAX; RECENT];
        self.current = usize::MAX;
        self.open_bytes = 0;
        for open in std::mem::take(&mut self.open) {
            if open.rows > 0 {
                let mut bytes = open.bytes;
                bytes.truncate(open.used);
                bytes.shrink_to_fit();
                self.hand_over(open.corner, open.rows, bytes)?;
            }
        }
        Ok(())
    }

    /// Hands over what is left.
    pub fn finish(mut self) -> Result<ScanTally, IngestError> {
        self.flush()?;
        if self.tally.stored > 0 {
            self.tally.bounds = Some(LatticeBox { min: LatticePoint(self.min), max: LatticePoint(self.max) });
        }
        Ok(self.tally)
    }
}

/// The source's integer on `axis` in a record of [`PositionKind::Grid`].
#[inline]
fn grid_coordinate(record: &[u8], axis: usize) -> i32 {
    let b = &record[4 * axis..4 * axis + 4];
    i32::from_le_bytes([b[0], b[1], b[2], b[3]])
}

/// Payloads, or-ed, in the words of `with_payload_words`.
struct Ored<const WORDS: usize>([u64; WORDS]);

impl<const WORDS: usize> Ored<WORDS> {
    fn start(word: usize, payload: usize) -> usize {
        if word + 1 == WORDS { payload - 8 } else { 8 * word }
    }

    /// Copies a payload and takes it in.
    #[inline]
    fn copy(&mut self, from: &[u8], to: &mut [u8]) {
        for (word, ored) in self.0.iter_mut().enumerate() {
            let start = Self::start(word, from.len());
            let mut bytes = [0; 8];
            bytes.copy_from_slice(&from[start..start + 8]);
            to[start..start + 8].copy_from_slice(&bytes);
            *ored |= u64::from_le_bytes(bytes);
        }
    }

    fn bytes(&self, payload: usize) -> Vec<u8> {
        let mut bytes = vec![0; payload];
        for (word, ored) in self.0.iter().enumerate() {
            let at = &mut bytes[Self::start(word, payload)..][..8];
            at.iter_mut().zip(ored.to_le_bytes()).for_each(|(to, from)| *to |= from);
        }
        bytes
    }
}

/// Are they equal? Number by number: as an array they would be stored apart and loaded together, for which the processor
/// waits.
#[inline]
fn same(a: [u64; 3], b: [u64; 3]) -> bool {
    (a[0] ^ b[0]) | (a[1] ^ b[1]) | (a[2] ^ b[2]) == 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::{Lattice, SourceGrid};
    use crate::points::{Attribute, Field};
    use proptest::prelude::*;

    fn plan(lattice: &Lattice, offset: [f64; 3], payload: usize) -> RowPlan {
        let grid = SourceGrid::from_f64([0.01, 0.02, 0.01], offset).unwrap();
        let mut fields = Vec::new();
        for (i, name) in ["Red", "Green", "Blue"].into_iter().enumerate().filter(|(i, _)| 2 * i + 3 <= payload) {
            let field = Field { offset: 2 * i + 1, kind: FieldKind::Whole };
            fields.push((Attribute::new(name, ScalarType::U16), field));
        }
        let layout = RecordLayout::new(PositionKind::Grid, payload, fields);
        RowPlan::new(0, layout, SourceMap::new(&grid, lattice))
    }

    type Rows = Vec<(Cube, Vec<Vec<u8>>)>;

    fn partitioned(
        lattice: &Lattice,
        plan: &RowPlan,
        k: u8,
        take: impl FnOnce(&mut Sorter<'_, '_>),
    ) -> (ScanTally, Rows) {
        let partition = Partition::new(lattice, None, k, false);
        let mut sorter = partition.sorter(plan);
        take(&mut sorter);
        let tally = sorter.finish().unwrap();
        let rows = partition.finish().into_iter().map(|bucket| {
            let bytes = bucket.segments.iter().flat_map(|s| match &s.place {
                Place::Memory(bytes) => bytes.chunks_exact(8 + plan.layout.payload).map(<[u8]>::to_vec),
                _ => panic!("nothing is spilled"),
            });
            let mut rows: Vec<_> = bytes.collect();
            assert_eq!(rows.len() as u64, bucket.rows);
            rows.sort();
            (bucket.cube, rows)
        });
        (tally, rows.collect())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]
        #[test]
        fn blocks_of_records_become_the_rows_that_single_ones_do(
            n in 0_usize..1200, payload in 1_usize..70, k in 0_u8..=21, spread in 0_u32..32, from: i32, far in prop_oneof![Just(0), 0_usize..400],
            // The last two at the ends of the lattice.
            offset in prop::sample::select(vec![
                [0.0; 3], [500_000.0, 0.0, -500_000.0], [1e10, 0.0, -1e10],
                [1_876_499_844_737.0, 0.0, 0.0], [0.0, 500_000.0, -938_249_922_368.0],
            ]),
            seed: u64,
        ) {
            let lattice = Lattice::uniform(0.01).unwrap();
            let plan = plan(&lattice, offset, payload);
            prop_assert!(plan.map.as_ref().unwrap().affine().is_some());
            let mut state = seed | 1;
            let mut next = || { state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407); (state >> 32) as u32 };
            let mut records = Vec::new();
            for i in 0..n {
                for _ in 0..3 {
                    // Some far from the others; of some, the coordinates are outside of the lattice.
                    let x = if far > 0 && i % far == 1 { next() as i32 } else { from.wrapping_add((next() & ((1 << spread) - 1)) as i32) };
                    records.extend(x.to_le_bytes());
                }
                records.extend((0..payload).map(|_| next() as u8));
            }
            let fast = partitioned(&lattice, &plan, k, |sorter| sorter.take::<u64>(&records, usize::MAX).unwrap());
            let naive = partitioned(&lattice, &plan, k, |sorter| {
                sorter.take_one_by_one::<u64, 0>(&records).unwrap();
                sorter.tally.read = n as u64;
            });
            prop_assert_eq!(format!("{:?}", fast.0), format!("{:?}", naive.0));
            prop_assert_eq!(fast.0.read, n as u64);
            prop_assert!(fast.1 == naive.1);
        }
    }
    // In a volume of 20 million points in no order, most segments were of a single row, and took more memory than the rows.
    #[test]
    fn points_in_no_order_come_to_fewer_and_larger_buckets() {
        let lattice = Lattice::uniform(0.01).unwrap();
        let plan = plan(&lattice, [0.0; 3], 9);
        let mut state = 1_u64;
        let mut records = Vec::new();
        let n = 60_000;
        for i in 0..n {
            for _ in 0..3 {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                records.extend(((state >> 44) as i32).to_le_bytes());
            }
            records.extend([i as u8; 9]);
        }
        // Cubes of 2^16 steps: 4096 of them, of which a buffer each is much more than what may be open.
        let partition = Partition::new(&lattice, None, 16, false);
        let mut sorter = partition.sorter(&plan);
        for piece in records.chunks(1000 * plan.layout.stride()) {
            sorter.take::<u64>(piece, 256 << 10).unwrap();
        }
        assert_eq!(sorter.finish().unwrap().stored, n);
        let buckets = partition.finish();
        assert_eq!(buckets.iter().map(|b| b.rows).sum::<u64>(), n);
        assert!(buckets.iter().all(|b| b.cube.k() > 17), "8 to 64 times as large");
        let segments: usize = buckets.iter().map(|b| b.segments.len()).sum();
        assert!(segments < n as usize / 20, "{segments} segments");
    }
}

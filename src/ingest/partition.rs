//! From records to buckets: moves points to the lattice, keys them, and hands each row to the bucket of its cube.
//!
//! Buckets are aligned cubes of one exponent `k`, chosen from the sources' bounds. Headers may lie: where that makes too
//! many buckets, `k` is raised while reading and the buckets so far are joined.

use super::IngestError;
use super::rows::RowKey;
use super::spill::Spill;
use crate::lattice::{BITS, Cube, LOW_DIGITS, Lattice, LatticeBox, LatticePoint, SourceMap};
use crate::points::{FieldKind, PositionKind, RecordLayout, ScalarType};
use crate::store::model::Rejected;
use std::collections::HashMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU8, Ordering};

/// Bytes of a bucket's first buffer; each next one is twice the size, up to [`LARGEST_BUFFER`]. Buffers are handed over
/// when they are full and never grow: fresh memory is dear, and one that doubles in place touches it twice.
const FIRST_BUFFER: usize = 4 << 10;
const LARGEST_BUFFER: usize = 64 << 10;
/// More buckets than this are joined eight to one.
const MOST_BUCKETS: usize = 1 << 15;

/// How the points of one scan become rows.
#[derive(Debug)]
pub(super) struct RowPlan {
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

    /// The same scan with its records in canonical form, after a lattice position.
    pub fn canonical(&self) -> Self {
        let layout = RecordLayout::canonical(PositionKind::Lattice, self.layout.attributes.iter().cloned());
        Self::new(self.slot, layout, None)
    }
}

/// What became of the records of a scan.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ScanTally {
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

/// Rows of one scan in one bucket.
#[derive(Debug)]
pub(super) struct Segment {
    pub slot: u32,
    pub rows: u32,
    pub place: Place,
}

/// Where a segment's bytes are.
#[derive(Debug)]
pub(super) enum Place {
    Memory(Vec<u8>),
    Spilled { offset: u64, bytes: usize },
}

/// All rows of one cube.
#[derive(Debug)]
pub(super) struct Bucket {
    pub cube: Cube,
    pub rows: u64,
    pub segments: Vec<Segment>,
}

/// The buckets while they are being filled, by several threads.
pub(super) struct Partition<'a> {
    lattice: &'a Lattice,
    spill: Option<&'a Spill>,
    k: AtomicU8,
    /// The largest exponent that the row keys allow.
    largest_k: u8,
    buckets: Mutex<HashMap<Cube, Vec<Segment>>>,
}

impl<'a> Partition<'a> {
    /// `k`: the buckets' exponent to begin with.
    pub fn new(lattice: &'a Lattice, spill: Option<&'a Spill>, k: u8, wide: bool) -> Self {
        let largest_k = if wide { BITS } else { LOW_DIGITS };
        let k = AtomicU8::new(k.min(largest_k));
        Self { lattice, spill, k, largest_k, buckets: Mutex::default() }
    }

    /// A worker for one scan.
    pub fn sorter<'b>(&'b self, plan: &'b RowPlan) -> Sorter<'a, 'b> {
        let k = self.k.load(Ordering::Relaxed);
        let affine = plan.map.as_ref().and_then(SourceMap::affine);
        Sorter {
            partition: self,
            plan,
            affine,
            k,
            open: Vec::new(),
            by_corner: HashMap::new(),
            current: usize::MAX,
            open_bytes: 0,
            tally: ScanTally::default(),
            min: [u64::MAX; 3],
            max: [0; 3],
        }
    }

    fn hand_over(&self, cube: Cube, segment: Segment) -> Result<(), IngestError> {
        let segment = match (self.spill, segment.place) {
            (Some(spill), Place::Memory(bytes)) => {
                let offset = spill.append(&bytes)?;
                Segment { place: Place::Spilled { offset, bytes: bytes.len() }, ..segment }
            }
            (_, place) => Segment { place, ..segment },
        };
        let mut buckets = lock(&self.buckets);
        buckets.entry(cube).or_default().push(segment);
        if buckets.len() > MOST_BUCKETS {
            let k = self.k.load(Ordering::Relaxed);
            if k < self.largest_k {
                self.k.store(k + 1, Ordering::Relaxed);
                *buckets = join(std::mem::take(&mut *buckets), k + 1);
            }
        }
        Ok(())
    }

    /// The buckets in key order. Cubes are disjoint.
    pub fn finish(self) -> Vec<Bucket> {
        let k = self.k.into_inner();
        let buckets = self.buckets.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
        let mut buckets: Vec<_> = join(buckets, k)
            .into_iter()
            .map(|(cube, mut segments)| {
                // Which thread came first must not matter to anything; it doesn't to the result, and sorted it doesn't
                // to the time either.
                segments.sort_by_key(|s| s.slot);
                Bucket { cube, rows: segments.iter().map(|s| u64::from(s.rows)).sum(), segments }
            })
            .collect();
        buckets.sort_by_key(|b| b.cube.first_key());
        buckets
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    // A panic elsewhere ends the ingest; the buckets themselves are whole after every statement.
    mutex.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

fn join(buckets: HashMap<Cube, Vec<Segment>>, k: u8) -> HashMap<Cube, Vec<Segment>> {
    let mut joined: HashMap<Cube, Vec<Segment>> = HashMap::new();
    for (cube, mut segments) in buckets {
        joined.entry(cube.ancestor(k)).or_default().append(&mut segments);
    }
    joined
}

struct Open {
    corner: [u64; 3],
    rows: u32,
    bytes: Vec<u8>,
    /// Size of the next buffer.
    next_bytes: usize,
}

/// Turns records of one scan into rows of buckets; one thread has one for all pieces of a scan.
pub(super) struct Sorter<'a, 'b> {
    partition: &'b Partition<'a>,
    plan: &'b RowPlan,
    affine: Option<[(i64, i64); 3]>,
    k: u8,
    open: Vec<Open>,
    by_corner: HashMap<[u64; 3], usize>,
    current: usize,
    open_bytes: usize,
    tally: ScanTally,
    min: [u64; 3],
    max: [u64; 3],
}

impl Sorter<'_, '_> {
    /// Takes a run of whole records; `most_open_bytes` limits what is held in buffers that are not full yet.
    pub fn take<K: RowKey>(&mut self, records: &[u8], most_open_bytes: usize) -> Result<(), IngestError> {
        let stride = self.plan.layout.stride();
        let head = self.plan.layout.position.size();
        for record in records.chunks_exact(stride) {
            let (position, payload) = record.split_at(head);
            self.tally.read += 1;
            let Some(point) = self.position(position) else { continue };
            self.tally.stored += 1;
            for axis in 0..3 {
                self.min[axis] = self.min[axis].min(point.0[axis]);
                self.max[axis] = self.max[axis].max(point.0[axis]);
            }
            if let Some(offsets) = self.plan.color_offsets {
                for o in offsets {
                    self.tally.color_bits |= u16::from_le_bytes([payload[o], payload[o + 1]]);
                }
            }
            self.push::<K>(point, payload)?;
        }
        if self.open_bytes > most_open_bytes {
            self.flush()?;
        }
        Ok(())
    }

    #[inline]
    fn position(&mut self, bytes: &[u8]) -> Option<LatticePoint> {
        match self.plan.layout.position {
            PositionKind::Grid => {
                let x: [i32; 3] = std::array::from_fn(|i| {
                    i32::from_le_bytes([bytes[4 * i], bytes[4 * i + 1], bytes[4 * i + 2], bytes[4 * i + 3]])
                });
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

    #[inline]
    fn push<K: RowKey>(&mut self, point: LatticePoint, payload: &[u8]) -> Result<(), IngestError> {
        let corner = point.0.map(|c| c >> self.k);
        if self.open.get(self.current).is_none_or(|o| o.corner != corner) {
            self.current = *self.by_corner.entry(corner).or_insert_with(|| {
                self.open.push(Open { corner, rows: 0, bytes: Vec::new(), next_bytes: FIRST_BUFFER });
                self.open.len() - 1
            });
        }
        let row_bytes = K::BYTES + payload.len();
        let open = &mut self.open[self.current];
        if open.bytes.capacity() == 0 {
            open.bytes.reserve_exact(open.next_bytes.max(row_bytes));
            open.next_bytes = (2 * open.next_bytes).min(LARGEST_BUFFER);
            self.open_bytes += open.bytes.capacity();
        }
        K::of(point).push(&mut open.bytes);
        open.bytes.extend_from_slice(payload);
        open.rows += 1;
        if open.bytes.len() + row_bytes > open.bytes.capacity() {
            let (rows, bytes) = (std::mem::take(&mut open.rows), std::mem::take(&mut open.bytes));
            self.open_bytes -= bytes.capacity();
            self.hand_over(corner, rows, bytes)?;
        }
        Ok(())
    }

    fn hand_over(&self, corner: [u64; 3], rows: u32, bytes: Vec<u8>) -> Result<(), IngestError> {
        let cube = Cube::containing(LatticePoint(corner.map(|c| c << self.k)), self.k);
        self.partition.hand_over(cube, Segment { slot: self.plan.slot, rows, place: Place::Memory(bytes) })
    }

    fn flush(&mut self) -> Result<(), IngestError> {
        self.by_corner.clear();
        self.current = usize::MAX;
        self.open_bytes = 0;
        for open in std::mem::take(&mut self.open) {
            if open.rows > 0 {
                let mut bytes = open.bytes;
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

/// The exponent at which about `wanted` cubes are occupied by a surface with these bounds, and whether row keys must be
/// wide because the site has too many cubes of 21 levels.
pub(super) fn bucket_exponent(bounds: &LatticeBox, wanted: u64) -> (u8, bool) {
    let occupied = |k: u8| {
        let n: [u128; 3] = std::array::from_fn(|i| u128::from((bounds.max.0[i] >> k) - (bounds.min.0[i] >> k)) + 1);
        // A volume has at most n0 n1 n2 cubes, a surface about as many as its shadows.
        (n[0] * n[1] * n[2]).min(n[0] * n[1] + n[1] * n[2] + n[0] * n[2])
    };
    let wide = occupied(LOW_DIGITS) > 4096;
    let largest = if wide { BITS } else { LOW_DIGITS };
    let k = (0..=largest).rev().find(|&k| occupied(k) >= u128::from(wanted)).unwrap_or(0);
    (k, wide)
}

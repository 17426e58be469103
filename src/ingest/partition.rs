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
/// when they are full and never grow: fresh memory is dear, and one that doubles in place touches it twice. (What is
/// fresh is zero already.)
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
            recent: [usize::MAX; RECENT],
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
    /// The buffer: room for whole rows, of which `used` bytes are taken. Empty if there is none.
    bytes: Vec<u8>,
    used: usize,
    /// Size of the next buffer.
    next_bytes: usize,
}

/// Buckets that were looked up last, by a few bits of their corner.
const RECENT: usize = 64;

/// What becomes of the points of a run of records.
struct RunTally {
    stored: u64,
    min: [u64; 3],
    max: [u64; 3],
    color_bits: u16,
}

/// Turns records of one scan into rows of buckets; one thread has one for all pieces of a scan.
pub(super) struct Sorter<'a, 'b> {
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
    tally: ScanTally,
    min: [u64; 3],
    max: [u64; 3],
}

impl Sorter<'_, '_> {
    /// Takes a run of whole records; `most_open_bytes` limits what is held in buffers that are not full yet.
    pub fn take<K: RowKey>(&mut self, records: &[u8], most_open_bytes: usize) -> Result<(), IngestError> {
        // A call to copy so few bytes takes longer than the copy: whole words of 8, the last two of which may overlap, and
        // as many of them as the compiler knows.
        match self.plan.layout.payload {
            0..8 => self.take_run::<K, 0>(records),
            8 => self.take_run::<K, 1>(records),
            9..=16 => self.take_run::<K, 2>(records),
            17..=24 => self.take_run::<K, 3>(records),
            25..=32 => self.take_run::<K, 4>(records),
            33..=40 => self.take_run::<K, 5>(records),
            41..=48 => self.take_run::<K, 6>(records),
            _ => self.take_run::<K, 0>(records),
        }?;
        if self.open_bytes > most_open_bytes {
            self.flush()?;
        }
        Ok(())
    }

    /// Takes records whose payload is copied as so many words, or in any way if that is 0.
    fn take_run<K: RowKey, const WORDS: usize>(&mut self, records: &[u8]) -> Result<(), IngestError> {
        let stride = self.plan.layout.stride();
        let head = self.plan.layout.position.size();
        let colors = self.plan.color_offsets;
        let mut run = RunTally { stored: 0, min: [u64::MAX; 3], max: [0; 3], color_bits: 0 };
        for record in records.chunks_exact(stride) {
            let (position, payload) = record.split_at(head);
            let Some(point) = self.position(position) else { continue };
            run.stored += 1;
            for axis in 0..3 {
                run.min[axis] = run.min[axis].min(point.0[axis]);
                run.max[axis] = run.max[axis].max(point.0[axis]);
            }
            if let Some(offsets) = colors {
                for o in offsets {
                    run.color_bits |= u16::from_le_bytes([payload[o], payload[o + 1]]);
                }
            }
            self.push::<K, WORDS>(point, payload)?;
        }
        self.tally.read += (records.len() / stride) as u64;
        self.tally.stored += run.stored;
        self.tally.color_bits |= run.color_bits;
        for axis in 0..3 {
            self.min[axis] = self.min[axis].min(run.min[axis]);
            self.max[axis] = self.max[axis].max(run.max[axis]);
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
    fn push<K: RowKey, const WORDS: usize>(&mut self, point: LatticePoint, payload: &[u8]) -> Result<(), IngestError> {
        let corner = point.0.map(|c| c >> self.k);
        if self.open.get(self.current).is_none_or(|o| !same(o.corner, corner)) {
            self.turn_to(corner);
        }
        let row_bytes = K::BYTES + payload.len();
        let open = &mut self.open[self.current];
        if open.bytes.is_empty() {
            let rows = (open.next_bytes / row_bytes).max(1);
            open.next_bytes = (2 * open.next_bytes).min(LARGEST_BUFFER);
            open.bytes = vec![0; rows * row_bytes];
            self.open_bytes += open.bytes.len();
        }
        let row = &mut open.bytes[open.used..open.used + row_bytes];
        K::of(point).write(row);
        copy_payload::<WORDS>(payload, &mut row[K::BYTES..]);
        open.used += row_bytes;
        open.rows += 1;
        if open.used == open.bytes.len() {
            open.used = 0;
            let (rows, bytes) = (std::mem::take(&mut open.rows), std::mem::take(&mut open.bytes));
            self.open_bytes -= bytes.len();
            self.hand_over(corner, rows, bytes)?;
        }
        Ok(())
    }

    /// Makes the bucket at `corner` the current one.
    fn turn_to(&mut self, corner: [u64; 3]) {
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

    fn hand_over(&self, corner: [u64; 3], rows: u32, bytes: Vec<u8>) -> Result<(), IngestError> {
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

/// Are they equal? Number by number: as an array they would be stored apart and loaded together, for which the processor
/// waits.
#[inline]
fn same(a: [u64; 3], b: [u64; 3]) -> bool {
    (a[0] ^ b[0]) | (a[1] ^ b[1]) | (a[2] ^ b[2]) == 0
}

/// Copies a payload of more than `8 * (WORDS - 1)` bytes and at most `8 * WORDS`; of any size if `WORDS` is 0.
#[inline]
fn copy_payload<const WORDS: usize>(from: &[u8], to: &mut [u8]) {
    if WORDS == 0 {
        to.copy_from_slice(from);
        return;
    }
    let mut copy = |start: usize| to[start..start + 8].copy_from_slice(&from[start..start + 8]);
    for word in 0..WORDS - 1 {
        copy(8 * word);
    }
    copy(from.len() - 8);
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

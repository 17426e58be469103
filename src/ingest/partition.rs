//! From records to buckets: every row comes to the bucket of its cube, from whichever thread ([`sorter`] makes the rows).
//!
//! Buckets are aligned cubes of one exponent `k`, chosen from the sources' bounds as for a surface whose points come in
//! some order. Headers may lie, and points may fill a volume and come in none: where there are too many buckets, or what
//! they get is too little at a time, `k` is raised while reading and the buckets so far are joined.

mod sorter;

pub(super) use sorter::{RowPlan, ScanTally, Sorter};

use super::IngestError;
use super::gather::ScanColumns;
use super::rows::RowKey;
use super::spill::{Place, Spill};
use crate::lattice::{BITS, Cube, LOW_DIGITS, Lattice, LatticeBox};
use std::collections::HashMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU8, Ordering};

/// More buckets than this are joined eight to one.
const MOST_BUCKETS: usize = 1 << 15;

/// Rows of one scan in one bucket.
#[derive(Debug)]
pub(super) struct Segment {
    pub slot: u32,
    pub rows: u32,
    /// Where its bytes are.
    pub place: Place,
}

impl Segment {
    /// Bytes of a row, with its key.
    pub fn row_bytes<K: RowKey>(&self, scans: &[ScanColumns<'_>]) -> usize {
        K::BYTES + scans[self.slot as usize].plan.layout.payload
    }
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
        Sorter::new(self, plan)
    }

    fn hand_over(&self, cube: Cube, segment: Segment) -> Result<(), IngestError> {
        let segment = match (self.spill, segment.place) {
            (Some(spill), Place::Memory(bytes)) => Segment { place: Place::Spilled(spill.append(&bytes)?), ..segment },
            (_, place) => Segment { place, ..segment },
        };
        let mut buckets = lock(&self.buckets);
        buckets.entry(cube).or_default().push(segment);
        if buckets.len() > MOST_BUCKETS {
            let k = self.k.load(Ordering::Relaxed);
            self.join_to(k + 1, &mut buckets);
        }
        Ok(())
    }

    /// Joins buckets eight to one, if they are still of exponent `k` and may be larger.
    fn coarsen(&self, k: u8) {
        let mut buckets = lock(&self.buckets);
        if k == self.k.load(Ordering::Relaxed) {
            self.join_to(k + 1, &mut buckets);
        }
    }

    fn join_to(&self, k: u8, buckets: &mut HashMap<Cube, Vec<Segment>>) {
        if k <= self.largest_k {
            self.k.store(k, Ordering::Relaxed);
            *buckets = join(std::mem::take(buckets), k);
        }
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

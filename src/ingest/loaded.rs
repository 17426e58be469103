//! The rows of one bucket in canonical order, where they lie; and those that leave it for coarser nodes.

use super::IngestError;
use super::gather::ScanColumns;
use super::partition::{Bucket, Place, Segment};
use super::rows::{PairSorter, RowKey};
use super::spill::Spill;
use crate::lattice::Cube;
use std::cmp::Ordering;

/// Payloads of rows of several scans, addressed by a number each.
#[derive(Debug, Default)]
pub(super) struct Payloads {
    bytes: Vec<u8>,
    runs: Vec<PayloadRun>,
}

/// Payloads of one scan that lie together.
#[derive(Clone, Copy, Debug)]
struct PayloadRun {
    slot: u32,
    first: u32,
    start: usize,
    payload: usize,
}

impl Payloads {
    /// The scan and the payload of row `row`.
    #[inline]
    pub fn row(&self, row: u32) -> (u32, &[u8]) {
        let run = match self.runs.as_slice() {
            [only] => only,
            runs => &runs[runs.partition_point(|r| r.first <= row) - 1],
        };
        let start = run.start + (row - run.first) as usize * run.payload;
        (run.slot, &self.bytes[start..start + run.payload])
    }

    fn push(&mut self, row: u32, slot: u32, payload: &[u8]) {
        if self.runs.last().is_none_or(|r| r.slot != slot) {
            self.runs.push(PayloadRun { slot, first: row, start: self.bytes.len(), payload: payload.len() });
        }
        self.bytes.extend_from_slice(payload);
    }
}

/// Rows of several scans where they lie, addressed by a number each.
#[derive(Debug)]
pub(super) struct Rows<'a> {
    runs: Vec<Run<'a>>,
    /// A row's number is that of its run, shifted by so many bits, and its place in it.
    shift: u32,
    key_bytes: usize,
}

/// Rows of one scan that lie together.
#[derive(Clone, Copy, Debug)]
struct Run<'a> {
    slot: u32,
    row_bytes: usize,
    bytes: &'a [u8],
}

impl<'a> Rows<'a> {
    /// `None` if there are too many to number.
    fn new(runs: Vec<Run<'a>>, key_bytes: usize) -> Option<Self> {
        let most = runs.iter().map(|r| r.bytes.len() / r.row_bytes).max().unwrap_or(0).max(1);
        let shift = usize::BITS - (most - 1).leading_zeros();
        let rows = (runs.len() as u64).checked_shl(shift).filter(|_| shift < u32::BITS)?;
        (rows <= 1 << u32::BITS).then_some(Self { runs, shift, key_bytes })
    }

    /// The scan and the payload of row `row`.
    #[inline]
    pub fn row(&self, row: u32) -> (u32, &'a [u8]) {
        let run = self.runs[(row >> self.shift) as usize];
        let start = (row & ((1 << self.shift) - 1)) as usize * run.row_bytes;
        (run.slot, &run.bytes[start + self.key_bytes..start + run.row_bytes])
    }

    /// The payloads of `rows`, copied, numbered from zero in that order.
    pub fn picked(&self, rows: impl Iterator<Item = u32>) -> Payloads {
        let mut picked = Payloads::default();
        for (number, row) in (0..).zip(rows) {
            let (slot, payload) = self.row(row);
            picked.push(number, slot, payload);
        }
        picked
    }
}

/// Buffers that live from bucket to bucket.
#[derive(Debug, Default)]
pub(super) struct LoadScratch<K> {
    /// Spilled rows that were read back.
    spilled: Vec<u8>,
    segment: Vec<u8>,
    pairs: Vec<(K, u32)>,
    sorter: PairSorter<K>,
    keys: Vec<K>,
    order: Vec<u32>,
}

/// A bucket, sorted.
#[derive(Debug)]
pub(super) struct Loaded<'a, K> {
    pub keys: &'a [K],
    /// The number of each point's row.
    pub order: &'a [u32],
    pub rows: Rows<'a>,
}

/// Calls `each` with the key of every row of `bucket`, segment by segment.
pub(super) fn for_each_key<K: RowKey>(
    bucket: &Bucket,
    scans: &[ScanColumns<'_>],
    spill: Option<&Spill>,
    mut each: impl FnMut(K),
) -> Result<(), IngestError> {
    let mut buffer = Vec::new();
    for segment in &bucket.segments {
        let bytes = match &segment.place {
            Place::Memory(bytes) => bytes.as_slice(),
            Place::Spilled { offset, bytes } => {
                buffer.clear();
                read_back(spill, *offset, *bytes, &mut buffer)?;
                &buffer
            }
        };
        bytes.chunks_exact(row_bytes::<K>(segment, scans)).for_each(|row| each(K::read(row)));
    }
    Ok(())
}

fn row_bytes<K: RowKey>(segment: &Segment, scans: &[ScanColumns<'_>]) -> usize {
    K::BYTES + scans[segment.slot as usize].plan.layout.payload
}

/// Appends a spilled segment's bytes to `to`.
fn read_back(spill: Option<&Spill>, offset: u64, bytes: usize, to: &mut Vec<u8>) -> Result<(), IngestError> {
    let spill = spill.ok_or_else(|| IngestError::Internal("a spilled segment without a spill".into()))?;
    let start = to.len();
    to.resize(start + bytes, 0);
    spill.read(&mut to[start..], offset)
}

/// Finds the `rows` rows of `bucket` that lie in `cube` and sorts them by (key, record bytes, attributes, scan identity).
/// Rows that are in memory stay where they are.
pub(super) fn load<'a, K: RowKey>(
    bucket: &'a Bucket,
    cube: Cube,
    rows: u64,
    scans: &[ScanColumns<'_>],
    spill: Option<&Spill>,
    scratch: &'a mut LoadScratch<K>,
) -> Result<Loaded<'a, K>, IngestError> {
    let LoadScratch { spilled, segment: buffer, pairs, sorter, keys, order } = scratch;
    let all = rows == bucket.rows;
    let (first, last) = (cube.first_key(), cube.last_key());
    let of_bucket = bucket.cube.first_key();
    let inside = |key: K| all || (first..=last).contains(&key.full(of_bucket));
    // What is read back may be cut to the cube at once; it is addressed when it no longer moves.
    spilled.clear();
    let mut read = Vec::new();
    for segment in &bucket.segments {
        let Place::Spilled { offset, bytes } = segment.place else { continue };
        let (row_bytes, start) = (row_bytes::<K>(segment, scans), spilled.len());
        if all {
            read_back(spill, offset, bytes, spilled)?;
        } else {
            buffer.clear();
            read_back(spill, offset, bytes, buffer)?;
            let rows = buffer.chunks_exact(row_bytes).filter(|row| inside(K::read(row)));
            rows.for_each(|row| spilled.extend_from_slice(row));
        }
        read.push((segment.slot, row_bytes, start..spilled.len()));
    }
    let spilled: &[u8] = spilled;
    let in_memory = bucket.segments.iter().filter_map(|segment| match &segment.place {
        Place::Memory(bytes) => Some(Run { slot: segment.slot, row_bytes: row_bytes::<K>(segment, scans), bytes }),
        Place::Spilled { .. } => None,
    });
    let read = read.into_iter().map(|(slot, row_bytes, range)| Run { slot, row_bytes, bytes: &spilled[range] });
    let rows = Rows::new(in_memory.chain(read).collect(), K::BYTES)
        .ok_or_else(|| IngestError::Internal(format!("{rows} points on one place do not fit one bucket")))?;
    pairs.clear();
    for (number, run) in rows.runs.iter().enumerate() {
        // Checked by `Rows::new`.
        let number = (number << rows.shift) as u32;
        let keyed = (number..).zip(run.bytes.chunks_exact(run.row_bytes)).map(|(i, row)| (K::read(row), i));
        if all {
            pairs.extend(keyed);
        } else {
            pairs.extend(keyed.filter(|(key, _)| inside(*key)));
        }
    }
    sorter.sort(pairs, cube.k());
    settle_ties(pairs, &rows, scans);
    keys.clear();
    keys.extend(pairs.iter().map(|p| p.0));
    order.clear();
    order.extend(pairs.iter().map(|p| p.1));
    Ok(Loaded { keys, order, rows })
}

/// Settles runs of equal keys by record bytes, then attributes, then scan identity. Beyond that records are
/// interchangeable.
fn settle_ties<K: RowKey>(pairs: &mut [(K, u32)], rows: &Rows<'_>, scans: &[ScanColumns<'_>]) {
    for run in pairs.chunk_by_mut(|a, b| a.0 == b.0) {
        if run.len() < 2 {
            continue;
        }
        let mut tied: Vec<_> = run
            .iter()
            .map(|&(_, row)| {
                let mut bytes = Vec::new();
                let (slot, payload) = rows.row(row);
                scans[slot as usize].plan.layout.canonical_bytes(payload, &mut bytes);
                (bytes, slot, row)
            })
            .collect();
        tied.sort_by(|a, b| tie(a, b, scans));
        for (pair, (_, _, row)) in run.iter_mut().zip(tied) {
            pair.1 = row;
        }
    }
}

fn tie(a: &(Vec<u8>, u32, u32), b: &(Vec<u8>, u32, u32), scans: &[ScanColumns<'_>]) -> Ordering {
    let (x, y) = (&scans[a.1 as usize], &scans[b.1 as usize]);
    a.0.cmp(&b.0).then_with(|| x.signature.cmp(&y.signature)).then_with(|| x.identity.cmp(&y.identity))
}

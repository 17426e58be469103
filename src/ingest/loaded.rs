//! The rows of one bucket in canonical order; and those that leave it for coarser nodes.

use super::IngestError;
use super::gather::{RowSource, ScanColumns};
use super::partition::{Bucket, Place, Segment};
use super::rows::{RowKey, copy_payload, with_payload_words};
use super::sort::{Bins, Sorter};
use super::spill::Spill;
use crate::lattice::Cube;
use std::cmp::Ordering;
use std::ops::Range;

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

/// Rows of one cube without their keys, one after the other in key order, addressed by their number.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rows<'a> {
    bytes: &'a [u8],
    stride: usize,
    /// Bytes of the scan's number before each payload: none if all are of one scan.
    head: usize,
    /// The only scan.
    slot: u32,
    scans: &'a [ScanColumns<'a>],
}

/// Bytes of a buffer that are kept from job to job.
const SPARE_BYTES: usize = 256 << 20;

/// Bytes of a scan's number before a payload.
const SLOT_BYTES: usize = 4;

impl<'a> RowSource<'a> for Rows<'a> {
    #[inline(always)]
    fn row(&self, row: u32) -> (u32, &'a [u8]) {
        let start = row as usize * self.stride;
        let bytes = &self.bytes[start..start + self.stride];
        if self.head == 0 {
            return (self.slot, bytes);
        }
        let (slot, payload) = bytes.split_at(SLOT_BYTES);
        let slot = u32::from_le_bytes([slot[0], slot[1], slot[2], slot[3]]);
        (slot, &payload[..self.scans[slot as usize].plan.layout.payload])
    }
}

impl Rows<'_> {
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
    bins: Bins,
    sorter: Sorter<K>,
    keys: Vec<K>,
    order: Vec<u32>,
    /// Rows in their bins.
    scattered: Vec<u8>,
    /// Of [`Rows`].
    rows: Vec<u8>,
}

/// The rows of a cube, sorted.
#[derive(Debug)]
pub(super) struct Loaded<'a, K> {
    pub keys: &'a [K],
    /// Of the points in the order of their keys.
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

/// Rows of one scan that lie together, with their keys.
struct Run<'a> {
    slot: u32,
    row_bytes: usize,
    bytes: &'a [u8],
}

/// Finds the `rows` rows of `bucket` that lie in `cube` and sorts them by (key, record bytes, attributes, scan identity).
/// They are copied, so the bucket is no longer needed afterwards.
pub(super) fn load<'a, K: RowKey>(
    bucket: &Bucket,
    cube: Cube,
    rows: u64,
    scans: &'a [ScanColumns<'a>],
    spill: Option<&Spill>,
    scratch: &'a mut LoadScratch<K>,
) -> Result<Loaded<'a, K>, IngestError> {
    let LoadScratch { spilled, bins, sorter, keys, order, scattered, rows: bytes } = scratch;
    spilled.clear();
    let mut places = Vec::new();
    for segment in &bucket.segments {
        let start = spilled.len();
        if let Place::Spilled { offset, bytes } = segment.place {
            read_back(spill, offset, bytes, spilled)?;
        }
        places.push(start..spilled.len());
    }
    // What is read back is addressed when it no longer moves.
    let runs = bucket.segments.iter().zip(places).map(|(segment, place)| {
        let bytes = match &segment.place {
            Place::Memory(bytes) => bytes,
            Place::Spilled { .. } => &spilled[place],
        };
        Run { slot: segment.slot, row_bytes: row_bytes::<K>(segment, scans), bytes }
    });
    let runs: Vec<_> = runs.collect();

    let all = rows == bucket.rows;
    let (first, last) = (cube.first_key(), cube.last_key());
    let of_bucket = bucket.cube.first_key();
    let inside = |key: K| all || (first..=last).contains(&key.full(of_bucket));
    let too_many = || IngestError::Internal(format!("{rows} points on one place do not fit one bucket"));
    u32::try_from(rows).map_err(|_| too_many())?;
    bins.clear(cube.k(), rows as usize);
    for run in &runs {
        run.bytes.chunks_exact(run.row_bytes).map(K::read).filter(|key| inside(*key)).for_each(|key| bins.count(key));
    }
    let count = bins.counted();
    let slot = runs.first().map_or(0, |r| r.slot);
    let head = if runs.iter().all(|r| r.slot == slot) { 0 } else { SLOT_BYTES };
    let stride = head + runs.iter().map(|r| r.row_bytes - K::BYTES).max().unwrap_or(0);
    // Every place is overwritten; memory that was touched before is the cheapest.
    keys.resize(count, K::default());
    let needed = count.checked_mul(stride).ok_or_else(too_many)?;
    for bytes in [&mut *scattered, &mut *bytes] {
        if bytes.len() < needed {
            bytes.clear();
            bytes.resize(needed, 0);
        }
    }
    let mut scatter = Scatter { bins, keys, rows: &mut scattered[..needed], stride, head };
    for run in &runs {
        let payload = run.row_bytes - K::BYTES;
        let scatter = &mut scatter;
        with_payload_words!(payload, scatter_run::<K>(run, &inside, scatter));
    }
    drop(runs);
    if spilled.len() > SPARE_BYTES {
        // A job far beyond the others, whose points lie at one place.
        *spilled = Vec::new();
    }
    let (from, to) = (&scattered[..needed], &mut bytes[..needed]);
    sorter.sort(bins, keys, order, |bin, order| {
        with_payload_words!(stride, permute(stride, bin, order, from, to));
    });
    let record = |row: &[u8], out: &mut Vec<u8>| {
        let (slot, payload) = Rows { bytes: row, stride, head, slot, scans }.row(0);
        scans[slot as usize].plan.layout.canonical_bytes(payload, out);
    };
    let scan = |row: &[u8]| &scans[Rows { bytes: row, stride, head, slot, scans }.row(0).0 as usize];
    let order = |a: &[u8], b: &[u8]| {
        let (a, b) = (scan(a), scan(b));
        a.signature.cmp(&b.signature).then_with(|| a.identity.cmp(&b.identity))
    };
    settle_ties(keys, (&mut bytes[..needed], &mut scattered[..needed]), stride, record, order);
    let rows = Rows { bytes: &bytes[..needed], stride, head, slot, scans };
    Ok(Loaded { keys, rows })
}

/// Puts the rows of a bin in order: the one at place `i` of the bin comes from place `order[i]` of all.
fn permute<const WORDS: usize>(stride: usize, bin: Range<usize>, order: &[u32], from: &[u8], to: &mut [u8]) {
    // Read once from its start to its end, the bin is in the fastest cache when its rows are picked.
    let bytes = bin.start * stride..bin.end * stride;
    std::hint::black_box(from[bytes.clone()].iter().step_by(64).fold(0, |sum, byte| sum ^ byte));
    if stride == 0 {
        return;
    }
    for (to, &place) in to[bytes].chunks_exact_mut(stride).zip(order) {
        copy_payload::<WORDS>(&from[place as usize * stride..][..stride], to);
    }
}

/// Where rows are scattered to.
struct Scatter<'a, K> {
    bins: &'a mut Bins,
    keys: &'a mut [K],
    rows: &'a mut [u8],
    stride: usize,
    head: usize,
}

fn scatter_run<K: RowKey, const WORDS: usize>(
    run: &Run<'_>,
    inside: &impl Fn(K) -> bool,
    Scatter { bins, keys, rows, stride, head }: &mut Scatter<'_, K>,
) {
    let payload = run.row_bytes - K::BYTES;
    for row in run.bytes.chunks_exact(run.row_bytes) {
        let key = K::read(row);
        if !inside(key) {
            continue;
        }
        let place = bins.place(key);
        keys[place] = key;
        let to = &mut rows[place * *stride..][..*head + payload];
        if *head > 0 {
            to[..SLOT_BYTES].copy_from_slice(&run.slot.to_le_bytes());
        }
        copy_payload::<WORDS>(&row[K::BYTES..], &mut to[*head..]);
    }
}

/// A row among those with its key: where its record is, and which of them it is.
struct Tied {
    start: usize,
    bytes: u32,
    row: u32,
}

/// Brings the rows of equal keys into the order of their records, and where these are equal into `order`: attributes, then scan
/// identity. Beyond that records are interchangeable. `spare` is as long as the rows, and is written over.
fn settle_ties<K: RowKey>(
    keys: &[K],
    (rows, spare): (&mut [u8], &mut [u8]),
    stride: usize,
    record: impl Fn(&[u8], &mut Vec<u8>),
    order: impl Fn(&[u8], &[u8]) -> Ordering,
) {
    if stride == 0 {
        return;
    }
    // One buffer for all records: there may be millions at one place.
    let (mut records, mut tied) = (Vec::new(), Vec::new());
    let mut start = 0;
    for run in keys.chunk_by(|a, b| a == b) {
        let place = start * stride..(start + run.len()) * stride;
        start += run.len();
        if run.len() == 1 {
            continue;
        }
        let (rows, spare) = (&mut rows[place.clone()], &mut spare[place]);
        spare.copy_from_slice(rows);
        records.clear();
        tied.clear();
        for (row, bytes) in (0..).zip(spare.chunks_exact(stride)) {
            let start = records.len();
            record(bytes, &mut records);
            tied.push(Tied { start, bytes: (records.len() - start) as u32, row });
        }
        let row = |t: &Tied| &spare[t.row as usize * stride..][..stride];
        let record = |t: &Tied| &records[t.start..][..t.bytes as usize];
        tied.sort_unstable_by(|a, b| {
            record(a).cmp(record(b)).then_with(|| order(row(a), row(b))).then_with(|| a.row.cmp(&b.row))
        });
        rows.chunks_exact_mut(stride).zip(&tied).for_each(|(to, t)| to.copy_from_slice(row(t)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn ties_are_in_the_order_of_their_records_then_of_their_scans(
            mut rows in prop::collection::vec((0_u64..6, [0_u8..3, 0..3, 0..4]), 0..200),
        ) {
            rows.sort_by_key(|row| row.0);
            let keys: Vec<u64> = rows.iter().map(|row| row.0).collect();
            let mut bytes: Vec<u8> = rows.iter().flat_map(|row| row.1).collect();
            let mut spare = vec![7; bytes.len()];
            // The record is the second byte and the first, the scan the third.
            let record = |row: &[u8], out: &mut Vec<u8>| out.extend([row[1], row[0]]);
            settle_ties(&keys, (&mut bytes, &mut spare), 3, record, |a, b| a[2].cmp(&b[2]));
            rows.sort_by_key(|(key, [a, b, scan])| (*key, *b, *a, *scan));
            prop_assert_eq!(bytes, rows.iter().flat_map(|row| row.1).collect::<Vec<_>>());
        }
    }
}

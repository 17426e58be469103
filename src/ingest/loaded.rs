//! The rows of one bucket in canonical order; and those that leave it for coarser nodes.

use super::IngestError;
use super::gather::{RowSource, ScanColumns};
use super::partition::Bucket;
use super::rows::{RowKey, copy_payload, with_payload_words};
use super::sort::{Bins, Sorter};
use super::spill::{Place, Spill};
use std::cmp::Ordering;
use std::ops::Range;

/// How rows without their keys lie one after the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RowForm {
    /// Bytes of a row.
    pub stride: usize,
    /// Bytes of the scan's number before each payload: none if all are of one scan.
    head: usize,
    /// The only scan.
    slot: u32,
}

impl RowForm {
    /// For rows of these scans, by slot and size of the payload, at least one.
    pub fn of(scans: impl Iterator<Item = (u32, usize)> + Clone) -> Self {
        let slot = scans.clone().next().map_or(0, |s| s.0);
        let head = if scans.clone().all(|s| s.0 == slot) { 0 } else { SLOT_BYTES };
        Self { stride: head + scans.map(|s| s.1).max().unwrap_or(0), head, slot }
    }

    /// A form for rows of all these forms.
    pub fn union(forms: impl Iterator<Item = Self> + Clone) -> Self {
        let Some(first) = forms.clone().next() else { return Self { stride: 0, head: 0, slot: 0 } };
        if forms.clone().all(|form| form == first) {
            return first;
        }
        let payload = forms.map(|form| form.stride - form.head).max().unwrap_or(0);
        Self { stride: SLOT_BYTES + payload, head: SLOT_BYTES, slot: first.slot }
    }

    /// The scan of a row of `stride` bytes, and its payload with what may be behind it.
    #[inline(always)]
    fn split(self, row: &[u8]) -> (u32, &[u8]) {
        if self.head == 0 {
            return (self.slot, row);
        }
        let (slot, payload) = row.split_at(SLOT_BYTES);
        (u32::from_le_bytes([slot[0], slot[1], slot[2], slot[3]]), payload)
    }

    /// Appends rows of the form `from`, of which this is a union, in this one: all `count` of `rows`.
    pub fn append(self, rows: &[u8], count: usize, from: Self, to: &mut Vec<u8>) {
        if self == from {
            to.extend_from_slice(rows);
            return;
        }
        for row in 0..count {
            let (slot, payload) = from.split(&rows[row * from.stride..][..from.stride]);
            let end = to.len() + self.stride;
            to.extend_from_slice(&slot.to_le_bytes());
            to.extend_from_slice(payload);
            to.resize(end, 0);
        }
    }
}

/// Rows of one cube without their keys, one after the other in key order, addressed by their number.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rows<'a> {
    pub bytes: &'a [u8],
    pub form: RowForm,
    pub scans: &'a [ScanColumns<'a>],
}

impl Rows<'_> {
    /// Row `row` as it lies there.
    #[inline(always)]
    pub fn whole(&self, row: u32) -> &[u8] {
        &self.bytes[row as usize * self.form.stride..][..self.form.stride]
    }
}

/// Bytes of a buffer that are kept from job to job.
const SPARE_BYTES: usize = 256 << 20;

/// Bytes of a scan's number before a payload.
const SLOT_BYTES: usize = 4;

impl<'a> RowSource<'a> for Rows<'a> {
    #[inline(always)]
    fn row(&self, row: u32) -> (u32, &'a [u8]) {
        let RowForm { stride, head, slot } = self.form;
        let start = row as usize * stride;
        let bytes = &self.bytes[start..start + stride];
        if head == 0 {
            return (slot, bytes);
        }
        let (slot, payload) = self.form.split(bytes);
        (slot, &payload[..self.scans[slot as usize].plan.layout.payload])
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

/// Rows of one scan that lie together, with their keys.
struct Run<'a> {
    slot: u32,
    row_bytes: usize,
    bytes: &'a [u8],
}

/// Sorts the rows of `bucket` by (key, record bytes, attributes, scan identity). They are copied, so the bucket is no longer
/// needed afterwards.
pub(super) fn load<'a, K: RowKey>(
    bucket: &Bucket,
    scans: &'a [ScanColumns<'a>],
    spill: Option<&Spill>,
    scratch: &'a mut LoadScratch<K>,
) -> Result<Loaded<'a, K>, IngestError> {
    let LoadScratch { spilled, bins, sorter, keys, order, scattered, rows: bytes } = scratch;
    let Bucket { cube, rows, ref segments } = *bucket;
    spilled.clear();
    let mut places = Vec::new();
    for segment in segments {
        let start = spilled.len();
        segment.place.read_spilled(spill, spilled)?;
        places.push(start..spilled.len());
    }
    // What is read back is addressed when it no longer moves.
    let runs = segments.iter().zip(places).map(|(segment, place)| {
        let bytes = match &segment.place {
            Place::Memory(bytes) => bytes,
            _ => &spilled[place],
        };
        Run { slot: segment.slot, row_bytes: segment.row_bytes::<K>(scans), bytes }
    });
    let runs: Vec<_> = runs.collect();

    let too_many = || IngestError::Internal(format!("{rows} points on one place do not fit one bucket"));
    u32::try_from(rows).map_err(|_| too_many())?;
    bins.clear(cube.k(), rows as usize);
    for run in &runs {
        run.bytes.chunks_exact(run.row_bytes).map(K::read).for_each(|key| bins.count(key));
    }
    let count = bins.counted();
    let form = RowForm::of(runs.iter().map(|r| (r.slot, r.row_bytes - K::BYTES)));
    let RowForm { stride, head, .. } = form;
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
        with_payload_words!(payload, scatter_run::<K>(run, scatter));
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
        let (slot, payload) = Rows { bytes: row, form, scans }.row(0);
        scans[slot as usize].plan.layout.canonical_bytes(payload, out);
    };
    let scan = |row: &[u8]| &scans[Rows { bytes: row, form, scans }.row(0).0 as usize];
    let order = |a: &[u8], b: &[u8]| {
        let (a, b) = (scan(a), scan(b));
        compare(&a.signature, &b.signature).then_with(|| a.identity.cmp(&b.identity))
    };
    settle_ties(keys, (&mut bytes[..needed], &mut scattered[..needed]), stride, record, order);
    let rows = Rows { bytes: &bytes[..needed], form, scans };
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
    Scatter { bins, keys, rows, stride, head }: &mut Scatter<'_, K>,
) {
    let payload = run.row_bytes - K::BYTES;
    for row in run.bytes.chunks_exact(run.row_bytes) {
        let key = K::read(row);
        let place = bins.place(key);
        keys[place] = key;
        let to = &mut rows[place * *stride..][..*head + payload];
        if *head > 0 {
            to[..SLOT_BYTES].copy_from_slice(&run.slot.to_le_bytes());
        }
        copy_payload::<WORDS>(&row[K::BYTES..], &mut to[*head..]);
    }
}

/// The order of bytes. Empty ones may be of a buffer without memory, and a comparison that looks there takes the processor 300 ns.
fn compare(a: &[u8], b: &[u8]) -> Ordering {
    if a.is_empty() || b.is_empty() { a.len().cmp(&b.len()) } else { a.cmp(b) }
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
            compare(record(a), record(b)).then_with(|| order(row(a), row(b))).then_with(|| a.row.cmp(&b.row))
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

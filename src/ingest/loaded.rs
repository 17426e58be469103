//! The rows of one bucket in memory, in canonical order; and those that leave it for coarser nodes.

use super::IngestError;
use super::gather::ScanColumns;
use super::partition::{Bucket, Place, Segment};
use super::rows::{RowKey, sort_pairs};
use super::spill::Spill;
use crate::lattice::Cube;
use std::cmp::Ordering;
use std::sync::Arc;

/// Payloads of rows of several scans, addressed by a number each.
#[derive(Debug, Default)]
pub(super) struct Payloads {
    bytes: Vec<u8>,
    runs: Vec<Run>,
}

/// Rows of one scan that lie together.
#[derive(Clone, Copy, Debug)]
struct Run {
    slot: u32,
    first: u32,
    start: usize,
    payload: usize,
}

impl Payloads {
    /// Begins a run of rows of one scan.
    fn begin(&mut self, slot: u32, first: u32, payload: usize) {
        if self.runs.last().is_none_or(|r| r.slot != slot) {
            self.runs.push(Run { slot, first, start: self.bytes.len(), payload });
        }
    }

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

    /// The payloads of `rows`, copied, numbered from zero in that order.
    pub fn picked(&self, rows: impl Iterator<Item = u32>) -> Self {
        let mut picked = Self::default();
        for (first, row) in (0_u32..).zip(rows) {
            let (slot, payload) = self.row(row);
            picked.begin(slot, first, payload.len());
            picked.bytes.extend_from_slice(payload);
        }
        picked
    }
}

/// A bucket, sorted.
#[derive(Debug)]
pub(super) struct Loaded<K> {
    pub keys: Vec<K>,
    /// The number of each point's payload.
    pub order: Vec<u32>,
    pub payloads: Payloads,
}

/// Calls `each` with the key and the payload of every row of `bucket`, segment by segment.
pub(super) fn for_each_row<K: RowKey>(
    bucket: &Bucket,
    scans: &[ScanColumns<'_>],
    spill: Option<&Spill>,
    mut each: impl FnMut(K, Row<'_>),
) -> Result<(), IngestError> {
    let mut buffer = Vec::new();
    for segment in &bucket.segments {
        rows_of(segment, scans, spill, &mut buffer, &mut each)?;
    }
    Ok(())
}

/// One row without its key.
pub(super) struct Row<'a> {
    slot: u32,
    payload: &'a [u8],
}

fn rows_of<K: RowKey>(
    segment: &Segment,
    scans: &[ScanColumns<'_>],
    spill: Option<&Spill>,
    buffer: &mut Vec<u8>,
    each: &mut impl FnMut(K, Row<'_>),
) -> Result<(), IngestError> {
    let bytes = match &segment.place {
        Place::Memory(bytes) => bytes.as_slice(),
        Place::Spilled { offset, bytes } => {
            let spill = spill.ok_or_else(|| IngestError::Internal("a spilled segment without a spill".into()))?;
            buffer.resize(*bytes, 0);
            spill.read(buffer, *offset)?;
            buffer.as_slice()
        }
    };
    let payload = scans[segment.slot as usize].plan.layout.payload;
    for row in bytes.chunks_exact(K::BYTES + payload) {
        each(K::read(row), Row { slot: segment.slot, payload: &row[K::BYTES..] });
    }
    Ok(())
}

/// Reads the `rows` rows of `bucket` that lie in `cube` and sorts them by (key, record bytes, attributes, scan
/// identity). A bucket that nobody else needs gives its memory back segment by segment.
pub(super) fn load<K: RowKey>(
    bucket: Arc<Bucket>,
    cube: Cube,
    rows: u64,
    scans: &[ScanColumns<'_>],
    spill: Option<&Spill>,
) -> Result<Loaded<K>, IngestError> {
    let whole = rows == bucket.rows;
    let capacity = u32::try_from(rows)
        .map_err(|_| IngestError::Internal(format!("{rows} points on one place do not fit one bucket")))?;
    let mut pairs: Vec<(K, u32)> = Vec::with_capacity(capacity as usize);
    let mut payloads = Payloads::default();
    let bucket_cube = bucket.cube;
    let (first, last) = (cube.first_key(), cube.last_key());
    let mut take = |key: K, row: Row<'_>| {
        if whole || (first..=last).contains(&key.full(bucket_cube)) {
            let number = pairs.len() as u32;
            if number == 0 {
                payloads.bytes.reserve_exact(capacity as usize * row.payload.len());
            }
            payloads.begin(row.slot, number, row.payload.len());
            payloads.bytes.extend_from_slice(row.payload);
            pairs.push((key, number));
        }
    };
    let mut buffer = Vec::new();
    match Arc::try_unwrap(bucket) {
        Ok(owned) => {
            for segment in owned.segments {
                rows_of(&segment, scans, spill, &mut buffer, &mut take)?;
            }
        }
        Err(shared) => {
            for segment in &shared.segments {
                rows_of(segment, scans, spill, &mut buffer, &mut take)?;
            }
        }
    }
    let pairs = in_canonical_order(sort_pairs(pairs, cube.k()), &payloads, scans);
    let (keys, order) = pairs.into_iter().unzip();
    Ok(Loaded { keys, order, payloads })
}

/// Settles runs of equal keys by record bytes, then attributes, then scan identity. Beyond that records are
/// interchangeable.
fn in_canonical_order<K: RowKey>(
    mut pairs: Vec<(K, u32)>,
    payloads: &Payloads,
    scans: &[ScanColumns<'_>],
) -> Vec<(K, u32)> {
    let mut start = 0;
    while start < pairs.len() {
        let key = pairs[start].0;
        let end = start + pairs[start..].iter().take_while(|p| p.0 == key).count();
        if end - start > 1 {
            let mut tied: Vec<_> = pairs[start..end]
                .iter()
                .map(|&(_, row)| {
                    let mut bytes = Vec::new();
                    let (slot, payload) = payloads.row(row);
                    scans[slot as usize].plan.layout.canonical_bytes(payload, &mut bytes);
                    (bytes, slot, row)
                })
                .collect();
            tied.sort_by(|a, b| tie(a, b, scans));
            for (pair, (_, _, row)) in pairs[start..end].iter_mut().zip(tied) {
                pair.1 = row;
            }
        }
        start = end;
    }
    pairs
}

fn tie(a: &(Vec<u8>, u32, u32), b: &(Vec<u8>, u32, u32), scans: &[ScanColumns<'_>]) -> Ordering {
    let (x, y) = (&scans[a.1 as usize], &scans[b.1 as usize]);
    a.0.cmp(&b.0).then_with(|| x.signature.cmp(&y.signature)).then_with(|| x.identity.cmp(&y.identity))
}

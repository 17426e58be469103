//! A point on its way through a changing tree: its key, its record, its scan.

use super::super::IngestError;
use super::super::gather::{ScanColumns, Scratch, gather};
use super::super::partition::{Bucket, Place, Segment};
use super::super::rows::RowKey;
use crate::lattice::{Cube, Key};
use crate::octree::TreePoint;
use crate::store::PointColumns;
use crate::store::model::ScanId;
use rayon::prelude::*;
use std::collections::HashMap;

/// A point of a tree. The order of its fields is the canonical order of points: key, canonical record bytes, then the
/// scan by its place in [`ScanOrder`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(in super::super) struct Point<'a> {
    pub key: Key,
    pub record: &'a [u8],
    pub scan: u32,
}

impl TreePoint for Point<'_> {
    fn key(&self) -> Key {
        self.key
    }
}

/// The scans that take part, in the order that decides between equal records: by their attributes, then by identity.
/// Their layouts are canonical.
#[derive(Debug)]
pub(in super::super) struct ScanOrder<'a> {
    scans: Vec<ScanColumns<'a>>,
    places: HashMap<ScanId, u32>,
}

impl<'a> ScanOrder<'a> {
    pub fn new(mut scans: Vec<ScanColumns<'a>>) -> Self {
        scans.sort_by(|a, b| a.signature.cmp(&b.signature).then_with(|| a.identity.cmp(&b.identity)));
        let places = (0..).zip(&scans).map(|(place, scan)| (scan.id, place)).collect();
        Self { scans, places }
    }

    /// In order.
    pub fn all(&self) -> &[ScanColumns<'a>] {
        &self.scans
    }

    /// The place of a scan.
    pub fn place(&self, scan: ScanId) -> Option<u32> {
        self.places.get(&scan).copied()
    }
}

/// The columns of points, for a part's encoder: of those with these indices, in that order.
pub(in super::super) fn gathered(
    scans: &ScanOrder<'_>,
    points: &[Point<'_>],
    picked: &[u32],
    scratch: &mut Scratch,
) -> PointColumns {
    let mut columns = PointColumns::default();
    let row = |i: u32| (points[i as usize].scan, points[i as usize].record);
    gather(scans.all(), picked, row, scratch, &mut columns);
    columns
}

/// Rows that were read from sources, as canonical records; they own what [`Point`]s borrow.
#[derive(Debug, Default)]
pub(in super::super) struct NewRows {
    runs: Vec<Run>,
}

#[derive(Debug)]
struct Run {
    scan: u32,
    keys: Vec<Key>,
    records: Vec<u8>,
    record_bytes: usize,
}

impl NewRows {
    /// From buckets in memory, whose segments' slots are places in `sources`.
    pub fn of<K: RowKey>(
        buckets: &[Bucket],
        sources: &[ScanColumns<'_>],
        order: &ScanOrder<'_>,
    ) -> Result<Self, IngestError> {
        let runs = buckets
            .par_iter()
            .flat_map_iter(|bucket| bucket.segments.iter().map(|segment| (bucket.cube, segment)))
            .map(|(cube, segment)| Run::of::<K>(cube, segment, sources, order))
            .collect::<Result<_, _>>()?;
        Ok(Self { runs })
    }

    /// The points, in canonical order.
    pub fn points(&self) -> Vec<Point<'_>> {
        let mut points: Vec<Point<'_>> = Vec::with_capacity(self.runs.iter().map(|r| r.keys.len()).sum());
        for run in &self.runs {
            let records = (0..run.keys.len()).map(|i| &run.records[i * run.record_bytes..(i + 1) * run.record_bytes]);
            points.extend(run.keys.iter().zip(records).map(|(&key, record)| Point { key, record, scan: run.scan }));
        }
        points.par_sort_unstable();
        points
    }
}

impl Run {
    fn of<K: RowKey>(
        cube: Cube,
        segment: &Segment,
        sources: &[ScanColumns<'_>],
        order: &ScanOrder<'_>,
    ) -> Result<Self, IngestError> {
        let Place::Memory(bytes) = &segment.place else {
            return Err(IngestError::Internal("spilled rows were to be changed in memory".into()));
        };
        let source = &sources[segment.slot as usize];
        let scan = order.place(source.id).ok_or_else(|| IngestError::Internal("a scan without a place".into()))?;
        let layout = &source.plan.layout;
        let record_bytes = layout.attributes.iter().map(|a| a.ty.size()).sum();
        let rows = segment.rows as usize;
        let first = cube.first_key();
        let (mut keys, mut records) = (Vec::with_capacity(rows), Vec::with_capacity(rows * record_bytes));
        for row in bytes.chunks_exact(K::BYTES + layout.payload) {
            keys.push(K::read(row).full(first));
            layout.canonical_bytes(&row[K::BYTES..], &mut records);
        }
        Ok(Self { scan, keys, records, record_bytes })
    }
}

//! The points that a store has, as a source like any other: their rows go through the buckets again, when layers are put
//! together and stores are merged.

use super::IngestError;
use super::partition::{Partition, RowPlan};
use super::progress::Progress;
use super::rows::RowKey;
use crate::codec::Decoder;
use crate::lattice::LatticeBox;
use crate::points::{PositionKind, RecordLayout};
use crate::store::model::{Scan, ScanCount, ScanId, Slot};
use crate::store::{DecodedPart, Node, Snapshot, StoreError, decode_part};
use crate::with_column;
use rayon::prelude::*;
use std::path::Path;

/// Some scans of a snapshot and their points, in some of its layers.
pub(super) struct StoredPoints<'a> {
    snapshot: &'a Snapshot,
    layers: Vec<u16>,
    /// Those of the layers.
    roots: Vec<Node>,
    /// The scans, ascending by id.
    scans: Vec<&'a Scan>,
    /// The number of the first of them in this run.
    first_slot: u32,
    layouts: Vec<RecordLayout>,
}

impl<'a> StoredPoints<'a> {
    /// The points of `layers` (`None`: of all) whose scan passes `wanted`.
    pub fn new(
        path: &Path,
        snapshot: &'a Snapshot,
        layers: Option<&[u16]>,
        first_slot: u32,
        wanted: impl Fn(&Scan) -> bool,
    ) -> Result<Self, IngestError> {
        let nodes = snapshot.nodes();
        let layers = layers.map_or_else(|| (0..nodes.layers()).collect(), <[u16]>::to_vec);
        let mut roots = nodes.roots()?;
        roots.retain(|root| layers.contains(&root.layer));
        let scans: Vec<_> = snapshot.scans().iter().filter(|s| wanted(s)).collect();
        let layouts = scans.iter().map(|scan| layout(path, snapshot, scan)).collect::<Result<_, _>>()?;
        Ok(Self { snapshot, layers, roots, scans, first_slot, layouts })
    }

    /// The scans, ascending by id.
    pub fn scans(&self) -> &[&'a Scan] {
        &self.scans
    }

    /// How the rows of each scan are laid out: canonical records after a lattice position.
    pub fn row_plans(&self) -> Vec<RowPlan> {
        let numbered = (self.first_slot..).zip(&self.layouts);
        numbered.map(|(slot, layout)| RowPlan::new(slot, layout.clone(), None)).collect()
    }

    /// How many they are.
    pub fn points(&self) -> u64 {
        self.roots.iter().map(|root| self.wanted(&root.scans)).fold(0, u64::saturating_add)
    }

    fn wanted(&self, counts: &[ScanCount]) -> u64 {
        counts.iter().filter(|c| self.place(c.scan).is_some()).map(|c| c.subtree).fold(0, u64::saturating_add)
    }

    fn place(&self, scan: ScanId) -> Option<usize> {
        self.scans.binary_search_by_key(&scan, |s| s.id).ok()
    }

    /// Bytes of their records.
    pub fn payload_bytes(&self) -> u64 {
        let counts = self.roots.iter().flat_map(|root| &root.scans);
        let payload = |c: &ScanCount| Some(c.subtree.saturating_mul(self.layouts[self.place(c.scan)?].payload as u64));
        counts.filter_map(payload).fold(0, u64::saturating_add)
    }

    /// Bounds that hold them all, not always tight.
    pub fn bounds(&self) -> Option<LatticeBox> {
        self.roots.iter().map(|root| root.subtree_bounds).reduce(|a, b| a.union(&b))
    }

    /// Puts their rows into `partition`; `plans` are [`StoredPoints::row_plans`]. Gives the bounds of what was put.
    pub fn read<K: RowKey>(
        &self,
        partition: &Partition<'_>,
        plans: &[RowPlan],
        open_bytes: usize,
        progress: &dyn Progress,
    ) -> Result<Option<LatticeBox>, IngestError> {
        let mut nodes = Vec::new();
        for &layer in &self.layers {
            nodes.append(&mut self.snapshot.nodes().all(layer)?);
        }
        let bounds = nodes
            .par_iter()
            .map_init(Decoder::new, |decoder, head| {
                if progress.cancelled() {
                    return Err(IngestError::Interrupted);
                }
                let mut bounds: Option<LatticeBox> = None;
                for part in 0..head.parts.len() {
                    let decoded = decode_part(self.snapshot, head, part, decoder)?;
                    let found = self.put::<K>(&decoded, partition, plans, open_bytes)?;
                    bounds = union(bounds, found);
                }
                progress.advance(head.own_points);
                Ok(bounds)
            })
            .collect::<Result<Vec<_>, _>>()?;
        Ok(bounds.into_iter().fold(None, union))
    }

    fn put<K: RowKey>(
        &self,
        part: &DecodedPart,
        partition: &Partition<'_>,
        plans: &[RowPlan],
        open_bytes: usize,
    ) -> Result<Option<LatticeBox>, IngestError> {
        let mut present: Vec<ScanId> = part.scans.chunk_by(|a, b| a == b).map(|run| run[0]).collect();
        present.sort_unstable();
        present.dedup();
        let mut bounds = None;
        for scan in present {
            let Some(place) = self.place(scan) else { continue };
            let points: Vec<u32> = (0..).zip(&part.scans).filter(|(_, s)| **s == scan).map(|(i, _)| i).collect();
            let layout = &self.layouts[place];
            let stride = layout.stride();
            let mut rows = vec![0; stride * points.len()];
            for (row, &i) in rows.chunks_exact_mut(stride).zip(&points) {
                for (axis, value) in part.keys[i as usize].point().0.into_iter().enumerate() {
                    row[8 * axis..8 * axis + 8].copy_from_slice(&value.to_le_bytes());
                }
            }
            let head = layout.position.size();
            write_fields(part, &self.scans[place].attributes, layout, &points, &mut rows, |n| n * stride + head);
            let mut sorter = partition.sorter(&plans[place]);
            sorter.take::<K>(&rows, open_bytes)?;
            bounds = union(bounds, sorter.finish()?.bounds);
        }
        Ok(bounds)
    }
}

fn union(a: Option<LatticeBox>, b: Option<LatticeBox>) -> Option<LatticeBox> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.union(&b)),
        (a, b) => a.or(b),
    }
}

/// Writes the values of `points` of a part into records; the record of the n-th of them begins at `start(n)`.
fn write_fields(
    part: &DecodedPart,
    slots: &[Slot],
    layout: &RecordLayout,
    points: &[u32],
    records: &mut [u8],
    start: impl Fn(usize) -> usize,
) {
    for (slot, field) in slots.iter().zip(&layout.fields) {
        let Ok(found) = part.columns.binary_search_by_key(slot, |c| c.0) else { continue };
        with_column!(&part.columns[found].1, values => {
            for (n, &i) in points.iter().enumerate() {
                let bytes = values[i as usize].to_le_bytes();
                let at = start(n) + field.offset;
                records[at..at + bytes.len()].copy_from_slice(&bytes);
            }
        });
    }
}

/// The canonical layout of a stored scan's records.
pub(super) fn layout(path: &Path, snapshot: &Snapshot, scan: &Scan) -> Result<RecordLayout, IngestError> {
    let attributes = scan
        .attributes
        .iter()
        .map(|&slot| {
            snapshot.attribute(slot).map(|a| a.attribute.clone()).ok_or_else(|| StoreError::Damaged {
                path: path.to_owned(),
                table: "scan",
                key: scan.id.to_string(),
                what: format!("attribute {slot} is not in the store"),
            })
        })
        .collect::<Result<Vec<_>, _>>()?;
    Ok(RecordLayout::canonical(PositionKind::Lattice, attributes))
}

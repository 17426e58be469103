//! The points that the store has already, as a source like any other: their rows go through the buckets again.

use super::IngestError;
use super::gather::ScanColumns;
use super::partition::{Partition, RowPlan};
use super::progress::Progress;
use super::rows::RowKey;
use crate::codec::{ColumnChunk, Decoder, PositionChunk};
use crate::lattice::LatticeBox;
use crate::points::{Column, PositionKind, Positions, RecordLayout};
use crate::store::model::{NodeHead, SLOT_POSITION, SLOT_SCAN, Scan, Slot};
use crate::store::{NodeIndex, ReadCost, Snapshot, StoreError};
use crate::with_column;
use rayon::prelude::*;
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// The scans of a snapshot and their points.
pub(super) struct Existing<'a> {
    path: &'a Path,
    snapshot: &'a Snapshot,
    index: Arc<NodeIndex>,
    layouts: Vec<RecordLayout>,
}

impl<'a> Existing<'a> {
    pub fn new(path: &'a Path, snapshot: &'a Snapshot) -> Result<Self, IngestError> {
        let index = snapshot.index()?;
        let layouts = snapshot.scans().iter().map(|scan| layout(path, snapshot, scan)).collect::<Result<_, _>>()?;
        Ok(Self { path, snapshot, index, layouts })
    }

    /// How the rows of each scan are laid out: canonical records after a lattice position. Slots are places in
    /// [`Snapshot::scans`].
    pub fn row_plans(&self) -> Vec<RowPlan> {
        (0..).zip(&self.layouts).map(|(slot, layout)| RowPlan::new(slot, layout.clone(), None)).collect()
    }

    pub fn scan_columns<'p>(&self, plans: &'p [RowPlan]) -> Vec<ScanColumns<'p>> {
        let scans = self.snapshot.scans().iter().zip(plans);
        scans.map(|(scan, plan)| ScanColumns::new(scan.id, scan.identity, plan, scan.attributes.clone())).collect()
    }

    pub fn points(&self) -> u64 {
        self.snapshot.scans().iter().map(|s| s.stored).sum()
    }

    pub fn payload_bytes(&self, plans: &[RowPlan]) -> u64 {
        self.snapshot.scans().iter().zip(plans).map(|(s, p)| s.stored * p.layout.payload as u64).sum()
    }

    pub fn bounds(&self) -> Option<LatticeBox> {
        self.snapshot.scans().iter().filter_map(|s| s.bounds).reduce(|a, b| a.union(&b))
    }

    /// Puts the rows of all nodes into `partition`.
    pub fn read<K: RowKey>(
        &self,
        partition: &Partition<'_>,
        plans: &[RowPlan],
        open_bytes: usize,
        progress: &dyn Progress,
    ) -> Result<(), IngestError> {
        self.index.heads().par_iter().with_max_len(4).try_for_each_init(Decoder::new, |decoder, head| {
            if progress.cancelled() {
                return Err(IngestError::Interrupted);
            }
            for part in 0..head.parts.len() {
                self.read_part::<K>(decoder, head, part, partition, plans, open_bytes)?;
            }
            progress.advance(head.own_points);
            Ok(())
        })
    }

    fn read_part<K: RowKey>(
        &self,
        decoder: &mut Decoder,
        head: &NodeHead,
        part: usize,
        partition: &Partition<'_>,
        plans: &[RowPlan],
        open_bytes: usize,
    ) -> Result<(), IngestError> {
        let attributes = self.snapshot.attributes();
        let mut slots = vec![SLOT_POSITION, SLOT_SCAN];
        slots.extend(attributes.iter().map(|a| a.id));
        let count = head.parts[part].points as usize;
        let damaged = |what: String| damage(self.path, "chunk", format!("{:?} part {part}", head.cube), what);
        let chunks = self.snapshot.read_part(head, part, &slots, &mut ReadCost::default())?;
        let bytes = |i: usize| chunks.get(i).and_then(Option::as_ref);
        let (Some(positions_bytes), Some(scan_bytes)) = (bytes(0), bytes(1)) else {
            return Err(damaged("positions or scans are missing".into()).into());
        };
        let mut positions = Positions::with_capacity(count);
        PositionChunk::parse(positions_bytes, head.cube, count)
            .and_then(|chunk| chunk.decode(decoder, &mut positions))
            .map_err(|e| damaged(e.to_string()))?;
        let mut decode = |bytes: &[u8], ty| {
            let mut column = Column::with_capacity(ty, count);
            ColumnChunk::parse(bytes, ty, count)
                .and_then(|chunk| chunk.decode(decoder, &mut column))
                .map_err(|e| damaged(e.to_string()))?;
            Ok::<_, StoreError>(column)
        };
        let Column::U32(scans) = decode(scan_bytes, crate::points::ScalarType::U32)? else {
            return Err(damaged("scans are no u32".into()).into());
        };
        let mut columns: HashMap<Slot, Column> = HashMap::new();
        for (i, attribute) in attributes.iter().enumerate() {
            if let Some(bytes) = bytes(i + 2) {
                columns.insert(attribute.id, decode(bytes, attribute.attribute.ty)?);
            }
        }
        for (scan, plan) in self.snapshot.scans().iter().zip(plans) {
            let points: Vec<usize> = (0..count).filter(|&i| scans[i] == scan.id).collect();
            if points.is_empty() {
                continue;
            }
            let records = records(&positions, &columns, scan, &plan.layout, &points);
            let mut sorter = partition.sorter(plan);
            sorter.take::<K>(&records, open_bytes)?;
            sorter.finish()?;
        }
        Ok(())
    }
}

/// The records of `points` in the canonical layout, after their lattice positions.
fn records(
    positions: &Positions,
    columns: &HashMap<Slot, Column>,
    scan: &Scan,
    layout: &RecordLayout,
    points: &[usize],
) -> Vec<u8> {
    let stride = layout.stride();
    let mut records = vec![0; stride * points.len()];
    for (record, &i) in records.chunks_exact_mut(stride).zip(points) {
        for (axis, value) in positions.point(i).0.into_iter().enumerate() {
            record[8 * axis..8 * axis + 8].copy_from_slice(&value.to_le_bytes());
        }
    }
    for (slot, field) in scan.attributes.iter().zip(&layout.fields) {
        let Some(column) = columns.get(slot) else { continue };
        let start = layout.position.size() + field.offset;
        with_column!(column, values => {
            for (record, &i) in records.chunks_exact_mut(stride).zip(points) {
                let bytes = values[i].to_le_bytes();
                record[start..start + bytes.len()].copy_from_slice(&bytes);
            }
        });
    }
    records
}

fn damage(path: &Path, table: &'static str, key: String, what: String) -> StoreError {
    StoreError::Damaged { path: path.to_owned(), table, key, what }
}

fn layout(path: &Path, snapshot: &Snapshot, scan: &Scan) -> Result<RecordLayout, IngestError> {
    let attributes = scan
        .attributes
        .iter()
        .map(|&slot| {
            snapshot.attribute(slot).map(|a| a.attribute.clone()).ok_or_else(|| {
                damage(path, "scan", scan.id.to_string(), format!("attribute {slot} is not in the store"))
            })
        })
        .collect::<Result<Vec<_>, _>>()?;
    Ok(RecordLayout::canonical(PositionKind::Lattice, attributes))
}

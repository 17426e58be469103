//! A point on its way through a changing tree: its key, and where its record lies.

use super::super::IngestError;
use super::super::gather::{ScanColumns, Scratch, gather};
use super::super::loaded::{LoadScratch, Loaded, load};
use super::super::partition::Bucket;
use super::super::rows::RowKey;
use crate::lattice::{Cube, Key, LOW_DIGITS};
use crate::octree::TreePoint;
use crate::points::Column;
use crate::store::model::{Scan, ScanId, Slot, StoredAttribute};
use crate::store::{DecodedPart, PointColumns};
use rayon::prelude::*;
use std::cmp::Ordering;
use std::collections::HashMap;
use std::sync::Arc;

/// A point of a tree. Their order is the canonical one: by key, then record bytes, then the scan by its place in
/// [`ScanOrder`].
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Point<'a> {
    low: u64,
    /// Its place in the block.
    pub at: u32,
    pub block: &'a Block,
}

impl Point<'_> {
    /// Are they one and the same, not just equal?
    pub fn is(&self, other: &Self) -> bool {
        self.at == other.at && std::ptr::eq(self.block, other.block)
    }

    /// The place of its scan in the order of scans.
    pub fn place(&self) -> u32 {
        self.block.places[self.at as usize]
    }

    /// By record bytes, then scan.
    fn tie(&self, other: &Self) -> Ordering {
        if self.is(other) {
            return Ordering::Equal;
        }
        let order = &self.block.order;
        let (a, b) = (order.slots(self.place()), order.slots(other.place()));
        let records = if a == b {
            let values = a.iter().map(|&slot| self.raw(slot).cmp(&other.raw(slot)));
            values.fold(Ordering::Equal, Ordering::then)
        } else {
            self.record(a).cmp(&other.record(b))
        };
        records.then_with(|| self.place().cmp(&other.place()))
    }

    /// The bytes of a value, filled up with zeros.
    fn raw(&self, slot: Slot) -> [u8; 8] {
        self.block.column(slot).map_or([0; 8], |column| column.raw(self.at as usize))
    }

    /// The canonical record: all values' bytes, one after the other.
    fn record(&self, slots: &[Slot]) -> Vec<u8> {
        let mut record = Vec::new();
        for column in slots.iter().filter_map(|&slot| self.block.column(slot)) {
            record.extend_from_slice(&column.raw(self.at as usize)[..column.ty().size()]);
        }
        record
    }
}

impl TreePoint for Point<'_> {
    fn key(&self) -> Key {
        Key { high: self.block.high.of(self.at), low: self.low }
    }
}

impl Ord for Point<'_> {
    fn cmp(&self, other: &Self) -> Ordering {
        self.key().cmp(&other.key()).then_with(|| self.tie(other))
    }
}

impl PartialOrd for Point<'_> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Point<'_> {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Point<'_> {}

/// The scans that take part, in the order that decides between equal records: by their attributes, then by identity.
#[derive(Debug)]
pub(in super::super) struct ScanOrder {
    scans: Vec<Ordered>,
    places: HashMap<ScanId, u32>,
}

#[derive(Debug)]
struct Ordered {
    id: ScanId,
    /// In the order of the record's bytes.
    slots: Vec<Slot>,
    /// Names and types of its attributes, as bytes.
    signature: Vec<u8>,
    identity: [u8; 32],
}

impl ScanOrder {
    /// `attributes` are all of the store, ascending by number.
    pub fn new<'s>(scans: impl IntoIterator<Item = &'s Scan>, attributes: &[StoredAttribute]) -> Self {
        let attribute = |slot: &Slot| {
            let found = attributes.binary_search_by_key(slot, |a| a.id).ok();
            found.map(|i| &attributes[i].attribute)
        };
        let ordered = |scan: &Scan| Ordered {
            id: scan.id,
            slots: scan.attributes.clone(),
            signature: ScanColumns::signature_of(scan.attributes.iter().filter_map(attribute)),
            identity: scan.identity,
        };
        let mut scans: Vec<Ordered> = scans.into_iter().map(ordered).collect();
        scans.sort_by(|a, b| a.signature.cmp(&b.signature).then_with(|| a.identity.cmp(&b.identity)));
        let places = (0..).zip(&scans).map(|(place, scan)| (scan.id, place)).collect();
        Self { scans, places }
    }

    /// The scan at a place.
    pub fn id(&self, place: u32) -> ScanId {
        self.scans[place as usize].id
    }

    fn slots(&self, place: u32) -> &[Slot] {
        &self.scans[place as usize].slots
    }

    /// The places of scans.
    fn places(&self, scans: &[ScanId]) -> Result<Vec<u32>, IngestError> {
        let mut last = None;
        let place = |&scan: &ScanId| match last {
            Some((id, place)) if id == scan => Ok(place),
            _ => {
                let place = self.places.get(&scan).copied();
                let place =
                    place.ok_or_else(|| IngestError::Internal(format!("points of scan {scan}, which is not there")))?;
                last = Some((scan, place));
                Ok(place)
            }
        };
        scans.iter().map(place).collect()
    }
}

/// Points that lie together, by column: those of a stored node, or new ones of one bucket.
#[derive(Debug)]
pub(in super::super) struct Block {
    order: Arc<ScanOrder>,
    high: High,
    lows: Vec<u64>,
    /// The place of each point's scan.
    places: Vec<u32>,
    /// Ascending by slot; zero where a point's scan lacks the attribute.
    pub columns: Vec<(Slot, Column)>,
    /// The points in canonical order.
    sorted: Vec<u32>,
}

/// The digits of keys from [`LOW_DIGITS`] up.
#[derive(Debug)]
enum High {
    One(u128),
    Each(Vec<u128>),
}

impl High {
    fn of(&self, at: u32) -> u128 {
        match self {
            Self::One(high) => *high,
            Self::Each(highs) => highs[at as usize],
        }
    }

    fn of_keys(cube: Cube, keys: impl Iterator<Item = Key>) -> Self {
        if cube.k() <= LOW_DIGITS {
            Self::One(cube.first_key().high)
        } else {
            Self::Each(keys.map(|key| key.high).collect())
        }
    }
}

impl Block {
    /// The points of a node, by part.
    pub fn of_parts(order: &Arc<ScanOrder>, cube: Cube, parts: Vec<DecodedPart>) -> Result<Self, IngestError> {
        let high = High::of_keys(cube, parts.iter().flat_map(|part| part.keys.iter().copied()));
        let (mut lows, mut places) = (Vec::new(), Vec::new());
        let mut columns: Vec<(Slot, Column)> = Vec::new();
        for part in parts {
            let before = lows.len();
            lows.extend(part.keys.iter().map(|key| key.low));
            places.append(&mut order.places(&part.scans)?);
            for (slot, column) in part.columns {
                match columns.binary_search_by_key(&slot, |c| c.0) {
                    Ok(i) => columns[i].1.append(&column),
                    Err(i) if before == 0 => columns.insert(i, (slot, column)),
                    Err(i) => {
                        let mut with_nulls = Column::zeros(column.ty(), before);
                        with_nulls.append(&column);
                        columns.insert(i, (slot, with_nulls));
                    }
                }
            }
            columns.iter_mut().for_each(|(_, column)| column.resize(lows.len()));
        }
        let mut block = Self { order: order.clone(), high, lows, places, columns, sorted: Vec::new() };
        // Parts are in order each; a stable sort merges them.
        let mut sorted: Vec<(u64, u32)> = block.lows.iter().copied().zip(0..).collect();
        match &block.high {
            High::One(_) => sorted.sort_by_key(|p| p.0),
            High::Each(highs) => sorted.sort_by_key(|&(low, at)| (highs[at as usize], low)),
        }
        for tied in sorted.chunk_by_mut(|a, b| a.0 == b.0).filter(|run| run.len() > 1) {
            tied.sort_by(|a, b| block.point(a.1).cmp(&block.point(b.1)));
        }
        let sorted = sorted.into_iter().map(|p| p.1).collect();
        block.sorted = sorted;
        Ok(block)
    }

    fn point(&self, at: u32) -> Point<'_> {
        Point { low: self.lows[at as usize], at, block: self }
    }

    /// The points, in canonical order.
    pub fn points(&self) -> impl ExactSizeIterator<Item = Point<'_>> {
        self.sorted.iter().map(|&at| self.point(at))
    }

    pub fn column(&self, slot: Slot) -> Option<&Column> {
        self.columns.binary_search_by_key(&slot, |c| c.0).ok().map(|i| &self.columns[i].1)
    }
}

/// Rows that were read from sources; they own what [`Point`]s borrow.
#[derive(Debug)]
pub(in super::super) struct NewPoints {
    /// In key order.
    blocks: Vec<Block>,
}

impl NewPoints {
    /// From buckets in memory, which are in key order; the slots of their segments are places in `sources`.
    pub fn of<K: RowKey>(
        buckets: &[Bucket],
        sources: &[ScanColumns<'_>],
        order: &Arc<ScanOrder>,
    ) -> Result<Self, IngestError> {
        let block = |(scratch, gatherer): &mut (LoadScratch<K>, Scratch), bucket: &Bucket| {
            let Loaded { keys, rows } = load(bucket, sources, None, scratch)?;
            let mut found = PointColumns::default();
            let rows_in_order: Vec<u32> = (0..).take(keys.len()).collect();
            gather(sources, &rows_in_order, rows, gatherer, &mut found);
            let first = bucket.cube.first_key();
            let full = keys.iter().map(|key| key.full(first));
            Ok::<_, IngestError>(Block {
                order: order.clone(),
                high: High::of_keys(bucket.cube, full.clone()),
                lows: full.map(|key| key.low).collect(),
                places: order.places(&found.scans)?,
                sorted: (0..).take(found.scans.len()).collect(),
                columns: found.columns,
            })
        };
        let blocks = buckets.par_iter().map_init(Default::default, block).collect::<Result<_, _>>()?;
        Ok(Self { blocks })
    }

    /// The points, in canonical order.
    pub fn points(&self) -> Vec<Point<'_>> {
        self.blocks.iter().flat_map(Block::points).collect()
    }
}

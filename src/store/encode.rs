//! A node's points to its rows: parts, chunks, head and zone maps. Pure, and on ingest's hot path: many threads encode
//! at once, one [`EncodeScratch`] each.

use super::model::{
    NodeHead, PartHead, Range, SLOT_PACKED, SLOT_POSITION, SLOT_SCAN, ScanCount, ScanId, Shape, Slot, StoredAttribute,
    Zones,
};
use super::rows::{ChunkRow, pack};
use super::shape::Relative;
use super::writer::ChunkIds;
use super::zones::{range_of_all, range_where};
use crate::codec::{CodecError, Encoder, Passes};
use crate::lattice::{Cube, LatticeBox, SortKey};
use crate::octree;
use crate::points::{Column, ScalarType};

/// Columns shorter than this share a row: a row of its own costs about 60 bytes beside its content, and leaves a part of
/// a page empty (docs/format.md has what was measured).
pub const PACKED_BELOW_BYTES: usize = 4096;

/// Which attributes the points of each scan have, and how deep their colours are.
#[derive(Clone, Debug, Default)]
pub struct ScanTable {
    /// Ascending by scan.
    scans: Vec<(ScanId, ScanFacts)>,
    /// The columns of red, green and blue: there may be one of each type.
    colors: [Vec<Slot>; 3],
    /// The columns of times.
    times: Vec<Slot>,
}

#[derive(Clone, Debug)]
struct ScanFacts {
    /// Ascending.
    slots: Vec<Slot>,
    eight_bit: bool,
}

impl ScanTable {
    /// Without scans yet.
    pub fn new(attributes: &[StoredAttribute]) -> Self {
        let of = |name: &str| {
            let named = attributes.iter().filter(|a| a.attribute.name == name);
            named.filter(|a| matches!(a.attribute.ty, ScalarType::U8 | ScalarType::U16)).map(|a| a.id).collect()
        };
        let times = attributes.iter().filter(|a| a.attribute.name == "GpsTime" && a.attribute.ty == ScalarType::F64);
        let times = times.map(|a| a.id).collect();
        Self { scans: Vec::new(), colors: [of("Red"), of("Green"), of("Blue")], times }
    }

    /// Adds a scan, or replaces what was said of it: its attributes, and the depth of its colours, 8 or 16.
    pub fn insert(&mut self, scan: ScanId, attributes: &[Slot], color_depth: Option<u8>) {
        let mut slots = attributes.to_vec();
        slots.sort_unstable();
        let facts = ScanFacts { slots, eight_bit: color_depth == Some(8) };
        match self.scans.binary_search_by_key(&scan, |s| s.0) {
            Ok(i) => self.scans[i].1 = facts,
            Err(i) => self.scans.insert(i, (scan, facts)),
        }
    }

    fn facts(&self, scan: ScanId) -> Option<&ScanFacts> {
        self.scans.binary_search_by_key(&scan, |s| s.0).ok().map(|i| &self.scans[i].1)
    }

    /// Have the points of this scan this attribute?
    pub fn has(&self, scan: ScanId, slot: Slot) -> bool {
        self.facts(scan).is_some_and(|f| f.slots.binary_search(&slot).is_ok())
    }
}

/// A node's own points, in key order (ties by record bytes, then by the scan's content).
#[derive(Clone, Copy, Debug)]
pub struct NodeInput<'a, K> {
    /// The layer.
    pub layer: u16,
    /// The cube.
    pub cube: Cube,
    /// Does it hold everything that remains in its cube?
    pub leaf: bool,
    /// Bit `octant` is set where there is a child.
    pub children: u8,
    /// The keys, ascending: `u64` for cubes of exponent at most 21.
    pub keys: &'a [K],
    /// The win of each point ([`octree::wins`]).
    pub wins: &'a [i8],
    /// The scan of each point.
    pub scans: &'a [ScanId],
    /// The attributes, any order: one value per point, zero where the point's scan lacks it. A column that no scan of
    /// the node has may be left out.
    pub columns: &'a [(Slot, Column)],
}

/// A node ready to be written; what it says of its subtree is of its own points only until [`super::merge_subtree`].
#[derive(Clone, Debug)]
pub struct EncodedNode {
    /// The head, with ids for its chunk rows.
    pub head: NodeHead,
    /// The zone maps.
    pub zones: Zones,
    /// The chunk rows, ascending by id.
    pub chunks: Vec<ChunkRow>,
}

/// What encoding keeps from node to node; one per thread.
#[derive(Debug, Default)]
pub struct EncodeScratch {
    encoder: Encoder,
    relative: Relative,
    scans: Vec<ScanId>,
}

/// Encodes a node.
///
/// # Errors
///
/// [`CodecError::Key`] if a key is outside of the cube or out of order.
///
/// # Panics
///
/// If `wins`, `scans` or a column has another length than `keys`.
pub fn encode_node<K: SortKey>(
    input: &NodeInput<'_, K>,
    table: &ScanTable,
    ids: &ChunkIds,
    scratch: &mut EncodeScratch,
) -> Result<EncodedNode, CodecError> {
    let NodeInput { layer, cube, leaf, children, keys, wins, scans, columns } = *input;
    assert!(wins.len() == keys.len(), "a node's columns have one length");
    let Description { scans: counts, bounds, shape, zones } = describe(input, table, &mut scratch.relative);
    let zones = Zones { subtree: zones.clone(), own: zones };
    let mut sorted: Vec<&(Slot, Column)> = columns.iter().collect();
    sorted.sort_by_key(|c| c.0);

    let plan = octree::split(wins, &octree::steps(keys, wins));
    let base = ids.reserve(plan.len());
    let mut head = NodeHead {
        layer,
        cube,
        leaf,
        children,
        own_points: keys.len() as u64,
        subtree_points: keys.len() as u64,
        scans: counts,
        own_bounds: bounds,
        subtree_bounds: bounds.unwrap_or(LatticeBox::of(cube.low())),
        shape,
        chunk_base: base,
        parts: Vec::with_capacity(plan.len()),
    };
    let mut chunks = Vec::new();
    for (part, plan) in plan.into_iter().enumerate() {
        let whole = plan.points.len() == keys.len();
        let mut pieces: Vec<(Slot, Vec<u8>)> = Vec::with_capacity(columns.len() + 2);
        let picked: Vec<K>;
        let keys = if whole {
            keys
        } else {
            picked = plan.points.iter().map(|&i| keys[i as usize]).collect();
            &picked
        };
        scratch.scans.clear();
        scratch.scans.extend(plan.points.iter().map(|&i| scans[i as usize]));
        let scan_column = Column::U32(std::mem::take(&mut scratch.scans));
        let mut scan_bytes = Vec::new();
        scratch.encoder.column(&scan_column, &mut scan_bytes)?;
        let Column::U32(part_scans) = scan_column else { unreachable!("it was put in as one") };
        let present = count_scans(&part_scans);
        scratch.scans = part_scans;
        let of_part = |column: &Column| {
            let mut picked = Column::with_capacity(column.ty(), plan.points.len());
            picked.extend_gathered(column, &plan.points);
            picked
        };
        let is_there = |slot: Slot| present.iter().any(|c| table.has(c.scan, slot));
        // Times come first: they show the passes, which positions carry and other columns are encoded by.
        let times = sorted.iter().find(|c| table.times.contains(&c.0) && is_there(c.0));
        let mut time_bytes = Vec::new();
        let passes = match times {
            Some((_, times)) if whole => scratch.encoder.times(times, cube, keys, &mut time_bytes)?,
            Some((_, times)) => scratch.encoder.times(&of_part(times), cube, keys, &mut time_bytes)?,
            None => Passes::default(),
        };
        let mut bytes = Vec::new();
        scratch.encoder.positions_with(cube, keys, &passes, &mut bytes)?;
        pieces.push((SLOT_POSITION, bytes));
        pieces.push((SLOT_SCAN, scan_bytes));
        for (slot, column) in &sorted {
            if !is_there(*slot) {
                continue;
            }
            let mut bytes = Vec::new();
            if times.is_some_and(|times| times.0 == *slot) {
                bytes = std::mem::take(&mut time_bytes);
            } else if whole {
                scratch.encoder.column_beside(column, &passes, &mut bytes)?;
            } else {
                scratch.encoder.column_beside(&of_part(column), &passes, &mut bytes)?;
            }
            pieces.push((*slot, bytes));
        }
        let facts = PartHead {
            points: plan.points.len() as u32,
            first_step: plan.first_step,
            last_step: plan.last_step,
            chunks: Vec::new(),
            packed: Vec::new(),
            packed_bytes: 0,
        };
        head.parts.push(facts);
        put_part(&mut head, part, pieces, &mut chunks);
    }
    Ok(EncodedNode { head, zones, chunks })
}

/// What a node's row says of its own points, apart from how they are cut into parts: a function of the points alone.
#[derive(Debug, PartialEq)]
pub(super) struct Description {
    pub scans: Vec<ScanCount>,
    pub bounds: Option<LatticeBox>,
    pub shape: Shape,
    /// Ascending by slot.
    pub zones: Vec<(Slot, Range)>,
}

/// Describes a node's own points; `wins` are not looked at.
pub(super) fn describe<K: SortKey>(
    input: &NodeInput<'_, K>,
    table: &ScanTable,
    relative: &mut Relative,
) -> Description {
    let NodeInput { cube, keys, scans, columns, .. } = *input;
    assert!(scans.len() == keys.len(), "a node's columns have one length");
    assert!(columns.iter().all(|c| c.1.len() == keys.len()), "a node's columns have one length");
    let counts = count_scans(scans);
    relative.fill(cube, keys);
    let shape = Shape { color: mean_color(input, table, &counts), ..relative.shape(cube) };
    let mut zones: Vec<(Slot, Range)> = Vec::with_capacity(columns.len());
    for (slot, column) in columns {
        let having = counts.iter().filter(|c| table.has(c.scan, *slot)).count();
        let range = match having {
            0 => None,
            n if n == counts.len() => range_of_all(column),
            _ => range_where(column, |i| table.has(scans[i], *slot)),
        };
        zones.extend(range.map(|r| (*slot, r)));
    }
    zones.sort_by_key(|z| z.0);
    Description { scans: counts, bounds: relative.bounds(cube), shape, zones }
}

/// Decides which columns of the part share a row, and makes the rows. `pieces` ascend by slot.
fn put_part(head: &mut NodeHead, part: usize, pieces: Vec<(Slot, Vec<u8>)>, chunks: &mut Vec<ChunkRow>) {
    let (layer, cube) = (head.layer, head.cube);
    let points = head.parts[part].points;
    let row =
        |id: i64, slot: Slot, bytes: Vec<u8>| ChunkRow { id, layer, cube, part: part as u32, slot, points, bytes };
    let mut small = Vec::new();
    for (slot, bytes) in pieces {
        if bytes.len() < PACKED_BELOW_BYTES {
            small.push((slot, bytes));
        } else {
            head.parts[part].chunks.push((slot, bytes.len() as u32));
            chunks.push(row(head.chunk_id(part, slot), slot, bytes));
        }
    }
    if !small.is_empty() {
        let packed = pack(small.iter().map(|(slot, bytes)| (*slot, &bytes[..])));
        head.parts[part].packed = small.iter().map(|(slot, bytes)| (*slot, bytes.len() as u32)).collect();
        head.parts[part].packed_bytes = packed.len() as u32;
        chunks.push(row(head.chunk_id(part, SLOT_PACKED), SLOT_PACKED, packed));
    }
}

/// How many points of each scan there are, ascending by scan.
fn count_scans(scans: &[ScanId]) -> Vec<ScanCount> {
    let mut counts: Vec<ScanCount> = Vec::new();
    for run in scans.chunk_by(|a, b| a == b) {
        let (scan, n) = (run[0], run.len() as u64);
        match counts.binary_search_by_key(&scan, |c| c.scan) {
            Ok(i) => {
                counts[i].own += n;
                counts[i].subtree += n;
            }
            Err(i) => counts.insert(i, ScanCount { scan, own: n, subtree: n }),
        }
    }
    counts
}

/// The mean colour at 16 bits of the points that have all three.
fn mean_color<K>(input: &NodeInput<'_, K>, table: &ScanTable, counts: &[ScanCount]) -> Option<[u16; 3]> {
    let column = |slot: Slot| input.columns.iter().find(|c| c.0 == slot).map(|c| &c.1);
    let mut sums = [0_u64; 3];
    let mut points = 0_u64;
    for count in counts {
        let Some(facts) = table.facts(count.scan) else { continue };
        let of_scan =
            |slots: &[Slot]| slots.iter().find(|s| facts.slots.binary_search(s).is_ok()).and_then(|s| column(*s));
        let [Some(red), Some(green), Some(blue)] = std::array::from_fn(|i| of_scan(&table.colors[i])) else { continue };
        for (sum, channel) in sums.iter_mut().zip([red, green, blue]) {
            let deep = if facts.eight_bit || channel.ty() == ScalarType::U8 { 257 } else { 1 };
            let all = counts.len() == 1;
            let add = match channel {
                Column::U8(v) => sum_of(v, input.scans, count.scan, all),
                Column::U16(v) => sum_of(v, input.scans, count.scan, all),
                _ => 0,
            };
            *sum = sum.saturating_add(add.saturating_mul(deep));
        }
        points += count.own;
    }
    // Rounded to the nearest, halves up.
    (points > 0).then(|| sums.map(|s| u16::try_from((2 * s + points) / (2 * points)).unwrap_or(u16::MAX)))
}

fn sum_of<T: Copy + Into<u64>>(values: &[T], scans: &[ScanId], scan: ScanId, all: bool) -> u64 {
    if all {
        values.iter().map(|&v| v.into()).sum()
    } else {
        values.iter().zip(scans).filter(|(_, s)| **s == scan).map(|(&v, _)| v.into()).sum()
    }
}

//! A node's points to its rows: parts, chunks, head and zone maps. Pure, and on ingest's hot path: many threads encode
//! at once, one [`EncodeScratch`] each.

use super::leaders::leaders;
use super::model::{
    NodeHead, PartHead, SLOT_PACKED, SLOT_POSITION, SLOT_SCAN, ScanId, Shape, Slot, StoredAttribute, Zones,
};
use super::own_points::{Describer, Description, count_scans};
use super::rows::{ChunkRow, pack};
use super::shape::Relative;
use super::writer::ChunkIds;
use crate::codec::{BlockSize, CodecError, Encoder, Passes};
use crate::lattice::{Cube, LatticeBox, SortKey};
use crate::octree::PartPlan;
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
    pub(super) colors: [Vec<Slot>; 3],
    /// The columns of times.
    times: Vec<Slot>,
    /// Columns that are encoded after others, and those.
    leaders: Vec<(Slot, Vec<Slot>)>,
}

#[derive(Clone, Debug)]
pub(super) struct ScanFacts {
    /// Ascending.
    pub slots: Vec<Slot>,
    pub eight_bit: bool,
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
        let leaders = attributes.iter().map(|a| (a.id, leaders(attributes, a.id).collect::<Vec<_>>()));
        let leaders = leaders.filter(|(_, leaders)| !leaders.is_empty()).collect();
        Self { scans: Vec::new(), colors: [of("Red"), of("Green"), of("Blue")], times, leaders }
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

    pub(super) fn facts(&self, scan: ScanId) -> Option<&ScanFacts> {
        self.scans.binary_search_by_key(&scan, |s| s.0).ok().map(|i| &self.scans[i].1)
    }

    /// Have the points of this scan this attribute?
    pub fn has(&self, scan: ScanId, slot: Slot) -> bool {
        self.facts(scan).is_some_and(|f| f.slots.binary_search(&slot).is_ok())
    }
}

/// The attributes of some points, by column, and the scan of each point.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointColumns {
    /// The scan of each point.
    pub scans: Vec<ScanId>,
    /// The attributes, ascending by slot: one value per point, zero where the point's scan lacks it. A column that no
    /// scan of these points has may be left out.
    pub columns: Vec<(Slot, Column)>,
}

impl PointColumns {
    /// The columns of each part of a node, from those of all its points in key order.
    ///
    /// # Panics
    ///
    /// If a column is shorter than the plan.
    #[cfg(test)]
    pub fn cut(&self, plan: &[PartPlan]) -> Vec<Self> {
        let of_part = |part: &PartPlan| {
            let column = |(slot, all): &(Slot, Column)| {
                let mut own = Column::with_capacity(all.ty(), part.points.len());
                own.extend_gathered(all, &part.points);
                (*slot, own)
            };
            Self {
                scans: part.points.iter().map(|&i| self.scans[i as usize]).collect(),
                columns: self.columns.iter().map(column).collect(),
            }
        };
        plan.iter().map(of_part).collect()
    }

    /// The same, borrowed.
    pub(super) fn slices(&self) -> ColumnSlices<'_> {
        ColumnSlices { scans: &self.scans, columns: &self.columns }
    }
}

/// [`PointColumns`], borrowed.
#[derive(Clone, Copy, Debug)]
pub(super) struct ColumnSlices<'a> {
    pub scans: &'a [ScanId],
    pub columns: &'a [(Slot, Column)],
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
    /// How the points are cut into parts: [`octree::split`](crate::octree::split).
    pub plan: &'a [PartPlan],
    /// How the columns are cut: [`block_size`].
    pub block_size: BlockSize,
}

/// Where the attributes of a node's parts come from. They are asked for one after the other, so that a node of millions of
/// points need not have all of them as columns at once.
pub trait PartColumns {
    /// The attributes of the points of part `number`, in the part's order: asked for once each, ascending.
    fn of_part(&mut self, number: usize) -> &PointColumns;
}

impl PartColumns for &[PointColumns] {
    fn of_part(&mut self, number: usize) -> &PointColumns {
        &self[number]
    }
}

/// Nodes over more points than this are cut finer.
const COARSE_FROM_POINTS: u64 = 1 << 18;

/// How the columns of a node are cut that has so many points stored in it or below. A region of the size that is asked for
/// most has little of a coarse node, which lies over much more; what it reads there must not follow the size of the site.
/// Finer blocks take more bytes: a tenth, if all were cut so.
pub fn block_size(rem: u64) -> BlockSize {
    if rem > COARSE_FROM_POINTS { BlockSize::FINE } else { BlockSize::LARGEST }
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

impl EncodedNode {
    /// Gives the chunk rows new ids. Nodes that are numbered when they are written, and not when they are encoded, are
    /// always appended to the table: rows that go between others split pages, which stay half empty.
    pub fn renumber(&mut self, ids: &ChunkIds) {
        let base = ids.reserve(self.head.parts.len());
        self.chunks.iter_mut().for_each(|chunk| chunk.id += base - self.head.chunk_base);
        self.head.chunk_base = base;
    }
}

/// What encoding keeps from node to node; one per thread.
#[derive(Debug, Default)]
pub struct EncodeScratch {
    encoder: Encoder,
    relative: Relative,
}

/// Encodes a node.
///
/// # Errors
///
/// [`CodecError::Key`] if a key is outside of the cube or out of order.
///
/// # Panics
///
/// If the parts and the keys, or the columns of a part, differ in length.
pub fn encode_node<K: SortKey>(
    input: &NodeInput<'_, K>,
    parts: &mut impl PartColumns,
    table: &ScanTable,
    ids: &ChunkIds,
    scratch: &mut EncodeScratch,
) -> Result<EncodedNode, CodecError> {
    let NodeInput { layer, cube, leaf, children, keys, plan, block_size } = *input;
    let base = ids.reserve(plan.len());
    let mut head = NodeHead {
        layer,
        cube,
        leaf,
        children,
        own_points: keys.len() as u64,
        subtree_points: keys.len() as u64,
        subtree_nodes: 1,
        scans: Vec::new(),
        own_bounds: None,
        subtree_bounds: LatticeBox::of(cube.low()),
        shape: Shape::default(),
        chunk_base: base,
        parts: Vec::with_capacity(plan.len()),
    };
    let mut chunks = Vec::new();
    let mut describer = Describer::new(table);
    scratch.encoder.cut_into(block_size);
    for (number, part) in plan.iter().enumerate() {
        let columns = parts.of_part(number);
        assert!(part.points.len() == columns.scans.len(), "a part's columns have its length");
        describer.add(&columns.slices());
        let picked: Vec<K>;
        let keys = if part.points.len() == keys.len() {
            keys
        } else {
            picked = part.points.iter().map(|&i| keys[i as usize]).collect();
            &picked
        };
        let pieces = encode_part(cube, keys, columns, table, &mut scratch.encoder)?;
        let facts = PartHead {
            points: part.points.len() as u32,
            block_size,
            first_step: part.first_step,
            last_step: part.last_step,
            chunks: Vec::new(),
            packed: Vec::new(),
            packed_bytes: 0,
        };
        head.parts.push(facts);
        put_part(&mut head, number, pieces, &mut chunks);
    }
    let Description { scans, bounds, shape, zones } = describer.finish(cube, keys, &mut scratch.relative);
    (head.scans, head.own_bounds, head.shape) = (scans, bounds, shape);
    head.subtree_bounds = bounds.unwrap_or(head.subtree_bounds);
    let zones = Zones { subtree: zones.clone(), own: zones };
    Ok(EncodedNode { head, zones, chunks })
}

/// The columns of a part, encoded, ascending by slot.
fn encode_part<K: SortKey>(
    cube: Cube,
    keys: &[K],
    PointColumns { scans, columns }: &PointColumns,
    table: &ScanTable,
    encoder: &mut Encoder,
) -> Result<Vec<(Slot, Vec<u8>)>, CodecError> {
    let mut pieces: Vec<(Slot, Vec<u8>)> = Vec::with_capacity(columns.len() + 2);
    let present = count_scans(scans);
    let is_there = |slot: Slot| present.iter().any(|c| table.has(c.scan, slot));
    // Times come first: they show the passes, which positions carry and other columns are encoded by.
    let times = columns.iter().find(|c| table.times.contains(&c.0) && is_there(c.0));
    let mut time_bytes = Vec::new();
    let passes = match times {
        Some((_, times)) => encoder.times(times, cube, keys, &mut time_bytes)?,
        None => Passes::default(),
    };
    let mut bytes = Vec::new();
    encoder.positions_with(cube, keys, &passes, &mut bytes)?;
    pieces.push((SLOT_POSITION, bytes));
    let mut bytes = Vec::new();
    encoder.column(&Column::U32(scans.clone()), &mut bytes)?;
    pieces.push((SLOT_SCAN, bytes));
    for (slot, column) in columns {
        if !is_there(*slot) {
            continue;
        }
        let mut bytes = Vec::new();
        if times.is_some_and(|times| times.0 == *slot) {
            bytes = std::mem::take(&mut time_bytes);
        } else {
            let leaders = table.leaders.iter().find(|l| l.0 == *slot).map_or(&[][..], |l| &l.1);
            let leaders: Vec<&Column> = leaders
                .iter()
                .map_while(|l| columns.iter().find(|c| c.0 == *l && is_there(*l)).map(|c| &c.1))
                .collect();
            encoder.column_after(column, &passes, &leaders, &mut bytes)?;
        }
        pieces.push((*slot, bytes));
    }
    Ok(pieces)
}

/// Decides which columns of the part share a row, and makes the rows. `pieces` ascend by slot.
fn put_part(head: &mut NodeHead, part: usize, pieces: Vec<(Slot, Vec<u8>)>, chunks: &mut Vec<ChunkRow>) {
    let (layer, cube) = (head.layer, head.cube);
    let blocks = head.blocks(part);
    let row = |id: i64, slot: Slot, bytes: Vec<u8>| ChunkRow::new(id, (layer, cube), part as u32, slot, blocks, bytes);
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

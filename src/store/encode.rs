//! A node's points to its rows: parts, chunks, head and zone maps. Pure, and on ingest's hot path: many threads encode
//! at once, one [`EncodeScratch`] each.

use super::leaders::leaders;
use super::model::{
    NodeHead, PartHead, Range, SLOT_PACKED, SLOT_POSITION, SLOT_SCAN, ScanCount, ScanId, Shape, Slot, StoredAttribute,
    Zones,
};
use super::rows::{ChunkRow, pack};
use super::shape::Relative;
use super::writer::ChunkIds;
use super::zones::{merge_ranges, range_of_all, range_where};
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
    colors: [Vec<Slot>; 3],
    /// The columns of times.
    times: Vec<Slot>,
    /// Columns that are encoded after others, and those.
    leaders: Vec<(Slot, Vec<Slot>)>,
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

    fn facts(&self, scan: ScanId) -> Option<&ScanFacts> {
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
    /// The attributes of each part's points, in the part's order.
    pub parts: &'a [PointColumns],
    /// How the columns are cut: [`block_size`].
    pub block_size: BlockSize,
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
    table: &ScanTable,
    ids: &ChunkIds,
    scratch: &mut EncodeScratch,
) -> Result<EncodedNode, CodecError> {
    let NodeInput { layer, cube, leaf, children, keys, plan, parts, block_size } = *input;
    assert!(plan.len() == parts.len(), "every part has its columns");
    let slices: Vec<_> = parts.iter().map(PointColumns::slices).collect();
    let Description { scans: counts, bounds, shape, zones } =
        describe(cube, keys, &slices, table, &mut scratch.relative);
    let zones = Zones { subtree: zones.clone(), own: zones };

    let base = ids.reserve(plan.len());
    let mut head = NodeHead {
        layer,
        cube,
        leaf,
        children,
        own_points: keys.len() as u64,
        subtree_points: keys.len() as u64,
        subtree_nodes: 1,
        scans: counts,
        own_bounds: bounds,
        subtree_bounds: bounds.unwrap_or(LatticeBox::of(cube.low())),
        shape,
        chunk_base: base,
        parts: Vec::with_capacity(plan.len()),
    };
    let mut chunks = Vec::new();
    scratch.encoder.cut_into(block_size);
    for (part, (plan, PointColumns { scans, columns })) in plan.iter().zip(parts).enumerate() {
        assert!(plan.points.len() == scans.len(), "a part's columns have its length");
        let mut pieces: Vec<(Slot, Vec<u8>)> = Vec::with_capacity(columns.len() + 2);
        let picked: Vec<K>;
        let keys = if plan.points.len() == keys.len() {
            keys
        } else {
            picked = plan.points.iter().map(|&i| keys[i as usize]).collect();
            &picked
        };
        let present = count_scans(scans);
        let is_there = |slot: Slot| present.iter().any(|c| table.has(c.scan, slot));
        // Times come first: they show the passes, which positions carry and other columns are encoded by.
        let times = columns.iter().find(|c| table.times.contains(&c.0) && is_there(c.0));
        let mut time_bytes = Vec::new();
        let passes = match times {
            Some((_, times)) => scratch.encoder.times(times, cube, keys, &mut time_bytes)?,
            None => Passes::default(),
        };
        let mut bytes = Vec::new();
        scratch.encoder.positions_with(cube, keys, &passes, &mut bytes)?;
        pieces.push((SLOT_POSITION, bytes));
        let mut bytes = Vec::new();
        scratch.encoder.column(&Column::U32(scans.clone()), &mut bytes)?;
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
                scratch.encoder.column_after(column, &passes, &leaders, &mut bytes)?;
            }
            pieces.push((*slot, bytes));
        }
        let facts = PartHead {
            points: plan.points.len() as u32,
            block_size,
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

/// Describes a node's own points: their keys in order, and the attributes of some after the other, in any order.
pub(super) fn describe<K: SortKey>(
    cube: Cube,
    keys: &[K],
    parts: &[ColumnSlices<'_>],
    table: &ScanTable,
    relative: &mut Relative,
) -> Description {
    assert!(parts.iter().map(|p| p.scans.len()).sum::<usize>() == keys.len(), "the parts are all of the node");
    let mut scans: Vec<ScanCount> = Vec::new();
    let mut zones: Vec<(Slot, Range)> = Vec::new();
    let mut color = ColorSum::default();
    for part in parts {
        assert!(part.columns.iter().all(|c| c.1.len() == part.scans.len()), "a part's columns have one length");
        let counts = count_scans(part.scans);
        color.add(part, table, &counts);
        for (slot, column) in part.columns {
            let having = counts.iter().filter(|c| table.has(c.scan, *slot)).count();
            let range = match having {
                0 => None,
                n if n == counts.len() => range_of_all(column),
                _ => range_where(column, |i| table.has(part.scans[i], *slot)),
            };
            if let Some(range) = range {
                merge_ranges(&mut zones, &[(*slot, range)]);
            }
        }
        counts.into_iter().for_each(|count| add_count(&mut scans, count));
    }
    relative.fill(cube, keys);
    let shape = Shape { color: color.mean(), ..relative.shape() };
    Description { scans, bounds: relative.bounds(cube), shape, zones }
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

/// How many points of each scan there are, ascending by scan.
fn count_scans(scans: &[ScanId]) -> Vec<ScanCount> {
    let mut counts: Vec<ScanCount> = Vec::new();
    let mut add = |scan: ScanId, n: usize| add_count(&mut counts, ScanCount { scan, own: n as u64, subtree: n as u64 });
    // In blocks, of which most are of one scan: so the compiler compares many at once.
    for block in scans.chunks(256) {
        if block.iter().fold(0, |d, scan| d | (scan ^ block[0])) == 0 {
            add(block[0], block.len());
        } else {
            block.chunk_by(|a, b| a == b).for_each(|run| add(run[0], run.len()));
        }
    }
    counts
}

fn add_count(counts: &mut Vec<ScanCount>, more: ScanCount) {
    match counts.binary_search_by_key(&more.scan, |c| c.scan) {
        Ok(i) => {
            counts[i].own += more.own;
            counts[i].subtree += more.subtree;
        }
        Err(i) => counts.insert(i, more),
    }
}

/// The colours at 16 bits, added up, of the points that have all three.
#[derive(Default)]
struct ColorSum {
    sums: [u64; 3],
    points: u64,
}

impl ColorSum {
    /// Adds points, of which `counts` says how many each scan has.
    fn add(&mut self, part: &ColumnSlices<'_>, table: &ScanTable, counts: &[ScanCount]) {
        let column = |slot: Slot| part.columns.iter().find(|c| c.0 == slot).map(|c| &c.1);
        for count in counts {
            let Some(facts) = table.facts(count.scan) else { continue };
            let of_scan =
                |slots: &[Slot]| slots.iter().find(|s| facts.slots.binary_search(s).is_ok()).and_then(|s| column(*s));
            let [Some(red), Some(green), Some(blue)] = std::array::from_fn(|i| of_scan(&table.colors[i])) else {
                continue;
            };
            for (sum, channel) in self.sums.iter_mut().zip([red, green, blue]) {
                let deep = if facts.eight_bit || channel.ty() == ScalarType::U8 { 257 } else { 1 };
                let all = counts.len() == 1;
                let add = match channel {
                    Column::U8(v) => sum_of(v, part.scans, count.scan, all),
                    Column::U16(v) => sum_of(v, part.scans, count.scan, all),
                    _ => 0,
                };
                *sum = sum.saturating_add(add.saturating_mul(deep));
            }
            self.points += count.own;
        }
    }

    /// Rounded to the nearest, halves up.
    fn mean(&self) -> Option<[u16; 3]> {
        let n = self.points;
        (n > 0).then(|| self.sums.map(|s| u16::try_from((2 * s + n) / (2 * n)).unwrap_or(u16::MAX)))
    }
}

fn sum_of<T: Copy + Into<u64>>(values: &[T], scans: &[ScanId], scan: ScanId, all: bool) -> u64 {
    if all {
        values.iter().map(|&v| v.into()).sum()
    } else {
        values.iter().zip(scans).filter(|(_, s)| **s == scan).map(|(&v, _)| v.into()).sum()
    }
}

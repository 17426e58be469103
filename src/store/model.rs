//! What the store's rows say, as checked types. How they are written as bytes is `rows`' business.

use crate::codec::{BlockSize, Blocks};
use crate::lattice::{Cube, Exactness, Lattice, LatticeBox};
pub use crate::octree::Step;
use crate::points::{Attribute, Crs, LasFacts};

/// The number of a scan in its store; never used again after the scan is gone.
pub type ScanId = u32;

/// Which column of a node a chunk holds: [`SLOT_POSITION`], [`SLOT_SCAN`], or the id of an attribute (2 and up).
pub type Slot = u16;

/// The positions of a part.
pub const SLOT_POSITION: Slot = 0;
/// The scan ids of a part, as `u32`; always there, constant where a part has one scan.
pub const SLOT_SCAN: Slot = 1;
/// The first id of an attribute.
pub const FIRST_ATTRIBUTE: Slot = 2;
/// Not a column: the row of a part in which its small columns lie together.
pub const SLOT_PACKED: Slot = Slot::MAX;
/// Chunk rows are `chunk_base + part * SLOT_STRIDE + slot`.
pub const SLOT_STRIDE: i64 = 1 << 16;

/// The sampling grid has `2^g` cells a side: fixed by format version 1.
pub const FORMAT_G: u8 = 7;
/// A node with at most this many remaining points is a leaf: fixed by format version 1 (tests may use other values).
pub const FORMAT_LEAF_CAPACITY: u32 = 32_768;

/// The one row of `site`.
#[derive(Clone, Debug, PartialEq)]
pub struct Site {
    /// Quantum and phase.
    pub lattice: Lattice,
    /// The sampling grid has `2^g` cells a side.
    pub g: u8,
    /// The leaf rule.
    pub leaf_capacity: u32,
    /// The root of each layer, in order; `None` for an empty one.
    pub roots: Vec<Option<Cube>>,
    /// The site's CRS: of the first scan that has one.
    pub crs: Option<Crs>,
    /// Counts committed changes.
    pub generation: u64,
}

impl Site {
    /// The root that the points of all layers would have in one.
    pub fn root(&self) -> Option<Cube> {
        let both = |a: Cube, b: Cube| Cube::spanning(a.low(), b.low(), a.k().max(b.k()));
        self.roots.iter().flatten().copied().reduce(both)
    }
}

/// How many records of a scan were not stored, and why.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rejected {
    /// A coordinate was NaN or infinite, or the scanner marked it as no measurement.
    pub not_finite: u64,
    /// A coordinate was outside the lattice.
    pub out_of_range: u64,
    /// The header announced the record but the file ends before it.
    pub truncated: u64,
}

impl Rejected {
    /// All of them; the greatest number where the sum does not fit, which a damaged row may say.
    pub fn total(&self) -> u64 {
        self.not_finite.saturating_add(self.out_of_range).saturating_add(self.truncated)
    }
}

/// A row of `scan`.
#[derive(Clone, Debug, PartialEq)]
pub struct Scan {
    /// The number.
    pub id: ScanId,
    /// Unique in the store.
    pub name: String,
    /// The file's path, absolute.
    pub source: String,
    /// Size of the source in bytes.
    pub source_bytes: u64,
    /// BLAKE3 of the source's bytes, index in the file, pose, reader options.
    pub identity: [u8; 32],
    /// Seconds since 1970, when it was stored.
    pub time: i64,
    /// 4 x 4, row-major, world from scan; the identity where the source has none.
    pub pose: [f64; 16],
    /// Records that the source announced or held.
    pub read: u64,
    /// Points stored.
    pub stored: u64,
    /// Records not stored, by reason.
    pub rejected: Rejected,
    /// Tight bounds of the stored points; `None` if there are none.
    pub bounds: Option<LatticeBox>,
    /// How faithfully positions are kept.
    pub exactness: Exactness,
    /// The largest distance on one axis between a source coordinate and the stored one, in CRS units.
    pub largest_error: f64,
    /// `las`, `laz`, `copc`, `ply`, ...
    pub format: String,
    /// For LAS sources.
    pub las: Option<LasFacts>,
    /// 8 or 16: found over the whole scan; `None` without colours.
    pub color_depth: Option<u8>,
    /// Shown unless asked otherwise?
    pub visible: bool,
    /// Which attributes its points have: ids, ascending by canonical order (name, then type).
    pub attributes: Vec<Slot>,
    /// The scan's own CRS, if it has one.
    pub crs: Option<Crs>,
}

/// A row of `attribute`.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredAttribute {
    /// The number, from [`FIRST_ATTRIBUTE`] up.
    pub id: Slot,
    /// Name, type, scaling, no-data, description.
    pub attribute: Attribute,
}

/// What a node row says of one part.
#[derive(Clone, Debug, PartialEq)]
pub struct PartHead {
    /// Points of the part.
    pub points: u32,
    /// How its columns are cut.
    pub block_size: BlockSize,
    /// The step of the part's first points in the order of detail: the coarsest.
    pub first_step: Step,
    /// The last step that is complete once this part and all before it are taken; `None` if none is.
    pub last_step: Option<Step>,
    /// Which columns have a chunk row of their own, with its length in bytes, ascending by slot.
    pub chunks: Vec<(Slot, u32)>,
    /// Which columns share the part's packed row, each with its own length in bytes, ascending by slot.
    pub packed: Vec<(Slot, u32)>,
    /// Length of the packed row; 0 if there is none.
    pub packed_bytes: u32,
}

impl PartHead {
    /// The blocks of its columns.
    pub fn blocks(&self) -> Blocks {
        Blocks::new(self.points as usize, self.block_size)
    }
}

/// Points of one scan in a node and in its subtree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScanCount {
    /// Which scan.
    pub scan: ScanId,
    /// Stored in the node.
    pub own: u64,
    /// Stored in the node or below.
    pub subtree: u64,
}

/// How a node's own points lie: functions of the content alone.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shape {
    /// Mean sample spacing in lattice steps (Gobbetti and Marton's r_j).
    pub spacing: f64,
    /// Mean position, relative to the cube's low corner, in lattice steps.
    pub mean: [f64; 3],
    /// Central second moments xx, xy, xz, yy, yz, zz, in square lattice steps.
    pub moments: [f64; 6],
    /// Radius, about the mean, of a sphere that holds the points, in lattice steps.
    pub radius: f64,
    /// Mean colour at 16 bits; `None` without colours.
    pub color: Option<[u16; 3]>,
}

/// A node row without its zone maps: all that selection needs.
#[derive(Clone, Debug, PartialEq)]
pub struct NodeHead {
    /// The layer.
    pub layer: u16,
    /// The cube.
    pub cube: Cube,
    /// Does it hold everything that remains in its cube?
    pub leaf: bool,
    /// Bit `octant` is set where there is a child.
    pub children: u8,
    /// Points stored here.
    pub own_points: u64,
    /// Points stored here or below.
    pub subtree_points: u64,
    /// This node and those below it.
    pub subtree_nodes: u64,
    /// Points per scan, ascending by scan; only scans with points in the subtree.
    pub scans: Vec<ScanCount>,
    /// Tight bounds of the own points.
    pub own_bounds: Option<LatticeBox>,
    /// Tight bounds of the subtree's points.
    pub subtree_bounds: LatticeBox,
    /// How the own points lie.
    pub shape: Shape,
    /// Chunk rows are `chunk_base + part * SLOT_STRIDE + slot`.
    pub chunk_base: i64,
    /// The parts, coarse to fine; empty for a node that stores nothing.
    pub parts: Vec<PartHead>,
}

impl NodeHead {
    /// Of an inner node that stores nothing itself; what it says of its subtree is still to be filled in.
    pub fn without_points(layer: u16, cube: Cube) -> Self {
        Self {
            layer,
            cube,
            leaf: false,
            children: 0,
            own_points: 0,
            subtree_points: 0,
            subtree_nodes: 1,
            scans: Vec::new(),
            own_bounds: None,
            subtree_bounds: LatticeBox::of(cube.low()),
            shape: Shape::default(),
            chunk_base: 0,
            parts: Vec::new(),
        }
    }

    /// The blocks of a part's columns; none if there is no such part.
    pub fn blocks(&self, part: usize) -> Blocks {
        self.parts.get(part).map(PartHead::blocks).unwrap_or_default()
    }

    /// The ids of the node's chunk rows lie in this range.
    pub fn chunk_ids(&self) -> std::ops::Range<i64> {
        let rows = (self.parts.len() as i64).saturating_mul(SLOT_STRIDE);
        self.chunk_base..self.chunk_base.saturating_add(rows)
    }

    /// The id of the row of column `slot` of part `part`.
    pub fn chunk_id(&self, part: usize, slot: Slot) -> i64 {
        self.chunk_base.saturating_add((part as i64).saturating_mul(SLOT_STRIDE)).saturating_add(slot.into())
    }
}

/// The least and the greatest value of an attribute, NaN left out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Range {
    /// Of an unsigned type.
    Unsigned(u64, u64),
    /// Of a signed type.
    Signed(i64, i64),
    /// Of a floating-point type.
    Float(f64, f64),
    /// There are values, and all of them are NaN.
    OnlyNan,
}

/// The zone maps of a node: per attribute, ascending by slot, over the points whose scan has it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Zones {
    /// Over the node's own points.
    pub own: Vec<(Slot, Range)>,
    /// Over the subtree.
    pub subtree: Vec<(Slot, Range)>,
}

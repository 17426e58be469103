//! Stores built from the naive tree, and points that know who they are.

use crate::codec::BlockSize;
use crate::lattice::{BIAS, Cube, Exactness, Key, Lattice, LatticeBox, LatticePoint};
use crate::octree::{LEAST_PART_POINTS, Params, naive, split_at_least, steps, wins};
use crate::points::{Attribute, Column, ScalarType};
use crate::store::model::{Rejected, Scan, ScanId, Slot};
use crate::store::{
    EncodeScratch, EncodedNode, Flip, NodeChange, NodeInput, PointColumns, ScanTable, SiteOptions, Snapshot, Store,
    Summary, encode_node, merge_subtree,
};
use proptest::prelude::*;
use std::collections::HashMap;

/// A point with its whole record, in the order that the rule gives: key, record, scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Point {
    pub key: Key,
    pub class: u8,
    /// Every point's own number.
    pub id: u32,
    /// Only scan 2 has it.
    pub height: Option<i16>,
    pub scan: ScanId,
}

impl Point {
    pub fn at(&self) -> LatticePoint {
        self.key.point()
    }
}

pub const QUANTUM: f64 = 0.25;

pub struct TestStore {
    /// Ascending.
    pub points: Vec<Point>,
    pub snapshot: Snapshot,
    pub lattice: Lattice,
    /// Exponent of the largest root, 0 without points.
    pub k: u8,
    pub g: u8,
}

impl TestStore {
    /// Of all points; of none it is one place.
    pub fn bounds(&self) -> LatticeBox {
        let boxes = self.points.iter().map(|p| LatticeBox { min: p.at(), max: p.at() });
        let nowhere = LatticePoint([0; 3]);
        boxes.reduce(|a, b| a.union(&b)).unwrap_or(LatticeBox { min: nowhere, max: nowhere })
    }
}

/// Numbers points; those of odd number are of scan 1.
pub fn numbered(places: Vec<(LatticePoint, u8)>) -> Vec<Point> {
    let point = |(id, (at, class)): (u32, (LatticePoint, u8))| {
        let scan = if id % 2 == 1 { 1 } else { 2 };
        let height = (scan == 2).then_some((id % 7) as i16 - 3);
        Point { key: Key::of(at), class, id, height, scan }
    };
    let mut points: Vec<Point> = (0..).zip(places).map(point).collect();
    points.sort_unstable();
    points
}

/// Few points in a small place, with repeated positions, around the origin and across large boundaries.
pub fn places(most: usize) -> impl Strategy<Value = Vec<(LatticePoint, u8)>> {
    let corner = prop::sample::select(vec![BIAS as u64, (BIAS as u64) & !0xfff, 1 << 40, (1 << 40) - 9]);
    (corner, 1_u32..7).prop_flat_map(move |(corner, bits)| {
        let coordinate = 0..1_u64 << bits;
        let point = (prop::array::uniform3(coordinate), 0_u8..4)
            .prop_map(move |(p, class)| (LatticePoint(p.map(|c| corner + c)), class));
        prop::collection::vec(point, 0..most)
    })
}

fn scan(id: ScanId, name: &str, attributes: Vec<Slot>, visible: bool, points: &[Point]) -> Scan {
    let own = || points.iter().filter(|p| p.scan == id).map(Point::at);
    let stored = own().count() as u64;
    Scan {
        id,
        name: name.into(),
        source: format!("{name}.las"),
        source_bytes: 0,
        identity: [id as u8; 32],
        time: 0,
        pose: std::array::from_fn(|i| f64::from(u8::from(i % 5 == 0))),
        read: stored,
        stored,
        rejected: Rejected::default(),
        bounds: own().map(LatticeBox::of).reduce(|a, b| a.union(&b)),
        exactness: Exactness::Exact,
        largest_error: 0.0,
        format: "las".into(),
        las: None,
        color_depth: None,
        visible,
        attributes,
        crs: None,
    }
}

/// A store of these layers, with scan 1 `north` and scan 2 `roof`; `hidden` of them is not visible.
pub fn store(layers: &[Vec<Point>], params: Params, hidden: Option<ScanId>) -> TestStore {
    fill(&Store::in_memory(options(params)).unwrap(), layers, params, hidden)
}

/// The same in a file.
pub fn store_at(path: &std::path::Path, layers: &[Vec<Point>], params: Params) -> TestStore {
    fill(&Store::create(path, options(params)).unwrap(), layers, params, None)
}

fn options(params: Params) -> SiteOptions {
    let options = SiteOptions::new(Lattice::uniform(QUANTUM).unwrap());
    SiteOptions { g: params.g, leaf_capacity: params.leaf_capacity, ..options }
}

fn fill(store: &Store, layers: &[Vec<Point>], params: Params, hidden: Option<ScanId>) -> TestStore {
    let lattice = Lattice::uniform(QUANTUM).unwrap();
    let mut writer = store.writer().unwrap();
    let attributes = [
        Attribute::new("Classification", ScalarType::U8),
        Attribute::new("code", ScalarType::U32),
        // Before the height by name: of points on one position the number decides, as in the order of `Point`.
        Attribute::new("height", ScalarType::I16),
    ];
    let slots = writer.add_attributes(&attributes).unwrap();
    let &[class, id, height] = slots.as_slice() else { panic!("three attributes") };
    assert_eq!((writer.reserve_scan(), writer.reserve_scan()), (1, 2));
    let mut table = ScanTable::new(writer.attributes());
    table.insert(1, &[class, id], None);
    table.insert(2, &[class, id, height], None);
    let ids = writer.chunk_ids();
    let mut scratch = EncodeScratch::default();
    let (mut nodes, mut roots) = (Vec::new(), Vec::new());
    for (layer, points) in layers.iter().enumerate() {
        let root = naive::root(points, Point::at, params.g);
        roots.push(root);
        let Some(root) = root else { continue };
        let keys: Vec<Key> = points.iter().map(|p| p.key).collect();
        let win_of: HashMap<u32, i8> = points.iter().map(|p| p.id).zip(wins(&keys, root.k() as i8)).collect();
        let mut summaries: HashMap<Cube, Summary> = HashMap::new();
        // Children before parents.
        for (key, (leaf, _, own)) in naive::tree(points, Point::at, params).into_iter().rev() {
            let cube = Cube::from_node_key(&key).unwrap();
            let below: Vec<Summary> = (0..8).filter_map(|o| summaries.get(&cube.child(o)?).cloned()).collect();
            let children = (0..8)
                .filter(|&o| cube.child(o).is_some_and(|c| summaries.contains_key(&c)))
                .fold(0, |m, o| m | 1 << o);
            let keys: Vec<Key> = own.iter().map(|p| p.key).collect();
            let wins: Vec<i8> = own.iter().map(|p| win_of[&p.id]).collect();
            let columns = PointColumns {
                scans: own.iter().map(|p| p.scan).collect(),
                columns: vec![
                    (class, Column::U8(own.iter().map(|p| p.class).collect())),
                    (id, Column::U32(own.iter().map(|p| p.id).collect())),
                    (height, Column::I16(own.iter().map(|p| p.height.unwrap_or(0)).collect())),
                ],
            };
            let layer = layer as u16;
            // Of all sizes, so that small nodes have several.
            let block_size = BlockSize::of_exponent(4 + cube.k().wrapping_add(own.len() as u8) % 9).unwrap();
            // Of small nodes, too, several; of others as in a real store.
            let least = [4, 16, LEAST_PART_POINTS][usize::from(cube.k()) % 3];
            let plan = split_at_least(&wins, &steps(&keys, &wins), least);
            let parts = columns.cut(&plan);
            let input = NodeInput { layer, cube, leaf, children, keys: &keys, plan: &plan, block_size };
            let EncodedNode { mut head, mut zones, chunks } =
                encode_node(&input, &mut &parts[..], &table, &ids, &mut scratch).unwrap();
            summaries.insert(cube, merge_subtree(&mut head, &mut zones, &below));
            writer.put_chunks(&chunks).unwrap();
            nodes.push((head, zones));
        }
    }
    let mut points = layers.concat();
    points.sort_unstable();
    let k = roots.iter().flatten().map(|r| r.k()).max().unwrap_or(0);
    let flip = Flip {
        scans_added: vec![
            scan(1, "north", vec![class, id], hidden != Some(1), &points),
            scan(2, "roof", vec![class, id, height], hidden != Some(2), &points),
        ],
        roots: Some(roots),
        nodes: NodeChange::ReplaceAll(nodes),
        ..Flip::default()
    };
    writer.commit(flip).unwrap();
    TestStore { points, snapshot: store.snapshot().unwrap(), lattice, k, g: params.g }
}

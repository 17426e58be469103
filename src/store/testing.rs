//! Small stores of random points, for tests.

use super::decode::decode_part;
use super::model::{Rejected, Scan, Slot};
use super::*;
use crate::codec::{BlockSize, Decoder};
use crate::lattice::{BIAS, Cube, Exactness, Key, Lattice, LatticeBox, LatticePoint};
use crate::octree::{self, Params, assemble};
use crate::points::{Attribute, Column, ScalarType};
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::PathBuf;

/// The hashes of a store.
pub fn digested(store: &Store) -> Digest {
    digest(&store.snapshot().unwrap(), &|_| true).unwrap().unwrap()
}

/// What a check to its end finds.
pub fn verified(store: &Store, deep: bool) -> Report {
    verify(store, deep, &|_, _| ControlFlow::Continue(())).unwrap()
}

/// A point with two attributes, of which scan 2 has only the first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Point {
    pub key: Key,
    pub intensity: u16,
    pub time: u64,
    pub scan: u32,
}

/// The canonical record bytes: GpsTime, which scan 2 lacks, before Intensity.
fn record(p: &Point) -> Vec<u8> {
    let time = p.time.to_le_bytes();
    let time: &[u8] = if p.scan == 2 { &[] } else { &time };
    [time, &p.intensity.to_le_bytes()].concat()
}

pub const PARAMS: Params = Params { g: 2, leaf_capacity: 40 };

/// Where a store can be made, under a name with every special character of a URI; the folder goes when it is dropped.
pub fn folder() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a store?#%.esker");
    (folder, path)
}

pub fn options() -> SiteOptions {
    SiteOptions {
        g: PARAMS.g,
        leaf_capacity: PARAMS.leaf_capacity,
        ..SiteOptions::new(Lattice::uniform(0.01).unwrap())
    }
}

pub fn point(at: [i64; 3], intensity: u16, time: u64, scan: u32) -> Point {
    let at = LatticePoint(at.map(|c| (BIAS + c) as u64));
    Point { key: Key::of(at), intensity, time: if scan == 2 { 0 } else { time }, scan }
}

pub fn points(most: usize) -> impl Strategy<Value = Vec<Point>> {
    let one = (prop::array::uniform3(-60_i64..60), any::<u16>(), any::<u64>(), 1_u32..=2);
    prop::collection::vec(one.prop_map(|(at, i, t, s)| point(at, i, t, s)), 1..most)
}

/// Points of a fixed pseudo-random sequence.
pub fn some_points(n: u64) -> Vec<Point> {
    let mix = |i: u64| (i + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    (0..n)
        .map(|i| {
            let r = mix(i);
            let at = [r % 97, r >> 20 & 63, r >> 40 & 15].map(|c| c as i64 - 30);
            point(at, (r >> 48) as u16, mix(r), 1 + (r >> 33 & 1) as u32)
        })
        .collect()
}

fn attributes() -> [Attribute; 2] {
    [Attribute::new("Intensity", ScalarType::U16), Attribute::new("GpsTime", ScalarType::F64)]
}

fn scan(id: u32, slots: &[Slot], points: &[Point]) -> Scan {
    let mine = || points.iter().filter(|p| p.scan == id);
    let stored = mine().count() as u64;
    let bounds = mine().map(|p| LatticeBox::of(p.key.point())).reduce(|a, b| a.union(&b));
    Scan {
        id,
        name: format!("scan {id}"),
        source: format!("scans/{id}.las"),
        source_bytes: 1000,
        identity: [id as u8; 32],
        time: 1_700_000_000,
        pose: std::array::from_fn(|i| if i % 5 == 0 { 1.0 } else { -0.0 }),
        read: stored + 3,
        stored,
        rejected: Rejected { not_finite: 1, out_of_range: 2, truncated: 0 },
        bounds,
        exactness: Exactness::Exact,
        largest_error: 0.0,
        format: "las".into(),
        las: None,
        color_depth: None,
        visible: true,
        attributes: slots.to_vec(),
        crs: None,
    }
}

/// Writes the chunks of a tree of these points and gives the change that makes them the whole content. Scans that were
/// there before are removed.
pub fn prepare(writer: &mut Writer, mut points: Vec<Point>, before: &[Scan]) -> Flip {
    let slots = writer.add_attributes(&attributes()).unwrap();
    while writer.reserve_scan() < 2 {}
    // Ties between keys are settled by record bytes, then by the scan's identity, which is its number here.
    points.sort_by_cached_key(|p| (p.key, record(p), p.scan));
    let mut table = ScanTable::new(writer.attributes());
    // In canonical order: GpsTime before Intensity.
    let scans = [scan(1, &[slots[1], slots[0]], &points), scan(2, &[slots[0]], &points)];
    scans.iter().for_each(|s| table.insert(s.id, &s.attributes, s.color_depth));
    let keys: Vec<Key> = points.iter().map(|p| p.key).collect();
    let bounds = scans.iter().filter_map(|s| s.bounds).reduce(|a, b| a.union(&b));
    let mut nodes = Vec::new();
    let root = bounds.map(|b| octree::root_of(&b, PARAMS));
    if let Some(root) = root {
        let wins = octree::wins(&keys, root.k() as i8);
        let mut summaries: BTreeMap<(u8, LatticePoint), Summary> = BTreeMap::new();
        let mut scratch = EncodeScratch::default();
        let ids = writer.chunk_ids();
        assemble::build_bucket(root, &keys, &wins, assemble::Place::Root, PARAMS, |node| {
            let pick = |i: &u32| points[*i as usize];
            let own: Vec<Point> = node.points.iter().map(pick).collect();
            let keys: Vec<Key> = own.iter().map(|p| p.key).collect();
            let wins: Vec<i8> = node.points.iter().map(|&i| wins[i as usize]).collect();
            let columns = PointColumns {
                scans: own.iter().map(|p| p.scan).collect(),
                columns: vec![
                    (slots[0], Column::U16(own.iter().map(|p| p.intensity).collect())),
                    (slots[1], Column::F64(own.iter().map(|p| f64::from_bits(p.time)).collect())),
                ],
            };
            let plan = octree::split(&wins, &octree::steps(&keys, &wins));
            let input = NodeInput {
                layer: 0,
                cube: node.cube,
                leaf: node.leaf,
                children: node.children,
                keys: &keys,
                plan: &plan,
                block_size: BlockSize::of_exponent(4 + node.cube.k() % 9).unwrap(),
            };
            let EncodedNode { mut head, mut zones, chunks } =
                encode_node(&input, &mut &columns.cut(&plan)[..], &table, &ids, &mut scratch).unwrap();
            writer.put_chunks(&chunks).unwrap();
            let children: Vec<Summary> = (0..8)
                .filter(|o| node.children >> o & 1 == 1)
                .filter_map(|o| node.cube.child(o))
                .map(|c| summaries[&(c.k(), c.low())].clone())
                .collect();
            let summary = merge_subtree(&mut head, &mut zones, &children);
            summaries.insert((node.cube.k(), node.cube.low()), summary);
            nodes.push((head, zones));
        });
    }
    let there = |s: &Scan| before.iter().any(|b| b.id == s.id);
    let (scans_changed, scans_added) = scans.into_iter().partition(there);
    Flip {
        scans_added,
        scans_changed,
        roots: Some(vec![root]),
        nodes: NodeChange::ReplaceAll(nodes),
        ..Flip::default()
    }
}

/// Makes these points the whole content.
pub fn replace(store: &Store, points: Vec<Point>) -> Committed {
    let before = store.snapshot().unwrap().scans().to_vec();
    let mut writer = store.writer().unwrap();
    let change = prepare(&mut writer, points, &before);
    writer.commit(change).unwrap()
}

/// All points of a snapshot, sorted.
pub fn content(snapshot: &Snapshot) -> Result<Vec<Point>, StoreError> {
    let mut all = Vec::new();
    let index = snapshot.index()?;
    let mut decoder = Decoder::new();
    for (node, head) in index.heads().iter().enumerate() {
        snapshot.zones(node as NodeIx)?;
        for part in 0..head.parts.len() {
            let part = decode_part(snapshot, head, part, &mut decoder)?;
            for i in 0..part.keys.len() {
                let value = |name: &str| {
                    let slot = snapshot.attributes().iter().find(|a| a.attribute.name == name).map(|a| a.id);
                    let column = part.columns.iter().find(|c| Some(c.0) == slot);
                    column.map_or(0, |c| u64::from_le_bytes(c.1.raw(i)))
                };
                all.push(Point {
                    key: part.keys[i],
                    intensity: value("Intensity") as u16,
                    time: value("GpsTime"),
                    scan: part.scans[i],
                });
            }
        }
    }
    all.sort();
    Ok(all)
}

pub fn sorted(mut points: Vec<Point>) -> Vec<Point> {
    points.sort();
    points
}

/// A cube that no test's points are in.
pub fn elsewhere() -> Cube {
    Cube::containing(LatticePoint([0; 3]), 5)
}

//! Invariant 7 on the store: the payload that a change reads is what OCTREE sections 3 and 4 name, and nothing else is
//! written again.

use super::*;
use crate::codec::Decoder;
use crate::ingest::batch::{Batch, add};
use crate::ingest::context::{Context, Resources};
use crate::ingest::layers::{joined, scan_table, withdraw};
use crate::ingest::report::{Report, Stages};
use crate::ingest::{IngestOptions, LatticeWish, ingest, sources};
use crate::lattice::{Key, NodeKey};
use crate::store::model::{SLOT_POSITION, Slot};
use crate::store::{Flip, Store, decode_part};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// SplitMix64.
struct Random(u64);

impl Random {
    fn below(&mut self, n: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ z >> 31) % n.max(1)
    }
}

fn options() -> IngestOptions {
    IngestOptions {
        lattice: LatticeWish { quantum: Some([1.0; 3]), phase: None },
        g: 2,
        leaf_capacity: 20,
        resources: Resources { threads: Some(2), ..Resources::default() },
        ..IngestOptions::default()
    }
}

/// A file of points in a cube; the fourth column is an attribute.
fn file(path: PathBuf, points: u64, origin: [u64; 3], side: u64, random: &mut Random) -> PathBuf {
    let mut text = String::from("x,y,z,Shade\n");
    for _ in 0..points {
        let at = origin.map(|o| o + random.below(side));
        writeln!(text, "{},{},{},{}", at[0], at[1], at[2], random.below(9)).unwrap();
    }
    std::fs::write(&path, text).unwrap();
    path
}

/// A site and a patch on it, small beside it.
struct Case {
    folder: tempfile::TempDir,
    site: PathBuf,
    patch: PathBuf,
}

impl Case {
    fn new(seed: u64) -> Self {
        let mut random = Random(seed);
        let folder = tempfile::tempdir().unwrap();
        let site = file(folder.path().join("site.csv"), 4000, [5000; 3], 300, &mut random);
        // Every third is beside the site, so that the root grows and shrinks.
        let beside = if seed.is_multiple_of(3) { 5000 } else { 0 };
        let origin = [(); 3].map(|()| 5000 + beside + random.below(250));
        let patch = file(folder.path().join("patch.csv"), 60, origin, 30, &mut random);
        Self { folder, site, patch }
    }

    fn store(&self) -> PathBuf {
        self.folder.path().join("s.esker")
    }
}

/// The cube of the root.
fn root(nodes: &BTreeMap<NodeKey, Known>) -> Cube {
    nodes.values().next().unwrap().head.cube
}

/// A node as the store has it.
struct Known {
    head: NodeHead,
    /// Keys and scans of its points.
    points: Vec<(Key, ScanId)>,
}

/// All nodes of layer 0, read through a handle of its own.
fn nodes(path: &Path) -> BTreeMap<NodeKey, Known> {
    let snapshot = Store::open(path).unwrap().snapshot().unwrap();
    let index = snapshot.index().unwrap();
    let mut decoder = Decoder::new();
    let known = |node| {
        let head: &NodeHead = index.head(node);
        let mut points = Vec::new();
        for part in 0..head.parts.len() {
            let part = decode_part(&snapshot, head, part, &mut decoder).unwrap();
            points.extend(part.keys.iter().copied().zip(part.scans.iter().copied()));
        }
        (head.cube.node_key(), Known { head: head.clone(), points })
    };
    index.layer(0).map(known).collect()
}

/// What was read of each node.
fn by_node(reads: BTreeSet<(u16, NodeKey, Slot)>) -> BTreeMap<NodeKey, BTreeSet<Slot>> {
    let mut found: BTreeMap<NodeKey, BTreeSet<Slot>> = BTreeMap::new();
    for (_, node, slot) in reads {
        found.entry(node).or_default().insert(slot);
    }
    found
}

/// Nodes whose chunk rows are the same before and after are those that did not change; how many there are.
fn unwritten(
    before: &BTreeMap<NodeKey, Known>,
    after: &BTreeMap<NodeKey, Known>,
    touched: &BTreeSet<NodeKey>,
) -> usize {
    let mut kept = 0;
    for (key, node) in before.iter().filter(|(key, node)| !touched.contains(*key) && node.head.own_points > 0) {
        let now = after.get(key).map(|now| now.head.chunk_base);
        assert_eq!(now, Some(node.head.chunk_base), "{:?} was written again", node.head.cube);
        kept += 1;
    }
    // Points that left a node of a tree with the same root and came back are no reason either. (What a leaf or a root writes
    // depends on more than its own points.)
    let same_root = root(before) == root(after);
    for (key, node) in before.iter().filter(|(_, node)| same_root && !node.head.leaf && node.head.own_points > 0) {
        let Some(now) = after.get(key).filter(|now| !now.head.leaf && now.points == node.points) else { continue };
        assert_eq!(now.head.chunk_base, node.head.chunk_base, "{:?} was written again", node.head.cube);
    }
    kept
}

fn cube(key: &NodeKey) -> Cube {
    Cube::from_node_key(key).unwrap()
}

#[test]
fn an_added_scan_reads_and_writes_the_nodes_that_receive_points() {
    let mut kept = 0;
    for seed in 0..24 {
        let case = Case::new(seed);
        let store_path = case.store();
        ingest(&store_path, std::slice::from_ref(&case.site), &options(), &()).unwrap();
        let before = nodes(&store_path);
        let reads = Context::run(&store_path, &Resources::default(), &(), |context| {
            let store = Store::open(&store_path)?;
            let mut writer = context.writer(&store)?;
            let held = store.snapshot()?;
            let sources = sources::open(
                &sources::Inputs::Files(std::slice::from_ref(&case.patch)),
                &options(),
                sources::Stored { scans: held.scans(), lattice: None },
                &(),
            )?
            .sources;
            let batch = Batch {
                sources: &sources,
                measured: &[None],
                crs: None,
                replaced: &[],
                visible: true,
                strict: false,
                keep_going: false,
            };
            let mut report = Report::default();
            add(context, &store, &mut writer, &batch, &mut Stages::default(), &mut report)?;
            assert!(store.snapshot()?.nodes().root(1)?.is_none(), "seed {seed}: it became a layer");
            assert!(report.chunks_written > 0, "seed {seed}");
            Ok(by_node(held.take_reads()))
        })
        .unwrap();
        let after = nodes(&store_path);
        let (old, new) = (root(&before), root(&after));
        let mut named = BTreeSet::new();
        for (key, node) in &before {
            let now = after.get(key);
            let receives = now.is_some_and(|now| now.head.subtree_points > node.head.subtree_points);
            // A root that was, and what became part of a leaf above or in its place.
            let absorbed = || after.values().any(|n| n.head.leaf && n.head.cube.contains_cube(cube(key)));
            if receives || old != new && (cube(key) == old || absorbed()) {
                named.insert(*key);
            }
        }
        let with_points = |key: &NodeKey| before[key].head.own_points > 0;
        let read: BTreeSet<NodeKey> = reads.keys().copied().collect();
        if old == new {
            assert_eq!(read, named.iter().copied().filter(with_points).collect(), "seed {seed}");
        } else {
            assert!(read.is_subset(&named), "seed {seed}");
        }
        kept += unwritten(&before, &after, &named);
    }
    assert!(kept > 24 * 100, "{kept}: hardly any node was left alone");
}

#[test]
fn a_removed_scan_reads_and_writes_the_nodes_that_lose_points_and_those_that_fill_their_cells() {
    let mut kept = 0;
    for seed in 100..124 {
        let case = Case::new(seed);
        let store_path = case.store();
        ingest(&store_path, &[case.site, case.patch], &options(), &()).unwrap();
        let before = nodes(&store_path);
        let reads = Context::run(&store_path, &Resources::default(), &(), |context| {
            let store = Store::open(&store_path)?;
            let mut writer = context.writer(&store)?;
            let snapshot = store.snapshot()?;
            let doomed: Vec<ScanId> = snapshot.scans().iter().filter(|s| s.name == "patch").map(|s| s.id).collect();
            let order = Arc::new(ScanOrder::new(snapshot.scans(), writer.attributes()));
            let table = scan_table(writer.attributes(), snapshot.scans());
            let params = Params { g: 2, leaf_capacity: 20 };
            let ground = Ground { snapshot: &snapshot, params, scans: &order, table: &table };
            let edit = withdraw(context, &ground, &mut writer, 0, &doomed)?.unwrap();
            let reads = snapshot.take_reads();
            let flip = Flip { scans_removed: doomed, ..joined(snapshot.site(), vec![edit]) };
            drop(snapshot);
            writer.commit(flip)?;
            Ok(by_node(reads))
        })
        .unwrap();
        let after = nodes(&store_path);
        let patch_id = 2;
        let mut named = BTreeSet::new();
        for (key, node) in &before {
            for (vacated, _) in node.points.iter().filter(|(_, scan)| *scan == patch_id) {
                named.insert(*key);
                let below = before.range(*key..=cube(key).last_node_key());
                named.extend(below.map(|(k, _)| *k).filter(|k| cube(k).contains(vacated.point())));
            }
        }
        let (old, new) = (root(&before), root(&after));
        for key in before.keys() {
            let chain = old != new && cube(key).contains_cube(new);
            let rebuilt = old != new && before.get(&new.node_key()).is_none_or(|n| n.head.leaf);
            // A leaf that was an inner node takes over what was below it.
            let leaves = after.iter().filter(|(k, n)| n.head.leaf && before.get(*k).is_none_or(|b| !b.head.leaf));
            let collapsed = leaves.clone().any(|(k, _)| cube(k).contains_cube(cube(key)));
            if chain || rebuilt || collapsed {
                named.insert(*key);
            }
        }
        let written =
            |key: &NodeKey| after.get(key).map(|n| n.head.chunk_base) != before.get(key).map(|n| n.head.chunk_base);
        for (key, slots) in &reads {
            if !named.contains(key) {
                // The levels of a leaf's points depend on the positions above it.
                let over_leaf =
                    after.iter().any(|(k, n)| n.head.leaf && written(k) && cube(key).contains_cube(cube(k)));
                let only_positions = slots.iter().eq([&SLOT_POSITION]);
                assert!(over_leaf && only_positions, "seed {seed}: {:?} was read for nothing", cube(key));
            }
        }
        for (key, node) in &before {
            let loses = node.points.iter().any(|(_, scan)| *scan == patch_id);
            assert!(!loses || reads.contains_key(key), "seed {seed}: what loses points was not read");
        }
        kept += unwritten(&before, &after, &named);
    }
    assert!(kept > 24 * 100, "{kept}: hardly any node was left alone");
}

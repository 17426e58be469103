//! What a changed tree comes to: rows and chunks of the nodes whose content is new, rows alone of those above them.

use super::super::IngestError;
use super::super::gather::Scratch;
use super::nodes::{Change, Own, Stored};
use super::{Ground, Point, gathered};
use crate::lattice::{Cube, Key, LOW_DIGITS, NodeKey};
use crate::octree::{self, Nodes, Tree, TreePoint, wins};
use crate::store::model::{NodeHead, Zones};
use crate::store::{ChunkIds, EncodeScratch, EncodedNode, NodeInput, Summary, Writer, encode_node, merge_subtree};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Nodes that are encoded before they are written: enough for all threads, little enough for memory.
const WINDOW: usize = 64;

/// The part of a commit that one layer's change makes.
#[derive(Debug, Default)]
pub(in super::super) struct Edit {
    pub layer: u16,
    pub root: Option<Cube>,
    pub put: Vec<(NodeHead, Zones)>,
    pub delete: Vec<(u16, Cube)>,
    /// Chunk rows written.
    pub chunks: u64,
    /// Points in nodes that were written.
    pub points: u64,
}

/// A node to encode.
struct Job<'p, 'a> {
    cube: Cube,
    leaf: bool,
    children: u8,
    points: &'p [Point<'a>],
    wins: Vec<i8>,
}

/// Encodes and writes what is new; gives the rows.
pub(super) fn finish(
    ground: &Ground<'_>,
    writer: &mut Writer,
    layer: u16,
    mut tree: Tree<Stored<'_>>,
) -> Result<Edit, IngestError> {
    let stored_root = ground.snapshot.site().roots.get(usize::from(layer)).copied().flatten();
    let root = tree.root();
    keep_unchanged(&mut tree, root == stored_root)?;
    let nodes = tree.nodes();
    let mut edit = Edit { layer, root, ..Edit::default() };
    edit.delete = nodes
        .changes
        .iter()
        .filter(|(_, change)| matches!(change, Change::Gone))
        .filter_map(|(key, _)| Some((layer, Cube::from_node_key(key)?)))
        .collect();
    let Some(root) = root else { return Ok(edit) };
    let mut affected = Affected::of(nodes, root);
    affected.jobs(nodes, ground, root)?;

    let ids = writer.chunk_ids();
    let mut encoded: BTreeMap<NodeKey, (NodeHead, Zones)> = BTreeMap::new();
    let jobs = std::mem::take(&mut affected.jobs);
    for window in jobs.chunks(WINDOW) {
        let nodes: Vec<EncodedNode> = window
            .par_iter()
            .map_init(<(EncodeScratch, Scratch)>::default, |scratch, job| encode(ground, layer, &ids, job, scratch))
            .collect::<Result<_, _>>()?;
        for node in nodes {
            writer.put_chunks(&node.chunks)?;
            edit.chunks += node.chunks.len() as u64;
            edit.points += node.head.own_points;
            encoded.insert(node.head.cube.node_key(), (node.head, node.zones));
        }
    }
    summarise(ground, nodes, &affected.cubes, root, &mut encoded, &mut edit.put)?;
    Ok(edit)
}

/// Points that were written back where they were need no new chunks. Not so in a leaf or a root: there the parts depend
/// on more than the node's own points.
fn keep_unchanged(tree: &mut Tree<Stored<'_>>, same_root: bool) -> Result<(), IngestError> {
    let root = tree.root();
    let nodes = tree.nodes();
    let mut kept = Vec::new();
    for (key, change) in &nodes.changes {
        let (Change::Here { leaf: false, own: Own::New(points), .. }, Some(cube)) = (change, Cube::from_node_key(key))
        else {
            continue;
        };
        let was_inner = nodes.head(cube).is_some_and(|head| !head.leaf);
        if was_inner && (same_root || root != Some(cube)) && nodes.has_just(cube, points)? {
            kept.push(*key);
        }
    }
    tree.nodes_mut().keep(&kept);
    Ok(())
}

/// The nodes whose rows change: those with changes and all above them.
struct Affected<'p, 'a> {
    cubes: BTreeSet<NodeKey>,
    /// Those with a new leaf at or below them, whose points' levels depend on the points above.
    over_leaves: BTreeSet<NodeKey>,
    jobs: Vec<Job<'p, 'a>>,
}

impl<'p, 'a> Affected<'p, 'a> {
    fn of(nodes: &'p Stored<'a>, root: Cube) -> Self {
        let (mut cubes, mut over_leaves) = (BTreeSet::new(), BTreeSet::new());
        for (key, change) in &nodes.changes {
            let Some(cube) = Cube::from_node_key(key).filter(|cube| root.contains_cube(*cube)) else { continue };
            let new_leaf = matches!(change, Change::Here { leaf: true, own: Own::New(_), .. });
            let from = if matches!(change, Change::Gone) { cube.k() + 1 } else { cube.k() };
            for k in from..=root.k() {
                let above = cube.ancestor(k).node_key();
                // What lies above one that is known is known, too.
                let known = !cubes.insert(above);
                if known && (!new_leaf || over_leaves.contains(&above)) {
                    break;
                }
                if new_leaf {
                    over_leaves.insert(above);
                }
            }
        }
        Self { cubes, over_leaves, jobs: Vec::new() }
    }

    /// Lists the nodes to encode, with the wins of their points.
    fn jobs(&mut self, nodes: &'p Stored<'a>, ground: &Ground<'_>, root: Cube) -> Result<(), IngestError> {
        let mut open = vec![(root, Vec::new())];
        while let Some((cube, above)) = open.pop() {
            let Some(row) = nodes.row(cube)? else { continue };
            let key = cube.node_key();
            let children = children(nodes, cube, row.leaf)?;
            if let Some(Change::Here { own: Own::New(points), .. }) = nodes.changes.get(&key)
                && !points.is_empty()
            {
                let points = points.as_slice();
                let wins = if row.leaf || cube == root {
                    wins_under(points, &above, root)
                } else {
                    vec![ground.params.cell(cube.k()); points.len()]
                };
                self.jobs.push(Job { cube, leaf: row.leaf, children, points, wins });
            }
            if children == 0 {
                continue;
            }
            let below: Vec<Cube> = (0..8)
                .filter(|octant| children & 1 << octant != 0)
                .filter_map(|octant| cube.child(octant))
                .filter(|child| self.cubes.contains(&child.node_key()))
                .collect();
            let over_leaves = |cube: &Cube| self.over_leaves.contains(&cube.node_key());
            let all = if below.iter().any(over_leaves) {
                let mut all = above;
                all.extend(nodes.keys(cube)?);
                all.sort();
                all
            } else {
                Vec::new()
            };
            open.extend(below.into_iter().map(|child| {
                let keys = if over_leaves(&child) { super::inside(&all, child).to_vec() } else { Vec::new() };
                (child, keys)
            }));
        }
        Ok(())
    }
}

/// The wins of a node's points among these and the points stored above it, both ascending.
fn wins_under(points: &[Point<'_>], above: &[Key], root: Cube) -> Vec<i8> {
    // Of equal keys the one stored coarser comes first.
    let mut merged: Vec<(Key, bool)> = above.iter().map(|&key| (key, false)).collect();
    merged.extend(points.iter().map(|p| (p.key(), true)));
    merged.sort();
    let keys: Vec<Key> = merged.iter().map(|m| m.0).collect();
    let all = wins(&keys, root.k() as i8);
    all.into_iter().zip(merged).filter(|(_, (_, own))| *own).map(|(win, _)| win).collect()
}

/// Which octants of an inner node have a child.
fn children(nodes: &Stored<'_>, cube: Cube, leaf: bool) -> Result<u8, IngestError> {
    let mut mask = 0;
    if !leaf {
        for octant in 0..8 {
            if let Some(child) = cube.child(octant)
                && nodes.row(child)?.is_some()
            {
                mask |= 1 << octant;
            }
        }
    }
    Ok(mask)
}

fn encode(
    ground: &Ground<'_>,
    layer: u16,
    ids: &ChunkIds,
    job: &Job<'_, '_>,
    (scratch, gather): &mut (EncodeScratch, Scratch),
) -> Result<EncodedNode, IngestError> {
    let Job { cube, leaf, children, points, ref wins } = *job;
    let failed = |e| IngestError::Internal(format!("node {cube:?}: {e}"));
    let keys: Vec<Key> = points.iter().map(TreePoint::key).collect();
    let plan = octree::split(wins, &octree::steps(&keys, wins));
    let parts: Vec<_> = plan.iter().map(|part| gathered(ground.scans, points, &part.points, gather)).collect();
    let (plan, parts) = (&plan[..], &parts[..]);
    if cube.k() <= LOW_DIGITS {
        let keys: Vec<u64> = keys.iter().map(|key| key.low).collect();
        let input = NodeInput { layer, cube, leaf, children, keys: &keys, plan, parts };
        encode_node(&input, ground.table, ids, scratch).map_err(failed)
    } else {
        let input = NodeInput { layer, cube, leaf, children, keys: &keys, plan, parts };
        encode_node(&input, ground.table, ids, scratch).map_err(failed)
    }
}

/// Brings the rows of all affected nodes up to date, children first; gives the summary of `cube`.
fn summarise(
    ground: &Ground<'_>,
    nodes: &Stored<'_>,
    affected: &BTreeSet<NodeKey>,
    cube: Cube,
    encoded: &mut BTreeMap<NodeKey, (NodeHead, Zones)>,
    put: &mut Vec<(NodeHead, Zones)>,
) -> Result<Option<Summary>, IngestError> {
    let Some(row) = nodes.row(cube)? else { return Ok(None) };
    let stored = ground.index.find(nodes.layer, cube);
    let key = cube.node_key();
    if !affected.contains(&key) {
        let Some(node) = stored else { return Ok(None) };
        return Ok(Some(Summary::of(ground.index.head(node), &*ground.snapshot.zones(node)?)));
    }
    let children = children(nodes, cube, row.leaf)?;
    let mut below = Vec::new();
    for child in (0..8).filter(|octant| children & 1 << octant != 0).filter_map(|octant| cube.child(octant)) {
        below.extend(summarise(ground, nodes, affected, child, encoded, put)?);
    }
    let (mut head, mut zones) = match (encoded.remove(&key), stored, row.own) {
        (Some(new), _, _) => new,
        (None, _, 0) => (NodeHead::without_points(nodes.layer, cube), Zones::default()),
        (None, Some(node), _) => (ground.index.head(node).clone(), ground.snapshot.zones(node)?.as_ref().clone()),
        (None, None, _) => return Err(IngestError::Internal(format!("node {cube:?} was not encoded"))),
    };
    head.leaf = row.leaf;
    head.children = children;
    let summary = merge_subtree(&mut head, &mut zones, &below);
    if summary.points != row.rem {
        let what = format!("node {cube:?} has {} points in its subtree, not {}", summary.points, row.rem);
        return Err(IngestError::Internal(what));
    }
    put.push((head, zones));
    Ok(Some(summary))
}

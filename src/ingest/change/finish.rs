//! What a changed tree comes to: rows and chunks of the nodes whose content is new, rows alone of those above them.

use super::super::IngestError;
use super::super::progress::Progress;
use super::super::writing::{Sink, through};
use super::columns::Scattered;
use super::nodes::{Change, Own, Stored};
use super::pool::Pool;
use super::{Ground, Point};
use crate::lattice::{Cube, Key, LOW_DIGITS, NodeKey};
use crate::octree::{self, Nodes, Row, Tree, TreePoint, wins};
use crate::store::model::{NodeHead, Zones};
use crate::store::{ChunkIds, EncodeScratch, NodeInput, Summary, Writer, block_size, encode_node, merge_subtree};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Bytes of encoded nodes that wait for the writer, at most.
const QUEUE_BYTES: usize = 16 << 20;

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

/// Encodes and writes what is new; gives the rows.
pub(super) fn finish(
    ground: &Ground<'_>,
    writer: &mut Writer,
    layer: u16,
    tree: &Tree<Stored<'_>>,
    progress: &dyn Progress,
) -> Result<Edit, IngestError> {
    let stored_root = ground.snapshot.site().roots.get(usize::from(layer)).copied().flatten();
    let nodes = tree.nodes();
    let mut edit = Edit { layer, root: tree.root(), ..Edit::default() };
    let gone = |(key, change): (&NodeKey, &Change<'_>)| match change {
        Change::Gone => Some((layer, Cube::from_node_key(key)?)),
        Change::Here { .. } => None,
    };
    edit.delete = nodes.changes().iter().filter_map(gone).collect();
    let Some(root) = tree.root() else { return Ok(edit) };
    let affected = Affected::of(nodes, root);
    let ids = ChunkIds::default();
    let ((), written) = through(writer, QUEUE_BYTES, progress, |sink| {
        let same_root = stored_root == Some(root);
        let scratches = Pool::default();
        Job { ground, nodes, affected: &affected, root, same_root, ids: &ids, scratches, sink }.run(root, &[])
    })?;
    edit.chunks = written.chunks;
    let keyed = |(head, zones): (NodeHead, Zones)| (head.cube.node_key(), (head, zones));
    let mut encoded: BTreeMap<_, _> = written.nodes.into_iter().map(keyed).collect();
    edit.points = encoded.values().map(|(head, _)| head.own_points).sum();
    summarise(ground, nodes, &affected.cubes, root, &mut encoded, &mut edit.put)?;
    Ok(edit)
}

/// The nodes whose rows change: those with changes and all above them.
struct Affected {
    cubes: BTreeSet<NodeKey>,
    /// Those with a new leaf at or below them, whose points' levels depend on the points above.
    over_leaves: BTreeSet<NodeKey>,
}

impl Affected {
    fn of(nodes: &Stored<'_>, root: Cube) -> Self {
        let (mut cubes, mut over_leaves) = (BTreeSet::new(), BTreeSet::new());
        for (key, change) in nodes.changes().iter() {
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
        Self { cubes, over_leaves }
    }
}

/// Encoding, from the root down, on all threads.
struct Job<'j, 'a> {
    ground: &'j Ground<'j>,
    nodes: &'j Stored<'a>,
    affected: &'j Affected,
    root: Cube,
    same_root: bool,
    ids: &'j ChunkIds,
    scratches: Pool<EncodeScratch>,
    sink: Sink<'j>,
}

impl<'a> Job<'_, 'a> {
    /// Encodes what is new in the node of `cube` and below. `above` are the keys of the points stored in its proper
    /// ancestors and inside it, if there is a new leaf at or below it.
    fn run(&self, cube: Cube, above: &[Key]) -> Result<(), IngestError> {
        let Some(row) = self.nodes.row(cube)? else { return Ok(()) };
        let children = children(self.nodes, cube, row.leaf)?;
        let own = || match self.nodes.written(cube) {
            Some(points) if !points.is_empty() => {
                if !self.is_unchanged(cube, row.leaf, &points)? {
                    self.encode(cube, &row, children, &points, above)?;
                }
                self.nodes.advance(points.len());
                Ok(())
            }
            _ => Ok(()),
        };
        let over_leaves = |cube: &Cube| self.affected.over_leaves.contains(&cube.node_key());
        let below = || {
            let affected = |child: &Cube| self.affected.cubes.contains(&child.node_key());
            let below: Vec<Cube> = octants(cube, children).filter(affected).collect();
            let all = match below.iter().any(over_leaves) {
                true => merged(above, &self.nodes.keys(cube)?),
                false => Vec::new(),
            };
            let run = |child: Cube| {
                let above = if over_leaves(&child) { inside(&all, child) } else { &[] };
                self.run(child, above)
            };
            below.into_par_iter().try_for_each(run)
        };
        if children == 0 {
            return own();
        }
        let (below, own) = rayon::join(below, own);
        below.and(own)
    }

    /// Points that were written back where they were need no new chunks. Not so in a leaf, a root or what was one: there
    /// the parts depend on more than the node's own points.
    fn is_unchanged(&self, cube: Cube, leaf: bool, points: &[Point<'a>]) -> Result<bool, IngestError> {
        let Some(node) = self.nodes.stored(cube)?.filter(|node| !leaf && !node.leaf) else { return Ok(false) };
        let was_and_is_no_root = self.root != cube && !node.is_root();
        Ok((self.same_root || was_and_is_no_root) && self.nodes.has_just(&node, points))
    }

    fn encode(
        &self,
        cube: Cube,
        &Row { leaf, rem, .. }: &Row,
        children: u8,
        points: &Arc<Vec<Point<'a>>>,
        above: &[Key],
    ) -> Result<(), IngestError> {
        self.nodes.go_on()?;
        let keys: Vec<Key> = points.iter().map(TreePoint::key).collect();
        let wins = match leaf || cube == self.root {
            true => wins_under(&keys, above, self.root),
            false => vec![self.ground.params.cell(cube.k()); keys.len()],
        };
        let plan = octree::split(&wins, &octree::steps(&keys, &wins));
        let scattered = Scattered::new(points);
        let scan = |point: &Point<'_>| self.ground.scans.id(point.place());
        let parts: Vec<_> = plan.iter().map(|part| scattered.columns(&part.points, scan)).collect();
        let (layer, plan, mut parts, block_size) = (self.nodes.layer, &plan[..], &parts[..], block_size(rem));
        let encoded = self.scratches.lend(|scratch| {
            if cube.k() <= LOW_DIGITS {
                let keys: Vec<u64> = keys.iter().map(|key| key.low).collect();
                let input = NodeInput { layer, cube, leaf, children, keys: &keys, plan, block_size };
                encode_node(&input, &mut parts, self.ground.table, self.ids, scratch)
            } else {
                let input = NodeInput { layer, cube, leaf, children, keys: &keys, plan, block_size };
                encode_node(&input, &mut parts, self.ground.table, self.ids, scratch)
            }
        });
        (self.sink)(encoded.map_err(|e| IngestError::Internal(format!("node {cube:?}: {e}")))?)
    }
}

/// The wins of a node's points among these and the points stored above it, both ascending.
fn wins_under(keys: &[Key], above: &[Key], root: Cube) -> Vec<i8> {
    if above.is_empty() {
        return wins(keys, root.k() as i8);
    }
    // Of equal keys the one stored coarser comes first.
    let mut merged: Vec<(Key, bool)> = above.iter().map(|&key| (key, false)).collect();
    merged.extend(keys.iter().map(|&key| (key, true)));
    merged.sort();
    let keys: Vec<Key> = merged.iter().map(|m| m.0).collect();
    let all = wins(&keys, root.k() as i8);
    all.into_iter().zip(merged).filter(|(_, (_, own))| *own).map(|(win, _)| win).collect()
}

fn merged(a: &[Key], b: &[Key]) -> Vec<Key> {
    let mut all = [a, b].concat();
    // A stable sort merges two runs.
    all.sort();
    all
}

fn inside(keys: &[Key], cube: Cube) -> &[Key] {
    let (first, last) = (cube.first_key(), cube.last_key());
    &keys[keys.partition_point(|k| *k < first)..keys.partition_point(|k| *k <= last)]
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

/// The cubes of the octants in a mask.
fn octants(cube: Cube, mask: u8) -> impl Iterator<Item = Cube> {
    (0..8).filter(move |octant| mask & 1 << octant != 0).filter_map(move |octant| cube.child(octant))
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
    let stored = nodes.stored(cube)?;
    let rows = ground.snapshot.nodes();
    let key = cube.node_key();
    if !affected.contains(&key) {
        let Some(node) = stored else { return Ok(None) };
        return Ok(Some(Summary::of(&node, &*rows.zones(&node)?)));
    }
    let children = children(nodes, cube, row.leaf)?;
    let mut below = Vec::new();
    for child in octants(cube, children) {
        below.extend(summarise(ground, nodes, affected, child, encoded, put)?);
    }
    let (mut head, mut zones) = match (encoded.remove(&key), stored, row.own) {
        (Some(new), _, _) => new,
        (None, _, 0) => (NodeHead::without_points(nodes.layer, cube), Zones::default()),
        (None, Some(node), _) => (NodeHead::clone(&node), rows.zones(&node)?.as_ref().clone()),
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

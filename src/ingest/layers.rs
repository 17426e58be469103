//! Which layer takes new points, which give some up, and how layers become one.
//!
//! A scan that is dense where it lies goes into the tree that is there: little is rewritten beside it. A thin one that
//! reaches everywhere would rewrite everything, so it becomes a layer of its own, or joins one of its like. Each layer
//! that a batch can't join has at least [`MOST_REWRITTEN`] times its points, so layers are few; when there are too many,
//! all but the largest become one.

use super::IngestError;
use super::build::Sink;
use super::bulk::{LEAST_SHARE, Layer, Room, params};
use super::change::{Edit, Ground, Point, change, point_bytes, touched, touched_by_removal};
use super::context::Context;
use super::gather::ScanColumns;
use super::partition::Bucket;
use super::progress::Stage;
use super::stored::StoredPoints;
use crate::lattice::{Cube, Key};
use crate::store::model::{Scan, ScanId, Site, StoredAttribute};
use crate::store::{Digest, Digester, Flip, NodeChange, Nodes, ScanTable, Snapshot, Store, StoreError, Writer};
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// Points that may be rewritten for each new one, beside two leaves full.
const MOST_REWRITTEN: u64 = 8;

/// More new points than this are not put into a tree one by one: a layer of them is built on all threads, which is
/// several times quicker a point.
pub(super) const MOST_INSERTED: u64 = 1 << 21;

/// More layers than this are folded.
const MOST_LAYERS: usize = 8;

/// Where new points go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Target {
    /// Into the tree that is there.
    Existing(u16),
    /// Into a layer without a tree.
    New(u16),
}

/// Where these points, which ascend, go in a store that will have these attributes; `None` if they are too many to be looked
/// at one by one.
pub(super) fn target(
    context: &Context<'_>,
    snapshot: &Snapshot,
    attributes: &[StoredAttribute],
    points: Option<&[Point<'_>]>,
) -> Result<Target, IngestError> {
    let site = snapshot.site();
    if let Some(points) = points {
        let n = points.len() as u64;
        let most = n.saturating_mul(MOST_REWRITTEN).saturating_add(2 * u64::from(site.leaf_capacity));
        let most = most.min((context.memory / point_bytes(attributes)).saturating_sub(n));
        for layer in taken_layers(site) {
            if touched(&snapshot.nodes(), layer, points, most)?.is_some() {
                return Ok(Target::Existing(layer));
            }
        }
    }
    let free = site.roots.iter().position(Option::is_none).unwrap_or(site.roots.len());
    Ok(Target::New(u16::try_from(free).unwrap_or(u16::MAX)))
}

/// The layers that have a tree.
pub(super) fn taken_layers(site: &Site) -> impl Iterator<Item = u16> + '_ {
    (0..).zip(&site.roots).filter(|(_, root)| root.is_some()).map(|(layer, _)| layer)
}

/// Which attributes which scans have.
pub(super) fn scan_table<'s>(attributes: &[StoredAttribute], scans: impl IntoIterator<Item = &'s Scan>) -> ScanTable {
    let mut table = ScanTable::new(attributes);
    for scan in scans {
        table.insert(scan.id, &scan.attributes, scan.color_depth);
    }
    table
}

/// Takes all points of `doomed` scans (ascending) out of a layer; `None` if it has none.
pub(super) fn withdraw(
    context: &Context<'_>,
    ground: &Ground<'_>,
    writer: &mut Writer,
    layer: u16,
    doomed: &[ScanId],
) -> Result<Option<Edit>, IngestError> {
    let nodes = ground.snapshot.nodes();
    let Some(head) = nodes.root(layer)? else { return Ok(None) };
    let is_doomed = |scan: ScanId| doomed.binary_search(&scan).is_ok();
    let going: u64 = head.scans.iter().filter(|c| is_doomed(c.scan)).map(|c| c.subtree).sum();
    if going == 0 {
        return Ok(None);
    }
    if going == head.subtree_points {
        return Ok(Some(Edit { layer, delete: all_nodes(&nodes, layer)?, ..Edit::default() }));
    }
    let rewritten = touched_by_removal(&nodes, layer, doomed)?;
    let fits = rewritten.saturating_mul(point_bytes(writer.attributes())) <= context.memory;
    // Where most of a large layer changes, building it anew on all threads is quicker.
    let dense = rewritten > head.subtree_points / 2 && rewritten > 16 * u64::from(ground.params.leaf_capacity);
    if fits && !dense {
        return change(ground, writer, layer, doomed, Vec::new(), context.progress).map(Some);
    }
    rebuild(context, ground.snapshot, writer, &[layer], layer, |scan| !is_doomed(scan.id)).map(Some)
}

/// Builds the points of some layers, of the scans that pass `wanted`, as one layer.
pub(super) fn rebuild(
    context: &Context<'_>,
    snapshot: &Snapshot,
    writer: &mut Writer,
    layers: &[u16],
    into: u16,
    wanted: impl Fn(&Scan) -> bool,
) -> Result<Edit, IngestError> {
    let mut edit = Edit { layer: into, ..Edit::default() };
    for &layer in layers {
        edit.delete.extend(all_nodes(&snapshot.nodes(), layer)?);
    }
    let source = Source { snapshot, layers, attributes: writer.attributes().to_vec() };
    source.built(context, into, wanted, |room, layer, buckets| {
        edit.root = Some(layer.root);
        let written = room.write(context, writer, layer, buckets)?;
        edit.put = written.nodes;
        edit.chunks = written.chunks;
        edit.points = edit.put.iter().map(|(head, _)| head.own_points).sum();
        Ok(())
    })?;
    Ok(edit)
}

/// The digest of the tree that all layers together make.
pub(super) fn digest_of_all(context: &Context<'_>, snapshot: &Snapshot) -> Result<Digest, IngestError> {
    let layers: Vec<u16> = taken_layers(snapshot.site()).collect();
    let digester = Digester::new(snapshot)?;
    let nodes = Mutex::new(BTreeMap::new());
    let attributes = snapshot.attributes().to_vec();
    let source = Source { snapshot, layers: &layers, attributes };
    source.built(
        context,
        0,
        |_| true,
        |room, layer, buckets| {
            let sink = |cube: Cube, leaf, part| {
                let digest = digester.node(cube, leaf, [Ok(part)])?;
                nodes.lock().unwrap_or_else(PoisonError::into_inner).insert(cube.node_key(), digest);
                Ok(())
            };
            room.build(context, layer, buckets, Sink::Content(&sink))
        },
    )?;
    let nodes: Vec<Digest> = nodes.into_inner().unwrap_or_else(PoisonError::into_inner).into_values().collect();
    Ok(digester.store(&nodes))
}

/// Stored points that are to be built anew.
struct Source<'a> {
    snapshot: &'a Snapshot,
    layers: &'a [u16],
    attributes: Vec<StoredAttribute>,
}

impl Source<'_> {
    /// Reads the points of scans that pass `wanted` into buckets, and hands them to `build`, unless there are none.
    fn built(
        self,
        context: &Context<'_>,
        into: u16,
        wanted: impl Fn(&Scan) -> bool,
        build: impl FnOnce(&Room, &Layer<'_>, Vec<Bucket>) -> Result<(), IngestError>,
    ) -> Result<(), IngestError> {
        let site = self.snapshot.site();
        let stored = StoredPoints::new(context.path, self.snapshot, Some(self.layers), 0, wanted)?;
        let plans = stored.row_plans();
        let (points, payload) = (stored.points(), stored.payload_bytes());
        let room = Room::new(context, site.g, stored.bounds(), points, payload, payload / LEAST_SHARE)?;
        let partition = room.partition(&site.lattice);
        context.progress.stage(Stage::Read, points);
        let bounds = if room.wide {
            stored.read::<Key>(&partition, &plans, room.budget.open_bytes, context.progress)?
        } else {
            stored.read::<u64>(&partition, &plans, room.budget.open_bytes, context.progress)?
        };
        let buckets = partition.finish();
        let Some(bounds) = bounds else { return Ok(()) };
        let root = Cube::spanning(bounds.min, bounds.max, site.g);
        let scans = stored.scans().iter().zip(&plans);
        let columns: Vec<_> =
            scans.map(|(s, plan)| ScanColumns::new(s.id, s.identity, plan, s.attributes.clone())).collect();
        let table = scan_table(&self.attributes, stored.scans().iter().copied());
        let layer = Layer { layer: into, params: params(site), root, scans: &columns, table: &table };
        context.progress.stage(Stage::Build, points);
        build(&room, &layer, buckets)
    }
}

fn all_nodes(nodes: &Nodes, layer: u16) -> Result<Vec<(u16, Cube)>, StoreError> {
    Ok(nodes.all(layer)?.iter().map(|node| (layer, node.cube)).collect())
}

/// What edits of different layers come to, as part of a commit.
pub(super) fn joined(site: &Site, edits: Vec<Edit>) -> Flip {
    let mut roots = site.roots.clone();
    let (mut put, mut delete) = (Vec::new(), Vec::new());
    for edit in edits {
        // Layers whose nodes are all gone have no root, but for the one that they went into.
        for &(layer, cube) in &edit.delete {
            if let Some(root) = roots.get_mut(usize::from(layer))
                && *root == Some(cube)
            {
                *root = None;
            }
        }
        let layer = usize::from(edit.layer);
        if roots.len() <= layer {
            roots.resize(layer + 1, None);
        }
        roots[layer] = edit.root;
        put.extend(edit.put);
        delete.extend(edit.delete);
    }
    while roots.len() > 1 && roots.last() == Some(&None) {
        roots.pop();
    }
    Flip { roots: Some(roots), nodes: NodeChange::Delta { put, delete }, ..Flip::default() }
}

/// Makes one layer of all but the largest if there are too many; says whether.
pub(super) fn fold_if_many(context: &Context<'_>, store: &Store, writer: &mut Writer) -> Result<bool, IngestError> {
    let snapshot = store.snapshot()?;
    let roots = snapshot.nodes().roots()?;
    let mut sizes: Vec<(u64, u16)> = roots.iter().map(|root| (root.subtree_points, root.layer)).collect();
    if sizes.len() <= MOST_LAYERS {
        return Ok(false);
    }
    sizes.sort_unstable();
    let rest: u64 = sizes[..sizes.len() - 1].iter().map(|s| s.0).sum();
    // What is nearly as large as the largest is not worth keeping apart.
    if sizes.last().is_some_and(|largest| rest < largest.0 / 2) {
        sizes.pop();
    }
    let layers: Vec<u16> = sizes.iter().map(|s| s.1).collect();
    fold(context, snapshot, writer, &layers, layers.iter().copied().min().unwrap_or(0))?;
    Ok(true)
}

/// Makes one layer of all; says whether there were several.
pub(super) fn fold_all(context: &Context<'_>, store: &Store, writer: &mut Writer) -> Result<bool, IngestError> {
    let snapshot = store.snapshot()?;
    let layers: Vec<u16> = taken_layers(snapshot.site()).collect();
    if layers.len() < 2 && layers.first().is_none_or(|&layer| layer == 0) {
        return Ok(false);
    }
    fold(context, snapshot, writer, &layers, 0)?;
    Ok(true)
}

fn fold(
    context: &Context<'_>,
    snapshot: Snapshot,
    writer: &mut Writer,
    layers: &[u16],
    into: u16,
) -> Result<(), IngestError> {
    let edit = rebuild(context, &snapshot, writer, layers, into, |_| true)?;
    let flip = joined(snapshot.site(), vec![edit]);
    context.progress.stage(Stage::Commit, snapshot.scans().iter().map(|s| s.stored).sum());
    // A snapshot that is held keeps the log from being written back.
    drop(snapshot);
    context.unless_cancelled(|stop| writer.commit_unless(flip, stop))?;
    Ok(())
}

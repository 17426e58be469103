//! From buckets to encoded nodes: jobs run on all threads, in key order as far as possible, and what they leave for
//! coarser nodes is joined as soon as its turn comes.

use super::IngestError;
use super::gather::{RowSource, ScanColumns, Scratch, gather};
use super::loaded::{LoadScratch, Loaded, Payloads, Rows, load};
use super::partition::Bucket;
use super::progress::Progress;
use super::rows::RowKey;
use super::spill::Spill;
use crate::lattice::Cube;
use crate::octree::assemble::{Assembler, EmittedNode, Entry, OwnedNode, Place, Subtree, build_bucket};
use crate::octree::{self, Params, first_win, put_wins};
use crate::store::{
    ChunkIds, DecodedPart, EncodeScratch, EncodedNode, NodeInput, PointColumns, ScanTable, block_size, encode_node,
};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

/// The payloads of `points`, which leave a bucket whose own node samples cells of exponent `cell`: in one block for each
/// node that will store them, so that none keeps others' memory while it rises.
fn held(points: &[u32], wins: &[i8], cell: i8, rows: &Rows<'_>) -> Vec<Held> {
    // Wins are at most 48, and no smaller than `cell` here.
    let group = |i: u32| (wins[i as usize].max(cell) - cell) as u8;
    let mut grouped: [Vec<u32>; 256] = std::array::from_fn(|_| Vec::new());
    for &i in points {
        grouped[usize::from(group(i))].push(i);
    }
    let block = |of_group: Vec<u32>| (!of_group.is_empty()).then(|| Arc::new(rows.picked(of_group.into_iter())));
    let blocks = grouped.map(block);
    let mut next = [0_u32; 256];
    let held = |&i: &u32| {
        let group = usize::from(group(i));
        next[group] += 1;
        blocks[group].as_ref().map(|block| (block.clone(), next[group] - 1))
    };
    points.iter().filter_map(held).collect()
}

/// What does not change during a build.
pub(super) struct Plan<'a> {
    pub params: Params,
    pub layer: u16,
    pub root: Cube,
    pub scans: &'a [ScanColumns<'a>],
    pub table: &'a ScanTable,
    pub ids: &'a ChunkIds,
    pub spill: Option<&'a Spill>,
    /// Buckets with more rows than this are worked through cube by cube.
    pub most_rows: u64,
    /// What the run may use.
    pub memory: u64,
    pub threads: usize,
    pub progress: &'a dyn Progress,
    /// Takes finished nodes, from any thread.
    pub sink: Sink<'a>,
}

/// In which form nodes are wanted.
#[derive(Clone, Copy)]
pub(super) enum Sink<'a> {
    /// Encoded.
    Encoded(&'a (dyn Fn(EncodedNode) -> Result<(), IngestError> + Sync)),
    /// As they are: cube, leaf or not, points.
    Content(&'a (dyn Fn(Cube, bool, DecodedPart) -> Result<(), IngestError> + Sync)),
}

/// A cube's worth of work.
struct Job {
    cube: Cube,
    rows: u64,
    bucket: usize,
}

/// A point on its way to a coarser node.
type Held = (Arc<Payloads>, u32);

/// The points of a node above the buckets.
#[derive(Clone, Copy)]
struct Rising<'a>(&'a [Entry<Held>]);

impl<'a> RowSource<'a> for Rising<'a> {
    #[inline(always)]
    fn row(&self, row: u32) -> (u32, &'a [u8]) {
        let (payloads, row) = &self.0[row as usize].item;
        payloads.row(*row)
    }
}

/// Joins what jobs leave, in job order.
struct Joiner {
    assembler: Option<Assembler<Held>>,
    waiting: BTreeMap<usize, Subtree<Held>>,
    next: usize,
}

/// Builds the tree of all rows in `buckets` (in key order) and gives every node to the sink.
pub(super) fn build<K: RowKey>(plan: &Plan<'_>, buckets: Vec<Bucket>) -> Result<(), IngestError> {
    let jobs = jobs::<K>(plan, &buckets)?;
    // How many jobs still need each bucket: the last one takes its rows away.
    let needed: Vec<AtomicUsize> = buckets.iter().map(|_| AtomicUsize::new(0)).collect();
    for job in &jobs {
        needed[job.bucket].fetch_add(1, Ordering::Relaxed);
    }
    let buckets: Vec<Mutex<Option<Arc<Bucket>>>> = buckets.into_iter().map(|b| Mutex::new(Some(Arc::new(b)))).collect();
    let joiner = Mutex::new(Joiner {
        assembler: Some(Assembler::new(plan.root, plan.params)),
        waiting: BTreeMap::new(),
        next: 0,
    });
    let next_job = AtomicUsize::new(0);
    let failed = AtomicBool::new(false);
    let first_error = Mutex::new(None);
    let work = || {
        let mut worker = Worker::new(plan);
        let mut scratch = JobScratch::<K>::default();
        loop {
            let number = next_job.fetch_add(1, Ordering::Relaxed);
            let Some(job) = jobs.get(number) else { return Ok(()) };
            if failed.load(Ordering::Relaxed) {
                return Ok(());
            }
            if plan.progress.cancelled() {
                return Err(IngestError::Interrupted);
            }
            let last = needed[job.bucket].fetch_sub(1, Ordering::Relaxed) == 1;
            let bucket = {
                let mut place = buckets[job.bucket].lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                if last { place.take() } else { place.clone() }
            };
            let bucket = bucket.ok_or_else(|| IngestError::Internal("a bucket was taken twice".into()))?;
            let previous = number.checked_sub(1).map(|i| jobs[i].cube);
            let left = worker.run(job, previous, bucket, &mut scratch)?;
            plan.progress.advance(job.rows);
            if let Some(subtree) = left {
                let ready = advance(&joiner, number, subtree);
                worker.emit_owned(ready)?;
            }
        }
    };
    rayon::scope(|scope| {
        for _ in 0..plan.threads {
            scope.spawn(|_| {
                if let Err(error) = work() {
                    failed.store(true, Ordering::Relaxed);
                    first_error.lock().unwrap_or_else(std::sync::PoisonError::into_inner).get_or_insert(error);
                }
            });
        }
    });
    if let Some(error) = first_error.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner) {
        return Err(error);
    }
    let mut joiner = joiner.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    let mut rest = Vec::new();
    if let Some(assembler) = joiner.assembler.take() {
        assembler.finish(&mut |node| rest.push(node));
    }
    // The nodes above the last job, of which there may be some while all other threads have nothing left to do.
    rest.into_par_iter().map_init(|| Worker::new(plan), |worker, node| worker.emit_owned(vec![node])).collect()
}

/// Rows of the last jobs.
const LAST_ROWS: u64 = 1 << 16;

/// Hands over what job `number` left; returns the nodes that became certain by it.
fn advance(joiner: &Mutex<Joiner>, number: usize, subtree: Subtree<Held>) -> Vec<OwnedNode<Held>> {
    let mut ready = Vec::new();
    let mut joiner = joiner.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    joiner.waiting.insert(number, subtree);
    let Joiner { assembler, waiting, next } = &mut *joiner;
    if let Some(assembler) = assembler {
        while let Some(subtree) = waiting.remove(next) {
            *next += 1;
            assembler.push(subtree, &mut |node| ready.push(node));
        }
    }
    ready
}

/// The jobs, in key order: buckets, and the cubes of buckets that are too large for one go.
fn jobs<K: RowKey>(plan: &Plan<'_>, buckets: &[Bucket]) -> Result<Vec<Job>, IngestError> {
    let mut jobs = Vec::new();
    for (number, bucket) in buckets.iter().enumerate() {
        // A bucket may be larger than the root; then it is the only one.
        let cube = if plan.root.contains_cube(bucket.cube) { bucket.cube } else { plan.root };
        // The last ones are cut finer, so that no thread is long without work while another is at the last.
        let is_last = plan.threads > 1 && number + plan.threads >= buckets.len();
        let most_rows = if is_last { plan.most_rows.min(LAST_ROWS) } else { plan.most_rows };
        split::<K>(plan, bucket, (number, most_rows), cube, bucket.rows, &mut jobs)?;
    }
    Ok(jobs)
}

/// Says what points at one place take that are more than the memory has room for: they are put in order at once.
fn tell_if_large(plan: &Plan<'_>, rows: u64) {
    let payload = plan.scans.iter().map(|s| s.plan.layout.payload as u64).max().unwrap_or(0);
    // Rows as they were read, in bins, in order and as records, then as columns and encoded; keys, twice while they are sorted.
    // Measured: 124 bytes of points with 8 bytes of payload, 206 of such with 22.
    let bytes = rows.saturating_mul(6 * payload + 3 * SORTED_BYTES);
    if bytes > plan.memory.max(WORTH_TELLING) {
        plan.progress.say(&format!(
            "{rows} points lie at one place, or nearly so, and are put in order at once: about {} MiB of memory, more than {} MiB",
            bytes.div_ceil(1 << 20),
            plan.memory >> 20
        ));
    }
}

/// So much memory is taken whatever was asked for.
const WORTH_TELLING: u64 = 2 << 20;

/// What sorting takes of a row beside its bytes.
const SORTED_BYTES: u64 = 24;

fn split<K: RowKey>(
    plan: &Plan<'_>,
    bucket: &Bucket,
    (number, most_rows): (usize, u64),
    cube: Cube,
    rows: u64,
    jobs: &mut Vec<Job>,
) -> Result<(), IngestError> {
    if rows <= most_rows || cube.k() <= plan.params.g {
        if rows > 0 {
            jobs.push(Job { cube, rows, bucket: number });
        }
        if rows > most_rows {
            tell_if_large(plan, rows);
        }
        return Ok(());
    }
    if plan.progress.cancelled() {
        return Err(IngestError::Interrupted);
    }
    let mut counts = [0_u64; 8];
    let digit = cube.k() - 1;
    let (first, last, of_bucket) = (cube.first_key(), cube.last_key(), bucket.cube.first_key());
    super::loaded::for_each_key::<K>(bucket, plan.scans, plan.spill, |key| {
        if (first..=last).contains(&key.full(of_bucket)) {
            counts[usize::from(key.digit(digit))] += 1;
        }
    })?;
    for (octant, rows) in cube.octants_in_key_order().into_iter().zip(counts) {
        if let Some(child) = cube.child(octant) {
            split::<K>(plan, bucket, (number, most_rows), child, rows, jobs)?;
        }
    }
    Ok(())
}

/// What a thread keeps from job to job: fresh memory is dear.
#[derive(Debug, Default)]
struct JobScratch<K> {
    load: LoadScratch<K>,
    wins: Vec<i8>,
    node: NodeScratch<K>,
}

/// A node's own points.
#[derive(Debug, Default)]
struct NodeScratch<K> {
    keys: Vec<K>,
    wins: Vec<i8>,
}

/// A node without its points.
struct NodeFrame {
    cube: Cube,
    leaf: bool,
    children: u8,
    rem: u64,
}

/// One thread's buffers.
struct Worker<'a> {
    plan: &'a Plan<'a>,
    encode: EncodeScratch,
    gather: Scratch,
    part_rows: Vec<u32>,
    columns: Vec<PointColumns>,
}

impl<'a> Worker<'a> {
    fn new(plan: &'a Plan<'a>) -> Self {
        Self {
            plan,
            encode: EncodeScratch::default(),
            gather: Scratch::default(),
            part_rows: Vec::new(),
            columns: Vec::new(),
        }
    }

    /// Builds the nodes of a job; returns what it leaves, or nothing if the job was the whole tree.
    fn run<K: RowKey>(
        &mut self,
        job: &Job,
        previous: Option<Cube>,
        bucket: Arc<Bucket>,
        scratch: &mut JobScratch<K>,
    ) -> Result<Option<Subtree<Held>>, IngestError> {
        let plan = self.plan;
        let JobScratch { load: load_scratch, wins, node: own } = scratch;
        let of_bucket = bucket.cube.first_key();
        let Loaded { keys, rows } = load::<K>(&bucket, job.cube, job.rows, plan.scans, plan.spill, load_scratch)?;
        // Its memory is used again while its points are encoded.
        drop(bucket);
        put_wins(keys, first_win(previous, job.cube, plan.root), wins);
        let place = if job.cube == plan.root { Place::Root } else { Place::Below };
        let mut result = Ok(());
        let rest = build_bucket(
            job.cube,
            keys,
            wins,
            place,
            plan.params,
            |EmittedNode { cube, leaf, children, rem, points }| {
                if result.is_ok() {
                    own.fill(points, keys, wins);
                    result = self.encode(NodeFrame { cube, leaf, children, rem }, own, points, rows);
                }
            },
        );
        result?;
        if place == Place::Root {
            return Ok(None);
        }
        let held = held(&rest.points, wins, plan.params.cell(job.cube.k()), &rows);
        let mut item = held.into_iter();
        let subtree = Subtree::from_bucket(job.cube, &rest, |i| {
            let i = i as usize;
            let item = item.next().unwrap_or_default();
            Entry { key: keys[i].full(of_bucket), win: wins[i], item }
        });
        Ok(Some(subtree))
    }

    fn emit_owned(&mut self, nodes: Vec<OwnedNode<Held>>) -> Result<(), IngestError> {
        for OwnedNode { cube, leaf, children, rem, entries } in nodes {
            let own = NodeScratch {
                keys: entries.iter().map(|e| e.key).collect(),
                wins: entries.iter().map(|e| e.win).collect(),
            };
            let rows: Vec<u32> = (0..).take(entries.len()).collect();
            self.encode(NodeFrame { cube, leaf, children, rem }, &own, &rows, Rising(&entries))?;
        }
        Ok(())
    }

    /// Gives a node to the sink, in the form that it wants; its points are these `rows` of `source`.
    fn encode<'r, K: RowKey>(
        &mut self,
        NodeFrame { cube, leaf, children, rem }: NodeFrame,
        own: &NodeScratch<K>,
        rows: &[u32],
        source: impl RowSource<'r> + Copy,
    ) -> Result<(), IngestError> {
        let NodeScratch { keys, wins } = own;
        let sink = match self.plan.sink {
            Sink::Encoded(sink) => sink,
            Sink::Content(sink) => {
                let mut columns = PointColumns::default();
                gather(self.plan.scans, rows, source, &mut self.gather, &mut columns);
                let keys = keys.iter().map(|key| key.full(cube.first_key())).collect();
                let PointColumns { scans, columns } = columns;
                return sink(cube, leaf, DecodedPart { keys, blocks: Vec::new(), scans, columns });
            }
        };
        let cut = octree::split(wins, &octree::steps(keys, wins));
        self.columns.resize_with(cut.len().max(self.columns.len()), PointColumns::default);
        let parts = &mut self.columns[..cut.len()];
        for (part, columns) in cut.iter().zip(&mut *parts) {
            let part_rows = if part.points.len() == rows.len() {
                rows
            } else {
                self.part_rows.clear();
                self.part_rows.extend(part.points.iter().map(|&i| rows[i as usize]));
                &self.part_rows
            };
            gather(self.plan.scans, part_rows, source, &mut self.gather, columns);
        }
        let (layer, block_size) = (self.plan.layer, block_size(rem));
        let input = NodeInput { layer, cube, leaf, children, keys, plan: &cut, parts, block_size };
        let encoded = encode_node(&input, self.plan.table, self.plan.ids, &mut self.encode)
            .map_err(|e| IngestError::Internal(format!("node {cube:?}: {e}")))?;
        sink(encoded)
    }
}

impl<K: RowKey> NodeScratch<K> {
    /// Takes the bucket's points with these indices.
    fn fill(&mut self, points: &[u32], keys: &[K], wins: &[i8]) {
        self.keys.clear();
        self.keys.extend(points.iter().map(|&i| keys[i as usize]));
        self.wins.clear();
        self.wins.extend(points.iter().map(|&i| wins[i as usize]));
    }
}

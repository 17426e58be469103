//! From buckets to encoded nodes: jobs run on all threads, in key order as far as possible, and what they leave for
//! coarser nodes is joined as soon as its turn comes.

use super::IngestError;
use super::gather::{RowSource, ScanColumns, Scratch, gather};
use super::loaded::{LoadScratch, Loaded, load};
use super::partition::Bucket;
use super::progress::Progress;
use super::rising::{BucketPoints, Held, Risen};
use super::rows::RowKey;
use super::spill::Spill;
use super::split::split;
use crate::lattice::{Cube, Key, LOW_DIGITS};
use crate::octree::assemble::{Assembler, Block, EmittedNode, OwnedNode, Place, Subtree, build_bucket};
use crate::octree::{self, Params, PartPlan, first_win, put_wins};
use crate::store::{
    ChunkIds, DecodedPart, EncodeScratch, EncodedNode, NodeInput, PartColumns, PointColumns, ScanTable, block_size,
    encode_node,
};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// What does not change during a build.
pub(super) struct Plan<'a> {
    pub params: Params,
    pub layer: u16,
    pub root: Cube,
    pub scans: &'a [ScanColumns<'a>],
    pub table: &'a ScanTable,
    pub ids: &'a ChunkIds,
    pub spill: Option<&'a Spill>,
    /// Buckets with more rows than this are cut.
    pub most_rows: u64,
    /// What the run may use.
    pub memory: u64,
    pub threads: usize,
    pub progress: &'a dyn Progress,
    /// Held by who takes much memory: for a large node, or for many points at one place.
    pub large: Mutex<()>,
    /// Takes finished nodes, from any thread.
    pub sink: Sink<'a>,
}

/// In which form nodes are wanted.
#[derive(Clone, Copy)]
pub(super) enum Sink<'a> {
    /// Encoded.
    Encoded(EncodedSink<'a>),
    /// As they are: cube, leaf or not, points.
    Content(ContentSink<'a>),
}

type EncodedSink<'a> = &'a (dyn Fn(EncodedNode) -> Result<(), IngestError> + Sync);
type ContentSink<'a> = &'a (dyn Fn(Cube, bool, DecodedPart) -> Result<(), IngestError> + Sync);

/// A cube's worth of work.
struct Job {
    cube: Cube,
    rows: u64,
    /// Its rows, until it is begun.
    bucket: Mutex<Option<Bucket>>,
}

/// Joins what jobs leave, in job order.
struct Joiner {
    assembler: Option<Assembler<Held>>,
    waiting: BTreeMap<usize, Subtree<Held>>,
    next: usize,
}

/// Builds the tree of all rows in `buckets` (in key order) and gives every node to the sink.
pub(super) fn build<K: RowKey>(plan: &Plan<'_>, buckets: Vec<Bucket>) -> Result<(), IngestError> {
    let jobs = jobs::<K>(plan, buckets)?;
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
            let bucket = job.bucket.lock().unwrap_or_else(std::sync::PoisonError::into_inner).take();
            let bucket = bucket.ok_or_else(|| IngestError::Internal("a bucket was taken twice".into()))?;
            let previous = number.checked_sub(1).map(|i| jobs[i].cube);
            let left = worker.run(previous, bucket, &mut scratch)?;
            if job.rows > plan.most_rows {
                // What it took is not needed again.
                scratch = JobScratch::default();
            }
            plan.progress.advance(job.rows);
            if let Some(subtree) = left {
                let ready = advance(&joiner, number, subtree);
                worker.emit_owned::<K>(ready)?;
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
    rest.into_par_iter().map_init(|| Worker::new(plan), |worker, node| worker.emit_owned::<K>(vec![node])).collect()
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

/// The jobs, in key order: buckets, or pieces of those that are too large for one go.
fn jobs<K: RowKey>(plan: &Plan<'_>, buckets: Vec<Bucket>) -> Result<Vec<Job>, IngestError> {
    // The last ones are cut finer, so that no thread is long without work while another is at the last.
    let first_of_last = if plan.threads > 1 { buckets.len().saturating_sub(plan.threads) } else { buckets.len() };
    let split = |(number, bucket): (usize, Bucket)| {
        let most_rows = if number < first_of_last { plan.most_rows } else { plan.most_rows.min(LAST_ROWS) };
        let mut pieces = Vec::new();
        split::<K>(plan, bucket, most_rows, &mut pieces)?;
        Ok(pieces)
    };
    let buckets: Vec<Vec<Bucket>> =
        buckets.into_par_iter().enumerate().map(split).collect::<Result<_, IngestError>>()?;
    let job = |bucket: Bucket| Job { cube: bucket.cube, rows: bucket.rows, bucket: Mutex::new(Some(bucket)) };
    Ok(buckets.into_iter().flatten().map(job).collect())
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

/// A node's own points, in key order: these rows of where they are, or all of them.
#[derive(Clone, Copy)]
struct Own<'a, K> {
    keys: &'a [K],
    wins: &'a [i8],
    rows: Option<&'a [u32]>,
}

/// Nodes with more points of their own take much memory while they are encoded.
const LARGE_NODE_POINTS: u64 = 1 << 17;

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
    columns: PointColumns,
}

impl<'a> Worker<'a> {
    fn new(plan: &'a Plan<'a>) -> Self {
        Self {
            plan,
            encode: EncodeScratch::default(),
            gather: Scratch::default(),
            part_rows: Vec::new(),
            columns: PointColumns::default(),
        }
    }

    /// Builds the nodes of a job; returns what it leaves, or nothing if the job was the whole tree.
    fn run<K: RowKey>(
        &mut self,
        previous: Option<Cube>,
        bucket: Bucket,
        scratch: &mut JobScratch<K>,
    ) -> Result<Option<Subtree<Held>>, IngestError> {
        let plan = self.plan;
        // So many points at one place: one such job at a time where memory is short.
        let is_large = plan.spill.is_some() && bucket.rows > plan.most_rows;
        let _one = is_large.then(|| plan.large.lock().unwrap_or_else(std::sync::PoisonError::into_inner));
        let JobScratch { load: load_scratch, wins, node: own } = scratch;
        let cube = bucket.cube;
        let Loaded { keys, rows } = load::<K>(&bucket, plan.scans, plan.spill, load_scratch)?;
        // Its memory is used again while its points are encoded, and its place in the file for those that rise.
        bucket.segments.iter().for_each(|segment| segment.place.give_back(plan.spill));
        drop(bucket);
        put_wins(keys, first_win(previous, cube, plan.root), wins);
        let place = if cube == plan.root { Place::Root } else { Place::Below };
        let mut result = Ok(());
        let rest =
            build_bucket(cube, keys, wins, place, plan.params, |EmittedNode { cube, leaf, children, rem, points }| {
                if result.is_ok() {
                    own.fill(points, keys, wins);
                    let own = Own { keys: &own.keys, wins: &own.wins, rows: Some(points) };
                    let made = self.make(NodeFrame { cube, leaf, children, rem }, own, rows);
                    result = made.and_then(Made::give);
                }
            });
        result?;
        if place == Place::Root {
            return Ok(None);
        }
        let points = BucketPoints { cube, keys, wins, rows };
        let blocks = rest.by_node(cube, wins, plan.params).map(|(win, own)| {
            let item = points.held(&own, plan.spill)?;
            Ok(Block { win, points: own.len() as u64, item })
        });
        let blocks = blocks.collect::<Result<_, IngestError>>()?;
        Ok(Some(Subtree { cube, built: rest.built, blocks }))
    }

    fn emit_owned<K: RowKey>(&mut self, nodes: Vec<OwnedNode<Held>>) -> Result<(), IngestError> {
        for node in nodes {
            let points: u64 = node.blocks.iter().map(|b| b.points).sum();
            // Where memory is short, one at a time of those that take much of it.
            let is_large = self.plan.spill.is_some() && points > LARGE_NODE_POINTS;
            let _one = is_large.then(|| self.plan.large.lock().unwrap_or_else(std::sync::PoisonError::into_inner));
            if node.cube.k() <= LOW_DIGITS {
                self.emit_risen::<K, u64>(node)?;
            } else {
                self.emit_risen::<K, Key>(node)?;
            }
            if is_large {
                (self.encode, self.columns) = Default::default();
            }
        }
        Ok(())
    }

    /// Of buckets with keys `K`; `N` does for the node.
    fn emit_risen<K: RowKey, N: RowKey>(&mut self, node: OwnedNode<Held>) -> Result<(), IngestError> {
        let OwnedNode { cube, leaf, children, rem, blocks } = node;
        let risen = Risen::<N>::collect::<K>(blocks, self.plan.spill)?;
        let own = Own { keys: &risen.keys, wins: &risen.wins, rows: None };
        let made = self.make(NodeFrame { cube, leaf, children, rem }, own, risen.rows(self.plan.scans))?;
        // The sink may take its time.
        drop(risen);
        made.give()
    }

    /// A node in the form that the sink wants.
    fn make<'r, K: RowKey>(
        &mut self,
        NodeFrame { cube, leaf, children, rem }: NodeFrame,
        Own { keys, wins, rows }: Own<'_, K>,
        source: impl RowSource<'r> + Copy,
    ) -> Result<Made<'a>, IngestError> {
        let Self { plan, encode, gather: scratch, part_rows, columns } = self;
        let scans = plan.scans;
        let sink = match plan.sink {
            Sink::Encoded(sink) => sink,
            Sink::Content(sink) => {
                let mut columns = PointColumns::default();
                let all: Vec<u32> = (0..).take(keys.len()).collect();
                gather(scans, rows.unwrap_or(&all), source, scratch, &mut columns);
                let keys = keys.iter().map(|key| key.full(cube.first_key())).collect();
                let PointColumns { scans, columns } = columns;
                return Ok(Made::Content(sink, cube, leaf, DecodedPart { keys, blocks: Vec::new(), scans, columns }));
            }
        };
        let parts = octree::split(wins, &octree::steps(keys, wins));
        let mut gathered = Gathered { scans, parts: &parts, rows, source, scratch, part_rows, columns };
        let block_size = block_size(rem);
        let input = NodeInput { layer: plan.layer, cube, leaf, children, keys, plan: &parts, block_size };
        let encoded = encode_node(&input, &mut gathered, plan.table, plan.ids, encode)
            .map_err(|e| IngestError::Internal(format!("node {cube:?}: {e}")))?;
        Ok(Made::Encoded(sink, Box::new(encoded)))
    }
}

/// A node that is ready, and who wants it.
enum Made<'a> {
    Encoded(EncodedSink<'a>, Box<EncodedNode>),
    Content(ContentSink<'a>, Cube, bool, DecodedPart),
}

impl Made<'_> {
    fn give(self) -> Result<(), IngestError> {
        match self {
            Self::Encoded(sink, node) => sink(*node),
            Self::Content(sink, cube, leaf, points) => sink(cube, leaf, points),
        }
    }
}

/// Columns of a node's parts, gathered when they are asked for.
struct Gathered<'a, S> {
    scans: &'a [ScanColumns<'a>],
    parts: &'a [PartPlan],
    /// As in [`Own`].
    rows: Option<&'a [u32]>,
    source: S,
    scratch: &'a mut Scratch,
    part_rows: &'a mut Vec<u32>,
    columns: &'a mut PointColumns,
}

impl<'r, S: RowSource<'r> + Copy> PartColumns for Gathered<'_, S> {
    fn of_part(&mut self, number: usize) -> &PointColumns {
        let points = &self.parts[number].points;
        let rows = match self.rows {
            None => points,
            Some(rows) if points.len() == rows.len() => rows,
            Some(rows) => {
                self.part_rows.clear();
                self.part_rows.extend(points.iter().map(|&i| rows[i as usize]));
                &*self.part_rows
            }
        };
        gather(self.scans, rows, self.source, self.scratch, self.columns);
        self.columns
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

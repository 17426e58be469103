//! A layer built from nothing: rows in buckets become nodes, nodes become rows and chunks of the store.

use super::IngestError;
use super::budget::{Budget, check_disk};
use super::build::{Plan, Sink, build};
use super::context::Context;
use super::gather::ScanColumns;
use super::partition::{Bucket, Partition, bucket_exponent};
use super::queue::Queue;
use super::rows::RowKey;
use super::spill::Spill;
use super::subtrees::with_subtrees;
use super::writing::Written;
use crate::lattice::{Cube, Key, Lattice, LatticeBox};
use crate::octree::Params;
use crate::store::model::Site;
use crate::store::{ChunkIds, EncodedNode, ScanTable, StoreError, Writer};
use std::sync::Mutex;

/// Where rows wait for their nodes: memory, or one temporary file.
pub(super) struct Room {
    pub budget: Budget,
    /// Do the rows have wide keys?
    pub wide: bool,
    k: u8,
    spill: Option<Spill>,
}

impl Room {
    /// For at most `rows` rows with `payload_bytes` bytes of payload, about inside `hint`, of which the store will keep
    /// about `store_bytes`.
    pub fn new(
        context: &Context<'_>,
        g: u8,
        hint: Option<LatticeBox>,
        rows: u64,
        payload_bytes: u64,
        store_bytes: u64,
    ) -> Result<Self, IngestError> {
        let wide = hint.is_some_and(|h| bucket_exponent(&h, 1).1);
        let key_bytes = if wide { <Key as RowKey>::BYTES } else { <u64 as RowKey>::BYTES } as u64;
        let budget = Budget::new(context.memory, rows, rows * key_bytes + payload_bytes, context.threads);
        // Some for every thread, also of a few rows.
        let buckets = budget.buckets.max((rows >> 13).min(4 * context.threads as u64));
        let k = hint.map_or(0, |h| bucket_exponent(&h, buckets).0).max(g);
        check_disk(context.path, store_bytes, budget.temp_bytes)?;
        if budget.temp_bytes > 0 {
            context.progress.say(&format!(
                "{rows} points don't fit {} MiB of memory; a temporary file of {} MiB will be used",
                context.memory >> 20,
                budget.temp_bytes.div_ceil(1 << 20)
            ));
        }
        let spill = if budget.temp_bytes > 0 { Some(Spill::create(context.path)?) } else { None };
        Ok(Self { budget, wide, k, spill })
    }

    /// The buckets, empty.
    pub fn partition<'a>(&'a self, lattice: &'a Lattice) -> Partition<'a> {
        Partition::new(lattice, self.spill.as_ref(), self.k, self.wide)
    }

    /// Bytes in the temporary file.
    pub fn temp_bytes(&self) -> u64 {
        self.spill.as_ref().map_or(0, Spill::bytes)
    }

    /// Is everything in memory?
    pub fn is_memory(&self) -> bool {
        self.spill.is_none()
    }

    /// Builds the tree of the rows in `buckets`, and gives every node to `sink`.
    pub fn build(
        &self,
        context: &Context<'_>,
        layer: &Layer<'_>,
        buckets: Vec<Bucket>,
        sink: Sink<'_>,
    ) -> Result<(), IngestError> {
        let ids = layer.ids.clone();
        let plan = Plan {
            params: layer.params,
            layer: layer.layer,
            root: layer.root,
            scans: layer.scans,
            table: layer.table,
            ids: &ids,
            spill: self.spill.as_ref(),
            most_rows: self.budget.bucket_rows,
            memory: context.memory,
            threads: context.threads,
            progress: context.progress,
            large: Mutex::default(),
            sink,
        };
        if self.wide { build::<Key>(&plan, buckets) } else { build::<u64>(&plan, buckets) }
    }

    /// Builds, encodes and writes.
    pub fn write(
        &self,
        context: &Context<'_>,
        writer: &mut Writer,
        layer: &Layer<'_>,
        buckets: Vec<Bucket>,
    ) -> Result<Written, IngestError> {
        writer.expect_many()?;
        let queue = Queue::new(self.budget.queue_bytes);
        let written = std::thread::scope(|scope| {
            let writing = scope.spawn(|| {
                let _leaves = queue.leaves();
                let mut written = Written::default();
                while let Some(mut node) = queue.pop() {
                    node.renumber(&layer.ids);
                    writer.put_chunks_unless(&node.chunks, &|| context.progress.cancelled())?;
                    written.chunks += node.chunks.len() as u64;
                    written.nodes.push((node.head, node.zones));
                }
                Ok::<_, StoreError>(written)
            });
            let ends = queue.ends();
            let sink = |node: EncodedNode| {
                // The writer only stops taking when it has failed, and says why when it is joined.
                let taken = queue.push(node);
                taken.then_some(()).ok_or_else(|| IngestError::Internal("the writer has stopped".into()))
            };
            let Layer { layer, params, root, scans, table, .. } = *layer;
            let unnumbered = Layer { layer, params, root, scans, table, ids: ChunkIds::default() };
            let built = self.build(context, &unnumbered, buckets, Sink::Encoded(&sink));
            drop(ends);
            let written = writing.join().map_err(|_| IngestError::Internal("the writer broke down".into()))?;
            match (built, written) {
                // Whoever is told to stop waits for no reader.
                (_, Err(error)) => context.go_on().and(Err(error.into())),
                (Err(error), Ok(_)) => Err(error),
                (Ok(()), Ok(written)) => Ok(written),
            }
        })?;
        context.go_on()?;
        Ok(Written { nodes: with_subtrees(written.nodes), ..written })
    }
}

/// What is known of a layer before it is built.
pub(super) struct Layer<'a> {
    pub layer: u16,
    pub params: Params,
    pub root: Cube,
    pub scans: &'a [ScanColumns<'a>],
    pub table: &'a ScanTable,
    pub ids: ChunkIds,
}

/// The parameters of a site's trees.
pub(super) fn params(site: &Site) -> Params {
    Params { g: site.g, leaf_capacity: site.leaf_capacity }
}

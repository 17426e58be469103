//! A layer built from nothing: rows in buckets become nodes, nodes become rows and chunks of the store.

use super::IngestError;
use super::budget::{Budget, check_disk};
use super::build::{Plan, Sink, build};
use super::context::Context;
use super::gather::ScanColumns;
use super::partition::{Bucket, Partition, bucket_exponent};
use super::rows::RowKey;
use super::spill::Spill;
use super::subtrees::with_subtrees;
use super::writing::{Written, through};
use crate::lattice::{Cube, Key, Lattice, LatticeBox};
use crate::octree::Params;
use crate::store::model::Site;
use crate::store::{ChunkIds, ScanTable, Writer};
use std::sync::Mutex;

/// Where rows wait for their nodes: memory, or one temporary file.
pub(super) struct Room {
    pub budget: Budget,
    /// Do the rows have wide keys?
    pub wide: bool,
    k: u8,
    spill: Option<Spill>,
}

/// Stores are a third to a sixth of the bytes of the points' records. A disk that has room for less than the least is not tried;
/// one that then fills up all the same leaves the store as it was.
pub(super) const LEAST_SHARE: u64 = 8;

impl Room {
    /// For at most `rows` rows with `payload_bytes` bytes of payload, about inside `hint`, of which the store will keep
    /// `store_bytes` at least.
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
        let total_bytes = rows.saturating_mul(key_bytes).saturating_add(payload_bytes);
        let budget = Budget::new(context.memory, rows, total_bytes, context.threads);
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
        // Numbered when they are written.
        let ids = ChunkIds::default();
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
        let ((), written) = through(writer, self.budget.queue_bytes, context.progress, |sink| {
            self.build(context, layer, buckets, Sink::Encoded(sink))
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
}

/// The parameters of a site's trees.
pub(super) fn params(site: &Site) -> Params {
    Params { g: site.g, leaf_capacity: site.leaf_capacity }
}

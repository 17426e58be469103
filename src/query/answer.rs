//! What comes with the points: how many, how good, at what cost.

use serde::Serialize;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// The report of a query.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Answer {
    /// Points returned.
    pub points: u64,
    /// Every matching point of the store has a returned point within this distance, in CRS units; `None` if nothing can
    /// be promised: no point is returned, though some may match, or the query was ended before its last point.
    pub error_bound: Option<f64>,
    /// For views: the largest error in pixels, at the centre of the image, of what is visible.
    pub error_bound_px: Option<f64>,
    /// Does the region lie wholly outside the bounds of the store's points?
    pub region_misses_site: bool,
    /// Matching points on the maximum faces of the query's box, which is half-open and does not have them; of several boxes
    /// those that none of them has. `None` where they were not counted, which is done at full detail only.
    pub on_maximum_faces: Option<u64>,
    /// What it cost.
    pub statistics: Statistics,
}

/// What a query cost.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Statistics {
    /// Nodes of which something was read.
    pub nodes: u64,
    /// Nodes whose rows were looked at.
    pub nodes_visited: u64,
    /// Parts of which something was read.
    pub parts: u64,
    /// Chunks read.
    pub chunks: u64,
    /// Chunks that were in the store's cache.
    pub chunks_cached: u64,
    /// Blocks decoded, each column for itself.
    pub blocks: u64,
    /// Blocks that were in the store's cache.
    pub blocks_cached: u64,
    /// Bytes of the chunks read, those in the cache apart.
    pub bytes_read: u64,
    /// The least that would have done: of each chunk that was read, the share of its blocks that hold a returned point.
    pub bytes_needed: u64,
    /// Points whose positions were decoded.
    pub points_decoded: u64,
    /// From start to end.
    pub seconds: f64,
    /// Choosing what to read.
    pub seconds_selecting: f64,
    /// Reading chunks, summed over threads.
    pub seconds_reading: f64,
    /// Decoding and testing, summed over threads.
    pub seconds_decoding: f64,
    /// In the receiver of the points.
    pub seconds_delivering: f64,
}

impl Answer {
    /// The same of a query that was ended before its last point: what is missing may be anywhere.
    pub(crate) fn cut_short(self) -> Self {
        Self { error_bound: None, error_bound_px: None, ..self }
    }
}

/// Counts from all threads.
#[derive(Debug, Default)]
pub(crate) struct Meter {
    pub nodes: AtomicU64,
    pub nodes_visited: AtomicU64,
    pub parts: AtomicU64,
    pub chunks: AtomicU64,
    pub chunks_cached: AtomicU64,
    pub blocks: AtomicU64,
    pub blocks_cached: AtomicU64,
    pub bytes_read: AtomicU64,
    pub bytes_needed: AtomicU64,
    pub points_decoded: AtomicU64,
    pub on_maximum_faces: AtomicU64,
    selecting_ns: AtomicU64,
    reading_ns: AtomicU64,
    decoding_ns: AtomicU64,
    delivering_ns: AtomicU64,
}

/// What a duration was spent on.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Stage {
    Selecting,
    Reading,
    Decoding,
    Delivering,
}

impl Meter {
    /// Adds to a count.
    pub fn add(counter: &AtomicU64, n: u64) {
        counter.fetch_add(n, Ordering::Relaxed);
    }

    /// Runs `work` on the clock of a stage.
    pub fn time<T>(&self, stage: Stage, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = work();
        let clock = match stage {
            Stage::Selecting => &self.selecting_ns,
            Stage::Reading => &self.reading_ns,
            Stage::Decoding => &self.decoding_ns,
            Stage::Delivering => &self.delivering_ns,
        };
        Self::add(clock, u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX));
        result
    }

    /// The counts so far.
    pub fn statistics(&self, elapsed: Duration) -> Statistics {
        let count = |c: &AtomicU64| c.load(Ordering::Relaxed);
        let seconds = |c: &AtomicU64| Duration::from_nanos(count(c)).as_secs_f64();
        Statistics {
            nodes: count(&self.nodes),
            nodes_visited: count(&self.nodes_visited),
            parts: count(&self.parts),
            chunks: count(&self.chunks),
            chunks_cached: count(&self.chunks_cached),
            blocks: count(&self.blocks),
            blocks_cached: count(&self.blocks_cached),
            bytes_read: count(&self.bytes_read),
            bytes_needed: count(&self.bytes_needed),
            points_decoded: count(&self.points_decoded),
            seconds: elapsed.as_secs_f64(),
            seconds_selecting: seconds(&self.selecting_ns),
            seconds_reading: seconds(&self.reading_ns),
            seconds_decoding: seconds(&self.decoding_ns),
            seconds_delivering: seconds(&self.delivering_ns),
        }
    }
}

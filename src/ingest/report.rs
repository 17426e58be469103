//! What an ingest did, for people and programs.

use super::progress::Stage;
use crate::store::model::Scan;
use serde::Serialize;
use std::time::{Duration, Instant};

/// What an ingest did.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct Report {
    /// The scans that were added.
    pub scans: Vec<ScanReport>,
    /// The inputs that were not, and why.
    pub skipped: Vec<Skipped>,
    /// The inputs that could not be read and were left out ([`IngestOptions::keep_going`](super::IngestOptions)).
    pub unreadable: Vec<Skipped>,
    /// Points added.
    pub points: u64,
    /// Wall time.
    pub seconds: f64,
    /// Points added by wall time.
    pub points_per_second: f64,
    /// The largest resident memory of the process so far.
    pub peak_memory_bytes: u64,
    /// Bytes of the temporary file that were announced beforehand.
    pub temp_bytes_predicted: u64,
    /// Bytes of the temporary file that were used.
    pub temp_bytes: u64,
    /// Rows of encoded columns that were written, of the new points and of what changed around them.
    pub chunks_written: u64,
    /// Where the time went.
    pub stages: Vec<StageReport>,
    /// What a user should know.
    pub notes: Vec<String>,
}

/// What became of one source.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct ScanReport {
    /// The scan's name in the store.
    pub name: String,
    /// The file's path, absolute; empty for points that were no file.
    pub source: String,
    /// Records that the source announced or held.
    pub read: u64,
    /// Points stored.
    pub stored: u64,
    /// Records that were not stored.
    pub rejected: u64,
    /// Of those: no valid position, because a coordinate is NaN or infinite or the scanner marked it as no measurement.
    pub rejected_not_finite: u64,
    /// Of those: coordinates outside the lattice.
    pub rejected_out_of_range: u64,
    /// Of those: announced by the header but not in the file.
    pub rejected_truncated: u64,
    /// `exact`, `recoverable` or `rounded`.
    pub positions: &'static str,
    /// The largest distance on one axis between a source coordinate and the stored one, in CRS units.
    pub max_error: f64,
    /// What a user should know.
    pub warnings: Vec<String>,
}

/// A scan that was taken out, or that was brought along.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct NamedScan {
    /// Its name in the store.
    pub name: String,
    /// Its points.
    pub points: u64,
}

impl NamedScan {
    pub(super) fn new(scan: &Scan) -> Self {
        Self { name: scan.name.clone(), points: scan.stored }
    }
}

/// An input that was passed over.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct Skipped {
    /// The file.
    pub path: String,
    /// Why.
    pub reason: String,
    /// Points that were rejected when the scan that is there already was read.
    #[serde(skip_serializing_if = "is_zero")]
    pub rejected: u64,
}

fn is_zero(n: &u64) -> bool {
    *n == 0
}

/// Wall time and points by stage, summed over the batches of a run.
#[derive(Debug, Default)]
pub(super) struct Stages(Vec<(Stage, Duration, u64)>);

impl Stages {
    /// Times `work` as part of a stage that `points` go through.
    pub fn time<R>(&mut self, stage: Stage, points: u64, work: impl FnOnce() -> R) -> R {
        let begun = Instant::now();
        let result = work();
        let took = begun.elapsed();
        match self.0.iter_mut().find(|s| s.0 == stage) {
            Some(sum) => *sum = (stage, sum.1 + took, sum.2 + points),
            None => self.0.push((stage, took, points)),
        }
        result
    }

    pub fn into_reports(self) -> Vec<StageReport> {
        let report = |(stage, took, points): (Stage, Duration, u64)| {
            let seconds = took.as_secs_f64();
            let ns_per_point = if points > 0 { seconds * 1e9 / points as f64 } else { 0.0 };
            StageReport { stage: stage.word(), seconds, ns_per_point }
        };
        self.0.into_iter().map(report).collect()
    }
}

/// Wall time of a stage.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct StageReport {
    /// `measuring`, `reading`, `building`, `commit`.
    pub stage: &'static str,
    /// Wall time.
    pub seconds: f64,
    /// Wall time by points that went through.
    pub ns_per_point: f64,
}

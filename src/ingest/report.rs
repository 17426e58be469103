//! What an ingest did, for people and programs.

use serde::Serialize;

/// What an ingest did.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// The scans that were added.
    pub scans: Vec<ScanReport>,
    /// The inputs that were not, and why.
    pub skipped: Vec<Skipped>,
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
    /// Where the time went.
    pub stages: Vec<StageReport>,
    /// What a user should know.
    pub notes: Vec<String>,
}

/// What became of one source.
#[derive(Clone, Debug, Serialize)]
pub struct ScanReport {
    /// The scan's name in the store.
    pub name: String,
    /// The path as given.
    pub source: String,
    /// Records that the source announced or held.
    pub read: u64,
    /// Points stored.
    pub stored: u64,
    /// Records that were not stored.
    pub rejected: u64,
    /// Of those: coordinates that are NaN or infinite.
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

/// An input that was not read.
#[derive(Clone, Debug, Serialize)]
pub struct Skipped {
    /// The file.
    pub path: String,
    /// Why.
    pub reason: String,
}

/// Wall time of a stage.
#[derive(Clone, Debug, Serialize)]
pub struct StageReport {
    /// `measuring`, `reading`, `building`, `commit`.
    pub stage: &'static str,
    /// Wall time.
    pub seconds: f64,
    /// Wall time by points that went through.
    pub ns_per_point: f64,
}

//! How the memory budget is shared out, and what goes through the temporary file.

use super::IngestError;
use std::path::Path;

/// Rows of a bucket, when there is memory enough.
const BUCKET_ROWS: u64 = 1 << 18;

/// What fits where.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Budget {
    /// Bytes that the temporary file will take: zero if all rows stay in memory.
    pub temp_bytes: u64,
    /// Records of a piece.
    pub piece_records: u64,
    /// Bytes of rows that one thread may collect before it hands them over.
    pub open_bytes: usize,
    /// Buckets to aim for.
    pub buckets: u64,
    /// Rows of a bucket at most.
    pub bucket_rows: u64,
    /// Bytes of encoded nodes that may wait for the writer.
    pub queue_bytes: usize,
}

impl Budget {
    /// For `rows` rows of `row_bytes` bytes each, at the largest, on `threads` threads.
    pub fn new(memory: u64, rows: u64, total_bytes: u64, threads: usize) -> Self {
        let row_bytes = total_bytes.checked_div(rows).unwrap_or(0).max(8);
        // Beside the rows themselves, jobs and the writer's queue need room; the rest is left to SQLite and the readers.
        let temp_bytes = if total_bytes <= memory / 2 { 0 } else { total_bytes };
        let threads = threads.max(1) as u64;
        // A job holds its rows up to three times (from the file, in bins, in order), their keys twice while they are sorted,
        // and what it encodes.
        let job_bytes = (memory / 4 / threads).max(1 << 20);
        let bucket_rows = (job_bytes / (3 * row_bytes + 48)).clamp(1 << 12, 1 << 22);
        let piece_bytes = (memory / 8 / threads).clamp(1 << 20, 16 << 20);
        Self {
            temp_bytes,
            piece_records: (piece_bytes / row_bytes).clamp(1 << 12, 1 << 18),
            open_bytes: piece_bytes as usize,
            buckets: rows.div_ceil(BUCKET_ROWS.min(bucket_rows / 2).max(1)),
            bucket_rows,
            queue_bytes: (memory / 16).clamp(1 << 20, 64 << 20) as usize,
        }
    }
}

/// A quarter of the machine's memory.
pub(super) fn default_memory() -> u64 {
    let info = rustix::system::sysinfo();
    (info.totalram as u64).saturating_mul(u64::from(info.mem_unit).max(1)) / 4
}

/// What a thread takes while it builds, whatever the budget is. Measured: 13 to 37 MiB.
const THREAD_BYTES: u64 = 32 << 20;

/// Threads to use when nothing is said: one per core, if `memory` has room for what they take.
pub(super) fn default_threads(memory: u64) -> usize {
    threads_of(std::thread::available_parallelism().map_or(1, usize::from), memory)
}

fn threads_of(cores: usize, memory: u64) -> usize {
    cores.min(usize::try_from(memory / THREAD_BYTES).unwrap_or(cores).max(2))
}

/// The largest resident memory of the process so far, in bytes.
pub(super) fn peak_memory() -> u64 {
    // Linux says it in /proc; where that is missing there is nothing to say.
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:")).unwrap_or("");
    let kib: u64 = line.split_whitespace().next().and_then(|n| n.parse().ok()).unwrap_or(0);
    kib * 1024
}

/// Refuses to begin when the store and the temporary file will not fit the disk.
pub(super) fn check_disk(store: &Path, store_bytes: u64, temp_bytes: u64) -> Result<(), IngestError> {
    let folder = match store.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    // A file system that can't say is not an error: writing will tell.
    let Ok(stat) = rustix::fs::statvfs(folder) else { return Ok(()) };
    let free = stat.f_bavail.saturating_mul(stat.f_frsize);
    if free < store_bytes.saturating_add(temp_bytes) {
        let mib = |bytes: u64| format!("{} MiB", bytes.div_ceil(1 << 20));
        return Err(IngestError::DiskFull {
            folder: folder.to_owned(),
            needed: mib(store_bytes),
            temp: mib(temp_bytes),
            free: mib(free),
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn little_memory_is_for_few_threads() {
        assert_eq!([1 << 20, 64 << 20, 256 << 20, 1 << 50].map(|memory| threads_of(16, memory)), [2, 2, 8, 16]);
        assert_eq!([1, 2].map(|cores| threads_of(cores, 1 << 20)), [1, 2]);
    }

    #[test]
    fn what_fits_stays_in_memory() {
        let small = Budget::new(256 << 20, 1_000_000, 32_000_000, 2);
        assert_eq!(small.temp_bytes, 0);
        let large = Budget::new(256 << 20, 20_000_000, 640_000_000, 2);
        assert_eq!(large.temp_bytes, 640_000_000);
        assert!(large.bucket_rows * (3 * 32 + 48) * 2 <= 256 << 20);
        assert!(Budget::new(1 << 20, 1, 40, 64).piece_records > 0);
    }
}

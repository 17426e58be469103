//! `esker digest`: two hashes of what a store holds.

use super::progress::Shown;
use super::watching::Reading;
use super::{Outcome, output, values};
use crate::ingest::{Resources, digest};
use clap::Args;
use std::path::PathBuf;

/// Prints two hashes of what a store holds, however it came to hold it.
///
/// `points` covers the lattice and every node with its records; `scans` also which scan each record came from. Neither
/// depends on the order of scans, on threads, memory or time.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  esker digest site.esker")]
pub(super) struct Arguments {
    /// The store.
    store: PathBuf,
    /// Memory to use at most where layers are put together, such as 512MiB or 4GiB (default: a quarter of the machine's).
    #[arg(long, value_name = "SIZE", value_parser = values::memory)]
    memory: Option<u64>,
    #[command(flatten)]
    reading: Reading,
    /// One JSON object on stdout.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<Outcome> {
    let shown = Shown::new(arguments.reading.progress);
    let threads = arguments.reading.threads.map(usize::from);
    let resources = Resources { memory_bytes: arguments.memory, threads, ..Resources::default() };
    let result = digest(&arguments.store, &resources, &shown);
    shown.clear();
    let digest = result?;
    if arguments.json {
        let [points, scans] = [digest.points, digest.scans].map(|hash| hash.to_string());
        output::json(&serde_json::json!({ "points": points, "scans": scans }))?;
    } else {
        output::line(format_args!("points {}", digest.points))?;
        output::line(format_args!("scans {}", digest.scans))?;
    }
    Ok(Outcome::Done)
}

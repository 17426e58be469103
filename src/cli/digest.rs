//! `esker digest`: two hashes of what a store holds.

use super::progress::Shown;
use super::{Outcome, changing::Changing, output};
use crate::ingest::digest;
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
    #[command(flatten)]
    changing: Changing,
    /// One JSON object on stdout.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<Outcome> {
    let shown = Shown::new(arguments.changing.progress);
    let result = digest(&arguments.store, &arguments.changing.resources(), &shown);
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

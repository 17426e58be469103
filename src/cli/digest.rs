//! `esker digest`: two hashes of what a store holds.

use super::{Outcome, output};
use crate::store::{Store, digest};
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
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<Outcome> {
    let store = Store::open(&arguments.store)?;
    let digest = digest(&store.snapshot()?)?;
    output::line(format_args!("points {}", digest.points))?;
    output::line(format_args!("scans {}", digest.scans))?;
    Ok(Outcome::Done)
}

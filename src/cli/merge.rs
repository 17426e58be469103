//! `esker merge`: several stores to one.

use super::progress::Shown;
use super::{Outcome, changing::Changing, output};
use crate::ingest;
use clap::Args;
use std::path::PathBuf;

/// Joins stores to a new one: what a single ingest of all their scans would have given.
///
/// The stores must be on one lattice (`ingest --lattice STORE` or `--quantum` sees to it) and in one CRS, so that a site
/// can be built in shards, on several machines. A scan that several of them have is taken once.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  esker merge site.esker north.esker south.esker\n  \
                  esker ingest south.esker south/ --lattice north.esker   # so that they can be joined")]
pub(super) struct Arguments {
    /// The new store.
    out: PathBuf,
    /// The stores to join.
    #[arg(required = true, value_name = "STORE")]
    stores: Vec<PathBuf>,
    #[command(flatten)]
    changing: Changing,
    /// One JSON object on stdout.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<Outcome> {
    let shown = Shown::new(arguments.changing.progress);
    let result = ingest::merge(&arguments.out, &arguments.stores, &arguments.changing.resources(), &shown);
    shown.clear();
    let merged = result?;
    for note in &merged.notes {
        output::tell!("esker: {}", output::clean(note));
    }
    if arguments.json {
        output::json(&serde_json::to_value(&merged)?)?;
    } else {
        for ingest::SkippedScan { name, reason, .. } in &merged.skipped {
            output::line(format_args!("{}: skipped, {reason}", output::clean(name)))?;
        }
        output::line(format_args!(
            "{}, {} joined in {:.1} s",
            output::counted(merged.scans.len() as u64, "scan"),
            output::counted(merged.points, "point"),
            merged.seconds,
        ))?;
    }
    Ok(Outcome::Done)
}

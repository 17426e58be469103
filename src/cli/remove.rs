//! `esker remove`: scans out of a store.

use super::progress::Shown;
use super::{Outcome, changing::Changing, output};
use crate::ingest;
use clap::Args;
use std::path::PathBuf;

/// Takes scans out of a store, as if they had never been there.
///
/// The space that they took is used again by what comes next, or given back to the file system where it is more than a
/// sixteenth of the file; `esker compact` gives all of it back. To leave a scan out for a while, `esker hide` is quicker.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  esker remove site.esker roof\n  esker remove site.esker 3 7 --json")]
pub(super) struct Arguments {
    /// The store.
    store: PathBuf,
    /// The scans, by name or number (`esker scans` lists them).
    #[arg(required = true, value_name = "SCAN")]
    scans: Vec<String>,
    #[command(flatten)]
    changing: Changing,
    /// One JSON object on stdout.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<Outcome> {
    let shown = Shown::new(arguments.changing.progress);
    let result = ingest::remove(&arguments.store, &arguments.scans, &arguments.changing.resources(), &shown);
    shown.clear();
    let removed = result?;
    if arguments.json {
        output::json(&serde_json::to_value(&removed)?)?;
    } else {
        for scan in &removed.scans {
            output::line(format_args!("{}: removed", output::clean(&scan.name)))?;
        }
        output::line(format_args!(
            "{} removed in {:.2} s; the file has {} now, {} before",
            output::counted(removed.points, "point"),
            removed.seconds,
            output::bytes(removed.bytes_after),
            output::bytes(removed.bytes_before),
        ))?;
    }
    Ok(Outcome::Done)
}

//! `esker scans`: the scans of a store.

use super::{Outcome, output};
use crate::store::{ScanDescription, Store};
use clap::Args;
use std::path::PathBuf;

/// Lists the scans of a store.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  esker scans site.esker\n  esker scans site.esker --json")]
pub(super) struct Arguments {
    /// The store.
    store: PathBuf,
    /// One JSON object on stdout.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<Outcome> {
    let store = Store::open(&arguments.store)?;
    let snapshot = store.snapshot()?;
    let lattice = &snapshot.site().lattice;
    if arguments.json {
        let scans: Vec<_> = snapshot.scans().iter().map(|s| ScanDescription::new(s, lattice)).collect();
        output::json(&serde_json::json!({ "scans": scans }))?;
        return Ok(Outcome::Done);
    }
    output::line(format_args!("{:>4}  {:>14}  {:>10}  {:<11}  name", "id", "points", "rejected", "positions"))?;
    for scan in snapshot.scans() {
        output::line(format_args!(
            "{:>4}  {:>14}  {:>10}  {:<11}  {}{}",
            scan.id,
            output::grouped(scan.stored),
            output::grouped(scan.rejected.total()),
            scan.exactness.word(),
            output::clean(&scan.name),
            if scan.visible { "" } else { "  (hidden)" },
        ))?;
    }
    Ok(Outcome::Done)
}

//! `esker view`: the window.

use super::Outcome;
use crate::export::{ExportOptions, Target, export};
use crate::query::{Query, Region};
use crate::store::{Snapshot, Store};
use crate::viewer::remembered::Remembered;
use crate::viewer::{Options, Wanted, parse_script};
use anyhow::Context;
use clap::Args;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// Opens a window on a store: fly, walk, measure, colour, export.
///
/// Opens at once and refines, within a budget of points. Shows new scans as an ingest commits them. H in the window
/// lists what mouse and keys do.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  esker view site.esker\n\n\
                  In the window: left drag turns, right drag moves, the wheel zooms, a double click goes there; W A S D \
                  fly, G walks, F shows everything, H shows all keys.")]
pub(super) struct Arguments {
    /// The store.
    store: PathBuf,
    /// Does what a script says in place of hands (docs/viewer.md).
    #[arg(long, value_name = "FILE", hide = true)]
    script: Option<PathBuf>,
    /// Neither reads nor writes the settings that are remembered.
    #[arg(long)]
    forget: bool,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<Outcome> {
    let started = Instant::now();
    let store = Store::open(&arguments.store)?;
    let lattice = store.snapshot()?.site().lattice.clone();
    let script = match &arguments.script {
        None => Vec::new(),
        Some(path) => {
            let text = std::fs::read_to_string(path).with_context(|| format!("{}: can't be read", path.display()))?;
            parse_script(&text).map_err(|e| anyhow::anyhow!("{}: {e}", path.display()))?
        }
    };
    let name = arguments.store.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let remember = if arguments.forget { None } else { Remembered::place() };
    let exporter = Arc::new(|snapshot: &Snapshot, wanted: &Wanted, path: &Path| {
        export_box(snapshot, wanted, path).map_err(|e| super::output::one_line(&e))
    });
    crate::viewer::run(Options { started, store, lattice, name, exporter, remember, script })?;
    Ok(Outcome::Done)
}

/// The points of a box that are seen, with all their attributes.
fn export_box(snapshot: &Snapshot, wanted: &Wanted, path: &Path) -> anyhow::Result<u64> {
    // What a command says of it names an option that a window has not.
    if path.exists() {
        anyhow::bail!("{}: exists already; give another name", path.display());
    }
    let region = Region::new_box(wanted.bounds.min().to_array(), wanted.bounds.max().to_array())?;
    let mut query = Query::new().region(region).scans(wanted.scans.iter().cloned());
    if let Some(filter) = &wanted.filter {
        query = query.filter(filter.clone());
    }
    let done = export(snapshot, &query, Target::File(path), &ExportOptions::default(), |_| {})?;
    Ok(done.answer.points)
}

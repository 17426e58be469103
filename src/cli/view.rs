//! `esker view`: the window.

use super::cameras::OneCamera;
use super::which::filter;
use super::{Outcome, values};
use crate::export::{ExportOptions, Target, export};
use crate::query::{Query, Region};
use crate::render::ColorMode;
use crate::store::{Snapshot, Store};
use crate::stream::ScanChoice;
use crate::viewer::remembered::Remembered;
use crate::viewer::{Options, Start, Wanted, parse_script};
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
#[command(
    after_help = "Examples:\n  esker view site.esker\n  esker view site.esker --bookmark door --color height\n  \
                  esker view site.esker --where 'Classification in (2, 6)'\n\n\
                  In the window: left drag turns, right drag moves, the wheel zooms, a double click goes there; W A S D \
                  fly, G walks, F shows everything, H shows all keys."
)]
pub(super) struct Arguments {
    /// The store.
    store: PathBuf,
    #[command(flatten)]
    camera: OneCamera,
    /// Colours to begin with: rgb, intensity, height, class, return, scan, level or time.
    #[arg(long, value_name = "MODE")]
    color: Option<ColorMode>,
    /// Shows only points for which this is true; can be changed in the window.
    #[arg(long = "where", value_name = "EXPR", allow_hyphen_values = true)]
    filter: Option<String>,
    /// Shows only this scan, by name or id, until others are switched on; may be given several times.
    #[arg(long = "scan", value_name = "NAME", value_parser = values::name, allow_hyphen_values = true)]
    scans: Vec<String>,
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
    let snapshot = store.snapshot()?;
    let lattice = snapshot.site().lattice.clone();
    let start = start(arguments, &snapshot)?;
    drop(snapshot);
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
    crate::viewer::run(Options { started, store, lattice, name, start, exporter, remember, script })?;
    Ok(Outcome::Done)
}

fn start(arguments: &Arguments, snapshot: &Snapshot) -> anyhow::Result<Start> {
    let filter = arguments.filter.as_ref().map(|text| filter(text, snapshot)).transpose()?;
    if let Some(filter) = &filter {
        filter.check(snapshot)?;
    }
    let mut scans = ScanChoice::default();
    if !arguments.scans.is_empty() {
        let asked = Query::new().scans(arguments.scans.iter().cloned()).asked_scans(snapshot)?;
        snapshot.scans().iter().for_each(|s| scans.set(s.id, s.visible, asked.contains(&s.id)));
    }
    Ok(Start { camera: arguments.camera.get(snapshot)?, mode: arguments.color, scans, filter })
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

//! `esker show` and `esker hide`: which scans take part.

use super::progress::Shown;
use super::{Outcome, changing::Changing, output};
use crate::ingest;
use clap::Args;
use std::path::PathBuf;

/// Lets hidden scans take part again.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  esker show site.esker roof")]
pub(super) struct Show {
    #[command(flatten)]
    which: Which,
}

/// Leaves scans out of queries, pictures and counts, without touching their points.
///
/// A hidden scan is still there for those who name it (`query --scan NAME`).
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  esker hide site.esker roof cellar\n  esker show site.esker cellar")]
pub(super) struct Hide {
    #[command(flatten)]
    which: Which,
}

#[derive(Debug, Args)]
struct Which {
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

pub(super) fn show(arguments: &Show) -> anyhow::Result<Outcome> {
    set(&arguments.which, true)
}

pub(super) fn hide(arguments: &Hide) -> anyhow::Result<Outcome> {
    set(&arguments.which, false)
}

fn set(which: &Which, visible: bool) -> anyhow::Result<Outcome> {
    let shown = Shown::new(which.changing.progress);
    let resources = which.changing.resources();
    let result = ingest::set_visible(&which.store, &which.scans, visible, &resources, &shown);
    shown.clear();
    let changed = result?;
    let word = if visible { "shown" } else { "hidden" };
    if which.json {
        output::json(&serde_json::json!({ word: changed }))?;
    } else if changed.is_empty() {
        output::line(format_args!("nothing to do: already {word}"))?;
    } else {
        for name in &changed {
            output::line(format_args!("{}: {word}", output::clean(name)))?;
        }
    }
    Ok(Outcome::Done)
}

//! `esker rename` and `esker set-crs`: what a store says of its points.

use super::progress::Shown;
use super::{Outcome, changing::Changing, output, values};
use crate::ingest;
use crate::points::Crs;
use clap::Args;
use std::path::PathBuf;

/// Gives a scan another name; touches no point.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  esker rename site.esker scan-2 cellar\n  esker rename site.esker 7 'north wall'")]
pub(super) struct Rename {
    /// The store.
    store: PathBuf,
    /// The scan, by name or number (`esker scans` lists them).
    scan: String,
    /// Its new name.
    #[arg(value_parser = values::name)]
    name: String,
    #[command(flatten)]
    changing: Changing,
    /// One JSON object on stdout.
    #[arg(long)]
    json: bool,
}

/// Says in which coordinate reference system a site is; no coordinate changes.
///
/// Scans in forms that name none (PTX, PTS, text, most PLY) make a site without a CRS, until a scan brings one. Outputs name the
/// CRS that is given here.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  esker set-crs site.esker EPSG:25832\n  esker set-crs site.esker EPSG:25832+7837\n  \
                        esker set-crs site.esker \"$(cat site.prj)\" --force"
)]
pub(super) struct SetCrs {
    /// The store.
    store: PathBuf,
    /// The CRS: EPSG:N, EPSG:N+V with a vertical one, or WKT.
    #[arg(value_name = "WKT|EPSG:N", value_parser = super::ingest::crs)]
    crs: Crs,
    /// Also where the site has another one.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    changing: Changing,
    /// One JSON object on stdout.
    #[arg(long)]
    json: bool,
}

pub(super) fn rename(arguments: &Rename) -> anyhow::Result<Outcome> {
    let Rename { store, scan, name, changing, json } = arguments;
    let shown = Shown::new(changing.progress);
    let result = ingest::rename(store, scan, name, &changing.resources(), &shown);
    shown.clear();
    let before = result?;
    if *json {
        output::json(&serde_json::json!({ "name": name, "before": before }))?;
    } else {
        output::line(format_args!("{}: is {} now", output::clean(&before), output::clean(name)))?;
    }
    Ok(Outcome::Done)
}

pub(super) fn set_crs(arguments: &SetCrs) -> anyhow::Result<Outcome> {
    let SetCrs { store, crs, force, changing, json } = arguments;
    let shown = Shown::new(changing.progress);
    let result = ingest::set_crs(store, crs, *force, &changing.resources(), &shown);
    shown.clear();
    let before = result?.map(|before| before.describe());
    if *json {
        output::json(&serde_json::json!({ "crs": crs.describe(), "before": before }))?;
    } else {
        let before = before.as_deref().unwrap_or("unknown");
        output::line(format_args!(
            "{}: is in {} now; before: {}",
            store.display(),
            output::clean(&crs.describe()),
            output::clean(before)
        ))?;
    }
    Ok(Outcome::Done)
}

//! `esker bookmark`: cameras that are kept in a store.

use super::cameras::read_view;
use super::progress::{Mode, Shown};
use super::{Outcome, output};
use crate::geometry::{Camera, DVec3, Projection};
use crate::ingest::{self, Resources};
use crate::store::{Snapshot, Store};
use clap::Args;
use std::path::PathBuf;

/// Lists the cameras that are kept in a store, prints one as a view file, keeps another, or lets go of one.
///
/// They are those of the window (`esker view`); `render`, `query` and `view` take them with --bookmark.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  esker bookmark site.esker                            lists them\n  \
                        esker bookmark site.esker door > door.json           a view file\n  \
                        esker bookmark site.esker door --view door.json      keeps it\n  \
                        esker bookmark site.esker door --remove\n  \
                        esker render site.esker --bookmark door -o door.png")]
pub(super) struct Arguments {
    /// The store.
    store: PathBuf,
    /// Which one; without it all are listed.
    name: Option<String>,
    /// Keeps what a view file says under that name.
    #[arg(long, value_name = "VIEW.json", requires = "name", conflicts_with = "remove")]
    view: Option<PathBuf>,
    /// Lets go of it.
    #[arg(long, requires = "name")]
    remove: bool,
    /// Also where another view has that name.
    #[arg(long, requires = "view")]
    force: bool,
    /// Wait while another process is writing to the store, instead of failing.
    #[arg(long, requires = "name")]
    wait: bool,
    /// One JSON object on stdout.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<Outcome> {
    let Arguments { store, name, view, remove, force, wait, json } = arguments;
    let resources = Resources { wait: *wait, ..Resources::default() };
    let shown = Shown::new(Mode::None);
    let told = match (name, view) {
        (Some(name), Some(view)) => {
            let replaced = ingest::keep_bookmark(store, name, &read_view(view)?, *force, &resources, &shown)?;
            (name, if replaced { "replaced" } else { "kept" })
        }
        (Some(name), None) if *remove => {
            ingest::remove_bookmark(store, name, &resources, &shown)?;
            (name, "removed")
        }
        (Some(name), None) => {
            let camera = ingest::bookmark(&Store::open(store)?.snapshot()?, name)?;
            output::json(&serde_json::to_value(&camera)?)?;
            return Ok(Outcome::Done);
        }
        (None, _) => {
            list(&Store::open(store)?.snapshot()?, *json)?;
            return Ok(Outcome::Done);
        }
    };
    let (name, done) = told;
    if *json {
        output::json(&serde_json::json!({ "name": name, "done": done }))?;
    } else {
        output::line(format_args!("{}: {done}", output::clean(name)))?;
    }
    Ok(Outcome::Done)
}

fn list(snapshot: &Snapshot, json: bool) -> anyhow::Result<()> {
    let names: Vec<String> = snapshot.bookmarks()?.into_iter().map(|(name, _)| name).collect();
    let cameras = names.iter().map(|name| Ok((name, ingest::bookmark(snapshot, name)?)));
    let cameras = cameras.collect::<anyhow::Result<Vec<(&String, Camera)>>>()?;
    if json {
        let each = |(name, camera): &(&String, Camera)| serde_json::json!({ "name": name, "view": camera });
        return Ok(output::json(&serde_json::json!({ "bookmarks": cameras.iter().map(each).collect::<Vec<_>>() }))?);
    }
    if cameras.is_empty() {
        output::tell!("esker: the store has no bookmarks");
    }
    let width = cameras.iter().map(|(name, _)| output::clean(name).chars().count()).max().unwrap_or(0);
    for (name, camera) in &cameras {
        // A thousandth of how far it looks is enough to know it by.
        let decimals = (3.0 - camera.eye().distance(camera.target()).log10().floor()).clamp(0.0, 12.0) as usize;
        let seen = match camera.projection() {
            Projection::Perspective { fov_y_rad } => format!("{:.0}° from top to bottom", fov_y_rad.to_degrees()),
            Projection::Orthographic { height } => format!("parallel, {height:.decimals$} from top to bottom"),
        };
        let place = |p: DVec3| p.to_array().map(|c| format!("{c:.decimals$}")).join(",");
        let name = output::clean(name);
        let (eye, target) = (place(camera.eye()), place(camera.target()));
        output::line(format_args!("{name:width$}  from {eye} to {target}, {seen}"))?;
    }
    Ok(())
}

//! `esker info`: what a store holds.

use super::{Outcome, output};
use crate::store::{AttributeCost, Description, Snapshot, Store, describe};
use clap::Args;
use std::path::PathBuf;

/// Says what a store holds: points, bounds, attributes and what they cost.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  esker info site.esker\n  esker info site.esker --json")]
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
    let description = describe(&snapshot)?;
    if arguments.json {
        output::json(&serde_json::to_value(&description)?)?;
    } else {
        print(&snapshot, &description)?;
    }
    Ok(Outcome::Done)
}

fn per_point(bytes: u64, points: u64) -> f64 {
    if points == 0 { 0.0 } else { bytes as f64 / points as f64 }
}

fn print(snapshot: &Snapshot, info: &Description) -> std::io::Result<()> {
    let site = snapshot.site();
    let unit = info.unit.unwrap_or("unit unknown");
    output::line(format_args!("points       {}", output::grouped(info.points)))?;
    let hidden = if info.scans_hidden > 0 { format!(" ({} hidden)", info.scans_hidden) } else { String::new() };
    output::line(format_args!("scans        {}{hidden}", info.scans))?;
    output::line(format_args!(
        "nodes        {} on {}",
        output::grouped(info.nodes),
        output::counted(info.levels.into(), "level")
    ))?;
    output::line(format_args!("lattice      {} ({unit})", super::ingest::describe(&site.lattice)))?;
    if let Some(spacing) = info.root_spacing {
        output::line(format_args!("spacing      {spacing} at the root"))?;
    }
    if let Some(bounds) = &info.bounds {
        let text = |c: [f64; 3]| format!("{},{},{}", c[0], c[1], c[2]);
        output::line(format_args!("bounds       {},{}", text(bounds.min), text(bounds.max)))?;
    }
    let crs = info.crs.as_ref().map_or("unknown", |c| &c.description);
    output::line(format_args!("crs          {}", output::clean(crs)))?;
    output::line(format_args!(
        "file         {} ({:.2} bytes a point)",
        output::bytes(info.bytes_total),
        info.bytes_per_point
    ))?;
    output::line(format_args!("generation   {}", info.generation))?;
    if !info.bookmarks.is_empty() {
        output::line(format_args!("bookmarks    {}", output::clean(&info.bookmarks.join(", "))))?;
    }
    if info.in_use {
        output::line("in use       yes: don't copy the file now")?;
    }
    let (name, ty, bytes, each) = ("attribute", "type", "bytes", "bytes/point");
    output::line(format_args!("{name:32} {ty:8} {bytes:>12} {each:>12} {:>18} {:>18}", "min", "max"))?;
    for AttributeCost { name, ty, bytes, min, max, scaling, no_data } in &info.attributes {
        let [min, max] = [min, max].map(|end| end.map_or_else(String::new, output::number));
        let each = per_point(*bytes, info.points);
        let mut line = format!("{:32} {ty:8} {bytes:>12} {each:>12.3} {min:>18} {max:>18}", output::clean(name));
        // There may be several of one name, told apart by these.
        if let Some(s) = scaling {
            line += &format!("  scale {} offset {}", s.scale, s.offset);
        }
        if let Some(no_data) = no_data {
            line += &format!("  no data {no_data}");
        }
        output::line(line.trim_end())?;
    }
    let overhead = info.bytes_total.saturating_sub(info.bytes_encoded);
    output::line(format_args!(
        "{:32} {:8} {overhead:>12} {:>12.3}",
        "(file, index)",
        "-",
        per_point(overhead, info.points)
    ))
}

//! `esker info`: what a store holds.

use super::{Outcome, output};
use crate::lattice::{Lattice, LatticeBox, LatticePoint};
use crate::store::model::{SLOT_POSITION, SLOT_SCAN, Scan, Slot};
use crate::store::{Snapshot, Store};
use clap::Args;
use serde_json::{Value, json};
use std::collections::BTreeMap;
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

/// What there is to say.
struct Facts {
    points: u64,
    nodes: usize,
    levels: u8,
    root_spacing: Option<f64>,
    bounds: Option<LatticeBox>,
    /// Name, type, encoded bytes.
    attributes: Vec<(String, &'static str, u64)>,
    file_bytes: u64,
    in_use: bool,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<Outcome> {
    let store = Store::open(&arguments.store)?;
    let snapshot = store.snapshot()?;
    let facts = facts(&store, &snapshot)?;
    if arguments.json {
        output::json(&as_json(&snapshot, &facts))?;
    } else {
        print(&snapshot, &facts)?;
    }
    Ok(Outcome::Done)
}

fn facts(store: &Store, snapshot: &Snapshot) -> anyhow::Result<Facts> {
    let index = snapshot.index()?;
    let mut bytes: BTreeMap<Slot, u64> = BTreeMap::new();
    let mut packed = 0;
    for part in index.heads().iter().flat_map(|h| &h.parts) {
        for &(slot, length) in &part.chunks {
            *bytes.entry(slot).or_default() += u64::from(length);
        }
        packed += u64::from(part.packed_bytes);
    }
    let of = |slot| bytes.get(&slot).copied().unwrap_or(0);
    let mut attributes = vec![("position".to_owned(), "3 x u48", of(SLOT_POSITION))];
    for a in snapshot.attributes() {
        attributes.push((a.attribute.name.clone(), a.attribute.ty.word(), of(a.id)));
    }
    attributes.push(("(scan ids)".to_owned(), "u32", of(SLOT_SCAN)));
    attributes.push(("(small columns)".to_owned(), "-", packed));
    let root = index.roots().map(|ix| index.head(ix).cube).max_by_key(|c| c.k());
    let deepest = index.heads().iter().map(|h| h.cube.k()).min();
    let quantum = snapshot.site().lattice.largest_quantum();
    Ok(Facts {
        points: snapshot.scans().iter().map(|s| s.stored).sum(),
        nodes: index.len(),
        levels: root.zip(deepest).map_or(0, |(r, d)| r.k() - d + 1),
        root_spacing: root.map(|r| quantum * 2_f64.powi(i32::from(r.k()) - i32::from(snapshot.site().g))),
        bounds: snapshot.scans().iter().filter_map(|s| s.bounds).reduce(|a, b| a.union(&b)),
        attributes,
        file_bytes: store.path().and_then(|p| std::fs::metadata(p).ok()).map_or(0, |m| m.len()),
        in_use: store.in_use(),
    })
}

/// World bounds whose maximum is one quantum up, so that they take everything when used as a half-open box.
pub(super) fn world_bounds(lattice: &Lattice, bounds: &LatticeBox) -> ([f64; 3], [f64; 3]) {
    let last = (1 << crate::lattice::BITS) - 1;
    let up = LatticePoint(bounds.max.0.map(|i| (i + 1).min(last)));
    (lattice.world_from_lattice(bounds.min), lattice.world_from_lattice(up))
}

fn bounds_json(lattice: &Lattice, bounds: Option<&LatticeBox>) -> Value {
    bounds.map_or(Value::Null, |b| {
        let (min, max) = world_bounds(lattice, b);
        json!({ "min": min, "max": max })
    })
}

/// One scan as JSON.
pub(super) fn scan_json(scan: &Scan, lattice: &Lattice) -> Value {
    json!({
        "id": scan.id,
        "name": scan.name,
        "source": scan.source,
        "format": scan.format,
        "points": scan.stored,
        "read": scan.read,
        "rejected": {
            "not_finite": scan.rejected.not_finite,
            "out_of_range": scan.rejected.out_of_range,
            "truncated": scan.rejected.truncated,
        },
        "positions": scan.exactness.word(),
        "max_error": scan.largest_error,
        "bounds": bounds_json(lattice, scan.bounds.as_ref()),
        "color_depth": scan.color_depth,
        "visible": scan.visible,
        "time": scan.time,
    })
}

fn as_json(snapshot: &Snapshot, facts: &Facts) -> Value {
    let site = snapshot.site();
    let attributes: Vec<_> =
        facts.attributes.iter().map(|(name, ty, bytes)| json!({ "name": name, "type": ty, "bytes": bytes })).collect();
    let encoded: u64 = facts.attributes.iter().map(|a| a.2).sum();
    json!({
        "points": facts.points,
        "scans": snapshot.scans().len(),
        "nodes": facts.nodes,
        "levels": facts.levels,
        "root_spacing": facts.root_spacing,
        "bounds": bounds_json(&site.lattice, facts.bounds.as_ref()),
        "quantum": site.lattice.quantum_f64(),
        "phase": site.lattice.phase().map(crate::lattice::Decimal::to_f64),
        "crs": site.crs.as_ref().map(|c| json!({
            "description": c.describe(),
            "wkt": c.wkt,
            "horizontal_epsg": c.horizontal_epsg,
            "vertical_epsg": c.vertical_epsg,
        })),
        "unit": site.crs.as_ref().and_then(|c| c.unit_name()),
        "attributes": attributes,
        "bytes_total": facts.file_bytes,
        "bytes_encoded": encoded,
        "bytes_per_point": per_point(facts.file_bytes, facts.points),
        "generation": site.generation,
        "in_use": facts.in_use,
    })
}

fn per_point(bytes: u64, points: u64) -> f64 {
    if points == 0 { 0.0 } else { bytes as f64 / points as f64 }
}

fn print(snapshot: &Snapshot, facts: &Facts) -> std::io::Result<()> {
    let site = snapshot.site();
    let unit = site.crs.as_ref().and_then(|c| c.unit_name()).unwrap_or("unit unknown");
    output::line(format_args!("points       {}", output::grouped(facts.points)))?;
    output::line(format_args!("scans        {}", snapshot.scans().len()))?;
    output::line(format_args!("nodes        {} on {} levels", output::grouped(facts.nodes as u64), facts.levels))?;
    output::line(format_args!("lattice      {} ({unit})", super::ingest::describe(&site.lattice)))?;
    if let Some(spacing) = facts.root_spacing {
        output::line(format_args!("spacing      {spacing} at the root"))?;
    }
    if let Some(bounds) = &facts.bounds {
        let (min, max) = world_bounds(&site.lattice, bounds);
        let text = |c: [f64; 3]| format!("{},{},{}", c[0], c[1], c[2]);
        output::line(format_args!("bounds       {},{}", text(min), text(max)))?;
    }
    let crs = site.crs.as_ref().map_or_else(|| "unknown".to_owned(), |c| c.describe());
    output::line(format_args!("crs          {}", output::clean(&crs)))?;
    output::line(format_args!(
        "file         {} ({:.2} bytes a point)",
        output::bytes(facts.file_bytes),
        per_point(facts.file_bytes, facts.points)
    ))?;
    output::line(format_args!("generation   {}", site.generation))?;
    if facts.in_use {
        output::line("in use       yes: don't copy the file now")?;
    }
    output::line(format_args!("{:32} {:8} {:>12} {:>12}", "attribute", "type", "bytes", "bytes/point"))?;
    for (name, ty, bytes) in &facts.attributes {
        output::line(format_args!(
            "{:32} {ty:8} {bytes:>12} {:>12.3}",
            output::clean(name),
            per_point(*bytes, facts.points)
        ))?;
    }
    let encoded: u64 = facts.attributes.iter().map(|a| a.2).sum();
    let overhead = facts.file_bytes.saturating_sub(encoded);
    output::line(format_args!(
        "{:32} {:8} {overhead:>12} {:>12.3}",
        "(file, index)",
        "-",
        per_point(overhead, facts.points)
    ))
}

//! `esker info`: what a store holds.

use super::{Outcome, output};
use crate::lattice::{Lattice, LatticeBox, LatticePoint};
use crate::store::model::Scan;
use crate::store::{Info, Snapshot, Store, info};
use clap::Args;
use serde_json::{Value, json};
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

/// What an attribute costs.
struct Cost {
    name: String,
    ty: &'static str,
    bytes: u64,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<Outcome> {
    let store = Store::open(&arguments.store)?;
    let snapshot = store.snapshot()?;
    let info = info(&snapshot)?;
    if arguments.json {
        output::json(&as_json(&snapshot, &info))?;
    } else {
        print(&snapshot, &info)?;
    }
    Ok(Outcome::Done)
}

fn costs(snapshot: &Snapshot, info: &Info) -> Vec<Cost> {
    let mut costs = vec![Cost { name: "position".into(), ty: "3 x u48", bytes: info.position_bytes }];
    for &(slot, bytes) in &info.attribute_bytes {
        if let Some(a) = snapshot.attribute(slot) {
            costs.push(Cost { name: a.attribute.name.clone(), ty: a.attribute.ty.word(), bytes });
        }
    }
    costs.push(Cost { name: "(scan of each point)".into(), ty: "u32", bytes: info.scan_bytes });
    costs
}

/// The spacing of the samples that the root holds, in CRS units.
fn root_spacing(snapshot: &Snapshot) -> Option<f64> {
    let site = snapshot.site();
    let root = site.roots.iter().flatten().map(|r| r.k()).max()?;
    Some(site.lattice.largest_quantum() * 2_f64.powi(i32::from(root) - i32::from(site.g)))
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
        // Row-major, world from scan; the scanner stood where it takes the origin.
        "pose": scan.pose,
        "scanner": [scan.pose[3], scan.pose[7], scan.pose[11]],
        "color_depth": scan.color_depth,
        "visible": scan.visible,
        "time": scan.time,
    })
}

fn as_json(snapshot: &Snapshot, info: &Info) -> Value {
    let site = snapshot.site();
    let attributes: Vec<_> =
        costs(snapshot, info).into_iter().map(|c| json!({ "name": c.name, "type": c.ty, "bytes": c.bytes })).collect();
    json!({
        "points": info.points,
        "scans": snapshot.scans().len(),
        "nodes": info.nodes,
        "levels": info.levels,
        "root_spacing": root_spacing(snapshot),
        "bounds": bounds_json(&site.lattice, info.bounds.as_ref()),
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
        "bytes_total": info.total_bytes,
        "bytes_encoded": info.chunk_bytes,
        "bytes_per_point": per_point(info.total_bytes, info.points),
        "generation": site.generation,
        "in_use": info.in_use,
    })
}

fn per_point(bytes: u64, points: u64) -> f64 {
    if points == 0 { 0.0 } else { bytes as f64 / points as f64 }
}

fn print(snapshot: &Snapshot, info: &Info) -> std::io::Result<()> {
    let site = snapshot.site();
    let unit = site.crs.as_ref().and_then(|c| c.unit_name()).unwrap_or("unit unknown");
    output::line(format_args!("points       {}", output::grouped(info.points)))?;
    output::line(format_args!("scans        {}", snapshot.scans().len()))?;
    output::line(format_args!("nodes        {} on {} levels", output::grouped(info.nodes), info.levels))?;
    output::line(format_args!("lattice      {} ({unit})", super::ingest::describe(&site.lattice)))?;
    if let Some(spacing) = root_spacing(snapshot) {
        output::line(format_args!("spacing      {spacing} at the root"))?;
    }
    if let Some(bounds) = &info.bounds {
        let (min, max) = world_bounds(&site.lattice, bounds);
        let text = |c: [f64; 3]| format!("{},{},{}", c[0], c[1], c[2]);
        output::line(format_args!("bounds       {},{}", text(min), text(max)))?;
    }
    let crs = site.crs.as_ref().map_or_else(|| "unknown".to_owned(), |c| c.describe());
    output::line(format_args!("crs          {}", output::clean(&crs)))?;
    output::line(format_args!(
        "file         {} ({:.2} bytes a point)",
        output::bytes(info.total_bytes),
        per_point(info.total_bytes, info.points)
    ))?;
    output::line(format_args!("generation   {}", site.generation))?;
    if info.in_use {
        output::line("in use       yes: don't copy the file now")?;
    }
    output::line(format_args!("{:32} {:8} {:>12} {:>12}", "attribute", "type", "bytes", "bytes/point"))?;
    for Cost { name, ty, bytes } in costs(snapshot, info) {
        output::line(format_args!(
            "{:32} {ty:8} {bytes:>12} {:>12.3}",
            output::clean(&name),
            per_point(bytes, info.points)
        ))?;
    }
    let overhead = info.total_bytes.saturating_sub(info.chunk_bytes);
    output::line(format_args!(
        "{:32} {:8} {overhead:>12} {:>12.3}",
        "(file, index)",
        "-",
        per_point(overhead, info.points)
    ))
}

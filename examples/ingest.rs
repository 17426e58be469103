//! Puts point files into a store with the library and prints where the time went.
//!
//! `cargo run --release --example ingest -- site.esker north.laz south.laz`

use esker::ingest::{IngestOptions, ingest};
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let Some(store) = arguments.next() else {
        return Err("usage: ingest STORE INPUT...".into());
    };
    let inputs: Vec<_> = arguments.collect();
    let report = ingest(&store, &inputs, &IngestOptions::default(), &())?;
    for stage in &report.stages {
        println!("{:10} {:8.2} s {:8.1} ns a point", stage.stage, stage.seconds, stage.ns_per_point);
    }
    println!("{} points, {:.1} million a second", report.points, report.points_per_second / 1e6);
    Ok(())
}

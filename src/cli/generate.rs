//! `esker generate`: synthetic models for trials.

use super::{Outcome, output, values};
use crate::generate::{GenerateOptions, Kind, generate};
use clap::Args;
use std::path::PathBuf;

/// Makes a synthetic model as LAS or LAZ: the same file for the same seed.
///
/// torus, spheres: simple shapes. terrain: an airborne survey with trees and buildings. site: several overlapping
/// terrestrial scans, each a file in a folder, denser near the scanner.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  esker generate terrain --points 5M -o terrain.laz\n  \
                  esker generate site --points 20M --seed 7 --scans 8 -o scans/")]
pub(super) struct Arguments {
    /// torus, spheres, terrain or site.
    #[arg(value_parser = kind)]
    kind: Kind,
    /// How many points, such as 500000 or 2M.
    #[arg(long, value_name = "N", value_parser = values::count)]
    points: u64,
    /// Another seed makes another model.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Scans of a site.
    #[arg(long, value_name = "N", default_value_t = GenerateOptions::default().scans)]
    scans: u32,
    /// Write the scans of a site as LAZ.
    #[arg(long)]
    laz: bool,
    /// A file ending in .las or .laz; for a site, a folder.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Replace existing files.
    #[arg(long)]
    force: bool,
}

fn kind(word: &str) -> Result<Kind, String> {
    Kind::from_word(word).ok_or_else(|| {
        let words: Vec<_> = Kind::ALL.iter().map(|k| k.word()).collect();
        format!("there is no model '{word}'; there are {}", words.join(", "))
    })
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<Outcome> {
    let options = GenerateOptions { force: arguments.force, scans: arguments.scans, laz: arguments.laz };
    let report =
        generate(arguments.kind, arguments.points, arguments.seed, &arguments.output, &options, &mut |_| true)?;
    for note in &report.notes {
        eprintln!("esker: {}", output::clean(note));
    }
    for (path, points) in &report.files {
        output::line(format_args!("{}: {} points", path.display(), output::grouped(*points)))?;
    }
    Ok(Outcome::Done)
}

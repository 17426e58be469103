//! `esker generate`: synthetic models for trials.

use super::interrupt::cancelled_by_interrupt;
use super::progress::Mode;
use super::watching::Watching;
use super::{Outcome, Usage, output, values};
use crate::generate::{GenerateOptions, Kind, generate};
use clap::Args;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

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
    /// Scans of a site (default: 5).
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    scans: Option<u32>,
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
    let is_site = arguments.kind == Kind::Site;
    if !is_site && (arguments.scans.is_some() || arguments.laz) {
        let option = if arguments.laz { "--laz" } else { "--scans" };
        let what = format!("{option} is for a site; another model is one file, LAS or LAZ as its name ends");
        return Err(Usage(what).into());
    }
    let ending = arguments.output.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    if is_site && matches!(ending.as_str(), "las" | "laz") && !arguments.output.is_dir() {
        let what = format!("{}: a site is a folder of files; give the name of a folder", arguments.output.display());
        return Err(Usage(what).into());
    }
    let scans = arguments.scans.unwrap_or(GenerateOptions::default().scans);
    let options = GenerateOptions { force: arguments.force, scans, laz: arguments.laz };
    let (cancel, all, written) = (cancelled_by_interrupt(), arguments.points, Arc::new(AtomicU64::new(0)));
    let far = written.clone();
    let watching = Watching::new(Mode::Auto, "generating", move || (far.load(Ordering::Relaxed), Some(all)));
    let mut go_on = |points| {
        written.store(points, Ordering::Relaxed);
        !cancel.is_cancelled()
    };
    let report = generate(arguments.kind, all, arguments.seed, &arguments.output, &options, &mut go_on)?;
    drop(watching);
    for note in &report.notes {
        output::tell!("esker: {}", output::clean(note));
    }
    for (path, points) in &report.files {
        output::line(format_args!("{}: {}", path.display(), output::counted(*points, "point")))?;
    }
    Ok(Outcome::Done)
}

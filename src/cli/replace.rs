//! `esker replace`: a scan's new version in its place.

use super::progress::Shown;
use super::{Outcome, changing::Changing, output};
use crate::ingest::{self, IngestOptions};
use clap::Args;
use std::path::PathBuf;

/// Takes a scan out and puts another file in its place, in one commit: readers see the one or the other.
///
/// Without a file, the scan's own source is read again.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  esker replace site.esker roof roof-cleaned.laz\n  \
                  esker replace site.esker roof            # the same file, read again\n  \
                  esker replace site.esker roof --pose registered.txt")]
pub(super) struct Arguments {
    /// The store.
    store: PathBuf,
    /// The scan, by name or number (`esker scans` lists them).
    scan: String,
    /// The new file (default: the scan's source).
    input: Option<PathBuf>,
    /// Where the scan stands: a file with one pose, as for `ingest` (default for the same file: as before).
    #[arg(long, value_name = "FILE")]
    pose: Option<PathBuf>,
    /// What the columns of a text file are, as for `ingest`.
    #[arg(long, value_name = "A,B,..", value_parser = super::ingest::columns, allow_hyphen_values = true)]
    columns: Option<super::ingest::Columns>,
    /// The new scan's name (default: the old one's).
    #[arg(long, value_parser = super::values::name, allow_hyphen_values = true)]
    name: Option<String>,
    /// Take coordinates as they are though the file's CRS is not the site's.
    #[arg(long)]
    ignore_crs: bool,
    /// Truncated files are errors; rejected points end the command with exit code 3.
    #[arg(long)]
    strict: bool,
    #[command(flatten)]
    changing: Changing,
    /// One JSON object on stdout.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<Outcome> {
    let shown = Shown::new(arguments.changing.progress);
    let options = IngestOptions {
        resources: arguments.changing.resources(),
        poses: super::ingest::poses(arguments.pose.as_slice())?,
        columns: arguments.columns.map(|c| c.0),
        ignore_crs: arguments.ignore_crs,
        name: arguments.name,
        strict: arguments.strict,
        ..IngestOptions::default()
    };
    let result = ingest::replace(&arguments.store, &arguments.scan, arguments.input.as_deref(), &options, &shown);
    shown.clear();
    let report = result?;
    super::ingest::tell(&report);
    if arguments.json {
        output::json(&serde_json::to_value(&report)?)?;
    } else {
        output::line(format_args!("{}: replaced", output::clean(&arguments.scan)))?;
        super::ingest::print(&report)?;
    }
    let rejected = report.scans.iter().any(|s| s.rejected > 0);
    Ok(if arguments.strict && rejected { Outcome::Rejected } else { Outcome::Done })
}

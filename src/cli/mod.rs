//! The command line: one file per command. Data on stdout, words on stderr; exit codes 0 ok, 1 error, 2 usage,
//! 3 finished with rejected points under `--strict`, 130 interrupted.

mod bookmark;
mod cameras;
mod changing;
mod compact;
mod density;
mod digest;
mod generate;
mod info;
mod ingest;
mod interrupt;
mod labels;
mod limits;
mod merge;
mod nearest;
mod output;
mod progress;
mod query;
mod region;
mod remove;
#[cfg(feature = "render")]
mod render;
mod replace;
mod scans;
mod values;
mod verify;
#[cfg(feature = "viewer")]
mod view;
mod visibility;
mod watching;
mod which;

use crate::export::ExportError;
use crate::generate::GenerateError;
use crate::ingest::IngestError;
use crate::query::QueryError;
use clap::{Parser, Subcommand};
use std::process::ExitCode;

/// Options that are no use together, as clap ends what it finds itself.
const EXIT_USAGE: u8 = 2;
/// Rejected points under `--strict`.
const EXIT_REJECTED: u8 = 3;
/// Ctrl-C.
const EXIT_INTERRUPTED: u8 = 130;

/// How a command ended when it did not fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Done,
    Rejected,
    /// `verify` found damage and has said so.
    Damaged,
}

/// Options are wrong that only together can be seen to be.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Usage(String);

#[derive(Debug, Parser)]
#[command(
    name = "esker",
    version,
    about = "Keeps point clouds of any size in one file and gives back the points that a question needs",
    after_help = "Examples:\n  esker ingest site.esker scans/*.laz\n  esker info site.esker\n  \
                  esker query site.esker --box 500000,5000000,500050,5000050 -o corner.laz\n  \
                  esker render site.esker -o site.png\n  esker view site.esker\n\n`esker COMMAND --help` has more."
)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Ingest(ingest::Arguments),
    Scans(scans::Arguments),
    Remove(remove::Arguments),
    Replace(replace::Arguments),
    Rename(labels::Rename),
    Show(visibility::Show),
    Hide(visibility::Hide),
    SetCrs(labels::SetCrs),
    Compact(compact::Arguments),
    Merge(merge::Arguments),
    Bookmark(bookmark::Arguments),
    Info(info::Arguments),
    Query(query::Arguments),
    Nearest(nearest::Arguments),
    Density(density::Arguments),
    #[cfg(feature = "render")]
    Render(render::Arguments),
    #[cfg(feature = "viewer")]
    View(view::Arguments),
    Verify(verify::Arguments),
    Digest(digest::Arguments),
    Generate(generate::Arguments),
}

/// Runs the command that the process was started with.
pub fn main() -> ExitCode {
    limits::let_writes_fail();
    // A closed pipe ends a program quietly in the shell's tradition; Rust reports it as an error of a write instead,
    // which `output` turns into a quiet end.
    let arguments = Arguments::parse();
    let result = match arguments.command {
        Command::Ingest(a) => ingest::run(a),
        Command::Scans(a) => scans::run(&a),
        Command::Remove(a) => remove::run(&a),
        Command::Replace(a) => replace::run(a),
        Command::Rename(a) => labels::rename(&a),
        Command::Show(a) => visibility::show(&a),
        Command::Hide(a) => visibility::hide(&a),
        Command::SetCrs(a) => labels::set_crs(&a),
        Command::Compact(a) => compact::run(&a),
        Command::Merge(a) => merge::run(&a),
        Command::Bookmark(a) => bookmark::run(&a),
        Command::Info(a) => info::run(&a),
        Command::Query(a) => query::run(&a),
        Command::Nearest(a) => nearest::run(&a),
        Command::Density(a) => density::run(&a),
        #[cfg(feature = "render")]
        Command::Render(a) => render::run(&a),
        #[cfg(feature = "viewer")]
        Command::View(a) => view::run(&a),
        Command::Verify(a) => verify::run(&a),
        Command::Digest(a) => digest::run(&a),
        Command::Generate(a) => generate::run(a),
    };
    match result {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Rejected) => ExitCode::from(EXIT_REJECTED),
        Ok(Outcome::Damaged) => ExitCode::FAILURE,
        Err(error) if output::is_closed_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            let hint = limits::of_file_size(&error).unwrap_or_default();
            output::tell!("esker: {}{hint}", output::one_line(&error));
            ExitCode::from(match error {
                error if is_interrupted(&error) => EXIT_INTERRUPTED,
                error if is_usage(&error) => EXIT_USAGE,
                _ => 1,
            })
        }
    }
}

/// Is it the command line that is wrong, whatever the store and the files are?
fn is_usage(error: &anyhow::Error) -> bool {
    let of_export = |e: &ExportError| {
        matches!(e, ExportError::ScaleOfNoGrid | ExportError::SplitOfStandardOutput | ExportError::Ending { .. })
    };
    error.is::<Usage>() || error.downcast_ref::<ExportError>().is_some_and(of_export)
}

/// Did Ctrl-C end the command?
fn is_interrupted(error: &anyhow::Error) -> bool {
    error.downcast_ref::<IngestError>().is_some_and(|e| matches!(e, IngestError::Interrupted))
        || error.downcast_ref::<QueryError>().is_some_and(|e| matches!(e, QueryError::Cancelled))
        || error.is::<verify::Ended>()
        || error.downcast_ref::<GenerateError>().is_some_and(|e| matches!(e, GenerateError::Stopped))
        || error.downcast_ref::<ExportError>().is_some_and(|e| matches!(e, ExportError::Query(QueryError::Cancelled)))
}

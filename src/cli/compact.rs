//! `esker compact`: one layer, no free space.

use super::progress::Shown;
use super::{Outcome, changing::Changing, output};
use crate::ingest;
use clap::Args;
use std::path::PathBuf;

/// Makes one layer of all and gives free space back to the file system.
///
/// Thin, wide scans are kept in layers of their own until then. The content stays the same, to the bit. While it runs,
/// a second copy of the store takes room beside it.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  esker compact site.esker\n  esker compact site.esker -o copy.esker")]
pub(super) struct Arguments {
    /// The store.
    store: PathBuf,
    /// Leave the store as it is and write a compact copy here.
    #[arg(short, long, value_name = "COPY")]
    output: Option<PathBuf>,
    #[command(flatten)]
    changing: Changing,
    /// One JSON object on stdout.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<Outcome> {
    let shown = Shown::new(arguments.changing.progress);
    let resources = arguments.changing.resources();
    let result = ingest::compact(&arguments.store, arguments.output.as_deref(), &resources, &shown);
    shown.clear();
    let done = result?;
    if arguments.json {
        output::json(&serde_json::to_value(&done)?)?;
    } else {
        let layers = if done.layers > 1 { format!("{} layers became one; ", done.layers) } else { String::new() };
        let what = if arguments.output.is_some() { "the copy has" } else { "the file has" };
        output::line(format_args!(
            "{layers}{what} {} now, {} before ({:.2} s)",
            output::bytes(done.bytes_after),
            output::bytes(done.bytes_before),
            done.seconds,
        ))?;
    }
    Ok(Outcome::Done)
}

//! `esker verify`: is the store whole?

use super::interrupt::cancelled_by_interrupt;
use super::watching::{Reading, Watching};
use super::{Outcome, output};
use crate::store::{Report, Store, verify};
use clap::Args;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Damage that is told in words; the rest is counted.
const TOLD: usize = 20;

/// Checks that a store is whole: checksums, counts, bounds, zone maps, and that no point was lost.
///
/// Names what is damaged; everything else stays readable. Exit code 1 if anything is.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  esker verify site.esker\n  esker verify site.esker --deep --json")]
pub(super) struct Arguments {
    /// The store.
    store: PathBuf,
    /// Also check that every point is stored where the sampling rule puts it.
    #[arg(long)]
    deep: bool,
    #[command(flatten)]
    reading: Reading,
    /// One JSON object on stdout.
    #[arg(long)]
    json: bool,
}

/// Ctrl-C came before the end.
#[derive(Debug, thiserror::Error)]
#[error("interrupted; not all was checked")]
pub(super) struct Ended;

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<Outcome> {
    let store = Store::open(&arguments.store)?;
    let far = Arc::new([AtomicU64::new(0), AtomicU64::new(0)]);
    let cancel = cancelled_by_interrupt();
    let go_on = |done, all| {
        far[0].store(done, Ordering::Relaxed);
        far[1].store(all, Ordering::Relaxed);
        if cancel.is_cancelled() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let shown = far.clone();
    let shown = move || (shown[0].load(Ordering::Relaxed), Some(shown[1].load(Ordering::Relaxed)));
    let watching = Watching::new(arguments.reading.progress, "verifying", shown);
    let report = arguments.reading.pool()?.install(|| verify(&store, arguments.deep, &go_on));
    drop(watching);
    let report = report.ok_or(Ended)?;
    if arguments.json {
        let findings: Vec<_> = report
            .findings
            .iter()
            .map(|f| serde_json::json!({ "table": f.table, "key": f.key, "what": f.what }))
            .collect();
        output::json(&serde_json::json!({
            "whole": report.is_whole(),
            "findings": findings,
            "more_findings": report.more_findings,
            "nodes": report.nodes,
            "points": report.points,
            "scans": report.scans,
        }))?;
    } else if report.is_whole() {
        output::line(format_args!(
            "whole: {} in {}, {}",
            output::counted(report.points, "point"),
            output::counted(report.nodes, "node"),
            output::counted(report.scans, "scan"),
        ))?;
    } else {
        for line in damage(&report) {
            output::tell!("esker: {}: {line}", arguments.store.display());
        }
    }
    Ok(if report.is_whole() { Outcome::Done } else { Outcome::Damaged })
}

/// What is damaged, line by line.
fn damage(report: &Report) -> Vec<String> {
    let told = report.findings.iter().take(TOLD);
    let mut lines: Vec<_> = told.map(|f| format!("damaged: {}", output::clean(&f.to_string()))).collect();
    let more = report.findings.len().saturating_sub(TOLD) as u64 + report.more_findings;
    if more > 0 {
        lines.push(format!("{} more; --json names the first thousand", output::grouped(more)));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Finding;

    #[test]
    fn much_damage_is_told_in_few_lines() {
        let finding = |i: usize| Finding { table: "chunk".into(), key: i.to_string(), what: "bad\u{1b}".into() };
        let report = |n: usize, more_findings| Report {
            findings: (0..n).map(finding).collect(),
            more_findings,
            ..Report::default()
        };
        assert_eq!(
            damage(&report(2, 0)),
            ["damaged: table chunk, 0: bad\u{fffd}", "damaged: table chunk, 1: bad\u{fffd}"]
        );
        assert_eq!(damage(&report(20, 0)).len(), 20);
        let lines = damage(&report(1000, 234));
        assert_eq!((lines.len(), lines[20].as_str()), (21, "1,214 more; --json names the first thousand"));
    }
}

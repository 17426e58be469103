//! One ingest from beginning to end.

use super::batch::{Batch, add};
use super::budget::peak_memory;
use super::context::{Context, Resources};
use super::lattice_choice::{Evidence, choose};
use super::layers::fold_if_many;
use super::measure::{WorldBounds, measure};
use super::progress::Progress;
use super::report::{Report, Stages};
use super::rows::RowKey;
use super::sources::{self, Source};
use super::{IngestError, IngestOptions};
use crate::lattice::{Decimal, Lattice};
use crate::points::Crs;
use crate::store::{SiteOptions, Store, StoreError, Writer, check_folder};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Puts `inputs` into the store at `path`, which is created if it is not there.
///
/// Sources that the store has already are skipped. All others become scans: those that fit the memory together in one
/// commit, in the order given. If anything fails, the store has the scans that were committed until then, and giving the
/// same inputs again goes on from there.
///
/// # Errors
///
/// [`IngestError`], in whose every case the store is as its last commit left it.
///
/// # Examples
///
/// ```no_run
/// use esker::ingest::{IngestOptions, ingest};
///
/// let report = ingest("site.esker".as_ref(), &["north.laz".into()], &IngestOptions::default(), &())?;
/// println!("{} points", report.points);
/// # Ok::<(), esker::ingest::IngestError>(())
/// ```
pub fn ingest(
    path: &Path,
    inputs: &[PathBuf],
    options: &IngestOptions,
    progress: &dyn Progress,
) -> Result<Report, IngestError> {
    let resources = Resources { memory_bytes: options.memory_bytes, threads: options.threads, wait: options.wait };
    Context::run(path, &resources, progress, |context| run(context, inputs, options))
}

fn run(context: &Context<'_>, inputs: &[PathBuf], options: &IngestOptions) -> Result<Report, IngestError> {
    let started = Instant::now();
    let mut stages = Stages::default();
    // A store that is there is locked first: what is looked at then stays true.
    let mut open = match context.path.exists() && !Store::is_unfinished(context.path) {
        true => Some(opened(context, Store::open(context.path)?)?),
        false => {
            // Before hours of reading.
            check_folder(context.path)?;
            None
        }
    };
    let (stored, site_crs) = match &open {
        Some((store, _)) => {
            let snapshot = store.snapshot()?;
            refuse_another_lattice(options, &snapshot.site().lattice)?;
            (snapshot.scans().to_vec(), snapshot.site().crs.clone())
        }
        None => (Vec::new(), None),
    };
    let sources::Sources { sources, skipped } = sources::open(inputs, options, &stored, context.progress)?;
    let mut report = Report { skipped, ..Report::default() };
    if sources.is_empty() {
        report.seconds = started.elapsed().as_secs_f64();
        return Ok(report);
    }
    let (crs, notes) = sources::agree_on_crs(site_crs, &sources, options.ignore_crs)?;
    report.notes.extend(notes);
    let measured = measure(context, &sources, &mut stages)?;

    let created = open.is_none();
    let (store, mut writer) = match open.take() {
        Some(open) => open,
        None => {
            let (lattice, notes) = choose(&evidence(&sources, &measured), &options.lattice)?;
            report.notes.extend(notes);
            let site = SiteOptions { lattice, g: options.g, leaf_capacity: options.leaf_capacity, crs: crs.clone() };
            match Store::create_with_writer(context.path, site) {
                // Somebody else has come first, and their store is gone on with. (A link that leads nowhere is no store.)
                Err(StoreError::AlreadyThere { .. } | StoreError::InUse { .. })
                    if context.wait && !context.path.is_symlink() =>
                {
                    context.pause()?;
                    return run(context, inputs, options);
                }
                created => created?,
            }
        }
    };
    if writer.leftovers().chunk_rows + writer.leftovers().spill_files > 0 {
        report.notes.push(format!(
            "removed what a run that was cut off had left: {} chunks, {} temporary files",
            writer.leftovers().chunk_rows,
            writer.leftovers().spill_files
        ));
    }
    for range in batches(&sources, context.memory) {
        let batch = Batch {
            sources: &sources[range.clone()],
            measured: &measured[range],
            crs: crs.clone(),
            replaced: &[],
            visible: true,
            strict: options.strict,
        };
        let added = add(context, &store, &mut writer, &batch, &mut stages, &mut report);
        if added.is_err() && created && report.scans.is_empty() {
            // Nothing was there before and nothing was added: leave no empty store behind.
            drop(store);
            writer.remove_store();
            return Err(added.err().unwrap_or(IngestError::Interrupted));
        }
        added?;
        fold_if_many(context, &store, &mut writer)?;
    }
    report.seconds = started.elapsed().as_secs_f64();
    report.points_per_second = if report.seconds > 0.0 { report.points as f64 / report.seconds } else { 0.0 };
    report.peak_memory_bytes = peak_memory();
    report.stages = stages.into_reports();
    Ok(report)
}

/// A store and its writer.
pub(super) fn opened(context: &Context<'_>, store: Store) -> Result<(Store, Writer), IngestError> {
    let writer = context.writer(&store)?;
    Ok((store, writer))
}

/// Runs of sources whose rows fit the memory together; a source that doesn't fit is alone.
fn batches(sources: &[Source], memory: u64) -> Vec<Range<usize>> {
    let bytes = |source: &Source| {
        let info = source.reader.info();
        info.records.saturating_mul((info.layout.payload + <u64 as RowKey>::BYTES) as u64)
    };
    let mut batches: Vec<Range<usize>> = Vec::new();
    let mut filled = 0_u64;
    for (i, source) in sources.iter().enumerate() {
        let more = bytes(source);
        match batches.last_mut() {
            Some(batch) if filled.saturating_add(more) <= memory / 2 => {
                batch.end = i + 1;
                filled += more;
            }
            _ => {
                batches.push(i..i + 1);
                filled = more;
            }
        }
    }
    batches
}

fn refuse_another_lattice(options: &IngestOptions, stored: &Lattice) -> Result<(), IngestError> {
    let wish = &options.lattice;
    let same = wish.quantum.is_none_or(|q| q == stored.quantum_f64())
        && wish.phase.is_none_or(|p| p == stored.phase().map(Decimal::to_f64));
    if same {
        return Ok(());
    }
    Err(IngestError::LatticeFixed {
        stored: stored.quantum_f64().map(|q| q.to_string()).join(" x "),
        phase: stored.phase().map(|p| p.to_string()).join(" x "),
    })
}

fn evidence(sources: &[Source], measured: &[Option<WorldBounds>]) -> Vec<Evidence> {
    let of = |(source, bounds): (&Source, &Option<WorldBounds>)| Evidence {
        grid: source.reader.info().grid,
        bounds: *bounds,
        step: source.reader.info().step,
        geographic: source.crs.as_ref().is_some_and(Crs::is_geographic),
    };
    sources.iter().zip(measured).map(of).collect()
}

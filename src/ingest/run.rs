//! One ingest from beginning to end.

use super::agree::{Said, agree_on_crs};
use super::batch::{Batch, add};
use super::budget::peak_memory;
use super::context::Context;
use super::error::Stopped;
use super::lattice_choice::{Evidence, choose};
use super::layers::fold_if_many;
use super::measure::{WorldBounds, measure};
use super::progress::Progress;
use super::report::{Report, Skipped, Stages};
use super::rows::RowKey;
use super::sources::{self, Source};
use super::{IngestError, IngestOptions};
use crate::formats::PointTable;
use crate::lattice::{Decimal, Lattice};
use crate::points::Crs;
use crate::store::{SiteOptions, Store, StoreError, Writer, check_folder};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// Puts `inputs` into the store at `path`, which is created if it is not there.
///
/// Sources that the store has already are skipped. All others become scans: those that fit the memory together in one
/// commit, in the order given. If anything fails, the store has the scans that were committed until then, and giving the
/// same inputs again goes on from there. With [`IngestOptions::keep_going`] inputs that can't be read are left out, and only
/// if nothing else is there the first one's error is that of the whole.
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
    Context::run(path, &options.resources, progress, |context| run(context, &sources::Inputs::Files(inputs), options))
}

/// Puts points that a program has made into a store, as a scan of the table's name, creating the store if it is not there. The
/// same points again are skipped, like a file that is there already. `options`: `name`, `columns`, `recursive` and `keep_going` say
/// nothing of a table; of `poses` there may be one.
///
/// ```
/// use esker::formats::PointTable;
/// use esker::ingest::{IngestOptions, LatticeWish, ingest_table};
/// use esker::points::Column;
/// use esker::query::{Filter, Query};
/// use esker::store::Store;
///
/// # let folder = std::env::temp_dir().join(format!("esker-table-{}", std::process::id()));
/// # std::fs::create_dir_all(&folder)?;
/// let path = folder.join("made.esker");
/// let mut table = PointTable::new("made", vec![1.0, 2.0, 3.0], vec![0.0; 3], vec![5.25; 3])?;
/// table.add("Classification", Column::U8(vec![2, 6, 2]))?;
/// let lattice = LatticeWish { quantum: Some([0.001; 3]), phase: None };
/// let report = ingest_table(&path, table, &IngestOptions { lattice, ..IngestOptions::default() }, &())?;
/// assert_eq!((report.scans[0].name.as_str(), report.points), ("made", 3));
///
/// let ground = Query::new().filter(Filter::parse("Classification = 2")?);
/// assert_eq!(ground.count(&Store::open(&path)?.snapshot()?)?.points, 2);
/// # std::fs::remove_dir_all(&folder)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
///
/// As [`ingest`].
pub fn ingest_table(
    path: &Path,
    table: PointTable,
    options: &IngestOptions,
    progress: &dyn Progress,
) -> Result<Report, IngestError> {
    let options = &IngestOptions { name: None, columns: None, keep_going: false, ..options.clone() };
    let inputs = sources::Inputs::Table(Arc::new(table));
    Context::run(path, &options.resources, progress, |context| run(context, &inputs, options))
}

fn run(context: &Context<'_>, inputs: &sources::Inputs<'_>, options: &IngestOptions) -> Result<Report, IngestError> {
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
    // Of a first ingest that was cut off: neither its lattice nor its CRS counts.
    let is_provisional = open.as_ref().is_some_and(|(_, writer)| writer.is_provisional());
    let created = open.is_none() || is_provisional;
    let (stored, lattice, mut site_crs) = match &open {
        Some((store, _)) if !is_provisional => {
            let snapshot = store.snapshot()?;
            refuse_another_lattice(options, &snapshot.site().lattice)?;
            let site = snapshot.site();
            (snapshot.scans().to_vec(), Some(site.lattice.clone()), site.crs.clone())
        }
        _ => (Vec::new(), None, None),
    };
    let known = sources::Stored { scans: &stored, lattice: lattice.as_ref() };
    let opened = sources::open(inputs, options, known, context.progress)?;
    let mut report = Report { skipped: opened.skipped.clone(), ..Report::default() };
    if !options.keep_going {
        // Before hours of measuring.
        let said: Vec<Said> = opened.sources.iter().map(Source::said).collect();
        agree_on_crs(site_crs.clone(), &said, options.ignore_crs)?;
    }
    let mut rest = Rest::measured(context, opened, options.keep_going, &mut stages)?;
    if rest.sources.is_empty() {
        // What is skipped is in the store if there was one.
        if (open.is_none() || report.skipped.is_empty()) && !rest.unreadable.is_empty() {
            return Err(rest.unreadable.swap_remove(0).1);
        }
        report.unreadable = left_out(&rest.unreadable);
        report.seconds = started.elapsed().as_secs_f64();
        return Ok(report);
    }
    let is_text = |source: &Source| !source.reader.info().options.is_empty();
    if options.columns.is_some() && !rest.sources.iter().any(is_text) {
        report.notes.push("no input is a file of text: the names of columns are of no use".into());
    }
    if let Some(leftovers) = open.as_ref().map(|(_, writer)| writer.leftovers())
        && leftovers.chunk_rows + leftovers.spill_files > 0
    {
        report.notes.push(format!(
            "removed what a run that was cut off had left: {} chunks, {} temporary files",
            leftovers.chunk_rows, leftovers.spill_files
        ));
    }

    let noted = report.notes.len();
    let (crs_before, mut stored_now) = (site_crs.clone(), Vec::new());
    let mut is_settled = false;
    loop {
        // Nothing is committed: the inputs that are left decide on lattice and CRS, and no other.
        if !is_settled && !rest.sources.is_empty() {
            rest.agree(site_crs.as_ref(), options)?;
            report.notes.truncate(noted);
            if created {
                match new_store(context, options, &rest, open.take(), &mut report.notes)? {
                    Some(made) => open = Some(made),
                    // Somebody else has come first, and their store is gone on with.
                    None => {
                        context.pause()?;
                        return run(context, inputs, options);
                    }
                }
            }
            is_settled = true;
        }
        let (Some((store, writer)), false) = (&mut open, rest.sources.is_empty()) else { break };
        let range = 0..first_batch(&rest.sources, context.memory);
        let said: Vec<Said> = rest.sources[range.clone()].iter().map(Source::said).collect();
        let (crs, _) = agree_on_crs(site_crs.clone(), &said, options.ignore_crs)?;
        let batch = Batch {
            sources: &rest.sources[range.clone()],
            measured: &rest.measured[range.clone()],
            crs: crs.clone(),
            replaced: &[],
            visible: true,
            strict: options.strict,
            keep_going: options.keep_going,
        };
        let failure = match add(context, store, writer, &batch, &mut stages, &mut report) {
            Ok(()) => {
                site_crs = crs;
                stored_now.extend(said);
                rest.drop_first(range.len());
                fold(context, store, writer, &mut report)?;
                continue;
            }
            // It is read once more without them.
            Err(Stopped::Unreadable(of_batch)) if options.keep_going => {
                rest.leave_out(of_batch);
                is_settled = !report.scans.is_empty();
                if !is_settled {
                    // What they said of the CRS does not count.
                    rest.take_up_others();
                }
                let any = !report.scans.is_empty() || !created && !report.skipped.is_empty();
                if any || !rest.sources.is_empty() {
                    continue;
                }
                rest.unreadable.swap_remove(0).1
            }
            Err(stopped) => stopped.into(),
        };
        if let (true, true, Some((store, writer))) = (created, report.scans.is_empty(), open) {
            // Nothing was there before and nothing was added: leave no empty store behind.
            drop(store);
            writer.remove_store();
        }
        return Err(failure);
    }
    report.notes.extend(crs_notes(crs_before, !stored.is_empty(), &stored_now, options.ignore_crs)?);
    rest.give_up_others();
    if report.scans.is_empty() && report.skipped.is_empty() && !rest.unreadable.is_empty() {
        return Err(rest.unreadable.swap_remove(0).1);
    }
    report.unreadable = left_out(&rest.unreadable);
    report.seconds = started.elapsed().as_secs_f64();
    report.points_per_second = if report.seconds > 0.0 { report.points as f64 / report.seconds } else { 0.0 };
    report.peak_memory_bytes = peak_memory();
    report.stages = stages.into_reports();
    Ok(report)
}

/// What to tell of the CRS of inputs beside the site's. `holds_scans`: the site has some already.
fn crs_notes(site: Option<Crs>, holds_scans: bool, said: &[Said], ignore: bool) -> Result<Vec<String>, IngestError> {
    let before = site.clone().filter(|crs| !crs.is_empty());
    let (crs, mut notes) = agree_on_crs(site, said, ignore)?;
    let Some(crs) = crs.filter(|_| holds_scans) else { return Ok(notes) };
    let had = match &before {
        None => Some("the site had no CRS"),
        Some(before) if before.vertical_epsg != crs.vertical_epsg => Some("the site's heights had no system"),
        Some(_) => None,
    };
    if let Some(had) = had {
        notes.push(format!(
            "{had}; it is {} now, which is taken for that of the scans that it has, too",
            crs.describe()
        ));
    }
    Ok(notes)
}

/// A new store, or one to which nothing was ever committed, for the sources that are to be read; none if somebody else has
/// made one meanwhile that is to be waited for.
fn new_store(
    context: &Context<'_>,
    options: &IngestOptions,
    rest: &Rest,
    left: Option<(Store, Writer)>,
    notes: &mut Vec<String>,
) -> Result<Option<(Store, Writer)>, IngestError> {
    let (lattice, of_lattice) = choose(&evidence(&rest.sources, &rest.measured), &options.lattice)?;
    notes.extend(of_lattice);
    // The CRS comes with the first scans that name one.
    let site = SiteOptions { lattice, g: options.g, leaf_capacity: options.leaf_capacity, crs: None };
    let made = match left {
        Some((store, mut writer)) => writer.begin_anew(site).map(|()| (store, writer)),
        None => Store::create_with_writer(context.path, site),
    };
    match made {
        // A link that leads nowhere is no store.
        Err(StoreError::AlreadyThere { .. } | StoreError::InUse { .. })
            if context.wait && !context.path.is_symlink() =>
        {
            Ok(None)
        }
        made => Ok(Some(made?)),
    }
}

/// Joins layers if there are many. That it can't be done is no error: what was committed counts, queries see all layers, and the
/// next change tries again.
pub(super) fn fold(
    context: &Context<'_>,
    store: &Store,
    writer: &mut Writer,
    report: &mut Report,
) -> Result<(), IngestError> {
    match fold_if_many(context, store, writer) {
        Ok(_) => Ok(()),
        Err(IngestError::Interrupted) => Err(IngestError::Interrupted),
        Err(error) => {
            report
                .notes
                .push(format!("all is stored, but the store's layers could not be joined: {}", in_full(&error)));
            Ok(())
        }
    }
}

/// A store and its writer.
pub(super) fn opened(context: &Context<'_>, store: Store) -> Result<(Store, Writer), IngestError> {
    let writer = context.writer(&store)?;
    Ok((store, writer))
}

/// What is still to be read.
struct Rest {
    sources: Vec<Source>,
    /// Of each source.
    measured: Vec<Option<WorldBounds>>,
    /// What was left out.
    unreadable: Vec<(PathBuf, IngestError)>,
    /// In another CRS than those before them, which may yet be left out.
    others: Vec<(Source, Option<WorldBounds>, IngestError)>,
}

impl Rest {
    /// Of opened sources. One whose bounds can't be found out is an error, or is left out.
    fn measured(
        context: &Context<'_>,
        opened: sources::Sources,
        keep_going: bool,
        stages: &mut Stages,
    ) -> Result<Self, IngestError> {
        let sources::Sources { sources, unreadable, .. } = opened;
        if !keep_going {
            let measured = measure::<Result<_, _>>(context, &sources, stages)?;
            return Ok(Self { sources, measured, unreadable, others: Vec::new() });
        }
        let mut rest = Self { sources: Vec::new(), measured: Vec::new(), unreadable, others: Vec::new() };
        let all: Vec<_> = measure(context, &sources, stages);
        for (source, bounds) in sources.into_iter().zip(all) {
            match bounds {
                Ok(bounds) => {
                    rest.sources.push(source);
                    rest.measured.push(bounds);
                }
                Err(error) if error.source_path().is_some() => {
                    rest.unreadable.push((source.reader.info().path.clone(), error));
                }
                Err(error) => return Err(error),
            }
        }
        Ok(rest)
    }

    /// Sets aside what is in another CRS than the site, or than what comes before it; without `keep_going` it is an error.
    fn agree(&mut self, site: Option<&Crs>, options: &IngestOptions) -> Result<(), IngestError> {
        loop {
            let said: Vec<Said> = self.sources.iter().map(Source::said).collect();
            let (path, error) = match agree_on_crs(site.cloned(), &said, options.ignore_crs) {
                Ok(_) => return Ok(()),
                Err(IngestError::OtherCrs { path, expected, found }) if options.keep_going => {
                    (path.clone(), move || IngestError::OtherCrs {
                        path: path.clone(),
                        expected: expected.clone(),
                        found: found.clone(),
                    })
                }
                Err(error) => return Err(error),
            };
            let all = std::mem::take(&mut self.sources).into_iter().zip(std::mem::take(&mut self.measured));
            for (source, measured) in all {
                if source.reader.info().path == path {
                    self.others.push((source, measured, error()));
                } else {
                    self.sources.push(source);
                    self.measured.push(measured);
                }
            }
        }
    }

    /// Takes up what was set aside.
    fn take_up_others(&mut self) {
        for (source, measured, _) in std::mem::take(&mut self.others) {
            self.sources.push(source);
            self.measured.push(measured);
        }
    }

    /// Leaves out what was set aside.
    fn give_up_others(&mut self) {
        let others = std::mem::take(&mut self.others);
        self.unreadable.extend(others.into_iter().map(|(source, _, error)| (source.reader.info().path.clone(), error)));
        self.unreadable.dedup_by(|a, b| a.0 == b.0);
    }

    fn drop_first(&mut self, sources: usize) {
        self.sources.drain(..sources);
        self.measured.drain(..sources);
    }

    /// Leaves out sources by their places, which ascend.
    fn leave_out(&mut self, places: Vec<(usize, IngestError)>) {
        for (place, error) in places.into_iter().rev() {
            self.measured.remove(place);
            let source = self.sources.remove(place);
            self.unreadable.push((source.reader.info().path.clone(), error));
        }
    }
}

/// Inputs that were left out, by their paths.
fn left_out(unreadable: &[(PathBuf, IngestError)]) -> Vec<Skipped> {
    let mut all: Vec<_> = unreadable
        .iter()
        .map(|(path, error)| Skipped { path: path.display().to_string(), reason: in_full(error), rejected: 0 })
        .collect();
    all.sort_by(|a, b| a.path.cmp(&b.path));
    all
}

/// An error with its causes.
fn in_full(error: &dyn std::error::Error) -> String {
    match error.source() {
        Some(cause) => format!("{error}: {}", in_full(cause)),
        None => error.to_string(),
    }
}

/// How many of the first sources have rows that fit the memory together; one that doesn't fit is alone.
fn first_batch(sources: &[Source], memory: u64) -> usize {
    let mut filled = 0_u64;
    let fits = |source: &&Source| {
        let info = source.reader.info();
        let bytes = info.records.saturating_mul((info.layout.payload + <u64 as RowKey>::BYTES) as u64);
        filled = filled.saturating_add(bytes);
        filled <= memory / 2
    };
    sources.iter().take_while(fits).count().max(1)
}

pub(super) fn refuse_another_lattice(options: &IngestOptions, stored: &Lattice) -> Result<(), IngestError> {
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
        geographic: source.crs.as_ref().map_or(source.reader.info().degrees, Crs::is_geographic),
    };
    sources.iter().zip(measured).map(of).collect()
}

//! Changes of a store that is there: scans out, replaced, hidden, shown; layers and free space put together.

use super::agree::{Said, agree_on_crs};
use super::batch::{Batch, add};
use super::budget::peak_memory;
use super::change::{Ground, ScanOrder};
use super::context::{Context, Resources};
use super::layers::{digest_of_all, fold_all, joined, scan_table, taken_layers, withdraw};
use super::measure::measure;
use super::progress::{Progress, Stage};
use super::report::{NamedScan, Report, Skipped, Stages};
use super::run::{fold, opened, refuse_another_lattice};
use super::sources;
use super::{IngestError, IngestOptions, bulk};
use crate::store::model::{Scan, ScanId};
use crate::store::{Digest, Flip, Store, StoreError, Temporary, WriterLock, has_empty_log};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// What [`remove`] did.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct Removed {
    /// The scans that are gone.
    pub scans: Vec<NamedScan>,
    /// Their points, of all of them.
    pub points: u64,
    /// Rows of encoded columns that were written anew.
    pub chunks_written: u64,
    /// The file's size before and after, without the log.
    pub bytes_before: u64,
    /// See `bytes_before`.
    pub bytes_after: u64,
    /// Wall time.
    pub seconds: f64,
}

/// What [`compact`] did.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct Compacted {
    /// Layers before; one is left.
    pub layers: usize,
    /// The file's size before and after, without the log.
    pub bytes_before: u64,
    /// See `bytes_before`; with a copy, the copy's.
    pub bytes_after: u64,
    /// Wall time.
    pub seconds: f64,
}

/// Takes scans out of a store, by name or number, in one commit. What is left is as if they had never been there.
///
/// # Errors
///
/// [`IngestError::NoScan`] if one of them is not there; in every case of an error nothing is removed. Without a name nothing
/// is done.
pub fn remove(
    path: &Path,
    scans: &[String],
    resources: &Resources,
    progress: &dyn Progress,
) -> Result<Removed, IngestError> {
    Context::run(path, resources, progress, |context| {
        let begun = Instant::now();
        let (store, mut writer) = opened(context, Store::open(path)?)?;
        let bytes_before = file_bytes(path);
        let snapshot = store.snapshot()?;
        let doomed = find_all(snapshot.scans(), scans)?;
        if doomed.is_empty() {
            return Ok(Removed { bytes_before, bytes_after: bytes_before, ..Removed::default() });
        }
        let gone: Vec<&Scan> = snapshot.scans().iter().filter(|s| doomed.contains(&s.id)).collect();
        let mut removed = Removed {
            scans: gone.iter().map(|s| NamedScan::new(s)).collect(),
            points: gone.iter().map(|s| s.stored).fold(0, u64::saturating_add),
            bytes_before,
            ..Removed::default()
        };
        let order = Arc::new(ScanOrder::new(snapshot.scans(), writer.attributes()));
        let table = scan_table(writer.attributes(), snapshot.scans());
        let params = bulk::params(snapshot.site());
        let ground = Ground { snapshot: &snapshot, params, scans: &order, table: &table };
        progress.stage(Stage::Build, removed.points);
        let mut edits = Vec::new();
        for layer in taken_layers(snapshot.site()) {
            edits.extend(withdraw(context, &ground, &mut writer, layer, &doomed)?);
        }
        context.go_on()?;
        removed.chunks_written = edits.iter().map(|e| e.chunks).sum();
        let flip = Flip { scans_removed: doomed, ..joined(snapshot.site(), edits) };
        drop(snapshot);
        progress.stage(Stage::Commit, removed.points);
        context.unless_cancelled(|stop| writer.commit_unless(flip, stop))?;
        removed.bytes_after = file_bytes(path);
        removed.seconds = begun.elapsed().as_secs_f64();
        Ok(removed)
    })
}

/// Puts the scans of one input in the place of a scan, in one commit. The new scan has the old one's name, unless the
/// options give one. Of an input that has a scan of the old one's name among others, that one is taken. `input`: the old
/// scan's source, read again, if none is given. Nothing is left out of it, whatever
/// `keep_going` says.
///
/// # Errors
///
/// [`IngestError`]; the store is then as it was.
pub fn replace(
    path: &Path,
    scan: &str,
    input: Option<&Path>,
    options: &IngestOptions,
    progress: &dyn Progress,
) -> Result<Report, IngestError> {
    // What takes a scan's place is not left out.
    let options = &IngestOptions { keep_going: false, ..options.clone() };
    Context::run(path, &options.resources, progress, |context| {
        let begun = Instant::now();
        let mut stages = Stages::default();
        let (store, mut writer) = opened(context, Store::open(path)?)?;
        let snapshot = store.snapshot()?;
        let replaced = find_all(snapshot.scans(), &[scan.to_owned()])?;
        let (old, others): (Vec<Scan>, Vec<Scan>) =
            snapshot.scans().iter().cloned().partition(|s| replaced.contains(&s.id));
        refuse_another_lattice(options, &snapshot.site().lattice)?;
        let (site_crs, lattice) = (snapshot.site().crs.clone(), snapshot.site().lattice.clone());
        drop(snapshot);
        let stored = sources::Stored { scans: &others, lattice: Some(&lattice) };
        let opened = match (input, old.first()) {
            (Some(input), Some(old)) => {
                let input = sources::Inputs::InPlaceOf(&old.name, &input.to_owned());
                sources::open(&input, options, stored, progress)?
            }
            (None, Some(old)) => {
                let again = sources::open_again(old, options, progress)?;
                sources::Sources { sources: vec![again], ..sources::Sources::default() }
            }
            (_, None) => return Err(IngestError::Internal("a scan without a row".into())),
        };
        let mut sources = opened.sources;
        if let ([source], Some(old), None) = (&mut sources[..], old.first(), &options.name) {
            source.name = old.name.clone();
        }
        if let (true, Some(skipped)) = (sources.is_empty(), opened.skipped.first()) {
            let Skipped { path: input, reason, .. } = skipped.clone();
            return Err(IngestError::NotReplaced { scan: scan.to_owned(), input, reason });
        }
        if let Some(taken) = sources.iter().find(|s| others.iter().any(|other| other.name == s.name)) {
            return Err(IngestError::NameTaken(taken.name.clone()));
        }
        let mut report = Report { skipped: opened.skipped, ..Report::default() };
        let said: Vec<Said> = sources.iter().map(sources::Source::said).collect();
        let (crs, notes) = agree_on_crs(site_crs, &said, options.ignore_crs)?;
        report.notes.extend(notes);
        let measured = measure::<Result<Vec<_>, _>>(context, &sources, &mut stages)?;
        let (sources, measured) = (&sources[..], &measured[..]);
        let visible = old.iter().all(|scan| scan.visible);
        let strict = options.strict;
        let batch = Batch { sources, measured, crs, replaced: &replaced, visible, strict, keep_going: false };
        add(context, &store, &mut writer, &batch, &mut stages, &mut report)?;
        fold(context, &store, &mut writer, &mut report)?;
        report.seconds = begun.elapsed().as_secs_f64();
        report.points_per_second = if report.seconds > 0.0 { report.points as f64 / report.seconds } else { 0.0 };
        report.peak_memory_bytes = peak_memory();
        report.stages = stages.into_reports();
        Ok(report)
    })
}

/// Shows or hides scans, by name or number: hidden ones are left out of queries and pictures unless asked for by name.
/// No point is touched. Gives the names of those that were not so before.
///
/// # Errors
///
/// [`IngestError::NoScan`] if one of them is not there.
pub fn set_visible(
    path: &Path,
    scans: &[String],
    visible: bool,
    resources: &Resources,
    progress: &dyn Progress,
) -> Result<Vec<String>, IngestError> {
    Context::run(path, resources, progress, |context| {
        let (store, mut writer) = opened(context, Store::open(path)?)?;
        let snapshot = store.snapshot()?;
        let found = find_all(snapshot.scans(), scans)?;
        let changes = |scan: &&Scan| found.contains(&scan.id) && scan.visible != visible;
        let changed: Vec<Scan> =
            snapshot.scans().iter().filter(changes).map(|scan| Scan { visible, ..scan.clone() }).collect();
        drop(snapshot);
        let names = changed.iter().map(|s| s.name.clone()).collect();
        if !changed.is_empty() {
            let flip = Flip { scans_changed: changed, ..Flip::default() };
            context.unless_cancelled(|stop| writer.commit_unless(flip, stop))?;
        }
        Ok(names)
    })
}

/// Makes one layer of all and gives free space back to the file system; with `copy`, a compact copy is written there and
/// the store stays as it is.
///
/// # Errors
///
/// [`IngestError`]; the store's content is the same in every case.
pub fn compact(
    path: &Path,
    copy: Option<&Path>,
    resources: &Resources,
    progress: &dyn Progress,
) -> Result<Compacted, IngestError> {
    let Some(copy) = copy else {
        return Context::run(path, resources, progress, |context| {
            let begun = Instant::now();
            let (store, mut writer) = opened(context, Store::open(path)?)?;
            let bytes_before = file_bytes(path);
            let layers = taken_layers(store.snapshot()?.site()).count();
            fold_all(context, &store, &mut writer)?;
            context.unless_cancelled(|stop| writer.compact(stop))?;
            let bytes_after = file_bytes(path);
            Ok(Compacted { layers, bytes_before, bytes_after, seconds: begun.elapsed().as_secs_f64() })
        });
    };
    let free = || if copy.exists() { Err(IngestError::OutputThere(copy.to_owned())) } else { Ok(()) };
    free()?;
    // Held until the copy has its name: another one of that name would be written into the same file.
    let _alone = Context::run(copy, resources, progress, |context| context.when_free(|| WriterLock::take(copy)))?;
    free()?;
    // Under another name until it is whole.
    let unfinished = Temporary::Copy.path(copy, 0);
    // What runs that were cut off have left.
    Temporary::Copy.there(copy).unwrap_or_default().iter().for_each(|left| remove_copy(left));
    let bytes_before = file_bytes(path);
    let copied = Context::run(path, resources, progress, |context| {
        let store = Store::open(path)?;
        // So that nobody writes meanwhile. Who may only read the store may copy it all the same.
        let _writer = match context.writer(&store) {
            Err(IngestError::Store(StoreError::ReadOnly { .. })) => None,
            writer => Some(writer?),
        };
        context.unless_cancelled(|stop| store.copy_to(&unfinished, stop))?;
        Ok(())
    })
    .and_then(|()| compact(&unfinished, None, resources, progress));
    match copied {
        Ok(compacted) => {
            named(&unfinished, copy)?;
            Ok(Compacted { bytes_before, ..compacted })
        }
        Err(error) => {
            remove_copy(&unfinished);
            Err(match error {
                IngestError::Store(StoreError::Full { path }) if path == unfinished => {
                    StoreError::Full { path: copy.into() }.into()
                }
                error => error,
            })
        }
    }
}

/// Gives a copy its name if all of it is in its file: a log beside it would be left behind, with the last of its content.
/// Otherwise the copy is taken away.
fn named(unfinished: &Path, copy: &Path) -> Result<(), IngestError> {
    let named = if has_empty_log(unfinished) {
        std::fs::rename(unfinished, copy)
    } else {
        Err(std::io::Error::other("its log was not written back; something else has it open, or its disk fails"))
    };
    named.map_err(|source| {
        remove_copy(unfinished);
        IngestError::Copy { path: copy.to_owned(), source }
    })
}

/// Takes away a copy that nobody else knows of.
fn remove_copy(path: &Path) {
    for suffix in ["", "-wal", "-shm", "-journal", "-lock"] {
        let mut name = path.as_os_str().to_owned();
        name.push(suffix);
        // What can't be removed ends the next copy with an error.
        let _ = std::fs::remove_file(PathBuf::from(name));
    }
}

/// The two hashes of a store, with layers as with one: those of what compacting it would give.
///
/// # Errors
///
/// [`IngestError::Store`] if anything can't be read.
pub fn digest(path: &Path, resources: &Resources, progress: &dyn Progress) -> Result<Digest, IngestError> {
    Context::run(path, resources, progress, |context| {
        let snapshot = Store::open(path)?.snapshot()?;
        if taken_layers(snapshot.site()).count() < 2 {
            let points = snapshot.scans().iter().map(|s| s.stored).fold(0, u64::saturating_add);
            progress.stage(Stage::Read, points);
            let go_on = |points| {
                progress.advance(points);
                !progress.cancelled()
            };
            return crate::store::digest(&snapshot, &go_on)?.ok_or(IngestError::Interrupted);
        }
        digest_of_all(context, &snapshot)
    })
}

fn file_bytes(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |m| m.len())
}

/// The numbers of scans given by name or number, ascending.
fn find_all(scans: &[Scan], wanted: &[String]) -> Result<Vec<ScanId>, IngestError> {
    let mut found = wanted.iter().map(|w| find(scans, w)).collect::<Result<Vec<_>, _>>()?;
    found.sort_unstable();
    found.dedup();
    Ok(found)
}

pub(super) fn find(scans: &[Scan], wanted: &str) -> Result<ScanId, IngestError> {
    // A name goes before a number: a scan may be called '7'.
    let named = scans.iter().find(|s| s.name == wanted);
    let numbered = || wanted.parse::<ScanId>().ok().and_then(|id| scans.iter().find(|s| s.id == id));
    if let Some(scan) = named.or_else(numbered) {
        return Ok(scan.id);
    }
    let alike = scans.iter().find(|s| s.name.eq_ignore_ascii_case(wanted) || s.name.starts_with(wanted));
    let nearest = alike.map_or(String::new(), |s| format!(" (did you mean '{}'?)", s.name));
    Err(IngestError::NoScan { wanted: wanted.to_owned(), nearest })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::Lattice;
    use crate::store::SiteOptions;

    /// The file was given its name without what was still in its log.
    #[test]
    fn a_copy_whose_log_is_not_written_back_is_an_error_and_not_a_store() {
        let folder = tempfile::tempdir().unwrap();
        let [unfinished, copy] = ["unfinished.esker", "copy.esker"].map(|name| folder.path().join(name));
        let store = Store::create(&unfinished, SiteOptions::new(Lattice::uniform(0.01).unwrap())).unwrap();
        let mut writer = store.writer().unwrap();
        writer.commit(Flip::default()).unwrap();
        let reader = rusqlite::Connection::open(&unfinished).unwrap();
        reader.execute_batch("BEGIN").unwrap();
        reader.query_row("SELECT count(*) FROM sqlite_schema", [], |_| Ok(())).unwrap();
        writer.commit(Flip::default()).unwrap();
        drop((writer, store));
        let error = named(&unfinished, &copy).unwrap_err().to_string();
        assert!(error.contains("copy.esker") && error.contains("its log was not written back"), "{error}");
        assert!(!copy.exists() && !unfinished.exists());
        drop(reader);
        std::fs::write(&unfinished, "whole").unwrap();
        named(&unfinished, &copy).unwrap();
        assert!(copy.exists() && !unfinished.exists());
    }
}

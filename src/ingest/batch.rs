//! Some sources to scans of the store, in one commit.

use super::IngestError;
use super::bulk::{LEAST_SHARE, Layer, Room, params};
use super::change::{Edit, Ground, NewPoints, ScanOrder, change, point_bytes};
use super::context::Context;
use super::error::Stopped;
use super::gather::ScanColumns;
use super::layers::{MOST_INSERTED, Target, joined, scan_table, taken_layers, target, withdraw};
use super::measure::{WorldBounds, hinted_bounds};
use super::partition::{Bucket, RowPlan, ScanTally};
use super::progress::Stage;
use super::reading::{Read, Reading};
use super::report::{Report, ScanReport, Stages};
use super::sources::Source;
use super::writing::Written;
use crate::lattice::{Cube, Exactness, Key, Lattice, SourceMap};
use crate::points::{Attribute, Crs, ScalarType};
use crate::store::model::{Scan, ScanId};
use crate::store::{Flip, Snapshot, Store, Writer};
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

/// Pieces of fewer records are not worth another thread's while.
const LEAST_PIECE: u64 = 1 << 12;

/// What is to be done.
pub(super) struct Batch<'a> {
    pub sources: &'a [Source],
    /// World bounds of each source, where they are known.
    pub measured: &'a [Option<WorldBounds>],
    /// The site's CRS from now on.
    pub crs: Option<Crs>,
    /// Scans that go in the same commit, ascending.
    pub replaced: &'a [ScanId],
    /// Are the new scans shown?
    pub visible: bool,
    pub strict: bool,
    pub keep_going: bool,
}

/// The errors of sources, in their order.
fn refuse(errors: impl Iterator<Item = Option<IngestError>>) -> Result<(), Stopped> {
    let errors: Vec<_> = errors.enumerate().filter_map(|(i, error)| Some((i, error?))).collect();
    if errors.is_empty() { Ok(()) } else { Err(Stopped::Unreadable(errors)) }
}

/// Reads the sources and commits them.
///
/// # Errors
///
/// [`Stopped`]; nothing was committed.
pub(super) fn add(
    context: &Context<'_>,
    store: &Store,
    writer: &mut Writer,
    batch: &Batch<'_>,
    stages: &mut Stages,
    report: &mut Report,
) -> Result<(), Stopped> {
    // The lock is held: what the snapshot says stays true.
    let snapshot = store.snapshot()?;
    let site = snapshot.site().clone();
    let lattice = &site.lattice;
    let sources = batch.sources;
    let plans = plans(sources, lattice)?;

    // What headers announce, which may be any number: too many is what does not fit, not a small number.
    let infos = || sources.iter().map(|s| s.reader.info());
    let records = infos().map(|info| info.records).fold(0, u64::saturating_add);
    let payload = infos().map(|info| info.records.saturating_mul(info.layout.payload as u64));
    let payload = payload.fold(0, u64::saturating_add);
    let hint = hinted_bounds(lattice, sources, batch.measured);
    let mut room = Room::new(context, site.g, hint, records, payload, payload / LEAST_SHARE)?;
    // Something for every thread, also of a small file.
    let pieces = 2 * context.threads.max(1) as u64;
    room.budget.piece_records = room.budget.piece_records.min(records.div_ceil(pieces)).max(LEAST_PIECE);
    report.temp_bytes_predicted = report.temp_bytes_predicted.max(room.budget.temp_bytes);
    let (read, buckets) = {
        let partition = room.partition(lattice);
        let Batch { strict, keep_going, .. } = *batch;
        let (threads, progress) = (context.threads, context.progress);
        let reading = Reading { plans: &plans, sources, threads, strict, keep_going, progress };
        context.progress.stage(Stage::Read, records);
        let read = stages.time(Stage::Read, records, || {
            if room.wide {
                reading.read::<Key>(&partition, &room.budget)
            } else {
                reading.read::<u64>(&partition, &room.budget)
            }
        })?;
        (read, partition.finish())
    };
    report.temp_bytes = report.temp_bytes.max(room.temp_bytes());
    refuse_if_nothing_is_there(sources, &read.tallies)?;
    refuse_if_all_are_outside(sources, &read.tallies, lattice)?;

    let scans = scan_rows(writer, batch, &read, &plans)?;
    let new_points = read.tallies.iter().map(|t| t.stored).sum();
    context.progress.stage(Stage::Build, new_points);
    let new = NewScans { plans: &plans, scans: &scans };
    let edits =
        stages.time(Stage::Build, new_points, || build(context, snapshot, writer, batch, &new, &room, buckets))?;
    context.go_on()?;
    report.chunks_written += edits.iter().map(|e| e.chunks).sum::<u64>();

    context.progress.stage(Stage::Commit, new_points);
    let scans_removed = batch.replaced.to_vec();
    let flip = Flip { crs: batch.crs.clone(), scans_removed, ..joined(&site, edits) };
    let told: Vec<_> = sources
        .iter()
        .zip(&read.tallies)
        .zip(&scans)
        .map(|((s, tally), scan)| scan_report(s, tally, scan, &site.lattice))
        .collect();
    let flip = Flip { scans_added: scans, ..flip };
    stages.time(Stage::Commit, new_points, || context.unless_cancelled(|stop| writer.commit_unless(flip, stop)))?;
    // Not before: a report without scans says that nothing was committed.
    report.scans.extend(told);
    report.points += new_points;
    Ok(())
}

fn plans(sources: &[Source], lattice: &Lattice) -> Result<Vec<RowPlan>, Stopped> {
    let (mut plans, mut refused) = (Vec::new(), Vec::new());
    for (slot, source) in (0..).zip(sources) {
        let info = source.reader.info();
        let map = info.grid.as_ref().map(|grid| SourceMap::new(grid, lattice));
        refused.push(map.as_ref().is_some_and(Option::is_none).then(|| IngestError::Grid(info.path.clone())));
        plans.push(RowPlan::new(slot, info.layout.clone(), map.flatten()));
    }
    refuse(refused.into_iter())?;
    Ok(plans)
}

struct NewScans<'a> {
    plans: &'a [RowPlan],
    scans: &'a [Scan],
}

impl NewScans<'_> {
    /// By slot.
    fn columns(&self) -> Vec<ScanColumns<'_>> {
        let scans = self.scans.iter().zip(self.plans);
        scans.map(|(s, plan)| ScanColumns::new(s.id, s.identity, plan, s.attributes.clone())).collect()
    }
}

/// Puts the new points where they belong, and takes those of replaced scans away.
fn build(
    context: &Context<'_>,
    snapshot: Snapshot,
    writer: &mut Writer,
    batch: &Batch<'_>,
    new: &NewScans<'_>,
    room: &Room,
    buckets: Vec<Bucket>,
) -> Result<Vec<Edit>, IngestError> {
    let site = snapshot.site();
    let order = Arc::new(ScanOrder::new(snapshot.scans().iter().chain(new.scans), writer.attributes()));
    let table = scan_table(writer.attributes(), snapshot.scans().iter().chain(new.scans));
    let ground = Ground { snapshot: &snapshot, params: params(site), scans: &order, table: &table };
    let rows: u64 = buckets.iter().map(|b| b.rows).sum();
    let fits = rows <= MOST_INSERTED && rows.saturating_mul(point_bytes(writer.attributes())) <= context.memory;
    let small = room.is_memory() && fits;
    let columns = new.columns();

    let mut edits = Vec::new();
    if small && taken_layers(site).next().is_some() {
        let new_points = if room.wide {
            NewPoints::of::<Key>(&buckets, &columns, &order)?
        } else {
            NewPoints::of::<u64>(&buckets, &columns, &order)?
        };
        let mut points = new_points.points();
        if let Target::Existing(into) = target(context, &snapshot, writer.attributes(), Some(&points))? {
            drop(buckets);
            for layer in taken_layers(site) {
                if layer == into {
                    let points = std::mem::take(&mut points);
                    edits.push(change(&ground, writer, layer, batch.replaced, points, context.progress)?);
                } else {
                    edits.extend(withdraw(context, &ground, writer, layer, batch.replaced)?);
                }
            }
            return Ok(edits);
        }
    }
    for layer in taken_layers(site) {
        edits.extend(withdraw(context, &ground, writer, layer, batch.replaced)?);
    }
    let bounds = new.scans.iter().filter_map(|s| s.bounds).reduce(|a, b| a.union(&b));
    if let (Some(bounds), Target::New(into)) = (bounds, target(context, &snapshot, writer.attributes(), None)?) {
        let params = params(site);
        let root = Cube::spanning(bounds.min, bounds.max, site.g);
        // A snapshot that is held keeps the log from being used again while it grows by the whole layer.
        drop(snapshot);
        let layer = Layer { layer: into, params, root, scans: &columns, table: &table };
        let written = room.write(context, writer, &layer, buckets)?;
        let Written { nodes: put, chunks } = written;
        edits.push(Edit { layer: into, root: Some(root), put, chunks, ..Edit::default() });
    }
    Ok(edits)
}

/// The rows of `scan` for the sources.
fn scan_rows(
    writer: &mut Writer,
    batch: &Batch<'_>,
    Read { tallies, contents }: &Read,
    plans: &[RowPlan],
) -> Result<Vec<Scan>, IngestError> {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs() as i64);
    let mut scans = Vec::new();
    for (((source, tally), content), plan) in batch.sources.iter().zip(tallies).zip(contents).zip(plans) {
        let info = source.reader.info();
        let attributes = writer.add_attributes(&plan.layout.attributes)?;
        let exactness = match &plan.map {
            Some(map) => map.exactness(),
            None if tally.largest_error == 0.0 => Exactness::Exact,
            None => Exactness::Rounded,
        };
        let is_8_bit = |name: &str| plan.layout.attributes.iter().any(|a| a.name == name && a.ty == ScalarType::U8);
        scans.push(Scan {
            id: writer.reserve_scan(),
            name: source.name.clone(),
            // Wherever `replace` is run, it means this file.
            source: match info.format {
                "table" => String::new(),
                _ => std::path::absolute(&info.path).unwrap_or_else(|_| info.path.clone()).display().to_string(),
            },
            source_bytes: source.bytes,
            identity: source.identity(content),
            time: now,
            pose: source.pose(),
            read: tally.read + tally.rejected.truncated,
            stored: tally.stored,
            rejected: tally.rejected,
            bounds: tally.bounds,
            exactness,
            largest_error: tally.largest_error,
            format: info.format.to_owned(),
            las: info.las.clone(),
            color_depth: color_depth(&plan.layout.attributes, tally.color_bits, is_8_bit("Red")),
            visible: batch.visible,
            attributes,
            crs: source.crs.clone(),
        });
    }
    Ok(scans)
}

/// Refuses sources that announce records and have no whole one.
fn refuse_if_nothing_is_there(sources: &[Source], tallies: &[ScanTally]) -> Result<(), Stopped> {
    let refused = |(source, tally): (&Source, &ScanTally)| {
        let missing = tally.rejected.truncated;
        let path = source.reader.info().path.clone();
        // Beside others in its file it is one that has no points.
        let is_alone = !source.is_of_several();
        (is_alone && missing > 0 && tally.read == 0).then_some(IngestError::Nothing { path, missing })
    };
    refuse(sources.iter().zip(tallies).map(refused))
}

/// Refuses sources of which no point is in the lattice.
fn refuse_if_all_are_outside(sources: &[Source], tallies: &[ScanTally], lattice: &Lattice) -> Result<(), Stopped> {
    let refused = |(source, tally): (&Source, &ScanTally)| {
        let out = tally.rejected.out_of_range;
        let path = source.reader.info().path.clone();
        (out > 0 && tally.stored == 0 && out == tally.read).then(|| IngestError::OutOfRange {
            path,
            points: out,
            range: range_of(lattice),
        })
    };
    refuse(sources.iter().zip(tallies).map(refused))
}

/// The range of the lattice in words.
fn range_of(lattice: &Lattice) -> String {
    let last = (1 << crate::lattice::BITS) - 1;
    format!("{:e} to {:e} in x", lattice.world_on_axis(0, 0), lattice.world_on_axis(0, last))
}

fn color_depth(attributes: &[Attribute], bits: u16, is_8_bit: bool) -> Option<u8> {
    attributes.iter().find(|a| a.name == "Red")?;
    match bits {
        _ if is_8_bit => Some(8),
        // All black, as files have them that have no colours: of no depth.
        0 => None,
        1..=255 => Some(8),
        _ => Some(16),
    }
}

/// Says so where a source's floats of 32 bits are far coarser than the lattice: they were rounded by whoever wrote them.
fn coarse_floats(source: &Source, scan: &Scan, lattice: &Lattice) -> Option<String> {
    let info = source.reader.info();
    // In a scan's own frame coordinates are small, or are not known here.
    let bounds = scan.bounds.filter(|_| info.is_single && info.pose.is_identity())?;
    let (min, max) = (lattice.world_from_lattice(bounds.min), lattice.world_from_lattice(bounds.max));
    let farthest = min.iter().chain(&max).fold(0.0_f64, |a, v| a.max(v.abs())) as f32;
    let step = f64::from(farthest.next_up()) - f64::from(farthest);
    (step > 8.0 * lattice.largest_quantum()).then(|| {
        let step = format!("{step:.1e}").parse::<f64>().unwrap_or(step);
        format!(
            "its coordinates are 32-bit floats, up to {step} apart here: digits were lost before; write doubles, or points about a \
             local origin"
        )
    })
}

fn scan_report(source: &Source, tally: &ScanTally, scan: &Scan, lattice: &Lattice) -> ScanReport {
    let mut warnings = source.warnings.clone();
    warnings.extend(source.reader.found_while_reading());
    warnings.extend(coarse_floats(source, scan, lattice));
    // What was missing at once has its warning.
    let lost = tally.rejected.truncated.saturating_sub(source.reader.info().missing);
    if lost > 0 {
        warnings.push(format!(
            "the file ends before all is read, or was cut meanwhile: {lost} of its records are not there"
        ));
    }
    if tally.rejected.out_of_range > 0 {
        warnings.push(format!(
            "outside the lattice, where a store with a coarser --quantum has room: {} of the points",
            tally.rejected.out_of_range
        ));
    }
    if tally.rejected.not_finite > 0 {
        warnings.push(format!(
            "without a valid position (a coordinate is NaN or infinite, or the scanner marked it so): {} of the points",
            tally.rejected.not_finite
        ));
    }
    ScanReport {
        name: scan.name.clone(),
        source: scan.source.clone(),
        read: scan.read,
        stored: scan.stored,
        rejected: scan.rejected.total(),
        rejected_not_finite: scan.rejected.not_finite,
        rejected_out_of_range: scan.rejected.out_of_range,
        rejected_truncated: scan.rejected.truncated,
        positions: scan.exactness.word(),
        max_error: scan.largest_error,
        warnings,
    }
}

//! One ingest from beginning to end.

use super::budget::{Budget, check_disk, default_memory, default_threads, peak_memory};
use super::build::{Plan, build};
use super::existing::Existing;
use super::gather::ScanColumns;
use super::identity::IDENTITY_POSE;
use super::lattice_choice::{Evidence, choose};
use super::partition::{Bucket, Partition, RowPlan, ScanTally, bucket_exponent};
use super::progress::{Progress, Stage};
use super::reading::{Read, Reading};
use super::report::{Report, ScanReport, StageReport};
use super::rows::RowKey;
use super::sources::{self, Source};
use super::spill::Spill;
use super::subtrees::with_subtrees;
use super::{IngestError, IngestOptions};
use crate::formats::FormatError;
use crate::lattice::{Cube, Exactness, Key, Lattice, LatticeBox, SourceMap};
use crate::octree::Params;
use crate::points::{Attribute, Crs, PositionKind, ScalarType};
use crate::store::model::{NodeHead, Scan, Zones};
use crate::store::{ChunkIds, EncodedNode, Flip, NodeChange, ScanTable, SiteOptions, Store, Writer};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::mpsc::sync_channel;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// Puts `inputs` into the store at `path`, which is created if it is not there.
///
/// Sources that the store has already are skipped. All others become scans in one commit; if anything fails before, the
/// store stays as it was.
///
/// # Errors
///
/// [`IngestError`], in whose every case nothing was added.
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
    let started = Instant::now();
    let threads = options.threads.unwrap_or_else(default_threads).max(1);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| IngestError::Threads(e.to_string()))?;
    pool.install(|| Run { path, inputs, options, progress, threads, started, stages: Vec::new() }.run())
}

struct Run<'a> {
    path: &'a Path,
    inputs: &'a [PathBuf],
    options: &'a IngestOptions,
    progress: &'a dyn Progress,
    threads: usize,
    started: Instant,
    stages: Vec<StageReport>,
}

impl Run<'_> {
    fn run(mut self) -> Result<Report, IngestError> {
        let store = if self.path.exists() { Some(Store::open(self.path)?) } else { None };
        if let Some(store) = &store {
            self.refuse_another_lattice(&store.snapshot()?.site().lattice)?;
        }
        let stored = match &store {
            Some(store) => store.snapshot()?.scans().to_vec(),
            None => Vec::new(),
        };
        let opened = sources::open(self.inputs, self.options, &stored, self.progress)?;
        let (sources, skipped) = (opened.sources, opened.skipped);
        let mut report = Report { skipped, ..Report::default() };
        if sources.is_empty() {
            report.seconds = self.started.elapsed().as_secs_f64();
            return Ok(report);
        }
        let site_crs = match &store {
            Some(store) => store.snapshot()?.site().crs.clone(),
            None => None,
        };
        let (crs, notes) = sources::agree_on_crs(site_crs, &sources, self.options.ignore_crs)?;
        report.notes.extend(notes);

        let measured = self.measure(&sources, store.is_none())?;
        let created = store.is_none();
        let store = match store {
            Some(store) => store,
            None => {
                let (lattice, notes) = choose(&evidence(&sources, &measured), &self.options.lattice)?;
                report.notes.extend(notes);
                Store::create(
                    self.path,
                    SiteOptions {
                        lattice,
                        g: self.options.g,
                        leaf_capacity: self.options.leaf_capacity,
                        crs: crs.clone(),
                    },
                )?
            }
        };
        let result = self.fill(&store, sources, &measured, crs, &mut report);
        if result.is_err() && created {
            // Nothing was there before and nothing was added: leave no empty store behind.
            drop(store);
            remove_store(self.path);
        }
        result?;
        report.seconds = self.started.elapsed().as_secs_f64();
        report.points_per_second = if report.seconds > 0.0 { report.points as f64 / report.seconds } else { 0.0 };
        report.peak_memory_bytes = peak_memory();
        report.stages = self.stages;
        Ok(report)
    }

    fn refuse_another_lattice(&self, stored: &Lattice) -> Result<(), IngestError> {
        let wish = &self.options.lattice;
        let same = wish.quantum.is_none_or(|q| q == stored.quantum_f64())
            && wish.phase.is_none_or(|p| p == stored.phase().map(crate::lattice::Decimal::to_f64));
        if same {
            return Ok(());
        }
        Err(IngestError::LatticeFixed {
            stored: stored.quantum_f64().map(|q| q.to_string()).join(" x "),
            phase: stored.phase().map(|p| p.to_string()).join(" x "),
        })
    }

    /// World bounds of the sources whose header doesn't say them, by reading their positions.
    fn measure(&mut self, sources: &[Source], needed: bool) -> Result<Vec<Option<WorldBounds>>, IngestError> {
        let lacking = |s: &Source| {
            let info = s.reader.info();
            info.bounds_hint.is_none() && info.layout.position == PositionKind::World
        };
        let total = sources.iter().filter(|s| lacking(s)).map(|s| s.reader.info().records).sum();
        if total == 0 || !needed && sources.iter().all(|s| !lacking(s)) {
            return Ok(sources.iter().map(|s| s.reader.info().bounds_hint).collect());
        }
        let begun = Instant::now();
        self.progress.stage(Stage::Measure, total);
        let bounds = sources
            .iter()
            .map(|source| if lacking(source) { self.bounds_of(source) } else { Ok(source.reader.info().bounds_hint) })
            .collect();
        self.note_stage(Stage::Measure, begun, total);
        bounds
    }

    fn bounds_of(&self, source: &Source) -> Result<Option<WorldBounds>, IngestError> {
        let stride = source.reader.info().layout.stride();
        let pieces = source.reader.pieces(1 << 18);
        let parts: Vec<_> = pieces
            .into_par_iter()
            .map(|piece| {
                let mut bounds: Option<WorldBounds> = None;
                source.reader.read(piece, &mut |records| {
                    for record in records.chunks_exact(stride) {
                        let world = world_position(record);
                        if world.iter().all(|v| v.is_finite()) {
                            bounds = Some(widen(bounds, (world, world)));
                        }
                    }
                    self.progress.advance((records.len() / stride) as u64);
                    !self.progress.cancelled()
                })?;
                Ok::<_, FormatError>(bounds)
            })
            .collect::<Result<_, _>>()?;
        if self.progress.cancelled() {
            return Err(IngestError::Interrupted);
        }
        Ok(parts.into_iter().flatten().reduce(|a, b| widen(Some(a), b)))
    }

    fn note_stage(&mut self, stage: Stage, begun: Instant, points: u64) {
        let seconds = begun.elapsed().as_secs_f64();
        let ns_per_point = if points > 0 { seconds * 1e9 / points as f64 } else { 0.0 };
        self.stages.push(StageReport { stage: stage.word(), seconds, ns_per_point });
    }

    fn fill(
        &mut self,
        store: &Store,
        sources: Vec<Source>,
        measured: &[Option<WorldBounds>],
        crs: Option<Crs>,
        report: &mut Report,
    ) -> Result<(), IngestError> {
        let mut writer = store.writer()?;
        // The lock is held from here on: what the snapshot says stays true.
        let snapshot = store.snapshot()?;
        let site = snapshot.site().clone();
        let lattice = &site.lattice;
        let existing = Existing::new(self.path, &snapshot)?;

        let mut plans: Vec<RowPlan> = existing.row_plans();
        let first_new = plans.len();
        for source in &sources {
            let info = source.reader.info();
            let map = match &info.grid {
                Some(grid) => Some(SourceMap::new(grid, lattice).ok_or_else(|| IngestError::Grid(info.path.clone()))?),
                None => None,
            };
            plans.push(RowPlan::new(plans.len() as u32, info.layout.clone(), map));
        }

        let key_bytes = |wide: bool| if wide { <Key as RowKey>::BYTES } else { <u64 as RowKey>::BYTES } as u64;
        let hint = hinted_bounds(lattice, &sources, measured, existing.bounds());
        let rows: u64 = existing.points() + sources.iter().map(|s| s.reader.info().records).sum::<u64>();
        let payload_bytes: u64 = existing.payload_bytes(&plans)
            + sources.iter().map(|s| s.reader.info().records * s.reader.info().layout.payload as u64).sum::<u64>();
        let memory = self.options.memory_bytes.unwrap_or_else(default_memory);
        let wide = hint.is_some_and(|h| bucket_exponent(&h, 1).1);
        let budget = Budget::new(memory, rows, rows * key_bytes(wide) + payload_bytes, self.threads);
        let k = hint.map_or(0, |h| bucket_exponent(&h, budget.buckets).0).max(site.g);
        let store_bytes = sources.iter().map(|s| s.reader.info().records * s.reader.info().layout.stride() as u64 / 2);
        check_disk(self.path, store_bytes.sum(), budget.temp_bytes)?;
        report.temp_bytes_predicted = budget.temp_bytes;
        if budget.temp_bytes > 0 {
            self.progress.say(&format!(
                "{rows} points don't fit {} MiB of memory; a temporary file of {} MiB will be used",
                memory >> 20,
                budget.temp_bytes.div_ceil(1 << 20)
            ));
        }
        let spill = if budget.temp_bytes > 0 { Some(Spill::create(self.path)?) } else { None };

        let reading = Reading {
            plans: &plans,
            first_new,
            sources: &sources,
            existing: &existing,
            threads: self.threads,
            strict: self.options.strict,
            progress: self.progress,
        };
        let partition = Partition::new(lattice, spill.as_ref(), k, wide);
        let begun = Instant::now();
        self.progress.stage(Stage::Read, rows);
        let read =
            if wide { reading.read::<Key>(&partition, &budget) } else { reading.read::<u64>(&partition, &budget) };
        let Read { tallies, contents } = read?;
        self.note_stage(Stage::Read, begun, rows);
        let buckets = partition.finish();
        report.temp_bytes = spill.as_ref().map_or(0, Spill::bytes);

        for (source, tally) in sources.iter().zip(&tallies) {
            let out = tally.rejected.out_of_range;
            if out > 0 && tally.stored == 0 && out == tally.read {
                return Err(IngestError::OutOfRange {
                    path: source.reader.info().path.clone(),
                    points: out,
                    range: range_of(lattice),
                });
            }
        }
        let scans = self.scans(&mut writer, &sources, &tallies, &contents, &plans[first_new..])?;

        let bounds = buckets_bounds(existing.bounds(), &tallies);
        let stored = existing.points() + tallies.iter().map(|t| t.stored).sum::<u64>();
        let stored_scans = snapshot.scans().to_vec();
        let mut columns: Vec<ScanColumns<'_>> = existing.scan_columns(&plans);
        // A snapshot that is held keeps the log from being written back while it grows.
        drop(existing);
        drop(snapshot);
        for (scan, plan) in scans.iter().zip(&plans[first_new..]) {
            columns.push(ScanColumns::new(scan.id, scan.identity, plan, scan.attributes.clone()));
        }
        let begun = Instant::now();
        self.progress.stage(Stage::Build, stored);
        let root = bounds.map(|b| Cube::spanning(b.min, b.max, site.g));
        let nodes = match root {
            Some(root) => {
                let params = Params { g: site.g, leaf_capacity: site.leaf_capacity };
                let mut table = ScanTable::new(writer.attributes());
                for scan in stored_scans.iter().chain(&scans) {
                    table.insert(scan.id, &scan.attributes, scan.color_depth);
                }
                let (ids, spill) = (writer.chunk_ids(), spill.as_ref());
                let job = BuildJob { params, root, columns: &columns, table, ids, spill, budget: &budget, wide };
                self.build(&mut writer, &job, buckets)?
            }
            None => Vec::new(),
        };
        drop(spill);
        self.note_stage(Stage::Build, begun, stored);
        if self.progress.cancelled() {
            return Err(IngestError::Interrupted);
        }

        let begun = Instant::now();
        self.progress.stage(Stage::Commit, stored);
        let nodes = with_subtrees(nodes);
        for ((source, tally), scan) in sources.iter().zip(&tallies).zip(&scans) {
            report.scans.push(scan_report(source, tally, scan));
        }
        report.points = tallies.iter().map(|t| t.stored).sum();
        writer.commit(Flip {
            scans_added: scans,
            crs,
            roots: Some(vec![root]),
            nodes: NodeChange::ReplaceAll(nodes),
            ..Flip::default()
        })?;
        self.note_stage(Stage::Commit, begun, stored);
        Ok(())
    }

    /// The rows of `scan` for the new sources.
    fn scans(
        &self,
        writer: &mut Writer,
        sources: &[Source],
        tallies: &[ScanTally],
        contents: &[[u8; 32]],
        plans: &[RowPlan],
    ) -> Result<Vec<Scan>, IngestError> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs() as i64);
        let mut scans = Vec::new();
        for (((source, tally), content), plan) in sources.iter().zip(tallies).zip(contents).zip(plans) {
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
                source: info.path.display().to_string(),
                source_bytes: source.bytes,
                identity: source.identity(content),
                time: now,
                pose: IDENTITY_POSE,
                read: tally.read + tally.rejected.truncated,
                stored: tally.stored,
                rejected: tally.rejected,
                bounds: tally.bounds,
                exactness,
                largest_error: tally.largest_error,
                format: info.format.to_owned(),
                las: info.las.clone(),
                color_depth: color_depth(&plan.layout.attributes, tally.color_bits, is_8_bit("Red")),
                visible: true,
                attributes,
                crs: source.crs.clone(),
            });
        }
        Ok(scans)
    }

    /// Builds, encodes and writes all nodes; returns what their rows will say of themselves.
    fn build(
        &self,
        writer: &mut Writer,
        job: &BuildJob<'_>,
        buckets: Vec<Bucket>,
    ) -> Result<Vec<(NodeHead, Zones)>, IngestError> {
        let (sender, receiver) = sync_channel::<EncodedNode>(job.budget.queue);
        let sender = Mutex::new(sender);
        std::thread::scope(|scope| {
            let writing = scope.spawn(move || {
                let mut heads = Vec::new();
                for node in receiver {
                    writer.put_chunks(&node.chunks)?;
                    heads.push((node.head, node.zones));
                }
                Ok::<_, crate::store::StoreError>(heads)
            });
            let sink = |node: EncodedNode| {
                let sender = sender.lock().unwrap_or_else(std::sync::PoisonError::into_inner).clone();
                // The writer only stops listening when it has failed, and says why when it is joined.
                sender.send(node).map_err(|_| IngestError::Internal("the writer has stopped".into()))
            };
            let plan = Plan {
                params: job.params,
                root: job.root,
                scans: job.columns,
                table: &job.table,
                ids: &job.ids,
                spill: job.spill,
                most_rows: job.budget.bucket_rows,
                threads: self.threads,
                progress: self.progress,
                sink: &sink,
            };
            let built = if job.wide { build::<Key>(&plan, buckets) } else { build::<u64>(&plan, buckets) };
            drop(sender);
            let written = writing.join().map_err(|_| IngestError::Internal("the writer broke down".into()))?;
            match (built, written) {
                (_, Err(error)) => Err(error.into()),
                (Err(error), Ok(_)) => Err(error),
                (Ok(()), Ok(heads)) => Ok(heads),
            }
        })
    }
}

struct BuildJob<'a> {
    params: Params,
    root: Cube,
    columns: &'a [ScanColumns<'a>],
    table: ScanTable,
    ids: ChunkIds,
    spill: Option<&'a Spill>,
    budget: &'a Budget,
    wide: bool,
}

/// Takes away a store that was created by this run and never got a scan.
fn remove_store(path: &Path) {
    for suffix in ["", "-wal", "-shm", "-lock"] {
        let mut name = path.as_os_str().to_owned();
        name.push(suffix);
        // What can't be removed is an empty store, which does no harm.
        let _ = std::fs::remove_file(PathBuf::from(name));
    }
}

type WorldBounds = ([f64; 3], [f64; 3]);

fn evidence(sources: &[Source], measured: &[Option<WorldBounds>]) -> Vec<Evidence> {
    let of = |(source, bounds): (&Source, &Option<WorldBounds>)| Evidence {
        grid: source.reader.info().grid,
        bounds: *bounds,
        geographic: source.crs.as_ref().is_some_and(Crs::is_geographic),
    };
    sources.iter().zip(measured).map(of).collect()
}

fn world_position(record: &[u8]) -> [f64; 3] {
    std::array::from_fn(|i| {
        let mut bytes = [0; 8];
        bytes.copy_from_slice(&record[8 * i..8 * i + 8]);
        f64::from_le_bytes(bytes)
    })
}

fn widen(bounds: Option<WorldBounds>, other: WorldBounds) -> WorldBounds {
    let Some((min, max)) = bounds else { return other };
    (std::array::from_fn(|i| min[i].min(other.0[i])), std::array::from_fn(|i| max[i].max(other.1[i])))
}

/// Where the points are going to be, as far as headers can be believed, cut to the lattice.
fn hinted_bounds(
    lattice: &Lattice,
    sources: &[Source],
    measured: &[Option<WorldBounds>],
    existing: Option<LatticeBox>,
) -> Option<LatticeBox> {
    let mut hint = existing;
    for (source, bounds) in sources.iter().zip(measured) {
        let Some((min, max)) = bounds else { continue };
        if source.reader.info().records == 0 {
            continue;
        }
        let clamp = |world: [f64; 3]| {
            crate::lattice::LatticePoint(std::array::from_fn(|i| {
                let last = (1_u64 << crate::lattice::BITS) - 1;
                lattice.first_index_at_least(i, world[i]).unwrap_or(last).min(last)
            }))
        };
        let (a, b) = (clamp(*min), clamp(*max));
        let corner = LatticeBox::of(a).with(b);
        hint = Some(hint.map_or(corner, |h| h.union(&corner)));
    }
    hint
}

fn buckets_bounds(existing: Option<LatticeBox>, tallies: &[ScanTally]) -> Option<LatticeBox> {
    existing.into_iter().chain(tallies.iter().filter_map(|t| t.bounds)).reduce(|a, b| a.union(&b))
}

/// The range of the lattice in words.
fn range_of(lattice: &Lattice) -> String {
    let last = (1 << crate::lattice::BITS) - 1;
    format!("{:e} to {:e} in x", lattice.world_on_axis(0, 0), lattice.world_on_axis(0, last))
}

fn color_depth(attributes: &[Attribute], bits: u16, is_8_bit: bool) -> Option<u8> {
    attributes.iter().find(|a| a.name == "Red")?;
    Some(if is_8_bit || bits <= 255 { 8 } else { 16 })
}

fn scan_report(source: &Source, tally: &ScanTally, scan: &Scan) -> ScanReport {
    let mut warnings = source.warnings.clone();
    if tally.rejected.out_of_range > 0 {
        warnings.push(format!(
            "{} points are outside the lattice; a store with a coarser --quantum would hold them",
            tally.rejected.out_of_range
        ));
    }
    if tally.rejected.not_finite > 0 {
        warnings.push(format!("{} points have a coordinate that is NaN or infinite", tally.rejected.not_finite));
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

//! Several stores on one lattice to one: what a single ingest of everything would have given.

use super::IngestError;
use super::bulk::{LEAST_SHARE, Layer, Room, params};
use super::context::{Context, Resources};
use super::gather::ScanColumns;
use super::layers::scan_table;
use super::naming::numbered_name;
use super::partition::RowPlan;
use super::progress::{Progress, Stage};
use super::report::NamedScan;
use super::stored::StoredPoints;
use crate::lattice::{Cube, Key, LatticeBox};
use crate::points::Attribute;
use crate::store::model::{Scan, Site};
use crate::store::{Flip, NodeChange, SiteOptions, Snapshot, Store, Writer};
use serde::Serialize;
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What [`merge`] did.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct Merged {
    /// The scans in the new store.
    pub scans: Vec<NamedScan>,
    /// Scans that a store before has already: they are taken once.
    pub skipped: Vec<SkippedScan>,
    /// What a user should know of it.
    pub notes: Vec<String>,
    /// Points.
    pub points: u64,
    /// Wall time.
    pub seconds: f64,
}

/// A scan that was passed over.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct SkippedScan {
    /// The store that has it, as given.
    pub path: String,
    /// The scan's name in that store.
    pub name: String,
    /// Why.
    pub reason: String,
}

/// A store to be joined.
struct Shard {
    path: PathBuf,
    snapshot: Snapshot,
}

/// Joins `stores` to a new store at `out`; hidden scans stay hidden, bookmarks are kept.
///
/// # Errors
///
/// [`IngestError::NotAlike`] if they don't have one lattice and one CRS, [`IngestError::OutputThere`]; no store is left
/// behind then.
pub fn merge(
    out: &Path,
    stores: &[PathBuf],
    resources: &Resources,
    progress: &dyn Progress,
) -> Result<Merged, IngestError> {
    Context::run(out, resources, progress, |context| {
        let begun = Instant::now();
        let out = context.path;
        let left = left_by_a_crash(out)?;
        let shards = stores
            .iter()
            .map(|path| Ok(Shard { path: path.clone(), snapshot: Store::open(path)?.snapshot()? }))
            .collect::<Result<Vec<_>, IngestError>>()?;
        let site = agreed(&shards)?;
        if let Some(left) = left {
            left.remove_store();
        }
        let (_, mut writer) = Store::create_with_writer(
            out,
            SiteOptions {
                lattice: site.lattice.clone(),
                g: site.g,
                leaf_capacity: site.leaf_capacity,
                crs: site.crs.clone(),
            },
        )?;
        let mut notes = notes(&shards, &site);
        let joined = bookmarks(&shards, &mut notes).and_then(|bookmarks| {
            // Before the commit: with it, the store has all or is none.
            bookmarks.iter().try_for_each(|(name, camera)| writer.put_bookmark(name, camera))?;
            join(context, &shards, &site, &mut writer)
        });
        match joined {
            Ok(merged) => Ok(Merged { seconds: begun.elapsed().as_secs_f64(), notes, ..merged }),
            Err(error) => {
                writer.remove_store();
                Err(error)
            }
        }
    })
}

/// The writer of a store that never had a commit, if there is one. Anything else that is there is an error.
fn left_by_a_crash(out: &Path) -> Result<Option<Writer>, IngestError> {
    if !out.exists() || Store::is_unfinished(out) {
        return Ok(None);
    }
    let is_new = || {
        // Whoever is writing to it holds the lock.
        let writer = Store::open(out).ok()?.writer().ok()?;
        writer.is_provisional().then_some(writer)
    };
    if let Some(writer) = is_new() {
        return Ok(Some(writer));
    }
    Err(IngestError::OutputThere(out.to_owned()))
}

/// The site of them all.
fn agreed(shards: &[Shard]) -> Result<Site, IngestError> {
    let Some(first) = shards.first() else {
        return Err(IngestError::NoStores);
    };
    let mut site = first.snapshot.site().clone();
    for shard in &shards[1..] {
        let other = shard.snapshot.site();
        let refuse =
            |why: String| Err(IngestError::NotAlike { first: first.path.clone(), path: shard.path.clone(), why });
        if other.lattice != site.lattice {
            let quantum = |s: &Site| s.lattice.quantum().map(|q| q.to_string()).join(" x ");
            let phase = |s: &Site| s.lattice.phase().map(|p| p.to_string()).join(" x ");
            return refuse(format!(
                "its lattice has quantum {} and phase {}, the other's {} and {}; ingest its scans again with --lattice {}",
                quantum(other),
                phase(other),
                quantum(&site),
                phase(&site),
                first.path.display(),
            ));
        }
        if (other.g, other.leaf_capacity) != (site.g, site.leaf_capacity) {
            return refuse("its nodes are of another size".into());
        }
        match (&site.crs, &other.crs) {
            (Some(a), Some(b)) if a.same_as(b) == Some(false) => {
                return refuse(format!("its CRS is {}, the other's {}", b.describe_beside(a), a.describe_beside(b)));
            }
            (None, Some(crs)) => site.crs = Some(crs.clone()),
            _ => {}
        }
    }
    Ok(site)
}

/// What is taken for granted.
fn notes(shards: &[Shard], site: &Site) -> Vec<String> {
    let Some(crs) = &site.crs else { return Vec::new() };
    let note = |shard: &Shard| match &shard.snapshot.site().crs {
        None => {
            let path = shard.path.display();
            Some(format!("{path} names no CRS and is taken to be in the others', {}", crs.describe()))
        }
        Some(own) if own.same_as(crs).is_none() => Some(format!(
            "{}: can't tell whether its CRS ({}) is the others' ({}); its coordinates are taken as they are",
            shard.path.display(),
            own.describe(),
            crs.describe()
        )),
        Some(_) => None,
    };
    shards.iter().filter_map(note).collect()
}

/// The bookmarks of them all: one that several have alike is taken once, one of a name that is taken gets a number.
fn bookmarks(shards: &[Shard], notes: &mut Vec<String>) -> Result<Vec<(String, String)>, IngestError> {
    let each = shards.iter().map(|shard| shard.snapshot.bookmarks()).collect::<Result<Vec<_>, _>>()?;
    let mut names: HashSet<String> = each.iter().flatten().map(|(name, _)| name.clone()).collect();
    let mut first: HashSet<&str> = HashSet::new();
    let mut seen = HashSet::new();
    let mut all = Vec::new();
    for (shard, bookmarks) in shards.iter().zip(&each) {
        for (name, camera) in bookmarks.iter().filter(|&bookmark| seen.insert(bookmark)) {
            if first.insert(name) {
                all.push((name.clone(), camera.clone()));
                continue;
            }
            let new = numbered_name(name, &mut names);
            notes
                .push(format!("{}: its bookmark '{name}' is '{new}': another one has that name", shard.path.display()));
            all.push((new, camera.clone()));
        }
    }
    Ok(all)
}

fn join(context: &Context<'_>, shards: &[Shard], site: &Site, writer: &mut Writer) -> Result<Merged, IngestError> {
    let mut merged = Merged::default();
    let mut seen = HashSet::new();
    let mut names = HashSet::new();
    let mut scans: Vec<Scan> = Vec::new();
    let mut parts = Vec::new();
    for shard in shards {
        let first_slot = u32::try_from(scans.len()).unwrap_or(u32::MAX);
        let new: HashSet<_> = shard.snapshot.scans().iter().filter(|s| seen.insert(s.identity)).map(|s| s.id).collect();
        let twice = shard.snapshot.scans().iter().filter(|s| !new.contains(&s.id));
        merged.skipped.extend(twice.map(|s| SkippedScan {
            path: shard.path.display().to_string(),
            name: s.name.clone(),
            reason: "it is there already".into(),
        }));
        let part = StoredPoints::new(&shard.path, &shard.snapshot, None, first_slot, |s| new.contains(&s.id))?;
        for scan in part.scans() {
            let attributes: Vec<Attribute> = scan
                .attributes
                .iter()
                .filter_map(|&slot| shard.snapshot.attribute(slot))
                .map(|a| a.attribute.clone())
                .collect();
            scans.push(Scan {
                id: writer.reserve_scan(),
                name: numbered_name(&scan.name, &mut names),
                attributes: writer.add_attributes(&attributes)?,
                ..(*scan).clone()
            });
        }
        parts.push(part);
    }
    let plans: Vec<Vec<RowPlan>> = parts.iter().map(StoredPoints::row_plans).collect();
    let points = parts.iter().map(StoredPoints::points).fold(0, u64::saturating_add);
    let payload = parts.iter().map(StoredPoints::payload_bytes).fold(0, u64::saturating_add);
    let hint = parts.iter().filter_map(StoredPoints::bounds).reduce(|a, b| a.union(&b));
    let room = Room::new(context, site.g, hint, points, payload, payload / LEAST_SHARE)?;
    let partition = room.partition(&site.lattice);
    context.progress.stage(Stage::Read, points);
    let mut bounds: Option<LatticeBox> = None;
    for (part, plans) in parts.iter().zip(&plans) {
        let found = if room.wide {
            part.read::<Key>(&partition, plans, room.budget.open_bytes, context.progress)?
        } else {
            part.read::<u64>(&partition, plans, room.budget.open_bytes, context.progress)?
        };
        bounds = bounds.into_iter().chain(found).reduce(|a, b| a.union(&b));
    }
    let buckets = partition.finish();
    let mut flip = Flip { crs: site.crs.clone(), ..Flip::default() };
    if let Some(bounds) = bounds {
        let root = Cube::spanning(bounds.min, bounds.max, site.g);
        let columns: Vec<_> = scans
            .iter()
            .zip(plans.iter().flatten())
            .map(|(s, plan)| ScanColumns::new(s.id, s.identity, plan, s.attributes.clone()))
            .collect();
        let table = scan_table(writer.attributes(), &scans);
        let layer = Layer { layer: 0, params: params(site), root, scans: &columns, table: &table };
        context.progress.stage(Stage::Build, points);
        flip.nodes = NodeChange::ReplaceAll(room.write(context, writer, &layer, buckets)?.nodes);
        flip.roots = Some(vec![Some(root)]);
    }
    merged.points = points;
    merged.scans = scans.iter().map(NamedScan::new).collect();
    context.progress.stage(Stage::Commit, points);
    let flip = Flip { scans_added: scans, ..flip };
    context.unless_cancelled(|stop| writer.commit_unless(flip, stop))?;
    Ok(merged)
}

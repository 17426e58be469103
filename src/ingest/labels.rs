//! Changes of what a store says of its points, none of the points: names of scans, the site's CRS.

use super::IngestError;
use super::context::{Context, Resources};
use super::edit::find;
use super::progress::Progress;
use super::run::opened;
use crate::points::Crs;
use crate::store::model::Scan;
use crate::store::{Flip, Store};
use std::path::Path;

/// Gives a scan another name; gives the old one.
///
/// # Errors
///
/// [`IngestError::NoScan`], [`IngestError::NameTaken`], [`IngestError::NoName`].
pub fn rename(
    path: &Path,
    scan: &str,
    name: &str,
    resources: &Resources,
    progress: &dyn Progress,
) -> Result<String, IngestError> {
    Context::run(path, resources, progress, |context| {
        if name.trim().is_empty() {
            return Err(IngestError::NoName);
        }
        let (store, mut writer) = opened(context, Store::open(path)?)?;
        let snapshot = store.snapshot()?;
        let id = find(snapshot.scans(), scan)?;
        let (renamed, others): (Vec<Scan>, Vec<Scan>) = snapshot.scans().iter().cloned().partition(|s| s.id == id);
        drop(snapshot);
        if others.iter().any(|s| s.name == name) {
            return Err(IngestError::NameTaken(name.to_owned()));
        }
        let old = renamed.first().map_or_else(String::new, |s| s.name.clone());
        if old != name {
            let scans_changed = renamed.into_iter().map(|s| Scan { name: name.to_owned(), ..s }).collect();
            let flip = Flip { scans_changed, ..Flip::default() };
            context.unless_cancelled(|stop| writer.commit_unless(flip, stop))?;
        }
        Ok(old)
    })
}

/// Says in which CRS a site is; no coordinate changes. Gives the CRS that it had. `force`: also where that is not surely
/// the same.
///
/// # Errors
///
/// [`IngestError::HasCrs`] without `force`; [`IngestError::Unfinished`].
pub fn set_crs(
    path: &Path,
    crs: &Crs,
    force: bool,
    resources: &Resources,
    progress: &dyn Progress,
) -> Result<Option<Crs>, IngestError> {
    Context::run(path, resources, progress, |context| {
        let (store, mut writer) = opened(context, Store::open(path)?)?;
        if writer.is_provisional() {
            // The next ingest gives it a site of its own.
            return Err(IngestError::Unfinished(path.to_owned()));
        }
        let old = store.snapshot()?.site().crs.clone().filter(|crs| !crs.is_empty());
        if let Some(has) = old.as_ref().filter(|old| !force && old.same_as(crs) != Some(true)) {
            return Err(IngestError::HasCrs { has: has.describe_beside(crs), asked: crs.describe_beside(has) });
        }
        let flip = Flip { crs: Some(crs.clone()), ..Flip::default() };
        context.unless_cancelled(|stop| writer.commit_unless(flip, stop))?;
        Ok(old)
    })
}

//! Cameras that are kept in a store under a name. They touch neither points nor scans, and make no new generation.

use super::IngestError;
use super::context::{Context, Resources};
use super::progress::Progress;
use super::run::opened;
use crate::geometry::Camera;
use crate::store::{Snapshot, Store, Writer};
use std::path::Path;

/// The camera that a store has under a name.
///
/// # Errors
///
/// [`IngestError::NoBookmark`], [`IngestError::BookmarkUnread`], [`IngestError::Store`].
pub fn bookmark(snapshot: &Snapshot, name: &str) -> Result<Camera, IngestError> {
    let bookmarks = snapshot.bookmarks()?;
    match bookmarks.iter().find(|(n, _)| n == name) {
        Some((_, json)) => serde_json::from_str(json).map_err(|e| IngestError::BookmarkUnread(name.to_owned(), e)),
        None => Err(no_bookmark(name, &bookmarks)),
    }
}

/// Keeps a camera under a name; says whether that name had another one before. `replace`: also then.
///
/// # Errors
///
/// [`IngestError::BookmarkTaken`] without `replace`, [`IngestError::NoName`], [`IngestError::Unfinished`].
pub fn keep_bookmark(
    path: &Path,
    name: &str,
    camera: &Camera,
    replace: bool,
    resources: &Resources,
    progress: &dyn Progress,
) -> Result<bool, IngestError> {
    if name.trim().is_empty() {
        return Err(IngestError::NoName);
    }
    let json = serde_json::to_string(camera).map_err(|e| IngestError::BookmarkUnread(name.to_owned(), e))?;
    changed(path, resources, progress, |bookmarks, writer| {
        let before = bookmarks.iter().find(|(n, _)| n == name);
        if before.is_some() && !replace {
            return Err(IngestError::BookmarkTaken(name.to_owned()));
        }
        writer.put_bookmark(name, &json)?;
        Ok(before.is_some_and(|(_, before)| *before != json))
    })
}

/// Lets go of a camera.
///
/// # Errors
///
/// [`IngestError::NoBookmark`].
pub fn remove_bookmark(
    path: &Path,
    name: &str,
    resources: &Resources,
    progress: &dyn Progress,
) -> Result<(), IngestError> {
    changed(path, resources, progress, |bookmarks, writer| {
        if bookmarks.iter().all(|(n, _)| n != name) {
            return Err(no_bookmark(name, bookmarks));
        }
        Ok(writer.remove_bookmark(name)?)
    })
}

fn changed<T: Send>(
    path: &Path,
    resources: &Resources,
    progress: &dyn Progress,
    change: impl FnOnce(&[(String, String)], &mut Writer) -> Result<T, IngestError> + Send,
) -> Result<T, IngestError> {
    Context::run(path, resources, progress, |context| {
        let (store, mut writer) = opened(context, Store::open(path)?)?;
        if writer.is_provisional() {
            // The next ingest begins it anew, without them.
            return Err(IngestError::Unfinished(path.to_owned()));
        }
        let bookmarks = store.snapshot()?.bookmarks()?;
        change(&bookmarks, &mut writer)
    })
}

fn no_bookmark(name: &str, bookmarks: &[(String, String)]) -> IngestError {
    let there = bookmarks.iter().map(|(name, _)| format!("'{name}'")).collect::<Vec<_>>().join(", ");
    let there = if there.is_empty() { "none at all".to_owned() } else { there };
    IngestError::NoBookmark { name: name.to_owned(), there }
}

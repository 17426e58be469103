//! Cameras that commands are given: view files, and bookmarks of the store.

use crate::geometry::Camera;
use crate::ingest;
use crate::store::Snapshot;
use anyhow::Context;
use clap::Args;
use std::path::{Path, PathBuf};

/// One camera, or none.
#[derive(Debug, Args)]
pub(super) struct OneCamera {
    /// The camera: a view file in JSON.
    #[arg(long, value_name = "VIEW.json", group = "camera")]
    pub view: Option<PathBuf>,
    /// The camera: one that is kept in the store (`esker bookmark` lists them).
    #[arg(long, value_name = "NAME", group = "camera")]
    pub bookmark: Option<String>,
}

impl OneCamera {
    pub fn get(&self, snapshot: &Snapshot) -> anyhow::Result<Option<Camera>> {
        match (&self.view, &self.bookmark) {
            (Some(path), _) => Ok(Some(read_view(path)?)),
            (None, Some(name)) => Ok(Some(ingest::bookmark(snapshot, name)?)),
            (None, None) => Ok(None),
        }
    }
}

/// Reads a view file.
pub(super) fn read_view(path: &Path) -> anyhow::Result<Camera> {
    let text = std::fs::read_to_string(path).with_context(|| format!("{}: reading the view failed", path.display()))?;
    serde_json::from_str(&text).with_context(|| format!("{}: is no view", path.display()))
}

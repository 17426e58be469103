//! The inputs of one command: opened, recognised, named, and compared with what the store has.

use super::identity::{IDENTITY_POSE, content_hash, scan_identity};
use super::naming::unique_name;
use super::progress::Progress;
use super::report::Skipped;
use super::{IngestError, IngestOptions};
use crate::formats::{self, PointSource, ReadOptions};
use crate::points::Crs;
use crate::store::model::Scan;
use std::collections::{HashMap, HashSet};
use std::path::PathBuf;

/// A source that will become a scan.
pub(super) struct Source {
    pub reader: Box<dyn PointSource>,
    pub name: String,
    pub bytes: u64,
    /// Known ahead only where another source or a stored scan has the same size.
    pub content: Option<[u8; 32]>,
    /// What it says, or what `--crs` says.
    pub crs: Option<Crs>,
    pub warnings: Vec<String>,
}

impl Source {
    pub fn identity(&self, content: &[u8; 32]) -> [u8; 32] {
        scan_identity(content, self.reader.info().index, &IDENTITY_POSE, "")
    }
}

/// What the inputs came to.
#[derive(Default)]
pub(super) struct Sources {
    pub sources: Vec<Source>,
    pub skipped: Vec<Skipped>,
}

/// Opens all inputs. Those that the store has already, or that are given twice, are skipped with a word.
pub(super) fn open(
    inputs: &[PathBuf],
    options: &IngestOptions,
    stored: &[Scan],
    progress: &dyn Progress,
) -> Result<Sources, IngestError> {
    let listed = formats::list_inputs(inputs, options.recursive)?;
    let mut skipped: Vec<_> = listed
        .skipped
        .iter()
        .map(|path| Skipped { path: path.display().to_string(), reason: "not a point file".into() })
        .collect();
    if listed.files.is_empty() {
        let hint = if options.recursive { "" } else { " (--recursive looks into folders below)" };
        return Err(IngestError::NoInput(hint.into()));
    }
    let mut opened = Vec::new();
    for path in listed.files {
        let reader = formats::open(&path, &ReadOptions::default())?;
        let bytes = std::fs::metadata(&path).map(|m| m.len()).map_err(|source| formats::FormatError::Io {
            path: path.clone(),
            action: "reading the size",
            source,
        })?;
        let info = reader.info();
        if options.strict && info.missing > 0 {
            return Err(IngestError::Truncated { path, missing: info.missing });
        }
        let crs = options.crs.clone().or_else(|| info.crs.clone()).filter(|c| !c.is_empty());
        let warnings = info.warnings.clone();
        opened.push(Source { reader, name: String::new(), bytes, content: None, crs, warnings });
    }

    // Hash ahead only what could be there already.
    let mut sizes: HashMap<u64, usize> = HashMap::new();
    stored.iter().map(|s| s.source_bytes).chain(opened.iter().map(|s| s.bytes)).for_each(|size| {
        *sizes.entry(size).or_default() += 1;
    });
    let mut by_identity: HashMap<[u8; 32], String> =
        stored.iter().map(|s| (s.identity, format!("already in the store as '{}'", s.name))).collect();
    let mut taken: HashSet<String> = stored.iter().map(|s| s.name.clone()).collect();
    let mut sources = Vec::new();
    let single = opened.len() == 1;
    for mut source in opened {
        let path = source.reader.info().path.clone();
        if sizes.get(&source.bytes).is_some_and(|&n| n > 1) {
            let Some(content) = content_hash(&path, &|| progress.cancelled())? else {
                return Err(IngestError::Interrupted);
            };
            source.content = Some(content);
            let identity = source.identity(&content);
            if let Some(reason) = by_identity.get(&identity) {
                skipped.push(Skipped { path: path.display().to_string(), reason: reason.clone() });
                continue;
            }
            by_identity.insert(identity, format!("the same bytes as {}", path.display()));
        }
        source.name = match &options.name {
            Some(name) if single => {
                if !taken.insert(name.clone()) {
                    return Err(IngestError::NameTaken(name.clone()));
                }
                name.clone()
            }
            Some(_) => return Err(IngestError::NameOfMany),
            None => unique_name(&path, &mut taken),
        };
        sources.push(source);
    }
    Ok(Sources { sources, skipped })
}

/// Compares the CRS of all sources with the site's; returns the site's CRS afterwards and what to tell.
pub(super) fn agree_on_crs(
    site: Option<Crs>,
    sources: &[Source],
    ignore: bool,
) -> Result<(Option<Crs>, Vec<String>), IngestError> {
    let mut notes = Vec::new();
    let mut site = site.filter(|c| !c.is_empty());
    let mut of: Option<PathBuf> = None;
    for source in sources {
        let Some(crs) = &source.crs else { continue };
        let path = &source.reader.info().path;
        match &site {
            None => {
                site = Some(crs.clone());
                of = Some(path.clone());
            }
            Some(expected) => match expected.same_as(crs) {
                Some(true) => {}
                Some(false) if ignore => notes.push(format!(
                    "{}: its CRS is {}, the site's is {}; its coordinates are taken as they are (--ignore-crs)",
                    path.display(),
                    crs.describe(),
                    expected.describe()
                )),
                Some(false) => {
                    return Err(IngestError::OtherCrs {
                        path: path.clone(),
                        expected: expected.describe(),
                        found: crs.describe(),
                    });
                }
                None => notes.push(format!(
                    "{}: can't tell whether its CRS ({}) is the site's ({})",
                    path.display(),
                    crs.describe(),
                    expected.describe()
                )),
            },
        }
    }
    let without = sources.iter().filter(|s| s.crs.is_none()).count();
    if let (Some(crs), true) = (&site, without > 0) {
        let from = of.map(|p| format!(" of {}", p.display())).unwrap_or_default();
        notes.push(format!("{without} of the inputs name no CRS and take the site's, {}{from}", crs.describe()));
    }
    Ok((site, notes))
}

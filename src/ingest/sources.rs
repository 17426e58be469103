//! The inputs of one command: opened, recognised, named, and compared with what the store has.

use super::agree::Said;
use super::identity::{content_hash, scan_identity};
use super::naming::{natural_names, unique_name};
use super::progress::Progress;
use super::report::Skipped;
use super::versions::Versions;
use super::{IngestError, IngestOptions};
use crate::formats::{self, PointSource, PointTable, ReadOptions, TableSource};
use crate::geometry::Pose;
use crate::lattice::Lattice;
use crate::points::{Crs, counted};
use crate::store::model::Scan;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// More points than this are announced by no file but a damaged one; counts of a scan have to fit an `i64`.
const MOST_POINTS: u64 = 1 << 60;

/// A source that will become a scan.
pub(super) struct Source {
    pub reader: Box<dyn PointSource>,
    pub name: String,
    /// Its number in its file, from one, if that has several.
    number: Option<u32>,
    pub bytes: u64,
    /// Known ahead only where another source or a stored scan has the same size.
    pub content: Option<[u8; 32]>,
    /// What it says, or what `--crs` says.
    pub crs: Option<Crs>,
    pub warnings: Vec<String>,
}

impl Source {
    pub fn identity(&self, content: &[u8; 32]) -> [u8; 32] {
        let info = self.reader.info();
        scan_identity(content, info.index, &self.pose(), &info.options)
    }

    /// World from the scan's own frame, as the store keeps it.
    pub fn pose(&self) -> [f64; 16] {
        self.reader.info().pose.to_matrix()
    }

    /// The identity of the stored scan that is this source with another pose, or read without the options of this run. `poses`: those
    /// of stored scans of its size.
    fn with_another_pose(
        &self,
        content: &[u8; 32],
        poses: &[[f64; 16]],
        stored: &HashMap<[u8; 32], String>,
    ) -> Option<[u8; 32]> {
        let info = self.reader.info();
        let of = |pose| [&*info.options, ""].map(|options| scan_identity(content, info.index, pose, options));
        poses.iter().flat_map(of).find(|identity| stored.contains_key(identity))
    }

    /// What it is called in a store, and what where that is taken.
    pub fn names(&self) -> (String, Option<String>) {
        let info = self.reader.info();
        natural_names(&info.path, info.scan_name.as_deref(), self.number)
    }

    /// Are there more scans in its file?
    pub fn is_of_several(&self) -> bool {
        self.number.is_some()
    }

    /// What it says of its coordinates.
    pub fn said(&self) -> Said {
        let info = self.reader.info();
        Said { path: info.path.clone(), label: self.label(), crs: self.crs.clone(), bounds: info.bounds_hint }
    }

    /// The file, and which of its scans.
    fn label(&self) -> String {
        let info = self.reader.info();
        match self.number {
            Some(number) => format!("{} (scan {number})", info.path.display()),
            None => info.path.display().to_string(),
        }
    }
}

/// What the inputs came to.
#[derive(Default)]
pub(super) struct Sources {
    pub sources: Vec<Source>,
    pub skipped: Vec<Skipped>,
    /// Files that are left out.
    pub unreadable: Vec<(PathBuf, IngestError)>,
}

/// What is to be ingested.
pub(super) enum Inputs<'a> {
    /// Files and folders.
    Files(&'a [PathBuf]),
    /// A file that takes the place of the scan of this name: of several scans in it the one that is called so, if there is one.
    InPlaceOf(&'a str, &'a PathBuf),
    /// A file whose scans stand here, whatever it says itself.
    At(Pose, &'a PathBuf),
    /// Points in memory.
    Table(Arc<PointTable>),
}

/// The sources of some inputs, before they are compared with what is there.
type Opened = (Vec<Source>, Vec<Skipped>, Vec<(PathBuf, IngestError)>);

/// What inputs are compared with.
#[derive(Clone, Copy, Default)]
pub(super) struct Stored<'a> {
    pub scans: &'a [Scan],
    /// What their bounds mean.
    pub lattice: Option<&'a Lattice>,
}

/// A table as the one source.
fn open_table(table: Arc<PointTable>, options: &IngestOptions, progress: &dyn Progress) -> Result<Opened, IngestError> {
    let source = TableSource::new(table);
    let content = source.content(&|| !progress.cancelled()).ok_or(IngestError::Interrupted)?;
    let bytes = source.bytes();
    let pose = match options.poses[..] {
        [] => Pose::IDENTITY,
        [pose] => pose,
        ref several => return Err(IngestError::Poses { poses: several.len(), files: 1 }),
    };
    let path = source.info().path.clone();
    let reader = formats::place(Box::new(source), &pose)
        .map_err(|e| formats::FormatError::unsupported(&path, format!("the pose that is given ({e})"), ""))?;
    let crs = options.crs.clone().filter(|c| !c.is_empty());
    let (name, number, content) = (String::new(), None, Some(content));
    Ok((vec![Source { reader, name, number, bytes, content, crs, warnings: Vec::new() }], Vec::new(), Vec::new()))
}

/// Opens all inputs. Those that the store has already, or that are given twice, are skipped with a word.
pub(super) fn open(
    inputs: &Inputs<'_>,
    options: &IngestOptions,
    stored: Stored<'_>,
    progress: &dyn Progress,
) -> Result<Sources, IngestError> {
    let opened = match inputs {
        Inputs::Files(paths) => open_files(paths, options)?,
        Inputs::InPlaceOf(name, path) => keep_the_one_named(name, open_files(std::slice::from_ref(path), options)?),
        Inputs::At(pose, path) => (open_file(path, Standing::At(*pose), options)?, Vec::new(), Vec::new()),
        Inputs::Table(table) => open_table(table.clone(), options, progress)?,
    };
    compare(opened, options, stored, progress)
}

fn open_files(inputs: &[PathBuf], options: &IngestOptions) -> Result<Opened, IngestError> {
    if options.name.as_ref().is_some_and(|name| name.trim().is_empty()) {
        return Err(IngestError::NoName);
    }
    let (there, missing): (Vec<_>, Vec<_>) =
        inputs.iter().cloned().partition(|path| !options.keep_going || std::fs::metadata(path).is_ok());
    // If nothing is there, the first is an error as without the option.
    let (there, missing) = if there.is_empty() { (inputs.to_vec(), Vec::new()) } else { (there, missing) };
    let listed = formats::list_inputs(&there, options.recursive)?;
    let skipped: Vec<_> = listed
        .skipped
        .iter()
        .map(|path| Skipped { path: path.display().to_string(), reason: "not a point file".into(), rejected: 0 })
        .collect();
    if listed.files.is_empty() {
        let hint = if options.recursive { "" } else { " (--recursive looks into folders below)" };
        return Err(IngestError::NoInput(hint.into()));
    }
    let poses = poses(&listed.files, options)?;
    let why = |path: PathBuf| {
        let listed = formats::list_inputs(std::slice::from_ref(&path), false);
        listed.err().map(|error| (path, IngestError::from(error)))
    };
    let mut unreadable: Vec<_> = missing.into_iter().filter_map(why).collect();
    let mut opened = Vec::new();
    for (path, pose) in listed.files.into_iter().zip(poses) {
        match open_file(&path, Standing::After(pose), options) {
            Ok(of_file) => opened.extend(of_file),
            Err(error) if options.keep_going => unreadable.push((path, error)),
            Err(error) => return Err(error),
        }
    }
    Ok((opened, skipped, unreadable))
}

/// Which of some scans of a file is called `name` in a store.
fn called(name: &str, scans: &[Source]) -> Option<usize> {
    // What they would be called in a store that has no others; of those that are called so twice the second has a longer name.
    let mut taken = HashSet::new();
    let is_called = |s: &Source| {
        let info = s.reader.info();
        unique_name(&info.path, info.scan_name.as_deref(), s.number, &mut taken) == name
    };
    let found: Vec<bool> = scans.iter().map(is_called).collect();
    let may_be = |s: &Source| {
        let (base, longer) = s.names();
        base == name || longer.is_some_and(|longer| longer == name)
    };
    found.into_iter().position(|is| is).or_else(|| {
        let mut places = (0..scans.len()).filter(|&i| may_be(&scans[i]));
        places.next().filter(|_| places.next().is_none())
    })
}

/// Of several scans of which one is called `name`, keeps that one; says so of the others.
fn keep_the_one_named(name: &str, (opened, mut skipped, unreadable): Opened) -> Opened {
    let Some(place) = called(name, &opened) else { return (opened, skipped, unreadable) };
    let mut kept = Vec::new();
    for (i, source) in opened.into_iter().enumerate() {
        if i == place {
            kept.push(source);
        } else {
            let reason = format!("not the scan that takes the place of '{name}'");
            skipped.push(Skipped { path: source.label(), reason, rejected: 0 });
        }
    }
    (kept, skipped, unreadable)
}

/// Leaves out what the store has already, or what is given twice, and names the rest.
fn compare(
    (opened, mut skipped, mut unreadable): Opened,
    options: &IngestOptions,
    stored: Stored<'_>,
    progress: &dyn Progress,
) -> Result<Sources, IngestError> {
    let versions = Versions::of(stored);
    let stored = stored.scans;
    // Hash ahead only what could be there already.
    let mut sizes: HashMap<u64, usize> = HashMap::new();
    stored.iter().map(|s| s.source_bytes).chain(opened.iter().map(|s| s.bytes)).for_each(|size| {
        *sizes.entry(size).or_default() += 1;
    });
    let mut by_identity: HashMap<[u8; 32], String> =
        stored.iter().map(|s| (s.identity, format!("already in the store as '{}'", s.name))).collect();
    // Scans of one file stand in few places.
    let mut poses: HashMap<u64, Vec<[f64; 16]>> = HashMap::new();
    for scan in stored {
        let of_size = poses.entry(scan.source_bytes).or_default();
        if !of_size.contains(&scan.pose) {
            of_size.push(scan.pose);
        }
    }
    let by_stored = by_identity.clone();
    let mut taken: HashSet<String> = stored.iter().map(|s| s.name.clone()).collect();
    let mut sources = Vec::new();
    let single = opened.len() == 1;
    // The scans of a file are next to each other, and have one content.
    let mut hashed: Option<(PathBuf, [u8; 32])> = None;
    for mut source in opened {
        let path = source.reader.info().path.clone();
        if sizes.get(&source.bytes).is_some_and(|&n| n > 1) {
            let content = match (&hashed, source.content) {
                (_, Some(known)) => known,
                (Some((of, content)), None) if *of == path => *content,
                _ => content_hash(&path, &|| progress.cancelled())?.ok_or(IngestError::Interrupted)?,
            };
            hashed = Some((path.clone(), content));
            source.content = Some(content);
            let identity = source.identity(&content);
            if let Some(reason) = by_identity.get(&identity) {
                let scan = stored.iter().find(|s| s.identity == identity);
                let kept = scan.map_or("", |s| kept_of(s, options));
                let rejected = scan.map_or(0, |s| s.read.saturating_sub(s.stored));
                let lost = match rejected {
                    0 => String::new(),
                    _ => format!("; {} rejected then", counted(rejected, "point")),
                };
                skipped.push(Skipped { path: source.label(), reason: format!("{reason}{lost}{kept}"), rejected });
                continue;
            }
            let poses = poses.get(&source.bytes).map(Vec::as_slice).unwrap_or_default();
            let other = source.with_another_pose(&content, poses, &by_stored);
            if let Some(scan) = other.and_then(|identity| stored.iter().find(|s| s.identity == identity)) {
                let error = IngestError::OtherPose { scan: source.label(), name: scan.name.clone() };
                if !options.keep_going {
                    return Err(error);
                }
                unreadable.push((path, error));
                continue;
            }
            by_identity.insert(identity, format!("the same bytes as {}", source.label()));
        }
        source.name = match &options.name {
            Some(name) if single => {
                if !taken.insert(name.clone()) {
                    return Err(IngestError::NameTaken(name.clone()));
                }
                name.clone()
            }
            Some(_) => return Err(IngestError::NameOfMany),
            None => unique_name(&path, source.reader.info().scan_name.as_deref(), source.number, &mut taken),
        };
        if let Some(scan) = versions.of_source(&source) {
            source.warnings.push(format!(
                "the store has another version as '{}', and both are there now; `esker replace` puts a new one in its place",
                scan.name
            ));
        }
        sources.push(source);
    }
    Ok(Sources { sources, skipped, unreadable })
}

/// What a scan that is there already keeps, though the options ask for something else.
fn kept_of(scan: &Scan, options: &IngestOptions) -> &'static str {
    let name = options.name.as_ref().is_some_and(|name| *name != scan.name);
    let crs = options.crs.as_ref().is_some_and(|crs| scan.crs.as_ref() != Some(crs));
    match (name, crs) {
        (true, true) => "; its name and its CRS stay as they are",
        (true, false) => "; its name stays as it is",
        (false, true) => "; its CRS stays as it is",
        (false, false) => "",
    }
}

/// Where the scans of a file stand.
#[derive(Clone, Copy)]
enum Standing {
    /// Where the file says, and then moved by this.
    After(Pose),
    /// Here.
    At(Pose),
}

/// The scans of a file.
fn open_file(path: &Path, standing: Standing, options: &IngestOptions) -> Result<Vec<Source>, IngestError> {
    let (pose, pose_instead) = match standing {
        Standing::After(pose) => (pose, None),
        Standing::At(pose) => (Pose::IDENTITY, Some(pose)),
    };
    let how = ReadOptions { pose, pose_instead, columns: options.columns.clone(), ..ReadOptions::default() };
    let readers = formats::open_all(path, &how)?;
    let bytes = std::fs::metadata(path).map(|m| m.len()).map_err(|source| formats::FormatError::Io {
        path: path.to_owned(),
        action: "reading the size",
        source,
    })?;
    let several = readers.len() > 1;
    let mut sources = Vec::new();
    for reader in readers {
        let info = reader.info();
        if info.records.saturating_add(info.missing) > MOST_POINTS {
            let found = info.records.saturating_add(info.missing).to_string();
            let expected = "a header with a count of points that can be".to_owned();
            return Err(formats::FormatError::Malformed { path: path.to_owned(), offset: 0, expected, found }.into());
        }
        if options.strict && info.missing > 0 {
            return Err(IngestError::Truncated { path: path.to_owned(), missing: info.missing });
        }
        let crs = options.crs.clone().or_else(|| info.crs.clone()).filter(|c| !c.is_empty());
        let warnings = info.warnings.clone();
        let number = several.then_some(info.index.saturating_add(1));
        sources.push(Source { reader, name: String::new(), number, bytes, content: None, crs, warnings });
    }
    Ok(sources)
}

/// Opens the source of a stored scan again: of its file, the one scan that it was. Where no pose is given, it keeps its own.
/// A file that has changed is told by its path; a path that hangs on the current folder may be any file, and is refused.
pub(super) fn open_again(old: &Scan, options: &IngestOptions, progress: &dyn Progress) -> Result<Source, IngestError> {
    let path = PathBuf::from(&old.source);
    if old.source.is_empty() {
        return Err(IngestError::NoFile(old.name.clone()));
    }
    if path.is_relative() {
        return Err(IngestError::Relative { path, name: old.name.clone() });
    }
    let unnamed = IngestOptions { name: None, ..options.clone() };
    let opened = |inputs: &Inputs<'_>| open(inputs, &unnamed, Stored::default(), progress);
    let given = options.poses.first().copied();
    let mut sources = opened(&Inputs::Files(std::slice::from_ref(&path)))?.sources;
    let content = content_hash(&path, &|| progress.cancelled())?.ok_or(IngestError::Interrupted)?;
    // Its number in the file is part of its identity; in a file that has changed, its name there must do.
    let is_old = |s: &Source| {
        let info = s.reader.info();
        ["", &info.options].iter().any(|o| scan_identity(&content, info.index, &old.pose, o) == old.identity)
    };
    let same = sources.iter().position(is_old);
    let is_same = same.is_some();
    let number = same.or_else(|| called(&old.name, &sources).or((sources.len() == 1).then_some(0)));
    let lost = || IngestError::Changed { path: path.clone(), name: old.name.clone() };
    let mut source = number.filter(|&n| n < sources.len()).map(|n| sources.swap_remove(n)).ok_or_else(lost)?;
    let own = source.pose();
    if given.is_none() && own != old.pose {
        // It was given one: as before, to the bit, or it would be another scan.
        let (kept, index) = (Pose::from_matrix(&old.pose).map_err(|_| lost())?, source.reader.info().index);
        let again = opened(&Inputs::At(kept, &path))?.sources;
        source = again.into_iter().find(|s| s.reader.info().index == index).ok_or_else(lost)?;
    }
    if options.name.as_ref().is_some_and(|name| name.trim().is_empty()) {
        return Err(IngestError::NoName);
    }
    source.name = options.name.clone().unwrap_or_else(|| old.name.clone());
    source.content = Some(content);
    if !is_same {
        let stays = "it stands where it stood, wherever the file has it now (name the file to take that)";
        let stays = if source.pose() == own { String::new() } else { format!("; {stays}") };
        source.warnings.push(format!("{} has changed: what it holds now is read{stays}", path.display()));
    }
    Ok(source)
}

/// The pose for each of `files`: one each, or none at all.
fn poses(files: &[PathBuf], options: &IngestOptions) -> Result<Vec<Pose>, IngestError> {
    match options.poses.len() {
        0 => Ok(vec![Pose::IDENTITY; files.len()]),
        n if n == files.len() => Ok(options.poses.clone()),
        poses => Err(IngestError::Poses { poses, files: files.len() }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ingest::ingest;
    use crate::store::Store;

    #[test]
    fn a_relative_source_is_not_read_again() {
        // It would be whatever lies under that path where somebody happens to be.
        let folder = tempfile::tempdir().unwrap();
        let (store, input) = (folder.path().join("s.esker"), folder.path().join("p.xyz"));
        std::fs::write(&input, "1 2 3\n").unwrap();
        ingest(&store, &[input], &IngestOptions::default(), &()).unwrap();
        let scan = Store::open(&store).unwrap().snapshot().unwrap().scans()[0].clone();
        let again = |scan: &Scan| open_again(scan, &IngestOptions::default(), &()).map(|s| s.reader.info().records);
        assert_eq!(again(&scan).unwrap(), 1);
        let relative = Scan { source: "Cargo.toml".into(), ..scan };
        let refused = again(&relative).unwrap_err().to_string();
        assert_eq!(
            refused,
            "'p' came from Cargo.toml, and the store does not say in which folder that is; name the file"
        );
    }
}

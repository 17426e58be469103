//! Which format a file has: by its first bytes, then by its name.

use super::file::SourceFile;
use super::las::{LasSource, quoted};
use super::ply::PlySource;
use super::{FormatError, PointSource};
use std::path::{Path, PathBuf};

/// Formats that can be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputFormat {
    /// LAS, LAZ and COPC.
    Las,
    /// PLY.
    Ply,
}

impl InputFormat {
    /// By the ending of a file name.
    pub fn of_path(path: &Path) -> Option<Self> {
        match &*ending(path) {
            "las" | "laz" => Some(Self::Las),
            "ply" => Some(Self::Ply),
            _ => None,
        }
    }

    fn word(self) -> &'static str {
        match self {
            Self::Las => "LAS",
            Self::Ply => "PLY",
        }
    }
}

/// How to open a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReadOptions {
    /// The format, if it is not to be found out.
    pub format: Option<InputFormat>,
}

/// Point formats that are known by their first bytes but not read.
const MAGIC: &[(&[u8], &str)] = &[
    (b"ASTM-E57", "E57"),
    (b"# .PCD", "PCD"),
    (b"VERSION .7", "PCD"),
    (b"VERSION 0.7", "PCD"),
    (b"SQLite format 3\0", "an SQLite database as a point file"),
    (b"PK\x03\x04", "a zip archive"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"glTF", "glTF"),
    (b"\x89HDF", "HDF5"),
    (b"PAR1", "Parquet"),
];

/// Formats that are known by their ending but not read.
const ENDINGS: &[(&[&str], &str)] = &[
    (&["e57"], "E57"),
    (&["ptx"], "PTX"),
    (&["pts"], "PTS"),
    (&["pcd"], "PCD"),
    (&["xyz", "txt", "csv", "asc"], "text"),
    (&["obj"], "OBJ"),
    (&["stl"], "STL"),
    (&["off"], "OFF"),
    (&["gltf", "glb"], "glTF"),
    (&["zlas"], "zLAS"),
    (&["rcp", "rcs"], "ReCap"),
    (&["fls"], "FARO"),
    (&["bin"], "a `.bin` file"),
];

const REMEDY: &str = "convert it to LAS, LAZ or PLY first, with PDAL or CloudCompare for example";

fn ending(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default()
}

/// Opens a point file: by its first bytes, whatever its name.
///
/// # Errors
///
/// [`FormatError::Io`] if it can't be read, [`FormatError::Unsupported`] for directories and for formats that are not read,
/// [`FormatError::Malformed`] if the file is not what its name or its header says.
pub fn open(path: &Path, options: &ReadOptions) -> Result<Box<dyn PointSource>, FormatError> {
    let failed = |source| FormatError::Io { path: path.to_owned(), action: "opening", source };
    let kind = std::fs::metadata(path).map_err(failed)?;
    if kind.is_dir() {
        return Err(FormatError::unsupported(path, "a directory as a point file", "name the files in it"));
    }
    if !kind.is_file() {
        // A pipe has no positions to read from.
        return Err(FormatError::unsupported(path, "anything but a regular file", "write the points to a file first"));
    }
    let file = SourceFile::open(path)?;
    let head = file.read_vec(0, 32)?;
    let by_name = InputFormat::of_path(path);
    if head.is_empty() {
        return Err(file.malformed(0, "a point file", "an empty one"));
    }
    let by_bytes = if head.starts_with(b"LASF") {
        Some(InputFormat::Las)
    } else if head.starts_with(b"ply") && head.get(3).is_some_and(u8::is_ascii_whitespace) {
        Some(InputFormat::Ply)
    } else {
        None
    };
    if let Some(format) = options.format.or(by_bytes) {
        return open_as(file, format);
    }
    if let Some((_, what)) = MAGIC.iter().find(|(magic, _)| head.starts_with(magic)) {
        return Err(file.unsupported(*what, REMEDY));
    }
    if let Some(format) = by_name {
        let expected = match format {
            InputFormat::Las => "the signature `LASF`, as the name promises",
            InputFormat::Ply => "the word `ply`, as the name promises",
        };
        return Err(file.malformed(0, expected, quoted(&head[..head.len().min(8)])));
    }
    let ending = ending(path);
    let what = ENDINGS.iter().find(|(endings, _)| endings.contains(&&*ending)).map(|(_, what)| *what);
    Err(match what {
        Some(what) => file.unsupported(what, REMEDY),
        None => file.unsupported("a file of this kind", "LAS, LAZ, COPC and PLY files are"),
    })
}

fn open_as(file: SourceFile, format: InputFormat) -> Result<Box<dyn PointSource>, FormatError> {
    let named = InputFormat::of_path(file.path());
    let warning = named
        .filter(|n| *n != format)
        .map(|n| format!("the name says {}, the content is {}: it is read as that", n.word(), format.word()));
    Ok(match format {
        InputFormat::Las => {
            let mut source = LasSource::open(file)?;
            source.warn(warning);
            Box::new(source)
        }
        InputFormat::Ply => {
            let mut source = PlySource::open(file)?;
            source.warn(warning);
            Box::new(source)
        }
    })
}

/// What a list of paths comes to.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Inputs {
    /// Files to read: those that were named, and those in directories whose ending is that of a readable format.
    pub files: Vec<PathBuf>,
    /// Other files in those directories, and directories below them unless they were to be entered.
    pub skipped: Vec<PathBuf>,
}

/// The files that `paths` stand for, in order; the content of a directory is sorted by name.
///
/// # Errors
///
/// [`FormatError::Io`] if a path does not exist or a directory can't be listed.
pub fn list_inputs(paths: &[PathBuf], recursive: bool) -> Result<Inputs, FormatError> {
    let mut inputs = Inputs::default();
    for path in paths {
        let failed = |source| FormatError::Io { path: path.clone(), action: "opening", source };
        if std::fs::metadata(path).map_err(failed)?.is_dir() {
            list_directory(path, recursive, &mut inputs)?;
        } else {
            inputs.files.push(path.clone());
        }
    }
    Ok(inputs)
}

fn list_directory(directory: &Path, recursive: bool, inputs: &mut Inputs) -> Result<(), FormatError> {
    let failed = |source| FormatError::Io { path: directory.to_owned(), action: "listing", source };
    let entries = std::fs::read_dir(directory).map_err(failed)?.collect::<Result<Vec<_>, _>>().map_err(failed)?;
    let mut paths: Vec<_> = entries.into_iter().map(|e| e.path()).collect();
    paths.sort();
    for path in paths {
        // A link to a directory is not followed: it may lead back up.
        let link = std::fs::symlink_metadata(&path).is_ok_and(|m| m.is_symlink());
        if path.is_dir() {
            if recursive && !link {
                list_directory(&path, recursive, inputs)?;
            } else {
                inputs.skipped.push(path);
            }
        } else if InputFormat::of_path(&path).is_some() {
            inputs.files.push(path);
        } else {
            inputs.skipped.push(path);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(name: &str, content: &[u8]) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, content).unwrap();
        open(&path, &ReadOptions::default()).err().map_or_else(|| "opened".to_owned(), |e| e.to_string())
    }

    #[test]
    fn what_is_no_point_file_is_named() {
        assert!(message("a.las", b"").contains("an empty one"));
        assert!(message("a.las", b"hello, world").contains("at byte 0: expected the signature `LASF`"));
        assert!(message("a.ply", b"hello").contains("found `hello`"));
        assert!(message("a.e57", b"ASTM-E57 and more").contains("E57 is not supported; convert it"));
        assert!(message("a.las", b"ASTM-E57 and more").contains("E57 is not supported"));
        assert!(message("a.pts", b"3\n1 2 3\n").contains("PTS is not supported"));
        assert!(message("a.xyz", b"1 2 3\n").contains("text is not supported"));
        assert!(message("a", b"\0\x01").contains("LAS, LAZ, COPC and PLY files are"));
        let folder = tempfile::tempdir().unwrap();
        let directory = open(folder.path(), &ReadOptions::default()).err().unwrap().to_string();
        assert!(directory.contains("a directory as a point file is not supported; name the files in it"));
        let missing = open(&folder.path().join("none.las"), &ReadOptions::default()).err().unwrap();
        assert!(matches!(missing, FormatError::Io { action: "opening", .. }));
    }

    #[test]
    fn bytes_win_over_the_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.las");
        std::fs::write(&path, "ply\nformat ascii 1.0\nelement vertex 1\nproperty int x\nproperty int y\nproperty int z\nend_header\n1 2 3\n")
            .unwrap();
        let source = open(&path, &ReadOptions::default()).unwrap();
        assert_eq!((source.info().format, source.info().records), ("ply", 1));
        assert!(source.info().warnings[0].contains("the name says LAS, the content is PLY"));
    }

    #[test]
    fn a_directory_means_the_point_files_in_it() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("below")).unwrap();
        for name in ["b.LAZ", "a.las", "c.copc.laz", "notes.txt", "below/d.ply"] {
            std::fs::write(at(name), "").unwrap();
        }
        let paths = [folder.path().to_owned(), at("notes.txt")];
        let flat = list_inputs(&paths, false).unwrap();
        assert_eq!(flat.files, ["a.las", "b.LAZ", "c.copc.laz", "notes.txt"].map(at));
        assert_eq!(flat.skipped, ["below", "notes.txt"].map(at));
        let deep = list_inputs(&paths[..1], true).unwrap();
        assert_eq!(deep.files, ["a.las", "b.LAZ", "below/d.ply", "c.copc.laz"].map(at));
        assert!(list_inputs(&[at("none")], false).is_err());
    }
}

//! Which format a file has: by its first bytes, then by its name and the shape of its first lines.

use super::file::SourceFile;
use super::las::{LasSource, quoted};
use super::ply::PlySource;
use super::text::{HEAD_BYTES, Shape, open_pts, open_ptx, open_rows, shape};
use super::{FormatError, PointSource, e57, pcd, posed, read_poses};
use crate::geometry::Pose;
use std::path::{Path, PathBuf};

/// Formats that can be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum InputFormat {
    /// LAS, LAZ and COPC.
    Las,
    /// PLY.
    Ply,
    /// E57, with any number of scans.
    E57,
    /// PCD.
    Pcd,
    /// Blocks of rows, each with its transform.
    Ptx,
    /// Blocks of rows, each with its count.
    Pts,
    /// Rows of numbers: XYZ, TXT, CSV, ASC.
    Text,
}

impl InputFormat {
    /// By the ending of a file name.
    pub fn of_path(path: &Path) -> Option<Self> {
        match &*ending(path) {
            "las" | "laz" => Some(Self::Las),
            "ply" => Some(Self::Ply),
            "e57" => Some(Self::E57),
            "pcd" => Some(Self::Pcd),
            "ptx" => Some(Self::Ptx),
            "pts" => Some(Self::Pts),
            "xyz" | "txt" | "csv" | "asc" => Some(Self::Text),
            _ => None,
        }
    }

    fn of_bytes(head: &[u8]) -> Option<Self> {
        let words =
            |start: &[u8]| head.starts_with(start) && head.get(start.len()).is_some_and(u8::is_ascii_whitespace);
        if head.starts_with(b"LASF") {
            Some(Self::Las)
        } else if words(b"ply") {
            Some(Self::Ply)
        } else if head.starts_with(b"ASTM-E57") {
            Some(Self::E57)
        } else if head.starts_with(b"# .PCD") || head.starts_with(b"VERSION .7") || head.starts_with(b"VERSION 0.7") {
            Some(Self::Pcd)
        } else {
            None
        }
    }

    fn of_shape(shape: Shape) -> Self {
        match shape {
            Shape::Ptx => Self::Ptx,
            Shape::Pts => Self::Pts,
            Shape::Rows => Self::Text,
        }
    }

    fn word(self) -> &'static str {
        match self {
            Self::Las => "LAS",
            Self::Ply => "PLY",
            Self::E57 => "E57",
            Self::Pcd => "PCD",
            Self::Ptx => "PTX",
            Self::Pts => "PTS",
            Self::Text => "rows of text",
        }
    }

    /// What a file of this name begins with.
    fn beginning(self) -> &'static str {
        match self {
            Self::Las => "the signature `LASF`",
            Self::Ply => "the word `ply`",
            Self::E57 => "the signature `ASTM-E57`",
            Self::Pcd => "a PCD header (`# .PCD` or `VERSION`)",
            Self::Ptx => "two counts, four lines of three numbers and four of four",
            Self::Pts => "a count, or rows of numbers",
            Self::Text => "rows of numbers, or a line that names x, y and z (--columns names them otherwise)",
        }
    }
}

/// How to open a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReadOptions {
    /// The format, if it is not to be found out.
    pub format: Option<InputFormat>,
    /// Applied after a file's own pose.
    pub pose: Pose,
    /// Where a scan stands, instead of its own pose and [`ReadOptions::pose`].
    pub pose_instead: Option<Pose>,
    /// Names of the columns of text files, instead of their own or the customary ones; from [`parse_columns`].
    pub columns: Option<Vec<String>>,
}

pub use super::text::parse_columns;

/// What is known by its first bytes but not read, and what to do.
const MAGIC: &[(&[u8], &str, &str)] = &[
    (b"SQLite format 3\0", "an SQLite database as a point file", "if it is a store, join it with `esker merge`"),
    (b"PK\x03\x04", "a zip archive", UNPACK),
    (b"\x1f\x8b", "a gzip archive", UNPACK),
    (b"7z\xbc\xaf\x27\x1c", "a 7z archive", UNPACK),
    (b"\x28\xb5\x2f\xfd", "a zstd archive", UNPACK),
    (b"glTF", "glTF", REMEDY),
    (b"\x89HDF", "HDF5", REMEDY),
    (b"PAR1", "Parquet", REMEDY),
];
const UNPACK: &str = "unpack it first";
const GRID: &str = "make points of it first, for example with `gdal_translate -of XYZ`";

/// Formats that are known by their ending but not read.
const ENDINGS: &[(&[&str], &str)] = &[
    (&["obj"], "OBJ"),
    (&["stl"], "STL"),
    (&["off"], "OFF"),
    (&["gltf", "glb"], "glTF"),
    (&["zlas"], "zLAS"),
    (&["rcp", "rcs"], "ReCap"),
    (&["fls"], "FARO"),
    (&["bin"], "a `.bin` file"),
];

const REMEDY: &str = "convert it to LAS, LAZ, E57 or PLY first, with PDAL or CloudCompare for example";
const READABLE: &str = "LAS, LAZ, COPC, PLY, E57, PTX, PTS, PCD and text with x, y and z are";

fn ending(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default()
}

/// Opens a point file that holds one scan: by its first bytes, whatever its name.
///
/// # Errors
///
/// As [`open_all`]; [`FormatError::Unsupported`] for a file with several scans.
pub fn open(path: &Path, options: &ReadOptions) -> Result<Box<dyn PointSource>, FormatError> {
    let mut all = open_all(path, options)?;
    match (all.pop(), all.len()) {
        (Some(one), 0) => Ok(one),
        (_, others) => Err(FormatError::unsupported(path, format!("a file with {} scans here", others + 1), "")),
    }
}

/// Opens all scans of a point file: by its first bytes, whatever its name. Most formats have one; E57, PTX and PTS may have
/// any number, but none without.
///
/// # Errors
///
/// [`FormatError::Io`] if it can't be read, [`FormatError::Unsupported`] for directories and for formats that are not read,
/// [`FormatError::Malformed`] if the file is not what its name or its header says.
pub fn open_all(path: &Path, options: &ReadOptions) -> Result<Vec<Box<dyn PointSource>>, FormatError> {
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
    let format = match options.format {
        Some(format) => format,
        None => recognise(&file, options.columns.is_some())?,
    };
    let sources = open_as(file, format, options)?;
    let placed = |source: Box<dyn PointSource>| {
        let index = source.info().index;
        if let Some(pose) = options.pose_instead {
            return Ok(posed::place_at(source, pose));
        }
        posed::place(source, &options.pose).map_err(|e| {
            FormatError::unsupported(path, format!("the pose of scan {} after the one given ({e})", index + 1), "")
        })
    };
    sources.into_iter().map(placed).collect()
}

/// The format of a file. `named`: the user says what its columns are, so that text needs no names of its own.
fn recognise(file: &SourceFile, named: bool) -> Result<InputFormat, FormatError> {
    let head = file.read_vec(0, HEAD_BYTES)?;
    if head.is_empty() {
        return Err(file.malformed(0, "a point file", "an empty one"));
    }
    if let Some(format) = InputFormat::of_bytes(&head) {
        return Ok(format);
    }
    if let Some((_, what, remedy)) = MAGIC.iter().find(|(magic, ..)| head.starts_with(magic)) {
        return Err(file.unsupported(*what, remedy));
    }
    // A raster of heights begins with its columns, whatever it is called.
    if head.get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"ncols")) {
        return Err(file.unsupported("a grid of heights (ESRI ASCII raster)", GRID));
    }
    let shape = shape(&head).map(InputFormat::of_shape);
    let found = || quoted(&head[..head.len().min(8)]);
    match (InputFormat::of_path(file.path()), shape) {
        // A PTS file may lack its count, and then it is rows.
        (Some(InputFormat::Pts), Some(InputFormat::Text)) => Ok(InputFormat::Pts),
        (Some(InputFormat::Ptx), Some(InputFormat::Pts | InputFormat::Text)) => {
            Err(file.malformed(0, "two counts and a transform, as the name promises", found()))
        }
        (Some(InputFormat::Pts | InputFormat::Ptx | InputFormat::Text) | None, Some(shape)) => Ok(shape),
        (Some(InputFormat::Text), None) if named => Ok(InputFormat::Text),
        // Its opener says what is wrong, and where.
        (Some(InputFormat::Text), None)
            if head.iter().take(512).all(|b| (b' '..=b'~').contains(b) || b.is_ascii_whitespace()) =>
        {
            Ok(InputFormat::Text)
        }
        // Text in UTF-16 has a remedy.
        (Some(InputFormat::Text | InputFormat::Pts), None)
            if head.starts_with(b"\xff\xfe") || head.starts_with(b"\xfe\xff") =>
        {
            Ok(InputFormat::Text)
        }
        (Some(format), _) => Err(file.malformed(0, format!("{}, as the name promises", format.beginning()), found())),
        (None, None) => {
            let ending = ending(file.path());
            let what = ENDINGS.iter().find(|(endings, _)| endings.contains(&&*ending)).map(|(_, what)| *what);
            Err(match what {
                Some(what) => file.unsupported(what, REMEDY),
                None => file.unsupported("a file of this kind", READABLE),
            })
        }
    }
}

fn open_as(
    file: SourceFile,
    format: InputFormat,
    options: &ReadOptions,
) -> Result<Vec<Box<dyn PointSource>>, FormatError> {
    let named = InputFormat::of_path(file.path());
    let warning = named
        .filter(|n| *n != format)
        .map(|n| format!("the name says {}, the content is {}: it is read as that", n.word(), format.word()));
    let columns = options.columns.as_deref();
    let mut sources = match format {
        InputFormat::Las => vec![Box::new(LasSource::open(file)?) as Box<dyn PointSource>],
        InputFormat::Ply => vec![Box::new(PlySource::open(file)?) as Box<dyn PointSource>],
        InputFormat::E57 => e57::open(file)?,
        InputFormat::Pcd => vec![pcd::open(file)?],
        InputFormat::Ptx => open_ptx(file, columns)?,
        InputFormat::Pts => open_pts(file, columns)?,
        InputFormat::Text => open_rows(file, columns)?,
    };
    if let (Some(warning), Some(first)) = (warning, sources.first_mut()) {
        first.warn(warning);
    }
    Ok(sources)
}

/// What a list of paths comes to.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Inputs {
    /// Files to read: those that were named, and those in directories whose ending is that of a readable format; of text
    /// files there, those that begin like points and are no poses.
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
        } else if is_point_file(&path) {
            inputs.files.push(path);
        } else {
            inputs.skipped.push(path);
        }
    }
    Ok(())
}

/// Is it a pose as a matrix? Beside scans there often is one, and four rows of four numbers look like points, too.
fn is_matrix(path: &Path) -> bool {
    let small = std::fs::metadata(path).is_ok_and(|m| m.len() <= HEAD_BYTES);
    let text = if small { std::fs::read_to_string(path).unwrap_or_default() } else { String::new() };
    let words = text.lines().map(|l| l.split_whitespace().count()).find(|&n| n > 0);
    matches!(words, Some(4 | 16)) && read_poses(path).is_ok()
}

/// Is it a file of points by its name? Text may be anything, and is looked at.
fn is_point_file(path: &Path) -> bool {
    match InputFormat::of_path(path) {
        // Looking into a pipe waits for whoever writes to it. Opening says what is wrong with it.
        Some(_) if std::fs::metadata(path).is_ok_and(|m| !m.is_file()) => true,
        Some(InputFormat::Text) => {
            let head = SourceFile::open(path).and_then(|f| f.read_vec(0, HEAD_BYTES));
            head.is_ok_and(|head| shape(&head).is_some()) && !is_matrix(path)
        }
        format => format.is_some(),
    }
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
        assert!(message("a.e57", b"hello").contains("expected the signature `ASTM-E57`"));
        assert!(
            message("a.e57", b"ASTM-E57 and more")
                .contains("expected an E57 file, found what its reader refuses: Failed to read E57")
        );
        assert!(message("a.pcd", b"1 2 3\n").contains("expected a PCD header"));
        assert!(message("a.ptx", b"1 2 3\n").contains("expected two counts and a transform"));
        assert!(
            message("a.txt", b"hello, world\nand more\n").contains("expected a row of numbers, or a line that names")
        );
        assert!(message("a.csv", b"\0\0\0").contains("expected rows of numbers"));
        assert!(message("a.xyz", b"\xff\xfe1\0 \0").contains("text in UTF-16 is not supported; write it as UTF-8"));
        assert!(message("a.xyz", b"1 2 3\r4 5 6\r").contains("carriage return alone is not supported"));
        assert!(message("a.fls", b"\0\x01").contains("FARO is not supported; convert it"));
        assert!(message("a.xyz.gz", b"\x1f\x8b\x08\0").contains("a gzip archive is not supported; unpack it first"));
        assert!(message("a.asc", b"ncols 3\nnrows 2\n1 2 3\n4 5 6\n").contains("a grid of heights"));
        assert!(message("a.las", b"SQLite format 3\0").contains("join it with `esker merge`"));
        assert!(message("a", b"\0\x01").contains("PTX, PTS, PCD and text with x, y and z are"));
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
        for name in ["b.LAZ", "a.las", "c.copc.laz", "below/d.ply"] {
            std::fs::write(at(name), "").unwrap();
        }
        std::fs::write(at("notes.txt"), "1 tripod, 2 targets").unwrap();
        std::fs::write(at("e.txt"), "1 2 3\n").unwrap();
        // A pose beside the scans is none of them.
        std::fs::write(at("pose.txt"), "1 0 0 5\n0 1 0 6\n0 0 1 7\n0 0 0 1\n").unwrap();
        let paths = [folder.path().to_owned(), at("notes.txt")];
        let flat = list_inputs(&paths, false).unwrap();
        assert_eq!(flat.files, ["a.las", "b.LAZ", "c.copc.laz", "e.txt", "notes.txt"].map(at));
        assert_eq!(flat.skipped, ["below", "notes.txt", "pose.txt"].map(at));
        let deep = list_inputs(&paths[..1], true).unwrap();
        assert_eq!(deep.files, ["a.las", "b.LAZ", "below/d.ply", "c.copc.laz", "e.txt"].map(at));
        assert!(list_inputs(&[at("none")], false).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn listing_opens_no_pipe() {
        // A pipe with the name of a text was opened to look at it, which waited for ever.
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.csv");
        assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
        let listed = list_inputs(&[folder.path().to_owned()], false).unwrap();
        assert_eq!(listed.files, std::slice::from_ref(&path));
        assert!(open(&path, &ReadOptions::default()).err().unwrap().to_string().contains("but a regular file"));
    }
}

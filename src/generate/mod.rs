//! Synthetic models for trials: the same bytes for the same seed, on every machine and with any number of threads.
//!
//! A model is made in blocks of a fixed size, each from a random stream of its own, so blocks can be made in any order and
//! only a few are in memory. Points are LAS 1.4, format 7, in millimetres, with colours, intensity, returns, classes, GPS
//! times and scan angles, somewhere in UTM zone 32 north.

mod points;
mod random;
mod scene;
mod shapes;
mod site;
mod terrain;

use crate::formats::{
    CreateOptions, CreationDate, FormatError, LasTarget, OutputFormat, OutputPlan, PointWriter, create,
};
use crate::lattice::LatticeError;
use crate::points::{Batch, Crs};
use points::Points;
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::thread;
use thiserror::Error;

/// Points of a block.
const BLOCK_POINTS: u64 = 1 << 15;
/// GPS time of the first pulse, adjusted standard: in 2021.
const START_TIME: f64 = 300_000_000.0;
/// Most scans of a site: their numbers are point source ids.
const MOST_SCANS: u32 = 10_000;
/// Most points: blocks of all scans have streams of their own below 2^32.
const MOST_POINTS: u64 = 1 << 46;

const WKT: &str = concat!(
    r#"PROJCS["WGS 84 / UTM zone 32N",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563,"#,
    r#"AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],"#,
    r#"UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],AUTHORITY["EPSG","4326"]],"#,
    r#"PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",9],"#,
    r#"PARAMETER["scale_factor",0.9996],PARAMETER["false_easting",500000],PARAMETER["false_northing",0],"#,
    r#"UNIT["metre",1,AUTHORITY["EPSG","9001"]],AXIS["Easting",EAST],AXIS["Northing",NORTH],"#,
    r#"AUTHORITY["EPSG","32632"]]"#
);

/// What is generated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Kind {
    /// A torus.
    Torus,
    /// Five concentric spheres.
    Spheres,
    /// An airborne survey of a landscape with trees and buildings: ground, vegetation and building classes, up to three
    /// returns.
    Terrain,
    /// Several terrestrial scans of one landscape, each a file.
    Site,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Torus, Self::Spheres, Self::Terrain, Self::Site];

    /// The word for it on the command line.
    pub fn word(self) -> &'static str {
        match self {
            Self::Torus => "torus",
            Self::Spheres => "spheres",
            Self::Terrain => "terrain",
            Self::Site => "site",
        }
    }

    /// The reverse of [`Kind::word`].
    pub fn from_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|k| k.word() == word)
    }
}

/// How a model is written.
#[derive(Clone, Copy, Debug)]
pub struct GenerateOptions {
    /// Replace existing files?
    pub force: bool,
    /// Scans of a site.
    pub scans: u32,
    /// LAZ files for a site; other kinds go by the ending of the file's name.
    pub laz: bool,
}

impl Default for GenerateOptions {
    fn default() -> Self {
        Self { force: false, scans: 5, laz: false }
    }
}

/// What was generated.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Report {
    /// The files, each with its points.
    pub files: Vec<(PathBuf, u64)>,
    /// All points: as many as asked for.
    pub points: u64,
    /// What a user should know.
    pub notes: Vec<String>,
}

/// Why nothing, or not all, was generated.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum GenerateError {
    /// A file could not be written.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// The folder of a site could not be made.
    #[error("{path}: creating the folder failed")]
    Folder {
        /// The folder.
        path: PathBuf,
        /// The system's word.
        source: std::io::Error,
    },
    /// The file's name has another ending.
    #[error("{0}: models are written as LAS or LAZ; end the name with .las or .laz")]
    Ending(PathBuf),
    /// A number is out of range.
    #[error("{what} {value} is out of range: it must be {least} to {most}")]
    Range {
        /// `scans` or `points`.
        what: &'static str,
        /// What was asked for.
        value: u64,
        /// The least that is possible.
        least: u64,
        /// The most.
        most: u64,
    },
    /// The lattice of millimetres does not exist: a mistake in the program.
    #[error(transparent)]
    Lattice(#[from] LatticeError),
    /// The caller wanted no more.
    #[error("stopped; no incomplete file was left")]
    Stopped,
}

/// A model that is made in blocks.
trait Model: Sync {
    /// Block number `block`: exactly `points` points, of which the first is number `first` of the model.
    fn block(&self, block: u64, first: u64, points: usize) -> Points;
}

/// Writes a model of exactly `points` points: to the file `path`, or for [`Kind::Site`] to files `site_1.las` and on in
/// the folder `path`, which is made if it is not there. `progress` is told the points written so far, and returns false to
/// stop.
///
/// # Errors
///
/// [`GenerateError::Format`] if a file exists and is not to be replaced, or cannot be written;
/// [`GenerateError::Ending`] and [`GenerateError::Range`] if the request makes no sense.
pub fn generate(
    kind: Kind,
    points: u64,
    seed: u64,
    path: &Path,
    options: &GenerateOptions,
    progress: &mut dyn FnMut(u64) -> bool,
) -> Result<Report, GenerateError> {
    let check = |what, value, least, most| {
        let range = GenerateError::Range { what, value, least, most };
        (least..=most).contains(&value).then_some(()).ok_or(range)
    };
    check("points", points, 0, MOST_POINTS)?;
    let mut output = Output { options, done: 0, progress, notes: Vec::new(), files: Vec::new() };
    match kind {
        Kind::Torus => output.write(path, format_of(path)?, points, &shapes::Torus { seed })?,
        Kind::Spheres => output.write(path, format_of(path)?, points, &shapes::Spheres { seed })?,
        Kind::Terrain => output.write(path, format_of(path)?, points, &terrain::Terrain::new(seed, points))?,
        Kind::Site => {
            check("scans", u64::from(options.scans), 1, u64::from(MOST_SCANS))?;
            output.write_site(path, points, seed)?;
        }
    }
    Ok(Report { files: output.files, points: output.done, notes: output.notes })
}

fn format_of(path: &Path) -> Result<OutputFormat, GenerateError> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    let format = OutputFormat::of_extension(extension).filter(|f| matches!(f, OutputFormat::Las | OutputFormat::Laz));
    format.ok_or_else(|| GenerateError::Ending(path.into()))
}

/// Files on their way.
struct Output<'a> {
    options: &'a GenerateOptions,
    done: u64,
    progress: &'a mut dyn FnMut(u64) -> bool,
    notes: Vec<String>,
    files: Vec<(PathBuf, u64)>,
}

impl Output<'_> {
    fn write_site(&mut self, folder: &Path, points: u64, seed: u64) -> Result<(), GenerateError> {
        std::fs::create_dir_all(folder).map_err(|source| GenerateError::Folder { path: folder.into(), source })?;
        let (ending, format) = if self.options.laz { ("laz", OutputFormat::Laz) } else { ("las", OutputFormat::Las) };
        let scans = self.options.scans;
        let path = |i: u32| folder.join(format!("site_{}.{ending}", i + 1));
        // All or nothing: a name that is taken is found before anything is written.
        if let Some(taken) = (0..scans).map(path).find(|p| p.exists() && !self.options.force) {
            let reason = "exists already; use --force to replace it".into();
            return Err(FormatError::Unwritable { path: taken, reason }.into());
        }
        for scan in 0..scans {
            let (i, n) = (u64::from(scan), u64::from(scans));
            // The first scans have one more where the division leaves a rest.
            let share = points / n + u64::from(i < points % n);
            self.write(&path(scan), format, share, &site::Scan::new(seed, scan, scans, share))?;
        }
        Ok(())
    }

    fn write(
        &mut self,
        path: &Path,
        format: OutputFormat,
        points: u64,
        model: &dyn Model,
    ) -> Result<(), GenerateError> {
        let plan = OutputPlan {
            lattice: points::lattice()?,
            attributes: points::attributes(),
            crs: Some(Crs { wkt: Some(WKT.into()), horizontal_epsg: Some(32_632), ..Crs::default() }),
            las: LasTarget::Merged { scale: [0.001; 3], offset: [points::ORIGIN[0], points::ORIGIN[1], 0.0] },
        };
        let options = CreateOptions {
            force: self.options.force,
            points: Some(points),
            standard_gps_time: true,
            las_values: std::collections::BTreeMap::new(),
            // The day of the first pulse: files of a seed are the same whenever they are made.
            creation_date: Some(CreationDate { day_of_year: 75, year: 2021 }),
        };
        let mut writer = create(path, format, &plan, &options)?;
        self.write_blocks(writer.as_mut(), points, model)?;
        self.notes.extend(writer.finish()?);
        self.files.push((path.into(), points));
        Ok(())
    }

    /// Makes some blocks in parallel while those before are written.
    fn write_blocks(
        &mut self,
        writer: &mut dyn PointWriter,
        points: u64,
        model: &dyn Model,
    ) -> Result<(), GenerateError> {
        let blocks = points.div_ceil(BLOCK_POINTS);
        let at_once = 2 * rayon::current_num_threads() as u64;
        let make = |from: u64| -> Vec<Batch> {
            let block = |b: u64| {
                let first = b * BLOCK_POINTS;
                model.block(b, first, BLOCK_POINTS.min(points - first) as usize).into_batch()
            };
            (from..blocks.min(from + at_once)).into_par_iter().map(block).collect()
        };
        let mut ready = make(0);
        let mut next = at_once;
        while !ready.is_empty() {
            ready = thread::scope(|scope| {
                let ahead = scope.spawn(|| make(next));
                for batch in &ready {
                    writer.write(batch)?;
                    self.done += batch.len() as u64;
                }
                if !(self.progress)(self.done) {
                    return Err(GenerateError::Stopped);
                }
                Ok(ahead.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
            })?;
            next += at_once;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;

//! `esker ingest`: point files into a store.

use super::progress::{Mode, Shown};
use super::{Outcome, output, values};
use crate::formats::{InputFormat, parse_columns, read_poses};
use crate::geometry::Pose;
use crate::ingest::{IngestError, IngestOptions, LatticeWish, Report, Resources, ScanReport, ingest};
use crate::lattice::Lattice;
use crate::points::Crs;
use crate::store::{Store, StoreError};
use anyhow::{Context, bail};
use clap::Args;
use std::path::PathBuf;

/// Puts point files into a store, creating it if it is not there.
///
/// Reads LAS 1.0 to 1.5, LAZ, COPC, PLY, E57, PTX, PTS, PCD and rows of text (XYZ, TXT, CSV, ASC). Every file is a scan,
/// and so is every scan inside an E57 file and every block of PTX and PTS; a folder means all point files in it. Scans that
/// the store has already are skipped, so an interrupted command is resumed by giving it again.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  esker ingest site.esker north.laz south.laz\n  \
                  esker ingest site.esker scans/ --recursive --memory 4GiB\n  \
                  esker ingest model.esker bunny.ply --quantum 0.0001\n  \
                  esker ingest site.esker setups.e57 survey.ptx\n  \
                  esker ingest site.esker local.las --pose station.txt\n  \
                  esker ingest site.esker points.csv --columns x,y,z,-,intensity\n  \
                  esker ingest site.esker tiles/ --keep-going\n  \
                  esker ingest site.esker tile.las --crs EPSG:25832 --json")]
pub(super) struct Arguments {
    /// The store, a file that usually ends in .esker.
    store: PathBuf,
    /// Point files and folders.
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// Lattice step of a new store, in CRS units: one number, or one per axis (default: the finest scale of all inputs).
    #[arg(long, value_name = "Q[,Q,Q]", value_parser = values::steps, allow_hyphen_values = true)]
    quantum: Option<[f64; 3]>,
    /// Offset of a new store's lattice, less than the quantum (default: where the inputs' own grids lie).
    #[arg(long, value_name = "P[,P,P]", value_parser = values::finite_per_axis, allow_hyphen_values = true)]
    phase: Option<[f64; 3]>,
    /// Take quantum and phase of a new store from this one, so that the two can be merged.
    #[arg(long, value_name = "STORE", conflicts_with_all = ["quantum", "phase"])]
    lattice: Option<PathBuf>,
    /// Memory to use at most, such as 512MiB or 4GiB (default: a quarter of the machine's); the rest goes through a
    /// temporary file beside the store.
    #[arg(long, value_name = "SIZE", value_parser = values::memory)]
    memory: Option<u64>,
    /// Threads (default: one per core, or for each 32 MiB of memory if these are fewer).
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// The inputs' CRS, instead of what they say: EPSG:N or WKT.
    #[arg(long, value_name = "WKT|EPSG:N", value_parser = crs)]
    crs: Option<Crs>,
    /// Take coordinates as they are though an input's CRS is not the site's.
    #[arg(long)]
    ignore_crs: bool,
    /// The scan's name, for a single input of one scan (default: what the file calls it, or the file's name without its
    /// ending).
    #[arg(long, value_parser = values::name, allow_hyphen_values = true)]
    name: Option<String>,
    /// Where the inputs stand: a file of poses, one for each input file in their order; may be given several times. A pose
    /// is a row-major 4 x 4 matrix, or tx ty tz qw qx qy qz; text or JSON. It comes after a file's own pose.
    #[arg(long = "pose", value_name = "FILE")]
    poses: Vec<PathBuf>,
    /// What the columns of text files are, such as x,y,z,intensity,red,green,blue; `-` for one that is not read (default:
    /// their header line, or the customary ones).
    #[arg(long, value_name = "A,B,..", value_parser = columns, allow_hyphen_values = true)]
    columns: Option<Columns>,
    /// Look for point files in folders below, too.
    #[arg(long)]
    recursive: bool,
    /// Leave out inputs that can't be read, or are in another CRS, and store the others; they are named at the end, with exit
    /// code 3.
    #[arg(long)]
    keep_going: bool,
    /// Wait while another process is writing to the store, instead of failing.
    #[arg(long)]
    wait: bool,
    /// Truncated files are errors; rejected points end the command with exit code 3, also those of scans that are there
    /// already.
    #[arg(long)]
    strict: bool,
    /// One JSON object on stdout.
    #[arg(long)]
    json: bool,
    /// How to show progress on stderr.
    #[arg(long, value_enum, default_value_t = Mode::Auto)]
    progress: Mode,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<Outcome> {
    let mut wish = LatticeWish { quantum: arguments.quantum, phase: arguments.phase };
    if let Some(path) = &arguments.lattice {
        let other = Store::open(path)?;
        let lattice = other.snapshot()?.site().lattice.clone();
        wish = LatticeWish {
            quantum: Some(lattice.quantum_f64()),
            phase: Some(lattice.phase().map(crate::lattice::Decimal::to_f64)),
        };
    }
    let options = IngestOptions {
        lattice: wish,
        resources: Resources {
            memory_bytes: arguments.memory,
            threads: arguments.threads.map(usize::from),
            wait: arguments.wait,
        },
        crs: arguments.crs,
        ignore_crs: arguments.ignore_crs,
        name: arguments.name,
        poses: poses(&arguments.poses)?,
        columns: arguments.columns.map(|c| c.0),
        recursive: arguments.recursive,
        strict: arguments.strict,
        keep_going: arguments.keep_going,
        ..IngestOptions::default()
    };
    let shown = Shown::new(arguments.progress);
    let result = ingest(&arguments.store, &arguments.inputs, &options, &shown);
    shown.clear();
    let report = match result {
        Err(error @ IngestError::Store(StoreError::NotAStore { .. }))
            if InputFormat::of_path(&arguments.store).is_some() =>
        {
            bail!("{error}; the store comes first: esker ingest STORE {} ...", arguments.store.display())
        }
        Err(
            error @ (IngestError::Format(_)
            | IngestError::Grid(_)
            | IngestError::OutOfRange { .. }
            | IngestError::Truncated { .. }),
        ) if !arguments.keep_going && are_several(&arguments.inputs) => {
            bail!("{}; --keep-going stores the others", output::one_line(&error.into()))
        }
        result => result?,
    };
    tell(&report);
    if arguments.json {
        output::json(&serde_json::to_value(&report).context("the report as JSON")?)?;
    } else {
        print(&report)?;
    }
    // Also of what an earlier run has stored: the same command, given again, ends as it did.
    let rejected = report.scans.iter().any(|s| s.rejected > 0) || report.skipped.iter().any(|s| s.rejected > 0);
    Ok(if arguments.strict && rejected || !report.unreadable.is_empty() { Outcome::Rejected } else { Outcome::Done })
}

/// Could the inputs be more than one file?
fn are_several(inputs: &[PathBuf]) -> bool {
    inputs.len() > 1 || inputs.iter().any(|input| input.is_dir())
}

/// Notes and warnings, on stderr.
pub(super) fn tell(report: &Report) {
    for left_out in &report.unreadable {
        output::tell!("esker: left out: {}", output::clean(&left_out.reason));
    }
    for note in &report.notes {
        output::tell!("esker: {}", output::clean(note));
    }
    for scan in &report.scans {
        for warning in &scan.warnings {
            output::tell!("esker: {}: {}", output::clean(&scan.name), output::clean(warning));
        }
    }
}

/// What was kept or lost, in lines on stdout.
pub(super) fn print(report: &Report) -> std::io::Result<()> {
    for scan in &report.scans {
        let error = match scan.max_error {
            e if e > 0.0 => format!(", off by at most {e:.3e}"),
            _ => String::new(),
        };
        let rejected = rejected(scan);
        output::line(format_args!(
            "{}: {} stored{rejected}; positions {}{error}",
            output::clean(&scan.name),
            output::counted(scan.stored, "point"),
            scan.positions,
        ))?;
    }
    for skipped in &report.skipped {
        output::line(format_args!("{}: skipped, {}", output::clean(&skipped.path), skipped.reason))?;
    }
    if report.points > 0 {
        // Of a few points the rate is that of opening the store.
        let rate = match report.points_per_second / 1e6 {
            rate if rate >= 0.1 => format!(" ({rate:.1} million a second)"),
            _ => String::new(),
        };
        let temp = match report.temp_bytes {
            0 => String::new(),
            bytes => format!(", temporary file {}", output::bytes(bytes)),
        };
        output::line(format_args!(
            "{} in {:.1} s{rate}, memory {}{temp}",
            output::counted(report.points, "point"),
            report.seconds,
            output::bytes(report.peak_memory_bytes),
        ))?;
    }
    Ok(())
}

/// What was not stored, with the reasons.
fn rejected(scan: &ScanReport) -> String {
    let reasons = [
        (scan.rejected_truncated, "not in the file"),
        (scan.rejected_not_finite, "without a valid position"),
        (scan.rejected_out_of_range, "outside the lattice"),
    ];
    let counted = |&(n, reason): &(u64, &str)| format!("{} {reason}", output::grouped(n));
    match reasons.iter().filter(|(n, _)| *n > 0).map(counted).collect::<Vec<_>>() {
        reasons if reasons.is_empty() => String::new(),
        reasons => format!(", {} rejected ({})", output::grouped(scan.rejected), reasons.join(", ")),
    }
}

/// Names of columns, as one argument.
#[derive(Clone, Debug)]
pub(super) struct Columns(pub Vec<String>);

pub(super) fn columns(text: &str) -> Result<Columns, String> {
    parse_columns(text).map(Columns)
}

/// The poses of all files, in their order.
pub(super) fn poses(files: &[PathBuf]) -> anyhow::Result<Vec<Pose>> {
    let mut poses = Vec::new();
    for file in files {
        poses.extend(read_poses(file)?);
    }
    Ok(poses)
}

/// EPSG:N, WKT, or what a file has of either.
pub(super) fn crs(text: &str) -> Result<Crs, String> {
    let content = std::fs::read_to_string(text);
    let crs = Crs::parse(content.as_deref().unwrap_or(text));
    crs.ok_or_else(|| "it is neither EPSG:N (1024 to 32766) nor WKT nor a file that holds WKT".to_owned())
}

/// The lattice in words.
pub(super) fn describe(lattice: &Lattice) -> String {
    let one = |values: [crate::lattice::Decimal; 3]| {
        if values.iter().all(|v| *v == values[0]) {
            values[0].to_string()
        } else {
            format!("{} x {} x {}", values[0], values[1], values[2])
        }
    };
    let phase = lattice.phase();
    if phase.iter().all(|p| *p == crate::lattice::Decimal::ZERO) {
        format!("quantum {}", one(lattice.quantum()))
    } else {
        format!("quantum {}, phase {}", one(lattice.quantum()), one(phase))
    }
}

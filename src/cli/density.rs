//! `esker density`: how many points lie where, and how high, as a raster.

use super::which::{Which, tell_why_nothing};
use super::{Outcome, Usage, output, values};
use crate::formats::{Raster, RasterFormat, write_raster};
use crate::points::Crs;
use crate::query::{Density, DensitySquare};
use crate::store::{Limits, Store};
use anyhow::bail;
use clap::{Args, ValueEnum};
use std::path::{Path, PathBuf};

/// Counts points in squares, and finds the lowest and highest of each.
///
/// Without -o it says how many squares there are and how full they are. Nodes that lie in one square are counted without
/// reading a point.
#[derive(Debug, Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Examples:\n  esker density site.esker --side 1\n  esker density site.esker --side 0.5 -o density.asc\n  \
                  esker density site.esker --side 1 --where 'Classification = 2' --value lowest -o ground.asc\n  \
                  esker density site.esker --side 10 -o - --format csv\n\n\
                  .asc is ESRI's text raster of one value, which QGIS, GDAL and CloudCompare read, with the CRS beside it in \
                  a .prj where the store knows its WKT; .csv has a line for each square that has points: X and Y of its \
                  centre, Count, Lowest, Highest. The edges of squares are at multiples of the side."
)]
pub(super) struct Arguments {
    /// The store.
    store: PathBuf,
    /// The side of a square, in CRS units.
    #[arg(long, value_name = "S", value_parser = values::positive)]
    side: f64,
    #[command(flatten)]
    which: Which,
    /// For .asc: which value; count unless said.
    #[arg(long, value_enum, requires = "output")]
    value: Option<Value>,
    /// Where to: a file ending in .asc or .csv, or - for stdout.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// The form of the output, if its name doesn't say.
    #[arg(long, value_enum, requires = "output")]
    format: Option<Format>,
    /// Replace an existing file.
    #[arg(long)]
    force: bool,
    /// One JSON object on stdout, or on stderr where the raster goes to stdout.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Value {
    /// Points in the square.
    Count,
    /// Points per unit of area.
    Density,
    /// The least height.
    Lowest,
    /// The greatest height.
    Highest,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    Asc,
    Csv,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<Outcome> {
    let target = arguments.output.as_deref().map(|path| {
        let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
        let by_name = match ending.as_str() {
            "asc" => Some(Format::Asc),
            "csv" => Some(Format::Csv),
            _ => None,
        };
        if path == Path::new("-") && arguments.format.is_none() {
            return Err(Usage("-o - needs --format: asc or csv".into()));
        }
        let format = arguments.format.or(by_name).ok_or_else(|| {
            Usage(format!("{}: '{ending}' is no ending of a raster; use .asc or .csv, or --format", path.display()))
        })?;
        Ok::<_, Usage>((path, format))
    });
    let target = target.transpose()?;
    if arguments.value.is_some() && target.is_some_and(|(_, format)| format == Format::Csv) {
        return Err(Usage("--value is for .asc; .csv has count, lowest and highest".into()).into());
    }
    let store = Store::open_with(&arguments.store, Limits::once())?;
    let snapshot = store.snapshot()?;
    let region = arguments.which.region(&snapshot)?;
    let (query, watching) = arguments.which.watched(arguments.which.query(region.clone(), &snapshot)?, false);
    let density = query.density(&snapshot, arguments.side)?;
    drop(watching);
    if density.squares.is_empty() {
        tell_why_nothing(&snapshot, &region, &arguments.which.scans)?;
    }
    if let Some((path, format)) = target {
        if format == Format::Asc && density.squares.is_empty() {
            bail!("no points match, and a raster of no squares is none: nothing was written");
        }
        let value = arguments.value.unwrap_or(Value::Count);
        let (format, bands) = match format {
            Format::Asc => (RasterFormat::Asc, vec![("value", band(&density, value))]),
            Format::Csv => {
                let named = [("Count", Value::Count), ("Lowest", Value::Lowest), ("Highest", Value::Highest)];
                (RasterFormat::Csv, named.map(|(name, value)| (name, band(&density, value))).into())
            }
        };
        let Density { side, first, size, .. } = density;
        let places: Vec<usize> = density.squares.iter().map(|square| density.place(square)).collect();
        let counts = matches!(value, Value::Count | Value::Density);
        let empty = if counts { 0.0 } else { f64::NAN };
        let wkt = snapshot.site().crs.as_ref().and_then(|crs| crs.wkt.as_deref());
        let raster = Raster { side, first, size, places: &places, bands: &bands, empty, wkt };
        write_raster(path, format, &raster, arguments.force)?;
    }
    let to_stdout = target.is_some_and(|(path, _)| path == Path::new("-"));
    report(arguments, &density, snapshot.site().crs.as_ref(), to_stdout)?;
    Ok(Outcome::Done)
}

/// A value of each square that has points.
fn band(density: &Density, value: Value) -> Vec<f64> {
    let of = |square: &DensitySquare| match value {
        Value::Count => square.points as f64,
        Value::Density => square.points as f64 / (density.side * density.side),
        Value::Lowest => square.lowest,
        Value::Highest => square.highest,
    };
    density.squares.iter().map(of).collect()
}

fn report(arguments: &Arguments, density: &Density, crs: Option<&Crs>, to_stdout: bool) -> anyhow::Result<()> {
    let points: u64 = density.squares.iter().map(|square| square.points).sum();
    let full = density.squares.len() as u64;
    let most = density.squares.iter().map(|square| square.points).max().unwrap_or(0);
    let area = full as f64 * density.side * density.side;
    let mean = if full > 0 { points as f64 / area } else { 0.0 };
    if arguments.json {
        let value = serde_json::json!({
            "points": points, "side": density.side, "first": density.first, "size": density.size,
            "squares_with_points": full, "most_points": most, "points_per_area": mean,
            "statistics": density.statistics,
        });
        if to_stdout {
            output::tell!("{value}");
        } else {
            output::json(&value)?;
        }
    } else if !to_stdout {
        let [across, up] = density.size;
        output::line(format_args!("points       {}", output::grouped(points)))?;
        output::line(format_args!("squares      {across} x {up}, {} of them with points", output::grouped(full)))?;
        output::line(format_args!("fullest      {}", output::counted(most, "point")))?;
        let unit = crs.and_then(Crs::unit_name).unwrap_or("unit");
        output::line(format_args!("density      {mean:.4} points per square {unit}, where there are any"))?;
    }
    Ok(())
}

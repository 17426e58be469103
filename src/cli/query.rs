//! `esker query`: points out, by region, filter and detail.

use super::cameras::OneCamera;
use super::which::{Which, tell_why_nothing, with_attributes};
use super::{Outcome, Usage, output, values};
use crate::export::{self, ExportError, ExportOptions, Exported, PartOf, Target, Written};
use crate::formats::OutputFormat;
use crate::points::Number;
use crate::query::{Answer, AttributeSummary, Detail, Policy, Query, Region};
use crate::store::{Holders, Limits, Snapshot, Store};
use clap::{Args, ValueEnum};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Takes points out of a store: exactly those asked for, at the detail asked for, with the error stated.
///
/// Without -o it says how many there are and what their attributes are like.
#[derive(Debug, Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Examples:\n  esker query site.esker --box 500000,5000000,500050,5000050 -o corner.laz\n  \
                  esker query site.esker --polygon plots.geojson --z 120,inf -o plots.laz\n  \
                  esker query site.esker --polygon 'POLYGON((500000 5000000, 500050 5000000, 500050 5000030))' --count\n  \
                  esker query site.esker --obox 500010,5000020,130,40,8,10,30 -o street.las\n  \
                  esker query site.esker --region 'polygon(plot.wkt) and not sphere(10,20,3,5)' -o rest.npy\n  \
                  esker query site.esker --frustum view.json --where 'Classification = 6' -o seen.laz\n  \
                  esker query site.esker --where 'Classification = 2 and Intensity > 100' -o ground.las\n  \
                  esker query site.esker --sphere 500010,5000020,130,5 --attributes Red,Green,Blue -o tree.ply\n  \
                  esker query site.esker --max-error 0.05 -o overview.laz\n  \
                  esker query site.esker --capacity 100000 -o - --format csv | head\n  \
                  esker query site.esker --view view.json --capacity 2M --explain\n  \
                  esker query site.esker --split-by class -o out.laz\n  \
                  esker query site.esker --scan north --frame scan -o north_local.las\n\n\
                  Boxes and polygons are half-open: neighbours share no point; `inf` is a number. Several --polygon are \
                  united, as are several of any kind; --polygon with --z is what is in both. Filters compare attributes with \
                  numbers (= <> < <= > >=, between, in, is null, and, or, not), `scan` with names. Points come coarse to fine, \
                  for a view near to far."
)]
pub(super) struct Arguments {
    /// The store.
    store: PathBuf,
    #[command(flatten)]
    which: Which,
    #[command(flatten)]
    camera: OneCamera,
    /// For --view and --bookmark: stop where spacing is below so many pixels; 1 unless said.
    #[arg(long, value_name = "PX", value_parser = values::not_negative, requires = "camera")]
    max_error_px: Option<f64>,
    /// For --view and --bookmark: how points are spread: `screen`, the largest error in pixels first, or `distance`, ratios that fall with
    /// distance: distance,amount=2,levels=16,cube=minimum,min-ratio=0.001,split=LENGTH.
    #[arg(long, value_name = "POLICY", requires = "camera", value_parser = Policy::parse)]
    policy: Option<Policy>,
    /// Thinned to the coarsest cells with which every matching point is within D of a kept one, in CRS units; cells halve
    /// from level to level, so it is often much nearer.
    #[arg(long, value_name = "D", value_parser = values::not_negative, conflicts_with_all = ["spacing", "level"])]
    max_error: Option<f64>,
    /// One point per cell of at most D, in CRS units.
    #[arg(long, value_name = "D", value_parser = values::positive, conflicts_with = "level")]
    spacing: Option<f64>,
    /// One point per cell of level N; 0 is the root's.
    #[arg(long, value_name = "N")]
    level: Option<u32>,
    /// At most so many points, such as 500000 or 2M: an even thinning.
    #[arg(long, visible_alias = "budget", value_name = "N", value_parser = values::count)]
    capacity: Option<u64>,
    /// Only these attributes, separated by commas; `none` for positions alone.
    #[arg(long, value_name = "A,B", value_delimiter = ',')]
    attributes: Vec<String>,
    /// Where to: a file ending in .las, .laz, .ply, .csv, .xyz, .npy or .npz, or - for stdout.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// The form of the output, if its name doesn't say.
    #[arg(long, value_enum, requires = "output")]
    format: Option<Format>,
    /// LAS and LAZ: coordinates in these steps, one number or one per axis.
    #[arg(long, value_name = "S[,S,S]", value_parser = values::steps, allow_hyphen_values = true, requires = "output")]
    scale: Option<[f64; 3]>,
    /// In which frame coordinates are written: the world's, or the one of the scan, where its scanner is the origin
    /// (regions and filters are always the world's).
    #[arg(long, value_enum, value_name = "WHICH", default_value_t = Frame::World, requires = "output")]
    frame: Frame,
    /// A column Scan with the number of each point's scan, which `esker scans` lists (in LAS an extra byte).
    #[arg(long, requires = "output")]
    with_scan: bool,
    /// One file per scan, `out_NAME.las` for `out.las`, or per class, `out_class2.las`; at most 1,024 files.
    #[arg(long, value_enum, value_name = "WHAT", requires = "output")]
    split_by: Option<SplitBy>,
    /// Replace an existing file.
    #[arg(long)]
    force: bool,
    /// Print the number of points, nothing else.
    #[arg(long, conflicts_with_all = ["output", "json", "format", "scale", "frame", "split_by", "with_scan", "attributes", "force"])]
    count: bool,
    /// Say what becomes of the nodes, and why each of the coarsest is taken, tested, refused or cut, instead of giving
    /// points; with --explain=all of every node.
    #[arg(
        long,
        value_enum,
        value_name = "WHICH",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "coarsest",
        conflicts_with_all = ["output", "count", "format", "scale", "frame", "split_by", "with_scan", "force"]
    )]
    explain: Option<Explain>,
    /// One JSON object on stdout.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(super) enum Format {
    Las,
    Laz,
    Ply,
    Csv,
    Xyz,
    Npy,
    Npz,
}

/// Of which nodes an explanation has a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Explain {
    Coarsest,
    All,
}

impl Explain {
    /// The most lines: about what a terminal shows.
    fn most(self) -> usize {
        match self {
            Self::Coarsest => 32,
            Self::All => usize::MAX,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum SplitBy {
    Scan,
    Class,
}

impl From<SplitBy> for export::SplitBy {
    fn from(by: SplitBy) -> Self {
        match by {
            SplitBy::Scan => Self::Scan,
            SplitBy::Class => Self::Class,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Frame {
    World,
    Scan,
}

impl From<Frame> for export::Frame {
    fn from(frame: Frame) -> Self {
        match frame {
            Frame::World => Self::World,
            Frame::Scan => Self::Scan,
        }
    }
}

impl From<Format> for OutputFormat {
    fn from(format: Format) -> Self {
        match format {
            Format::Las => Self::Las,
            Format::Laz => Self::Laz,
            Format::Ply => Self::Ply,
            Format::Csv => Self::Csv,
            Format::Xyz => Self::Xyz,
            Format::Npy => Self::Npy,
            Format::Npz => Self::Npz,
        }
    }
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<Outcome> {
    let mut holders = None;
    let outcome = answer(arguments, &mut holders);
    // Of an answer that was given up some parts are still decoded, which keeps the store open and its log beside it.
    if let Some(holders) = holders {
        holders.wait(Duration::from_secs(2));
    }
    outcome
}

fn answer(arguments: &Arguments, holders: &mut Option<Holders>) -> anyhow::Result<Outcome> {
    if arguments.split_by.is_some() {
        super::limits::open_many_files();
    }
    if arguments.split_by.is_some() && arguments.output.as_deref() == Some(Path::new("-")) {
        return Err(ExportError::SplitOfStandardOutput.into());
    }
    let target =
        arguments.output.as_deref().map(|path| Ok::<_, anyhow::Error>((path, format(path, arguments.format)?)));
    let target = target.transpose()?;
    let store = Store::open_with(&arguments.store, Limits::once())?;
    *holders = Some(store.holders());
    let snapshot = store.snapshot()?;
    let region = arguments.which.region(&snapshot)?;
    let to_stdout = target.is_some_and(|(path, _)| path == Path::new("-"));
    let query = query(arguments, region.clone(), &snapshot)?;
    let (query, watching) = arguments.which.watched(query, to_stdout);
    if let Some(which) = arguments.explain {
        let explanation = query.explain(&snapshot)?;
        drop(watching);
        warn(arguments, &snapshot, &region, &explanation.answer)?;
        if arguments.json {
            output::json(&serde_json::to_value(&explanation)?)?;
        } else {
            output::line(output::clean_lines(&explanation.text(which.most())))?;
            if explanation.nodes.len() > which.most() {
                output::tell!("esker: --explain=all lists all nodes");
            }
        }
        return Ok(Outcome::Done);
    }
    if arguments.count {
        let answer = query.count(&snapshot)?;
        drop(watching);
        warn(arguments, &snapshot, &region, &answer)?;
        output::line(answer.points)?;
        return Ok(Outcome::Done);
    }
    match target {
        None => {
            let (answer, summary) = query.summary(&snapshot)?;
            drop(watching);
            warn(arguments, &snapshot, &region, &answer)?;
            if arguments.json {
                let mut value = serde_json::to_value(&answer)?;
                value["attributes"] = serde_json::to_value(&summary)?;
                output::json(&value)?;
            } else {
                print_summary(&answer, &summary)?;
            }
        }
        Some((path, format)) => {
            let target = if to_stdout { Target::StandardOutput } else { Target::File(path) };
            let options = ExportOptions {
                format: Some(format),
                scale: arguments.scale,
                frame: arguments.frame.into(),
                split: arguments.split_by.map(Into::into),
                with_scan: arguments.with_scan,
                force: arguments.force,
            };
            let Exported { answer, files, notes } = export::export(&snapshot, &query, target, &options, |_| {})?;
            drop(watching);
            for note in notes {
                output::tell!("esker: {}", output::clean(&note));
            }
            warn(arguments, &snapshot, &region, &answer)?;
            if arguments.split_by.is_some() {
                report_files(arguments, &files, &answer)?;
            } else {
                report(arguments, path, &answer)?;
            }
        }
    }
    Ok(Outcome::Done)
}

pub(super) fn format(path: &Path, given: Option<Format>) -> anyhow::Result<OutputFormat> {
    Ok(match given {
        Some(format) => format.into(),
        None if path == Path::new("-") => {
            return Err(Usage("-o - needs --format: las, laz, ply, csv, xyz, npy or npz".into()).into());
        }
        None => export::format_of(path)?,
    })
}

fn query(arguments: &Arguments, region: Region, snapshot: &Snapshot) -> anyhow::Result<Query> {
    let mut query = arguments.which.query(region, snapshot)?;
    if let Some(camera) = arguments.camera.get(snapshot)? {
        query = query.view(camera, arguments.max_error_px.unwrap_or(1.0));
        if let Some(policy) = &arguments.policy {
            if arguments.max_error_px.is_some() && matches!(policy, Policy::Distance(_)) {
                let what = "--max-error-px is for the policy of the screen: leave it out, or --policy";
                return Err(Usage(what.into()).into());
            }
            query = query.policy(*policy);
        }
    }
    let detail = match (arguments.max_error, arguments.spacing, arguments.level) {
        (Some(error), ..) => Detail::MaxError(error),
        (_, Some(spacing), _) => Detail::Spacing(spacing),
        (.., Some(level)) => Detail::Level(level),
        _ => Detail::Everything,
    };
    query = query.detail(detail);
    if let Some(capacity) = arguments.capacity {
        query = query.capacity(capacity);
    }
    Ok(with_attributes(query, &arguments.attributes))
}

/// Says what a user may not expect: a region beside the site, points on the faces that a half-open box leaves out.
fn warn(arguments: &Arguments, snapshot: &Snapshot, region: &Region, answer: &Answer) -> anyhow::Result<()> {
    if answer.points == 0 || answer.region_misses_site {
        tell_why_nothing(snapshot, region, &arguments.which.scans)?;
    }
    if arguments.which.place.closed || !region.is_of_boxes() {
        return Ok(());
    }
    let on_faces = match answer.on_maximum_faces {
        Some(counted) => counted,
        None => {
            // All that matches there, however coarse the answer is.
            let everything = arguments.which.query(region.clone(), snapshot)?.count(snapshot)?;
            everything.on_maximum_faces.unwrap_or(0)
        }
    };
    if on_faces > 0 {
        output::tell!(
            "esker: {} on the region's maximum faces and {} not taken; --closed takes {}",
            output::agreeing(on_faces, "point", ["lies", "lie"]),
            if on_faces == 1 { "is" } else { "are" },
            if on_faces == 1 { "it" } else { "them" }
        );
    }
    Ok(())
}

/// Of an attribute with more values than this the points of each are not listed for people.
const LISTED: usize = 24;

fn print_summary(answer: &Answer, summary: &[AttributeSummary]) -> std::io::Result<()> {
    output::line(format_args!("points       {}", output::grouped(answer.points)))?;
    output::line(format_args!("error bound  {}", bound(answer)))?;
    if answer.points == 0 {
        return Ok(());
    }
    output::line(format_args!("{:32} {:>18} {:>18} {:>18} {:>14}", "attribute", "min", "max", "mean", "values"))?;
    let number = |v: Option<Number>| v.map_or_else(|| "-".to_owned(), output::number);
    for a in summary {
        output::line(format_args!(
            "{:32} {:>18} {:>18} {:>18} {:>14}",
            output::clean(&a.name),
            number(a.min),
            number(a.max),
            a.mean.map_or_else(|| "-".to_owned(), output::mean),
            output::grouped(a.count)
        ))?;
    }
    for a in summary.iter().filter(|a| (2..=LISTED).contains(&a.counts.len())) {
        let all = a.counts.iter().map(|c| format!("{}: {}", c.value, output::grouped(c.points)));
        output::line(format_args!("{:32} {}", output::clean(&a.name), all.collect::<Vec<_>>().join("  ")))?;
    }
    Ok(())
}

/// The bound in words.
fn bound(answer: &Answer) -> String {
    let world = answer.error_bound.map_or_else(|| "none can be given".to_owned(), |b| format!("{b}"));
    match answer.error_bound_px {
        Some(px) => format!("{world} ({px:.2} pixels)"),
        None => world,
    }
}

fn report(arguments: &Arguments, path: &Path, answer: &Answer) -> anyhow::Result<()> {
    if arguments.json {
        if path == Path::new("-") {
            // stdout has the points.
            output::tell!("{}", serde_json::to_string(answer)?);
        } else {
            let mut value = serde_json::to_value(answer)?;
            value["output"] = path.display().to_string().into();
            output::json(&value)?;
        }
    } else if path != Path::new("-") {
        output::line(format_args!(
            "{}: {}, error bound {}",
            path.display(),
            output::counted(answer.points, "point"),
            bound(answer)
        ))?;
    }
    Ok(())
}

fn report_files(arguments: &Arguments, files: &[Written], answer: &Answer) -> anyhow::Result<()> {
    if arguments.json {
        let mut value = serde_json::to_value(answer)?;
        value["outputs"] = serde_json::to_value(files)?;
        return Ok(output::json(&value)?);
    }
    for Written { path, points, part } in files {
        // A scan's name may have what the name of a file cannot have.
        let of = match part {
            Some(PartOf::Scan(name)) => format!(" of scan {}", output::clean(name)),
            Some(PartOf::Class(Some(class))) => format!(" of class {class}"),
            Some(PartOf::Class(None)) => " without a class".to_owned(),
            None => String::new(),
        };
        output::line(format_args!("{}: {}{of}", path.display(), output::counted(*points, "point")))?;
    }
    let all = output::counted(answer.points, "point");
    output::line(format_args!("{all} in all, error bound {}", bound(answer)))?;
    Ok(())
}

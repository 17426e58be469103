//! `esker render`: pictures without a window.

mod options;
mod resident;
mod session;
mod statistics;
mod walk;

use super::cameras::OneCamera;
use super::interrupt::cancelled_by_interrupt;
use super::region::Where;
use super::which::filter;
use super::{Outcome, Usage, output, values};
use crate::formats::{OutputFile, check_output};
use crate::geometry::{Camera, DVec3, WorldBox};
use crate::lattice::LatticeBox;
use crate::points::{Batch, Crs};
use crate::query::{Query, Region, flat_attributes, occupied_boxes};
use crate::render::{ColorDepths, ColorMode, ColorOptions, Coloring};
use crate::store::model::{Scan, ScanId};
use crate::store::{Snapshot, Store, WorldBounds, info};
use crate::stream::gpu::Paint;
use anyhow::Context;
use clap::Args;
use session::{Asked, Session, Starting};
use statistics::Table;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Draws a store as a PNG, from a given camera or from above the whole site, from the south-west; or a walk as many.
///
/// Works without a window and without a graphics card (on software Vulkan). Points are round splats as large as the
/// spacing at their place, shaded by eye-dome lighting.
#[derive(Debug, Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Examples:\n  esker render site.esker -o site.png\n  \
                  esker render site.esker --view door.json --size 1920x1080 --color height -o door.png\n  \
                  esker render site.esker --top --polygon plot.geojson --color class --legend -o plot.png\n  \
                  esker render site.esker --color class --where 'Classification <> 7' --shape paraboloid -o classes.png\n  \
                  esker render site.esker --clip 500,200,-inf,520,240,inf --background ffffff -o strip.png\n  \
                  esker render site.esker --path walk.json --stats walk.csv -o walk.png     (walk-0000.png, ...)\n\n\
                  A view file: {\"eye\":[x,y,z],\"target\":[x,y,z],\"up\":[0,0,1],\"projection\":\"perspective\",\
                  \"fov_y_deg\":60,\"size\":[1280,720]}; \"orthographic\" has \"height\" instead of \"fov_y_deg\".\n\
                  A walk: [VIEW, VIEW, ...], a frame each, or {\"keyframes\":[VIEW, ...],\"frames\":N}."
)]
pub(super) struct Arguments {
    /// The store.
    store: PathBuf,
    #[command(flatten)]
    camera: OneCamera,
    /// The cameras of a walk in JSON: numbered pictures, with what is loaded kept from one to the next.
    #[arg(long, value_name = "CAMERAS.json", conflicts_with = "camera")]
    path: Option<PathBuf>,
    /// The camera: straight from above, north up, in parallel: a plan of all that is drawn.
    #[arg(long, conflicts_with_all = ["camera", "path"])]
    top: bool,
    /// Width and height in pixels (default: the view's, or 1280x720).
    #[arg(long, value_name = "WxH", value_parser = values::pixels)]
    size: Option<[u32; 2]>,
    /// At most so many points.
    #[arg(long, visible_alias = "budget", value_name = "N", default_value = "2M", value_parser = values::count)]
    capacity: u64,
    /// Stop where the spacing is below so many pixels.
    #[arg(long, value_name = "PX", default_value = "1", value_parser = values::not_negative)]
    max_error_px: f64,
    /// rgb, intensity, height, class, return, scan, level or time; rgb falls back to intensity, then height.
    #[arg(long, value_name = "MODE", default_value = "rgb")]
    color: ColorMode,
    /// The values at the two ends of the colours of intensity, height or time (default: the 1st and the 99th percentile
    /// of what may be drawn, by --where, --scan, --box, --clip and the like, from wherever it is seen).
    #[arg(long, value_name = "LOW,HIGH", value_parser = options::range, allow_hyphen_values = true)]
    range: Option<[f64; 2]>,
    /// Only points for which this is true.
    #[arg(long = "where", value_name = "EXPR", allow_hyphen_values = true)]
    filter: Option<String>,
    /// Only this scan, by name or id; may be given several times.
    #[arg(long = "scan", value_name = "NAME", value_parser = values::name, allow_hyphen_values = true)]
    scans: Vec<String>,
    #[command(flatten)]
    place: Where,
    #[command(flatten)]
    look: options::Look,
    /// A table of what each frame cost, as CSV; - for stdout.
    #[arg(long, value_name = "FILE.csv")]
    stats: Option<PathBuf>,
    /// The picture; with --path the name before the numbers.
    #[arg(short, long, value_name = "OUT.png")]
    output: PathBuf,
    /// Replace existing files.
    #[arg(long)]
    force: bool,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<Outcome> {
    let ending = arguments.output.extension();
    // Pictures of a walk get their ending with their numbers.
    let bare = ending.is_none() && arguments.path.is_some();
    if !bare && !ending.is_some_and(|ending| ending.eq_ignore_ascii_case("png")) {
        let path = arguments.output.display();
        return Err(Usage(format!("{path}: pictures are written as PNG; give it a name that ends in .png")).into());
    }
    let cancel = cancelled_by_interrupt();
    // The adapter takes its time, and needs nothing of the store.
    let starting = Starting::new(Instant::now());
    let store = Store::open(&arguments.store)?;
    let outputs = |frames: usize| -> Vec<PathBuf> {
        match arguments.path {
            None => vec![arguments.output.clone()],
            Some(_) => (0..frames).map(|frame| numbered(&arguments.output, frame)).collect(),
        }
    };
    let snapshot = store.snapshot()?;
    let region = arguments.place.region(&snapshot.site().lattice)?;
    let cameras = cameras(arguments, &snapshot, &region)?;
    let outputs = outputs(cameras.len());
    // Before the work, not after it.
    let pictures = outputs.iter().map(|path| check_output(path, arguments.force)).collect::<Result<Vec<_>, _>>()?;
    let mut table = Table::create(arguments.stats.as_deref(), &pictures, arguments.force)?;

    if snapshot.site().crs.as_ref().is_some_and(Crs::is_geographic) {
        output::tell!(
            "esker: the site's coordinates are degrees, and are drawn as long as metres of height; reproject its files for \
             a picture in proportion"
        );
    }
    let query = query(arguments, &snapshot, &region)?.cancel(&cancel);
    let coloring = coloring(arguments, &snapshot, &query)?;
    let mut session = session(arguments, &snapshot, query, coloring, starting)?;
    let mut drawn = 0;
    for ((frame, camera), path) in cameras.iter().enumerate().zip(&outputs) {
        let mut file = OutputFile::create(path, arguments.force)?;
        let (mut image, cost) = session.frame(camera)?;
        if arguments.look.legend {
            image.draw_legend(session.legend());
        }
        file.write(&image.to_png()?)?;
        file.finish()?;
        table.line(&cost.line(frame))?;
        let bound = cost.error_px.map_or_else(String::new, |px| format!(", screen-space error {px:.2} pixels"));
        let points = output::counted(cost.points, "point");
        drawn += cost.points;
        let told = format!("{}: {points}{bound}, drawn by {}", path.display(), session.adapter_name());
        if table.is_standard_output() {
            output::tell!("esker: {told}");
        } else {
            output::line(told)?;
        }
    }
    table.finish()?;
    if drawn == 0 {
        output::tell!("esker: nothing was drawn: no point matches, or none is in view");
        super::which::tell_why_nothing(&snapshot, &region, &arguments.scans)?;
    }
    Ok(Outcome::Done)
}

/// `walk.png` and 7 as `walk-0007.png`.
fn numbered(path: &Path, frame: usize) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let ending = path.extension().map_or_else(|| "png".into(), |e| e.to_string_lossy());
    path.with_file_name(format!("{stem}-{frame:04}.{ending}"))
}

fn cameras(arguments: &Arguments, snapshot: &Snapshot, region: &Region) -> anyhow::Result<Vec<Camera>> {
    let asked = |s: &Scan| arguments.scans.iter().any(|name| *name == s.name || name.parse() == Ok(s.id));
    let is_seen = |s: &Scan| if arguments.scans.is_empty() { s.visible } else { asked(s) };
    let site = snapshot.scans().iter().filter(|s| is_seen(s)).filter_map(|s| s.bounds).reduce(|a, b| a.union(&b));
    let bounds = site.map(|b| WorldBounds::new(&snapshot.site().lattice, &b));
    let WorldBounds { min, max } = bounds.unwrap_or(WorldBounds { min: [0.0; 3], max: [1.0; 3] });
    let bounds = WorldBox::new(min, max).context("the site's bounds are no box")?;
    let cameras = match (&arguments.path, arguments.camera.get(snapshot)?) {
        (Some(path), _) => walk::read(path)?,
        (None, Some(camera)) => vec![camera],
        (None, None) => {
            let is_seen = |id| snapshot.scans().iter().any(|s| s.id == id && is_seen(s));
            let size = arguments.size.unwrap_or([1280, 720]);
            let places = match region {
                Region::Everything => places(arguments, snapshot, is_seen)?,
                _ => some_places(arguments, snapshot, region)?,
            };
            vec![if arguments.top { Camera::above(&places, size)? } else { Camera::seeing(&places, size)? }]
        }
    };
    let sized = cameras.into_iter().map(|camera| match arguments.size {
        Some(size) => camera.with_size(size),
        None => Ok(camera),
    });
    sized.map(|camera| Ok(camera?.reaching(&bounds))).collect()
}

/// Corners of boxes around the points, within what one clip box keeps.
fn places(arguments: &Arguments, snapshot: &Snapshot, is_seen: impl Fn(ScanId) -> bool) -> anyhow::Result<Vec<DVec3>> {
    let lattice = &snapshot.site().lattice;
    let [low, high] =
        arguments.look.kept_box().unwrap_or([[f64::NEG_INFINITY; 3], [f64::INFINITY; 3]]).map(DVec3::from_array);
    let boxes = occupied_boxes(snapshot, is_seen)?;
    let kept = |b: LatticeBox| {
        let WorldBounds { min, max } = WorldBounds::closed(lattice, &b);
        WorldBox::new(DVec3::from_array(min).max(low).to_array(), DVec3::from_array(max).min(high).to_array())
    };
    Ok(boxes.into_iter().filter_map(kept).flat_map(|b| b.corners()).collect())
}

/// Of some of the points in a region, which may be small beside the site's boxes.
fn some_places(arguments: &Arguments, snapshot: &Snapshot, region: &Region) -> anyhow::Result<Vec<DVec3>> {
    /// Enough to be near all ends of what they are of.
    const ENOUGH: u64 = 20_000;
    let (mut places, lattice) = (Vec::new(), &snapshot.site().lattice);
    query(arguments, snapshot, region)?.positions_only().capacity(ENOUGH).run(snapshot, |batch| {
        places.extend(batch.positions.iter().map(|p| DVec3::from_array(lattice.world_from_lattice(p))));
        std::ops::ControlFlow::Continue(())
    })?;
    Ok(places)
}

/// Which points count.
fn query(arguments: &Arguments, snapshot: &Snapshot, region: &Region) -> anyhow::Result<Query> {
    let mut query = Query::new();
    if let Some(text) = &arguments.filter {
        query = query.filter(filter(text, snapshot)?);
    }
    if !arguments.scans.is_empty() {
        query = query.scans(arguments.scans.iter().cloned());
    }
    // What one box keeps is also all that is read; several are left to the passes.
    let kept = arguments.look.kept_box().map(|[min, max]| Region::new_box(min, max)).transpose()?;
    Ok(query.region(Region::all([region.clone()].into_iter().chain(kept))))
}

/// How points are coloured, by the points of the coarsest level.
fn coloring(arguments: &Arguments, snapshot: &Snapshot, query: &Query) -> anyhow::Result<Coloring> {
    let flat = flat_attributes(snapshot)?;
    let black = ColorMode::Rgb.attributes().iter().all(|name| flat.get(*name).is_none_or(|value| *value == 0.0));
    let has = |name: &str| {
        // Some files have room for colours, or intensities, but none: points of one grey would show nothing.
        let is_color = ColorMode::Rgb.attributes().contains(&name);
        let nothing = if is_color { black && flat.contains_key(name) } else { flat.contains_key(name) };
        snapshot.attributes().iter().any(|a| a.attribute.name == name)
            && !(nothing && arguments.color == ColorMode::Rgb)
    };
    let mode = arguments.color.resolved(has)?;
    if mode != arguments.color {
        output::tell!("esker: the points have no {} to show; shown by {}", arguments.color.word(), mode.word());
    }
    if arguments.range.is_some() && !mode.has_range() {
        let what = format!("--range is for colours by intensity, height or time, not by {}", mode.word());
        return Err(Usage(what).into());
    }
    let asked = query.asked_scans(snapshot)?;
    let scans = || asked.iter().filter_map(|id| snapshot.scan(*id));
    let options = ColorOptions {
        mode,
        depths: ColorDepths::of_scans(scans().map(|s| (s.id, s.color_depth))),
        range: arguments.range,
        scan_names: scans().map(|s| (s.id, s.name.clone())).collect(),
        levels: if mode == ColorMode::Level && arguments.look.legend { Some(info(snapshot)?.levels) } else { None },
    };
    let uncolored = mode == ColorMode::Rgb && options.depths.by_scan.values().any(Option::is_none);
    let mut sample = Vec::new();
    if (mode.has_range() && arguments.range.is_none()) || uncolored || arguments.look.legend {
        let mut names: Vec<String> = mode.attributes().iter().map(|n| (*n).to_owned()).collect();
        if uncolored && has("Intensity") {
            names.push("Intensity".into());
        }
        let coarse = with_attributes(query.clone(), names).with_scans(true).coarse_sample();
        coarse.run(snapshot, |batch| {
            sample.push(batch);
            std::ops::ControlFlow::Continue(())
        })?;
    }
    let sample: Vec<&Batch> = sample.iter().collect();
    Ok(Coloring::new(&sample, &snapshot.site().lattice, &options)?)
}

fn with_attributes(query: Query, names: Vec<String>) -> Query {
    if names.is_empty() { query.positions_only() } else { query.attributes(names) }
}

fn session(
    arguments: &Arguments,
    snapshot: &Snapshot,
    query: Query,
    coloring: Coloring,
    starting: Starting,
) -> anyhow::Result<Session> {
    let all_match = arguments.filter.is_none()
        && arguments.scans.is_empty()
        && arguments.look.kept_box().is_none()
        && arguments.place.is_everything()
        && snapshot.scans().iter().all(|s| s.visible);
    let has = |name: &String| snapshot.attributes().iter().any(|a| a.attribute.name == *name);
    let names = coloring.paint.attributes().into_iter().filter(has).collect();
    let parts = with_attributes(query, names).with_scans(coloring.paint.needs_scans()).view_parts(snapshot)?;
    let asked = Asked {
        capacity: arguments.capacity.min(u32::MAX.into()),
        max_error_px: arguments.max_error_px,
        options: arguments.look.options()?,
        all_match,
    };
    Ok(Session::new(parts, coloring, asked, starting))
}

//! `esker render`: a picture without a window.

use super::{Outcome, output, values};
use crate::geometry::{Camera, WorldBox};
use crate::points::Batch;
use crate::query::{Filter, Query, select_view};
use crate::render::{ColorDepths, ColorMode, ColorOptions, RenderOptions, Renderer, Scene, SelectedPoints, colors};
use crate::store::{Snapshot, Store};
use anyhow::Context;
use clap::Args;
use std::ops::ControlFlow;
use std::path::PathBuf;

/// Draws a store as a PNG, from a given camera or from above the whole site.
///
/// Works without a window and without a graphics card (on software Vulkan). Points are round splats as large as the
/// spacing at their place, shaded by eye-dome lighting.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  esker render site.esker -o site.png\n  \
                  esker render site.esker --view door.json --size 1920x1080 --color height -o door.png\n\n\
                  A view file: {\"eye\":[x,y,z],\"target\":[x,y,z],\"up\":[0,0,1],\"projection\":\"perspective\",\
                  \"fov_y_deg\":60,\"size\":[1280,720]}; \"orthographic\" has \"height\" instead of \"fov_y_deg\".")]
pub(super) struct Arguments {
    /// The store.
    store: PathBuf,
    /// The camera: a view file in JSON (default: the whole site from above, from the south-west).
    #[arg(long, value_name = "VIEW.json", conflicts_with = "bookmark")]
    view: Option<PathBuf>,
    /// A camera that is saved in the store.
    #[arg(long, value_name = "NAME")]
    bookmark: Option<String>,
    /// Width and height in pixels (default: the view's, or 1280x720).
    #[arg(long, value_name = "WxH", value_parser = values::pixels)]
    size: Option<[u32; 2]>,
    /// At most so many points.
    #[arg(long, visible_alias = "budget", value_name = "N", default_value = "2M", value_parser = values::count)]
    capacity: u64,
    /// Stop where the spacing is below so many pixels.
    #[arg(long, value_name = "PX", default_value = "1", value_parser = values::not_negative)]
    max_error_px: f64,
    /// rgb, intensity, height, class, return or scan; rgb falls back to intensity, then height.
    #[arg(long, value_name = "MODE", default_value = "rgb")]
    color: ColorMode,
    /// Only points for which this is true.
    #[arg(long = "where", value_name = "EXPR")]
    filter: Option<String>,
    /// Only this scan, by name or id; may be given several times.
    #[arg(long = "scan", value_name = "NAME")]
    scans: Vec<String>,
    /// Flat colours, without eye-dome lighting.
    #[arg(long)]
    unlit: bool,
    /// The picture.
    #[arg(short, long, value_name = "OUT.png")]
    output: PathBuf,
    /// Replace an existing file.
    #[arg(long)]
    force: bool,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<Outcome> {
    let store = Store::open(&arguments.store)?;
    if arguments.output.exists() && !arguments.force {
        // Before the work, not after it.
        anyhow::bail!("{}: exists already; use --force to replace it", arguments.output.display());
    }
    let snapshot = store.snapshot()?;
    let camera = camera(arguments, &snapshot)?;
    let (scene, bound_px) = scene(arguments, &snapshot, &camera)?;
    let options = RenderOptions {
        edl: if arguments.unlit { None } else { RenderOptions::default().edl },
        ..RenderOptions::default()
    };
    let renderer = Renderer::new()?;
    let image = renderer.render(&scene, &camera, &options)?;
    image.write_png(&arguments.output, arguments.force)?;
    let bound = bound_px.map_or_else(String::new, |px| format!(", screen-space error {px:.2} pixels"));
    output::line(format_args!(
        "{}: {} points{bound}, drawn by {}",
        arguments.output.display(),
        output::grouped(scene.len() as u64),
        renderer.adapter_name()
    ))?;
    Ok(Outcome::Done)
}

fn camera(arguments: &Arguments, snapshot: &Snapshot) -> anyhow::Result<Camera> {
    let site = snapshot.scans().iter().filter(|s| s.visible).filter_map(|s| s.bounds).reduce(|a, b| a.union(&b));
    let bounds = site.map(|b| super::info::world_bounds(&snapshot.site().lattice, &b));
    let (min, max) = bounds.unwrap_or(([0.0; 3], [1.0; 3]));
    let bounds = WorldBox::new(min, max).context("the site's bounds are no box")?;
    let camera = match (&arguments.view, &arguments.bookmark) {
        (Some(path), _) => super::query::read_view(path)?,
        (None, Some(name)) => {
            let bookmarks = snapshot.bookmarks()?;
            let found = bookmarks.iter().find(|(n, _)| n == name);
            let (_, json) = found.with_context(|| format!("the store has no bookmark '{name}'"))?;
            serde_json::from_str(json).with_context(|| format!("bookmark '{name}' is no view"))?
        }
        (None, None) => Camera::looking_at_all(&bounds, arguments.size.unwrap_or([1280, 720]))?,
    };
    let camera = match arguments.size {
        Some(size) => camera.with_size(size)?,
        None => camera,
    };
    Ok(camera.reaching(&bounds))
}

/// The points of the view with their colours, and the error in pixels.
fn scene(arguments: &Arguments, snapshot: &Snapshot, camera: &Camera) -> anyhow::Result<(Scene, Option<f64>)> {
    let site = snapshot.site();
    let mode = arguments.color;
    let mut query = Query::new().view(camera.clone(), arguments.max_error_px).capacity(arguments.capacity);
    if let Some(text) = &arguments.filter {
        query = query.filter(Filter::parse(text)?);
    }
    if !arguments.scans.is_empty() {
        query = query.scans(arguments.scans.iter().cloned());
    }
    // What the mode or its stand-ins may want, as far as the store has it.
    let has = |name: &str| snapshot.attributes().iter().any(|a| a.attribute.name == name);
    let wanted = mode.attributes().iter().chain(ColorMode::Intensity.attributes()).filter(|n| has(n));
    query = query.attributes(wanted.map(|n| (*n).to_owned())).with_scans(true);
    let mut batches: Vec<Batch> = Vec::new();
    let answer = query.run(snapshot, |batch| {
        batches.push(batch);
        ControlFlow::Continue(())
    })?;
    let depths =
        ColorDepths { others: Some(16), by_scan: snapshot.scans().iter().map(|s| (s.id, s.color_depth)).collect() };
    let references: Vec<_> = batches.iter().collect();
    let colored = colors(&references, &site.lattice, &ColorOptions { mode, depths, ..ColorOptions::default() })?;
    if colored.mode != mode {
        eprintln!("esker: the points have no {} to show; shown by {}", mode.word(), colored.mode.word());
    }

    // Splats are as large as the finest selected node around them asks for.
    let nodes = snapshot.nodes();
    let selection =
        select_view(&nodes, &site.lattice, site.g, camera, arguments.max_error_px, Some(arguments.capacity))?;
    let quantum = site.lattice.largest_quantum();
    let mut selected: Vec<SelectedPoints> = selection
        .parts
        .iter()
        .map(|part| {
            let cube = nodes.node(part.node)?.cube;
            let spacing = quantum * 2_f64.powi(i32::from(cube.k()) - i32::from(site.g));
            Ok(SelectedPoints { cube, spacing, positions: Default::default(), colors: Vec::new() })
        })
        .collect::<anyhow::Result<_>>()?;
    if let Some(root) = nodes.roots()?.iter().map(|r| r.cube).max_by_key(|c| c.k()) {
        let spacing = quantum * 2_f64.powi(i32::from(root.k()) - i32::from(site.g));
        for (batch, colors) in batches.into_iter().zip(colored.colors) {
            selected.push(SelectedPoints { cube: root, spacing, positions: batch.positions, colors });
        }
    }
    Ok((Scene::from_selection(site.lattice.clone(), selected)?, answer.error_bound_px))
}

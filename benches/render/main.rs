//! What a picture costs, stage by stage, at budgets from 0.5 to 10 million points; and what a point costs as a triangle,
//! as a quad and as a point primitive on this machine's adapter.
//!
//! `cargo bench --bench render` takes a generated store of 1.5 million points; `ESKER_STORE=big.esker` another one. Each
//! figure is the median of five, with the least and the greatest, in nanoseconds a point that passed on all cores.

#![allow(missing_docs)]

mod frames;
mod primitives;

use esker::generate::{GenerateOptions, Kind, generate};
use esker::geometry::{Camera, WorldBox};
use esker::ingest::{IngestOptions, ingest};
use esker::query::Wanted;
use esker::render::{ColorDepths, ColorMode, ColorOptions, Coloring, GpuPool, RenderOptions, Renderer, View};
use esker::store::{Snapshot, Store};
use esker::stream::gpu::{BLOCK_POINTS, BlockId, DrawBlock, DrawList, DrawNode, Paint, PointPool};
use esker::stream::{self, Limits, Loaded, ScanChoice, Shown, StoreSource, Stream, set_spacings};
use frames::Gpu;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

// The program's own: what is freed between two pictures costs no fresh memory for the next one.
#[cfg(feature = "cli")]
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

type Error = Box<dyn std::error::Error>;

const RUNS: usize = 5;
/// Points that are loaded in a run at least: small budgets several times.
const LEAST_LOADED: u64 = 4_000_000;
/// To [`spread`], for times in milliseconds.
const MILLISECONDS: u64 = 1_000_000;
const SIZE_PX: [u32; 2] = [1280, 720];
/// Of the frames that are drawn one after the other.
const WINDOW_PX: [u32; 2] = [1920, 1080];
const BUDGETS: [u64; 5] = [500_000, 1_000_000, 2_000_000, 5_000_000, 10_000_000];

fn main() -> Result<(), Error> {
    let folder = tempfile::tempdir()?;
    let path = match std::env::var_os("ESKER_STORE") {
        Some(path) => PathBuf::from(path),
        None => {
            let (source, path) = (folder.path().join("terrain.las"), folder.path().join("terrain.esker"));
            generate(Kind::Terrain, 1_500_000, 1, &source, &GenerateOptions::default(), &mut |_| true)?;
            ingest(&path, &[source], &IngestOptions::default(), &())?;
            path
        }
    };
    let (gpu, renderer) = Gpu::new()?;
    println!("{} threads, drawn by {}\n", rayon::current_num_threads(), renderer.adapter_name());
    stages(&Store::open(&path)?, &gpu, &renderer)?;
    first_pictures(&path, &renderer)?;
    primitives::compare()
}

/// Median, least and greatest, in nanoseconds for each of `points`.
fn spread(mut times: Vec<Duration>, points: u64) -> String {
    times.sort_unstable();
    let ns = |time: Duration| time.as_nanos() as f64 / points.max(1) as f64;
    format!("{:.1} ({:.1}-{:.1})", ns(median(&times)), ns(times[0]), ns(times[times.len() - 1]))
}

fn median(times: &[Duration]) -> Duration {
    let mut times = times.to_vec();
    times.sort_unstable();
    times[times.len() / 2]
}

fn timed<T>(times: &mut Vec<Duration>, work: impl FnOnce() -> T) -> T {
    let started = Instant::now();
    let done = work();
    times.push(started.elapsed());
    done
}

fn bounds(snapshot: &Snapshot) -> Result<WorldBox, Error> {
    let all = snapshot.scans().iter().filter_map(|s| s.bounds).reduce(|a, b| a.union(&b)).ok_or("no points")?;
    let world = |p| snapshot.site().lattice.world_from_lattice(p);
    Ok(WorldBox::new(world(all.min), world(all.max)).ok_or("no box")?)
}

/// What is shown, and how its values are coloured.
fn coloring(snapshot: &Snapshot) -> Result<Coloring, Error> {
    let has = |name: &str| snapshot.attributes().iter().any(|a| a.attribute.name == name);
    let depths = ColorDepths::of_scans(snapshot.scans().iter().map(|s| (s.id, s.color_depth)));
    let options = ColorOptions { mode: ColorMode::Rgb.resolved(has)?, depths, ..ColorOptions::default() };
    Ok(Coloring::new(&[], &snapshot.site().lattice, &options)?)
}

fn limits(points: u64) -> Limits {
    Limits { points, error_px: 0.0, ..Limits::default() }
}

/// The stream's own stages, one after the other.
fn stages(store: &Store, gpu: &Gpu, renderer: &Renderer) -> Result<(), Error> {
    let snapshot = store.snapshot()?;
    let camera = Camera::looking_at_all(&bounds(&snapshot)?, SIZE_PX)?;
    let coloring = coloring(&snapshot)?;
    let shown = Shown { scans: ScanChoice::default(), filter: None, paint: coloring.paint.clone() };
    let content = StoreSource::new(store.clone()).open_now(&shown)?;
    let stored: u64 = snapshot.scans().iter().map(|s| s.stored).sum();
    println!(
        "| points | select | load: read, decode, pack | of it reading, by core | of it decoding, by core | upload | draw | load, M points/s |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let mut frames = String::new();
    for budget in BUDGETS {
        let [mut select, mut load, mut read, mut decode, mut upload, mut draw] = [const { Vec::new() }; 6];
        let (mut points, mut drawn) = (0, None);
        for _ in 0..RUNS {
            let blocks = limits(budget).blocks(BLOCK_POINTS) / 2;
            let view = stream::View {
                camera: camera.clone(),
                error_px: 0.0,
                points: budget,
                blocks,
                block_points: BLOCK_POINTS,
            };
            let wanted = timed(&mut select, || content.select_now(&view))?.wanted;
            points = wanted.points;
            let mut loaded: Vec<Loaded> = Vec::new();
            // Ten milliseconds after half a second of drawing tell more of what the caches had forgotten than of loading.
            for _ in 0..LEAST_LOADED.div_ceil(budget) {
                loaded.clear();
                let before = content.statistics();
                loaded = timed(&mut load, || {
                    wanted.parts.par_iter().map(|part| content.load_now(part)).collect::<Result<_, _>>()
                })?;
                let after = content.statistics();
                read.push(Duration::from_secs_f64(after.seconds_reading - before.seconds_reading));
                decode.push(Duration::from_secs_f64(after.seconds_decoding - before.seconds_decoding));
            }
            let blocks = loaded.iter().map(|p| p.points.len().div_ceil(BLOCK_POINTS as usize)).sum::<usize>();
            let mut pool = renderer.pool(blocks as u32, BLOCK_POINTS)?;
            let list = timed(&mut upload, || -> Result<_, Error> {
                let list = uploaded(&wanted, &loaded, &mut pool, &snapshot, coloring.paint.tag())?;
                renderer.finish()?;
                Ok(list)
            })?;
            let mut canvas = renderer.canvas(false);
            let view = View { camera: &camera, options: &RenderOptions::default(), palette: &coloring.palette };
            timed(&mut draw, || renderer.render_list(&mut canvas, &pool.points(), &list, view))?;
            drawn = Some((pool, list));
        }
        if let Some((pool, list)) = drawn {
            let camera = camera.clone().with_size(WINDOW_PX)?;
            let [whole, encoding] = gpu.frames(renderer, &pool.points(), &list, &camera, &coloring.palette)?;
            let rate = 1.0 / median(&whole).as_secs_f64();
            let (whole, encoding) = (spread(whole, MILLISECONDS), spread(encoding, MILLISECONDS));
            frames += &format!("| {points} | {} | {whole} | {encoding} | {rate:.0} |\n", list.blocks.len());
        }
        let each = points as f64 / median(&load).as_secs_f64() / 1e6;
        println!(
            "| {points} | {} | {} | {} | {} | {} | {} | {each:.0} |",
            spread(select, points),
            spread(load, points),
            spread(read, points),
            spread(decode, points),
            spread(upload, points),
            spread(draw, points),
        );
        if budget >= stored {
            break;
        }
    }
    let [width, height] = WINDOW_PX;
    println!("\n| points | blocks | frame of {width} x {height}, ms | of it this thread, ms | frames a second |");
    println!("|---|---|---|---|---|\n{frames}");
    Ok(())
}

/// A stream with its own threads and a pool on the adapter, as a window has it: from opening the store to a first closed
/// picture, and to all points of the budget. Nothing is drawn.
fn first_pictures(path: &Path, renderer: &Renderer) -> Result<(), Error> {
    println!("\n| points | first picture, ms | its points | complete, ms | uploaded | pool |");
    println!("|---|---|---|---|---|---|");
    for budget in BUDGETS {
        let [mut first, mut complete] = [const { Vec::new() }; 2];
        let (mut points, mut uploaded, mut pool_bytes, mut first_points) = (0, 0, 0, 0);
        for _ in 0..RUNS {
            let pool = renderer.pool(limits(budget).blocks(BLOCK_POINTS), BLOCK_POINTS)?;
            let started = Instant::now();
            let store = Store::open(path)?;
            let snapshot = store.snapshot()?;
            let camera = Camera::looking_at_all(&bounds(&snapshot)?, SIZE_PX)?;
            let paint = coloring(&snapshot)?.paint;
            let shown = Shown { scans: ScanChoice::default(), filter: None, paint };
            let lattice = snapshot.site().lattice.clone();
            let source = Arc::new(StoreSource::new(store));
            let stream = Stream::spawn(source, Box::new(pool), shown, limits(budget), lattice, || ())?;
            stream.set_camera(&camera);
            while stream.front().list.points == 0 {
                std::thread::sleep(Duration::from_micros(200));
            }
            first.push(started.elapsed());
            first_points = stream.front().list.points;
            while !stream.status().complete {
                std::thread::sleep(Duration::from_micros(200));
            }
            complete.push(started.elapsed());
            let status = stream.status();
            (points, uploaded, pool_bytes) = (status.points, status.uploaded_bytes, status.pool_bytes);
        }
        let ms = |times: Vec<Duration>| spread(times, MILLISECONDS);
        println!(
            "| {points} | {} | {first_points} | {} | {uploaded} | {:.0} MB |",
            ms(first),
            ms(complete),
            pool_bytes as f64 / 1e6
        );
        if points < budget {
            break;
        }
    }
    println!();
    Ok(())
}

fn uploaded(
    wanted: &Wanted,
    loaded: &[Loaded],
    pool: &mut GpuPool,
    snapshot: &Snapshot,
    paint: u64,
) -> Result<DrawList, Error> {
    let mut list = DrawList::empty(snapshot.site().lattice.clone(), paint);
    // In node-key order, as a list must be; parents come first in it.
    let mut order: BTreeMap<_, usize> = BTreeMap::new();
    for (i, node) in wanted.nodes.iter().enumerate() {
        order.insert((node.cube.node_key(), node.layer), i);
    }
    let mut place = vec![0; wanted.nodes.len()];
    for (at, &i) in (0..).zip(order.values()) {
        place[i] = at;
        let node = &wanted.nodes[i];
        let parent = node.parent.map(|p| place[p as usize]);
        let (cube, layer, spacing) = (node.cube, node.layer, node.spacing_before);
        list.nodes.push(DrawNode { cube, layer, spacing, stand_in: false, parent });
    }
    let mut parts: Vec<usize> = (0..wanted.parts.len()).collect();
    parts.sort_by_key(|&i| (place[wanted.parts[i].node as usize], wanted.parts[i].part));
    let (mut next, mut counted) = (0, Vec::new());
    for i in parts {
        let (part, node) = (&wanted.parts[i], place[wanted.parts[i].node as usize]);
        counted.push((node, &*loaded[i].densities, 1.0));
        for (chunk, number) in loaded[i].points.chunks(BLOCK_POINTS as usize).zip(0..) {
            pool.write(BlockId(next), chunk)?;
            let (points, first) = (chunk.len() as u32, number * BLOCK_POINTS);
            list.blocks.push(DrawBlock { block: BlockId(next), points, node, part: part.part, first });
            list.points += u64::from(points);
            next += 1;
        }
    }
    set_spacings(&mut list, counted);
    Ok(list)
}

//! Figures of the query engine, as a table: `cargo bench --bench engine`. First the index of a billion points, made up of node
//! rows alone; then, where `ESKER_STORE` names a store, that store: selection, regions, caches, threads.

#![allow(missing_docs)]

use esker::codec::BlockSize;
use esker::geometry::{Camera, WorldBox};
use esker::lattice::{BIAS, Cube, Exactness, Lattice, LatticeBox, LatticePoint};
use esker::points::Batch;
use esker::query::{Answer, Detail, Query, Region, select_view};
use esker::store::model::{FORMAT_G, NodeHead, PartHead, Rejected, Scan, ScanCount, Step, Zones};
use esker::store::{Flip, Limits, NodeChange, SiteOptions, Snapshot, Store, Summary, merge_subtree};
use std::hint::black_box;
use std::path::Path;
use std::time::{Duration, Instant};

type Error = Box<dyn std::error::Error>;

/// Levels of a made-up quadtree below its root: 87,381 nodes.
const DEPTH: u8 = 8;
const POINTS_A_NODE: u32 = 13_000;

fn timed<T>(work: impl FnOnce() -> Result<T, Error>) -> Result<(T, Duration), Error> {
    let start = Instant::now();
    Ok((work()?, start.elapsed()))
}

/// The middle of some runs, and the outermost.
fn runs(n: usize, mut work: impl FnMut() -> Result<(), Error>) -> Result<String, Error> {
    let mut all = Vec::new();
    for _ in 0..n {
        all.push(timed(&mut work)?.1.as_secs_f64() * 1e3);
    }
    all.sort_by(f64::total_cmp);
    Ok(format!("{:.2} ms ({:.2} to {:.2}, {n} runs)", all[n / 2], all[0], all[n - 1]))
}

fn row(what: &str, figure: impl std::fmt::Display) {
    println!("{what:58} {figure}");
}

/// A flat site of full nodes, without a single chunk.
fn made_up(path: &Path) -> Result<(), Error> {
    let options = SiteOptions::new(Lattice::uniform(0.001)?);
    let (g, k) = (FORMAT_G, 15 + DEPTH);
    let store = Store::create(path, options)?;
    let mut writer = store.writer()?;
    let scan = writer.reserve_scan();
    let ids = writer.chunk_ids();
    let root = Cube::containing(LatticePoint([BIAS as u64; 3]), k);
    let mut nodes = Vec::new();
    fn add(
        nodes: &mut Vec<(NodeHead, Zones)>,
        cube: Cube,
        depth: u8,
        make: &mut dyn FnMut(Cube, bool) -> NodeHead,
    ) -> Summary {
        let mut head = make(cube, depth == DEPTH);
        let mut below = Vec::new();
        if depth < DEPTH {
            for child in (0..4).filter_map(|octant| cube.child(octant)) {
                head.children |= 1 << child.octant();
                below.push(add(nodes, child, depth + 1, make));
            }
        }
        let mut zones = Zones::default();
        let summary = merge_subtree(&mut head, &mut zones, &below);
        nodes.push((head, zones));
        summary
    }
    let mut make = |cube: Cube, leaf: bool| {
        let low = cube.low();
        let side = cube.side() - 1;
        let max = LatticePoint([low.0[0] + side, low.0[1] + side, root.low().0[2] + 300]);
        let step = Step { win: (cube.k() - g) as i8, group: 3 };
        let columns = |slots: std::ops::Range<u16>| slots.map(|slot| (slot, 9000)).collect();
        let part = PartHead {
            points: POINTS_A_NODE,
            block_size: BlockSize::LARGEST,
            first_step: Step { group: 1, ..step },
            last_step: Some(step),
            chunks: columns(0..8),
            packed: columns(8..18),
            packed_bytes: 90_060,
        };
        NodeHead {
            leaf,
            own_points: POINTS_A_NODE.into(),
            scans: vec![ScanCount { scan, own: POINTS_A_NODE.into(), subtree: POINTS_A_NODE.into() }],
            own_bounds: Some(LatticeBox { min: LatticePoint([low.0[0], low.0[1], root.low().0[2]]), max }),
            chunk_base: ids.reserve(1),
            parts: vec![part],
            ..NodeHead::without_points(0, cube)
        }
    };
    let all = add(&mut nodes, root, 0, &mut make);
    let scan = Scan {
        id: scan,
        name: "made up".into(),
        source: String::new(),
        source_bytes: 0,
        identity: [0; 32],
        time: 0,
        pose: std::array::from_fn(|i| f64::from(u8::from(i % 5 == 0))),
        read: all.points,
        stored: all.points,
        rejected: Rejected::default(),
        bounds: all.bounds,
        exactness: Exactness::Exact,
        largest_error: 0.0,
        format: "las".into(),
        las: None,
        color_depth: None,
        visible: true,
        attributes: Vec::new(),
        crs: None,
    };
    let nodes = NodeChange::ReplaceAll(nodes);
    writer.commit(Flip { scans_added: vec![scan], roots: Some(vec![Some(root)]), nodes, ..Flip::default() })?;
    Ok(())
}

fn bounds(snapshot: &Snapshot) -> Result<WorldBox, Error> {
    let all = snapshot.scans().iter().filter_map(|s| s.bounds).reduce(|a, b| a.union(&b)).ok_or("no points")?;
    let world = |p| snapshot.site().lattice.world_from_lattice(p);
    Ok(WorldBox::new(world(all.min), world(all.max)).ok_or("no box")?)
}

/// From a corner over the site, so that near and far nodes count.
fn camera(snapshot: &Snapshot) -> Result<Camera, Error> {
    let all = bounds(snapshot)?;
    let (min, max) = (all.min(), all.max());
    let at = |part: f64, axis: usize| min[axis] + part * (max[axis] - min[axis]);
    let up = 0.02 * (max[0] - min[0]);
    let view = serde_json::json!({
        "eye": [at(0.4, 0), at(0.4, 1), max[2] + up], "target": [at(0.5, 0), at(0.5, 1), min[2]], "size": [1920, 1080],
    });
    let camera: Camera = serde_json::from_value(view)?;
    Ok(camera.reaching(&all))
}

fn selection(store: &Path) -> Result<(), Error> {
    let (snapshot, open) = timed(|| Ok(Store::open(store)?.snapshot()?))?;
    let nodes = snapshot.nodes();
    let (_, roots) = timed(|| Ok(nodes.roots()?))?;
    row("open, snapshot and root rows", format!("{:.2} ms", (open + roots).as_secs_f64() * 1e3));
    let (lattice, g) = (&snapshot.site().lattice, snapshot.site().g);
    for (name, camera) in
        [("near", camera(&snapshot)?), ("all", Camera::looking_at_all(&bounds(&snapshot)?, [1920, 1080])?)]
    {
        let select = || Ok(select_view(&nodes, lattice, g, &camera, 1.0, Some(2_000_000))?);
        let (found, cold) = timed(select)?;
        row(
            &format!("view selection ({name}), first"),
            format!(
                "{:.2} ms, {} nodes visited, {} points",
                cold.as_secs_f64() * 1e3,
                found.nodes_visited,
                found.points
            ),
        );
        row(&format!("view selection ({name}), warm"), runs(51, || select().map(|s| drop(black_box(s))))?);
    }
    let (loads, bytes) = nodes.loaded();
    row("pages loaded, and bytes of rows in memory", format!("{loads}, {:.1} MiB", bytes as f64 / f64::from(1 << 20)));
    let (index, whole) = timed(|| Ok(snapshot.index()?))?;
    row("all rows at once, for comparison", format!("{} nodes, {:.1} ms", index.len(), whole.as_secs_f64() * 1e3));
    Ok(())
}

fn read(query: &Query, snapshot: &Snapshot) -> Result<Answer, Error> {
    let mut batches = query.batches(snapshot)?;
    for batch in &mut batches {
        black_box::<Batch>(batch?);
    }
    Ok(batches.answer())
}

fn speed(name: &str, query: &Query, snapshot: &Snapshot) -> Result<(), Error> {
    read(query, snapshot)?;
    let mut all: Vec<(f64, u64)> = Vec::new();
    for _ in 0..5 {
        let (answer, time) = timed(|| read(query, snapshot))?;
        all.push((time.as_secs_f64(), answer.points));
    }
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let rate = |(time, points): (f64, u64)| points as f64 / time / 1e6;
    row(
        name,
        format!("{:.1} M points/s ({:.1} to {:.1}), {} points", rate(all[2]), rate(all[4]), rate(all[0]), all[2].1),
    );
    Ok(())
}

/// A box of the plan that begins at a part of the way along each axis and takes a part of each.
fn region(all: &WorldBox, from: [f64; 2], part: f64) -> Result<Region, Error> {
    let at = |axis: usize, t: f64| all.min()[axis] + t * (all.max()[axis] - all.min()[axis]);
    let inf = f64::INFINITY;
    let (x, y) = (from[0], from[1]);
    Ok(Region::new_box([at(0, x), at(1, y), -inf], [at(0, x + part), at(1, y + part), inf])?)
}

fn regions(path: &Path) -> Result<(), Error> {
    let once = Store::open_with(path, Limits::once())?.snapshot()?;
    let kept = Store::open(path)?;
    let all = bounds(&once)?;
    let colors = Query::new().attributes(["Red", "Green", "Blue"]);
    speed("whole store, positions and colours", &colors, &once)?;
    speed("a quarter of the plan, positions and colours", &colors.clone().region(region(&all, [0.3; 2], 0.5)?), &once)?;
    speed("27 % of the plan, all attributes", &Query::new().region(region(&all, [0.2; 2], 0.52)?), &once)?;
    speed("everything, all attributes", &Query::new(), &once)?;
    for error in [0.25, 1.0, 4.0] {
        speed(&format!("--max-error {error}, all attributes"), &Query::new().detail(Detail::MaxError(error)), &once)?;
    }
    speed("--capacity 1,000,000, all attributes", &Query::new().capacity(1_000_000), &once)?;
    let hundredth = Query::new().region(region(&all, [0.45; 2], 0.1)?);
    let snapshot = kept.snapshot()?;
    row("1 % of the plan, all attributes, nothing kept", runs(21, || read(&hundredth, &once).map(drop))?);
    row("the same from the cache", runs(21, || read(&hundredth, &snapshot).map(drop))?);
    println!("{:?}", kept.cache_figures());

    // Random boxes of 100,000 points and more.
    let mut seed = 1_u64;
    let mut random = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 11) as f64 / (1_u64 << 53) as f64
    };
    let (mut decoded, mut bytes) = (Vec::new(), Vec::new());
    while decoded.len() < 200 {
        let part = 0.07 + 0.4 * random() * random();
        let from = [random() * (1.0 - part), random() * (1.0 - part)];
        let answer = read(&Query::new().region(region(&all, from, part)?), &once)?;
        if answer.points >= 100_000 {
            decoded.push(answer.statistics.points_decoded as f64 / answer.points as f64);
            bytes.push(answer.statistics.bytes_read as f64 / answer.statistics.bytes_needed.max(1) as f64);
        }
    }
    for (name, mut ratios) in [("points decoded a point returned", decoded), ("bytes read a byte needed", bytes)] {
        ratios.sort_by(f64::total_cmp);
        let (median, most) = (ratios[ratios.len() / 2], ratios[ratios.len() - 1]);
        row(&format!("{name}, 200 boxes"), format!("median {median:.2}, most {most:.2}"));
    }

    // One decoding thread a query.
    let mixed: Vec<Query> = (0..64)
        .map(|i| {
            let from = [random() * 0.9, random() * 0.9];
            let query = Query::new().region(region(&all, from, 0.08)?).threads(1);
            Ok(match i % 3 {
                0 => query.attributes(["Red", "Green", "Blue"]),
                1 => query,
                _ => query.detail(Detail::Spacing(1.0)),
            })
        })
        .collect::<Result<_, Error>>()?;
    let throughput = |threads: usize| {
        let start = Instant::now();
        std::thread::scope(|scope| {
            let work = |first: usize| {
                let (mixed, once) = (&mixed, &once);
                move || mixed.iter().skip(first).step_by(threads).all(|query| read(query, once).is_ok())
            };
            let all: Vec<_> = (0..threads).map(|first| scope.spawn(work(first))).collect();
            assert!(all.into_iter().all(|thread| thread.join().unwrap_or(false)), "a query failed");
        });
        mixed.len() as f64 / start.elapsed().as_secs_f64()
    };
    throughput(1);
    let mut ratios: Vec<f64> = (0..5).map(|_| throughput(2) / throughput(1)).collect();
    ratios.sort_by(f64::total_cmp);
    row("two threads against one", format!("{:.2} times ({:.2} to {:.2})", ratios[2], ratios[0], ratios[4]));
    Ok(())
}

fn main() -> Result<(), Error> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("made-up.esker");
    made_up(&path)?;
    println!("a billion points, made up");
    selection(&path)?;
    if let Some(store) = std::env::var_os("ESKER_STORE") {
        println!("{}", store.display());
        selection(Path::new(&store))?;
        regions(Path::new(&store))?;
    }
    Ok(())
}

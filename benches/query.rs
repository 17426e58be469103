//! Queries of a generated store of 1.5 million points, warm: a box of a hundredth of the plan, everything with colours or
//! without, and the selection for a view. `cargo bench --bench query`.

#![allow(missing_docs)]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use esker::generate::{GenerateOptions, Kind, generate};
use esker::geometry::{Camera, WorldBox};
use esker::ingest::{IngestOptions, ingest};
use esker::query::{Query, Region, select_view};
use esker::store::{Snapshot, Store};
use std::hint::black_box;
use std::ops::ControlFlow;
use std::time::Duration;

type Error = Box<dyn std::error::Error>;

const POINTS: u64 = 1_500_000;

/// The bounds of all points.
fn bounds(snapshot: &Snapshot) -> Result<WorldBox, Error> {
    let all = snapshot.scans().iter().filter_map(|s| s.bounds).reduce(|a, b| a.union(&b)).ok_or("no points")?;
    let world = |p| snapshot.site().lattice.world_from_lattice(p);
    Ok(WorldBox::new(world(all.min), world(all.max)).ok_or("no box")?)
}

fn read_all(query: &Query, snapshot: &Snapshot) -> u64 {
    let mut points = 0;
    let ran = query.run(snapshot, |batch| {
        points += black_box(&batch).len() as u64;
        ControlFlow::Continue(())
    });
    assert_eq!(ran.map(|answer| answer.points).ok(), Some(points));
    points
}

fn run(criterion: &mut Criterion) -> Result<(), Error> {
    let folder = tempfile::tempdir()?;
    let (source, path) = (folder.path().join("terrain.las"), folder.path().join("terrain.esker"));
    generate(Kind::Terrain, POINTS, 1, &source, &GenerateOptions::default(), &mut |_| true)?;
    ingest(&path, &[source], &IngestOptions::default(), &())?;
    let snapshot = Store::open(&path)?.snapshot()?;
    let all = bounds(&snapshot)?;

    let mut group = criterion.benchmark_group("query");
    group.sample_size(20).measurement_time(Duration::from_secs(4));
    // A tenth of the width each way, from the middle on.
    let corner = |axis: usize, part: f64| all.min()[axis] + part * (all.max()[axis] - all.min()[axis]);
    let (min, max) = ([corner(0, 0.5), corner(1, 0.5)], [corner(0, 0.6), corner(1, 0.6)]);
    let inf = f64::INFINITY;
    let one = Query::new().region(Region::new_box([min[0], min[1], -inf], [max[0], max[1], inf])?);
    let whole = [
        ("box 1 %, all attributes", one),
        ("everything, positions", Query::new().positions_only()),
        ("everything, positions and colours", Query::new().attributes(["Red", "Green", "Blue"])),
    ];
    for (name, query) in &whole {
        group.throughput(Throughput::Elements(read_all(query, &snapshot)));
        group.bench_function(*name, |b| b.iter(|| read_all(query, &snapshot)));
    }
    let nodes = snapshot.nodes();
    let (lattice, g) = (&snapshot.site().lattice, snapshot.site().g);
    let camera = Camera::looking_at_all(&all, [1920, 1080])?;
    group.throughput(Throughput::Elements(nodes.len()));
    group.bench_function("view selection", |b| b.iter(|| select_view(&nodes, lattice, g, &camera, 1.0, Some(500_000))));
    group.finish();
    Ok(())
}

fn queries(criterion: &mut Criterion) {
    if let Err(error) = run(criterion) {
        panic!("{error}");
    }
}

criterion_group!(benches, queries);
criterion_main!(benches);

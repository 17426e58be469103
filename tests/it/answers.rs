//! Laws 4, 5 and 6 on real tiles: exact regions, honest error bounds, capacities that nest.

use crate::support::{Random, RawLas, data_folder, esker_ok};
use esker::ingest::{IngestOptions, ingest};
use esker::lattice::{Lattice, LatticePoint, SourceGrid, SourceMap};
use esker::points::Batch;
use esker::query::{Detail, Filter, Query, Region};
use esker::store::{Snapshot, Store};
use std::collections::{HashMap, HashSet};
use std::path::PathBuf;

/// A tile in a store, and its points read by other means.
struct Tile {
    name: String,
    snapshot: Snapshot,
    lattice: Lattice,
    /// Position, intensity, return number.
    points: Vec<(LatticePoint, u16, u8)>,
    _folder: tempfile::TempDir,
}

/// At least three real tiles, or generated ones.
fn tiles() -> Vec<Tile> {
    let folder = tempfile::tempdir().unwrap();
    let mut paths: Vec<PathBuf> = Vec::new();
    if let Some(data) = data_folder() {
        for name in [
            "pdal_autzen/autzen_trim_7.las",
            "ign_tiles/test_data_77050_627755_LA93_IGN69.laz",
            "lidr/MixedConifer.laz",
            "spanner_multiplatform/ALS_Clip.laz",
        ] {
            paths.extend(Some(data.join(name)).filter(|p| p.exists()));
        }
    }
    if paths.len() < 3 {
        for kind in ["terrain", "torus", "spheres"] {
            let path = folder.path().join(format!("{kind}.las"));
            esker_ok(&["generate", kind, "--points", "60000", "-o", path.to_str().unwrap()]);
            paths.push(path);
        }
    }
    paths.iter().map(|p| tile(p)).collect()
}

fn tile(path: &std::path::Path) -> Tile {
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("tile.esker");
    ingest(&store, &[path.to_owned()], &IngestOptions::default(), &()).unwrap();
    let snapshot = Store::open(&store).unwrap().snapshot().unwrap();
    let lattice = snapshot.site().lattice.clone();
    let raw = RawLas::read(path).unwrap();
    let h = &raw.header;
    let scale = [h.x_scale_factor, h.y_scale_factor, h.z_scale_factor];
    let offset = [h.x_offset, h.y_offset, h.z_offset];
    let map = SourceMap::new(&SourceGrid::from_f64(scale, offset).unwrap(), &lattice).unwrap();
    let legacy = h.point_data_record_format & 0x3f < 6;
    let points = raw
        .records
        .iter()
        .map(|r| {
            let x = |i: usize| i32::from_le_bytes(r[4 * i..4 * i + 4].try_into().unwrap());
            let p = LatticePoint(std::array::from_fn(|i| map.to_lattice(i, x(i)).unwrap()));
            (p, u16::from_le_bytes([r[12], r[13]]), r[14] & if legacy { 7 } else { 15 })
        })
        .collect();
    let name = path.file_name().unwrap().to_string_lossy().into_owned();
    Tile { name, snapshot, lattice, points, _folder: folder }
}

impl Tile {
    fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        let b = self.snapshot.scans()[0].bounds.unwrap();
        (self.lattice.world_from_lattice(b.min), self.lattice.world_from_lattice(b.max))
    }

    /// A coordinate on axis `i`: anywhere around, or exactly a point's.
    fn coordinate(&self, random: &mut Random, i: usize) -> f64 {
        let (min, max) = self.bounds();
        match random.below(8) {
            0 => self.lattice.world_on_axis(i, self.points[random.below(self.points.len() as u64) as usize].0.0[i]),
            1 => f64::INFINITY * if random.below(2) == 0 { 1.0 } else { -1.0 },
            _ => min[i] + (max[i] - min[i]) * (random.unit() * 1.2 - 0.1),
        }
    }

    fn region(&self, random: &mut Random) -> Region {
        if random.below(3) == 0 {
            let centre = std::array::from_fn(|i| {
                loop {
                    let c = self.coordinate(random, i);
                    if c.is_finite() {
                        break c;
                    }
                }
            });
            let (min, max) = self.bounds();
            let radius = match random.below(6) {
                0 => 0.0,
                1 => 1e9,
                _ => (max[0] - min[0]) * random.unit() * 0.4,
            };
            return Region::new_sphere(centre, radius).unwrap();
        }
        let (mut low, mut high) = ([0.0; 3], [0.0; 3]);
        for i in 0..3 {
            let (a, b) = (self.coordinate(random, i), self.coordinate(random, i));
            (low[i], high[i]) = if random.below(20) == 0 { (a, a) } else { (a.min(b), a.max(b)) };
        }
        Region::new_box(low, high).unwrap()
    }
}

/// Of intensity and return number.
type Matches = Box<dyn Fn(u16, u8) -> bool>;

/// A filter, and the same in Rust.
fn filter(random: &mut Random) -> (Option<Filter>, Matches) {
    let level = random.below(120) as u16;
    match random.below(4) {
        0 => (Some(Filter::parse(&format!("Intensity > {level}")).unwrap()), Box::new(move |i, _| i > level)),
        1 => (
            Some(Filter::parse(&format!("ReturnNumber = 1 or Intensity between 10 and {level}")).unwrap()),
            Box::new(move |i, r| r == 1 || (10..=level).contains(&i)),
        ),
        _ => (None, Box::new(|_, _| true)),
    }
}

fn sorted(batch: &Batch) -> Vec<LatticePoint> {
    let mut points: Vec<_> = batch.positions.iter().collect();
    points.sort_unstable();
    points
}

#[test]
fn regions_with_filters_equal_brute_force() {
    let regions = if std::env::var_os("ESKER_SWEEP").is_some() { 10_000 } else { 1000 };
    for tile in tiles() {
        let mut random = Random(7);
        let mut hits = 0;
        for n in 0..regions {
            let region = tile.region(&mut random);
            let (filter, matches) = filter(&mut random);
            let on_lattice = region.on_lattice(&tile.lattice).unwrap();
            let mut expected: Vec<_> = tile
                .points
                .iter()
                .filter(|(p, i, r)| on_lattice.contains(*p) && matches(*i, *r))
                .map(|(p, ..)| *p)
                .collect();
            expected.sort_unstable();
            let mut query = Query::new().region(region.clone()).positions_only();
            if let Some(filter) = filter.clone() {
                query = query.filter(filter);
            }
            hits += usize::from(!expected.is_empty());
            assert_eq!(
                query.count(&tile.snapshot).unwrap().points,
                expected.len() as u64,
                "{}: region {n}: {region:?} {filter:?}",
                tile.name
            );
            if n % 10 == 0 {
                let (batch, answer) = query.collect(&tile.snapshot).unwrap();
                assert_eq!(answer.error_bound, Some(0.0));
                assert!(sorted(&batch) == expected, "{}: region {n}: {region:?} {filter:?}", tile.name);
            }
        }
        assert!(hits > regions / 4, "{}: only {hits} regions hold a point", tile.name);
    }
}

/// The largest distance from a point of `all` to the nearest of `some`, cut at a little more than `limit`.
pub fn hausdorff(lattice: &Lattice, all: &[LatticePoint], some: &[LatticePoint], limit: f64) -> f64 {
    let cell = limit.max(1e-9);
    let at = |p: &LatticePoint| lattice.world_from_lattice(*p);
    let of = |w: [f64; 3]| w.map(|c| (c / cell).floor() as i64);
    let mut grid: HashMap<[i64; 3], Vec<[f64; 3]>> = HashMap::new();
    for p in some {
        grid.entry(of(at(p))).or_default().push(at(p));
    }
    let mut largest = 0.0_f64;
    for p in all {
        let (w, c) = (at(p), of(at(p)));
        let mut nearest = f64::INFINITY;
        for n in 0..27 {
            let key = [c[0] + n % 3 - 1, c[1] + n / 3 % 3 - 1, c[2] + n / 9 - 1];
            for q in grid.get(&key).into_iter().flatten() {
                nearest = nearest.min((0..3).map(|i| (w[i] - q[i]).powi(2)).sum::<f64>().sqrt());
            }
        }
        largest = largest.max(nearest);
    }
    largest
}

#[test]
fn reported_bounds_hold_for_details_capacities_and_filters() {
    for tile in tiles() {
        let mut random = Random(11);
        let (min, max) = tile.bounds();
        for n in 0..40 {
            // Also boxes thinner than a cell.
            let region = match n % 4 {
                0 => Region::Everything,
                1 => {
                    let x = tile.coordinate(&mut random, 0).clamp(min[0], max[0]);
                    let inf = f64::INFINITY;
                    Region::new_box([x, -inf, -inf], [x + 0.05, inf, inf]).unwrap()
                }
                _ => tile.region(&mut random),
            };
            let (filter, matches) = filter(&mut random);
            let on_lattice = region.on_lattice(&tile.lattice).unwrap();
            let all: Vec<_> = tile
                .points
                .iter()
                .filter(|(p, i, r)| on_lattice.contains(*p) && matches(*i, *r))
                .map(|(p, ..)| *p)
                .collect();
            let mut query = Query::new().region(region.clone()).positions_only();
            if let Some(filter) = filter.clone() {
                query = query.filter(filter);
            }
            let size = (max[0] - min[0]).max(max[1] - min[1]);
            let query = match random.below(4) {
                0 => query.detail(Detail::Level(random.below(8) as u32)),
                1 => query.detail(Detail::MaxError(size * random.unit() * 0.1)),
                2 => query.detail(Detail::Spacing(size * random.unit() * 0.05 + 1e-6)),
                _ => query.capacity(random.below(all.len() as u64 + 10)),
            };
            let (batch, answer) = query.collect(&tile.snapshot).unwrap();
            let some = sorted(&batch);
            let context = format!("{}: {n}: {query:?}", tile.name);
            let known: HashSet<_> = all.iter().collect();
            assert!(some.iter().all(|p| known.contains(p)), "{context}: a point that does not match");
            match answer.error_bound {
                _ if all.is_empty() => assert!(some.is_empty()),
                None => assert!(some.is_empty(), "{context}: no bound though there are points"),
                Some(bound) => {
                    let error = hausdorff(&tile.lattice, &all, &some, bound * 1.001 + 1e-6);
                    assert!(error <= bound * (1.0 + 1e-9) + 1e-9, "{context}: {error} > {bound}");
                }
            }
        }
    }
}

#[test]
fn capacities_are_exact_and_nest() {
    for tile in tiles() {
        let mut random = Random(13);
        for n in 0..12 {
            let region = if n == 0 { Region::Everything } else { tile.region(&mut random) };
            let (filter, _) = filter(&mut random);
            let mut query = Query::new().region(region).positions_only();
            if let Some(filter) = filter {
                query = query.filter(filter);
            }
            let matching = query.count(&tile.snapshot).unwrap().points;
            let mut before: HashMap<LatticePoint, usize> = HashMap::new();
            let mut bound_before = f64::INFINITY;
            let mut capacities: Vec<u64> = (0..5).map(|_| random.below(matching + 2)).collect();
            capacities.extend([0, 1, 7, 100, matching, matching + 1000]);
            capacities.sort_unstable();
            for capacity in capacities {
                let (batch, answer) = query.clone().capacity(capacity).collect(&tile.snapshot).unwrap();
                assert_eq!(answer.points, capacity.min(matching), "{}", tile.name);
                assert_eq!(batch.len() as u64, answer.points);
                let mut now: HashMap<LatticePoint, usize> = HashMap::new();
                batch.positions.iter().for_each(|p| *now.entry(p).or_default() += 1);
                assert!(
                    before.iter().all(|(p, n)| now.get(p).is_some_and(|m| m >= n)),
                    "{}: capacity {capacity} loses a point of a smaller one",
                    tile.name
                );
                if let Some(bound) = answer.error_bound {
                    assert!(bound <= bound_before, "{}: a larger capacity has a worse bound", tile.name);
                    bound_before = bound;
                }
                before = now;
            }
        }
    }
}

//! Laws 4, 5 and 6 for everything together: random regions, filters, details and scans on real tiles equal brute force,
//! the naive sampling rule, or keep their promise. One scan owns every coarse winner, and is often hidden.

use crate::answers::hausdorff;
use crate::support::{Random, RawLas, data_folder, esker_ok, las_like};
use esker::geometry::{Camera, DVec3, Projection};
use esker::ingest::{IngestOptions, LatticeWish, ingest};
use esker::lattice::{Key, Lattice, LatticePoint, SourceGrid, SourceMap};
use esker::query::{Detail, Filter, Polygons, Query, Region};
use esker::store::{Snapshot, Store};
use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::path::Path;

#[derive(Clone, Copy)]
struct Point {
    at: LatticePoint,
    key: Key,
    intensity: u16,
    /// Synthetic, key point, withheld, overlap.
    flags: u8,
    scan: usize,
}

/// Scans of one tile in one store: two halves, and the winners of the coarse cells.
const SCANS: [&str; 3] = ["north", "south", "winners"];

/// What a filter means.
type Matches = Box<dyn Fn(&Point) -> bool>;

struct Site {
    snapshot: Snapshot,
    lattice: Lattice,
    points: Vec<Point>,
    /// The exponent of the root.
    k: u8,
    hidden: Option<usize>,
    _folder: tempfile::TempDir,
}

/// Sets the flags of a record to some that look random.
fn flag(record: &mut [u8], point_format: u8) -> u8 {
    let mix = record.iter().fold(7_u64, |m, b| (m ^ u64::from(*b)).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    // Each in a fourth of the points.
    let some = |shift: u64| u8::from(mix >> shift & 3 == 0);
    let flags = some(40) | some(44) << 1 | some(48) << 2 | some(52) << 3;
    if point_format < 6 {
        record[15] = record[15] & 31 | flags << 5;
        flags & 7
    } else {
        record[15] = record[15] & !15 | flags;
        flags
    }
}

/// A site of some thousand points of a file, in few large nodes or in many small ones.
fn site(path: &Path, hidden: Option<usize>, small: bool) -> Site {
    let folder = tempfile::tempdir().unwrap();
    let name = |n: &str| folder.path().join(n).to_str().unwrap().to_owned();
    esker_ok(&["ingest", &name("whole.esker"), path.to_str().unwrap()]);
    esker_ok(&["query", &name("whole.esker"), "--capacity", "8000", "-o", &name("thin.las")]);
    let raw = RawLas::read(Path::new(&name("thin.las"))).unwrap();
    let original = fs::read(name("thin.las")).unwrap();
    let h = &raw.header;
    let grid = SourceGrid::from_f64(
        [h.x_scale_factor, h.y_scale_factor, h.z_scale_factor],
        [h.x_offset, h.y_offset, h.z_offset],
    );
    let place = |record: &[u8], lattice: &Lattice| {
        let map = SourceMap::new(&grid.unwrap(), lattice).unwrap();
        let x = |i: usize| i32::from_le_bytes(record[4 * i..4 * i + 4].try_into().unwrap());
        LatticePoint(std::array::from_fn(|i| map.to_lattice(i, x(i)).unwrap()))
    };
    let lattice = Store::open(Path::new(&name("whole.esker"))).unwrap().snapshot().unwrap().site().lattice.clone();
    let mut records: Vec<(Point, Vec<u8>)> = raw
        .records
        .iter()
        .map(|r| {
            let (at, mut record) = (place(r, &lattice), r.clone());
            let flags = flag(&mut record, h.point_data_record_format);
            let intensity = u16::from_le_bytes([r[12], r[13]]);
            (Point { at, key: Key::of(at), intensity, flags, scan: 0 }, record)
        })
        .collect();
    records.sort_by_key(|(p, _)| p.key);
    let (min, max) = records.iter().fold(([u64::MAX; 3], [0; 3]), |(a, b), (p, _)| {
        (std::array::from_fn(|i| a[i].min(p.at.0[i])), std::array::from_fn(|i| b[i].max(p.at.0[i])))
    });
    let coarse = (0..3).map(|i| 64 - (max[i] - min[i]).leading_zeros() as u8).max().unwrap().saturating_sub(4);
    let mut before = None;
    for (n, (point, _)) in records.iter_mut().enumerate() {
        let wins = before.replace(point.key.prefix(coarse)) != Some(point.key.prefix(coarse));
        point.scan = if wins { 2 } else { n % 2 };
    }
    for (scan, file) in SCANS.iter().enumerate() {
        let own: Vec<Vec<u8>> = records.iter().filter(|(p, _)| p.scan == scan).map(|(_, r)| r.clone()).collect();
        assert!(own.len() > 20);
        fs::write(name(&format!("{file}.las")), las_like(&original, &own)).unwrap();
    }
    let store = name("site.esker");
    let phase = lattice.phase().map(|p| p.to_f64());
    let wish = LatticeWish { quantum: Some(lattice.quantum_f64()), phase: Some(phase) };
    let mut options = IngestOptions { lattice: wish, ..IngestOptions::default() };
    if small {
        (options.g, options.leaf_capacity) = (3, 40);
    }
    let put = |names: &[&str]| {
        let files: Vec<_> = names.iter().map(|n| folder.path().join(n)).collect();
        ingest(Path::new(&store), &files, &options, &()).unwrap();
    };
    put(&["north.las", "south.las"]);
    put(&["winners.las"]);
    if let Some(hidden) = hidden {
        esker_ok(&["hide", &store, SCANS[hidden]]);
    }
    let snapshot = Store::open(Path::new(&store)).unwrap().snapshot().unwrap();
    let differing = (0..3).fold(0, |d, i| d | (min[i] ^ max[i]));
    let k = (64 - differing.leading_zeros() as u8).max(snapshot.site().g);
    Site { snapshot, lattice, points: records.into_iter().map(|r| r.0).collect(), k, hidden, _folder: folder }
}

impl Site {
    fn any(&self, random: &mut Random) -> &Point {
        &self.points[random.below(self.points.len() as u64) as usize]
    }

    /// On a point, on a corner of a cell, or anywhere around.
    fn place(&self, random: &mut Random) -> [f64; 3] {
        let (a, b) = (self.any(random).at, self.any(random).at);
        std::array::from_fn(|i| match random.below(4) {
            0 => self.lattice.world_on_axis(i, a.0[i]),
            1 => {
                let k = random.below(self.k.into());
                self.lattice.world_on_axis(i, a.0[i] >> k << k)
            }
            _ => {
                let (x, y) = (self.lattice.world_on_axis(i, a.0[i]), self.lattice.world_on_axis(i, b.0[i]));
                x + (y - x) * random.unit()
            }
        })
    }

    fn size(&self) -> f64 {
        self.lattice.largest_quantum() * 2_f64.powi(self.k.into())
    }

    fn shape(&self, random: &mut Random) -> Region {
        let (a, b) = (self.place(random), self.place(random));
        let inf = f64::INFINITY;
        match random.below(7) {
            0 => Region::Everything,
            1 => {
                let flat = random.below(10) == 0;
                let low = std::array::from_fn(|i| a[i].min(b[i]));
                Region::new_box(low, std::array::from_fn(|i| if flat && i == 0 { low[0] } else { a[i].max(b[i]) }))
                    .unwrap()
            }
            2 => Region::new_sphere(a, (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt() * 0.6).unwrap(),
            3 => {
                let size = std::array::from_fn(|i| (a[i] - b[i]).abs());
                Region::new_oriented_box(a, size, [random.unit() * 360.0, random.unit() * 40.0, 90.0]).unwrap()
            }
            4 => {
                let projection = Projection::Perspective { fov_y_rad: 0.2 + random.unit() };
                let eye = DVec3::from_array(a) + DVec3::Z * self.size() * random.unit();
                match Camera::new(eye, DVec3::from_array(b), DVec3::new(0.1, 0.9, 0.2), projection, [400, 300]) {
                    Ok(camera) => Region::new_frustum(&camera),
                    Err(_) => Region::Everything,
                }
            }
            _ => {
                // A star around a place, with a hole, its corners often on points and corners of cells.
                let n = 3 + random.below(7) as usize;
                let radius = self.size() * (0.02 + 0.4 * random.unit());
                let corner = |i: usize, radius: f64, random: &mut Random| {
                    let angle = std::f64::consts::TAU * (i as f64 + 0.8 * random.unit()) / n as f64;
                    let world = [a[0] + radius * angle.cos(), a[1] + radius * angle.sin(), a[2]];
                    let k = random.below(3) * random.below(self.k.saturating_sub(6).into());
                    let p = self.lattice.lattice_from_world(world).unwrap();
                    [0, 1].map(|i| if k > 0 { self.lattice.world_on_axis(i, p.0[i] >> k << k) } else { world[i] })
                };
                let outer: Vec<_> = (0..n).map(|i| corner(i, radius * (0.6 + 0.4 * random.unit()), random)).collect();
                let inner: Vec<_> = (0..n).map(|i| corner(i, radius * 0.2, random)).collect();
                let mut z = [a[2].min(b[2]), a[2].max(b[2])];
                if random.below(2) == 0 {
                    z = [-inf, inf];
                }
                match Polygons::new(&[vec![outer, inner]]) {
                    Ok(area) => Region::new_prism(area, z).unwrap(),
                    Err(_) => Region::Everything,
                }
            }
        }
    }

    fn region(&self, random: &mut Random) -> Region {
        let a = self.shape(random);
        match random.below(6) {
            0 => Region::all([a, self.shape(random)]),
            1 => Region::any([a, self.shape(random)]),
            2 => a.inverted(),
            3 => Region::all([a, self.shape(random).inverted()]),
            _ => a,
        }
    }

    /// A filter, and what it means.
    fn filter(&self, random: &mut Random) -> (Option<String>, Matches) {
        let level = self.any(random).intensity;
        match random.below(11) {
            0 => (Some(format!("Intensity > {level}")), Box::new(move |p| p.intensity > level)),
            1 => (
                Some(format!("not Intensity in ({level}, 3)")),
                Box::new(move |p| p.intensity != level && p.intensity != 3),
            ),
            2 => (Some("Intensity < 0".into()), Box::new(|_| false)),
            3 => {
                let one = self.any(random).at;
                let text = ["X", "Y", "Z"].iter().enumerate().map(|(i, axis)| {
                    let exact = self.lattice.decimal_on_axis(i, one.0[i]);
                    format!("{axis} = {}e{}", exact.mantissa(), exact.exponent())
                });
                (Some(text.collect::<Vec<_>>().join(" and ")), Box::new(move |p| p.at == one))
            }
            4 => (Some("scan <> 'south'".into()), Box::new(|p| p.scan != 1)),
            5 => (
                Some("scan in ('north', 'winners') and Withheld = 0".into()),
                Box::new(|p| p.scan != 1 && p.flags & 4 == 0),
            ),
            6 => (Some("Synthetic = 1 or not KeyPoint = 1".into()), Box::new(|p| p.flags & 1 == 1 || p.flags & 2 == 0)),
            7 => (
                Some(format!("withheld = 1 and Intensity <= {level}")),
                Box::new(move |p| p.flags & 4 == 4 && p.intensity <= level),
            ),
            _ => (None, Box::new(|_| true)),
        }
    }
}

fn counted(points: impl Iterator<Item = LatticePoint>) -> BTreeMap<LatticePoint, usize> {
    let mut counted = BTreeMap::new();
    points.for_each(|p| *counted.entry(p).or_default() += 1);
    counted
}

fn check(site: &Site, random: &mut Random, n: usize) {
    let region = site.region(random);
    let (filter, passes) = site.filter(random);
    let scans: Option<Vec<usize>> = match random.below(6) {
        0 => Some(vec![random.below(3) as usize]),
        1 => Some(vec![0, 2]),
        _ => None,
    };
    let on = region.on_lattice(&site.lattice).unwrap();
    let seen = |scan: usize| scans.as_ref().map_or(site.hidden != Some(scan), |s| s.contains(&scan));
    let matching: Vec<&Point> = site.points.iter().filter(|p| seen(p.scan) && on.contains(p.at) && passes(p)).collect();
    let mut query = Query::new().region(region.clone()).positions_only();
    if let Some(filter) = &filter {
        query = query.filter(Filter::parse(filter).unwrap());
    }
    if let Some(scans) = &scans {
        query = query.scans(scans.iter().map(|&s| SCANS[s]));
    }
    let context = format!("case {n}, hidden {:?}: {region:?} {filter:?} {scans:?}", site.hidden);
    let quantum = site.lattice.largest_quantum();
    let at = |p: &&Point| p.at;
    let all: Vec<LatticePoint> = matching.iter().map(at).collect();
    // The least matching point of every cell of this exponent.
    let level = |c: u8| -> Vec<LatticePoint> {
        let mut before = None;
        matching.iter().filter(|p| before.replace(p.key.prefix(c)) != Some(p.key.prefix(c))).map(at).collect()
    };
    let c = random.below(u64::from(site.k) + 1) as u8;
    let spacing = Detail::Spacing(quantum * 2_f64.powi(c.into()) * 1.01);
    let promised = |query: &Query| {
        let (batch, answer) = query.collect(&site.snapshot).unwrap();
        assert_eq!(batch.len() as u64, answer.points, "{context}");
        let found: Vec<LatticePoint> = batch.positions.iter().collect();
        match answer.error_bound {
            None => assert!(found.is_empty(), "{context}: no bound"),
            Some(bound) if n.is_multiple_of(4) && !all.is_empty() => {
                let error = hausdorff(&site.lattice, &all, &found, bound * 1.001 + 1e-6);
                assert!(error <= bound * (1.0 + 1e-9) + 1e-9, "{context}: {error} > {bound}");
            }
            Some(_) => {}
        }
        (found, answer.error_bound)
    };
    match random.below(6) {
        0 | 1 => {
            let (found, bound) = promised(&query);
            assert_eq!(counted(found.into_iter()), counted(all.iter().copied()), "{context}");
            assert_eq!(bound, Some(0.0));
            assert_eq!(query.count(&site.snapshot).unwrap().points, all.len() as u64, "{context}");
        }
        2 | 3 => {
            let query = query.detail(spacing);
            let (found, _) = promised(&query);
            assert_eq!(counted(found.into_iter()), counted(level(c).into_iter()), "{context} at cell {c}");
            assert_eq!(query.count(&site.snapshot).unwrap().points, level(c).len() as u64, "{context}");
        }
        4 => {
            let error = site.size() * random.unit() * 0.2;
            let (found, bound) = promised(&query.detail(Detail::MaxError(error)));
            assert!(all.is_empty() || bound.unwrap() <= error, "{context}");
            let (found, of) = (counted(found.into_iter()), counted(all.iter().copied()));
            assert!(found.iter().all(|(p, n)| of.get(p).is_some_and(|m| m >= n)), "{context}");
        }
        _ => {
            // The first points of one sequence, with and without a level.
            let (query, of) =
                if random.below(2) == 0 { (query.detail(spacing), level(c)) } else { (query, all.clone()) };
            let capacity = random.below(of.len() as u64 + 3);
            let (fewer, bound) = promised(&query.clone().capacity(capacity));
            assert_eq!(fewer.len() as u64, capacity.min(of.len() as u64), "{context}");
            let (more, better) = promised(&query.capacity(capacity + 1 + random.below(50)));
            let (fewer, more, of) = (counted(fewer.into_iter()), counted(more.into_iter()), counted(of.into_iter()));
            assert!(fewer.iter().all(|(p, n)| more.get(p).is_some_and(|m| m >= n)), "{context}: does not nest");
            assert!(more.iter().all(|(p, n)| of.get(p).is_some_and(|m| m >= n)), "{context}: does not match");
            assert!(bound.is_none_or(|b| better.unwrap() <= b), "{context}: a larger capacity has a worse bound");
        }
    }
}

#[test]
fn random_combinations_equal_brute_force() {
    let cases = if std::env::var_os("ESKER_SWEEP").is_some() { 10_000 } else { 1000 };
    let folder = tempfile::tempdir().unwrap();
    let mut paths: Vec<_> = ["pdal_autzen/autzen_trim_7.las", "lidr/MixedConifer.laz"]
        .iter()
        .filter_map(|name| Some(data_folder()?.join(name)).filter(|p| p.exists()))
        .collect();
    for kind in ["terrain", "torus"].iter().skip(paths.len()) {
        let path = folder.path().join(format!("{kind}.las"));
        esker_ok(&["generate", kind, "--points", "40000", "-o", path.to_str().unwrap()]);
        paths.push(path);
    }
    let sites: Vec<Site> =
        (0..).zip(&paths).flat_map(|(i, p)| [site(p, None, i % 2 == 0), site(p, Some(2), i % 2 == 1)]).collect();
    let mut random = Random(17);
    let mut kinds: HashMap<bool, usize> = HashMap::new();
    for n in 0..cases {
        let site = &sites[n % sites.len()];
        check(site, &mut random, n);
        *kinds.entry(site.hidden.is_some()).or_default() += 1;
    }
    assert_eq!(kinds.len(), 2);
}

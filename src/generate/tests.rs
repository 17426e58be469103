//! Counts, repeatability, and that a model is what it says.

use super::*;
use std::collections::BTreeMap;
use std::fs;

fn options() -> GenerateOptions {
    GenerateOptions::default()
}

fn read(path: &Path) -> Vec<las::Point> {
    let mut reader = las::Reader::from_path(path).unwrap();
    reader.read_all().unwrap().points().map(Result::unwrap).collect()
}

/// The bytes of all files of a model, made with this many threads.
fn bytes(kind: Kind, points: u64, seed: u64, threads: usize) -> BTreeMap<String, Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    let path = if kind == Kind::Site { folder.path().join("site") } else { folder.path().join("model.las") };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let report = pool.install(|| generate(kind, points, seed, &path, &options(), &mut |_| true)).unwrap();
    assert_eq!(report.points, points);
    let name = |p: &Path| p.file_name().unwrap().to_str().unwrap().to_owned();
    report.files.iter().map(|(p, _)| (name(p), fs::read(p).unwrap())).collect()
}

#[test]
fn a_seed_gives_the_same_bytes_with_any_number_of_threads() {
    for kind in Kind::ALL {
        let one = bytes(kind, 70_000, 7, 1);
        assert!(one == bytes(kind, 70_000, 7, 3), "{}", kind.word());
        assert!(one != bytes(kind, 70_000, 8, 3), "{}", kind.word());
    }
}

#[test]
fn bytes_are_the_same_on_every_machine() {
    // Digests from the first machine: they change only if a model does, which a user should be told.
    for (kind, expected) in GOLDEN {
        let mut hasher = blake3::Hasher::new();
        for file in bytes(kind, 40_000, 1, 2).into_values() {
            // Without the header's first bytes: they name the version of the program.
            hasher.update(&file[107..]);
        }
        assert_eq!(&hasher.finalize().to_hex()[..16], expected, "{}", kind.word());
    }
}

const GOLDEN: [(Kind, &str); 4] = [(Kind::Torus, ""), (Kind::Spheres, ""), (Kind::Terrain, ""), (Kind::Site, "")];

#[test]
fn counts_are_exact_also_around_blocks() {
    let folder = tempfile::tempdir().unwrap();
    for kind in [Kind::Torus, Kind::Spheres, Kind::Terrain] {
        for points in [0, 1, 2, BLOCK_POINTS - 1, BLOCK_POINTS, BLOCK_POINTS + 1] {
            let path = folder.path().join(format!("{}_{points}.laz", kind.word()));
            generate(kind, points, 3, &path, &options(), &mut |_| true).unwrap();
            assert_eq!(las::Reader::from_path(&path).unwrap().header().number_of_points(), points);
            assert_eq!(read(&path).len() as u64, points);
        }
    }
    for points in [0, 3, 17, 100_003] {
        let path = folder.path().join(format!("site_{points}"));
        let report = generate(Kind::Site, points, 3, &path, &options(), &mut |_| true).unwrap();
        let counts: Vec<_> = report.files.iter().map(|(p, n)| (read(p).len() as u64, *n)).collect();
        assert_eq!(counts.len(), 5);
        assert!(counts.iter().all(|(a, b)| a == b));
        assert_eq!(counts.iter().map(|c| c.0).sum::<u64>(), points);
    }
}

#[test]
fn a_torus_is_a_torus() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("t.las");
    generate(Kind::Torus, 20_000, 1, &path, &options(), &mut |_| true).unwrap();
    for p in read(&path) {
        let (x, y, z) = (p.x - points::ORIGIN[0], p.y - points::ORIGIN[1], p.z - points::ORIGIN[2]);
        let ring = (x * x + y * y).sqrt() - 100.0;
        assert!(((ring * ring + z * z).sqrt() - 40.0).abs() < 0.002, "{x} {y} {z}");
    }
}

#[test]
fn terrain_has_classes_returns_and_colours_that_belong_together() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("t.las");
    generate(Kind::Terrain, 200_000, 1, &path, &options(), &mut |_| true).unwrap();
    let points = read(&path);
    let mut classes = BTreeMap::<u8, usize>::new();
    for p in &points {
        *classes.entry(p.classification.into()).or_default() += 1;
        assert!((1..=p.number_of_returns).contains(&p.return_number));
        assert!(p.number_of_returns == 1 || u8::from(p.classification) != 6);
        assert!(p.color.is_some_and(|c| c.red % 257 == 0 && c.green > 0) && p.intensity > 0);
    }
    assert_eq!(classes.keys().copied().collect::<Vec<_>>(), [2, 5, 6]);
    assert!(classes.values().all(|&n| n > points.len() / 50), "{classes:?}");
    assert!(points.iter().any(|p| p.return_number == 3));
    assert!(points.windows(2).all(|w| w[0].gps_time <= w[1].gps_time));
}

#[test]
fn scans_of_a_site_overlap_and_thin_out_with_distance() {
    let folder = tempfile::tempdir().unwrap();
    let report = generate(Kind::Site, 250_000, 1, folder.path(), &options(), &mut |_| true).unwrap();
    let mut bounds = Vec::new();
    for (i, (path, _)) in report.files.iter().enumerate() {
        let station = site::Scan::new(1, i as u32, 5, 1).station();
        let points = read(path);
        let (x, y) = (station[0] + points::ORIGIN[0], station[1] + points::ORIGIN[1]);
        let ring = |a: f64, b: f64| {
            let inside = |p: &&las::Point| (a * a..b * b).contains(&((p.x - x) * (p.x - x) + (p.y - y) * (p.y - y)));
            points.iter().filter(inside).count() as f64 / (b * b - a * a)
        };
        assert!(ring(2.0, 8.0) > 3.0 * ring(8.0, 30.0) && ring(8.0, 30.0) > 3.0 * ring(30.0, 100.0));
        assert!(points.iter().all(|p| u32::from(p.point_source_id) == i as u32 + 1));
        assert!([2, 5, 6].iter().all(|c| points.iter().any(|p| u8::from(p.classification) == *c)));
        bounds.push(las::Reader::from_path(path).unwrap().header().bounds());
    }
    assert!(bounds.iter().all(|a| bounds.iter().all(|b| a.min.x < b.max.x && a.min.y < b.max.y)));
}

#[test]
fn requests_that_make_no_sense_are_refused_and_nothing_is_left() {
    let folder = tempfile::tempdir().unwrap();
    let ply = folder.path().join("a.ply");
    let error = generate(Kind::Torus, 1, 1, &ply, &options(), &mut |_| true).unwrap_err();
    assert!(error.to_string().contains(".las or .laz"));
    let none = GenerateOptions { scans: 0, ..options() };
    assert!(generate(Kind::Site, 1, 1, folder.path(), &none, &mut |_| true).is_err());
    let las = folder.path().join("a.las");
    let stopped = generate(Kind::Torus, 100, 1, &las, &options(), &mut |_| false).unwrap_err();
    assert!(matches!(stopped, GenerateError::Stopped));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);

    fs::write(folder.path().join("site_4.las"), b"mine").unwrap();
    let error = generate(Kind::Site, 10, 1, folder.path(), &options(), &mut |_| true).unwrap_err();
    assert!(error.to_string().contains("--force"));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    let force = GenerateOptions { force: true, ..options() };
    assert_eq!(generate(Kind::Site, 10, 1, folder.path(), &force, &mut |_| true).unwrap().points, 10);
}

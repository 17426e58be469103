//! `esker nearest` and `esker density` against brute force on the file's own coordinates, and Ctrl-C in what only reads.

use crate::support::{Random, TinyLas, esker, esker_fails, esker_ok};
use std::collections::BTreeMap;
use std::fs;
use std::io::Read;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// A store of random points; their coordinates.
fn site(folder: &tempfile::TempDir, points: usize) -> (String, Vec<[f64; 3]>) {
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (mut random, mut las) = (Random(11), TinyLas::new(3));
    for _ in 0..points {
        let at: [i32; 3] = std::array::from_fn(|i| random.below([4000, 3000, 200][i]) as i32 - 700);
        las.push(at, random.next());
    }
    fs::write(path("site.las"), las.bytes()).unwrap();
    esker_ok(&["ingest", &path("site.esker"), &path("site.las")]);
    (path("site.esker"), las.positions().into_iter().map(|p| p.map(|c| f64::from(c) / 100.0)).collect())
}

#[test]
fn neighbours_of_many_places_are_those_of_brute_force() {
    let folder = tempfile::tempdir().unwrap();
    // Several blocks a node; places in no order, many to a group and more than one group, some of them far outside.
    let (store, points) = site(&folder, 50_000);
    let mut random = Random(5);
    let places: Vec<[f64; 3]> = (0..700)
        .map(|n| {
            let wide = if n % 10 == 0 { 60_000 } else { 4000 };
            std::array::from_fn(|i| (random.below([wide, wide, 400][i]) as f64 - 800.0) / 100.0)
        })
        .collect();
    let text: String = places.iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect();
    let list = folder.path().join("places.txt");
    fs::write(&list, text).unwrap();
    let found = esker_ok(&["nearest", &store, "--places", list.to_str().unwrap(), "-k", "3", "--attributes", "none"]);
    let rows = table(&found);
    assert_eq!(rows.len(), 3 * places.len());
    for (n, (place, rows)) in places.iter().zip(rows.chunks(3)).enumerate() {
        let square = |p: &[f64; 3]| (0..3).map(|i| (p[i] - place[i]).powi(2)).sum::<f64>();
        let mut all: Vec<f64> = points.iter().map(square).collect();
        all.select_nth_unstable_by(3, f64::total_cmp);
        all[..3].sort_by(f64::total_cmp);
        for (row, expected) in rows.iter().zip(&all) {
            assert_eq!(row[3], n as f64);
            let found = square(&[row[0], row[1], row[2]]);
            assert!((found - expected).abs() < 1e-9 && (row[4] - expected.sqrt()).abs() < 1e-9, "{place:?}: {row:?}");
        }
    }
}

/// The lines of a table after the first, as numbers.
fn table(text: &str) -> Vec<Vec<f64>> {
    text.lines().skip(1).map(|line| line.split(',').map(|v| v.parse().unwrap()).collect()).collect()
}

#[test]
fn neighbours_and_densities_come_out_of_the_shell() {
    let folder = tempfile::tempdir().unwrap();
    let (store, points) = site(&folder, 3000);
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();

    let places = [[3.0, 4.0, -6.5], [100.0, 0.0, 0.0], [-7.0, -7.0, -7.0]];
    fs::write(path("places.txt"), "x y z\n3 4 -6.5\n100 0 0\n# none\n-7\t-7\t-7\tnote\n").unwrap();
    let found = esker_ok(&["nearest", &store, "--places", &path("places.txt"), "-k", "5", "--attributes", "none"]);
    assert_eq!(found.lines().next(), Some("X,Y,Z,Place,Distance"));
    let rows = table(&found);
    assert_eq!(rows.len(), 15);
    for (n, place) in places.iter().enumerate() {
        let away = |p: &[f64; 3]| (0..3).map(|i| (p[i] - place[i]).powi(2)).sum::<f64>().sqrt();
        let mut all: Vec<f64> = points.iter().map(away).collect();
        all.sort_by(f64::total_cmp);
        for (row, expected) in rows[5 * n..].iter().zip(&all[..5]) {
            assert_eq!(row[3], n as f64);
            assert!((row[4] - expected).abs() < 1e-9 && (away(&[row[0], row[1], row[2]]) - expected).abs() < 1e-9);
        }
    }
    // Within a radius, under a filter, to a file.
    let csv = path("near.csv");
    let report = esker_ok(&[
        "nearest", &store, "--at", "3,4,-6.5", "-k", "1000", "--radius", "4", "--where", "Z < -6", "-o", &csv, "--json",
    ]);
    let within =
        |p: &&[f64; 3]| p[2] < -6.0 && (p[0] - 3.0).powi(2) + (p[1] - 4.0).powi(2) + (p[2] + 6.5).powi(2) <= 16.0;
    let expected = points.iter().filter(within).count();
    assert!(expected > 3 && table(&fs::read_to_string(&csv).unwrap()).len() == expected);
    assert_eq!(serde_json::from_str::<serde_json::Value>(&report).unwrap()["neighbours"], expected);
    esker_fails(&["nearest", &store, "--at", "3,4"], 2, &["'3,4' for '--at", "X, Y and Z"]);
    esker_fails(&["nearest", &store, "--at", "3,4,nan"], 2, &["'nan' is no number"]);
    esker_fails(&["nearest", &store, "--at", "3,4,5", "-o", &path("a.las")], 2, &["no place for Place"]);
    esker_fails(&["nearest", &store, "--at", "3,4,1e300"], 1, &["coordinate", "from -1e150 to 1e150"]);
    esker_fails(&["nearest", &store], 2, &["--at"]);

    let mut squares: BTreeMap<[i64; 2], (f64, f64, f64)> = BTreeMap::new();
    for p in &points {
        // Sides of a power of two, so that dividing is exact.
        let square = squares.entry([0, 1].map(|i| (p[i] / 2.0).floor() as i64)).or_insert((0.0, p[2], p[2]));
        *square = (square.0 + 1.0, square.1.min(p[2]), square.2.max(p[2]));
    }
    let rows = table(&esker_ok(&["density", &store, "--side", "2", "-o", "-", "--format", "csv"]));
    assert_eq!(rows.len(), squares.len());
    for row in &rows {
        let at = [0, 1].map(|i| (row[i] / 2.0).floor() as i64);
        assert_eq!((row[2], row[3], row[4]), squares[&at], "{row:?}");
    }
    // Sides that are no float, exactly: with the centres the nearest floats.
    for tenths in [1, 3, 11] {
        let mut squares: BTreeMap<[i64; 2], f64> = BTreeMap::new();
        for p in &points {
            let at = [0, 1].map(|i| ((p[i] * 100.0).round() as i64).div_euclid(10 * tenths));
            *squares.entry(at).or_default() += 1.0;
        }
        let centre = |n: i64| format!("{}e-2", 10 * tenths * n + 5 * tenths).parse::<f64>().unwrap();
        let mut expected: Vec<[f64; 3]> = squares.iter().map(|(at, &n)| [centre(at[0]), centre(at[1]), n]).collect();
        let side = format!("0.{tenths}").replace("0.11", "1.1");
        let rows = table(&esker_ok(&["density", &store, "--side", &side, "-o", "-", "--format", "csv"]));
        let mut found: Vec<[f64; 3]> = rows.iter().map(|row| [row[0], row[1], row[2]]).collect();
        for all in [&mut expected, &mut found] {
            all.sort_by(|a, b| a.partial_cmp(b).unwrap());
        }
        assert!(found == expected, "{side}");
    }
    let none = path("none.asc");
    esker_fails(&["density", &store, "--side", "2", "--where", "Z > 1000", "-o", &none], 1, &["no points match"]);
    assert!(!fs::exists(&none).unwrap());
    let grid = path("density.asc");
    let words = esker_ok(&["density", &store, "--side", "2", "-o", &grid]);
    assert!(words.contains("3,000") && words.contains("fullest"), "{words}");
    let text = fs::read_to_string(&grid).unwrap();
    let head: BTreeMap<&str, f64> =
        text.lines().take(6).map(|l| l.split_once(' ').unwrap()).map(|(k, v)| (k, v.parse().unwrap())).collect();
    assert_eq!((head["xllcorner"], head["yllcorner"], head["cellsize"]), (-8.0, -8.0, 2.0));
    let values: Vec<f64> = text.lines().skip(6).flat_map(|l| l.split(' ')).map(|v| v.parse().unwrap()).collect();
    assert_eq!(values.len() as f64, head["ncols"] * head["nrows"]);
    assert_eq!(values.iter().sum::<f64>(), 3000.0);
    // The last line is the southernmost, which begins with the square at the corner.
    let southwest = text.lines().last().unwrap().split(' ').next().unwrap();
    assert_eq!(southwest.parse::<f64>().unwrap(), squares.get(&[-4, -4]).map_or(0.0, |s| s.0));
    esker_fails(&["density", &store, "--side", "2", "-o", &grid], 1, &["--force"]);
    // Beside a grid lies its CRS, if the site has one.
    assert!(!fs::exists(path("density.prj")).unwrap());
    let (cloud, utm) = (path("utm.xyz"), path("utm.esker"));
    fs::write(&cloud, "500000 5000000 1\n500001 5000000 2\n").unwrap();
    let wkt = r#"PROJCS["UTM 32",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],UNIT["metre",1]]"#;
    esker_ok(&["ingest", &utm, &cloud, "--crs", wkt]);
    let words = esker_ok(&["density", &utm, "--side", "2", "-o", &path("utm.asc")]);
    assert!(words.contains("points per square metre"), "{words}");
    assert_eq!(fs::read_to_string(path("utm.prj")).unwrap(), format!("{wkt}\n"));
    fs::remove_file(path("utm.asc")).unwrap();
    esker_fails(&["density", &utm, "--side", "2", "-o", &path("utm.asc")], 1, &["utm.prj", "--force"]);
    assert!(!fs::exists(path("utm.asc")).unwrap());
    // One of another site would say where this one is: it goes, where it may.
    fs::write(path("density.prj"), wkt).unwrap();
    fs::remove_file(&grid).unwrap();
    esker_fails(&["density", &store, "--side", "2", "-o", &grid], 1, &["density.prj", "--force"]);
    assert!(!fs::exists(&grid).unwrap() && fs::exists(path("density.prj")).unwrap());
    esker_ok(&["density", &store, "--side", "2", "-o", &grid, "--force"]);
    assert!(fs::exists(&grid).unwrap() && !fs::exists(path("density.prj")).unwrap());
    esker_fails(&["density", &store, "--side", "0"], 2, &["positive"]);
    esker_fails(&["density", &store, "--side", "2", "-o", &path("a.tif")], 2, &["'tif'", ".asc"]);
    esker_fails(&["density", &store, "--side", "1e-7"], 1, &["2^28"]);
    assert!(!esker(&["density", &store]).status.success());
}

#[test]
fn the_ranges_that_info_tells_are_those_of_the_points() {
    let folder = tempfile::tempdir().unwrap();
    let (store, _) = site(&folder, 2000);
    let json = |arguments: &[&str]| serde_json::from_str::<serde_json::Value>(&esker_ok(arguments)).unwrap();
    let (info, read) = (json(&["info", &store, "--json"]), json(&["query", &store, "--json"]));
    let mut compared = 0;
    for told in info["attributes"].as_array().unwrap() {
        let found = read["attributes"].as_array().unwrap().iter().find(|a| a["name"] == told["name"]);
        if let (Some(found), false) = (found, told["min"].is_null()) {
            let ends = |v: &serde_json::Value| [&v["min"], &v["max"]].map(|end| end.as_f64().unwrap());
            assert_eq!(ends(told), ends(found), "{told}");
            compared += 1;
        }
    }
    assert!(compared > 8, "{info}");
}

#[cfg(unix)]
#[test]
fn an_interrupted_query_ends_at_once_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (store, _) = site(&folder, 40_000);
    let temporary = folder.path().join("temporary");
    fs::create_dir(&temporary).unwrap();
    // Nobody reads on, so the program waits in the middle of handing its file over.
    let mut child = Command::new(env!("CARGO_BIN_EXE_esker"))
        .args(["query", &store, "-o", "-", "--format", "las"])
        .env("TMPDIR", &temporary)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut first = [0];
    child.stdout.as_mut().unwrap().read_exact(&mut first).unwrap();
    assert_eq!(fs::read_dir(&temporary).unwrap().count(), 1);
    let start = Instant::now();
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let status = child.wait().unwrap();
    assert_eq!(status.code(), Some(130));
    assert!(start.elapsed() < Duration::from_secs(5));
    assert_eq!(fs::read_dir(&temporary).unwrap().count(), 0);
    esker_ok(&["verify", &store]);
}

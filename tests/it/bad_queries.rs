//! Queries that make no sense: one clear line each, and no file.

use crate::support::{TinyLas, esker, esker_fails, esker_ok};
use std::fs;

/// A site of a few points in metres, in a projected CRS.
fn site(folder: &tempfile::TempDir) -> (String, impl Fn(&str) -> String + '_) {
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let mut las = TinyLas::new(3);
    for n in 0..500_i32 {
        las.push([77_000_000 + n * 7 % 10_000, 627_700_000 + n * 13 % 10_000, n % 900], n as u64 * 7919 * 4099);
    }
    fs::write(path("site.las"), las.bytes()).unwrap();
    esker_ok(&["ingest", &path("site.esker"), &path("site.las"), "--crs", "EPSG:2154"]);
    (path("site.esker"), path)
}

#[test]
fn regions_are_refused_with_the_place_and_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let (store, path) = site(&folder);
    let refused = |arguments: &[&str], words: &[&str]| {
        esker_fails(&[&["query", store.as_str(), "--count"], arguments].concat(), 1, words);
    };
    let misspelt = |arguments: &[&str], words: &[&str]| {
        esker_fails(&[&["query", store.as_str(), "--count"], arguments].concat(), 2, words);
    };
    misspelt(&["--box", "10,0,5,5"], &["x from 10 to 5", "smaller number first"]);
    misspelt(&["--box", "nan,0,5,5"], &["\"nan\" is not a number"]);
    misspelt(&["--box", "1,2,3"], &["4 numbers", "there are 3"]);
    misspelt(&["--box", "a,2,3,4"], &["\"a\" is not a number"]);
    misspelt(&["--sphere", "1,2,3,-4"], &["radius", "-4"]);
    misspelt(&["--sphere", "1,2,inf,4"], &["finite"]);
    misspelt(&["--obox", "1,2,3,4,-5,6,0"], &["-5", "0 or more"]);
    misspelt(&["--obox", "1,2,3,4"], &["7 numbers"]);
    misspelt(&["--z", "5,1"], &["z from 5 to 1"]);
    refused(&["--polygon", "POLYGON((0 0, 10 0, 10 x, 0 0))"], &["column 24", "\"x\""]);
    refused(&["--polygon", "POLYGON((0 0, 10 0, 10 10)"], &["column 27", "the end"]);
    refused(&["--polygon", "POINT(1 2)"], &["column 1", "found POINT", "expected POLYGON"]);
    refused(&["--polygon", ""], &["empty text", "GeoJSON"]);
    refused(&["--polygon", "POLYGON((0 0, 10 10, 10 0, 0 10, 0 0))"], &["crosses itself", "0 0 to 10 10"]);
    refused(&["--polygon", "POLYGON((0 0, 10 0, 5 5), (20 20, 21 20, 21 21))"], &["hole 1", "outside", "20 20"]);
    refused(&["--polygon", "POLYGON((0 0, 1 1))"], &["three are the least"]);
    refused(&["--polygon", "{\"type\":\"Polygon\",\"coordinates\":[[[0,0],"], &["GeoJSON", "column"]);
    refused(&["--polygon", "{\"type\":\"LineString\",\"coordinates\":[[0,0],[1,1]]}"], &["LineString", "no area"]);
    fs::write(path("bad.wkt"), "POLYGON((0 0,\n 1 1,\n 2 ,))").unwrap();
    refused(&["--polygon", &path("bad.wkt")], &["bad.wkt", "line 3 column 4"]);
    refused(&["--polygon", &path("none.geojson")], &["none.geojson"]);
    refused(&["--polygon", "POLYGON((5.1 45.2, 5.2 45.2, 5.2 45.3, 5.1 45.2))"], &["degrees", "EPSG:2154", "770000"]);
    refused(&["--polygon", "SRID=4326;POLYGON((770000 6277000, 770100 6277000, 770100 6277100))"], &["4326", "2154"]);
    refused(&["--region", "box(1,2,3,4) and cube(1)"], &["column 18", "cube"]);
    refused(&["--region", "not (box(1,2,3,4)"], &["column 18", "\")\""]);
    fs::write(path("view.json"), "{\"eye\":[0,0,0],\"target\":[0,0,0]}").unwrap();
    refused(&["--frustum", &path("view.json")], &["view.json", "target"]);
    fs::write(path("clip.json"), "{\"clip_from_world\":[[1,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}").unwrap();
    refused(&["--frustum", &path("clip.json")], &["clip.json", "clip matrix"]);

    let coordinate = ["X is no attribute but a coordinate", "leave it out"];
    esker_fails(&["query", &store, "--attributes", "Intensity,X"], 1, &coordinate);

    // Beside the site is no error, but said.
    let beside = esker(&["query", &store, "--count", "--polygon", "POLYGON((0 6000000, 10 6000000, 10 6000010))"]);
    let words = String::from_utf8_lossy(&beside.stderr).into_owned();
    assert!(beside.status.success() && words.contains("outside the site") && words.contains("770000"), "{words}");
}

#[test]
fn names_details_and_policies_are_refused_with_what_there_is() {
    let folder = tempfile::tempdir().unwrap();
    let (store, path) = site(&folder);
    let refused = |code: i32, arguments: &[&str], words: &[&str]| {
        let output = esker(&[&["query", store.as_str()], arguments].concat());
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {stderr}");
        words.iter().for_each(|w| assert!(stderr.contains(w), "{arguments:?}: no '{w}' in {stderr}"));
    };
    refused(1, &["--where", "Intensty > 5"], &["\"Intensty\"", "\"Intensity\"", "^"]);
    refused(1, &["--where", "Intensity > 'high'"], &["numbers", "^"]);
    refused(1, &["--where", "scan = site"], &["names of scans are in quotes: scan = 'site'", "^"]);
    refused(1, &["--where", "Intensity between 1 or 2"], &["expected \"and\"", "^"]);
    refused(1, &["--where", "Intensity > nan"], &["nan"]);
    refused(1, &["--attributes", "Intensity,Clasification"], &["\"Clasification\"", "\"Classification\""]);
    refused(1, &["--scan", "sit"], &["\"sit\"", "\"site"]);
    refused(2, &["--capacity", "-5"], &["-5"]);
    refused(2, &["--capacity", "1.5"], &["1.5"]);
    refused(2, &["--max-error", "-1"], &["-1"]);
    refused(2, &["--max-error", "nan"], &["nan"]);
    refused(2, &["--spacing", "0"], &["0"]);
    refused(2, &["--level", "-1"], &["-1"]);
    refused(2, &["--max-error", "1", "--spacing", "1"], &["cannot be used"]);
    fs::write(path("view.json"), "{\"eye\":[770050,6277050,500],\"target\":[770050,6277050,0]}").unwrap();
    let view = path("view.json");
    refused(2, &["--view", &view, "--policy", "near"], &["near", "screen and distance"]);
    refused(2, &["--view", &view, "--policy", "distance,amount=-1"], &["amount", "-1"]);
    refused(1, &["--view", &view, "--policy", "distance", "--where", "Intensity > 5"], &["distance policy"]);
    refused(1, &["--view", &view, "--policy", "distance", "--spacing", "5"], &["distance policy", "leave out spacing"]);
    refused(1, &["--view", &view, "--policy", "distance", "--level", "0"], &["distance policy", "level"]);
    refused(2, &["--view", &view, "--policy", "distance", "--max-error-px", "9"], &["--max-error-px", "leave it out"]);
    refused(2, &["--split-by", "class", "-o", "-", "--format", "csv"], &["file name"]);
    refused(2, &["-o", &path("out.shp")], &["shp", ".npy"]);
    assert!(!folder.path().join("out.shp").exists());
}

#[test]
fn files_are_split_by_class_and_by_scan_in_one_pass() {
    let folder = tempfile::tempdir().unwrap();
    let (store, path) = site(&folder);
    let whole: usize = esker_ok(&["query", &store, "--capacity", "300", "--count"]).trim().parse().unwrap();
    for by in ["class", "scan"] {
        let report = esker_ok(&[
            "query",
            &store,
            "--capacity",
            "300",
            "--split-by",
            by,
            "-o",
            &path(&format!("{by}.csv")),
            "--json",
        ]);
        let report: serde_json::Value = serde_json::from_str(&report).unwrap();
        let files = report["outputs"].as_array().unwrap();
        assert!(if by == "class" { files.len() > 4 } else { files.len() == 1 }, "{}", files.len());
        let mut lines = 0;
        for file in files {
            let name = file["path"].as_str().unwrap();
            let text = fs::read_to_string(name).unwrap();
            let column = text.lines().next().unwrap().split(',').position(|c| c == "Classification").unwrap();
            let rows: Vec<&str> = text.lines().skip(1).map(|l| l.split(',').nth(column).unwrap()).collect();
            assert_eq!(rows.len() as u64, file["points"].as_u64().unwrap());
            assert!(by == "scan" || rows.iter().all(|c| name.ends_with(&format!("class_class{c}.csv"))), "{name}");
            lines += rows.len();
        }
        assert_eq!(lines, whole);
    }
}

#[test]
fn a_coordinate_that_could_be_an_attribute_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    fs::write(
        path("x.ply"),
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty double y\nproperty double z\n\
         property uchar X\nend_header\n1 2 3 9\n4 5 6 0\n",
    )
    .unwrap();
    let store = path("x.esker");
    esker_ok(&["ingest", &store, &path("x.ply")]);
    let count = |filter: &str| {
        let output = esker(&["query", &store, "--where", filter, "--attributes", "none", "-o", "-", "--format", "csv"]);
        let (rows, words) = (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap());
        assert!(output.status.success(), "{words}");
        (rows.lines().nth(1).unwrap_or("").to_owned(), words)
    };
    let (row, words) = count("x > 2");
    assert_eq!(row, "4,5,6");
    assert_eq!(
        words,
        "esker: x is taken as the coordinate; the attribute of that name is written \"x\", in double quotes\n"
    );
    assert_eq!(count("\"X\" > 2"), ("1,2,3".to_owned(), String::new()));
    assert_eq!(count("y > 2"), ("4,5,6".to_owned(), String::new()));
}

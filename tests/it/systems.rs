//! Coordinate reference systems that meet: what surely differs is refused, what can't be told is said.

use crate::support::{TinyLas, esker, esker_fails, esker_ok};
use std::fs;
use tempfile::TempDir;

struct Place(TempDir);

impl Place {
    /// Two files of a point each, that say nothing of their CRS.
    fn new() -> Self {
        let place = Self(tempfile::tempdir().unwrap());
        for (name, at) in [("a.las", [100, 200, 3]), ("b.las", [300, 100, 4])] {
            let mut las = TinyLas::new(1);
            las.push(at, 7);
            fs::write(place.path(name), las.bytes()).unwrap();
        }
        place
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().to_owned()
    }

    /// A store of one file in a CRS; what is told of it.
    fn store(&self, name: &str, file: &str, crs: &str) -> String {
        let output = esker(&["ingest", &self.path(name), &self.path(file), "--crs", crs]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8_lossy(&output.stderr).into_owned()
    }
}

const FEET: &str = r#"PROJCS["plane",UNIT["US survey foot",0.304800609601219]]"#;
const DEGREES: &str = r#"GEOGCS["globe",UNIT["degree",0.0174532925199433]]"#;

#[test]
fn feet_metres_and_degrees_never_meet_unnoticed() {
    let place = Place::new();
    let [s, b] = ["s.esker", "b.las"].map(|name| place.path(name));
    place.store("s.esker", "a.las", "EPSG:26917");
    for (crs, unit) in [(FEET, "plane in US survey foot"), (DEGREES, "globe in degree")] {
        let expected = ["b.las: its CRS is ", unit, "the site's is EPSG:26917 in metre", "--ignore-crs"];
        esker_fails(&["ingest", &s, &b, "--crs", crs], 1, &expected);
        place.store("other.esker", "b.las", crs);
        esker_fails(
            &["merge", &place.path("all.esker"), &s, &place.path("other.esker")],
            1,
            &[unit, "EPSG:26917 in metre"],
        );
        fs::remove_file(place.path("other.esker")).unwrap();
    }
    assert!(esker_ok(&["info", &s]).contains("scans        1\n"));
    // In whose name nothing is said of the unit it can't be told.
    let told = place.store("s.esker", "b.las", r#"LOCAL_CS["here"]"#);
    assert!(
        told.contains("can't tell whether its CRS (here) is the site's (EPSG:26917); its coordinates are taken"),
        "{told}"
    );
    place.store("here.esker", "b.las", r#"LOCAL_CS["here"]"#);
    place.store("there.esker", "a.las", "EPSG:26917");
    let merged = esker(&["merge", &place.path("all.esker"), &place.path("there.esker"), &place.path("here.esker")]);
    let told = String::from_utf8_lossy(&merged.stderr);
    assert!(merged.status.success() && told.contains("here.esker: can't tell whether its CRS (here)"), "{told}");
}

#[test]
fn degrees_are_told_and_so_is_what_can_be_none() {
    let place = Place::new();
    let told = place.store("near.esker", "a.las", "EPSG:4326");
    assert!(told.contains("degrees and metres") && told.contains("mix the two units"), "{told}");
    place.store("metres.esker", "a.las", "EPSG:25832");
    for (store, is_told) in [("near.esker", true), ("metres.esker", false)] {
        let output = esker(&["render", &place.path(store), "--size", "40x30", "--force", "-o", &place.path("a.png")]);
        let told = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && told.contains("as long as metres") == is_told, "{store}: {told}");
    }
    let mut las = TinyLas::new(1);
    las.push([33_900_200, 524_800_000, 0], 1);
    fs::write(place.path("far.las"), las.bytes()).unwrap();
    let told = place.store("far.esker", "far.las", "EPSG:4326");
    assert!(told.contains("far.las: its CRS (EPSG:4326) is in degrees, but its coordinates lie between"), "{told}");
}

#[test]
fn floats_in_degrees_keep_a_tenth_of_a_millimetre() {
    let place = Place::new();
    fs::write(place.path("rtk.csv"), "x,y,z\n11.50000012,48.10000034,512.345\n11.60000056,48.20000078,520.5\n")
        .unwrap();
    place.store("rtk.esker", "rtk.csv", "EPSG:4326");
    let out = place.path("out.csv");
    esker_ok(&["query", &place.path("rtk.esker"), "-o", &out]);
    let text = fs::read_to_string(out).unwrap();
    for coordinate in ["11.50000012", "48.10000034", "512.345", "11.60000056", "48.20000078"] {
        assert!(text.contains(coordinate), "{text}");
    }
}

#[test]
fn a_forgotten_store_is_told() {
    let place = Place::new();
    let [a, b] = ["a.las", "b.las"].map(|name| place.path(name));
    let before = fs::read(&a).unwrap();
    esker_fails(&["ingest", &a, &b], 1, &["a.las: is not an Esker store", "the store comes first: esker ingest STORE"]);
    assert_eq!(fs::read(&a).unwrap(), before);
}

#[test]
fn values_that_no_field_of_las_holds_are_told() {
    let place = Place::new();
    fs::write(place.path("f.csv"), "x,y,z,intensity,code\n1,2,3,0.5,1\n2,3,4,0.25,2\n").unwrap();
    let s = place.path("f.esker");
    esker_ok(&["ingest", &s, &place.path("f.csv")]);
    let told = |name: &str| {
        let output = esker(&["query", &s, "-o", &place.path(name)]);
        assert!(output.status.success());
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let las = told("f.las");
    assert!(
        las.contains("Intensity is f32 here: LAS's own field has it times 65,535, and an extra byte as it is"),
        "{las}"
    );
    let field = |name: &str| {
        let mut reader = las::Reader::from_path(place.path(name)).unwrap();
        let points = reader.read_all().unwrap();
        let mut found: Vec<u16> = points.points().map(|p| p.unwrap().intensity).collect();
        found.sort_unstable();
        found
    };
    // They were 0, and viewers showed black points.
    assert_eq!(field("f.las"), [16_384, 32_768]);
    assert!(!las.contains("code") && !told("f.ply").contains("field"));
    // Whole numbers of a scanner stay, others are brought to the field's range.
    for (values, how, expected) in [
        ("7.5\n2,3,4,65534.5", "as the nearest whole number", [8, 65_535]),
        ("-2048\n2,3,4,2047", "from -2048 to 2047 as 0 to 65,535", [0, 65_535]),
    ] {
        let s = place.path(&format!("{}.esker", expected[0]));
        fs::write(place.path("g.csv"), format!("x,y,z,intensity\n1,2,3,{values}\n")).unwrap();
        esker_ok(&["ingest", &s, &place.path("g.csv")]);
        let output = esker(&["query", &s, "-o", &place.path("g.las"), "--force"]);
        let las = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(las.contains(how), "{las}");
        assert_eq!(field("g.las"), expected);
    }
}

#[test]
fn hidden_scans_are_told_where_they_are_missed() {
    let place = Place::new();
    let [s, a, b] = ["s.esker", "a.las", "b.las"].map(|name| place.path(name));
    esker_ok(&["ingest", &s, &a, &b]);
    esker_ok(&["hide", &s, "a", "b"]);
    assert!(esker_ok(&["info", &s]).contains("scans        2 (2 hidden)\n"));
    let output = esker(&["query", &s, "--count"]);
    assert_eq!(output.stdout, b"0\n");
    assert!(String::from_utf8_lossy(&output.stderr).contains("2 of 2 scans are hidden"));
    for command in [&["density", &s, "--side", "1"][..], &["nearest", &s, "--at", "1,2,0"]] {
        let output = esker(command);
        assert!(String::from_utf8_lossy(&output.stderr).contains("2 of 2 scans are hidden"), "{command:?}");
    }
    let output = esker(&["query", &s, "--scan", "a", "--count"]);
    assert_eq!((output.stdout, output.stderr), (b"1\n".to_vec(), Vec::new()));
}

/// They were null, as where there are no values.
#[test]
fn infinite_values_are_told_in_json() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\n\
                property double v\nproperty double w\nend_header\n";
    fs::write(at("w.ply"), format!("{head}0 0 0 inf nan\n1 1 1 0.1 nan\n2 2 2 -inf nan\n")).unwrap();
    let store = at("w.esker");
    esker_ok(&["ingest", &store, &at("w.ply")]);
    let json =
        |command: &str| -> serde_json::Value { serde_json::from_str(&esker_ok(&[command, &store, "--json"])).unwrap() };
    let of = |report: &serde_json::Value, name: &str| {
        report["attributes"].as_array().unwrap().iter().find(|a| a["name"] == name).unwrap().clone()
    };
    let (v, w) = (of(&json("query"), "v"), of(&json("query"), "w"));
    assert_eq!((&v["min"], &v["max"], &v["mean"]), (&"-inf".into(), &"inf".into(), &serde_json::Value::Null));
    assert_eq!((&w["count"], &w["min"], &w["max"]), (&0.into(), &serde_json::Value::Null, &serde_json::Value::Null));
    let told = of(&json("info"), "v");
    assert_eq!((&told["min"], &told["max"]), (&"-inf".into(), &"inf".into()));
}

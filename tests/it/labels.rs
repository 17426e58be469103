//! `rename` and `set-crs`, and how new versions of files and unnamed CRS are met.

use crate::support::{esker, esker_fails, esker_ok};
use std::fs;

struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().to_owned()
    }

    fn file(&self, name: &str, text: &str) -> String {
        let path = self.path(name);
        fs::create_dir_all(std::path::Path::new(&path).parent().unwrap()).unwrap();
        fs::write(&path, text).unwrap();
        path
    }
}

fn json(arguments: &[&str]) -> serde_json::Value {
    serde_json::from_str(&esker_ok(&[arguments, &["--json"]].concat())).unwrap()
}

fn names(store: &str) -> Vec<String> {
    let scans = json(&["scans", store]);
    scans["scans"].as_array().unwrap().iter().map(|s| s["name"].as_str().unwrap().to_owned()).collect()
}

/// What a command that must succeed says on stderr.
fn told(arguments: &[&str]) -> String {
    let output = esker(arguments);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    String::from_utf8(output.stderr).unwrap()
}

/// A view file says of a bookmark what it is, and makes it again.
#[test]
fn bookmarks_are_kept_listed_printed_and_let_go() {
    let place = Place::new();
    let s = place.path("s.esker");
    esker_ok(&["ingest", &s, &place.file("a.csv", "x,y,z\n1,2,3\n2,3,5\n")]);
    let before = (esker_ok(&["digest", &s]), json(&["info", &s])["generation"].clone());
    assert_eq!(json(&["bookmark", &s]), serde_json::json!({ "bookmarks": [] }));
    assert!(told(&["bookmark", &s]).contains("has no bookmarks"));
    let door =
        r#"{"eye":[1,2,9],"target":[1,2,3],"up":[0,1,0],"projection":"perspective","fov_y_deg":60,"size":[300,200]}"#;
    let file = place.file("door.json", door);
    assert_eq!(esker_ok(&["bookmark", &s, "door", "--view", &file]), "door: kept\n");
    // The same again, and another one, are not lost unasked.
    let keep = ["bookmark", &s, "door", "--view", &file];
    esker_fails(&keep, 1, &["the store has a bookmark 'door'"]);
    let printed: serde_json::Value = serde_json::from_str(&esker_ok(&["bookmark", &s, "door"])).unwrap();
    assert_eq!(printed["fov_y_deg"], 60.0);
    let plan = door.replace(r#""perspective","fov_y_deg":60"#, r#""orthographic","height":4"#);
    let plan = place.file("plan.json", &plan);
    let told_json = json(&["bookmark", &s, "door", "--view", &plan, "--force"]);
    assert_eq!(told_json, serde_json::json!({ "name": "door", "done": "replaced" }));
    let printed = esker_ok(&["bookmark", &s, "door"]);
    let view: serde_json::Value = serde_json::from_str(&printed).unwrap();
    assert_eq!((&view["projection"], &view["height"]), (&"orthographic".into(), &4.0.into()));
    let back = place.file("back.json", &printed);
    assert_eq!(esker_ok(&["bookmark", &s, "front door", "--view", &back]), "front door: kept\n");
    let listed = esker_ok(&["bookmark", &s]);
    assert_eq!(listed.lines().count(), 2, "{listed}");
    assert!(listed.contains("door        from 1.000,2.000,9.000 to 1.000,2.000,3.000, parallel, 4.000"), "{listed}");
    let all = json(&["bookmark", &s]);
    assert_eq!([0, 1].map(|i| &all["bookmarks"][i]["name"]), [&"door", &"front door"]);
    assert_eq!(all["bookmarks"][0]["view"], view);
    // A view query takes it, and says the same as with the file.
    let asked = |camera: &[&str]| json(&[&["query", &s, "--max-error-px", "1"], camera].concat())["points"].clone();
    assert_eq!(asked(&["--bookmark", "door"]), asked(&["--view", &plan]));
    esker_fails(&["query", &s, "--bookmark", "gate"], 1, &["no bookmark 'gate'; there are: 'door', 'front door'"]);
    esker_fails(&["bookmark", &s, "gate", "--remove"], 1, &["no bookmark 'gate'"]);
    assert_eq!(esker_ok(&["bookmark", &s, "door", "--remove"]), "door: removed\n");
    esker_fails(&["bookmark", &s, "door"], 1, &["there are: 'front door'"]);
    esker_fails(&["bookmark", &s, " ", "--view", &file], 1, &["can't be empty"]);
    esker_fails(&["bookmark", &s, "x", "--view", &s], 1, &["reading the view failed"]);
    esker_fails(&["bookmark", &s, "--remove"], 2, &["NAME"]);
    assert_eq!(before, (esker_ok(&["digest", &s]), json(&["info", &s])["generation"].clone()));
    esker_ok(&["verify", &s, "--deep"]);
}

#[test]
fn a_scan_is_renamed_and_nothing_else() {
    let place = Place::new();
    let s = place.path("s.esker");
    esker_ok(&["ingest", &s, &place.file("a.csv", "x,y,z\n1,2,3\n"), &place.file("b.csv", "x,y,z\n4,5,6\n")]);
    let before = esker_ok(&["digest", &s]);
    assert_eq!(esker_ok(&["rename", &s, "a", "north wall"]), "a: is north wall now\n");
    assert_eq!(json(&["rename", &s, "2", "south"]), serde_json::json!({ "name": "south", "before": "b" }));
    assert_eq!(names(&s), ["north wall", "south"]);
    assert_eq!(esker_ok(&["digest", &s]), before);
    esker_ok(&["verify", &s, "--deep"]);
    assert_eq!(esker_ok(&["query", &s, "--scan", "north wall", "--count"]), "1\n");
    // Under its own name it is still the same source.
    assert!(esker_ok(&["ingest", &s, &place.path("a.csv")]).contains("already in the store as 'north wall'"));
    esker_fails(&["rename", &s, "south", "north wall"], 1, &["the store has another scan named 'north wall'"]);
    esker_fails(&["rename", &s, "west", "x"], 1, &["no scan 'west'"]);
    esker_fails(&["rename", &s, "south", " "], 1, &["can't be empty"]);
    // A clash was SQLite's own error.
    let replace = ["replace", &s, "south", "--name", "north wall"];
    esker_fails(&replace, 1, &["the store has another scan named 'north wall'; give another name"]);
    assert_eq!(names(&s), ["north wall", "south"]);
}

#[test]
fn a_site_is_given_a_crs() {
    let place = Place::new();
    let s = place.path("s.esker");
    esker_ok(&["ingest", &s, &place.file("a.csv", "x,y,z\n1,2,3\n")]);
    let said = esker_ok(&["set-crs", &s, "EPSG:25832+7837"]);
    assert!(said.ends_with("is in EPSG:25832 + EPSG:7837 now; before: unknown\n"), "{said}");
    let crs = || json(&["info", &s])["crs"].clone();
    assert_eq!((&crs()["horizontal_epsg"], &crs()["vertical_epsg"]), (&25832.into(), &7837.into()));
    esker_fails(
        &["set-crs", &s, "EPSG:25833"],
        1,
        &["the site's CRS is EPSG:25832 + EPSG:7837, not EPSG:25833", "--force"],
    );
    let again = json(&["set-crs", &s, "EPSG:25833", "--force"]);
    assert_eq!(again, serde_json::json!({ "crs": "EPSG:25833", "before": "EPSG:25832 + EPSG:7837" }));
    esker_fails(&["set-crs", &s, "UTM"], 2, &["UTM"]);
    // What holds nothing yet is given a site by whoever fills it.
    let lattice = esker::lattice::Lattice::uniform(0.01).unwrap();
    drop(esker::store::Store::create(place.path("e.esker"), esker::store::SiteOptions::new(lattice)).unwrap());
    esker_ok(&["set-crs", &place.path("e.esker"), "EPSG:25832"]);
    // Outputs say it, and inputs in others are refused.
    esker_ok(&["query", &s, "-o", &place.path("a.las")]);
    esker_ok(&["ingest", &place.path("t.esker"), &place.path("a.las")]);
    assert_eq!(json(&["info", &place.path("t.esker")])["crs"]["horizontal_epsg"], 25833);
    let other = place.file("b.csv", "x,y,z\n4,5,6\n");
    esker_fails(&["ingest", &s, &other, "--crs", "EPSG:25832"], 1, &["EPSG:25833"]);
    esker_ok(&["verify", &s, "--deep"]);
}

#[test]
fn a_scan_that_brings_the_first_crs_says_so() {
    let place = Place::new();
    let s = place.path("s.esker");
    let (a, b) = (place.file("a.csv", "x,y,z\n1,2,3\n"), place.file("b.csv", "x,y,z\n4,5,6\n"));
    assert!(!told(&["ingest", &s, &a]).contains("CRS"));
    let note = told(&["ingest", &s, &b, "--crs", "EPSG:25832"]);
    assert!(
        note.contains("the site had no CRS; it is EPSG:25832 now, which is taken for that of the scans that it has"),
        "{note}"
    );
    // A text that has the code is the same system.
    let wkt = r#"PROJCS["ETRS89 / UTM zone 32N",UNIT["metre",1],AUTHORITY["EPSG","25832"]]"#;
    let c = place.file("c.csv", "x,y,z\n7,8,9\n");
    assert!(!told(&["ingest", &s, &c, "--crs", wkt]).contains("CRS"));
}

/// The records of the source said nothing of it, and were written as they are.
#[test]
fn heights_that_are_given_a_system_say_so_in_las() {
    let place = Place::new();
    let (s, las, out) = (place.path("s.esker"), place.path("a.las"), place.path("out.las"));
    esker_ok(&["generate", "terrain", "--points", "500", "-o", &las]);
    esker_ok(&["ingest", &s, &las]);
    esker_ok(&["set-crs", &s, "EPSG:32632+5783"]);
    esker_ok(&["query", &s, "-o", &out]);
    let back = place.path("back.esker");
    esker_ok(&["ingest", &back, &out]);
    assert_eq!(json(&["info", &back])["crs"]["vertical_epsg"], 5783);
}

/// It hung on which of the files came first.
#[test]
fn heights_in_two_systems_are_refused_in_any_order() {
    let place = Place::new();
    let file = |name: &str, crs: Option<u32>| {
        let path = place.path(name);
        let s = place.path("t.esker");
        esker_ok(&["generate", "terrain", "--points", "100", "--seed", &name.len().to_string(), "-o", &path]);
        if let Some(vertical) = crs {
            esker_ok(&["ingest", &s, &path]);
            esker_ok(&["set-crs", &s, &format!("EPSG:32632+{vertical}")]);
            esker_ok(&["query", &s, "-o", &path, "--force"]);
            fs::remove_file(&s).unwrap();
        }
        path
    };
    let (plain, one, other) = (file("a.las", None), file("bb.las", Some(5783)), file("ccc.las", Some(7837)));
    for order in [[&plain, &one, &other], [&one, &plain, &other], [&one, &other, &plain], [&other, &plain, &one]] {
        let s = place.path("s.esker");
        esker_fails(&["ingest", &s, order[0], order[1], order[2]], 1, &["its CRS is"]);
    }
    for order in [[&plain, &one], [&one, &plain]] {
        let s = place.path("s.esker");
        // Together, in commits of their own, and by two commands.
        for memory in ["1GiB", "1MiB", "apart"] {
            if memory == "apart" {
                esker_ok(&["ingest", &s, order[0]]);
                esker_ok(&["ingest", &s, order[1]]);
            } else {
                esker_ok(&["ingest", &s, order[0], order[1], "--memory", memory]);
            }
            assert_eq!(json(&["info", &s])["crs"]["vertical_epsg"], 5783, "{memory}");
            esker_fails(&["ingest", &s, &other], 1, &["its CRS is"]);
            fs::remove_file(&s).unwrap();
        }
    }
    // Where the others go on it is left out, and what it said is forgotten if nothing of it can be read.
    let s = place.path("s.esker");
    let output = esker(&["ingest", &s, &one, &other, "--keep-going"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(3) && said.contains("left out: ") && said.contains("ccc.las"), "{said}");
    fs::remove_file(&s).unwrap();
    let bytes = fs::read(&other).unwrap();
    let cut = u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize + 7;
    fs::write(&other, &bytes[..cut]).unwrap();
    for (inputs, there) in [(vec![&other, &one], vec!["bb"]), (vec![&other, &one, &plain], vec!["a", "bb"])] {
        let inputs: Vec<&str> = inputs.into_iter().map(String::as_str).collect();
        let output = esker(&[&["ingest", &s], &inputs[..], &["--keep-going"]].concat());
        assert_eq!(output.status.code(), Some(3), "{output:?}");
        assert_eq!(json(&["info", &s])["crs"]["vertical_epsg"], 5783);
        let mut found = names(&s);
        found.sort();
        assert_eq!(found, there);
        fs::remove_file(&s).unwrap();
    }
}

#[test]
fn a_new_version_of_a_file_is_told_and_not_doubled_by_replace() {
    let place = Place::new();
    let s = place.path("s.esker");
    let ptx = |z: u32| {
        let block =
            |x: u32| format!("1\n1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n{x} 0 {z} 0.5\n");
        format!("{}{}", block(1), block(2))
    };
    esker_ok(&["ingest", &s, &place.file("a.csv", "x,y,z\n1,2,3\n"), &place.file("two.ptx", &ptx(1))]);
    // Another content under the same path.
    let again = told(&["ingest", &s, &place.file("a.csv", "x,y,z\n1,2,4\n")]);
    assert!(again.contains("the store has another version as 'a', and both are there now"), "{again}");
    // The same name in another place is another file.
    assert!(!told(&["ingest", &s, &place.file("other/a.csv", "x,y,z\n9,2,5\n")]).contains("another version"));
    esker_ok(&["verify", &s]);
    // With another pose it is an error, or left out.
    let pose = place.file("pose.txt", "1 0 0 5\n0 1 0 0\n0 0 1 0\n0 0 0 1\n");
    let u = place.path("u.esker");
    esker_ok(&["ingest", &u, &place.path("a.csv")]);
    esker_ok(&["replace", &u, "a", "--pose", &pose]);
    let both = [place.path("a.csv"), place.file("n.csv", "x,y,z\n7,7,7\n")];
    esker_fails(&["ingest", &u, &both[0], &both[1]], 1, &["with another pose or other options", "`esker replace`"]);
    let output = esker(&["ingest", &u, &both[0], &both[1], "--keep-going"]);
    assert_eq!(output.status.code(), Some(3), "{output:?}");
    assert_eq!(names(&u), ["a", "n"]);
}

/// It brought the other setups along, beside those that were there.
#[test]
fn a_file_of_several_scans_replaces_the_one_of_its_name() {
    let place = Place::new();
    let (s, first, second) = (place.path("s.esker"), place.path("v1/project.e57"), place.path("v2/project.e57"));
    let project = |path: &str, z: f64| {
        fs::create_dir_all(std::path::Path::new(path).parent().unwrap()).unwrap();
        let mut writer = e57::E57Writer::from_file(path, "file").unwrap();
        for (number, name) in ["north", "south", "roof"].iter().enumerate() {
            let names = [e57::RecordName::CartesianX, e57::RecordName::CartesianY, e57::RecordName::CartesianZ];
            let record = |name| e57::Record { name, data_type: e57::RecordDataType::F64 };
            let mut scan = writer.add_pointcloud(name, names.map(record).to_vec()).unwrap();
            scan.set_name(Some((*name).to_owned()));
            scan.add_point([number as f64, 1.0, z].map(e57::RecordValue::Double).to_vec()).unwrap();
            scan.finalize().unwrap();
        }
        writer.finalize().unwrap();
    };
    project(&first, 1.0);
    project(&second, 2.0);
    esker_ok(&["ingest", &s, &first, "--quantum", "0.01"]);
    let said = esker_ok(&["replace", &s, "south", &second]);
    assert!(said.contains("(scan 1): skipped, not the scan that takes the place of 'south'"), "{said}");
    assert_eq!(names(&s), ["north", "roof", "south"]);
    let heights = esker_ok(&["query", &s, "-o", "-", "--format", "csv", "--where", "z = 2"]);
    assert_eq!(heights, "X,Y,Z\n1,1,2\n");
    // The same by ingest is beside the old ones, and told.
    let both = told(&["ingest", &s, &second]);
    assert!(both.contains("the store has another version as 'north'"), "{both}");
    assert_eq!(names(&s), ["north", "roof", "south", "project/north", "project/roof"]);
    esker_ok(&["verify", &s, "--deep"]);
}

/// A PTX of blocks; they stand at a turned place of their own.
fn blocks(z: f64, count: u32) -> String {
    let (sin, cos) = 0.7_f64.sin_cos();
    let pose = format!("{cos} {sin} 0 0\n{} {cos} 0 0\n0 0 1 0\n1.1 2.2 3.3 1", -sin);
    let block = |x: u32| {
        format!("2\n1\n1.1 2.2 3.3\n{cos} {sin} 0\n{} {cos} 0\n0 0 1\n{pose}\n{x} 0 {z} 0.5\n{x} 1 {z} 0.25\n", -sin)
    };
    (1..=count).map(block).collect()
}

/// The other blocks came beside those that were there, without a word.
#[test]
fn a_block_of_a_file_takes_the_place_of_the_block_of_its_name() {
    let place = Place::new();
    let s = place.path("s.esker");
    esker_ok(&["ingest", &s, &place.file("m.ptx", &blocks(1.0, 3)), "--quantum", "0.001"]);
    assert_eq!(names(&s), ["m-1", "m-2", "m-3"]);
    let better = place.file("new/m.ptx", &blocks(4.0, 3));
    let said = esker_ok(&["replace", &s, "m-2", &better]);
    assert!(said.contains("(scan 3): skipped, not the scan that takes the place of 'm-2'"), "{said}");
    assert_eq!(names(&s), ["m-1", "m-3", "m-2"]);
    assert_eq!(esker_ok(&["query", &s, "--where", "z > 7", "--count"]), "2\n");
    // One that was taken out, or has another name now, neither comes back nor is in the way.
    let poses = place.file("pose.txt", "1 0 0 5\n0 1 0 0\n0 0 1 0\n0 0 0 1\n");
    let u = place.path("u.esker");
    esker_ok(&["ingest", &u, &place.path("m.ptx"), "--quantum", "0.001"]);
    esker_ok(&["remove", &u, "m-1"]);
    esker_ok(&["rename", &u, "m-3", "third"]);
    esker_ok(&["replace", &u, "m-2", &place.path("m.ptx"), "--pose", &poses]);
    assert_eq!(names(&u), ["third", "m-2"]);
    // Two of one name: each takes the place of its own.
    let d = place.path("d.esker");
    let twice = place.path("d.e57");
    let project = |z: f64| {
        let mut writer = e57::E57Writer::from_file(&twice, "file").unwrap();
        for x in 0..3 {
            let names = [e57::RecordName::CartesianX, e57::RecordName::CartesianY, e57::RecordName::CartesianZ];
            let record = |name| e57::Record { name, data_type: e57::RecordDataType::F64 };
            let mut scan = writer.add_pointcloud(&format!("{x}"), names.map(record).to_vec()).unwrap();
            scan.set_name(Some(if x == 1 { "south" } else { "north" }.to_owned()));
            scan.add_point([f64::from(x), 1.0, z].map(e57::RecordValue::Double).to_vec()).unwrap();
            scan.finalize().unwrap();
        }
        writer.finalize().unwrap();
    };
    project(1.0);
    esker_ok(&["ingest", &d, &twice, "--quantum", "0.01"]);
    assert_eq!(names(&d), ["north", "south", "d/north"]);
    project(2.0);
    esker_ok(&["replace", &d, "d/north", &twice]);
    assert_eq!(names(&d), ["north", "south", "d/north"]);
    let changed = ["query", &d, "--where", "z = 2", "-o", "-", "--format", "csv"];
    assert_eq!(esker_ok(&changed), "X,Y,Z\n2,1,2\n");
}

/// Its pose was another one in its last digits, and the file was another scan then.
#[test]
fn a_scan_that_is_read_again_as_before_is_the_same_scan() {
    let place = Place::new();
    let s = place.path("s.esker");
    let (sin, cos) = 1.1_f64.sin_cos();
    let pose = place.file("pose.txt", &format!("{cos} {} 0 5.3\n{sin} {cos} 0 7.7\n0 0 1 0.9\n0 0 0 1\n", -sin));
    let ingest = ["ingest", &s, &place.file("m.ptx", &blocks(1.0, 2)), "--pose", &pose, "--quantum", "0.0001"];
    esker_ok(&ingest);
    let before = esker_ok(&["digest", &s]);
    for scan in ["m-1", "m-2"] {
        esker_ok(&["replace", &s, scan]);
        assert_eq!(esker_ok(&["digest", &s]), before, "{scan}");
    }
    assert!(esker_ok(&ingest).contains("already in the store as 'm-1'"));
    // What has changed is read, and stays where it was; that is said.
    place.file("m.ptx", &blocks(2.0, 2).replace("1.1 2.2 3.3 1\n", "9.1 9.2 9.3 1\n"));
    let changed = told(&["replace", &s, "m-1"]);
    assert!(changed.contains("has changed: what it holds now is read; it stands where it stood"), "{changed}");
    place.file("m.ptx", &blocks(2.5, 2));
    let u = place.path("u.esker");
    esker_ok(&["ingest", &u, &place.path("m.ptx"), "--quantum", "0.0001"]);
    place.file("m.ptx", &blocks(3.0, 2));
    let changed = told(&["replace", &u, "m-1"]);
    assert!(changed.contains("what it holds now is read") && !changed.contains("stands where"), "{changed}");
}

#[test]
fn another_version_is_known_by_its_name_and_its_place() {
    let place = Place::new();
    let (s, a, b) = (place.path("s.esker"), place.path("v1/tile.las"), place.path("v2/tile.las"));
    fs::create_dir_all(place.path("v1")).unwrap();
    fs::create_dir_all(place.path("v2")).unwrap();
    esker_ok(&["generate", "terrain", "--points", "3000", "--seed", "1", "-o", &a]);
    esker_ok(&["generate", "terrain", "--points", "3100", "--seed", "1", "-o", &b]);
    esker_ok(&["ingest", &s, &a]);
    assert!(told(&["ingest", &s, &b]).contains("the store has another version as 'tile'"));
    // The one that was replaced is not there, but what came in its place is.
    let u = place.path("u.esker");
    esker_ok(&["ingest", &u, &a]);
    esker_ok(&["replace", &u, "tile", &b]);
    assert!(told(&["ingest", &u, &a]).contains("the store has another version as 'tile'"));
    // Of the blocks of a file each is told of its own.
    let m = place.path("m.esker");
    esker_ok(&["ingest", &m, &place.file("m.ptx", &blocks(1.0, 2)), "--quantum", "0.001"]);
    let both = told(&["ingest", &m, &place.file("m.ptx", &blocks(2.0, 2))]);
    assert!(both.contains("version as 'm-1'") && both.contains("version as 'm-2'"), "{both}");
    // Elsewhere it is another one, whatever its name.
    let far = place.file("v3/tile.csv", "x,y,z\n-1,-2,3\n-5,-6,7\n");
    let v = place.path("v.esker");
    esker_ok(&["ingest", &v, &a]);
    assert!(!told(&["ingest", &v, &far, "--ignore-crs"]).contains("version"));
}

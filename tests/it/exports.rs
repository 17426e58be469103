//! Files that hold points of several scans, which differ in what files say of them.

use crate::support::{esker, esker_ok};
use std::collections::BTreeSet;
use std::fs;

/// Three points in a row from `x`, of these levels of red, in fields of this type.
fn ply(x: i32, ty: &str, red: [u32; 3]) -> String {
    let properties = format!("property {ty} red\nproperty {ty} green\nproperty {ty} blue\n");
    let head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\n";
    let points: String = (x..).zip(red).map(|(x, red)| format!("{x} 0 0 {red} 7 0\n")).collect();
    format!("{head}{properties}end_header\n{points}")
}

/// Near infrared of 16 bits beside colours of 8 was taken for one of 8, and became white.
#[test]
fn near_infrared_keeps_its_own_depth() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let with_infrared = |x: i32, red: [u32; 3]| {
        let text = ply(x, "ushort", red).replace("end_header", "property ushort Infrared\nend_header");
        text.replace(" 7 0\n", " 7 0 45386\n")
    };
    fs::write(path("few.ply"), with_infrared(0, [0, 1, 255])).unwrap();
    fs::write(path("many.ply"), with_infrared(10, [0, 256, 65535])).unwrap();
    let store = path("site.esker");
    esker_ok(&["ingest", &store, &path("few.ply"), &path("many.ply")]);
    let query = |more: &[&str]| esker(&[&["query", &store, "-o", "-", "--format", "csv"], more].concat());
    let rows = |more: &[&str]| -> Vec<String> {
        let text = String::from_utf8(query(more).stdout).unwrap();
        text.lines().skip(1).map(|line| line.splitn(4, ',').last().unwrap().to_owned()).collect()
    };
    assert_eq!(rows(&["--attributes", "Infrared"]), ["45386"; 6]);
    assert_eq!(rows(&["--attributes", "Infrared,Red", "--where", "Infrared = 45386 and Red = 257"]).len(), 1);
    let told = |attributes: &str| {
        let output = query(&["--attributes", attributes]);
        String::from_utf8(output.stderr).unwrap().contains("all are written with 16")
    };
    assert_eq!(["Infrared", "none", "Red"].map(told), [false, false, true]);
}

#[cfg(unix)]
#[test]
fn a_file_for_each_of_many_scans_is_open() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    fs::create_dir(at("in")).unwrap();
    (0..60).for_each(|i| fs::write(at(&format!("in/s{i}.csv")), format!("x,y,z\n{i},0,0\n")).unwrap());
    esker_ok(&["ingest", &at("s.esker"), &at("in")]);
    let query = "ulimit -Sn 40; exec \"$0\" query \"$1\" --split-by scan -o \"$2\"";
    let arguments = ["-c", query, env!("CARGO_BIN_EXE_esker"), &at("s.esker"), &at("o.las")];
    let output = std::process::Command::new("sh").args(arguments).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    assert_eq!((0..60).filter(|i| fs::exists(at(&format!("o_s{i}.las"))).unwrap()).count(), 60);
}

#[test]
fn what_some_scans_have_not_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    fs::write(path("a.csv"), "x,y,z,q\n1,1,1,5\n").unwrap();
    fs::write(path("b.csv"), "x,y,z,h\n2,2,2,0.5\n").unwrap();
    let store = path("s.esker");
    esker_ok(&["ingest", &store, &path("a.csv"), &path("b.csv")]);
    let said = |more: &[&str]| {
        let output = esker(&[&["query", &store, "-o", "-", "--format", "csv"], more].concat());
        assert!(output.status.success());
        String::from_utf8(output.stderr).unwrap()
    };
    assert!(said(&[]).contains("some of the scans have no h, q: their points have 0 there"), "{}", said(&[]));
    assert!(!said(&["--scan", "a"]).contains("have no"));
}

#[test]
fn colours_of_8_and_of_16_bits_meet_with_16() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    // Colours of 8 bits in a field of 16, as LAS files have them.
    fs::write(path("few.ply"), ply(0, "ushort", [0, 1, 255])).unwrap();
    fs::write(path("many.ply"), ply(10, "ushort", [0, 256, 65535])).unwrap();
    let store = path("site.esker");
    esker_ok(&["ingest", &store, &path("few.ply"), &path("many.ply")]);
    let colours = |name: &str| -> BTreeSet<(u32, u32, u32)> {
        let text = fs::read_to_string(path(name)).unwrap();
        let head: Vec<&str> = text.lines().next().unwrap().split(',').collect();
        let column = |name: &str| head.iter().position(|n| *n == name).unwrap();
        let (x, red, green) = (column("X"), column("Red"), column("Green"));
        let number = |row: &[&str], i: usize| row[i].parse::<f64>().unwrap() as u32;
        let rows = text.lines().skip(1).map(|line| line.split(',').collect::<Vec<_>>());
        rows.map(|row| (number(&row, x), number(&row, red), number(&row, green))).collect()
    };
    let told = esker(&["query", &store, "-o", &path("both.csv")]);
    assert!(
        told.status.success() && String::from_utf8_lossy(&told.stderr).contains("all are written with 16"),
        "{told:?}"
    );
    let deep = [(10, 0, 7), (11, 256, 7), (12, 65535, 7)];
    let raised = [(0, 0, 7 * 257), (1, 257, 7 * 257), (2, 65535, 7 * 257)];
    assert_eq!(colours("both.csv"), raised.into_iter().chain(deep).collect());
    // Alone, each has the depth that it was given.
    esker_ok(&["query", &store, "--split-by", "scan", "-o", &path("one.csv")]);
    assert_eq!(colours("one_few.csv"), [(0, 0, 7), (1, 1, 7), (2, 255, 7)].into());
    assert_eq!(colours("one_many.csv"), deep.into());
}

#[test]
fn colours_in_fields_of_8_and_of_16_bits_are_one_column_in_every_form() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    fs::write(path("few.ply"), ply(0, "uchar", [0, 1, 255])).unwrap();
    fs::write(path("many.ply"), ply(10, "ushort", [0, 256, 65535])).unwrap();
    // 8 bits in a field of 16: they count as such beside colours of either kind.
    fs::write(path("low.ply"), ply(20, "ushort", [0, 1, 255])).unwrap();
    let store = path("site.esker");
    esker_ok(&["ingest", &store, &path("few.ply"), &path("many.ply"), &path("low.ply")]);
    let rows = |name: &str| -> BTreeSet<String> {
        let text = fs::read_to_string(path(name)).unwrap();
        assert_eq!(text.lines().next(), Some("X,Y,Z,Red"), "{name}");
        text.lines().skip(1).map(str::to_owned).collect()
    };
    let of = |x: i32, red: [u32; 3]| (x..).zip(red).map(|(x, red)| format!("{x},0,0,{red}")).collect::<Vec<_>>();
    let raised = [0, 257, 65535];
    let all: BTreeSet<String> =
        [of(0, raised), of(10, [0, 256, 65535]), of(20, raised)].into_iter().flatten().collect();
    let told = esker(&["query", &store, "--attributes", "Red", "-o", &path("all.csv")]);
    let words = String::from_utf8_lossy(&told.stderr);
    assert!(told.status.success() && words.contains("Red of 8 bits became 16 bits: times 257"), "{told:?}");
    assert_eq!(rows("all.csv"), all);
    // The others say the same, which their own points show when they are stored again.
    for form in ["las", "ply", "npy"] {
        let (file, again, csv) = (path(&format!("all.{form}")), path(&format!("{form}.esker")), format!("{form}.csv"));
        esker_ok(&["query", &store, "--attributes", "Red", "-o", &file]);
        if form == "npy" {
            let bytes = fs::read(&file).unwrap();
            let head = String::from_utf8_lossy(&bytes[..200]).into_owned();
            assert!(head.contains("('Red', '<u2')") && !head.contains("Red.2"), "{head}");
            continue;
        }
        esker_ok(&["ingest", &again, &file]);
        esker_ok(&["query", &again, "--attributes", "Red", "-o", &path(&csv)]);
        assert_eq!(rows(&csv), all);
    }
    // Without the others of them each has its own kind.
    for (scan, red) in [("few", [0, 1, 255]), ("many", [0, 256, 65535]), ("low", [0, 1, 255])] {
        let csv = format!("{scan}.csv");
        esker_ok(&["query", &store, "--scan", scan, "--attributes", "Red", "-o", &path(&csv)]);
        let x = if scan == "few" {
            0
        } else if scan == "many" {
            10
        } else {
            20
        };
        assert_eq!(rows(&csv), of(x, red).into_iter().collect());
    }
    // Neighbours, too.
    let near = esker_ok(&["nearest", &store, "--at", "2,0,0", "--attributes", "Red"]);
    assert!(near.contains("65535") && !near.contains("Red.2"), "{near}");
}

#[test]
fn files_of_a_split_answer_have_names_that_a_file_can_have_and_no_two_the_same() {
    // Long names failed when all was written; those that took each other's numbers, too.
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (store, out) = (path("site.esker"), path("out"));
    fs::create_dir(&out).unwrap();
    let long = |end: &str| format!("{}{end}", "\u{e9}".repeat(150));
    let names = ["p:q", "p;q", "p_q_2", "P_Q", &long("1"), &long("2"), &"n".repeat(247)];
    for (i, name) in names.iter().enumerate() {
        fs::write(path("in.csv"), (0..=i).map(|n| format!("{n} {i} 0\n")).collect::<String>()).unwrap();
        esker_ok(&["ingest", &store, &path("in.csv"), "--name", name, "--columns", "x,y,z"]);
    }
    let split = ["query", &store, "--split-by", "scan", "-o", &format!("{out}/o.csv"), "--json"];
    let json: serde_json::Value = serde_json::from_str(&esker_ok(&split)).unwrap();
    for told in json["outputs"].as_array().unwrap() {
        let scan = names.iter().position(|n| told["scan"] == **n).unwrap();
        let rows = fs::read_to_string(told["path"].as_str().unwrap()).unwrap().lines().count();
        assert_eq!(rows, scan + 2, "{told}");
    }
    let mut found: Vec<_> =
        fs::read_dir(&out).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    found.sort();
    let cut = |n: usize, end: &str| format!("o_{}{end}.csv", "\u{e9}".repeat(n));
    let whole = format!("o_{}.csv", "n".repeat(247));
    assert_eq!(
        found,
        ["o_P_Q_4.csv", &whole, "o_p_q.csv", "o_p_q_2.csv", "o_p_q_2_3.csv", &cut(123, "_5"), &cut(123, "_6")]
    );
    // Without a name of a scan in it that could be cut.
    let long = format!("{out}/{}.csv", "n".repeat(300));
    let output = esker(&["query", &store, "-o", &long]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("too long"), "{output:?}");
}

#[test]
fn files_of_a_split_answer_tell_which_scan_or_class_they_hold() {
    // Names that a file cannot have became one name and a number, and nothing said which was which.
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let store = path("site.esker");
    for (i, name) in ["a/b", "a:b"].into_iter().enumerate() {
        let csv = path("in.csv");
        fs::write(&csv, (0..=i).map(|n| format!("{n} {i} 0\n")).collect::<String>()).unwrap();
        esker_ok(&["ingest", &store, &csv, "--name", name, "--columns", "x,y,z"]);
    }
    let split = ["query", &store, "--split-by", "scan", "-o", &path("out.csv"), "--force"];
    let words = esker_ok(&split);
    let json: serde_json::Value = serde_json::from_str(&esker_ok(&[&split[..], &["--json"]].concat())).unwrap();
    let outputs = json["outputs"].as_array().unwrap();
    assert_eq!(outputs.len(), 2, "{json}");
    for (scan, points, count) in [("a/b", 1, "1 point"), ("a:b", 2, "2 points")] {
        let told = outputs.iter().find(|o| o["scan"] == scan).unwrap();
        let file = told["path"].as_str().unwrap();
        assert_eq!(told["points"], points);
        assert_eq!(fs::read_to_string(file).unwrap().lines().count(), points + 1);
        assert!(words.lines().any(|l| l == format!("{file}: {count} of scan {scan}")), "{words}");
    }
    esker_ok(&["generate", "terrain", "--points", "2000", "-o", &path("t.las")]);
    esker_ok(&["ingest", &path("t.esker"), &path("t.las")]);
    let classes = ["query", &path("t.esker"), "--split-by", "class", "-o", &path("c.las"), "--json"];
    let json: serde_json::Value = serde_json::from_str(&esker_ok(&classes)).unwrap();
    for told in json["outputs"].as_array().unwrap() {
        assert!(told["path"].as_str().unwrap().ends_with(&format!("c_class{}.las", told["class"])), "{told}");
    }
}

/// What had its name already stayed, of an answer that could not be written whole.
#[test]
fn a_split_answer_that_fails_leaves_none_of_its_files() {
    use esker::export::{ExportOptions, SplitBy, Target, export};
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("c.csv"), "x,y,z,classification\n0,0,0,2\n1,0,0,5\n2,0,0,6\n").unwrap();
    esker_ok(&["ingest", at("s.esker").to_str().unwrap(), at("c.csv").to_str().unwrap()]);
    let snapshot = esker::store::Store::open(at("s.esker")).unwrap().snapshot().unwrap();
    let split = |force: bool, meanwhile: &dyn Fn()| {
        let options = ExportOptions { split: Some(SplitBy::Class), force, ..ExportOptions::default() };
        let query = esker::query::Query::new();
        export(&snapshot, &query, Target::File(&at("out.csv")), &options, |_| meanwhile())
    };
    // Somebody makes the last of the files while they are written.
    let error = split(false, &|| fs::write(at("out_class6.csv"), "mine").unwrap()).unwrap_err().to_string();
    assert!(error.contains("out_class6.csv") && error.contains("meanwhile"), "{error}");
    assert!(!at("out_class2.csv").exists() && !at("out_class5.csv").exists());
    assert_eq!(fs::read_to_string(at("out_class6.csv")).unwrap(), "mine");
    assert_eq!(split(true, &|| {}).unwrap().files.len(), 3);
    assert!(fs::read_to_string(at("out_class6.csv")).unwrap().ends_with("2,0,0,6\n"));
}

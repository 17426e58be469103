//! What goes out, in forms that other programs read.

use crate::support::{RawLas, TinyLas, esker, esker_fails, esker_ok, with_vlr};
use std::fs;
use std::path::Path;

/// Wider than 32 bits hold in steps of the quantum.
#[test]
fn what_las_cannot_hold_goes_out_in_other_forms() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    fs::write(at("wide.xyz"), "123456789.125 98765432.25 1.5\n4 5 6\n").unwrap();
    let store = at("wide.esker");
    esker_ok(&["ingest", &store, &at("wide.xyz")]);
    esker_fails(&["query", &store, "-o", &at("wide.las")], 1, &["123456785.125 units wide", "coarser scale"]);
    // What counts is how wide the answer is, in whatever way its region is said; where only a filter says it, nobody knows before.
    let regions: [&[&str]; 3] = [
        &["--box", "0,0,10,10"],
        &["--sphere", "123456789,98765432,1,5"],
        &["--polygon", "POLYGON((0 0, 9 0, 0 19, 0 0))"],
    ];
    for (region, expected) in
        regions.into_iter().zip([[4.0, 5.0, 6.0], [123456789.125, 98765432.25, 1.5], [4.0, 5.0, 6.0]])
    {
        esker_ok(&[&["query", &store, "--force", "-o", &at("part.las")], region].concat());
        let las = RawLas::read(Path::new(&at("part.las"))).unwrap();
        let (head, [record]) = (&las.header, &las.records[..]) else { panic!("{} points", las.records.len()) };
        let scale = [head.x_scale_factor, head.y_scale_factor, head.z_scale_factor];
        let offset = [head.x_offset, head.y_offset, head.z_offset];
        let integer = |i: usize| i32::from_le_bytes(record[4 * i..4 * i + 4].try_into().unwrap());
        let world = [0, 1, 2].map(|i| f64::from(integer(i)) * scale[i] + offset[i]);
        assert_eq!(world, expected, "{region:?}");
    }
    // CSV, PLY and NumPy have no such limit, and were refused as LAS is.
    let mut text: Vec<_> =
        esker_ok(&["query", &store, "-o", "-", "--format", "csv"]).lines().map(str::to_owned).collect();
    text.sort();
    assert_eq!(text, ["123456789.125,98765432.25,1.5", "4,5,6", "X,Y,Z"]);
    for form in ["ply", "npy", "npz"] {
        esker_ok(&["query", &store, "-o", &at(&format!("wide.{form}"))]);
    }
    let near = esker_ok(&["nearest", &store, "--at", "0,0,0"]);
    assert!(near.contains("\n4,5,6,0,"), "{near}");
    esker_ok(&["query", &store, "--scan", "wide", "--frame", "scan", "-o", &at("frame.csv")]);
    esker_fails(&["query", &store, "--scan", "wide", "--frame", "scan", "-o", &at("frame.laz")], 1, &["coarser scale"]);
    esker_ok(&["query", &store, "--scale", "1", "-o", &at("wide.laz")]);
    esker_fails(
        &["query", &store, "--scale", "1", "-o", &at("wide.copc.laz")],
        2,
        &["'copc.laz' is no ending that Esker writes"],
    );
    esker_fails(&["query", &store, "--scale", "1", "-o", &at("scaled.csv")], 2, &["a scale is for LAS and LAZ"]);
    assert!(!fs::exists(at("scaled.csv")).unwrap());
}

/// Text of six digits over five kilometres was rounded to a millimetre, where LAS can take hundredths of that out again.
#[test]
fn wide_text_keeps_as_many_digits_as_las_can_hold() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let rows = "690000.123456 5330000.654321 500.111111\n695000.123454 5335000.654324 500.222222\n";
    fs::write(at("a.xyz"), rows).unwrap();
    let report = esker_ok(&["ingest", &at("a.esker"), &at("a.xyz")]);
    assert!(report.contains("positions rounded, off by at most 4.000e-6"), "{report}");
    let text = esker_ok(&["query", &at("a.esker"), "-o", "-", "--format", "csv"]);
    for row in ["690000.12346,5330000.65432,500.11111", "695000.12345,5335000.65432,500.22222"] {
        assert!(text.contains(row), "{text}");
    }
    esker_ok(&["query", &at("a.esker"), "-o", &at("a.las")]);
    let las = RawLas::read(Path::new(&at("a.las"))).unwrap();
    assert_eq!((las.header.x_scale_factor, las.records.len()), (0.00001, 2));
    // All of them, where somebody asks for them.
    let report = esker_ok(&["ingest", &at("b.esker"), &at("a.xyz"), "--quantum", "0.000001"]);
    assert!(report.contains("positions exact"), "{report}");
}

/// A scan's number is another one's name: its file had that one's columns.
#[test]
fn a_split_gives_each_scan_its_own_columns_whatever_it_is_called() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let names = ["1", "10", "2"];
    for name in names {
        fs::write(at(&format!("{name}.csv")), format!("x,y,z,a{name}\n{name},2,3,4\n")).unwrap();
    }
    let store = at("a.esker");
    let files = names.map(|name| at(&format!("{name}.csv")));
    esker_ok(&["ingest", &store, &files[0], &files[1], &files[2]]);
    esker_ok(&["query", &store, "--split-by", "scan", "-o", &at("out.csv")]);
    for name in names {
        let text = fs::read_to_string(at(&format!("out_{name}.csv"))).unwrap();
        assert_eq!(text, format!("X,Y,Z,a{name}\n{name},2,3,4\n"));
    }
}

/// `--force` replaced the store itself, and all its points with it.
#[test]
fn no_output_takes_the_place_of_a_store() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    fs::write(at("a.xyz"), "1 2 3\n4 5 6\n").unwrap();
    let store = at("a.esker");
    esker_ok(&["ingest", &store, &at("a.xyz")]);
    let bytes = fs::read(&store).unwrap();
    let to_store = ["-o", &store, "--force"];
    let commands: [&[&str]; 4] = [
        &["query", &store, "--format", "las"],
        &["query", &store, "--format", "csv"],
        &["nearest", &store, "--at", "0,0,0", "--format", "csv"],
        &["density", &store, "--side", "1", "--format", "csv"],
    ];
    for command in commands {
        esker_fails(&[command, &to_store].concat(), 1, &["a.esker: is a database, such as a store"]);
    }
    // Whatever it is called.
    for name in ["b.las", "b.png"] {
        fs::copy(&store, at(name)).unwrap();
    }
    let render = ["render", &store, "--size", "64x48", "--force", "-o"];
    esker_fails(&[&render[..], &[&at("b.png")]].concat(), 1, &["b.png: is a database"]);
    // Nor is a picture written under the name of what it is not.
    for name in ["b.jpg", "b", "a.esker"] {
        esker_fails(&[&render[..], &[&at(name)]].concat(), 2, &[name, "give it a name that ends in .png"]);
    }
    let torus = ["generate", "torus", "--points", "10", "-o", &at("b.las"), "--force"];
    esker_fails(&torus, 1, &["b.las: is a database"]);
    for name in ["a.esker", "b.las", "b.png"] {
        assert!(fs::read(at(name)).unwrap() == bytes, "{name}");
    }
    // Anything else that is there is replaced.
    esker_ok(&["query", &store, "-o", &at("a.xyz"), "--format", "csv", "--force"]);
    assert!(fs::read_to_string(at("a.xyz")).unwrap().starts_with("X,Y,Z\n"));
}

/// A scan without times made the standard times of another one seconds of a week.
#[test]
fn the_kind_of_gps_times_is_that_of_the_scans_which_have_some() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let las = |name: &str, point_format: u8, standard: bool| {
        let mut las = TinyLas::new(point_format);
        las.push([i32::from(point_format), i32::from(standard), 3], 7);
        let mut bytes = las.bytes();
        bytes[6] |= u8::from(standard);
        fs::write(at(name), bytes).unwrap();
    };
    las("standard.las", 1, true);
    las("week.las", 1, false);
    las("none.las", 0, false);
    fs::write(at("text.csv"), "x,y,z\n1,2,3\n").unwrap();
    let store = at("s.esker");
    esker_ok(&["ingest", &store, &at("standard.las"), &at("week.las"), &at("none.las"), &at("text.csv")]);
    let encoding = |scans: &[&str], out: &str| {
        let scans: Vec<&str> = scans.iter().flat_map(|scan| ["--scan", scan]).collect();
        let output = esker(&[&["query", &store, "-o", &at(out)], &scans[..]].concat());
        let told = String::from_utf8(output.stderr).unwrap().contains("GPS times of two kinds meet");
        (RawLas::read(Path::new(&at(out))).unwrap().header.global_encoding & 1, told)
    };
    assert_eq!(encoding(&["standard"], "a.las"), (1, false));
    assert_eq!(encoding(&["standard", "none"], "b.las"), (1, false));
    assert_eq!(encoding(&["standard", "text"], "c.las"), (1, false));
    assert_eq!(encoding(&["week", "text"], "d.las"), (0, false));
    assert_eq!(encoding(&["standard", "week"], "e.las"), (0, true));
    assert_eq!(encoding(&["none", "text"], "f.las"), (0, false));
}

/// A GeoKey directory that names a projected system.
fn keys(epsg: u16) -> Vec<u8> {
    [1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, epsg].into_iter().flat_map(u16::to_le_bytes).collect()
}

/// A CRS that was given at ingest was lost on the way out: the file said what its source had said, or nothing.
#[test]
fn a_file_says_the_crs_that_the_store_has() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    for (name, x) in [("none", 0), ("utm", 100)] {
        let mut las = TinyLas::new(1);
        las.push([x, 2, 3], 7);
        let bytes = las.bytes();
        let bytes = if name == "utm" { with_vlr(&bytes, "LASF_Projection", 34_735, &keys(25_832)) } else { bytes };
        fs::write(at(&format!("{name}.las")), bytes).unwrap();
    }
    let crs_of = |store: &str| {
        let info: serde_json::Value = serde_json::from_str(&esker_ok(&["info", "--json", store])).unwrap();
        info["crs"].clone()
    };
    // What comes out of a store of these files, and into another.
    let round = |files: &[&str], options: &[&str]| {
        let (store, again) = (at("a.esker"), at("b.esker"));
        [&store, &again].iter().for_each(|s| drop(fs::remove_file(s)));
        let files: Vec<String> = files.iter().map(|f| at(&format!("{f}.las"))).collect();
        let files: Vec<&str> = files.iter().map(String::as_str).collect();
        esker_ok(&[&["ingest", &store], &files[..], options].concat());
        esker_ok(&["query", &store, "-o", &at("out.las"), "--force"]);
        esker_ok(&["ingest", &again, &at("out.las")]);
        assert_eq!(crs_of(&again)["horizontal_epsg"], crs_of(&store)["horizontal_epsg"], "{files:?} {options:?}");
        crs_of(&again)
    };
    let epsg = |crs: serde_json::Value| crs["horizontal_epsg"].as_u64();
    assert_eq!(epsg(round(&["utm"], &["--crs", "EPSG:32633"])), Some(32_633));
    assert_eq!(epsg(round(&["none"], &["--crs", "EPSG:25832"])), Some(25_832));
    assert_eq!(epsg(round(&["none", "utm"], &[])), Some(25_832));
    assert_eq!(epsg(round(&["utm", "none"], &[])), Some(25_832));
    let codes = round(&["utm"], &["--crs", "EPSG:25832+7837"]);
    assert_eq!((codes["horizontal_epsg"].as_u64(), codes["vertical_epsg"].as_u64()), (Some(25_832), Some(7837)));
    assert!(round(&["none"], &[]).is_null());
    // In a file like an old one text is a record, in LAS 1.4 the header says so, too.
    let wkt = r#"PROJCS["here",GEOGCS["g",DATUM["d",SPHEROID["s",6378137,298]],PRIMEM["p",0],UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],UNIT["metre",1]]"#;
    esker_ok(&["query", &at("a.esker"), "--attributes", "Intensity", "-o", &at("new.las")]);
    for file in ["utm", "new"] {
        assert_eq!(round(&[file], &["--crs", wkt])["wkt"], wkt, "{file}");
        let head = RawLas::read(Path::new(&at("out.las"))).unwrap().header;
        assert_eq!((head.version.minor, head.global_encoding & 16), if file == "new" { (4, 16) } else { (2, 0) });
    }
    // What a file says of itself comes back as it was.
    round(&["utm"], &[]);
    let [out, source] = ["out.las", "utm.las"].map(|name| fs::read(at(name)).unwrap());
    assert_eq!(out[227..], source[227..]);
    round(&["utm"], &["--crs", "EPSG:25832"]);
    assert_eq!(fs::read(at("out.las")).unwrap()[227..], source[227..]);
}

/// Coordinates in coarse steps were called exact.
#[test]
fn a_scale_that_rounds_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    fs::write(at("a.xyz"), "1.25 2 3\n4 5 6.5\n").unwrap();
    let store = at("a.esker");
    esker_ok(&["ingest", &store, &at("a.xyz"), "--quantum", "0.01"]);
    let told = |scale: &[&str]| {
        let output = esker(&[&["query", &store, "-o", &at("out.las"), "--force"], scale].concat());
        let text = String::from_utf8(output.stderr).unwrap();
        text.lines().find(|l| l.contains("rounded")).map(str::to_owned)
    };
    assert!(told(&["--scale", "7"]).unwrap().contains("rounded to steps of 7: off by up to 3.5 on an axis"));
    assert!(told(&["--scale", "0.0015"]).is_some());
    assert_eq!([told(&[]), told(&["--scale", "0.01"]), told(&["--scale", "0.0005"])], [None, None, None]);
}

/// Points without a class were put into the file of class 0, and so were classes of other types.
#[test]
fn points_without_a_class_have_a_file_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let head = "x,y,z,classification\n";
    fs::write(at("bytes.csv"), format!("{head}1,0,0,0\n2,0,0,2\n3,0,0,255\n")).unwrap();
    fs::write(at("whole.csv"), format!("{head}1,1,0,0\n2,1,0,2900\n3,1,0,-7\n")).unwrap();
    fs::write(at("parts.csv"), format!("{head}1,2,0,2\n2,2,0,2.5\n3,2,0,0\n")).unwrap();
    fs::write(at("none.csv"), "x,y,z\n1,3,0\n2,3,0\n").unwrap();
    let store = at("s.esker");
    let files = ["bytes.csv", "whole.csv", "parts.csv", "none.csv"].map(at);
    esker_ok(&[&["ingest", &store], &files.each_ref().map(String::as_str)[..]].concat());
    for (name, attributes) in [("all", None), ("bare", Some("none")), ("other", Some("classification"))] {
        let attributes = attributes.map_or(vec![], |a| vec!["--attributes", a]);
        let split = ["query", &store, "--split-by", "class", "-o", &at(&format!("{name}.csv"))];
        let output = esker(&[&split[..], &attributes].concat());
        let (out, told) = (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap());
        for (class, points) in [("0", 3), ("2", 2), ("255", 1), ("2900", 1), ("-7", 1)] {
            let text = fs::read_to_string(at(&format!("{name}_class{class}.csv"))).unwrap();
            assert_eq!(text.lines().count() - 1, points, "{name} {class}");
            assert_eq!(text.starts_with("X,Y,Z\n"), name == "bare");
        }
        assert_eq!(fs::read_to_string(at(&format!("{name}_noclass.csv"))).unwrap().lines().count() - 1, 3, "{name}");
        assert!(told.contains("3 points without a class") && out.contains("3 points without a class"), "{out}{told}");
        let written = fs::read_dir(folder.path())
            .unwrap()
            .filter(|e| e.as_ref().unwrap().file_name().to_str().unwrap().starts_with(&format!("{name}_")));
        assert_eq!(written.count(), 6);
    }
    let bare = at("bare.esker");
    esker_ok(&["ingest", &bare, &at("none.csv")]);
    let split = ["query", &bare, "--split-by", "class", "-o", &at("no.csv")];
    esker_fails(&split, 1, &["the points have no Classification to split by"]);
    // The scans that have some are left out.
    let split = ["query", &store, "--scan", "none", "--split-by", "class", "-o", &at("no.csv")];
    esker_fails(&split, 1, &["the points have no Classification to split by"]);
}

/// However coarse an answer was, the word counted all points of the store there.
#[test]
fn the_word_on_maximum_faces_counts_what_matches() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let head = "x,y,z,classification\n";
    fs::write(at("a.csv"), format!("{head}0,0,0,1\n1,1,0,1\n2,1,0,1\n2,1,0,2\n1,2,0,2\n")).unwrap();
    fs::write(at("b.csv"), format!("{head}2,0,0,2\n0,1,0,2\n")).unwrap();
    let store = at("s.esker");
    esker_ok(&["ingest", &store, &at("a.csv"), &at("b.csv")]);
    for detail in [&[][..], &["--level", "3"], &["--capacity", "2"], &["--max-error", "0.001"]] {
        let told = |which: &[&str]| {
            let output = esker(&[&["query", &store, "--box", "0,0,2,2", "--count"], detail, which].concat());
            assert!(output.status.success());
            String::from_utf8(output.stderr).unwrap()
        };
        assert!(told(&[]).contains("4 points lie on the region's maximum faces"), "{detail:?}: {}", told(&[]));
        let one = told(&["--where", "Classification = 1"]);
        assert!(one.contains("1 point lies on the region's maximum faces"), "{detail:?}: {one}");
        let one = told(&["--scan", "b"]);
        assert!(one.contains("1 point lies on the region's maximum faces"), "{detail:?}: {one}");
        let none = told(&["--where", "Classification = 1", "--scan", "b"]);
        assert!(!none.contains("faces"), "{detail:?}: {none}");
    }
    // Of neighbours only the faces of the whole, and what is on both is one point.
    let two = esker(&["query", &store, "--box", "0,0,1,2", "--box", "1,0,2,2", "--count"]);
    assert_eq!(String::from_utf8(two.stdout).unwrap(), "3\n");
    let told = String::from_utf8(two.stderr).unwrap();
    assert!(told.contains("4 points lie on the region's maximum faces"), "{told}");
    // Without an extent a box holds nothing, wherever it is; it was said to lie outside.
    for (option, region, axis) in [("--box", "0,1,2,1", "y"), ("--box", "2,0,2,9", "x"), ("--z", "0,0", "z")] {
        let output = esker(&["query", &store, option, region, "--count"]);
        let words = String::from_utf8(output.stderr).unwrap();
        assert!(output.stdout == b"0\n" && words.contains(&format!("no extent on {axis}")), "{words}");
        assert!(!words.contains("outside the site"), "{words}");
        assert_ne!(esker_ok(&["query", &store, option, region, "--count", "--closed"]), "0\n");
    }
    esker_fails(&["query", &store, "--box", "a,b,c,d"], 2, &["--box"]);
    esker_fails(&["query", &store, "--z", "495"], 2, &["MIN,MAX"]);
}

/// Points of a scan without returns were return 0 of 0 beside another one's, which readers of first or last returns drop.
#[test]
fn points_without_returns_are_the_only_one_in_las_beside_others_too() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let mut with = TinyLas::new(1);
    (0..500).for_each(|i| with.push([i * 100, 300, 0], i as u64));
    // Of one point the file itself says 0 of 0: that is kept.
    let mut bytes = with.bytes();
    bytes[227 + 14] = 0;
    fs::write(at("with.las"), bytes).unwrap();
    let rows: String = (0..300).map(|i| format!("{i},7,0\n")).collect();
    fs::write(at("without.csv"), format!("x,y,z\n{rows}")).unwrap();
    let store = at("s.esker");
    esker_ok(&["ingest", &store, &at("with.las"), &at("without.csv"), "--quantum", "0.01"]);
    for extra in [&[][..], &["--where", "Y > 5"], &["--attributes", "ReturnNumber,NumberOfReturns"]] {
        let las = at("out.las");
        let output = esker(&[&["query", &store, "-o", &las, "--force"], extra].concat());
        let words = String::from_utf8(output.stderr).unwrap();
        // Where no point of the others can be in the file nobody has returns.
        let told = words.contains("have no returns: their points are return 1 of 1") != extra.contains(&"Y > 5");
        assert!(output.status.success() && told, "{words}");
        assert!(!words.contains("ReturnNumber"), "{words}");
        let file = fs::read(&las).unwrap();
        let (start, size) = (u32::from_le_bytes(file[96..100].try_into().unwrap()) as usize, file[105] as usize);
        let format = file[104] & 63;
        let of = |record: &[u8]| {
            if format < 6 { (record[14] & 7, record[14] >> 3 & 7) } else { (record[14] & 15, record[14] >> 4) }
        };
        let all: Vec<_> = file[start..].chunks_exact(size).map(of).collect();
        let blank = all.iter().filter(|r| **r == (0, 0)).count();
        let (points, zeros) = if extra.contains(&"Y > 5") { (300, 0) } else { (800, 1) };
        assert_eq!((all.len(), blank), (points, zeros), "{extra:?}");
        assert!(all.iter().all(|r| *r == (1, 1) || *r == (0, 0)), "{extra:?}");
    }
    // Other forms have what is there: nothing.
    let text =
        esker_ok(&["query", &store, "--where", "Y > 5", "--attributes", "ReturnNumber", "-o", "-", "--format", "csv"]);
    assert!(text.lines().skip(1).all(|line| line.ends_with(",0")), "{text}");
}

/// They came in the alphabet's order, and readers of X Y Z I R G B go by place.
#[test]
fn columns_come_in_the_order_in_which_they_were_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let store = at("order.esker");
    fs::write(at("o.csv"), "x,y,z,intensity,red,green,blue,code\n1,2,3,7,10,20,30,5\n").unwrap();
    esker_ok(&["ingest", &store, &at("o.csv")]);
    let query = ["query", &store, "-o", "-", "--format", "csv"];
    let rows = |more: &[&str]| esker_ok(&[&query[..], more].concat());
    assert_eq!(rows(&[]), "X,Y,Z,Blue,Green,Intensity,Red,code\n1,2,3,30,20,7,10,5\n");
    let asked = rows(&["--attributes", "intensity,Red,green,Blue"]);
    assert_eq!(asked, "X,Y,Z,Intensity,Red,Green,Blue\n1,2,3,7,10,20,30\n");
    let near = ["nearest", &store, "--at", "1,2,3", "--attributes", "code,Red"];
    assert_eq!(esker_ok(&near), "X,Y,Z,Place,Distance,code,Red\n1,2,3,0,0,5,10\n");
    let split = at("p.csv");
    esker_ok(&["query", &store, "-o", &split, "--split-by", "scan", "--attributes", "Red,code"]);
    assert_eq!(fs::read_to_string(at("p_o.csv")).unwrap(), "X,Y,Z,Red,code\n1,2,3,10,5\n");
}

/// Joined setups could not be told apart in one file, and text without names was not to be had.
#[test]
fn points_say_their_scan_and_go_out_as_plain_rows() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let store = at("s.esker");
    fs::write(at("a.csv"), "x,y,z,intensity,code\n1,2,3,7,5\n").unwrap();
    fs::write(at("b.csv"), "x,y,z,intensity\n4,5,6,9\n").unwrap();
    esker_ok(&["ingest", &store, &at("a.csv"), &at("b.csv")]);
    let csv = esker_ok(&["query", &store, "-o", "-", "--format", "csv", "--attributes", "Intensity", "--with-scan"]);
    assert_eq!(csv, "X,Y,Z,Intensity,Scan\n1,2,3,7,1\n4,5,6,9,2\n");
    esker_ok(&["query", &store, "-o", &at("s.las"), "--with-scan"]);
    esker_ok(&["ingest", &at("again.esker"), &at("s.las")]);
    let again = ["query", &at("again.esker"), "-o", "-", "--format", "csv", "--attributes", "Scan"];
    assert_eq!(esker_ok(&again), "X,Y,Z,Scan\n1,2,3,1\n4,5,6,2\n");
    let split = ["query", &store, "--split-by", "scan", "-o", &at("p.csv"), "--attributes", "none", "--with-scan"];
    esker_ok(&split);
    assert_eq!(fs::read_to_string(at("p_b.csv")).unwrap(), "X,Y,Z,Scan\n4,5,6,2\n");
    // Rows of blanks, and a word on what they are.
    let output = esker(&["query", &store, "-o", &at("rows.xyz"), "--attributes", "Intensity,code"]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("the columns are X Y Z Intensity code"), "{output:?}");
    assert_eq!(fs::read_to_string(at("rows.xyz")).unwrap(), "1 2 3 7 5\n4 5 6 9 0\n");
    assert_eq!(esker_ok(&["query", &store, "-o", "-", "--format", "xyz", "--attributes", "none"]), "1 2 3\n4 5 6\n");
    esker_ok(&["query", &store, "-o", &at("rows.txt"), "--attributes", "none"]);
    esker_ok(&["ingest", &at("rows.esker"), &at("rows.txt")]);
    assert_eq!(esker_ok(&["query", &at("rows.esker"), "--count"]), "2\n");
    esker_fails(&["query", &store, "--count", "--with-scan"], 2, &["--with-scan"]);
}

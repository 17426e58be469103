//! What goes out, in forms that other programs read.

use crate::support::{RawLas, TinyLas, esker_fails, esker_ok};
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
        1,
        &["'copc.laz' is no ending that Esker writes"],
    );
    esker_fails(&["query", &store, "--scale", "1", "-o", &at("scaled.csv")], 1, &["--scale is for LAS and LAZ"]);
    assert!(!fs::exists(at("scaled.csv")).unwrap());
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
        esker_fails(&[&render[..], &[&at(name)]].concat(), 1, &[name, "give it a name that ends in .png"]);
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
        let output = crate::support::esker(&[&["query", &store, "-o", &at(out)], &scans[..]].concat());
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

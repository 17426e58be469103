//! Files that are not what they say.

use super::Place;
use crate::support::{esker, esker_fails, esker_ok};
use esker::ingest::{IngestOptions, Progress, Stage, ingest};
use std::fs;
use std::path::Path;
use std::process::Command;

#[test]
fn inputs_that_are_no_point_files_are_named() {
    let place = Place::new();
    let store = place.path("s.esker");
    esker_fails(&["ingest", &store, &place.path("missing.las")], 1, &["missing.las"]);
    let empty = place.write("empty.las", b"");
    esker_fails(&["ingest", &store, &empty], 1, &["empty.las"]);
    let text = place.write("text.las", b"this is no point cloud at all, it is a letter to my aunt");
    esker_fails(&["ingest", &store, &text], 1, &["text.las"]);
    let unknown = place.write("notes.docx", b"PK\x03\x04 something");
    esker_fails(&["ingest", &store, &unknown], 1, &["notes.docx"]);
    fs::create_dir(place.path("folder")).unwrap();
    esker_fails(&["ingest", &store, &place.path("folder")], 1, &["point file"]);
    place.nothing_there("s.esker");
}

/// A LAZ file whose first chunk says that it is longer than the file.
fn with_wrong_chunk(mut laz: Vec<u8>) -> Vec<u8> {
    let number = |at: usize| u32::from_le_bytes(laz[at..at + 4].try_into().unwrap()) as usize;
    let record_bytes = u16::from_le_bytes([laz[105], laz[106]]) as usize;
    // Before the first chunk is the place of the table of chunks; the chunk begins with a whole record, its count and the
    // lengths of its layers.
    let lengths = number(96) + 8 + record_bytes + 4;
    laz[lengths..lengths + 4].copy_from_slice(&[0xff; 4]);
    laz
}

#[test]
fn inputs_that_cannot_be_read_are_left_out_where_that_is_asked_for() {
    let place = Place::new();
    // Fails when it is opened, when its bounds are measured, when it is read.
    let letter = place.write("1_letter.las", b"this is no point cloud at all, it is a letter to my aunt");
    let table = place.write("2_table.csv", b"x,y,z\n1,2,3\n4,5,6\nseven,8,9\n");
    let good = [place.las("3_a.las", 30_000), place.path("5_b.laz"), place.las("7_c.las", 20_000)];
    esker_ok(&["generate", "spheres", "--points", "40000", "-o", &good[1]]);
    let chunk = place.write("4_chunk.laz", &with_wrong_chunk(fs::read(&good[1]).unwrap()));
    let laz = place.path("0_whole.laz");
    esker_ok(&["generate", "terrain", "--points", "10000", "-o", &laz]);
    let other = place.write("6_chunk.laz", &with_wrong_chunk(fs::read(&laz).unwrap()));
    let all = [&letter, &table, &good[0], &chunk, &good[1], &other, &good[2]];

    let expected = place.path("expected.esker");
    esker_ok(&["ingest", &expected, &good[0], &good[1], &good[2], "--quantum", "0.001"]);
    let digest = |store: &str| esker_ok(&["digest", store]);
    for memory in ["1GiB", "3MiB"] {
        let store = place.path("s.esker");
        let mut arguments = vec!["ingest", &store, "--quantum", "0.001", "--memory", memory];
        arguments.extend(all.map(String::as_str));
        // Without the option nothing that is damaged is passed over, and the option is named.
        esker_fails(&arguments, 1, &["--keep-going"]);
        place.nothing_there("s.esker");
        arguments.push("--keep-going");
        let output = esker(&arguments);
        let words = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(3), "{words}");
        let left_out: Vec<_> = words.lines().filter(|line| line.contains("left out")).collect();
        assert_eq!(left_out.len(), 4, "{words}");
        for (line, of) in left_out.iter().zip([&letter, &table, &chunk, &other]) {
            assert!(line.starts_with(&format!("esker: left out: {of}: ")), "{line}");
        }
        assert_eq!(digest(&store), digest(&expected), "--memory {memory}");
        // Again: what is there is skipped, what can't be read still can't.
        arguments.push("--json");
        let again = esker(&arguments);
        assert_eq!(again.status.code(), Some(3));
        let report: serde_json::Value = serde_json::from_slice(&again.stdout).unwrap();
        let count = |key: &str| report[key].as_array().unwrap().len();
        assert_eq!((count("scans"), count("skipped"), count("unreadable")), (0, 3, 4));
        esker_ok(&["verify", &store, "--deep"]);
        fs::remove_file(&store).unwrap();
    }

    // Nothing else: the first one's error, and no store.
    for alone in [&letter, &table, &chunk] {
        let name = Path::new(alone).file_name().unwrap().to_str().unwrap();
        esker_fails(&["ingest", &place.path("s.esker"), alone, "--keep-going"], 1, &[name]);
        place.nothing_there("s.esker");
    }
    // One that is not there is left out like the others, beside one that is.
    let (missing, beside) = (place.path("8_none.las"), place.path("beside.esker"));
    esker_fails(&["ingest", &beside, &good[2], &missing], 1, &["8_none.las", "--keep-going"]);
    esker_fails(&["ingest", &beside, &missing, "--keep-going"], 1, &["8_none.las"]);
    let output = esker(&["ingest", &beside, &missing, &good[2], "--keep-going"]);
    let words = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(3) && words.contains("left out: ") && words.contains("8_none.las"), "{words}");
    assert_eq!(esker_ok(&["query", &beside, "--count"]).trim(), "20000");
    // What is cut is damaged under --strict alone.
    let whole = fs::read(&good[0]).unwrap();
    let cut = place.write("cut.las", &whole[..whole.len() / 2]);
    let store = place.path("cut.esker");
    esker_fails(&["ingest", &store, &good[2], &cut, "--strict"], 1, &["cut.las", "--keep-going"]);
    let output = esker(&["ingest", &store, &good[2], &cut, "--strict", "--keep-going"]);
    assert_eq!(output.status.code(), Some(3));
    assert_eq!(esker_ok(&["query", &store, "--count"]).trim(), "20000");
    esker_ok(&["ingest", &store, &cut, "--keep-going"]);
    assert!(esker_ok(&["query", &store, "--count"]).trim().parse::<u32>().unwrap() > 30_000);
}

/// Such files gave a new store their CRS and their lattice, for good.
#[test]
fn what_a_file_says_that_is_left_out_does_not_count() {
    let place = Place::new();
    let text = place.write("a.csv", b"x,y,z\n1.25,2,3\n4,5.5,6\n");
    let fine = place.path("whole.laz");
    esker_ok(&["generate", "terrain", "--points", "10000", "-o", &fine]);
    let damaged = place.write("z_chunk.laz", &with_wrong_chunk(fs::read(&fine).unwrap()));
    let info =
        |store: &str| -> serde_json::Value { serde_json::from_str(&esker_ok(&["info", store, "--json"])).unwrap() };
    assert_ne!(
        info(&{
            esker_ok(&["ingest", &place.path("f.esker"), &fine]);
            place.path("f.esker")
        })["crs"],
        serde_json::Value::Null
    );
    let alone = place.path("alone.esker");
    esker_ok(&["ingest", &alone, &text]);
    let (store, later) = (place.path("s.esker"), place.path("later.esker"));
    let output = esker(&["ingest", &store, &text, &damaged, "--keep-going"]);
    let words = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(3) && !words.contains("names no CRS"), "{words}");
    esker_ok(&["ingest", &later, &text]);
    let more = place.write("b.csv", b"x,y,z\n7,8,9\n");
    assert_eq!(esker(&["ingest", &later, &more, &damaged, "--keep-going"]).status.code(), Some(3));
    for store in [&store, &later] {
        for what in ["crs", "quantum", "phase"] {
            assert_eq!(info(store)[what], info(&alone)[what], "{what}");
        }
        esker_ok(&["verify", store, "--deep"]);
    }
    assert_eq!(esker_ok(&["digest", &store]).lines().next(), esker_ok(&["digest", &alone]).lines().next());
    // Of a file of another system that can't be read nothing is asked.
    let other = place.path("other.las");
    esker_ok(&["generate", "terrain", "--points", "100", "-o", &other]);
    let mixed = place.path("mixed.esker");
    esker_ok(&["ingest", &mixed, &text, "--crs", "EPSG:2056"]);
    let output = esker(&[
        "ingest",
        &mixed,
        &more,
        &place.write("cut.csv", b"x,y,z\n1,2\n"),
        "--crs",
        "EPSG:2056",
        "--keep-going",
    ]);
    assert_eq!(output.status.code(), Some(3), "{output:?}");
}

#[test]
fn a_wrong_ending_does_not_matter() {
    let place = Place::new();
    let las = place.las("a.las", 1000);
    let renamed = place.path("a.ply");
    fs::rename(las, &renamed).unwrap();
    esker_ok(&["ingest", &place.path("s.esker"), &renamed]);
    assert_eq!(esker_ok(&["query", &place.path("s.esker"), "--count"]).trim(), "1000");
}

#[test]
fn zero_points_are_a_scan_of_zero_points() {
    let place = Place::new();
    let ply = place.write(
        "none.ply",
        b"ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\nproperty float z\nend_header\n",
    );
    let store = place.path("s.esker");
    esker_ok(&["ingest", &store, &ply]);
    assert_eq!(esker_ok(&["query", &store, "--count"]).trim(), "0");
    esker_ok(&["verify", &store]);
    esker_ok(&["query", &store, "-o", &place.path("none.las")]);
    esker_ok(&["info", &store]);
}

#[test]
fn headers_that_lie_are_noticed() {
    let place = Place::new();
    let las = place.las("a.las", 1000);
    let bytes = fs::read(&las).unwrap();
    let store = place.path("s.esker");

    // Offset to the points beyond the end.
    let mut lie = bytes.clone();
    lie[96..100].copy_from_slice(&u32::MAX.to_le_bytes());
    let path = place.write("offset.las", &lie);
    esker_fails(&["ingest", &store, &path], 1, &["offset.las"]);
    place.nothing_there("s.esker");

    // More points than there are (the 64-bit count of LAS 1.4).
    let mut lie = bytes.clone();
    lie[247..255].copy_from_slice(&5000_u64.to_le_bytes());
    let path = place.write("count.las", &lie);
    esker_fails(&["ingest", &store, &path, "--strict"], 1, &["count.las", "4000"]);
    place.nothing_there("s.esker");
    let report = esker_ok(&["ingest", &store, &path, "--json"]);
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    assert_eq!(report["scans"][0]["stored"], 1000);
    assert_eq!(report["scans"][0]["read"], 5000);
    assert_eq!(report["scans"][0]["rejected"], 4000);
    esker_ok(&["verify", &store]);

    // Cut short in the middle of a record.
    let path = place.write("cut.las", &bytes[..bytes.len() - 10]);
    let store = place.path("cut.esker");
    esker_ok(&["ingest", &store, &path]);
    assert_eq!(esker_ok(&["query", &store, "--count"]).trim(), "999");
}

#[test]
fn nan_and_infinite_coordinates_are_rejected_and_counted() {
    let place = Place::new();
    let mut ply = b"ply\nformat binary_little_endian 1.0\nelement vertex 5\nproperty float x\nproperty float y\n\
                    property float z\nproperty float q\nend_header\n"
        .to_vec();
    for x in [1.0, f32::NAN, f32::INFINITY, -2.0, f32::NEG_INFINITY] {
        for v in [x, 1.0, 2.0, f32::NAN] {
            ply.extend_from_slice(&v.to_le_bytes());
        }
    }
    let path = place.write("nan.ply", &ply);
    let store = place.path("s.esker");
    let report = esker_ok(&["ingest", &store, &path, "--json"]);
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    assert_eq!(report["scans"][0]["stored"], 2);
    assert_eq!(report["scans"][0]["rejected_not_finite"], 3);
    let output = esker(&["ingest", &place.path("t.esker"), &path, "--strict"]);
    assert_eq!(output.status.code(), Some(3));
    // NaN in an attribute is data.
    let csv = place.path("out.csv");
    esker_ok(&["query", &store, "-o", &csv]);
    assert_eq!(fs::read_to_string(csv).unwrap().matches("NaN").count(), 2);
}

#[test]
fn coordinates_over_the_whole_i32_range_are_kept() {
    let place = Place::new();
    let mut las = fs::read(place.las("a.las", 4)).unwrap();
    let start = u32::from_le_bytes(las[96..100].try_into().unwrap()) as usize;
    let size = usize::from(u16::from_le_bytes(las[105..107].try_into().unwrap()));
    for (i, v) in [i32::MIN, i32::MAX, 0, -1].into_iter().enumerate() {
        for axis in 0..3 {
            let at = start + i * size + 4 * axis;
            las[at..at + 4].copy_from_slice(&v.to_le_bytes());
        }
    }
    let path = place.write("wide.las", &las);
    let store = place.path("s.esker");
    esker_ok(&["ingest", &store, &path]);
    esker_ok(&["verify", &store]);
    let out = place.path("out.las");
    esker_ok(&["query", &store, "-o", &out]);
    let (before, after) =
        (crate::support::RawLas::read(Path::new(&path)), crate::support::RawLas::read(Path::new(&out)));
    assert_eq!(before.unwrap().sorted(), after.unwrap().sorted());
}

#[test]
fn a_count_of_points_that_cannot_be_is_refused_with_its_file() {
    let place = Place::new();
    let store = place.path("s.esker");
    let pcd =
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 18446744073709551615\nHEIGHT 1\nDATA ascii\n1 2 3\n";
    let ptx = "4294967295\n4294967295\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n1 2 3 0.5\n";
    let ply = "ply\nformat ascii 1.0\nelement vertex 18446744073709551615\nproperty int x\nproperty int y\nproperty int z\nend_header\n1 2 3\n";
    for (name, text) in [("a.pcd", pcd), ("a.pts", "9999999999999999999\n1 2 3\n"), ("a.ptx", ptx), ("a.ply", ply)] {
        let file = place.write(name, text.as_bytes());
        esker_fails(&["ingest", &store, &file], 1, &[name, "expected a header with a count of points that can be"]);
        place.nothing_there("s.esker");
    }
}

#[test]
fn a_heading_that_names_an_axis_twice_is_told_with_its_columns() {
    let place = Place::new();
    let csv = place.write("a.csv", b"X,Y,Z,Intensity,x\n1,2,3,4,5\n6,7,8,9,10\n");
    let store = place.path("a.esker");
    esker_fails(&["ingest", &store, &csv], 1, &["line 1", "columns 1 and 5", "--columns"]);
    esker_ok(&["ingest", &store, &csv, "--columns", "x,y,z,Intensity,dx"]);
}

/// Somebody cuts the file as soon as it is known how much it holds.
struct Cutting<'a> {
    file: &'a str,
    bytes: u64,
}

impl Progress for Cutting<'_> {
    fn stage(&self, stage: Stage, _total: u64) {
        if stage == Stage::Read {
            fs::File::options().write(true).open(self.file).unwrap().set_len(self.bytes).unwrap();
        }
    }
}

#[test]
fn a_file_that_is_cut_while_it_is_read_gives_a_warning() {
    // What was not there any more was counted, and nothing said.
    let place = Place::new();
    let rows: String = (100..200).map(|i| format!("{i} {i} {i}\n")).collect();
    let head = "ply\nformat binary_little_endian 1.0\nelement vertex 100\nproperty double x\nproperty double y\n\
                property double z\nend_header\n";
    let body: Vec<u8> = (0..100 * 3).flat_map(|i| f64::from(i).to_le_bytes()).collect();
    let las = place.las("a.las", 100);
    let half = |head: u64, bytes: u64| head + (bytes - head) / 2;
    let bytes = fs::metadata(&las).unwrap().len();
    let record = u64::from(u16::from_le_bytes(fs::read(&las).unwrap()[105..107].try_into().unwrap()));
    let files = [
        (las, half(bytes - 100 * record, bytes)),
        (
            place.write("b.ply", &[head.as_bytes(), &body].concat()),
            half(head.len() as u64, (head.len() + body.len()) as u64),
        ),
        (place.write("c.xyz", rows.as_bytes()), rows.len() as u64 / 2),
    ];
    for (i, (file, bytes)) in files.iter().enumerate() {
        let store = place.path(&format!("{i}.esker"));
        let cutting = Cutting { file, bytes: *bytes };
        let report = ingest(Path::new(&store), &[file.into()], &IngestOptions::default(), &cutting).unwrap();
        let [scan] = &report.scans[..] else { panic!("{file}: {} scans", report.scans.len()) };
        assert_eq!((scan.stored, scan.rejected_truncated), (50, 50), "{file}");
        let told =
            scan.warnings.iter().filter(|w| w.contains("cut meanwhile: 50 of its records are not there")).count();
        assert_eq!(told, 1, "{file}: {:?}", scan.warnings);
    }
}

#[test]
fn rejected_points_are_told_with_the_reasons() {
    let place = Place::new();
    let head = "ply\nformat ascii 1.0\nelement vertex 5\nproperty double x\nproperty double y\nproperty double z\n\
                end_header\n";
    let file = place.write("a.ply", format!("{head}1 2 3\n4 5 6\n7 8 nan\n").as_bytes());
    let told = esker_ok(&["ingest", &place.path("a.esker"), &file]);
    let expected = "a: 2 points stored, 3 rejected (2 not in the file, 1 without a valid position); positions exact\n";
    assert!(told.starts_with(expected), "{told}");
}

/// Each held a handle of its own from the first to the last.
#[test]
fn more_files_go_in_than_may_be_open() {
    let place = Place::new();
    fs::create_dir(place.path("many")).unwrap();
    for i in 0..400 {
        place.write(&format!("many/{i}.csv"), format!("x,y,z\n{i},2,3\n{i}.5,4,5\n").as_bytes());
    }
    let store = place.path("s.esker");
    let limited =
        format!("ulimit -n 200; exec '{}' ingest '{store}' '{}'", env!("CARGO_BIN_EXE_esker"), place.path("many"));
    let output = Command::new("sh").args(["-c", &limited]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(esker_ok(&["query", &store, "--count"]), "800\n");
}

/// Nothing of it was stored, and the command said that all was well.
#[test]
fn a_file_that_is_cut_before_its_first_record_is_an_error() {
    let place = Place::new();
    let laz = place.path("whole.laz");
    esker_ok(&["generate", "terrain", "--points", "20000", "-o", &laz]);
    let whole = fs::read(&laz).unwrap();
    let start = u32::from_le_bytes(whole[96..100].try_into().unwrap()) as usize;
    let cut = place.write("cut.laz", &whole[..start + 3000]);
    let store = place.path("s.esker");
    esker_fails(&["ingest", &store, &cut], 1, &["cut.laz", "before the first of the records"]);
    place.nothing_there("s.esker");
    // Beside others it is left out where that is asked for.
    let good = place.las("good.las", 500);
    assert_eq!(esker(&["ingest", &store, &cut, &good, "--keep-going"]).status.code(), Some(3));
    assert_eq!(esker_ok(&["query", &store, "--count"]), "500\n");
}

/// Of blocks that are whole all points are kept, wherever the file ends.
#[test]
fn a_file_that_is_cut_between_its_blocks_keeps_those_before() {
    let place = Place::new();
    let cut = place.write("q.pts", b"2\n1 2 3 5\n2 3 4 6\n3\n");
    let store = place.path("q.esker");
    esker_ok(&["ingest", &store, &cut]);
    assert_eq!(esker_ok(&["query", &store, "--count"]), "2\n");
}

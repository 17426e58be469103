//! Whatever a user does wrong: one line that says what to do, an exit code, nothing lost.

use crate::support::{esker, esker_fails, esker_ok};
use esker::ingest::{IngestOptions, Progress, Stage, ingest};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

struct Place {
    folder: TempDir,
}

impl Place {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    fn path(&self, name: &str) -> String {
        self.folder.path().join(name).to_str().unwrap().to_owned()
    }

    fn write(&self, name: &str, bytes: &[u8]) -> String {
        fs::write(self.path(name), bytes).unwrap();
        self.path(name)
    }

    /// A valid LAS file of `points` points.
    fn las(&self, name: &str, points: u64) -> String {
        esker_ok(&["generate", "torus", "--points", &points.to_string(), "-o", &self.path(name)]);
        self.path(name)
    }

    /// A store with a torus in it.
    fn store(&self, points: u64) -> String {
        let las = self.las("torus.las", points);
        esker_ok(&["ingest", &self.path("torus.esker"), &las]);
        self.path("torus.esker")
    }

    fn nothing_there(&self, name: &str) {
        for entry in fs::read_dir(self.folder.path()).unwrap() {
            let found = entry.unwrap().file_name().into_string().unwrap();
            assert!(!found.starts_with(name), "{found} was left behind");
        }
    }
}

#[test]
fn no_arguments_and_unknown_flags_are_usage_errors() {
    for arguments in
        [&[][..], &["--what"], &["ingest"], &["ingest", "x.esker"], &["nonsense"], &["query", "s", "--wat"]]
    {
        let output = esker(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(!output.stderr.is_empty());
    }
    // Whatever the store is: these are wrong before it is looked at, or for any.
    let place = Place::new();
    let (store, out, las) = (place.store(10), place.path("o.csv"), place.path("torus.las"));
    let view = place.write("view.json", br#"{"eye":[0,0,9],"target":[0,0,0]}"#);
    for arguments in [
        &["nearest", &store, "--at", "1,2"][..],
        &["nearest", &store, "--at", "1,2,3", "-k", "0"],
        &["nearest", &store, "--at", "1,2,3", "-o", "near.las"],
        &["ingest", &store, &las, "--crs", "EPSG:abc"],
        &["ingest", &store, &las, "--phase", "inf"],
        &["query", &store, "--view", &view, "--policy", "foo"],
        &["query", &store, "--view", &view, "--policy", "distance", "--max-error-px", "2"],
        &["query", &store, "--scale", "0.1", "-o", &out],
        &["query", &store, "-o", "out.docx"],
        &["query", &store, "--split-by", "scan", "--format", "csv", "-o", "-"],
        &["density", &store, "--side", "1", "-o", "raster.docx"],
        &["render", &store, "--range", "1,2", "--color", "class", "-o", "o.png"],
        &["render", &store, "--min-px", "3", "--max-px", "2", "-o", "o.png"],
        &["render", &store, "-o", "o.jpg"],
        &["generate", "torus", "--points", "10", "--laz", "-o", &out],
        &["generate", "site", "--points", "10", "-o", "site.las"],
    ] {
        esker_fails(arguments, 2, &[]);
    }
    for command in ["ingest", "scans", "info", "query", "render", "verify", "digest", "generate"] {
        let help = esker_ok(&[command, "--help"]);
        assert!(help.contains("Example"), "{command} --help has no example");
    }
}

/// A message that nobody can read ended the command with a panic, though its work was done.
#[test]
fn messages_that_cannot_be_written_change_nothing() {
    let place = Place::new();
    let text = place.write("far.csv", b"x,y,z\n0.1,0.2,0.3\n1e300,0,0\n0,0,nan\n");
    let store = place.path("s.esker");
    let unheard = |arguments: &[&str]| {
        let full = fs::File::options().write(true).open("/dev/full").unwrap();
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_esker"));
        command.args(arguments).stderr(full).output().unwrap().status.code()
    };
    assert_eq!(unheard(&["ingest", &store, &text, "--progress", "json"]), Some(0));
    assert_eq!(unheard(&["query", &store, "--box", "0,0,0,0.1,1,1", "--count"]), Some(0));
    assert_eq!(unheard(&["query", &store, "--closed", "--capacity", "1", "-o", &place.path("o.csv")]), Some(0));
    assert_eq!(unheard(&["nearest", &store, "--at", "1,2,3", "--json"]), Some(0));
    assert_eq!(unheard(&["info", &place.path("nothing.esker")]), Some(1));
    // Given again, it ends as before: what was rejected then is not forgotten.
    for _ in 0..2 {
        esker_fails(&["ingest", &store, &text, "--strict"], 3, &[]);
    }
    assert!(esker_ok(&["ingest", &store, &text]).contains("; 2 points rejected then"));
}

#[test]
fn options_that_have_no_effect_are_told() {
    let place = Place::new();
    let store = place.store(100);
    let told = |arguments: &[&str]| {
        let output = esker(arguments);
        assert!(output.status.success());
        String::from_utf8(output.stderr).unwrap()
    };
    let closed = "--closed has no effect";
    assert!(told(&["query", &store, "--count", "--closed"]).contains(closed));
    assert!(told(&["nearest", &store, "--at", "1,2,3", "--closed", "--sphere", "0,0,0,9"]).contains(closed));
    assert!(!told(&["query", &store, "--count", "--closed", "--box", "-1,-1,1,1"]).contains(closed));
    let columns = ["ingest", &place.path("other.esker"), &place.path("torus.las"), "--columns", "x,y,z,foo"];
    assert!(told(&columns).contains("the names of columns are of no use"));
    for arguments in [
        &["density", &store, "--side", "1", "--value", "lowest"][..],
        &["density", &store, "--side", "1", "--value", "lowest", "-o", &place.path("d.csv")],
        &["query", &store, "--count", "--attributes", "Red"],
        &["query", &store, "--count", "--force"],
        &["query", &store, "-o", "-"],
        &["density", &store, "--side", "1", "-o", "-"],
    ] {
        esker_fails(arguments, 2, &[]);
    }
}

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
fn stores_that_are_none_or_too_new_are_refused() {
    let place = Place::new();
    let text =
        place.write("a.esker", b"not a database, just some words that are long enough to be read as a header....");
    for command in ["info", "scans", "query", "verify", "digest", "render"] {
        let out = place.path("x.png");
        let mut arguments = vec![command, text.as_str()];
        if command == "render" {
            arguments.extend(["-o", &out]);
        }
        esker_fails(&arguments, 1, &["a.esker"]);
    }
    let las = place.las("a.las", 10);
    esker_fails(&["ingest", &text, &las], 1, &["a.esker"]);
    esker_fails(&["info", &place.path("none.esker")], 1, &["none.esker"]);
    fs::create_dir(place.path("dir.esker")).unwrap();
    esker_fails(&["info", &place.path("dir.esker")], 1, &["dir.esker"]);

    // SQLite keeps user_version at byte 60 of the file.
    let store = place.store(10);
    let mut bytes = fs::read(&store).unwrap();
    bytes[60..64].copy_from_slice(&99_u32.to_be_bytes());
    let newer = place.write("newer.esker", &bytes);
    esker_fails(&["info", &newer], 1, &["99", "newer"]);
}

#[test]
fn outputs_that_exist_are_not_overwritten() {
    let place = Place::new();
    let store = place.store(500);
    let out = place.write("out.las", b"precious");
    esker_fails(&["query", &store, "-o", &out], 1, &["out.las", "--force"]);
    assert_eq!(fs::read(&out).unwrap(), b"precious");
    esker_ok(&["query", &store, "-o", &out, "--force"]);
    assert!(fs::read(&out).unwrap().starts_with(b"LASF"));
    let picture = place.write("out.png", b"precious");
    esker_fails(&["render", &store, "-o", &picture], 1, &["out.png", "--force"]);
    esker_fails(&["query", &store, "-o", &place.path("out.xyzw")], 2, &["xyzw"]);
    esker_fails(&["generate", "torus", "--points", "10", "-o", &out], 1, &["--force"]);
}

#[test]
fn a_place_that_cannot_be_written_is_named() {
    let place = Place::new();
    let las = place.las("a.las", 10);
    let store = place.store(10);
    for nowhere in ["no/such/folder/s.esker", "a.las/s.esker"] {
        // Before the inputs are read, also what is wrong with them.
        let folder = place.path(nowhere.strip_suffix("/s.esker").unwrap());
        let expected = format!("s.esker: the folder {folder} does not exist; create it first");
        esker_fails(&["ingest", &place.path(nowhere), &place.path("none.las")], 1, &[&expected]);
        esker_fails(&["compact", &store, "-o", &place.path(nowhere)], 1, &[&expected]);
    }
    esker_fails(&["ingest", "/proc/s.esker", &las], 1, &["/proc"]);
    esker_fails(&["query", &store, "-o", &place.path("no/such/out.las")], 1, &["out.las"]);
}

#[test]
fn a_full_disk_leaves_the_store_as_it_was() {
    let place = Place::new();
    let shim = crate::faults::shim(place.folder.path());
    let store = place.store(20_000);
    let before = esker_ok(&["digest", &store]);
    esker_ok(&["generate", "spheres", "--points", "200000", "-o", &place.path("more.las")]);
    for bytes in ["0", "100000", "1000000"] {
        let output = Command::new(env!("CARGO_BIN_EXE_esker"))
            .args(["ingest", &store, &place.path("more.las")])
            .env("LD_PRELOAD", &shim)
            .env("ESKER_TEST_PATH", "torus.esker")
            .env("ESKER_TEST_FAULT", format!("full:{bytes}"))
            .output()
            .unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{bytes}: {stderr}");
        assert!(stderr.contains("torus.esker") && stderr.contains("full"), "{bytes}: {stderr}");
        assert_eq!(esker_ok(&["digest", &store]), before, "after {bytes} bytes");
        esker_ok(&["verify", &store]);
    }
    // With room again, the same command does it.
    esker_ok(&["ingest", &store, &place.path("more.las")]);
    assert_eq!(esker_ok(&["query", &store, "--count"]).trim(), "220000");
}

/// Runs it where every write to a file whose path contains `part` finds the disk full.
fn esker_on_full_disk(shim: &Path, part: &str, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_esker"));
    command.args(arguments).env("LD_PRELOAD", shim);
    command.env("ESKER_TEST_PATH", part).env("ESKER_TEST_FAULT", "full:0").output().unwrap()
}

#[test]
fn a_store_on_a_full_disk_can_be_read() {
    // SQLite found no room for the index of a log that was not there.
    let place = Place::new();
    let shim = crate::faults::shim(place.folder.path());
    let store = place.store(1000);
    let out = place.path("out.csv");
    for arguments in [
        &["query", &store, "--count"][..],
        &["info", &store],
        &["digest", &store],
        &["verify", "--deep", &store],
        &["query", &store, "-o", &out],
    ] {
        let output = esker_on_full_disk(&shim, "torus.esker", arguments);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{arguments:?}: {stderr}");
        if arguments[0] != "info" && !arguments.contains(&"verify") {
            let _ = fs::remove_file(&out);
            assert_eq!(String::from_utf8_lossy(&output.stdout), esker_ok(arguments), "{arguments:?}");
        }
        for suffix in ["-shm", "-wal"] {
            place.nothing_there(&format!("torus.esker{suffix}"));
        }
    }
    // Whoever writes is told, and leaves nothing either.
    let output = esker_on_full_disk(&shim, "torus.esker", &["hide", &store, "torus"]);
    assert!(output.status.code() == Some(1) && String::from_utf8_lossy(&output.stderr).contains("the disk is full"));
    place.nothing_there("torus.esker-");
    // A log has to be applied, and that needs the index.
    fs::write(format!("{store}-wal"), b"some log").unwrap();
    let output = esker_on_full_disk(&shim, "torus.esker", &["query", &store, "--count"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(1) && stderr.contains("the disk is full"), "{stderr}");
}

#[test]
fn a_full_disk_is_that_of_the_file_that_is_written() {
    let place = Place::new();
    let shim = crate::faults::shim(place.folder.path());
    let store = place.store(1000);
    fs::create_dir(place.path("full")).unwrap();
    let copy = place.path("full/copy.esker");
    let output = esker_on_full_disk(&shim, "/full/", &["compact", &store, "-o", &copy]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(stderr.starts_with(&format!("esker: {copy}: the disk is full")), "{stderr}");
    assert_eq!(fs::read_dir(place.path("full")).unwrap().count(), 0);
    // What goes to the standard output lies in the folder for temporary files until it is whole.
    let output = Command::new(env!("CARGO_BIN_EXE_esker"))
        .args(["query", &store, "-o", "-", "--format", "las"])
        .env("LD_PRELOAD", &shim)
        .env("ESKER_TEST_PATH", "/full/")
        .env("ESKER_TEST_FAULT", "full:0")
        .env("TMPDIR", place.path("full"))
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(stderr.contains(&place.path("full")) && stderr.contains("TMPDIR"), "{stderr}");
    assert_eq!(fs::read_dir(place.path("full")).unwrap().count(), 0);
}

#[cfg(unix)]
#[test]
fn a_limit_of_file_sizes_is_an_ordinary_error() {
    // A signal ended the process without a word, and half-written files stayed.
    let place = Place::new();
    let store = place.store(20_000);
    let before = esker_ok(&["digest", &store]);
    let more = place.path("more.las");
    esker_ok(&["generate", "spheres", "--points", "200000", "-o", &more]);
    for arguments in [
        &["ingest", &store, &more][..],
        &["compact", &store, "-o", &place.path("copy.esker")],
        &["query", &store, "-o", &place.path("out.csv")],
        &["query", &store, "-o", &place.path("out.las")],
        &["generate", "torus", "--points", "100000", "-o", &place.path("out.las")],
    ] {
        // Blocks of 512 bytes or of 1024, as the shell has them.
        let script = ["-c", "ulimit -f 100; exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_esker")];
        let output =
            Command::new("sh").args(script).args(arguments).env("TMPDIR", place.folder.path()).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {stderr}");
        assert!(
            stderr.contains("no file may be larger than") && stderr.contains("ulimit -f"),
            "{arguments:?}: {stderr}"
        );
        let mut left: Vec<_> =
            fs::read_dir(place.folder.path()).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        left.sort();
        assert_eq!(left, ["more.las", "torus.esker", "torus.las"], "{arguments:?}");
        assert_eq!(esker_ok(&["digest", &store]), before, "{arguments:?}");
    }
    esker_ok(&["verify", &store]);
}

#[test]
fn a_value_may_begin_with_a_dash_and_no_option_is_taken_for_one() {
    let place = Place::new();
    let store = place.path("s.esker");
    let rows = place.write("rows.txt", b"7 1 2 3\n8 4 5 -6\n");
    esker_ok(&["ingest", &store, &rows, "--name", "-north", "--columns", "-,x,y,z"]);
    esker_ok(&["ingest", &store, &place.las("torus.las", 10)]);
    let count = |arguments: &[&str]| esker_ok(&[&["query", &store, "--count"], arguments].concat()).trim().to_owned();
    assert_eq!(count(&["--scan", "-north"]), "2");
    assert_eq!(count(&["--scan", "-north", "--where", "-5 < z"]), "1");
    for forgotten in [&["query", &store, "--scan", "--count"][..], &["ingest", &store, &rows, "--name", "--strict"]] {
        esker_fails(forgotten, 2, &["looks like an option"]);
    }
    esker_ok(&["replace", &store, "--name", "-south", "--", "-north", &rows]);
    esker_ok(&["hide", &store, "--", "-south"]);
    esker_ok(&["remove", &store, "--", "-south"]);
    assert_eq!(count(&[]), "10");
}

#[cfg(target_os = "linux")]
#[test]
fn a_standard_output_that_is_full_is_named() {
    let place = Place::new();
    let store = place.store(10);
    for arguments in [&["query", &store, "--count"][..], &["info", &store, "--json"]] {
        let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let output = Command::new(env!("CARGO_BIN_EXE_esker")).args(arguments).stdout(full).output().unwrap();
        let told = String::from_utf8_lossy(&output.stderr);
        assert!(told.starts_with("esker: writing to the standard output failed: No space left"), "{told}");
        assert_eq!((output.status.code(), told.lines().count()), (Some(1), 1));
    }
}

#[test]
fn how_a_file_is_written_is_not_asked_for_where_none_is() {
    let place = Place::new();
    let store = place.store(10);
    for only in ["--count", "--explain"] {
        for how in [&["--split-by", "scan"][..], &["--scale", "0.1"], &["--format", "las"], &["--frame", "scan"]] {
            esker_fails(&[&["query", &store, only], how].concat(), 2, &["cannot be used with", how[0]]);
        }
    }
}

#[test]
fn an_interrupt_keeps_what_was_committed() {
    let place = Place::new();
    let store = place.store(1000);
    let before = esker_ok(&["digest", &store]);
    esker_ok(&["generate", "terrain", "--points", "3000000", "-o", &place.path("big.las")]);
    let mut child = Command::new(env!("CARGO_BIN_EXE_esker"))
        .args(["ingest", &store, &place.path("big.las"), "--threads", "1", "--progress", "json"])
        .stderr(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    // Once it says that it is reading, its signal handler is in place.
    let mut lines = std::io::BufRead::lines(std::io::BufReader::new(child.stderr.take().unwrap()));
    assert!(lines.next().unwrap().unwrap().contains("reading"));
    let interrupted = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(interrupted.success());
    let rest: Vec<_> = lines.map(Result::unwrap).collect();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{rest:?}");
    assert!(rest.iter().any(|l| l.contains("interrupted")), "{rest:?}");
    assert_eq!(esker_ok(&["digest", &store]), before);
    assert!(
        fs::read_dir(place.folder.path()).unwrap().all(|e| !e.unwrap().file_name().to_string_lossy().contains("spill"))
    );
}

#[test]
fn a_read_only_store_can_be_read() {
    let place = Place::new();
    let store = place.store(1000);
    let folder: PathBuf = place.folder.path().join("medium");
    fs::create_dir(&folder).unwrap();
    let copy = folder.join("torus.esker");
    fs::copy(&store, &copy).unwrap();
    let mut permissions = fs::metadata(&copy).unwrap().permissions();
    permissions.set_readonly(true);
    fs::set_permissions(&copy, permissions).unwrap();
    assert_eq!(esker_ok(&["query", copy.to_str().unwrap(), "--count"]).trim(), "1000");
    esker_ok(&["verify", copy.to_str().unwrap()]);
}

#[test]
fn a_closed_pipe_ends_quietly() {
    let place = Place::new();
    let store = place.store(100_000);
    let mut child = Command::new(env!("CARGO_BIN_EXE_esker"))
        .args(["query", &store, "-o", "-", "--format", "csv"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(!stderr.contains("panicked"), "{stderr}");
    std::io::stdout().flush().unwrap();
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
fn options_without_effect_are_refused() {
    let place = Place::new();
    let store = place.store(1000);
    let (las, png) = (place.path("x.las"), place.path("x.png"));
    let torus = ["generate", "torus", "--points", "10", "-o", &las];
    esker_fails(&[&torus[..], &["--scans", "3"]].concat(), 2, &["--scans", "site"]);
    esker_fails(&[&torus[..], &["--laz"]].concat(), 2, &["--laz", "site"]);
    esker_fails(&["generate", "site", "--points", "10", "-o", &las], 2, &["x.las", "folder"]);
    assert!(!fs::exists(&las).unwrap());
    esker_fails(&["query", &store, "--max-error-px", "2"], 2, &["--view"]);
    esker_fails(&["query", &store, "--policy", "distance"], 2, &["--view"]);
    if cfg!(feature = "render") {
        let render = ["render", &store, "-o", &png];
        esker_fails(&[&render[..], &["--min-px", "50", "--max-px", "5"]].concat(), 2, &["--min-px 50", "--max-px 5"]);
        let ranged = [&render[..], &["--color", "class", "--range", "0,5"]].concat();
        esker_fails(&ranged, 2, &["--range", "class"]);
        assert!(!fs::exists(&png).unwrap());
    }
}

#[test]
fn steps_of_coordinates_are_positive() {
    // A scale of 0 was too fine for points that are so wide.
    let place = Place::new();
    let store = place.store(10);
    for steps in ["0", "-0.01", "0.01,0,0.01"] {
        let expected = ["is no positive number"];
        esker_fails(&["query", &store, "-o", &place.path("out.las"), "--scale", steps], 2, &expected);
        esker_fails(&["ingest", &place.path("new.esker"), &place.path("torus.las"), "--quantum", steps], 2, &expected);
    }
    let split = ["query", &store, "--split-by", "scan", "-o", "-"];
    esker_fails(&split, 2, &["splitting writes several files; give a file name"]);
}

#[test]
fn a_scan_has_a_name() {
    let place = Place::new();
    let (las, store) = (place.las("a.las", 100), place.path("a.esker"));
    for name in ["", " "] {
        esker_fails(&["ingest", &store, &las, "--name", name], 1, &["name", "empty"]);
    }
    assert!(!fs::exists(&store).unwrap());
    esker_ok(&["ingest", &store, &las]);
    esker_fails(&["replace", &store, "a", "--name", ""], 1, &["name", "empty"]);
    esker_fails(&["replace", &store, "a", &las, "--name", ""], 1, &["name", "empty"]);
}

#[test]
fn a_heading_that_names_an_axis_twice_is_told_with_its_columns() {
    let place = Place::new();
    let csv = place.write("a.csv", b"X,Y,Z,Intensity,x\n1,2,3,4,5\n6,7,8,9,10\n");
    let store = place.path("a.esker");
    esker_fails(&["ingest", &store, &csv], 1, &["line 1", "columns 1 and 5", "--columns"]);
    esker_ok(&["ingest", &store, &csv, "--columns", "x,y,z,Intensity,dx"]);
}

#[cfg(unix)]
#[test]
fn a_link_that_leads_nowhere_is_not_waited_for() {
    // With --wait the program asked again for ever.
    let place = Place::new();
    let (las, link) = (place.las("a.las", 100), place.path("link.esker"));
    std::os::unix::fs::symlink(place.path("nowhere.esker"), &link).unwrap();
    let mut child = Command::new(env!("CARGO_BIN_EXE_esker"))
        .args(["ingest", &link, &las, "--wait"])
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let begun = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if begun.elapsed() > Duration::from_secs(20) {
            child.kill().unwrap();
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("link.esker"), "{output:?}");
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

#[cfg(target_os = "linux")]
mod permissions {
    use super::*;
    use rustix::thread::{CapabilitySet, CapabilitySets, set_capabilities, set_no_new_privs};
    use std::os::unix::fs::PermissionsExt;

    fn allow(path: &str, mode: u32) {
        fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
    }

    /// Runs the program as somebody whom permissions bind. They do not bind a superuser: its rights are given up for good, in a
    /// thread of its own, and the program that is started there gets none back. (Another user's name would not do: the folders
    /// that the program and the store lie in may be closed to others.)
    fn esker_bound(arguments: &[&str]) -> Output {
        let none = CapabilitySet::empty();
        let bound = || {
            set_no_new_privs(true).unwrap();
            set_capabilities(None, CapabilitySets { effective: none, permitted: none, inheritable: none }).unwrap();
            Command::new(env!("CARGO_BIN_EXE_esker")).args(arguments).output().unwrap()
        };
        std::thread::scope(|scope| scope.spawn(bound).join().unwrap())
    }

    #[test]
    fn a_store_that_may_not_be_read_is_told_so() {
        // It was said that it cannot be written.
        let place = Place::new();
        let store = place.store(10);
        allow(&store, 0);
        for arguments in [["info", &store], ["digest", &store]] {
            let output = esker_bound(&arguments);
            let stderr = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(1), "{stderr}");
            assert!(
                stderr.starts_with(&format!("esker: {store}: reading the store failed: Permission denied")),
                "{stderr}"
            );
        }
    }

    #[test]
    fn a_store_that_may_only_be_read_is_copied() {
        let place = Place::new();
        let [medium, out] = ["medium", "out"].map(|name| place.path(name));
        fs::create_dir(&medium).unwrap();
        fs::create_dir(&out).unwrap();
        let (store, copy) = (format!("{medium}/torus.esker"), format!("{out}/copy.esker"));
        fs::copy(place.store(20_000), &store).unwrap();
        allow(&store, 0o444);
        allow(&medium, 0o555);
        let before = fs::read(&store).unwrap();
        let output = esker_bound(&["compact", &store, "-o", &copy]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        // Without a copy it is written, and can't be.
        let output = esker_bound(&["compact", &store]);
        assert!(String::from_utf8_lossy(&output.stderr).contains("torus.esker: cannot be written"));
        allow(&medium, 0o755);
        assert_eq!(esker_ok(&["digest", &copy]), esker_ok(&["digest", &store]));
        assert!(fs::read(&store).unwrap() == before);
        esker_ok(&["verify", &copy, "--deep"]);
    }
}

#[cfg(unix)]
#[test]
fn an_interrupted_model_leaves_nothing() {
    // Its temporary file stayed for ever.
    let place = Place::new();
    let mut child = Command::new(env!("CARGO_BIN_EXE_esker"))
        .args(["generate", "terrain", "--points", "500M", "-o", &place.path("t.laz")])
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let entries = || fs::read_dir(place.folder.path()).unwrap().count();
    let begun = Instant::now();
    while entries() == 0 {
        assert!(begun.elapsed() < Duration::from_secs(60) && child.try_wait().unwrap().is_none());
        std::thread::sleep(Duration::from_millis(10));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert_eq!(entries(), 0);
}

//! Whatever a user does wrong: one line that says what to do, an exit code, nothing lost.

mod files;

use crate::support::{esker, esker_fails, esker_ok};
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

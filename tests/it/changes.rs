//! `remove`, `replace`, `show`, `hide`, `compact` and `merge` as a user meets them, and what they leave alone.

use crate::support::{Random, TinyLas, esker, esker_fails, esker_ok};
use esker::ingest::{IngestOptions, LatticeWish, ingest};
use esker::lattice::LatticePoint;
use esker::query::Query;
use esker::store::Store;
use std::fs;
use std::time::{Duration, Instant};

struct Place(tempfile::TempDir);

impl Place {
    fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().to_owned()
    }

    /// Four overlapping generated scans, `site_1` to `site_4`, and a store of them.
    fn site() -> Self {
        let place = Self(tempfile::tempdir().unwrap());
        esker_ok(&["generate", "site", "--points", "240k", "-o", &place.path("scans")]);
        esker_ok(&["ingest", &place.path("s.esker"), &place.path("scans")]);
        place
    }
}

fn count(store: &str, more: &[&str]) -> u64 {
    esker_ok(&[&["query", store, "--count"], more].concat()).trim().parse().unwrap()
}

#[test]
fn hidden_scans_are_left_out_unless_they_are_named() {
    let place = Place::site();
    let store = place.path("s.esker");
    let (all, one) = (count(&store, &[]), count(&store, &["--scan", "site_2"]));
    let before = esker_ok(&["digest", &store]);
    esker_ok(&["hide", &store, "site_2"]);
    assert_eq!(count(&store, &[]), all - one);
    assert_eq!(count(&store, &["--scan", "site_2"]), one);
    assert!(esker_ok(&["scans", &store]).contains("site_2  (hidden)"));
    assert_eq!(esker_ok(&["digest", &store]), before, "hiding touches no point");
    // What a picture's legend lists.
    let snapshot = Store::open(&store).unwrap().snapshot().unwrap();
    let asked = |query: Query| query.asked_scans(&snapshot).unwrap();
    let id = |name: &str| snapshot.scans().iter().find(|s| s.name == name).unwrap().id;
    assert_eq!(asked(Query::new().scans(["site_2"])), [id("site_2")]);
    assert!(!asked(Query::new()).contains(&id("site_2")));
    assert_eq!(asked(Query::new()).len(), snapshot.scans().len() - 1);
    drop(snapshot);
    assert!(esker_ok(&["hide", &store, "site_2"]).contains("nothing to do"));
    esker_ok(&["replace", &store, "site_2"]);
    assert!(esker_ok(&["hide", &store, "site_2"]).contains("nothing to do"), "what takes its place is hidden, too");
    esker_ok(&["show", &store, "site_2"]);
    assert_eq!(count(&store, &[]), all);
    for command in ["hide", "show", "remove"] {
        esker_fails(&[command, &store, "site_"], 1, &["no scan 'site_'", "site_1"]);
        esker_fails(&[command, &place.path("none.esker"), "x"], 1, &["none.esker"]);
        esker_fails(&[command, &store], 2, &[]);
    }
    assert_eq!(esker_ok(&["digest", &store]), before);
}

#[test]
fn a_scan_that_is_removed_or_replaced_leaves_no_trace() {
    let place = Place::site();
    let store = place.path("s.esker");
    let scan = |i: u32| place.path(&format!("scans/site_{i}.las"));
    let before = esker_ok(&["digest", &store]);
    esker_ok(&["remove", &store, "site_3", "1"]);
    let fresh = place.path("fresh.esker");
    let inputs = [scan(2), scan(4), scan(5)];
    let arguments: Vec<&str> =
        ["ingest", &fresh, "--lattice", &store].into_iter().chain(inputs.iter().map(String::as_str)).collect();
    esker_ok(&arguments);
    assert_eq!(esker_ok(&["digest", &store]), esker_ok(&["digest", &fresh]));
    // In the other scan's place, and back again.
    esker_ok(&["replace", &store, "site_2", &scan(1)]);
    assert!(esker_ok(&["scans", &store]).contains("site_2"), "the name stays");
    esker_fails(&["replace", &store, "site_9", &scan(1)], 1, &["no scan 'site_9'"]);
    let now = esker_ok(&["digest", &store, "--json"]);
    esker_fails(&["replace", &store, "site_2", &scan(4)], 1, &["'site_2' was not replaced", "site_4"]);
    assert_eq!(esker_ok(&["digest", &store, "--json"]), now);
    let points = esker_ok(&["digest", &store]);
    assert!(now.contains(points.lines().next().unwrap().trim_start_matches("points ")), "{now} is not {points}");
    esker_ok(&["remove", &store, "site_2"]);
    esker_ok(&["ingest", &store, &scan(3), &scan(2), &scan(1)]);
    assert_eq!(esker_ok(&["digest", &store]), before);
    esker_ok(&["verify", &store, "--deep"]);
}

#[test]
fn space_is_given_back() {
    let place = Place::site();
    let (store, fresh, copy) = (place.path("s.esker"), place.path("fresh.esker"), place.path("copy.esker"));
    esker_ok(&["remove", &store, "site_1", "site_3"]);
    // As a run that was cut off leaves it.
    fs::write(place.path("copy.esker.partial-7-0"), "half a copy").unwrap();
    fs::write(place.path("copy.esker.partial-7-0-wal"), "its log").unwrap();
    // Files of a user's.
    let users = ["copy.esker.partial", "s.esker.spill-2", "s.esker.spill-report.txt"];
    users.iter().for_each(|name| fs::write(place.path(name), "notes").unwrap());
    fs::create_dir(place.path("s.esker.spill-1-1")).unwrap();
    esker_ok(&["compact", &store, "-o", &copy]);
    esker_ok(&["compact", &store]);
    let scans = [2, 4, 5].map(|i| place.path(&format!("scans/site_{i}.las")));
    esker_ok(&["ingest", &fresh, "--lattice", &store, &scans[0], &scans[1], &scans[2]]);
    let bytes = |path: &str| fs::metadata(path).unwrap().len() as f64;
    assert!(bytes(&store) <= 1.05 * bytes(&fresh), "{} after, {} fresh", bytes(&store), bytes(&fresh));
    assert!(bytes(&copy) <= 1.05 * bytes(&fresh), "{} in the copy, {} fresh", bytes(&copy), bytes(&fresh));
    assert_eq!(esker_ok(&["digest", &copy]), esker_ok(&["digest", &fresh]));
    esker_fails(&["compact", &store, "-o", &copy], 1, &["already"]);
    // Under that name it would be the store's own log.
    let log = format!("{store}-wal");
    esker_fails(&["compact", &store, "-o", &log], 1, &["ends in -wal", "give another name"]);
    assert!(!std::path::Path::new(&log).exists());
    // While somebody else makes a copy of that name: both would write one file.
    let other = place.path("other.esker");
    let lock = fs::File::create(format!("{other}-lock")).unwrap();
    lock.lock().unwrap();
    esker_fails(&["compact", &store, "-o", &other], 1, &["other.esker", "--wait"]);
    assert!(!fs::exists(&other).unwrap());
    drop(lock);
    esker_ok(&["compact", &store, "-o", &other]);
    assert_eq!(esker_ok(&["digest", &other]), esker_ok(&["digest", &fresh]));
    assert!(!fs::exists(format!("{other}-lock")).unwrap());
    for left in fs::read_dir(place.path("")).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()) {
        assert!(!left.contains(".partial-"), "{left} was left behind");
    }
    assert!(users.iter().all(|name| fs::read_to_string(place.path(name)).unwrap() == "notes"));
    assert!(fs::exists(place.path("s.esker.spill-1-1")).unwrap());
}

#[test]
fn a_source_that_is_read_again_is_the_same_file_wherever_that_is_asked() {
    // It was taken from the folder in which the command ran: another file of that name came into its place, without a word.
    let place = Place(tempfile::tempdir().unwrap());
    for (folder, points) in [("a", 3), ("b", 5)] {
        let mut las = TinyLas::new(1);
        (0..points).for_each(|i| las.push([i, 2 * i, 7], 1));
        fs::create_dir(place.path(folder)).unwrap();
        fs::write(place.path(&format!("{folder}/x.las")), las.bytes()).unwrap();
    }
    let run = |folder: &str, arguments: &[&str]| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_esker"));
        command.args(arguments).current_dir(place.path(folder)).output().unwrap()
    };
    let store = place.path("s.esker");
    assert!(run("a", &["ingest", &store, "x.las"]).status.success());
    let source = |store: &str| {
        let scans: serde_json::Value = serde_json::from_str(&esker_ok(&["scans", store, "--json"])).unwrap();
        scans["scans"][0]["source"].as_str().unwrap().to_owned()
    };
    assert_eq!(fs::canonicalize(source(&store)).unwrap(), fs::canonicalize(place.path("a/x.las")).unwrap());
    let again = run("b", &["replace", &store, "x"]);
    assert!(again.status.success() && again.stderr.is_empty(), "{again:?}");
    assert_eq!(count(&store, &[]), 3);
    // Edited since, it is taken, and that is said.
    fs::copy(place.path("b/x.las"), place.path("a/x.las")).unwrap();
    let edited = run("b", &["replace", &store, "x"]);
    let said = String::from_utf8(edited.stderr).unwrap();
    assert!(edited.status.success() && said.contains("x.las has changed") && said.contains(&source(&store)), "{said}");
    assert_eq!(count(&store, &[]), 5);
}

#[test]
fn merge_keeps_bookmarks() {
    // They were lost without a word.
    let place = Place(tempfile::tempdir().unwrap());
    fs::write(place.path("p.xyz"), "1 2 3\n4 5 6\n").unwrap();
    let store = |name: &str, bookmarks: &[(&str, &str)]| {
        let path = place.path(name);
        esker_ok(&["ingest", &path, &place.path("p.xyz")]);
        let mut writer = Store::open(&path).unwrap().writer().unwrap();
        bookmarks.iter().for_each(|(name, camera)| writer.put_bookmark(name, camera).unwrap());
        path
    };
    let a = store("a.esker", &[("door", "{\"at\":1}"), ("roof", "{\"at\":2}")]);
    let b = store("b.esker", &[("door", "{\"at\":3}"), ("door-2", "{\"at\":4}"), ("roof", "{\"at\":2}")]);
    let out = place.path("out.esker");
    let merged = esker(&["merge", &out, &a, &b, &a]);
    let said = String::from_utf8(merged.stderr).unwrap();
    assert!(merged.status.success() && said.contains("b.esker: its bookmark 'door' is 'door-3'"), "{said}");
    assert_eq!(said.lines().count(), 1, "{said}");
    let kept = Store::open(&out).unwrap().snapshot().unwrap().bookmarks().unwrap();
    let kept: Vec<(&str, &str)> = kept.iter().map(|(name, camera)| (name.as_str(), camera.as_str())).collect();
    let all = [("door", "{\"at\":1}"), ("door-2", "{\"at\":4}"), ("door-3", "{\"at\":3}"), ("roof", "{\"at\":2}")];
    assert_eq!(kept, all);
    esker_ok(&["verify", &out, "--deep"]);
}

#[test]
fn merge_refuses_what_is_not_alike_and_writes_over_nothing() {
    let place = Place::site();
    let (store, other, out) = (place.path("s.esker"), place.path("o.esker"), place.path("out.esker"));
    esker_ok(&["ingest", &other, &place.path("scans/site_1.las"), "--quantum", "0.01"]);
    esker_fails(&["merge", &out, &store, &other], 1, &["o.esker", "quantum", "--lattice"]);
    assert!(!fs::exists(&out).unwrap());
    esker_fails(&["merge", &store, &other], 1, &["already"]);
    esker_ok(&["merge", &out, &store, &store]);
    assert_eq!(esker_ok(&["digest", &out]), esker_ok(&["digest", &store]));
    // What names no CRS is joined, and that is said.
    let (bare, joined) = (place.path("bare.esker"), place.path("joined.esker"));
    fs::write(place.path("bare.xyz"), "690000 5330000 500\n690001 5330001 501\n").unwrap();
    esker_ok(&["ingest", &bare, &place.path("bare.xyz"), "--lattice", &store]);
    let output = esker(&["merge", &joined, &store, &bare]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && said.contains("bare.esker names no CRS") && said.contains("UTM"), "{said}");
}

#[test]
fn a_second_writer_is_told_or_waits() {
    let place = Place::site();
    let store = place.path("s.esker");
    let writer = Store::open(&store).unwrap().writer().unwrap();
    esker_fails(&["hide", &store, "site_1"], 1, &["s.esker", "another process", "--wait"]);
    let begun = Instant::now();
    let waiting = std::thread::spawn({
        let store = store.clone();
        move || esker(&["hide", &store, "site_1", "--wait"])
    });
    std::thread::sleep(Duration::from_millis(400));
    drop(writer);
    let output = waiting.join().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(begun.elapsed() >= Duration::from_millis(400));
}

#[test]
fn what_a_scan_does_not_touch_keeps_its_rows() {
    let place = Place(tempfile::tempdir().unwrap());
    let mut random = Random(99);
    let mut file = |name: &str, points: u64, origin: i32, side: u64| {
        let mut las = TinyLas::new(1);
        for _ in 0..points {
            las.push([0; 3].map(|_: i32| origin + random.below(side) as i32), random.next());
        }
        fs::write(place.path(name), las.bytes()).unwrap();
        las.positions()
    };
    file("site.las", 20_000, 0, 1 << 12);
    let added = file("patch.las", 300, 900, 120);
    let options = IngestOptions {
        lattice: LatticeWish { quantum: Some([0.01; 3]), phase: None },
        g: 3,
        leaf_capacity: 50,
        ..IngestOptions::default()
    };
    let store = std::path::PathBuf::from(place.path("s.esker"));
    let built = ingest(&store, &[place.path("site.las").into()], &options, &()).unwrap();
    let rows = "SELECT count(*) FROM chunk";
    let rows: i64 = rusqlite::Connection::open(&store).unwrap().query_row(rows, [], |row| row.get(0)).unwrap();
    let rows = rows as u64;
    assert_eq!(built.chunks_written, rows);
    let open = || Store::open(&store).unwrap().snapshot().unwrap();
    let before = open();
    let report = ingest(&store, &[place.path("patch.las").into()], &options, &()).unwrap();
    let after = open();
    assert_eq!(after.site().roots.len(), 1, "the patch went into the tree that was there");
    assert!(report.chunks_written < rows / 5, "{} of {rows} rows", report.chunks_written);
    let (old, new) = (before.index().unwrap(), after.index().unwrap());
    assert_eq!(old.root(0).map(|r| old.head(r).cube), new.root(0).map(|r| new.head(r).cube));
    let bias = esker::lattice::BIAS;
    let at = |p: &[i32; 3]| LatticePoint(p.map(|v| (bias + i64::from(v)) as u64));
    let mut kept = 0;
    for head in old.heads() {
        if added.iter().any(|p| head.cube.contains(at(p))) {
            continue;
        }
        let now = new.find(0, head.cube).map(|n| new.head(n));
        assert_eq!(now.map(|h| h.chunk_base), Some(head.chunk_base), "{:?} was written again", head.cube);
        kept += 1;
    }
    assert!(kept * 10 > old.len() * 8, "{kept} of {} nodes", old.len());
}

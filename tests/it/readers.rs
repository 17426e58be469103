//! Law 7 for those who look while others write: every answer is that of one committed generation, and nobody fails or
//! waits for the writer.

use crate::support::{Random, TinyLas, esker, esker_ok};
use esker::ingest::{IngestError, IngestOptions, LatticeWish, Progress, Resources, Stage, compact, ingest, remove};
use esker::query::{Query, Region};
use esker::store::Store;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Points in steps of 0.01, ascending.
type Answer = Vec<[i64; 3]>;

/// What one generation holds.
#[derive(Debug, PartialEq)]
struct Content {
    all: Answer,
    /// In the box that is asked for.
    inside: Answer,
}

const LOW: f64 = 0.5;
const HIGH: f64 = 2.5;

impl Content {
    fn of<'l>(files: impl Iterator<Item = &'l TinyLas>) -> Self {
        let mut all: Answer = files.flat_map(TinyLas::positions).map(|p| p.map(i64::from)).collect();
        all.sort_unstable();
        let in_box = |v: &i64| (50..250).contains(v);
        let inside = all.iter().copied().filter(|p| p.iter().all(in_box)).collect();
        Self { all, inside }
    }
}

/// What the library answers, and for which generation; `after` so long with a snapshot that has read nothing.
fn ask(store: &Store, after: Duration) -> (u64, Answer, Duration) {
    let begun = Instant::now();
    let snapshot = store.snapshot().unwrap();
    let waited = begun.elapsed();
    std::thread::sleep(after);
    let query = Query::new().region(Region::new_box([LOW; 3], [HIGH; 3]).unwrap());
    let (batch, answer) = query.collect(&snapshot).unwrap();
    assert_eq!(answer.points, query.count(&snapshot).unwrap().points);
    let lattice = &snapshot.site().lattice;
    let world = |i| lattice.world_from_lattice(batch.positions.point(i)).map(|v| (v * 100.0).round() as i64);
    let mut points: Answer = (0..batch.positions.len()).map(world).collect();
    points.sort_unstable();
    (snapshot.generation(), points, waited)
}

/// What a process of its own answers: for the box, or for a camera that sees the whole site from so near that nothing is
/// finer than a pixel.
fn ask_process(store: &Path, view: Option<&Path>) -> Answer {
    let area = format!("{LOW},{LOW},{LOW},{HIGH},{HIGH},{HIGH}");
    let mut arguments = vec!["query", store.to_str().unwrap(), "-o", "-", "--format", "csv"];
    match view {
        Some(view) => arguments.extend(["--view", view.to_str().unwrap(), "--max-error-px", "1e-9"]),
        None => arguments.extend(["--box", &area]),
    }
    let output = esker(&arguments);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "a reader failed: {stderr}");
    let text = String::from_utf8(output.stdout).unwrap();
    let row = |line: &str| {
        let mut axes = line.split(',').take(3).map(|v| (v.parse::<f64>().unwrap() * 100.0).round() as i64);
        std::array::from_fn(|_| axes.next().unwrap())
    };
    let mut points: Answer = text.lines().skip(1).map(row).collect();
    points.sort_unstable();
    points
}

#[test]
fn readers_see_committed_generations_while_scans_come_and_go() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut random = Random(4711);
    let files: Vec<TinyLas> = (0..6_u64)
        .map(|i| {
            let mut las = TinyLas::new(1);
            for _ in 0..400 + 300 * i {
                las.push([0; 3].map(|_: i32| (60 * i + random.below(250)) as i32), random.next());
            }
            fs::write(at(&format!("f{i}.las")), las.bytes()).unwrap();
            las
        })
        .collect();
    let options = IngestOptions {
        lattice: LatticeWish { quantum: Some([0.01; 3]), phase: None },
        g: 3,
        leaf_capacity: 50,
        ..IngestOptions::default()
    };
    let store = at("s.esker");
    // Answers by generation, written down before the generation is committed.
    let expected: Mutex<BTreeMap<u64, Content>> = Mutex::default();
    let expect = |generation: u64, present: &[usize]| {
        let content = Content::of(present.iter().map(|&i| &files[i]));
        expected.lock().unwrap().insert(generation, content);
    };
    let view = at("view.json");
    let camera = r#"{"eye":[3,3,40],"target":[3,3,0],"up":[0,1,0],"fov_y_deg":60,"size":[640,480]}"#;
    fs::write(&view, camera).unwrap();
    expect(1, &[0]);
    ingest(&store, &[at("f0.las")], &options, &()).unwrap();

    let done = AtomicBool::new(false);
    let asked = AtomicU64::new(0);
    let waits: Mutex<Vec<Duration>> = Mutex::default();
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                let own = Store::open(&store).unwrap();
                let held = own.snapshot().unwrap();
                let first = ask(&own, Duration::ZERO);
                // At once, or when the snapshot's transactions have been renewed and others have committed meanwhile.
                for after in [0, 0, 0, 250].into_iter().cycle().map(Duration::from_millis) {
                    if done.load(Ordering::Relaxed) {
                        break;
                    }
                    let (generation, points, waited) = ask(&own, after);
                    let known = expected.lock().unwrap().get(&generation).map(|content| content.inside.clone());
                    assert_eq!(known, Some(points), "generation {generation}");
                    waits.lock().unwrap().push(waited);
                    asked.fetch_add(1, Ordering::Relaxed);
                }
                // A snapshot is what it was, however much has changed.
                assert!(own.changed(&held).unwrap());
                assert_eq!(held.generation(), first.0);
                let all = Query::new().count(&held).unwrap().points;
                assert_eq!(all, held.scans().iter().map(|s| s.stored).sum::<u64>());
            });
        }
        for view in [None, Some(view.as_path()), None, Some(view.as_path())] {
            let (done, asked, store, expected) = (&done, &asked, &store, &expected);
            scope.spawn(move || {
                while !done.load(Ordering::Relaxed) {
                    let points = ask_process(store, view);
                    let known = expected.lock().unwrap();
                    let is = |content: &Content| *if view.is_some() { &content.all } else { &content.inside } == points;
                    assert!(known.values().any(is), "{} points are no generation's", points.len());
                    asked.fetch_add(1, Ordering::Relaxed);
                }
            });
        }
        let changes = || {
            let mut present = vec![0];
            for round in 0..3 {
                for i in 1..6 {
                    present.push(i);
                    let generation = Store::open(&store).unwrap().snapshot().unwrap().generation();
                    expect(generation + 1, &present);
                    ingest(&store, &[at(&format!("f{i}.las"))], &options, &()).unwrap();
                }
                for i in [2, 5, 1, 4, 3] {
                    present.retain(|&p| p != i);
                    let generation = Store::open(&store).unwrap().snapshot().unwrap().generation();
                    expect(generation + 1, &present);
                    remove(&store, &[format!("f{i}")], &Resources::default(), &()).unwrap();
                }
                let generation = Store::open(&store).unwrap().snapshot().unwrap().generation();
                expect(generation + 1, &present);
                compact(&store, None, &Resources::default(), &()).unwrap_or_else(|e| panic!("round {round}: {e}"));
            }
        };
        let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(changes));
        done.store(true, Ordering::Relaxed);
        result.unwrap();
    });
    let mut waits = waits.into_inner().unwrap();
    waits.sort_unstable();
    let slow = waits.get(waits.len() * 99 / 100).copied().unwrap_or_default();
    println!("{} answers; 99 of 100 snapshots within {slow:?}", asked.load(Ordering::Relaxed));
    assert!(asked.load(Ordering::Relaxed) > 40, "hardly anybody looked");
    esker_ok(&["verify", store.to_str().unwrap(), "--deep"]);
}

/// Another program takes to reading just before the commit, and soon somebody wants the ingest to end.
struct ReaderInTheWay<'a> {
    store: &'a Path,
    reader: Mutex<Option<(rusqlite::Connection, Instant)>>,
}

impl Progress for ReaderInTheWay<'_> {
    fn stage(&self, stage: Stage, _total: u64) {
        if stage == Stage::Commit {
            let reader = rusqlite::Connection::open(self.store).unwrap();
            reader.execute_batch("BEGIN; SELECT * FROM site").unwrap();
            *self.reader.lock().unwrap() = Some((reader, Instant::now()));
        }
    }

    fn cancelled(&self) -> bool {
        let reader = self.reader.lock().unwrap();
        reader.as_ref().is_some_and(|(_, since)| since.elapsed() > Duration::from_millis(200))
    }
}

#[test]
fn a_first_ingest_that_waits_for_a_reader_can_be_interrupted() {
    let folder = tempfile::tempdir().unwrap();
    let (las, store) = (folder.path().join("a.las"), folder.path().join("a.esker"));
    let mut file = TinyLas::new(1);
    (0..3000).for_each(|i| file.push([i * 7 % 4001, i * 31 % 2003, i % 97], i as u64));
    fs::write(&las, file.bytes()).unwrap();
    let progress = ReaderInTheWay { store: &store, reader: Mutex::new(None) };
    let begun = Instant::now();
    let error = ingest(&store, std::slice::from_ref(&las), &IngestOptions::default(), &progress).unwrap_err();
    assert!(matches!(error, IngestError::Interrupted), "{error:?}");
    assert!(begun.elapsed() < Duration::from_secs(10), "{:?}", begun.elapsed());
    // It began with no store, and leaves none.
    assert!(!store.exists());
    drop(progress);
    ingest(&store, &[las], &IngestOptions::default(), &()).unwrap();
    esker_ok(&["verify", store.to_str().unwrap()]);
}

/// The log of an ingest of 2.9 GB beside a reader that keeps looking: with the sweeps.
#[test]
fn a_reader_that_stays_does_not_make_the_log_grow() {
    if std::env::var_os("ESKER_SWEEP").is_none() {
        println!("a sweep: set ESKER_SWEEP=1");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    esker_ok(&["generate", "terrain", "--points", "1M", "-o", &path("first.las")]);
    esker_ok(&["generate", "terrain", "--points", "80M", "--seed", "2", "-o", &path("large.las")]);
    esker_ok(&["ingest", &path("s.esker"), &path("first.las")]);
    let own = Store::open(path("s.esker")).unwrap();
    let held = own.snapshot().unwrap();
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_esker"));
    let mut ingest = command.args(["ingest", &path("s.esker"), &path("large.las")]).spawn().unwrap();
    let mut largest = 0;
    let status = loop {
        if let Some(status) = ingest.try_wait().unwrap() {
            break status;
        }
        largest = largest.max(fs::metadata(path("s.esker-wal")).map_or(0, |m| m.len()));
        assert_eq!(Query::new().count(&held).unwrap().points, 1_000_000);
        std::thread::sleep(Duration::from_millis(5));
    };
    assert!(status.success());
    println!("the log had at most {} MiB", largest >> 20);
    assert!(largest < 256 << 20, "{} MiB", largest >> 20);
    assert!(own.changed(&held).unwrap());
}

/// What SQLite makes beside a store belonged to the reader, and the owner could not write it any more.
#[cfg(unix)]
#[test]
fn a_reader_that_may_not_write_leaves_nothing_that_keeps_the_owner_out() {
    use std::os::unix::fs::PermissionsExt;
    use std::os::unix::process::CommandExt;
    let folder = tempfile::tempdir().unwrap();
    let open_to_all = |path: &std::path::Path| fs::set_permissions(path, fs::Permissions::from_mode(0o777)).unwrap();
    open_to_all(folder.path());
    let program = folder.path().join("esker");
    fs::copy(env!("CARGO_BIN_EXE_esker"), &program).unwrap();
    open_to_all(&program);
    let run = |user: u32, arguments: &[&str]| {
        let mut command = std::process::Command::new(&program);
        command.current_dir(folder.path()).args(arguments).uid(user).gid(user);
        command.output()
    };
    fs::write(folder.path().join("a.csv"), "x,y,z\n1,2,3\n").unwrap();
    let ingested = match run(1001, &["ingest", "s.esker", "a.csv"]) {
        Ok(output) => output,
        // Only root may run a program as somebody else.
        Err(e) if e.kind() == std::io::ErrorKind::PermissionDenied => return,
        Err(e) => panic!("{e}"),
    };
    assert!(ingested.status.success(), "{ingested:?}");
    for arguments in [&["info", "s.esker"][..], &["query", "s.esker", "--count"], &["verify", "s.esker"]] {
        let output = run(1002, arguments).unwrap();
        assert!(output.status.success(), "{output:?}");
    }
    for end in ["-wal", "-shm"] {
        assert!(!folder.path().join(format!("s.esker{end}")).exists(), "{end} is left");
    }
    let hidden = run(1001, &["hide", "s.esker", "a"]).unwrap();
    assert!(hidden.status.success(), "{hidden:?}");
}

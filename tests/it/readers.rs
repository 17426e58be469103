//! Law 7 for those who look while others write: every answer is that of one committed generation, and nobody fails or
//! waits for the writer.

use crate::support::{Random, TinyLas, esker, esker_ok};
use esker::ingest::{IngestOptions, LatticeWish, Resources, compact, ingest, remove};
use esker::query::{Query, Region};
use esker::store::Store;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// The points of one generation in the box that is asked for, in steps of 0.01, ascending.
type Answer = Vec<[i64; 3]>;

const LOW: f64 = 0.5;
const HIGH: f64 = 2.5;

fn inside(las: &TinyLas) -> Answer {
    let in_box = |v: &i32| (50..250).contains(v);
    let points = las.positions().into_iter().filter(|p| p.iter().all(in_box));
    points.map(|p| p.map(i64::from)).collect()
}

/// What the library answers, and for which generation.
fn ask(store: &Store) -> (u64, Answer, Duration) {
    let begun = Instant::now();
    let snapshot = store.snapshot().unwrap();
    let waited = begun.elapsed();
    let query = Query::new().region(Region::new_box([LOW; 3], [HIGH; 3]).unwrap());
    let (batch, answer) = query.collect(&snapshot).unwrap();
    assert_eq!(answer.points, query.count(&snapshot).unwrap().points);
    let lattice = &snapshot.site().lattice;
    let world = |i| lattice.world_from_lattice(batch.positions.point(i)).map(|v| (v * 100.0).round() as i64);
    let mut points: Answer = (0..batch.positions.len()).map(world).collect();
    points.sort_unstable();
    (snapshot.generation(), points, waited)
}

/// The same by a process of its own.
fn ask_process(store: &Path) -> Answer {
    let area = format!("{LOW},{LOW},{LOW},{HIGH},{HIGH},{HIGH}");
    let output = esker(&["query", store.to_str().unwrap(), "--box", &area, "-o", "-", "--format", "csv"]);
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
    let expected: Mutex<BTreeMap<u64, Answer>> = Mutex::default();
    let expect = |generation: u64, present: &[usize]| {
        let mut points: Answer = present.iter().flat_map(|&i| inside(&files[i])).collect();
        points.sort_unstable();
        expected.lock().unwrap().insert(generation, points);
    };
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
                let first = ask(&own);
                while !done.load(Ordering::Relaxed) {
                    let (generation, points, waited) = ask(&own);
                    assert_eq!(expected.lock().unwrap().get(&generation), Some(&points), "generation {generation}");
                    waits.lock().unwrap().push(waited);
                    asked.fetch_add(1, Ordering::Relaxed);
                }
                // A snapshot is what it was, however much has changed.
                assert!(own.changed(&held).unwrap());
                assert_eq!(held.generation(), first.0);
                let all = Query::new().count(&held).unwrap().points;
                assert_eq!(all, held.scans().iter().map(|s| s.stored).sum::<u64>());
            });
            scope.spawn(|| {
                while !done.load(Ordering::Relaxed) {
                    let points = ask_process(&store);
                    let known = expected.lock().unwrap();
                    assert!(known.values().any(|e| *e == points), "{} points are no generation's", points.len());
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

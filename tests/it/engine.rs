//! One store in many hands: 32 threads ask all sorts of things of one handle, its caches too small for all of it, while a scan
//! is added; every answer is that of one committed generation.

use crate::support::{Random, TinyLas};
use esker::ingest::{IngestOptions, LatticeWish, ingest};
use esker::query::{Detail, Filter, Query, Region};
use esker::store::{Limits, Snapshot, Store};
use std::collections::HashMap;
use std::fs;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// Whatever is asked, by number.
fn question(i: u64) -> Query {
    let mut random = Random(i);
    let low = [random.unit() * 60.0, random.unit() * 60.0, -1.0];
    let side = 2.0 + random.unit() * 40.0;
    let region = Region::new_box(low, [low[0] + side, low[1] + side, 30.0]).unwrap();
    let query = Query::new().region(region).with_scans(i.is_multiple_of(2));
    match i % 6 {
        0 => query,
        1 => query.filter(Filter::parse("Classification < 5 and Intensity > 300").unwrap()),
        2 => query.detail(Detail::Spacing(0.5)),
        3 => query.capacity(1500),
        4 => query.positions_only().threads(1),
        _ => query.attributes(["Intensity", "GpsTime"]).threads(2),
    }
}

/// The generation that was asked, the question, and everything in the answer.
type Told = (u64, u64, (u64, u64));

/// Everything in the answer, in one number.
fn told(snapshot: &Snapshot, i: u64) -> (u64, u64) {
    use std::hash::{DefaultHasher, Hash, Hasher};
    let (batch, answer) = question(i).collect(snapshot).unwrap();
    let mut hasher = DefaultHasher::new();
    (&batch.positions.x, &batch.positions.y, &batch.positions.z, &batch.scans).hash(&mut hasher);
    for column in &batch.columns {
        (0..column.len()).for_each(|row| column.raw(row).hash(&mut hasher));
    }
    answer.error_bound.map(f64::to_bits).hash(&mut hasher);
    (answer.points, hasher.finish())
}

#[test]
fn many_threads_ask_one_store_while_a_scan_is_added() {
    const QUESTIONS: u64 = 24;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut random = Random(99);
    for (name, from, n) in [("a.las", 0, 60_000), ("b.las", 2000, 30_000)] {
        let mut las = TinyLas::new(1);
        for _ in 0..n {
            let [x, y] = [0; 2].map(|_: i32| (from + random.below(6000)) as i32);
            las.push([x, y, (x / 9 + y / 17) % 900], random.next());
        }
        fs::write(at(name), las.bytes()).unwrap();
    }
    let options = IngestOptions {
        lattice: LatticeWish { quantum: Some([0.01; 3]), phase: None },
        g: 5,
        leaf_capacity: 800,
        ..IngestOptions::default()
    };
    let path = at("s.esker");
    ingest(&path, &[at("a.las")], &options, &()).unwrap();
    let mut limits = Limits::default();
    (limits.node_bytes, limits.row_bytes, limits.block_bytes) = (60_000, 300_000, 2_000_000);
    let store = Store::open_with(&path, limits).unwrap();
    let before = store.snapshot().unwrap();

    let answers: Mutex<Vec<Told>> = Mutex::default();
    let asked = AtomicU64::new(0);
    std::thread::scope(|scope| {
        for thread in 0..32 {
            let (store, answers, asked) = (&store, &answers, &asked);
            scope.spawn(move || {
                // Some after the scan is there, however fast it comes.
                let mut after = 0;
                for round in 0_u64.. {
                    let i = (thread * 7 + round * 5) % QUESTIONS;
                    let snapshot = store.snapshot().unwrap();
                    let found = told(&snapshot, i);
                    answers.lock().unwrap().push((snapshot.generation(), i, found));
                    asked.fetch_add(1, Ordering::Relaxed);
                    after += u64::from(snapshot.generation() > 1);
                    if after > 1 {
                        break;
                    }
                }
            });
        }
        while asked.load(Ordering::Relaxed) < 64 {
            std::thread::yield_now();
        }
        ingest(&path, &[at("b.las")], &options, &()).unwrap();
    });

    // What a reader alone finds, without a cache, is what all of them must have found.
    let once = Store::open_with(&path, Limits::once()).unwrap().snapshot().unwrap();
    let mut expected: HashMap<(u64, u64), (u64, u64)> = HashMap::new();
    for i in 0..QUESTIONS {
        expected.insert((before.generation(), i), told(&before, i));
        expected.insert((once.generation(), i), told(&once, i));
    }
    assert_eq!((before.generation(), once.generation()), (1, 2));
    let answers = answers.into_inner().unwrap();
    for (generation, i, found) in &answers {
        assert_eq!(expected.get(&(*generation, *i)), Some(found), "question {i} of generation {generation}");
    }
    let of_first = answers.iter().filter(|a| a.0 == 1).count();
    assert!(of_first >= 64 && answers.len() - of_first >= 64, "{of_first} of {}", answers.len());
    let figures = store.cache_figures();
    assert!(figures.block_hits > 0 && figures.row_hits > 0, "{figures:?}");
    assert!(figures.block_bytes <= 2_000_000 && figures.row_bytes <= 300_000, "{figures:?}");
}

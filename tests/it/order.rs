//! The points of thinned answers come coarse to fine, in batches that anybody may stop at.

use crate::support::{Random, TinyLas, esker_ok};
use esker::lattice::{Key, LatticePoint};
use esker::octree::wins;
use esker::query::{Detail, Filter, Query};
use esker::store::Store;
use std::collections::HashSet;

/// What each point of an answer wins among its points, in the order in which they come.
fn wins_in_order(keys: &[Key]) -> Vec<i8> {
    let mut sorted = keys.to_vec();
    sorted.sort_unstable();
    let wins = wins(&sorted, 48);
    keys.iter().map(|key| wins[sorted.binary_search(key).unwrap()]).collect()
}

#[test]
fn places_far_apart_are_all_there_from_the_start() {
    // The leaves of such a site hold points of many levels.
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let mut las = TinyLas::new(1);
    let mut random = Random(5);
    for place in 0..20_i32 {
        let corner = [place * 900_000 + 77, (place * 7 % 20) * 900_000, 0];
        for _ in 0..20_000 {
            let within = [random.below(1000) as i32, random.below(1000) as i32, random.below(5) as i32];
            las.push(std::array::from_fn(|axis| corner[axis] + within[axis]), 1);
        }
    }
    std::fs::write(path("t.las"), las.bytes()).unwrap();
    esker_ok(&["ingest", &path("t.esker"), &path("t.las")]);
    let snapshot = Store::open(path("t.esker")).unwrap().snapshot().unwrap();
    for query in [Query::new().detail(Detail::Spacing(0.2)), Query::new().capacity(100_000)] {
        let mut points: Vec<LatticePoint> = Vec::new();
        for batch in query.positions_only().batches(&snapshot).unwrap() {
            points.extend(batch.unwrap().positions.iter());
        }
        // Of cells of 80 centimetres and 3 metres nearly all are met by a quarter of the points.
        for cell in [6, 8] {
            let cells = |points: &[LatticePoint]| -> HashSet<[u64; 3]> {
                points.iter().map(|p| p.0.map(|c| c >> cell)).collect()
            };
            let (all, early) = (cells(&points).len(), cells(&points[..points.len() / 4]).len());
            assert!(
                early * 20 >= all * 17,
                "{early} of {all} cells by {} of {} points",
                points.len() / 4,
                points.len()
            );
        }
    }
}

#[test]
fn who_stops_early_has_all_of_it_thinned() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    esker_ok(&["generate", "terrain", "--points", "1M", "-o", &path("t.las")]);
    esker_ok(&["ingest", &path("t.esker"), &path("t.las")]);
    let snapshot = Store::open(path("t.esker")).unwrap().snapshot().unwrap();
    let filtered = |filter: &str| Query::new().filter(Filter::parse(filter).unwrap());
    for (query, growth) in
        [(Query::new(), 16), (filtered("Classification = 2"), 64), (filtered("Intensity < 25000"), 64)]
    {
        for query in [query.clone().detail(Detail::Spacing(0.5)), query.capacity(60_000)] {
            let mut keys: Vec<Key> = Vec::new();
            for batch in query.positions_only().batches(&snapshot).unwrap() {
                keys.extend(batch.unwrap().positions.iter().map(Key::of));
            }
            let wins = wins_in_order(&keys);
            let level = |c: i8| wins.iter().filter(|&&w| w >= c).count();
            let is_complete = |c: &i8| wins[..level(*c)].iter().all(|w| w >= c);
            let mut levels: Vec<usize> = (0..30).filter(is_complete).map(level).collect();
            levels.dedup();
            // Below that it is all of the first block.
            levels.retain(|&points| points >= 1000);
            println!("{levels:?} of {}", keys.len());
            assert!(levels.len() > 1 && levels[0] == keys.len(), "{levels:?}");
            assert!(levels.windows(2).all(|w| w[0] <= growth * w[1]), "{levels:?}");
            assert!(levels[levels.len() - 1] <= 8192, "{levels:?}");
        }
    }
}

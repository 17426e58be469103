//! The points of thinned answers come coarse to fine, in batches that anybody may stop at.

use crate::support::esker_ok;
use esker::lattice::Key;
use esker::octree::wins;
use esker::query::{Detail, Filter, Query};
use esker::store::Store;

/// What each point of an answer wins among its points, in the order in which they come.
fn wins_in_order(keys: &[Key]) -> Vec<i8> {
    let mut sorted = keys.to_vec();
    sorted.sort_unstable();
    let wins = wins(&sorted, 48);
    keys.iter().map(|key| wins[sorted.binary_search(key).unwrap()]).collect()
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

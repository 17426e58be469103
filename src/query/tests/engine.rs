//! The same answers by other ways: batch by batch, folded, on one thread; ended early; neighbours and densities.

use super::*;
use crate::lattice::LatticePoint;
use crate::points::Positions;
use std::collections::BTreeMap;

fn all_ways(query: &Query, test: &TestStore) -> (Batch, Answer) {
    let (batch, answer) = query.collect(&test.snapshot).unwrap();
    for threads in [1, 3] {
        let mut batches = query.clone().threads(threads).batches(&test.snapshot).unwrap();
        let mut same = Batch::empty(batches.attributes().clone());
        for one in &mut batches {
            let one = one.unwrap();
            assert!(!one.is_empty());
            same.append(&one);
        }
        assert!(same == batch, "{threads} threads");
        let again = batches.answer();
        assert_eq!((again.points, again.error_bound), (answer.points, answer.error_bound));
        assert_eq!(again.on_maximum_faces, answer.on_maximum_faces);
        let (folded, answer_of_fold) = query
            .clone()
            .threads(threads)
            .fold(
                &test.snapshot,
                Positions::default,
                |all, batch| all.x.extend(batch.positions.x),
                |all, one| {
                    all.x.extend(one.x);
                },
            )
            .unwrap();
        assert!(folded.x == batch.positions.x, "{threads} threads, folded");
        assert_eq!((answer_of_fold.points, answer_of_fold.error_bound), (answer.points, answer.error_bound));
    }
    (batch, answer)
}

#[test]
fn batches_and_folds_are_the_same_answer_on_any_threads() {
    let test = store(&[surface(60_000)], Params { g: 4, leaf_capacity: 700 }, None);
    let half = Region::new_box([-1e9; 3], [400.0 * QUANTUM, 1e9, 1e9]).unwrap();
    let camera = serde_json::from_str(r#"{"eye":[-90,-80,60],"target":[300,300,0]}"#).unwrap();
    for query in [
        Query::new(),
        Query::new().region(half.clone()),
        Query::new().region(half.clone()).filter(Filter::parse("class < 3").unwrap()).with_scans(true),
        Query::new().region(half.clone()).detail(Detail::Spacing(4.0 * QUANTUM)),
        Query::new().region(half.clone()).capacity(7000),
        Query::new().view(camera, 2.0),
        Query::new().filter(Filter::parse("class = 77").unwrap()),
    ] {
        let (batch, answer) = all_ways(&query, &test);
        let count = query.count(&test.snapshot).unwrap();
        assert_eq!((count.points, batch.len() as u64), (answer.points, answer.points));
    }
}

#[test]
fn a_level_is_thinned_subtree_by_subtree_as_it_is_at_once() {
    // Deep enough that most subtrees are tasks of their own, below nodes that are read alone.
    let points = surface(12_000);
    for params in [Params { g: 3, leaf_capacity: 60 }, Params { g: 5, leaf_capacity: 300 }] {
        let test = store(std::slice::from_ref(&points), params, Some(1));
        let sphere = Region::new_sphere([50.0, 90.0, 0.0], 300.0).unwrap();
        for (region, text) in [(Region::Everything, ""), (sphere.clone(), ""), (sphere, "class < 3")] {
            let on = region.on_lattice(&test.lattice).unwrap();
            let matches = |p: &&Point| p.scan == 2 && on.contains(p.at()) && (text.is_empty() || p.class < 3);
            let all: Vec<Point> = test.points.iter().filter(matches).copied().collect();
            for c in [0, 1, 3, 4, 6, 8] {
                let mut query =
                    Query::new().region(region.clone()).detail(Detail::Spacing(2_f64.powi(c.into()) * QUANTUM));
                if !text.is_empty() {
                    query = query.filter(Filter::parse(text).unwrap());
                }
                let (found, _) = collect(query.clone().with_scans(true), &test);
                assert!(ascending(found) == naive::level(&all, Point::at, c, |_| true), "{params:?} {text} {c}");
                let counted = query.count(&test.snapshot).unwrap().points;
                assert_eq!(counted, naive::level(&all, Point::at, c, |_| true).len() as u64);
            }
        }
    }
}

#[test]
fn a_token_ends_queries_of_every_kind() {
    let test = store(&[surface(60_000)], Params { g: 4, leaf_capacity: 500 }, None);
    let cancel = Cancel::new();
    let query = Query::new().cancel(&cancel);
    let mut batches = query.clone().threads(1).batches(&test.snapshot).unwrap();
    let mut before = 0;
    for _ in 0..3 {
        before += batches.next().unwrap().unwrap().len();
    }
    let elsewhere = cancel.clone();
    std::thread::spawn(move || elsewhere.cancel()).join().unwrap();
    // What was begun may still come; then the error, then nothing.
    let mut rest = batches.by_ref().skip_while(|batch| {
        before += batch.as_ref().map_or(0, Batch::len);
        batch.is_ok()
    });
    assert!(matches!(rest.next(), Some(Err(QueryError::Cancelled))));
    assert!(rest.next().is_none() && before < 60_000);
    let kinds = [
        query.clone(),
        query.clone().detail(Detail::Level(2)),
        query.clone().capacity(5000),
        query.clone().filter(Filter::parse("class = 1").unwrap()),
    ];
    for query in kinds {
        assert!(matches!(query.count(&test.snapshot), Err(QueryError::Cancelled)), "{query:?}");
        assert!(matches!(query.collect(&test.snapshot), Err(QueryError::Cancelled)), "{query:?}");
    }
    let none = || query.nearest(&test.snapshot, &[[0.0; 3]], 3, None).unwrap_err();
    assert!(matches!(none(), QueryError::Cancelled));
    assert!(matches!(query.density(&test.snapshot, 0.1), Err(QueryError::Cancelled)));
}

/// A file-backed copy is needed here: what is in memory is not cached.
#[test]
fn cached_blocks_are_the_ones_that_were_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.esker");
    let test = stores::store_at(&path, &[surface(60_000)], Params { g: 7, leaf_capacity: 9000 });
    let once = crate::store::Store::open_with(&path, crate::store::Limits::once()).unwrap().snapshot().unwrap();
    let kept = crate::store::Store::open(&path).unwrap();
    let snapshot = kept.snapshot().unwrap();
    let ball = Region::new_sphere([200.0, 100.0, 0.0], 150.0).unwrap();
    let box_ = Region::new_box([-1e9; 3], [100.0, 200.0, 1e9]).unwrap();
    for region in [ball, box_, Region::Everything] {
        for filter in ["", "class < 3", "X > 30 and code > 1000"] {
            let mut query = Query::new().region(region.clone()).with_scans(true);
            if !filter.is_empty() {
                query = query.filter(Filter::parse(filter).unwrap());
            }
            let (expected, cost) = query.collect(&once).unwrap();
            assert!(cost.statistics.bytes_needed <= cost.statistics.bytes_read, "{cost:?}");
            assert_eq!((cost.statistics.blocks_cached, cost.statistics.chunks_cached), (0, 0));
            for round in 0..2 {
                let (found, answer) = query.collect(&snapshot).unwrap();
                assert!(found == expected, "{region:?} {filter} round {round}");
                if round == 1 {
                    assert_eq!(answer.statistics.bytes_read, 0);
                    assert_eq!(answer.statistics.points_decoded, 0);
                    assert!(answer.statistics.blocks_cached > 0);
                }
            }
        }
    }
    let figures = kept.cache_figures();
    assert!(figures.block_hits > 0 && figures.block_bytes > 0 && figures.row_bytes > 0, "{figures:?}");
    assert_eq!(test.points.len(), 60_000);
}

/// One node with parts of several blocks, and queries that look at few of them.
fn queries_of_few_blocks() -> (Vec<Point>, Params, Vec<Query>) {
    let params = Params { g: 7, leaf_capacity: 70_000 };
    let corner = Region::new_box([-1e9; 3], [-300.0 * QUANTUM, -200.0 * QUANTUM, 1e9]).unwrap();
    let ball = Region::new_sphere([3400.0, 2400.0, -213.0].map(|c| c * QUANTUM), 200.0 * QUANTUM).unwrap();
    let all = Query::new().with_scans(true);
    let queries = vec![
        all.clone().region(corner.clone()),
        all.clone().region(ball.clone()),
        all.clone().region(ball.clone()).filter(Filter::parse("class < 2").unwrap()),
        all.clone().region(corner).capacity(300),
        all.region(ball).detail(Detail::Spacing(32.0 * QUANTUM)),
    ];
    (surface(60_000), params, queries)
}

#[test]
fn of_a_chunk_only_the_blocks_are_read_that_are_looked_at() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.esker");
    let (points, params, queries) = queries_of_few_blocks();
    stores::store_at(&path, &[points], params);
    let once = crate::store::Store::open_with(&path, crate::store::Limits::once()).unwrap().snapshot().unwrap();
    for query in queries {
        // A store that keeps rows reads them whole.
        let whole = crate::store::Store::open(&path).unwrap().snapshot().unwrap();
        let (expected, of_rows) = query.collect(&whole).unwrap();
        let (found, of_blocks) = query.collect(&once).unwrap();
        assert!(found == expected && !found.is_empty(), "{query:?}");
        let (blocks, rows) = (of_blocks.statistics.bytes_read, of_rows.statistics.bytes_read);
        // A thinned answer looks around the region, and more than once where nothing is kept.
        let thinned = query.capacity.is_some() || query.detail != Detail::Everything;
        assert!(thinned || blocks * 2 < rows, "{blocks} bytes of {rows}: {query:?}");
    }
}

#[test]
fn damage_in_blocks_that_are_read_alone_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.esker");
    let (points, params, queries) = queries_of_few_blocks();
    stores::store_at(&path, &[points], params);
    let ask = |path: &std::path::Path| -> Vec<Result<Batch, QueryError>> {
        let store = crate::store::Store::open_with(path, crate::store::Limits::once());
        let snapshot = store.and_then(|store| store.snapshot());
        let ask = |query: &Query| Ok(query.collect(snapshot.as_ref().map_err(|_| QueryError::Cancelled)?)?.0);
        queries.iter().map(ask).collect()
    };
    let expected: Vec<Batch> = ask(&path).into_iter().map(Result::unwrap).collect();
    let file = std::fs::read(&path).unwrap();
    let copy = folder.path().join("copy.esker");
    let (mut refused, mut right) = (0, 0);
    let step = file.len() / 150;
    for i in 0..150 {
        let mut damaged = file.clone();
        damaged[i * step + i * 7 % step] ^= 1 << (i % 8);
        std::fs::write(&copy, &damaged).unwrap();
        for (found, expected) in ask(&copy).into_iter().zip(&expected) {
            match found {
                Ok(found) => {
                    assert!(found == *expected, "flip {i}");
                    right += 1;
                }
                Err(_) => refused += 1,
            }
        }
    }
    // Most blocks are not looked at.
    assert!(refused > 20 && right > 300, "{refused} refused, {right} right");
}

fn worlds(test: &TestStore, p: &Point) -> [f64; 3] {
    test.lattice.world_from_lattice(p.at())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(80))]

    #[test]
    fn neighbours_are_those_that_brute_force_finds(
        places in places(120), params in params(), asked in asked(), k in 0_usize..9,
        near in prop::collection::vec(prop::array::uniform3(-30_i32..300), 1..30),
        // Of so many of these places one is a thousand times as far away.
        far in 1_usize..9,
        // Half the squares that there are: many points are just that far.
        radius in prop::option::of((0_u32..50_000).prop_map(|n| (f64::from(n) / 32.0).sqrt())),
    ) {
        let test = store(&[numbered(places)], params, None);
        prop_assume!(!test.points.is_empty());
        // On the corners of a grid half as fine: many are equally far.
        let corner = test.lattice.world_from_lattice(Cube::containing(test.points[0].at(), 7).low());
        let place = |(n, p): (usize, &[i32; 3])| -> [f64; 3] {
            let away = if n % far == far - 1 && far > 2 { 500.0 } else { 0.5 };
            std::array::from_fn(|i| f64::from(p[i]) * away * QUANTUM + corner[i])
        };
        let near: Vec<[f64; 3]> = near.iter().enumerate().map(place).collect();
        let matches = asked.matches(&test, None);
        let query = asked.query(&test).attributes(["class", "height", "code"]);
        let found = query.nearest(&test.snapshot, &near, k, radius).unwrap();
        prop_assert_eq!(found.ends.len(), near.len());
        prop_assert_eq!(found.batch.len(), found.distances.len());
        let mine = points(&found.batch);
        let mut start = 0;
        for (at, &end) in near.iter().zip(&found.ends) {
            let square = |p: &Point| {
                let w = worlds(&test, p);
                let [dx, dy, dz]: [f64; 3] = std::array::from_fn(|i| w[i] - at[i]);
                (dx * dx + dy * dy) + dz * dz
            };
            let mut all: Vec<(f64, Key)> = test.points.iter().filter(|p| matches(p))
                .map(|p| (square(p), p.key)).filter(|(s, _)| radius.is_none_or(|r| s.sqrt() <= r)).collect();
            all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            all.truncate(k);
            let own = &mine[start..end];
            let got: Vec<(f64, Key)> = own.iter().map(|p| (square(p), p.key)).collect();
            prop_assert_eq!(&got, &all);
            prop_assert!(own.iter().all(&matches));
            let ids: std::collections::BTreeSet<u32> = own.iter().map(|p| p.id).collect();
            prop_assert_eq!(ids.len(), own.len(), "each of them once");
            for (p, d) in own.iter().zip(&found.distances[start..end]) {
                prop_assert_eq!(square(p).sqrt(), *d);
            }
            start = end;
        }
    }

    #[test]
    fn densities_are_counts_and_heights_by_square(
        places in places(120), params in params(), asked in asked(),
        hundredths in prop::sample::select(vec![10_i64, 25, 30, 70, 110, 300, 10_000]),
    ) {
        let test = store(&[numbered(places)], params, None);
        let matches = asked.matches(&test, None);
        let mut expected: BTreeMap<[i64; 2], (u64, f64, f64)> = BTreeMap::new();
        for p in test.points.iter().filter(|p| matches(p)) {
            let w = worlds(&test, p);
            // The quantum is 25 hundredths.
            let at = [0, 1].map(|i| (25 * (p.at().0[i] as i64 - BIAS)).div_euclid(hundredths));
            let square = expected.entry(at).or_insert((0, w[2], w[2]));
            *square = (square.0 + 1, square.1.min(w[2]), square.2.max(w[2]));
        }
        let found = asked.query(&test).density(&test.snapshot, hundredths as f64 / 100.0).unwrap();
        prop_assert!(found.squares.is_sorted_by_key(|s| found.place(s)));
        prop_assert!(found.squares.iter().all(|s| found.place(s) < found.size[0] * found.size[1]));
        let counts = found.grid(0, |s| s.points);
        let first = |s: &crate::query::DensitySquare| [0, 1].map(|i| s.at[i].abs_diff(found.first[i]) as usize);
        for s in &found.squares {
            let [i, j] = first(s);
            prop_assert_eq!(counts[j * found.size[0] + i], s.points);
        }
        prop_assert_eq!(counts.iter().sum::<u64>(), found.squares.iter().map(|s| s.points).sum::<u64>());
        let squares: BTreeMap<_, _> = found.squares.iter().map(|s| (s.at, (s.points, s.lowest, s.highest))).collect();
        prop_assert_eq!(squares, expected);
    }
}

/// The box around the sphere in which a neighbour may lie is most of the site, seen from afar.
#[test]
fn from_afar_only_the_near_side_is_read() {
    let test = store(&[surface(60_000)], Params { g: 5, leaf_capacity: 2000 }, None);
    let bounds = test.snapshot.scans()[0].bounds.unwrap();
    let [low, high] = [bounds.min, bounds.max].map(|corner| test.lattice.world_from_lattice(corner));
    let decoded = |away: f64| {
        let at = std::array::from_fn(|i| low[i] + (high[i] - low[i]) * (1.0 + away));
        Query::new().nearest(&test.snapshot, &[at], 1, None).unwrap().statistics.points_decoded
    };
    let (near, far) = (decoded(0.01), decoded(300.0));
    assert!(near > 0 && far <= 4 * near && far < 20_000, "{far} points, {near} beside the site");
}

/// The square of the radius, 0.7499999999999999, is less than that of the distance, whose root the radius is.
#[test]
fn a_neighbour_at_just_the_radius_is_one() {
    let test = store(&[numbered(vec![(LatticePoint([BIAS as u64; 3]), 0)])], Params { g: 4, leaf_capacity: 500 }, None);
    let nearest = |radius| Query::new().nearest(&test.snapshot, &[[0.5; 3]], 1, Some(radius)).unwrap();
    assert_eq!(nearest(0.866_025_403_784_438_6).distances, [0.866_025_403_784_438_6]);
    assert!(nearest(0.866_025_403_784_438_5).distances.is_empty());
}

#[test]
fn a_coarse_density_reads_nothing() {
    let mut points = surface(30_000);
    // All in one square of the coarse grid, which has edges at zero.
    points.retain(|p| p.at().0[..2].iter().all(|&c| c >= BIAS as u64));
    let count = points.len() as u64;
    let test = store(&[points], Params { g: 4, leaf_capacity: 500 }, None);
    let found = Query::new().density(&test.snapshot, 1e6).unwrap();
    assert_eq!(found.squares.iter().map(|s| s.points).collect::<Vec<_>>(), [count]);
    assert_eq!(found.statistics.bytes_read, 0);
    // The squares of a side lie in those of twice the side, so what rows tell of these they tell of those.
    let decoded = |side: f64| Query::new().density(&test.snapshot, side).unwrap().statistics.points_decoded;
    let decoded: Vec<u64> = (0..16).map(|i| decoded(f64::from(50 << i))).collect();
    assert!(decoded.is_sorted_by(|a, b| a >= b) && decoded.iter().any(|&n| 0 < n && n < count), "{decoded:?}");
    let refused = |side: f64| Query::new().density(&test.snapshot, side).is_err();
    assert!(refused(0.0) && refused(f64::NAN) && refused(-1.0) && refused(f64::INFINITY));
    let refused = |query: Query| query.nearest(&test.snapshot, &[[0.0, f64::NAN, 0.0]], 1, None).is_err();
    assert!(refused(Query::new()));
    assert!(Query::new().capacity(3).nearest(&test.snapshot, &[[0.0; 3]], 1, None).is_err());
    assert!(Query::new().nearest(&test.snapshot, &[[0.0; 3]], 1, Some(-1.0)).is_err());
}

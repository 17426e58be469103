//! Queries against brute force on the points themselves.

mod engine;
mod extents;
mod layers;
mod order;
mod stores;
mod views;

use super::*;
use crate::lattice::{BIAS, Cube, Key};
use crate::octree::{Metric, Params, canonical_order, naive};
use crate::points::{Batch, Column};
use crate::store::model::ScanId;
use proptest::prelude::*;
use std::ops::ControlFlow;
use stores::{Point, QUANTUM, TestStore, numbered, places, store};

/// What a filter means.
type Meaning = fn(&Point) -> bool;

/// Filters with what they mean.
const FILTERS: &[(&str, Meaning)] = &[
    ("", |_| true),
    ("Classification = 2", |p| p.class == 2),
    ("class in (0, 3) and not code < 20", |p| (p.class == 0 || p.class == 3) && p.id >= 20),
    ("height > 0", |p| p.height.is_some_and(|h| h > 0)),
    ("height is null or scan <> 'north'", |_| true),
    ("scan = 'roof' and height <= -2", |p| p.height.is_some_and(|h| h <= -2)),
    ("class = 9", |p| p.class == 9),
    ("X >= 0 and Y < 2.5", |p| p.at().0[0] >= BIAS as u64 && p.at().0[1] < BIAS as u64 + 10),
    ("code = 3 or code between 10 and 12", |p| p.id == 3 || (10..=12).contains(&p.id)),
];

/// What a test asks for.
#[derive(Clone, Debug)]
struct Asked {
    region: Region,
    filter: usize,
    scans: Option<&'static str>,
}

fn asked() -> impl Strategy<Value = Asked> {
    // Corners relative to the middle of the points, in quarters of a quantum: on faces of cells and between points.
    let corner = || prop::array::uniform3(-30_i32..280);
    let scans = prop::sample::select(vec![None, None, Some("north"), Some("roof"), Some("2")]);
    (0_u8..7, corner(), corner(), 0..FILTERS.len(), scans).prop_map(|(kind, a, b, filter, scans)| {
        let world = |c: [i32; 3]| c.map(|v| f64::from(v) / 4.0 * QUANTUM);
        let (low, high) = (std::array::from_fn(|i| a[i].min(b[i])), std::array::from_fn(|i| a[i].max(b[i])));
        let (mut min, mut max) = (world(low), world(high));
        let region = match kind {
            0 => Region::Everything,
            1 => Region::new_sphere(min, f64::from(a[0].abs()) / 8.0 * QUANTUM).unwrap(),
            // Thinner than a cell.
            2 => {
                max[0] = min[0] + QUANTUM;
                Region::new_box(min, max).unwrap()
            }
            3 => {
                min[2] = f64::NEG_INFINITY;
                max[2] = f64::INFINITY;
                Region::new_box(min, max).unwrap()
            }
            // Neighbours, or boxes that overlap.
            4 => {
                let middle = f64::from(a[0].midpoint(b[1])) / 4.0 * QUANTUM;
                let (mut left, mut right) = (max, min);
                (left[0], right[0]) = (middle.clamp(min[0], max[0]), middle.clamp(min[0], max[0]));
                right[1] -= f64::from(b[0].rem_euclid(2)) * QUANTUM;
                Region::any([Region::new_box(min, left).unwrap(), Region::new_box(right, max).unwrap()])
            }
            _ => Region::new_box(min, max).unwrap(),
        };
        Asked { region, filter, scans }
    })
}

/// The same region about the corner of the store's points.
fn moved(region: &Region, test: &TestStore) -> Region {
    let Some(first) = test.points.first() else { return region.clone() };
    let corner = test.lattice.world_from_lattice(Cube::containing(first.at(), 7).low());
    let shift = |p: [f64; 3]| std::array::from_fn(|i| p[i] + corner[i]);
    match *region {
        Region::Box { min, max } => Region::Box { min: shift(min), max: shift(max) },
        Region::Sphere { center, radius } => Region::Sphere { center: shift(center), radius },
        Region::Any(ref terms) => Region::Any(terms.iter().map(|term| moved(term, test)).collect()),
        _ => region.clone(),
    }
}
impl Asked {
    fn query(&self, test: &TestStore) -> Query {
        let mut query = Query::new().region(moved(&self.region, test)).with_scans(true);
        if !FILTERS[self.filter].0.is_empty() {
            query = query.filter(Filter::parse(FILTERS[self.filter].0).unwrap());
        }
        match self.scans {
            Some(scan) => query.scans([scan]),
            None => query,
        }
    }

    fn matches(&self, test: &TestStore, hidden: Option<ScanId>) -> impl Fn(&Point) -> bool {
        let region = moved(&self.region, test).on_lattice(&test.lattice).unwrap();
        let (filter, scans) = (self.filter, self.scans);
        move |p| {
            let scan = match scans {
                None => hidden != Some(p.scan),
                Some("north") => p.scan == 1,
                Some(_) => p.scan == 2,
            };
            scan && region.contains(p.at()) && FILTERS[filter].1(p)
        }
    }
}

/// The points of a batch, with every column compared on the way.
fn points(batch: &Batch) -> Vec<Point> {
    let [Column::U8(class), Column::U32(id), Column::I16(height)] = batch.columns.as_slice() else {
        assert!(batch.is_empty(), "{:?}", batch.attributes);
        return Vec::new();
    };
    (0..batch.len())
        .map(|i| {
            let scan = batch.scans[i];
            let height = if scan == 2 { Some(height[i]) } else { None };
            Point { key: Key::of(batch.positions.point(i)), class: class[i], id: id[i], height, scan }
        })
        .collect()
}

fn ascending(mut points: Vec<Point>) -> Vec<Point> {
    points.sort_unstable();
    points
}

/// The points with all columns; scan 1 alone has two attributes, so the asked ones are named.
fn collect(query: Query, test: &TestStore) -> (Vec<Point>, Answer) {
    let (batch, answer) = query.attributes(["class", "height", "code"]).collect(&test.snapshot).unwrap();
    assert_eq!(batch.len() as u64, answer.points);
    (points(&batch), answer)
}

fn hausdorff(all: &[Point], some: &[Point]) -> f64 {
    let at = |points: &[Point]| points.iter().map(Point::at).collect::<Vec<_>>();
    naive::hausdorff(&at(all), &at(some), [QUANTUM; 3])
}

fn params() -> impl Strategy<Value = Params> {
    (1_u8..4, 3_u32..20).prop_map(|(g, leaf_capacity)| Params { g, leaf_capacity })
}

const SLACK: f64 = 1.0 + 1e-12;

/// An answer's points, ascending, and its bound.
type Bounded = (Vec<Point>, Option<f64>);

/// The answers to a query under every capacity, each with its bound: all of the capacity is used, answers nest, and every
/// bound is kept about `seen`; there is one as soon as there is a point. `all` is how many points there are without one.
fn under_capacities(
    test: &TestStore,
    query: impl Fn() -> Query,
    all: usize,
    seen: &[Point],
) -> Result<Vec<Bounded>, TestCaseError> {
    let mut answers: Vec<Bounded> = Vec::new();
    for capacity in 0..=all + 1 {
        let (found, answer) = collect(query().capacity(capacity as u64), test);
        let found = ascending(found);
        prop_assert_eq!(found.len(), capacity.min(all));
        let mut before = answers.last().into_iter().flat_map(|(points, _)| points);
        prop_assert!(before.all(|p| found.binary_search(p).is_ok()), "{} points do not nest", capacity);
        match answer.error_bound {
            Some(bound) => {
                prop_assert!(hausdorff(seen, &found) <= bound * SLACK, "{} points: {}", capacity, bound);
                let (low, high) = (test.bounds().min.0, test.bounds().max.0);
                let wide = (0..3).map(|i| ((high[i] - low[i]) as f64 * QUANTUM).powi(2)).sum::<f64>().sqrt();
                prop_assert!(bound <= wide * SLACK, "{} points: {} of a site of {}", capacity, bound, wide);
            }
            None => prop_assert!(found.is_empty(), "{} points and no bound", capacity),
        }
        answers.push((found, answer.error_bound));
    }
    Ok(answers)
}

/// More points never have a worse bound; the last one is given.
fn last_bound(answers: &[Bounded]) -> Result<Option<f64>, TestCaseError> {
    let mut last: Option<f64> = None;
    for (points, bound) in answers {
        prop_assert!(bound.is_some() || last.is_none(), "{} points and no bound any more", points.len());
        let grows = last.zip(*bound).is_some_and(|(last, bound)| bound > last);
        prop_assert!(!grows, "{} points: {:?}, then {:?}", points.len(), last, bound);
        last = *bound;
    }
    Ok(last)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn full_detail_is_exactly_what_brute_force_finds(
        places in places(120), params in params(), asked in prop::collection::vec(asked(), 4),
        hidden in prop::sample::select(vec![None, Some(1), Some(2)]),
    ) {
        let test = store(&[numbered(places)], params, hidden);
        for asked in asked {
            let matches = asked.matches(&test, hidden);
            let expected: Vec<Point> = test.points.iter().filter(|p| matches(p)).copied().collect();
            let (found, answer) = collect(asked.query(&test), &test);
            prop_assert_eq!(ascending(found.clone()), expected.clone());
            prop_assert_eq!(answer.error_bound, Some(0.0));
            let count = asked.query(&test).count(&test.snapshot).unwrap();
            prop_assert_eq!(count.points, expected.len() as u64);
            // What is on the maximum faces is told by both, and is what the closed box has more.
            prop_assert_eq!(answer.on_maximum_faces, count.on_maximum_faces);
            let region = moved(&asked.region, &test);
            let closed = asked.query(&test).region(region.closed_on(&test.lattice)).count(&test.snapshot).unwrap();
            let on_faces = region.is_of_boxes().then_some(closed.points - count.points);
            prop_assert_eq!(count.on_maximum_faces, on_faces);
            // Again, in the same order.
            prop_assert_eq!(collect(asked.query(&test), &test).0, found);
        }
    }

    #[test]
    fn levels_are_the_rule_applied_to_the_matching_points(
        places in places(120), params in params(), asked in asked(),
        hidden in prop::sample::select(vec![None, None, Some(1)]),
    ) {
        let test = store(&[numbered(places)], params, hidden);
        let matches = asked.matches(&test, hidden);
        let all: Vec<Point> = test.points.iter().filter(|p| matches(p)).copied().collect();
        for c in 0..=test.k {
            let spacing = 2_f64.powi(c.into()) * QUANTUM;
            let (found, answer) = collect(asked.query(&test).detail(Detail::Spacing(spacing)), &test);
            let found = ascending(found);
            prop_assert_eq!(&found, &naive::level(&all, Point::at, c, |_| true), "cell {}", c);
            let bound = answer.error_bound.unwrap();
            prop_assert!(hausdorff(&all, &found) <= bound * SLACK);
            let (same, promised) = collect(asked.query(&test).detail(Detail::MaxError(bound)), &test);
            prop_assert_eq!(ascending(same), found.clone());
            prop_assert_eq!(promised.error_bound, Some(bound));
            if c + test.g <= test.k {
                let level = u32::from(test.k - test.g - c);
                prop_assert_eq!(ascending(collect(asked.query(&test).detail(Detail::Level(level)), &test).0), found);
            }
        }
        let deeper = collect(asked.query(&test).detail(Detail::Level(60)), &test).0;
        prop_assert_eq!(ascending(deeper), all);
    }

    #[test]
    fn a_capacity_gives_the_first_points_of_one_sequence(
        places in places(90), params in params(), asked in asked(), c in 0_u8..8,
    ) {
        let test = store(&[numbered(places)], params, None);
        let matches = asked.matches(&test, None);
        let all: Vec<Point> = test.points.iter().filter(|p| matches(p)).copied().collect();
        let keys: Vec<Key> = all.iter().map(|p| p.key).collect();
        let order = canonical_order(&keys, 48).order;
        let mut last = f64::INFINITY;
        for capacity in 0..=all.len() + 1 {
            let (found, answer) = collect(asked.query(&test).capacity(capacity as u64), &test);
            let expected = order.iter().take(capacity).map(|&i| all[i as usize]).collect();
            prop_assert_eq!(ascending(found.clone()), ascending(expected), "{} points", capacity);
            match answer.error_bound {
                None => prop_assert!(capacity == 0 && found.is_empty()),
                Some(bound) => {
                    prop_assert!(hausdorff(&all, &found) <= bound * SLACK);
                    prop_assert!(bound <= last, "{} points", capacity);
                    last = bound;
                }
            }
            prop_assert_eq!(asked.query(&test).capacity(capacity as u64).count(&test.snapshot).unwrap().points, answer.points);
        }
        prop_assert_eq!(last, 0.0);
        // With a level as well: the first of the level's.
        let spacing = Detail::Spacing(2_f64.powi(c.into()) * QUANTUM);
        let level = naive::level(&all, Point::at, c.min(test.k), |_| true);
        for capacity in 1..=level.len() + 1 {
            let (found, answer) = collect(asked.query(&test).detail(spacing).capacity(capacity as u64), &test);
            let keys: Vec<Key> = level.iter().map(|p| p.key).collect();
            let order = canonical_order(&keys, 48).order;
            let expected = order.iter().take(capacity).map(|&i| level[i as usize]).collect();
            prop_assert_eq!(ascending(found.clone()), ascending(expected));
            prop_assert!(hausdorff(&all, &found) <= answer.error_bound.unwrap() * SLACK);
        }
    }

    #[test]
    fn layers_are_one_set(
        places in places(60), more in places(60), params in params(), asked in asked(), capacity in 0_usize..40,
    ) {
        let points = numbered(places.into_iter().chain(more).collect());
        let (a, b): (Vec<Point>, Vec<Point>) = points.iter().partition(|p| p.id % 3 == 0);
        let test = store(&[a, b], params, None);
        let matches = asked.matches(&test, None);
        let all: Vec<Point> = test.points.iter().filter(|p| matches(p)).copied().collect();
        prop_assert_eq!(ascending(collect(asked.query(&test), &test).0), all.clone());
        for c in 0..=test.k.min(9) {
            let spacing = Detail::Spacing(2_f64.powi(c.into()) * QUANTUM);
            let (found, answer) = collect(asked.query(&test).detail(spacing), &test);
            prop_assert_eq!(ascending(found.clone()), naive::level(&all, Point::at, c, |_| true));
            prop_assert!(hausdorff(&all, &found) <= answer.error_bound.unwrap() * SLACK);
        }
        let (found, _) = collect(asked.query(&test).capacity(capacity as u64), &test);
        let keys: Vec<Key> = all.iter().map(|p| p.key).collect();
        let order = canonical_order(&keys, 48).order;
        let expected = order.iter().take(capacity).map(|&i| all[i as usize]).collect();
        prop_assert_eq!(ascending(found), ascending(expected));
    }
}

/// A surface with steps and repeated positions, large enough for several parts and blocks at the format's parameters.
fn surface(n: u64) -> Vec<Point> {
    let mix = |i: u64| (i + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let place = |i: u64| {
        let (x, y) = (mix(i) % 4000, mix(i ^ 0xabcd) % 3000);
        let z = (x / 700 * 40) + (y * y / 90_000) + mix(i + 7) % 3;
        let p = [x, y, z].map(|c| c + BIAS as u64 - 500);
        (crate::lattice::LatticePoint(p), (mix(i * 3) % 50).min(3) as u8)
    };
    numbered((0..n).map(|i| place(if i % 40 == 0 { i / 2 } else { i })).collect())
}

#[test]
fn the_laws_hold_at_the_parameters_of_the_format() {
    let test = store(&[surface(150_000)], Params { g: 7, leaf_capacity: 32_768 }, None);
    let w = |c: f64| c * QUANTUM;
    let regions = [
        Region::Everything,
        Region::new_box([w(-500.0), w(-500.0), w(-500.0)], [w(-400.0), w(-390.5), w(500.0)]).unwrap(),
        Region::new_box([w(100.0), -1e9, -1e9], [w(101.0), 1e9, 1e9]).unwrap(),
        Region::new_sphere([w(600.0), w(700.0), w(-300.0)], w(250.0)).unwrap(),
    ];
    for region in regions {
        for (text, filter) in [("", FILTERS[0].1), ("class < 3", |p: &Point| p.class < 3)] {
            let on = region.on_lattice(&test.lattice).unwrap();
            let all: Vec<Point> = test.points.iter().filter(|p| on.contains(p.at()) && filter(p)).copied().collect();
            let query = || {
                let query = Query::new().region(region.clone()).with_scans(true);
                if text.is_empty() { query } else { query.filter(Filter::parse(text).unwrap()) }
            };
            assert_eq!(ascending(collect(query(), &test).0), all);
            assert_eq!(query().count(&test.snapshot).unwrap().points, all.len() as u64);
            for c in [0, 2, 4, 7] {
                let spacing = 2_f64.powi(c.into()) * QUANTUM;
                let (found, _) = collect(query().detail(Detail::Spacing(spacing)), &test);
                assert!(ascending(found) == naive::level(&all, Point::at, c, |_| true), "{region:?} {text} {c}");
            }
            let keys: Vec<Key> = all.iter().map(|p| p.key).collect();
            let order = canonical_order(&keys, 48);
            for capacity in [1, 100, 3000, 20_000, 140_000_usize] {
                let (found, answer) = collect(query().capacity(capacity as u64), &test);
                let expected = order.order.iter().take(capacity).map(|&i| all[i as usize]).collect();
                assert!(ascending(found) == ascending(expected), "{region:?} {text} {capacity}");
                let metric = Metric::new([QUANTUM; 3]).within(&test.bounds());
                let bound = order.bound(capacity.min(all.len()), &metric);
                assert_eq!(answer.error_bound, Some(bound));
            }
        }
    }
}

#[test]
fn only_what_is_asked_for_is_read() {
    let test = store(&[surface(60_000)], Params { g: 7, leaf_capacity: 32_768 }, None);
    let cost = |query: Query| query.collect(&test.snapshot).unwrap().1.statistics;
    let all = cost(Query::new());
    let positions = cost(Query::new().positions_only());
    let one = cost(Query::new().attributes(["code"]));
    assert!(positions.bytes_read < one.bytes_read && one.bytes_read < all.bytes_read);
    assert_eq!(positions.points_decoded, 60_000);
    let corner = Region::new_box([-1e9; 3], [-480.0 * QUANTUM, 1e9, 1e9]).unwrap();
    let corner = cost(Query::new().region(corner));
    assert!(corner.points_decoded < 30_000, "{corner:?}");
    assert_eq!(cost(Query::new().filter(Filter::parse("class = 77").unwrap())).bytes_read, 0);
    let coarse = cost(Query::new().capacity(500));
    assert!(coarse.points_decoded < 40_000, "{coarse:?}");
    assert_eq!(Query::new().count(&test.snapshot).unwrap().statistics.bytes_read, 0);
}

/// It said that of the whole answer, as if nothing were missing.
#[test]
fn an_answer_that_was_ended_has_no_bound() {
    let test = store(&[surface(60_000)], Params { g: 7, leaf_capacity: 32_768 }, None);
    let query = || Query::new().threads(1);
    let stop_after = |most: usize| {
        let mut left = most;
        move || {
            left = left.saturating_sub(1);
            if left == 0 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        }
    };
    for (most, bound) in [(1, None), (usize::MAX, Some(0.0))] {
        let mut stop = stop_after(most);
        let answer = query().run(&test.snapshot, |_| stop()).unwrap();
        assert_eq!((answer.error_bound, answer.points == 60_000), (bound, bound.is_some()));
        let mut stop = stop_after(most);
        let answer = query().run_mapped(&test.snapshot, |batch| batch.len(), |_| stop()).unwrap();
        assert_eq!((answer.error_bound, answer.points == 60_000), (bound, bound.is_some()));
    }
    let mut batches = query().batches(&test.snapshot).unwrap();
    assert_eq!(batches.answer().error_bound, None);
    batches.next().unwrap().unwrap();
    assert_eq!(batches.answer().error_bound, None);
    for batch in &mut batches {
        batch.unwrap();
    }
    assert_eq!((batches.answer().error_bound, batches.answer().points), (Some(0.0), 60_000));
    // After an error neither.
    let cancel = Cancel::new();
    let mut batches = query().cancel(&cancel).batches(&test.snapshot).unwrap();
    batches.next().unwrap().unwrap();
    cancel.cancel();
    assert!(batches.next().unwrap().is_err() && batches.next().is_none());
    assert_eq!(batches.answer().error_bound, None);
}

#[test]
fn a_watch_says_how_far_a_query_is() {
    let test = store(&[surface(60_000)], Params { g: 7, leaf_capacity: 32_768 }, None);
    let watch = Watch::new();
    assert_eq!((watch.points(), watch.expected()), (0, None));
    let watched = Query::new().watch(&watch).threads(1);
    let mut batches = watched.clone().filter(Filter::parse("code >= 0").unwrap()).batches(&test.snapshot).unwrap();
    assert_eq!((watch.points(), watch.expected()), (0, Some(60_000)));
    let mut before = 0;
    for batch in &mut batches {
        batch.unwrap();
        assert!(before < watch.points() && watch.points() <= 60_000);
        before = watch.points();
    }
    assert_eq!(before, 60_000);
    // A second query counts on.
    watched.density(&test.snapshot, 0.5).unwrap();
    assert_eq!(watch.points(), watch.expected().unwrap());
    assert!(watch.points() > before, "{watch:?}");
    let other = Watch::new();
    let coarse = Query::new().watch(&other).capacity(500).collect(&test.snapshot).unwrap().1;
    assert_eq!((other.points(), other.expected()), (coarse.statistics.points_decoded, None));
}

#[test]
fn a_sink_that_has_enough_ends_the_query() {
    let test = store(&[surface(60_000)], Params { g: 4, leaf_capacity: 500 }, None);
    let mut batches = 0;
    let answer = Query::new()
        .run(&test.snapshot, |_| {
            batches += 1;
            if batches == 3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        })
        .unwrap();
    assert_eq!(batches, 3);
    assert!(answer.points < 60_000);
}

#[test]
fn names_and_numbers_that_make_no_sense_are_refused() {
    let test = store(&[surface(100)], Params { g: 3, leaf_capacity: 20 }, None);
    let error = |query: Query| query.count(&test.snapshot).unwrap_err().to_string();
    assert!(error(Query::new().scans(["nort"])).contains("did you mean \"north\"?"));
    assert!(error(Query::new().attributes(["clasification"])).contains("did you mean \"Classification\"?"));
    assert!(error(Query::new().detail(Detail::Spacing(f64::NAN))).contains("spacing"));
    assert!(error(Query::new().filter(Filter::parse("hight = 2").unwrap())).contains("\"height\""));
    let camera = serde_json::from_str(r#"{"eye":[0,0,0],"target":[1,0,0]}"#).unwrap();
    let camera: crate::geometry::Camera = camera;
    assert!(error(Query::new().view(camera.clone(), -1.0)).contains("pixel"));
    let policy = Policy::Distance(DistancePolicy::default());
    let filtered = Query::new().view(camera, 1.0).policy(policy).filter(Filter::parse("height = 2").unwrap());
    assert!(error(filtered).contains("distance policy"));
}

#[test]
fn an_answer_says_when_the_region_misses_the_site() {
    let test = store(&[surface(100)], Params { g: 3, leaf_capacity: 20 }, None);
    let far = Region::new_box([1e6; 3], [2e6; 3]).unwrap();
    let answer = Query::new().region(far).count(&test.snapshot).unwrap();
    assert!(answer.region_misses_site && answer.points == 0);
    assert!(!Query::new().count(&test.snapshot).unwrap().region_misses_site);
    let empty = store(&[Vec::new()], Params { g: 3, leaf_capacity: 20 }, None);
    let (batch, answer) = Query::new().capacity(5).collect(&empty.snapshot).unwrap();
    assert!(batch.is_empty() && answer.error_bound == Some(0.0));
}

#[test]
fn summaries_leave_out_scans_that_lack_the_attribute() {
    let test = store(&[surface(1000)], Params { g: 3, leaf_capacity: 100 }, None);
    let (answer, summary) = Query::new().summary(&test.snapshot).unwrap();
    assert_eq!(answer.points, 1000);
    let heights: Vec<f64> = test.points.iter().filter_map(|p| p.height).map(f64::from).collect();
    let height = summary.into_iter().find(|s| s.name == "height").unwrap();
    assert_eq!(height.count, heights.len() as u64);
    let mean = heights.iter().sum::<f64>() / heights.len() as f64;
    assert!((height.mean.unwrap() - mean).abs() < 1e-12);
}

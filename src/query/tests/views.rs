//! Views: the sequence does not depend on the capacity, and what is promised of visible points holds.

use super::*;
use crate::codec::Decoder;
use crate::geometry::{Camera, DVec3, Projection};
use crate::lattice::LatticePoint;
use crate::octree::even_order;
use crate::store::decode_part;

pub fn camera(test: &TestStore, eye: [f64; 3], size: u32) -> Camera {
    let middle = test.points.first().map_or([0.0; 3], |p| test.lattice.world_from_lattice(p.at()));
    let target = DVec3::from_array(middle);
    let projection = Projection::Perspective { fov_y_rad: 0.8 };
    let eye = target + DVec3::from_array(eye);
    Camera::new(eye, target, DVec3::new(0.1, 0.2, 0.9), projection, [size, size]).unwrap()
}

pub fn visible(test: &TestStore, camera: &Camera) -> Vec<Point> {
    let frustum = camera.frustum();
    let relative = |p: &Point| DVec3::from_array(test.lattice.world_from_lattice(p.at())) - camera.eye();
    test.points.iter().filter(|p| frustum.contains(relative(p))).copied().collect()
}

pub fn eye() -> impl Strategy<Value = [f64; 3]> {
    prop::array::uniform3(prop_oneof![-40.0_f64..40.0, -3.0_f64..3.0])
        .prop_filter("a direction", |e| e.iter().any(|c| c.abs() > 0.5) && (e[0].abs() > 0.2 || e[1].abs() > 0.3))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn views_nest_and_keep_their_promise(
        places in places(120), params in params(), eye in eye(), size in prop::sample::select(vec![2_u32, 16, 200, 2000]),
    ) {
        let test = store(&[numbered(places)], params, None);
        let camera = camera(&test, eye, size);
        let seen = visible(&test, &camera);
        let query = || Query::new().with_scans(true).view(camera.clone(), 1.0);
        let (all, unlimited) = collect(query(), &test);
        let last = last_bound(&under_capacities(&test, query, all.len(), &seen)?)?;
        prop_assert_eq!(last, unlimited.error_bound);
        // Fully refined, everything visible is there.
        let (finest, complete) = collect(Query::new().with_scans(true).view(camera.clone(), 0.0), &test);
        let finest = ascending(finest);
        prop_assert!(seen.iter().all(|p| finest.binary_search(p).is_ok()));
        prop_assert_eq!(complete.error_bound, Some(0.0));
    }

    #[test]
    fn views_under_a_filter_nest_and_keep_their_promise(
        places in places(120), params in params(), eye in eye(), asked in asked(),
        threshold in prop::sample::select(vec![1.0, 8.0, 40.0]),
    ) {
        let test = store(&[numbered(places)], params, None);
        let camera = camera(&test, eye, 64);
        let matches = asked.matches(&test, None);
        let seen: Vec<Point> = visible(&test, &camera).into_iter().filter(|p| matches(p)).collect();
        let (all, whole) = collect(asked.query(&test).view(camera.clone(), threshold), &test);
        prop_assert!(all.iter().all(&matches));
        // As fine as if there were no points but these: cells of so many pixels, none of which is empty.
        prop_assert!(whole.error_bound.is_some());
        prop_assert!(whole.error_bound_px.is_none_or(|px| px <= 1.7321 * threshold), "{whole:?}");
        prop_assert!(seen.is_empty() || !all.is_empty());
        let view = || asked.query(&test).view(camera.clone(), threshold);
        last_bound(&under_capacities(&test, view, all.len(), &seen)?)?;
        let (finest, answer) = collect(asked.query(&test).view(camera, 0.0), &test);
        let finest = ascending(finest);
        prop_assert!(seen.iter().all(|p| finest.binary_search(p).is_ok()));
        prop_assert_eq!(answer.error_bound, Some(0.0));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn the_policy_of_distance_uses_the_capacity_and_nests(
        places in places(120), params in params(), eye in eye(), amount in 0.5_f64..4.0, levels in 2_u32..20,
        split in prop::option::of(0.5_f64..30.0), min_ratio in prop::sample::select(vec![0.0, 0.001, 0.3, 1.0]),
        distance in prop::sample::select(vec![
            CubeDistance::Center, CubeDistance::Minimum, CubeDistance::Maximum, CubeDistance::Mean,
        ]),
    ) {
        let test = store(&[numbered(places)], params, None);
        let camera = camera(&test, eye, 300);
        let seen = visible(&test, &camera);
        let policy = Policy::Distance(DistancePolicy { amount, levels, min_ratio, distance, split });
        let query = || Query::new().with_scans(true).view(camera.clone(), 1.0).policy(policy);
        let (all, whole) = collect(query(), &test);
        prop_assert_eq!(whole.error_bound, Some(0.0));
        let all = ascending(all);
        prop_assert!(seen.iter().all(|p| all.binary_search(p).is_ok()));
        under_capacities(&test, query, all.len(), &seen)?;
    }

    #[test]
    fn explanations_account_for_every_point(
        places in places(120), params in params(), asked in asked(), eye in eye(), view in any::<bool>(),
        capacity in prop::option::of(0_u64..100), c in prop::option::of(0_u8..6),
    ) {
        let test = store(&[numbered(places)], params, None);
        let mut query = asked.query(&test);
        if view {
            query = query.view(camera(&test, eye, 64), 1.0);
        }
        if let Some(capacity) = capacity {
            query = query.capacity(capacity);
        }
        if let Some(c) = c {
            query = query.detail(Detail::Spacing(2_f64.powi(c.into()) * QUANTUM));
        }
        let explained = query.explain(&test.snapshot).unwrap();
        let answer = query.count(&test.snapshot).unwrap();
        prop_assert_eq!(explained.answer.points, answer.points);
        // What is said to be taken is in the answer; together with what is not known it is all of it.
        let sum: u64 = explained.nodes.iter().filter_map(|n| n.taken).sum();
        let open = explained.nodes.iter().any(|n| n.taken.is_none());
        prop_assert!(if open { sum <= answer.points } else { sum == answer.points }, "{} of {:?}", sum, explained);
        prop_assert!(explained.nodes.iter().all(|n| !n.reason.is_empty() && n.taken.is_none_or(|t| t <= n.points)));
        // A line for each node after the sums, which account for every node, too.
        let text = explained.to_string();
        let (sums, table) = text.split_once("\n\n").unwrap_or((&text, ""));
        prop_assert_eq!(table.lines().count(), if explained.nodes.is_empty() { 0 } else { explained.nodes.len() + 1 });
        let nodes = |line: &str| line.split_whitespace().nth(1).and_then(|n| n.parse().ok()).unwrap_or(0);
        prop_assert_eq!(sums.lines().skip(1).map(nodes).sum::<usize>(), explained.nodes.len());
        let few = explained.text(3);
        prop_assert_eq!(few.lines().count(), text.lines().count().min(sums.lines().count() + 6), "{}", few);
    }
}

#[test]
fn a_small_change_of_view_or_capacity_changes_few_points() {
    let test = store(&[surface(120_000)], Params { g: 5, leaf_capacity: 2000 }, None);
    let points = |eye: [f64; 3], capacity: u64, policy| {
        let query = Query::new().with_scans(true).view(camera(&test, eye, 900), 0.0).policy(policy).capacity(capacity);
        let (found, answer) = collect(query, &test);
        // The view holds more than that, so all of it is used.
        assert_eq!(answer.points, capacity);
        ascending(found)
    };
    for policy in [Policy::Screen, Policy::Distance(DistancePolicy::default())] {
        let eye = [-60.0, -40.0, 30.0];
        let here = points(eye, 20_000, policy);
        // Half a percent of the distance, or of the capacity.
        let moved = points([-59.8, -40.2, 30.2], 20_000, policy);
        let lost = here.iter().filter(|p| moved.binary_search(p).is_err()).count();
        assert!(lost < 1000, "{lost} of 20000 points changed with the view, {policy:?}");
        let more = points(eye, 20_100, policy);
        let lost = here.iter().filter(|p| more.binary_search(p).is_err()).count();
        assert_eq!(lost, 0, "{policy:?}");
    }
}

#[test]
fn views_come_near_to_far_and_regions_coarse_to_fine() {
    let test = store(&[surface(60_000)], Params { g: 5, leaf_capacity: 2000 }, None);
    let camera = camera(&test, [-60.0, -40.0, 30.0], 900);
    let spread = |query: Query| {
        let mut batches: Vec<Vec<LatticePoint>> = Vec::new();
        query
            .run(&test.snapshot, |batch| {
                batches.push(batch.positions.iter().collect());
                std::ops::ControlFlow::Continue(())
            })
            .unwrap();
        batches
    };
    let nearest = |batch: &Vec<LatticePoint>| {
        let distance =
            |p: &LatticePoint| (DVec3::from_array(test.lattice.world_from_lattice(*p)) - camera.eye()).length();
        batch.iter().map(distance).fold(f64::INFINITY, f64::min)
    };
    let batches = spread(Query::new().view(camera.clone(), 1.0));
    let (first, last) = (&batches[batches.len() / 4], &batches[batches.len() - 1]);
    assert!(batches.len() > 20 && nearest(first) < nearest(last), "{} and {}", nearest(first), nearest(last));
    // Coarse to fine: the first tenth of a region's answer reaches everywhere, the least distance of its points is large.
    let batches = spread(Query::new());
    let head: Vec<LatticePoint> = batches.iter().flatten().take(6000).copied().collect();
    let all: Vec<LatticePoint> = batches.iter().flatten().copied().collect();
    let some: Vec<LatticePoint> = all.iter().step_by(100).copied().collect();
    let reach = naive::hausdorff(&some, &head, [QUANTUM; 3]);
    let even = naive::hausdorff(&some, &all.iter().copied().rev().take(6000).collect::<Vec<_>>(), [QUANTUM; 3]);
    assert!(reach * 4.0 < even, "{reach} against {even} for the last ones");
}

#[test]
fn policies_are_read_from_text() {
    assert_eq!(Policy::parse("screen").unwrap(), Policy::Screen);
    let read = Policy::parse("distance, amount=1.5, levels=8, cube=mean, min-ratio=0.1, split=12").unwrap();
    let expected =
        DistancePolicy { amount: 1.5, levels: 8, min_ratio: 0.1, distance: CubeDistance::Mean, split: Some(12.0) };
    assert_eq!(read, Policy::Distance(expected));
    for bad in [
        "",
        "near",
        "screen,amount=1",
        "distance,amount=-1",
        "distance,amount=nan",
        "distance,levels=1.5",
        "distance,levels=1",
        "distance,min-ratio=2",
        "distance,split=0",
        "distance,cube=far",
        "distance,more=1",
        "distance,amount=x",
    ] {
        assert!(Policy::parse(bad).is_err(), "{bad}");
    }
}

fn sorted(mut keys: Vec<Key>) -> Vec<Key> {
    keys.sort_unstable();
    keys
}

#[test]
fn a_selection_is_closed_and_best_first() {
    let test = store(&[surface(120_000)], Params { g: 5, leaf_capacity: 2000 }, None);
    let index = test.snapshot.index().unwrap();
    let near = camera(&test, [-60.0, -40.0, 30.0], 900);
    let select = |capacity| select_view(&test.snapshot.nodes(), &test.lattice, test.g, &near, 1.0, capacity).unwrap();
    let whole = select(None);
    assert!(whole.points > 20_000 && whole.parts.len() > 30, "{} in {}", whole.points, whole.parts.len());
    let mut seen = std::collections::HashSet::new();
    for (i, part) in whole.parts.iter().enumerate() {
        if part.part == 0 {
            if let Some(parent) = index.parent(part.node) {
                let parts = index.head(parent).parts.len() as u32;
                assert!((0..parts).all(|p| seen.contains(&(parent, p))), "node {} before its parent", part.node);
            }
        } else {
            let last = whole.parts[i - 1];
            assert_eq!((last.node, last.part + 1), (part.node, part.part));
        }
        seen.insert((part.node, part.part));
    }
    for capacity in [1, 5000, 12_345, 20_000] {
        let some = select(Some(capacity));
        assert_eq!(some.points, capacity);
        let (last, first) = some.parts.split_last().unwrap();
        assert_eq!(first, &whole.parts[..first.len()]);
        let cut = whole.parts[first.len()];
        assert_eq!((last.node, last.part), (cut.node, cut.part));
        assert!(last.points <= cut.points);
        // What the query gives is an even thinning of that part.
        let (found, _) = collect(Query::new().with_scans(true).view(near.clone(), 1.0).capacity(capacity), &test);
        assert_eq!(found.len() as u64, capacity);
        let bound = some.error_bound.unwrap();
        assert!(bound >= whole.error_bound.unwrap());
        assert!(some.error_bound_px.is_none_or(|px| px >= whole.error_bound_px.unwrap()));
        // The points that the last part has brought.
        let fewer = capacity - u64::from(last.points);
        let (before, _) = collect(Query::new().with_scans(true).view(near.clone(), 1.0).capacity(fewer), &test);
        let before = ascending(before);
        let brought = found.iter().filter(|p| before.binary_search(p).is_err()).map(|p| p.key).collect();
        let head = index.head(cut.node);
        let keys = decode_part(&test.snapshot, head, cut.part as usize, &mut Decoder::new()).unwrap().keys;
        let thinned = even_order(cut.points).take(last.points as usize).map(|i| keys[i as usize]).collect();
        assert_eq!(sorted(brought), sorted(thinned), "{capacity} points");
    }
}

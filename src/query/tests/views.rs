//! Views: the sequence does not depend on the capacity, and what is promised of visible points holds.

use super::*;
use crate::geometry::{Camera, DVec3, Projection};
use crate::octree::even_order;

fn camera(test: &TestStore, eye: [f64; 3], size: u32) -> Camera {
    let middle = test.points.first().map_or([0.0; 3], |p| test.lattice.world_from_lattice(p.at()));
    let target = DVec3::from_array(middle);
    let projection = Projection::Perspective { fov_y_rad: 0.8 };
    let eye = target + DVec3::from_array(eye);
    Camera::new(eye, target, DVec3::new(0.1, 0.2, 0.9), projection, [size, size]).unwrap()
}

fn visible(test: &TestStore, camera: &Camera) -> Vec<Point> {
    let frustum = camera.frustum();
    let relative = |p: &Point| DVec3::from_array(test.lattice.world_from_lattice(p.at())) - camera.eye();
    test.points.iter().filter(|p| frustum.contains(relative(p))).copied().collect()
}

fn eye() -> impl Strategy<Value = [f64; 3]> {
    prop::array::uniform3(prop_oneof![-40.0_f64..40.0, -3.0_f64..3.0])
        .prop_filter("a direction", |e| e.iter().any(|c| c.abs() > 0.5) && (e[0].abs() > 0.2 || e[1].abs() > 0.3))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(80))]

    #[test]
    fn views_nest_and_keep_their_promise(
        places in places(120), params in params(), eye in eye(), size in prop::sample::select(vec![2_u32, 16, 200, 2000]),
    ) {
        let test = store(&[numbered(places)], params, None);
        let camera = camera(&test, eye, size);
        let seen = visible(&test, &camera);
        let query = || Query::new().with_scans(true).view(camera.clone(), 1.0);
        let (all, unlimited) = collect(query(), &test);
        let (mut before, mut last): (Vec<Point>, Option<f64>) = (Vec::new(), None);
        for capacity in 0..=all.len() + 1 {
            let (found, answer) = collect(query().capacity(capacity as u64), &test);
            let found = ascending(found);
            prop_assert_eq!(found.len(), capacity.min(all.len()));
            prop_assert!(before.iter().all(|p| found.binary_search(p).is_ok()), "{} points", capacity);
            if let Some(bound) = answer.error_bound {
                prop_assert!(hausdorff(&seen, &found) <= bound * SLACK, "{} points", capacity);
                prop_assert!(last.is_none_or(|l| bound <= l), "{} points: {:?}, then {}", capacity, last, bound);
                last = Some(bound);
            } else {
                prop_assert!(last.is_none() && found.is_empty() || test.points.is_empty());
            }
            before = found;
        }
        prop_assert_eq!(last, unlimited.error_bound);
        // Fully refined, everything visible is there.
        let (finest, complete) = collect(Query::new().with_scans(true).view(camera.clone(), 0.0), &test);
        let finest = ascending(finest);
        prop_assert!(seen.iter().all(|p| finest.binary_search(p).is_ok()));
        prop_assert_eq!(complete.error_bound, Some(0.0));
    }

    #[test]
    fn views_under_a_filter_nest_and_promise_only_what_is_complete(
        places in places(120), params in params(), eye in eye(), asked in asked(),
    ) {
        let test = store(&[numbered(places)], params, None);
        let camera = camera(&test, eye, 64);
        let matches = asked.matches(&test, None);
        let seen: Vec<Point> = visible(&test, &camera).into_iter().filter(|p| matches(p)).collect();
        let (all, _) = collect(asked.query(&test).view(camera.clone(), 1.0), &test);
        prop_assert!(all.iter().all(&matches));
        let mut before: Vec<Point> = Vec::new();
        for capacity in 0..=all.len() + 1 {
            let (found, answer) = collect(asked.query(&test).view(camera.clone(), 1.0).capacity(capacity as u64), &test);
            let found = ascending(found);
            prop_assert_eq!(found.len(), capacity.min(all.len()));
            prop_assert!(before.iter().all(|p| found.binary_search(p).is_ok()));
            if let Some(bound) = answer.error_bound {
                prop_assert!(hausdorff(&seen, &found) <= bound * SLACK);
            }
            before = found;
        }
        let (finest, answer) = collect(asked.query(&test).view(camera, 0.0), &test);
        let finest = ascending(finest);
        prop_assert!(seen.iter().all(|p| finest.binary_search(p).is_ok()));
        prop_assert_eq!(answer.error_bound, Some(0.0));
    }
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
        assert_eq!(even_order(cut.points).take(last.points as usize).count(), last.points as usize);
    }
}

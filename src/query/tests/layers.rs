//! Stores of several layers, as a thin scan leaves them: the answers are those of the same points in one layer, and
//! bounds, capacities and views keep their promises.

use super::views::{camera, eye, visible};
use super::*;

/// The same points in a few layers: one of nearly all of them, thin ones, sometimes one that was given up; or, half of the time,
/// each layer where the others are not.
fn layered() -> impl Strategy<Value = Vec<Vec<Point>>> {
    (places(110), 2_u32..4, any::<(bool, bool)>()).prop_map(|(places, layers, (empty, apart))| {
        let points = numbered(places);
        let mut across: Vec<u64> = points.iter().map(|p| p.at().0[0]).collect();
        across.sort_unstable();
        let middle = across.get(across.len() / 2).copied().unwrap_or(0);
        let of = |layer: u32| {
            let of_place = |p: &Point| u32::from(p.at().0[0] < middle);
            let of_number = |p: &Point| [0, 0, 1, 0, 2, 0, 0][p.id as usize % 7].min(layers - 1);
            let here = |p: &&Point| if apart { of_place(p) } else { of_number(p) } == layer;
            points.iter().filter(here).copied().collect::<Vec<_>>()
        };
        let mut all: Vec<Vec<Point>> = (0..layers).map(of).collect();
        if empty {
            all.insert(1, Vec::new());
        }
        all
    })
}

fn in_one(layers: &[Vec<Point>]) -> Vec<Vec<Point>> {
    vec![ascending(layers.concat())]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(80))]

    #[test]
    fn regions_are_answered_as_in_one_layer(
        layers in layered(), params in params(), asked in asked(), c in 0_u8..8,
        hidden in prop::sample::select(vec![None, None, Some(1), Some(2)]),
    ) {
        let (test, one) = (store(&layers, params, hidden), store(&in_one(&layers), params, hidden));
        let matches = asked.matches(&test, hidden);
        let all: Vec<Point> = test.points.iter().filter(|p| matches(p)).copied().collect();
        let (found, answer) = collect(asked.query(&test), &test);
        prop_assert_eq!(ascending(found), all.clone());
        prop_assert_eq!(answer.error_bound, Some(0.0));
        prop_assert_eq!(asked.query(&test).count(&test.snapshot).unwrap().points, all.len() as u64);
        // Alone, and after a level.
        for spacing in [None, Some(2_f64.powi(c.into()) * QUANTUM)] {
            let detailed = |test: &TestStore| match spacing {
                Some(spacing) => asked.query(test).detail(Detail::Spacing(spacing)),
                None => asked.query(test),
            };
            let whole = ascending(collect(detailed(&test), &test).0);
            prop_assert_eq!(&whole, &ascending(collect(detailed(&one), &one).0));
            let answers = under_capacities(&test, || detailed(&test), whole.len(), &all)?;
            last_bound(&answers)?;
            for (capacity, (found, bound)) in answers.into_iter().enumerate() {
                let (same, promised) = collect(detailed(&one).capacity(capacity as u64), &one);
                prop_assert_eq!(found, ascending(same), "{} points", capacity);
                // Where nothing may be looked at, the rows of one tree can rule out what those of several leave open.
                prop_assert!(capacity == 0 || bound == promised.error_bound, "{} points", capacity);
            }
        }
    }

    #[test]
    fn views_nest_and_keep_their_promise_over_layers(
        layers in layered(), params in params(), asked in asked(), eye in eye(),
        size in prop::sample::select(vec![2_u32, 16, 200, 2000]), is_filtered in any::<bool>(),
    ) {
        let test = store(&layers, params, None);
        let camera = camera(&test, eye, size);
        let matches = asked.matches(&test, None);
        let view = |test: &TestStore, max_error_px: f64| {
            let query = if is_filtered { asked.query(test) } else { Query::new().with_scans(true) };
            query.view(camera.clone(), max_error_px)
        };
        let query = || view(&test, 1.0);
        let wanted = |p: &Point| !is_filtered || matches(p);
        let seen: Vec<Point> = visible(&test, &camera).into_iter().filter(wanted).collect();
        let (all, unlimited) = collect(query(), &test);
        prop_assert!(all.iter().all(wanted));
        prop_assert!(unlimited.error_bound.is_some() || all.is_empty());
        let last = last_bound(&under_capacities(&test, query, all.len(), &seen)?)?;
        prop_assert_eq!(last, unlimited.error_bound);
        let (finest, answer) = collect(view(&test, 0.0), &test);
        let finest = ascending(finest);
        prop_assert!(seen.iter().all(|p| finest.binary_search(p).is_ok()));
        prop_assert_eq!(answer.error_bound, Some(0.0));
        // Of what is seen, that is what one layer gives.
        let one = store(&in_one(&layers), params, None);
        let (same, _) = collect(view(&one, 0.0), &one);
        let seen_of = |found: &[Point]| seen.iter().filter(|p| found.contains(p)).copied().collect::<Vec<_>>();
        prop_assert_eq!(seen_of(&finest), seen_of(&same));
    }

    #[test]
    fn the_policy_of_distance_nests_and_keeps_its_promise_over_layers(
        layers in layered(), params in params(), eye in eye(), min_ratio in prop::sample::select(vec![0.0, 0.001, 0.3]),
        split in prop::option::of(0.5_f64..30.0),
    ) {
        let test = store(&layers, params, None);
        let camera = camera(&test, eye, 300);
        let policy = Policy::Distance(DistancePolicy { min_ratio, split, ..DistancePolicy::default() });
        let query = || Query::new().with_scans(true).view(camera.clone(), 1.0).policy(policy);
        let (all, whole) = collect(query(), &test);
        prop_assert_eq!(whole.error_bound, Some(0.0));
        under_capacities(&test, query, all.len(), &visible(&test, &camera))?;
    }

    #[test]
    fn neighbours_and_densities_are_those_of_one_layer(
        layers in layered(), params in params(), asked in asked(), near in prop::array::uniform3(-3.0_f64..20.0),
        k in 1_usize..6, side in prop::sample::select(vec![0.3, 1.0, 7.5]), at in any::<prop::sample::Index>(),
        on_a_point in any::<bool>(),
    ) {
        let (test, one) = (store(&layers, params, None), store(&in_one(&layers), params, None));
        let corner = test.points.first().map_or([0.0; 3], |p| test.lattice.world_from_lattice(p.at()));
        // On a point there are others as near, of other layers.
        let place = match test.points.len() {
            0 => [near],
            n if on_a_point => [test.lattice.world_from_lattice(test.points[at.index(n)].at())],
            _ => [std::array::from_fn(|axis| corner[axis] + near[axis])],
        };
        let of = |test: &TestStore, is_asked: bool| {
            let query = if is_asked { asked.query(test) } else { Query::new().with_scans(true) };
            let query = query.attributes(["class", "height", "code"]);
            let found = query.nearest(&test.snapshot, &place, k, None).unwrap();
            let density = query.density(&test.snapshot, side).unwrap();
            (points(&found.batch), found.distances, found.ends, density.first, density.size, density.squares)
        };
        prop_assert_eq!(of(&test, true), of(&one, true));
        prop_assert_eq!(of(&test, false), of(&one, false));
    }
}

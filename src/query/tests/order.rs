//! In which order the points of a thinned answer come: coarse to fine, in rounds.

use super::*;
use crate::octree::wins;
use std::collections::HashMap;

/// What each point of an answer wins among its points, in the order in which they came.
fn wins_in_order(found: &[Point]) -> Vec<i8> {
    let sorted = ascending(found.to_vec());
    let keys: Vec<Key> = sorted.iter().map(|p| p.key).collect();
    let of: HashMap<Point, i8> = sorted.into_iter().zip(wins(&keys, 48)).collect();
    found.iter().map(|p| of[p]).collect()
}

/// Whoever stops early has a complete level: of those from `finest` on, which has `counted` points, one of which the next such
/// has not more than `growth` times the points, as far as levels have no more of them than `most`.
fn come_coarse_to_fine(
    wins: &[i8],
    finest: i8,
    counted: usize,
    growth: usize,
    most: usize,
) -> Result<(), TestCaseError> {
    let level = |c: i8| wins.iter().filter(|&&w| w >= c).count();
    // No point of it comes after one that is finer.
    let is_complete = |c: i8| !wins.iter().skip_while(|&&w| w >= c).any(|&w| w >= c);
    let mut there = counted;
    for c in finest + 1..48 {
        let points = level(c);
        if there <= 3 || points > most {
            continue;
        }
        let is_small = points * growth <= there;
        prop_assert!(is_complete(c) || !is_small, "{} of {} points at {}: {:?}", points, there, c, wins);
        if is_complete(c) {
            there = points;
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn thinned_answers_come_coarse_to_fine(
        places in places(150), params in params(), asked in asked(), capacity in 1_u64..100, layers in 1_usize..3,
        hidden in prop::sample::select(vec![None, None, Some(1)]),
    ) {
        let points = numbered(places);
        let layers: Vec<Vec<Point>> =
            (0..layers).map(|l| points.iter().filter(|p| p.id as usize % layers == l).copied().collect()).collect();
        let test = store(&layers, params, hidden);
        let is_filtered = hidden.is_some() || asked.filter > 0 || asked.scans.is_some();
        // What is filtered comes level by level as far as it is remembered: in a test 40 points.
        let (growth, most) = if is_filtered { (8, 40) } else { (3, usize::MAX) };
        for c in 0..=test.k.min(9) {
            let level = |c: u8| asked.query(&test).detail(Detail::Spacing(2_f64.powi(c.into()) * QUANTUM));
            let (found, _) = collect(level(c), &test);
            if is_filtered {
                come_coarse_to_fine(&wins_in_order(&found), c as i8, found.len(), growth, most)?;
            }
            let (found, _) = collect(level(c).capacity(capacity), &test);
            let wins = wins_in_order(&found);
            let finest = wins.iter().copied().min().map_or(c, |win| win.max(0) as u8);
            let counted = level(finest).count(&test.snapshot).unwrap().points as usize;
            come_coarse_to_fine(&wins, finest as i8, counted, growth, most)?;
        }
    }
}

#[test]
fn levels_of_a_site_come_one_after_the_other() {
    let test = store(&[surface(150_000)], Params { g: 5, leaf_capacity: 500 }, None);
    let corner = Region::new_sphere([150.0, 175.0, -75.0], 400.0).unwrap();
    for query in [Query::new(), Query::new().region(corner)] {
        for c in [5_u8, 6] {
            let level = query.clone().detail(Detail::Spacing(2_f64.powi(c.into()) * QUANTUM));
            let points = level.count(&test.snapshot).unwrap().points;
            for query in [level, query.clone().capacity(points - points / 9)] {
                let (found, _) = collect(query.with_scans(true), &test);
                let wins = wins_in_order(&found);
                let level = |c: i8| wins.iter().filter(|&&w| w >= c).count();
                let complete = (c as i8 + 1..12).filter(|&c| wins[..level(c)].iter().all(|&w| w >= c));
                let levels: Vec<i8> = complete.collect();
                // Each of them, down to those that have next to nothing.
                let before = std::iter::once(c as i8).chain(levels.iter().copied());
                let mut steps = before.zip(&levels).take_while(|(_, coarse)| level(**coarse) > 200).peekable();
                assert!(steps.peek().is_some() && steps.all(|(fine, coarse)| *coarse == fine + 1), "{levels:?}");
            }
        }
    }
}

//! What node rows say of all points together.

use super::*;
use crate::lattice::{LatticeBox, LatticePoint};

/// A line of places across the site, and its class.
fn aslant(points: u64, class: u8) -> Vec<(LatticePoint, u8)> {
    let low = (BIAS as u64) & !0xfff;
    (0..points).map(|i| (LatticePoint([low + 8 * i, low + 8 * i + i % 3, low + i % 5]), class)).collect()
}

#[test]
fn boxes_around_the_points_are_closer_than_one_box() {
    let params = Params { g: 2, leaf_capacity: 8 };
    let test = store(&[numbered(aslant(400, 1))], params, Some(2));
    let boxes = occupied_boxes(&test.snapshot, |_| true).unwrap();
    let volume = |b: &LatticeBox| (0..3).map(|i| (b.max.0[i] - b.min.0[i] + 1) as f64).product::<f64>();
    let one = test.points.iter().map(|p| LatticeBox::of(p.at())).reduce(|a, b| a.union(&b)).unwrap();
    let all: f64 = boxes.iter().map(volume).sum();
    assert!(boxes.len() > 20 && all < 0.5 * volume(&one), "{} boxes, {all} of {}", boxes.len(), volume(&one));
    let inside = test.points.iter().filter(|p| boxes.iter().any(|b| b.contains(p.at()))).count();
    assert!(inside * 20 >= test.points.len() * 19, "{inside} of {} points", test.points.len());
    let ends = boxes.iter().copied().reduce(|a, b| a.union(&b)).unwrap();
    assert_eq!(ends.max.0[0], one.max.0[0], "the last point is in none");
    // Of what nobody sees nothing is told.
    assert!(occupied_boxes(&test.snapshot, |_| false).unwrap().is_empty());
    let north = test.snapshot.scans()[0].bounds.unwrap();
    assert!(occupied_boxes(&test.snapshot, |id| id == 1).unwrap().iter().all(|b| north.contains_box(b)));
}

/// One point a thousand times farther away than the site is wide made the site a dot in its picture.
#[test]
fn a_few_strays_are_not_part_of_the_outline() {
    let params = Params { g: 2, leaf_capacity: 64 };
    let (points, expected) = (20_000, 8 * 19_999);
    let width = |strays: u64, away: i64| {
        let mut places = aslant(points, 1);
        let first = places[0].0.0;
        places.extend((0..strays as i64).map(|i| {
            let x = first[0].wrapping_add_signed(away + 5 * i);
            (LatticePoint([x, first[1], first[2]]), 1)
        }));
        let test = store(&[numbered(places)], params, None);
        let outline = occupied_boxes(&test.snapshot, |_| true).unwrap().into_iter().reduce(|a, b| a.union(&b)).unwrap();
        outline.max.0[0] - outline.min.0[0]
    };
    for (far, near) in [(200_000_000, 220_000), (-200_000_000, -100_000)] {
        let site = width(1, far);
        assert!((expected * 9 / 10..=expected).contains(&site), "{site} of {expected}");
        // What is a part of the site, though a small one, is seen, and so is a stray near by.
        assert!(width(400, far) >= 200_000_000);
        assert!(width(1, near) >= 220_000, "{}", width(1, near));
    }
}

#[test]
fn attributes_of_one_value_are_known() {
    let params = Params { g: 2, leaf_capacity: 8 };
    let flat = |places| flat_attributes(&store(&[numbered(places)], params, None).snapshot).unwrap();
    assert_eq!(flat(aslant(50, 3)).get("Classification"), Some(&3.0));
    let mut places = aslant(50, 3);
    places[20].1 = 2;
    assert!(!flat(places).contains_key("Classification"));
}

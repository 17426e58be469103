//! Polygons against a naive test of one place in exact integers.

use super::*;
use crate::geometry::Containment;
use crate::lattice::{BIAS, Lattice, LatticeBox, LatticePoint};
use proptest::prelude::*;
use std::collections::BTreeMap;

/// Even and odd, ring by ring, in the units of the polygon; only for lattices whose steps are whole units.
pub(crate) fn naive(area: &Polygons, lattice: &Lattice, p: LatticePoint) -> bool {
    let at: [i128; 2] = std::array::from_fn(|i| lattice.decimal_on_axis(i, p.0[i]).scaled_to(-PLACES).unwrap());
    area.polygons.iter().any(|rings| {
        let mut inside = false;
        for ring in rings {
            for i in 0..ring.len() {
                let (a, b) = (ring[i], ring[(i + 1) % ring.len()]);
                if (a[1] > at[1]) == (b[1] > at[1]) {
                    continue;
                }
                // x < a.x + (b.x - a.x) * (y - a.y) / (b.y - a.y), with what is divided by on the other side.
                let order = exact::compare_products(at[0] - a[0], b[1] - a[1], b[0] - a[0], at[1] - a[1]);
                if order == if b[1] > a[1] { Ordering::Less } else { Ordering::Greater } {
                    inside = !inside;
                }
            }
        }
        inside
    })
}

/// A coordinate of so many hundredths of a step: its shortest decimal is exactly that.
fn coordinate(hundredths: i64, quantum: f64) -> f64 {
    let q = Decimal::from_f64(quantum).unwrap();
    Decimal::new(q.mantissa() * i128::from(hundredths), q.exponent() - 2).to_f64()
}

/// Polygons of any rings, crossing ones too: even and odd are the same rule for them.
fn unchecked(polygons: &[Vec<Vec<[f64; 2]>>]) -> Polygons {
    let rings = |rings: &Vec<Vec<[f64; 2]>>| rings.iter().map(|r| exact_ring(r)).collect::<Result<Vec<_>, _>>();
    Polygons { polygons: polygons.iter().map(|p| rings(p).unwrap()).collect(), bounds: None, epsg: None }
}

fn vertex() -> impl Strategy<Value = [i64; 2]> {
    // On points, between them, on one line, close together, and far away.
    let axis = || {
        prop_oneof![
            4 => (-30_i64..30).prop_map(|v| v * 100),
            2 => -3000_i64..3000,
            1 => -3_i64..3,
            1 => prop::sample::select(vec![-1_000_000_007, 999_999_999, 123_456_789_012, -98_765_432_101]),
        ]
    };
    [axis(), axis()]
}

fn ring() -> impl Strategy<Value = Vec<[i64; 2]>> {
    let size = prop_oneof![4 => 3..9_usize, 1 => 20..80_usize];
    size.prop_flat_map(|n| prop::collection::vec(vertex(), n)).prop_filter("three places", |ring| {
        let world: Vec<[f64; 2]> = ring.iter().map(|v| v.map(|c| c as f64)).collect();
        exact_ring(&world).is_ok()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn boxes_and_points_agree_with_the_naive_test(
        polygons in prop::collection::vec(prop::collection::vec(ring(), 1..4), 1..3),
        quantum in prop::sample::select(vec![0.001, 0.01, 0.3, 1000.0]),
        corners in prop::collection::vec([-35_i64..35, -35_i64..35], 8),
        far in prop::collection::vec([-2_000_000_000_i64..2_000_000_000, -2_000_000_000_i64..2_000_000_000], 4),
    ) {
        let world: Vec<Vec<Vec<[f64; 2]>>> = polygons
            .iter()
            .map(|p| p.iter().map(|r| r.iter().map(|v| v.map(|c| coordinate(c, quantum))).collect()).collect())
            .collect();
        let area = unchecked(&world);
        let lattice = Lattice::uniform(quantum).unwrap();
        let prism = Prism::new(&area, [f64::NEG_INFINITY, f64::INFINITY], &lattice).unwrap();
        let at = |[x, y]: [i64; 2]| LatticePoint([(x + BIAS) as u64, (y + BIAS) as u64, BIAS as u64]);
        let mut points: Vec<LatticePoint> = (0..4900).map(|i| at([i % 70 - 35, i / 70 - 35])).collect();
        points.extend(far.iter().map(|&p| at(p)));
        let expected: Vec<bool> = points.iter().map(|&p| naive(&area, &lattice, p)).collect();
        let mask = prism.test(&points.iter().copied().collect());
        for (i, &p) in points.iter().enumerate() {
            prop_assert_eq!(prism.contains(p), expected[i], "{:?}", p);
            prop_assert_eq!(mask.contains(i), expected[i]);
        }
        // Few that lie together, of which most edges are on one side.
        let mut tiles = BTreeMap::<_, Vec<usize>>::new();
        for i in 0..4900 {
            tiles.entry((i % 70 / 7, i / 70 / 5)).or_default().push(i);
        }
        for tile in tiles.values() {
            let mask = prism.test(&tile.iter().map(|&i| points[i]).collect());
            for (place, &i) in tile.iter().enumerate() {
                prop_assert_eq!(mask.contains(place), expected[i], "{:?} in a tile", points[i]);
            }
        }
        let mut boxes: Vec<LatticeBox> = corners.windows(2).map(|w| LatticeBox::of(at(w[0])).with(at(w[1]))).collect();
        // Small ones, which are often wholly inside or outside, and one over everything.
        boxes.extend(corners.iter().map(|&[x, y]| LatticeBox::of(at([x, y])).with(at([x + (y & 3), y + (x & 3)]))));
        boxes.push(LatticeBox::of(at([-2_000_000_000; 2])).with(at([2_000_000_000; 2])));
        for bounds in boxes {
            let placed = prism.classify(&bounds);
            for (p, &inside) in points.iter().zip(&expected).filter(|(p, _)| bounds.contains(**p)) {
                match placed {
                    Containment::Inside => prop_assert!(inside, "{:?} in {:?}", p, bounds),
                    Containment::Outside => prop_assert!(!inside, "{:?} in {:?}", p, bounds),
                    Containment::Partly => {}
                }
            }
        }
    }

    #[test]
    fn neighbours_share_their_edge_with_no_point_lost(
        shifts in prop::collection::vec([-50_i64..50, -50_i64..50], 36), whole in any::<bool>(),
    ) {
        // A net of triangles over a square, its inner corners anywhere, often on points.
        let lattice = Lattice::uniform(0.01).unwrap();
        let corner = |i: usize, j: usize| {
            let inner = (1..5).contains(&i) && (1..5).contains(&j);
            let [dx, dy] = if inner { shifts[6 * j + i] } else { [0; 2] };
            let snap = |v: i64| if whole { v / 100 * 100 } else { v };
            [coordinate(snap(i as i64 * 500 + dx * 2), 0.01), coordinate(snap(j as i64 * 500 + dy * 2), 0.01)]
        };
        let mut cells = Vec::new();
        for (i, j) in (0..25).map(|n| (n % 5, n / 5)) {
            let [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
            cells.extend([vec![a, b, c], vec![a, c, d]]);
        }
        let inf = f64::INFINITY;
        let prisms: Vec<Prism> = cells
            .iter()
            .map(|ring| Prism::new(&Polygons::new(&[vec![ring.clone()]]).unwrap(), [-inf, inf], &lattice).unwrap())
            .collect();
        for n in 0..900 {
            let (x, y) = (n % 30 - 2, n / 30 - 2);
            let p = LatticePoint([(x + BIAS) as u64, (y + BIAS) as u64, 7]);
            let owners = prisms.iter().filter(|prism| prism.contains(p)).count();
            prop_assert_eq!(owners, usize::from((0..25).contains(&x) && (0..25).contains(&y)), "{} {}", x, y);
        }
    }
}

#[test]
fn a_rectangle_is_the_box_of_its_corners() {
    for (quantum, phase) in [(0.01, 0.0), (0.001, 0.0004), (0.3, 0.1)] {
        let decimal = |v| Decimal::from_f64(v).unwrap();
        let lattice = Lattice::new([decimal(quantum); 3], [decimal(phase); 3]).unwrap();
        let (x, y) = ([-0.123, 0.0, 0.1, 1.25], [-3.0, 0.0004, 2.1]);
        for (i, j) in (0..12).map(|n| (n % 4, n / 4)) {
            for (k, l) in (0..12).map(|n| (n % 4, n / 4)).filter(|&(k, l)| k > i && l > j) {
                let ring = vec![[x[i], y[j]], [x[k], y[j]], [x[k], y[l]], [x[i], y[l]]];
                let prism = Prism::new(&Polygons::new(&[vec![ring]]).unwrap(), [-0.5, 0.25], &lattice).unwrap();
                let Some(same) = lattice.box_from_world([x[i], y[j], -0.5], [x[k], y[l], 0.25]) else { continue };
                for corner in 0..64 {
                    // The box's corners, and one step within and without.
                    let at = |axis: usize| {
                        let side = if corner >> axis & 1 == 0 { same.min.0[axis] } else { same.max.0[axis] };
                        side - 1 + ((corner / 8) >> axis & 1) as u64 * if corner >> axis & 1 == 0 { 1 } else { 2 }
                    };
                    let p = LatticePoint([at(0), at(1), at(2)]);
                    assert_eq!(prism.contains(p), same.contains(p), "{p:?} and {same:?}");
                }
                assert_ne!(prism.classify(&same), Containment::Outside);
            }
        }
    }
}

#[test]
fn wrong_polygons_are_refused_with_the_place() {
    let wrong = |text: &str| Polygons::parse(text).expect_err(text).to_string();
    let bow = wrong("POLYGON((0 0, 10 10, 10 0, 0 10, 0 0))");
    assert!(bow.starts_with("the polygon crosses itself: the edge from "), "{bow}");
    assert!(bow.contains("10 0 to 0 10") && bow.contains("0 0 to 10 10"), "{bow}");
    let hole = wrong("MULTIPOLYGON(((20 0, 30 0, 25 5)), ((0 0, 10 0, 10 10, 0 10), (2 2, 15 2, 4 4)))");
    assert!(hole.starts_with("hole 1 of polygon 2 crosses polygon 2: "), "{hole}");
    let outside = wrong("POLYGON((0 0, 10 0, 10 10, 0 10), (12 2, 15 2, 14 4))");
    assert_eq!(outside, "hole 1 of the polygon lies outside of its outline, at 12 2");
    assert!(wrong("POLYGON((0 0, 1 1, 0 0))").contains("2 different places"));
    assert!(wrong("POLYGON((0 0, 1e16 1, 0 5))").contains("1e15"));
    assert_eq!(wrong("POLYGON((0 0,\n 1 x, 0 5))"), "WKT, line 2 column 4: expected a number, found \"x\"");
    assert!(wrong(r#"{"type":"FeatureCollection","features":[]}"#).contains("no feature"));
    assert!(Polygons::parse("POLYGON EMPTY").unwrap().bounds().is_none());
}

#[test]
fn coordinates_of_any_size_and_number_of_digits_are_kept() {
    let tiny = Polygons::parse("POLYGON((0 0, 1e-14 0, 1e-14 1e-14, 0 0))").unwrap();
    let lattice = Lattice::uniform(1e-12).unwrap();
    let inf = f64::INFINITY;
    let at = |x: i64, y: i64| LatticePoint([(x + BIAS) as u64, (y + BIAS) as u64, 0]);
    let prism = Prism::new(&tiny, [-inf, inf], &lattice).unwrap();
    assert!(prism.contains(at(0, 0)) && !prism.contains(at(1, 0)) && !prism.contains(at(0, 1)));
    let huge = Polygons::parse("POLYGON((-1e15 -1e15, 1e15 -1e15, 1e15 1e15, -1e15 -1e15))").unwrap();
    for quantum in [1e-12, 0.01, 1e6] {
        let prism = Prism::new(&huge, [-inf, inf], &Lattice::uniform(quantum).unwrap()).unwrap();
        // The diagonal is the outline on the upper left, which is inside; above it is outside.
        assert!(prism.contains(at(1000, 999)) && prism.contains(at(1000, 1000)) && !prism.contains(at(1000, 1001)));
        let all = LatticeBox { min: LatticePoint([0; 3]), max: LatticePoint([(1 << 48) - 1; 3]) };
        assert_eq!(prism.classify(&all), Containment::Partly);
    }
    // A third of a degree has no end; it is rounded, and neighbours round alike.
    let third = 1.0 / 3.0;
    let thirds = Polygons::new(&[vec![vec![[0.0, 0.0], [third, 0.0], [third, third * 1e-10]]]]);
    assert!(thirds.is_ok());
    // A phase of thirty decimals leaves no room beside 1e15.
    let quantum = [Decimal::new(1, -3); 3];
    let fine = Lattice::new(quantum, [Decimal::new(1, -12), Decimal::new(1, -18), Decimal::ZERO]).unwrap();
    assert!(Prism::new(&huge, [-inf, inf], &fine).is_ok());
    if let Ok(finest) = Lattice::new([Decimal::new(1, -12); 3], [Decimal::new(1, -28); 3]) {
        assert!(Prism::new(&huge, [-inf, inf], &finest).is_err());
        assert!(Prism::new(&tiny, [-inf, inf], &finest).is_ok());
    }
}

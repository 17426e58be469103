//! Regions against the documented tests of single points.

use super::*;
use crate::geometry::{Containment, DVec3, Projection};
use crate::lattice::{BIAS, Decimal, LatticeBox, LatticePoint};
use proptest::prelude::*;

fn lattice() -> impl Strategy<Value = Lattice> {
    prop::sample::select(vec![1e-6, 0.001, 0.01, 0.3, 1000.0]).prop_map(|q| Lattice::uniform(q).unwrap())
}

/// Points and boxes near the biased origin, so that small regions meet them.
fn near() -> impl Strategy<Value = LatticePoint> {
    prop::array::uniform3(-40_i64..40).prop_map(|p| LatticePoint(p.map(|c| (c + BIAS) as u64)))
}

/// A shape from the same few numbers: two corners in steps, infinite ones by the extremes.
fn shape(lattice: &Lattice, a: [i32; 3], b: [i32; 3], kind: u8, part: f64) -> Region {
    let q = lattice.largest_quantum();
    let world = |c: i32| match c {
        i32::MIN => f64::NEG_INFINITY,
        i32::MAX => f64::INFINITY,
        c => (f64::from(c) + part) * q,
    };
    let finite = |c: f64| if c.is_finite() { c } else { c.signum() * 1e6 * q };
    let (a3, b3) = (a.map(world), b.map(world));
    let (fa, fb) = (a3.map(finite), b3.map(finite));
    let low = std::array::from_fn(|i| a3[i].min(b3[i]));
    let high = std::array::from_fn(|i| a3[i].max(b3[i]));
    match kind {
        0 => Region::Everything,
        1 => Region::new_box(low, high).unwrap(),
        2 => Region::new_sphere(a3.map(|c| if c.is_finite() { c } else { 1e9 * q }), b3[0].abs()).unwrap(),
        // Also turned by right angles, whose faces go through points.
        3 => {
            let angles = [f64::from(a[2] % 8) * 45.0, f64::from(b[2] % 3) * 30.0, f64::from(b[1] % 2) * 10.0];
            Region::new_oriented_box(fa, fb.map(f64::abs), angles).unwrap()
        }
        4 => {
            let size = if b[0] % 2 == 0 { [1, 1] } else { [300, 200] };
            let projection = if a[0] % 2 == 0 {
                Projection::Perspective { fov_y_rad: 0.7 }
            } else {
                Projection::Orthographic { height: 30.0 * q }
            };
            let (eye, target) = (DVec3::from_array(fa), DVec3::from_array(fb) + DVec3::new(0.3, 0.2, 0.1) * q);
            match Camera::new(eye, target, DVec3::new(0.1, 0.2, 0.9), projection, size) {
                Ok(camera) => Region::new_frustum(&camera),
                Err(_) => Region::Any(Vec::new()),
            }
        }
        5 => {
            // A diamond with a hole, corners and edges on points.
            let (x, y, r) = (fa[0], fa[1], fb[0].abs().min(60.0 * q));
            let diamond = |r: f64| vec![[x - r, y], [x, y - r], [x + r, y], [x, y + r]];
            let rings = if r > q { vec![diamond(r), diamond(r / 4.0)] } else { vec![diamond(q)] };
            Region::new_prism(Polygons::new(&[rings]).unwrap(), [low[2], high[2]]).unwrap()
        }
        _ => {
            let (eye, projection) = (DVec3::from_array(fa), Projection::Perspective { fov_y_rad: 1.0 });
            let camera = Camera::new(eye, eye + DVec3::new(0.2, -0.5, 0.3) * q, DVec3::Z, projection, [3, 2]).unwrap();
            let camera = camera.with_depth_range(Some(2.0 * q), Some(70.0 * q)).unwrap();
            let clip = camera.clip_from_view() * camera.view_from_world();
            Region::new_clip_matrix(clip, ClipDepth::ZeroToOne).unwrap()
        }
    }
}

fn region() -> impl Strategy<Value = (Lattice, Region)> {
    let corner = || prop::array::uniform3(prop_oneof![-45_i32..45, Just(i32::MIN), Just(i32::MAX)]);
    let one = || (corner(), corner(), 0_u8..7, prop::sample::select(vec![0.0, 0.5, 0.1]));
    let joined = prop::sample::select(vec![0_u8, 0, 0, 1, 2, 3, 4, 5]);
    (lattice(), one(), one(), one(), joined).prop_map(|(lattice, a, b, c, joined)| {
        let of = |(p, q, kind, part): ([i32; 3], [i32; 3], u8, f64)| shape(&lattice, p, q, kind, part);
        let (a, b, c) = (of(a), of(b), of(c));
        let region = match joined {
            0 => a,
            1 => Region::all([a, b]),
            2 => Region::any([a, b]),
            3 => a.inverted(),
            4 => Region::all([Region::any([a, b]), c.inverted()]),
            _ => Region::any([Region::all([a, b]).inverted(), c]).inverted(),
        };
        (lattice, region)
    })
}

/// The documented test of each shape.
fn naive(region: &Region, lattice: &Lattice, p: LatticePoint) -> bool {
    let w = lattice.world_from_lattice(p);
    let between = |axis: usize, low: f64, high: f64| {
        let d = lattice.decimal_on_axis(axis, p.0[axis]);
        let exact = Decimal::from_f64;
        exact(low).map_or(low < 0.0, |m| m <= d) && exact(high).map_or(high > 0.0, |m| d < m)
    };
    match region {
        Region::Everything => true,
        Region::Box { min, max } => (0..3).all(|i| between(i, min[i], max[i])),
        Region::Sphere { center, radius } => {
            let d: [f64; 3] = std::array::from_fn(|i| w[i] - center[i]);
            (d[0] * d[0] + d[1] * d[1]) + d[2] * d[2] <= radius * radius
        }
        Region::Convex(convex) => convex.contains(w),
        Region::Prism { area, z } => between(2, z[0], z[1]) && polygon::tests::naive(area, lattice, p),
        Region::All(terms) => terms.iter().all(|t| naive(t, lattice, p)),
        Region::Any(terms) => terms.iter().any(|t| naive(t, lattice, p)),
        Region::Not(inner) => !naive(inner, lattice, p),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(600))]

    #[test]
    fn cubes_and_points_agree(
        (lattice, region) in region(), a in near(), b in near(), t in prop::collection::vec(near(), 1..60)
    ) {
        let on = region.on_lattice(&lattice).unwrap();
        let mut points: Vec<LatticePoint> = t;
        points.extend([a, b]);
        // The whole box, and thin ones that are often wholly in or out.
        let flat = LatticePoint([b.0[0], a.0[1], a.0[2]]);
        let boxes = [LatticeBox::of(a).with(b), LatticeBox::of(a).with(flat), LatticeBox::of(b).with(flat), LatticeBox::of(a)];
        points.extend(boxes.iter().flat_map(|b| [b.min, b.max]));
        for bounds in &boxes {
            let within = |p: LatticePoint| LatticePoint(std::array::from_fn(|i| p.0[i].clamp(bounds.min.0[i], bounds.max.0[i])));
            points.extend((0..20).map(|i| within(points[i % points.len()])).collect::<Vec<_>>());
        }
        let everywhere = points.iter().fold(LatticeBox::of(a), |all, p| all.with(*p));
        let mask = on.test(&points.iter().copied().collect(), &everywhere);
        for bounds in &boxes {
            let inside: Vec<LatticePoint> = points.iter().copied().filter(|p| bounds.contains(*p)).collect();
            let mask = on.test(&inside.iter().copied().collect(), bounds);
            prop_assert!(inside.iter().enumerate().all(|(i, &p)| mask.contains(i) == on.contains(p)));
        }
        let placed = boxes.map(|b| on.classify(&b));
        for (i, &p) in points.iter().enumerate() {
            let naive = naive(&region, &lattice, p);
            prop_assert_eq!(on.contains(p), naive);
            prop_assert_eq!(mask.contains(i), naive);
            for (bounds, placed) in boxes.iter().zip(placed) {
                if bounds.contains(p) {
                    match placed {
                        Containment::Inside => prop_assert!(naive),
                        Containment::Outside => prop_assert!(!naive),
                        Containment::Partly => {}
                    }
                }
            }
        }
    }
}

#[test]
fn regions_far_from_the_origin_are_decided_by_the_documented_test() {
    let lattice = Lattice::uniform(1e-4).unwrap();
    let center = [4_321_987.654_3, -1_234_567.890_1, 12.5];
    let middle = lattice.lattice_from_world(center).unwrap();
    let regions = [
        Region::new_sphere(center, 0.001).unwrap(),
        Region::new_oriented_box(center, [0.0018, 0.0016, 0.0017], [30.0, 20.0, 10.0]).unwrap(),
        Region::new_oriented_box(center, [0.0018, 0.0018, 0.0018], [90.0, 0.0, 0.0]).unwrap(),
    ];
    let mut points = Vec::new();
    for step in 0..21_u64.pow(3) {
        let offset = [step % 21, step / 21 % 21, step / 441];
        points.push(LatticePoint(std::array::from_fn(|i| middle.0[i] + offset[i] - 10)));
    }
    for region in regions {
        let on = region.on_lattice(&lattice).unwrap();
        let bounds = points.iter().fold(LatticeBox::of(points[0]), |all, p| all.with(*p));
        let mask = on.test(&points.iter().copied().collect(), &bounds);
        assert!(points.iter().enumerate().all(|(i, &p)| mask.contains(i) == on.contains(p)));
        assert!(points.iter().all(|&p| on.contains(p) == naive(&region, &lattice, p)));
        assert!(mask.count() > 3000 && mask.count() < 6500, "{}", mask.count());
    }
}

#[test]
fn regions_are_read_from_text_and_refused_with_a_reason() {
    let inf = f64::INFINITY;
    let plan = Region::parse_box("-1, -2.5, inf, 4").unwrap();
    assert_eq!(plan, Region::Box { min: [-1.0, -2.5, -inf], max: [inf, 4.0, inf] });
    assert!(Region::parse_box("0,0,0,0,0,0").is_ok());
    for bad in ["", "1,2,3", "1,2,3,4,5", "1,2,x,4", "nan,0,1,1", "3,0,1,1"] {
        assert!(Region::parse_box(bad).is_err(), "{bad}");
    }
    assert_eq!(Region::parse_sphere("1,2,3,4").unwrap(), Region::Sphere { center: [1.0, 2.0, 3.0], radius: 4.0 });
    for bad in ["1,2,3", "1,2,3,-4", "inf,2,3,4", "1,2,3,nan"] {
        assert!(Region::parse_sphere(bad).is_err(), "{bad}");
    }
    assert_eq!(Region::parse_heights("1,2").unwrap(), Region::new_box([-inf, -inf, 1.0], [inf, inf, 2.0]).unwrap());
    for bad in ["1", "2,1", "nan,1", "1,2,3"] {
        assert!(Region::parse_heights(bad).is_err(), "{bad}");
    }
    assert_eq!(
        Region::parse_oriented_box("1,2,3,4,5,6,0").unwrap(),
        Region::parse_oriented_box("1,2,3,4,5,6,0,0,0").unwrap()
    );
    for bad in
        ["1,2,3,4,5,6", "1,2,3,4,5,-6,0", "1,2,3,4,5,6,7,8", "1,2,inf,4,5,6,0", "1,2,3,4,5,6,inf", "1,2,3,nan,5,6,0"]
    {
        assert!(Region::parse_oriented_box(bad).is_err(), "{bad}");
    }
    let rows = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";
    let unit =
        Region::parse_frustum(&format!("{{\"clip_from_world\":{rows},\"depth\":\"minus_one_to_one\"}}")).unwrap();
    let on = unit.on_lattice(&Lattice::uniform(0.5).unwrap()).unwrap();
    let at = |p| on.contains(Lattice::uniform(0.5).unwrap().lattice_from_world(p).unwrap());
    assert!(at([1.0, -1.0, -1.0]) && !at([1.5, 0.0, 0.0]) && !at([0.0, 0.0, 1.5]));
    for bad in ["", "[]", "{}", "{\"clip_from_world\":[1,2]}", "{\"eye\":[0,0,0],\"target\":[0,0,0]}"] {
        assert!(Region::parse_frustum(bad).is_err(), "{bad}");
    }
}

proptest! {
    #[test]
    fn a_closed_box_has_the_points_on_its_faces_and_none_beyond(
        phase in 0_i128..10_000_000_000_000_000, at in -1_000_000_i64..1_000_000, nearest in any::<bool>(),
    ) {
        // Of a phase with 16 digits the float above a face may be above the next point, too: that one was taken with it.
        let lattice = Lattice::new([Decimal::new(1, -3); 3], [Decimal::new(phase, -19); 3]).unwrap();
        let index = (BIAS + at) as u64;
        // A face as a user has it: from a table of exact decimals, or from an array.
        let exact = lattice.decimal_on_axis(0, index);
        let face = if nearest { exact.to_f64() } else { lattice.world_on_axis(0, index) };
        let inf = f64::INFINITY;
        let open = Region::new_box([-inf; 3], [face, inf, inf]).unwrap();
        let last = |region: &Region| region.on_lattice(&lattice).unwrap().as_box().unwrap().max.0;
        let closed = last(&open.closed_on(&lattice));
        prop_assert_eq!(closed, [index, (1 << 48) - 1, (1 << 48) - 1]);
        let is_above = Decimal::from_f64(face).unwrap() > exact;
        prop_assert_eq!(last(&open)[0], if is_above { index } else { index - 1 });
        // Between two points there is nothing to close.
        let between = (face + lattice.world_on_axis(0, index + 1)) / 2.0;
        let open = Region::new_box([-inf; 3], [inf, between, inf]).unwrap();
        prop_assert_eq!(open.closed_on(&lattice), open);
    }
}

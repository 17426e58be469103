//! Whole images: adapter against CPU, and one site against the same site elsewhere.

use super::support::{coverage, difference, orthographic, perspective, random_points, renderer, scene, torus};
use crate::geometry::Camera;
use crate::render::{Background, Edl, RenderOptions, Scene, reference};

const SIZE: [u32; 2] = [320, 200];
/// The bound that the reference renderer's head states.
const DIFFERING: f64 = 0.005;

pub(super) fn options(edl: bool) -> RenderOptions {
    let edl = edl.then_some(Edl::default());
    RenderOptions { background: Background::Plain([0, 0, 0, 255]), edl, ..Default::default() }
}

#[track_caller]
pub(super) fn assert_twins_agree(scene: &Scene, camera: &Camera, options: &RenderOptions) {
    let expected = reference::render(scene, camera, options).unwrap();
    let got = renderer().render(scene, camera, options).unwrap();
    let differing = difference(&got, &expected, 2);
    assert!(differing <= DIFFERING, "{differing} of the pixels differ");
    assert!(coverage(&expected, [0, 0, 0, 255]) > 0.05, "there must be something to compare");
}

#[test]
fn adapter_and_cpu_agree_on_random_points() {
    let nodes: Vec<_> = (0..10).map(|i| (0.02 * f64::from(i), random_points(1000, [0.0; 3], 5.0, i as u64))).collect();
    let random = scene(0.001, &nodes);
    for edl in [false, true] {
        // From outside, from inside, in parallel.
        assert_twins_agree(&random, &perspective([8.0, -9.0, 4.0], [0.0; 3], 60.0, SIZE), &options(edl));
        assert_twins_agree(&random, &perspective([0.3, 0.2, 0.1], [1.0, 2.0, 3.0], 90.0, SIZE), &options(edl));
        assert_twins_agree(&random, &orthographic([8.0, -9.0, 4.0], [0.0; 3], 12.0, SIZE), &options(edl));
        assert_twins_agree(&random, &orthographic([0.0; 3], [1.0, 0.1, 0.3], 7.0, SIZE), &options(edl));
    }
}

#[test]
fn adapter_and_cpu_agree_on_a_surface() {
    let ring = scene(0.0001, &[(0.05, torus(30_000, [0.0; 3], 1))]);
    for edl in [false, true] {
        assert_twins_agree(&ring, &perspective([5.0, -5.0, 4.0], [0.0; 3], 50.0, SIZE), &options(edl));
        assert_twins_agree(&ring, &orthographic([5.0, -5.0, 4.0], [0.0; 3], 9.0, SIZE), &options(edl));
        assert_twins_agree(&ring, &perspective([3.0, -0.8, 1.2], [3.0, 1.0, 0.5], 70.0, SIZE), &options(edl));
    }
}

#[test]
fn adapter_and_cpu_agree_at_extreme_cameras() {
    let ring = scene(0.0001, &[(0.05, torus(20_000, [0.0; 3], 2))]);
    let far = [4e6, -8e6, 5e6];
    assert_twins_agree(&ring, &perspective(far, [0.0; 3], 5e-5, SIZE), &options(true));
    assert_twins_agree(&ring, &orthographic(far, [0.0; 3], 9.0, SIZE), &options(true));
    assert_twins_agree(&ring, &perspective([0.0, -3.0, 0.0], [0.0; 3], 150.0, SIZE), &options(true));
    let sliced = perspective([5.0, -5.0, 4.0], [0.0; 3], 50.0, SIZE).with_depth_range(Some(7.5), Some(9.0)).unwrap();
    assert_twins_agree(&ring, &sliced, &options(true));
}

#[test]
fn adapter_and_cpu_agree_on_nodes_wider_than_32_bits() {
    // 10,000 km of tenths of a millimetre, with a detailed spot in the middle of one node.
    let spot = [1000.0, 2000.0, 3000.0];
    let wide = |depth: f64| {
        let around = |seed| {
            let points = random_points(500, [0.0; 3], 5e6, seed).into_iter();
            points.map(move |([x, y, z], color)| ([x, spot[1] + y * depth, z], color))
        };
        let points = around(3).chain(torus(10_000, spot, 4)).chain(around(5));
        scene(0.0001, &[(0.06, points.collect())])
    };
    let eye = [1005.0, 1995.0, 3004.0];
    assert_twins_agree(&wide(1.0), &perspective(eye, spot, 50.0, SIZE), &options(true));
    // Parallel depth resolves a ten-millionth of the scene's extent along the line of sight, so that is kept small.
    let along_y = [spot[0], 1990.0, spot[2]];
    assert_twins_agree(&wide(1e-6), &orthographic(along_y, spot, 9.0, SIZE), &options(true));
}

#[test]
fn a_site_looks_the_same_wherever_it_is() {
    let quantum = 0.0001;
    // Whole numbers, so that the sites are the same to the step; UTM, ten million metres, Earth-centred.
    for offset in [[500_000.0, 5_400_000.0, 300.0], [1e7, 1e7, 1e7], [-4_198_000.0, 171_000.0, 4_780_000.0]] {
        let moved = |p: [f64; 3]| std::array::from_fn(|i| p[i] + offset[i]);
        let points = torus(30_000, [0.0; 3], 7);
        // Rounded to the lattice first: what is moved is the stored site.
        let here = scene(quantum, &[(0.05, points)]);
        let mut there = here.clone();
        let steps = offset.map(|o: f64| (o / quantum).round() as i64);
        for (axis, steps) in there.nodes.iter_mut().flat_map(|n| {
            [(&mut n.positions.x, steps[0]), (&mut n.positions.y, steps[1]), (&mut n.positions.z, steps[2])]
        }) {
            axis.iter_mut().for_each(|index| *index = index.wrapping_add_signed(steps));
        }
        for (eye, target, fov) in [
            ([5.0, -5.0, 4.0], [0.0; 3], 50.0),
            ([3.0, -0.8, 1.2], [3.0, 1.0, 0.5], 70.0),
            ([3.9, 0.1, 0.25], [3.9, 0.6, 0.2], 80.0),
        ] {
            let near_origin = renderer().render(&here, &perspective(eye, target, fov, SIZE), &options(true)).unwrap();
            let camera = perspective(moved(eye), moved(target), fov, SIZE);
            let far_away = renderer().render(&there, &camera, &options(true)).unwrap();
            let differing = difference(&near_origin, &far_away, 2);
            assert!(differing <= 0.001, "{offset:?} {eye:?}: {differing} of the pixels differ");
            assert!(coverage(&near_origin, [0, 0, 0, 255]) > 0.05);
        }
    }
}

#[test]
fn shading_darkens_only_what_has_something_nearer_beside_it() {
    // A near square before a far one, face on.
    let square = |half: i32, y: f64| {
        let axis = move || (-half * 10..=half * 10).map(|i| f64::from(i) / 10.0);
        axis().flat_map(move |x| axis().map(move |z| ([x, y, z], [200, 200, 200, 255]))).collect()
    };
    let steps = scene(0.001, &[(0.1, square(1, 5.0)), (0.1, square(3, 6.0))]);
    for camera in
        [orthographic([0.0; 3], [0.0, 1.0, 0.0], 8.0, SIZE), perspective([0.0; 3], [0.0, 1.0, 0.0], 70.0, SIZE)]
    {
        let (flat, lit) = (options(false), options(true));
        assert_twins_agree(&steps, &camera, &lit);
        let [flat, lit] = [&flat, &lit].map(|o| renderer().render(&steps, &camera, o).unwrap());
        assert!(flat.rgba.iter().zip(&lit.rgba).all(|(flat, lit)| lit <= flat));
        assert_eq!(lit.pixel(160, 100), [200, 200, 200, 255], "the near square is unlit");
        let darkened = difference(&flat, &lit, 2);
        assert!((0.001..0.05).contains(&darkened), "only the far square's inner edge: {darkened}");
    }
}

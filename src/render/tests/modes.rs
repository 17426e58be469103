//! Every way to draw: adapter against CPU, and what it must look like.

use super::same_image::{assert_twins_agree, options};
use super::support::{coverage, difference, orthographic, perspective, random_points, renderer, scene, torus};
use crate::geometry::{Camera, DVec3, WorldBox};
use crate::render::{Background, ClipBox, Fog, RenderError, RenderOptions, Scene, Shape, reference};

const SIZE: [u32; 2] = [320, 200];
const BLACK: [u8; 4] = [0, 0, 0, 255];

fn site() -> Scene {
    scene(0.0001, &[(0.05, torus(20_000, [0.0; 3], 11)), (0.1, random_points(1500, [0.0; 3], 4.0, 12))])
}

fn cameras() -> [Camera; 3] {
    [
        perspective([5.0, -5.0, 4.0], [0.0; 3], 50.0, SIZE),
        orthographic([5.0, -5.0, 4.0], [0.0; 3], 9.0, SIZE),
        perspective([3.0, -0.8, 1.2], [3.0, 1.0, 0.5], 70.0, SIZE),
    ]
}

#[test]
fn adapter_and_cpu_agree_on_every_shape_with_and_without_shadows() {
    let site = site();
    for camera in cameras() {
        for shape in Shape::ALL {
            for shadow_px in [0.0, 2.5] {
                assert_twins_agree(&site, &camera, &RenderOptions { shape, shadow_px, ..options(true) });
            }
        }
    }
}

#[test]
fn adapter_and_cpu_agree_in_fog_and_clip_boxes_and_on_node_boxes() {
    let mut site = site();
    let lattice = site.lattice.clone();
    let corner = |c: f64| lattice.lattice_from_world([c; 3]).unwrap();
    site.boxes = [(-4.0, 4.0, [255, 200, 0, 255]), (-1.0, 2.0, [0, 200, 255, 255])]
        .map(|(low, high, color)| {
            let bounds = crate::lattice::LatticeBox { min: corner(low), max: corner(high) };
            (bounds, color)
        })
        .into();
    let slanted = [DVec3::new(3.0, 1.5, 0.0), DVec3::new(-1.0, 2.0, 0.0), DVec3::Z * 0.9];
    let keep = ClipBox::new(DVec3::new(1.0, 0.0, 0.0), slanted, true).unwrap();
    let other = ClipBox::new(DVec3::new(-3.0, 0.0, 0.0), [DVec3::X, DVec3::Y * 2.0, DVec3::Z], true).unwrap();
    let cut = ClipBox::from_bounds(&WorldBox::new([2.0, -9.0, -0.2], [4.0, 9.0, 9.0]).unwrap(), false).unwrap();
    for camera in cameras() {
        for fog in
            [Fog { color: None, start: 3.0, half: 2.0 }, Fog { color: Some([200, 210, 220]), start: 0.0, half: 5.0 }]
        {
            let background = Background::Gradient { top: [40, 60, 90, 255], bottom: [10, 0, 0, 255] };
            let foggy = RenderOptions { fog: Some(fog), background, ..options(true) };
            assert_twins_agree(&site, &camera, &foggy);
        }
        assert_twins_agree(&site, &camera, &RenderOptions { node_boxes: true, ..options(true) });
    }
    for camera in &cameras()[..2] {
        for clips in [vec![cut], vec![keep], vec![cut, keep, other]] {
            assert_twins_agree(&site, camera, &RenderOptions { clips, ..options(false) });
        }
    }
}

/// The part of the picture that has this colour.
fn part_of(scene: &Scene, camera: &Camera, options: &RenderOptions, color: [u8; 4]) -> f64 {
    let image = renderer().render(scene, camera, options).unwrap();
    let pixels = image.rgba.chunks_exact(4).filter(|p| **p == color).count();
    pixels as f64 / f64::from(SIZE[0] * SIZE[1])
}

#[test]
fn a_square_is_larger_than_its_circle_by_four_over_pi() {
    let red = [255, 0, 0, 255];
    // Not a whole number of half pixels: the border's own pixels would count twice.
    let one = scene(0.001, &[(1.01, vec![([0.0, 5.0, 0.0], red)])]);
    let camera = orthographic([0.0; 3], [0.0, 1.0, 0.0], 4.0, SIZE);
    let base = RenderOptions { max_radius_of_height: 1.0, ..options(false) };
    let [round, square, bent] =
        Shape::ALL.map(|shape| part_of(&one, &camera, &RenderOptions { shape, ..base.clone() }, red));
    assert!((square / round - 4.0 / std::f64::consts::PI).abs() < 0.02, "{}", square / round);
    assert_eq!(round, bent);
}

#[test]
fn of_two_paraboloids_each_has_its_half() {
    let (red, green) = ([255, 0, 0, 255], [0, 255, 0, 255]);
    // Side by side; one a hair nearer, which as a flat disc hides most of the other.
    let two = scene(0.001, &[(1.0, vec![([-0.2, 5.0, 0.0], red), ([0.2, 5.01, 0.0], green)])]);
    let camera = orthographic([0.0; 3], [0.0, 1.0, 0.0], 4.0, SIZE);
    let parts = |shape| {
        let options = RenderOptions { shape, max_radius_of_height: 1.0, ..options(false) };
        [red, green].map(|color| part_of(&two, &camera, &options, color))
    };
    let ([flat_red, flat_green], [bent_red, bent_green]) = (parts(Shape::Round), parts(Shape::Paraboloid));
    assert!(flat_red > 1.5 * flat_green, "{flat_red} {flat_green}");
    assert!((bent_red / bent_green - 1.0).abs() < 0.1, "{bent_red} {bent_green}");
}

#[test]
fn shadows_outline_what_stands_before_something_else_and_nothing_more() {
    let color = [200, 200, 200, 255];
    let square = |half: i32, y: f64| -> Vec<([f64; 3], [u8; 4])> {
        let axis = move || (-half * 10..=half * 10).map(|i| f64::from(i) / 10.0);
        axis().flat_map(move |x| axis().map(move |z| ([x, y, z], color))).collect()
    };
    let camera = orthographic([0.0; 3], [0.0, 1.0, 0.0], 4.0, SIZE);
    // 50 pixels a unit: the near square is 100 pixels wide, and all of the far one is beyond the image.
    let steps = scene(0.001, &[(0.1, square(1, 5.0)), (0.1, square(5, 7.0))]);
    let options = RenderOptions { shadow_px: 3.0, background: Background::Plain([9, 9, 9, 255]), ..options(false) };
    let outline = part_of(&steps, &camera, &options, BLACK) * f64::from(SIZE[0] * SIZE[1]);
    // Four sides of about 107 pixels, three wide.
    assert!((1000.0..1700.0).contains(&outline), "{outline}");
    let plain = scene(0.001, &[(0.1, square(5, 7.0))]);
    assert_eq!(part_of(&plain, &camera, &options, BLACK), 0.0);
    // The ground, seen at 70 degrees from its normal.
    let (sin, cos) = 70_f64.to_radians().sin_cos();
    let tilted = square(9, 0.0).into_iter().map(|([x, _, z], color)| ([x, 30.0 + z * sin, z * cos], color)).collect();
    assert_eq!(part_of(&scene(0.001, &[(0.1, tilted)]), &camera, &options, BLACK), 0.0);
}

#[test]
fn fog_takes_half_of_a_colour_at_its_half_depth() {
    let white = [255, 255, 255, 255];
    let at = |y: f64| scene(0.001, &[(0.5, vec![([0.0, y, 0.0], white)])]);
    let camera = perspective([0.0; 3], [0.0, 1.0, 0.0], 60.0, [61, 41]);
    let fog = Fog { color: Some([0, 0, 0]), start: 10.0, half: 20.0 };
    let options = RenderOptions { fog: Some(fog), ..options(false) };
    let center = |y: f64| renderer().render(&at(y), &camera, &options).unwrap().pixel(30, 20)[0];
    assert_eq!(center(5.0), 255);
    // Half of the light is 188 of 255 in sRGB.
    assert_eq!(center(30.0), 188);
    assert_eq!(center(50.0), 137);
}

#[test]
fn clip_boxes_keep_and_cut() {
    let color = [10, 200, 30, 255];
    let axis = || (-20..=20).map(|i| f64::from(i) / 10.0);
    let wall = axis().flat_map(|x| axis().map(move |z| ([x, 5.0, z], color))).collect();
    let wall = scene(0.001, &[(0.1, wall)]);
    let camera = orthographic([0.0; 3], [0.0, 1.0, 0.0], 4.0, SIZE);
    let left = ClipBox::from_bounds(&WorldBox::new([-1.05, 0.0, -1.05], [-0.05, 9.0, 1.05]).unwrap(), true).unwrap();
    let right = ClipBox::from_bounds(&WorldBox::new([0.05, 0.0, -1.05], [1.05, 9.0, 1.05]).unwrap(), true).unwrap();
    let hole = ClipBox::from_bounds(&WorldBox::new([-9.0, 0.0, -0.25], [9.0, 9.0, 0.25]).unwrap(), false).unwrap();
    let shown = |clips: Vec<ClipBox>| {
        let options = RenderOptions { clips, ..options(false) };
        reference::points_shown(&wall, &camera, &options)
            .unwrap()
            .into_iter()
            .flatten()
            .collect::<std::collections::BTreeSet<_>>()
            .len()
    };
    assert_eq!(shown(vec![left]), 10 * 21);
    assert_eq!(shown(vec![left, right]), 2 * 10 * 21);
    assert_eq!(shown(vec![hole, left, right]), 2 * 10 * 16);
    let all = renderer().render(&wall, &camera, &options(false)).unwrap();
    let cut = RenderOptions { clips: vec![left, right], ..options(false) };
    let cut = renderer().render(&wall, &camera, &cut).unwrap();
    assert!(coverage(&cut, BLACK) < 0.7 * coverage(&all, BLACK));
    let too_many = RenderOptions { clips: vec![left; 9], ..options(false) };
    assert!(matches!(renderer().render(&wall, &camera, &too_many), Err(RenderError::TooManyClips { count: 9 })));
    assert!(ClipBox::new(DVec3::ZERO, [DVec3::X, DVec3::X, DVec3::Z], true).is_err());
    assert!(ClipBox::new(DVec3::NAN, [DVec3::X, DVec3::Y, DVec3::Z], true).is_err());
}

#[test]
fn a_box_around_the_eye_is_drawn_as_far_as_it_is_seen() {
    let mut empty = scene(0.001, &[]);
    let corner = |c: f64| empty.lattice.lattice_from_world([c; 3]).unwrap();
    let bounds = crate::lattice::LatticeBox { min: corner(-1e4), max: corner(1e4) };
    empty.boxes = vec![(bounds, [255, 255, 255, 255])];
    let boxed = RenderOptions { node_boxes: true, ..options(false) };
    // Towards a corner: three edges meet there.
    let camera = perspective([100.0, 50.0, -70.0], [1e4, 1e4, 1e4], 40.0, SIZE);
    let got = renderer().render(&empty, &camera, &boxed).unwrap();
    let expected = reference::render(&empty, &camera, &boxed).unwrap();
    assert!(difference(&got, &expected, 2) < 0.001);
    let drawn = coverage(&got, BLACK) * f64::from(SIZE[0] * SIZE[1]);
    assert!((300.0..1500.0).contains(&drawn), "{drawn}");
}

//! What can be said of every pixel: exact colours, which point wins, what is not drawn.

use super::support::{coverage, orthographic, perspective, renderer, scene};
use crate::geometry::Camera;
use crate::render::{Background, Edl, Image, RenderError, RenderNode, RenderOptions, Scene, reference};

const BLACK: [u8; 4] = [0, 0, 0, 255];
const COLOR: [u8; 4] = [200, 100, 50, 255];
const SIZE: [u32; 2] = [61, 41];

fn plain() -> RenderOptions {
    RenderOptions { background: Background::Plain(BLACK), edl: None, ..Default::default() }
}

/// The image on the adapter and on the CPU, which must be the same to the last byte.
fn both(scene: &Scene, camera: &Camera, options: &RenderOptions) -> Image {
    let expected = reference::render(scene, camera, options).unwrap();
    assert_eq!(renderer().render(scene, camera, options).unwrap(), expected);
    expected
}

#[test]
fn an_unlit_point_has_exactly_its_colour() {
    let one = scene(0.001, &[(0.2, vec![([0.0, 5.0, 0.0], COLOR)])]);
    let lit = RenderOptions { edl: Some(Edl { strength: 5.0, radius_px: 2.0 }), ..plain() };
    for camera in
        [perspective([0.0; 3], [0.0, 1.0, 0.0], 60.0, SIZE), orthographic([0.0; 3], [0.0, 1.0, 0.0], 2.0, SIZE)]
    {
        for options in [&plain(), &lit] {
            let image = both(&one, &camera, options);
            assert_eq!(image.pixel(30, 20), COLOR);
            assert!(image.rgba.chunks_exact(4).all(|p| p == COLOR || p == BLACK));
            assert!(coverage(&image, BLACK) > 0.001);
        }
    }
}

#[test]
fn every_byte_of_colour_comes_out_as_it_went_in() {
    let points = (0..=255).map(|i| ([f64::from(i) + 0.5, 5.0, 0.5], [i as u8, 255 - i as u8, i as u8 ^ 90, 0]));
    let row = scene(0.5, &[(0.1, points.collect())]);
    let image = both(&row, &orthographic([128.0, 0.0, 0.5], [128.0, 1.0, 0.5], 1.0, [256, 1]), &plain());
    for x in 0..=255 {
        assert_eq!(image.pixel(x, 0), [x as u8, 255 - x as u8, x as u8 ^ 90, 255]);
    }
}

#[test]
fn a_splat_is_a_circle_of_the_radius_asked_for() {
    // 10 pixels per unit: spacing 1.6 times 0.75 is 12 pixels.
    let one = scene(0.001, &[(1.6, vec![([0.0, 5.0, 0.0], COLOR)])]);
    let options = RenderOptions { max_radius_of_height: 1.0, ..plain() };
    let image = both(&one, &orthographic([0.0; 3], [0.0, 1.0, 0.0], 4.1, SIZE), &options);
    let area = coverage(&image, BLACK) * f64::from(SIZE[0] * SIZE[1]);
    assert!((area / (std::f64::consts::PI * 144.0) - 1.0).abs() < 0.03, "{area}");
    let capped = RenderOptions { max_radius_of_height: 0.1, ..plain() };
    let image = both(&one, &orthographic([0.0; 3], [0.0, 1.0, 0.0], 4.1, SIZE), &capped);
    let area = coverage(&image, BLACK) * f64::from(SIZE[0] * SIZE[1]);
    assert!((area / (std::f64::consts::PI * 4.1 * 4.1) - 1.0).abs() < 0.1, "{area}");
}

#[test]
fn no_point_on_the_image_vanishes_however_small() {
    // Every point in a pixel of its own, anywhere within it.
    let points: Vec<_> = (0..40 * 40)
        .map(|i| {
            let within = |n: i32| f64::from(n * 7919 % 97 + 1) / 98.0;
            ([f64::from(i % 40) + within(i), 1000.0, f64::from(i / 40) + within(i + 13)], COLOR)
        })
        .collect();
    let tiny = scene(0.0001, &[(0.0, points)]);
    let image = both(&tiny, &orthographic([20.0, 0.0, 20.0], [20.0, 1.0, 20.0], 40.0, [40, 40]), &plain());
    assert_eq!(coverage(&image, BLACK), 1.0);
}

#[test]
fn the_nearer_point_wins_and_of_equals_the_first_drawn() {
    let (red, green) = ([255, 0, 0, 255], [0, 255, 0, 255]);
    let at = |y: f64, color| (0.5, vec![([0.0, y, 0.0], color)]);
    for camera in
        [perspective([0.0; 3], [0.0, 1.0, 0.0], 60.0, SIZE), orthographic([0.0; 3], [0.0, 1.0, 0.0], 2.0, SIZE)]
    {
        for (nodes, winner) in [
            ([at(5.0, red), at(5.001, green)], red),
            ([at(5.001, red), at(5.0, green)], green),
            ([at(5.0, red), at(5.0, green)], red),
            ([at(5.0, green), at(5.0, red)], green),
        ] {
            assert_eq!(both(&scene(0.001, &nodes), &camera, &plain()).pixel(30, 20), winner);
        }
    }
}

#[test]
fn what_is_behind_the_eye_at_it_or_beside_the_image_is_not_drawn() {
    let points = [
        [0.0, 0.0, 0.0],
        [0.0, -1.0, 0.0],
        [0.0, -1e6, 0.0],
        [1e6, 0.0, 0.0],
        [1e6, 1e-3, 1e6],
        [0.0, 1.0, 1e5],
        [0.0, 1e-4, 0.0],
    ];
    let hidden = scene(0.0001, &[(1.0, points.map(|p| (p, COLOR)).into())]);
    let camera = perspective([0.0; 3], [0.0, 10.0, 0.0], 60.0, SIZE);
    assert_eq!(coverage(&both(&hidden, &camera, &plain()), BLACK), 0.0);
    let camera = orthographic([0.0, 0.1, 0.0], [0.0, 10.0, 0.0], 5.0, SIZE).with_depth_range(Some(0.2), Some(0.5));
    assert_eq!(coverage(&both(&hidden, &camera.unwrap(), &plain()), BLACK), 0.0);
}

#[test]
fn a_scene_without_points_is_background() {
    let empty = scene(0.001, &[(1.0, vec![])]);
    let camera = perspective([0.0; 3], [0.0, 1.0, 0.0], 60.0, [3, 101]);
    assert_eq!(coverage(&both(&empty, &camera, &plain()), BLACK), 0.0);
    let clear = RenderOptions { background: Background::Plain([0; 4]), ..plain() };
    assert!(both(&empty, &camera, &clear).rgba.iter().all(|&byte| byte == 0));
    let (top, bottom) = ([0, 50, 200, 255], [100, 50, 0, 255]);
    let gradient = RenderOptions { background: Background::Gradient { top, bottom }, ..plain() };
    let image = renderer().render(&empty, &camera, &gradient).unwrap();
    assert_eq!((image.pixel(0, 50), image.pixel(2, 50)), ([50, 50, 100, 255], [50, 50, 100, 255]));
    assert!(image.pixel(0, 0)[2] > 195 && image.pixel(0, 100)[2] < 5);
}

#[test]
fn what_cannot_be_drawn_is_refused_with_numbers() {
    let empty = scene(0.001, &[]);
    let limit = renderer().max_size_px();
    let large = perspective([0.0; 3], [0.0, 1.0, 0.0], 60.0, [4, 4]).with_size([limit + 1, 4]);
    // The camera has a limit of its own, which may be the lower one.
    if let Ok(large) = large {
        let refused = renderer().render(&empty, &large, &plain()).unwrap_err();
        assert!(matches!(refused, RenderError::Size { limit: l, .. } if l == limit));
        assert!(refused.to_string().contains(&limit.to_string()), "{refused}");
    }
    let camera = perspective([0.0; 3], [0.0, 1.0, 0.0], 60.0, SIZE);
    let nan = RenderOptions { radius_factor: f64::NAN, ..plain() };
    assert!(matches!(renderer().render(&empty, &camera, &nan), Err(RenderError::Number { .. })));
    let mut uneven = scene(0.001, &[(1.0, vec![([0.0; 3], COLOR)])]);
    uneven.nodes[0].colors.clear();
    assert!(matches!(renderer().render(&uneven, &camera, &plain()), Err(RenderError::ColorCount { .. })));
    uneven.nodes[0] = RenderNode { spacing: f64::INFINITY, ..Default::default() };
    assert!(matches!(reference::render(&uneven, &camera, &plain()), Err(RenderError::Number { .. })));
}

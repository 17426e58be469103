//! Draw lists from a pool: the same images as scenes, whatever lies where; and who is under a pixel.

use super::same_image::options;
use super::support::{coverage, difference, orthographic, perspective, renderer, torus};
use crate::geometry::Camera;
use crate::lattice::{Cube, Lattice, LatticePoint};
use crate::render::scene::SelectedPoints;
use crate::render::{
    Canvas, GpuPool, Image, NO_VALUE, Palette, Picked, PoolPoints, RenderOptions, Scene, View, reference,
};
use crate::stream::gpu::{BlockId, DrawBlock, DrawList, DrawNode, PackedPoint, PointPool, PoolError};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

const SIZE: [u32; 2] = [320, 200];
const BLACK: [u8; 4] = [0, 0, 0, 255];
const BLOCK_POINTS: u32 = 64;

/// A node with its points and their values.
type Content = (Cube, f64, Vec<LatticePoint>, Vec<u32>);

/// Points in a root, its children and theirs: the first fall to the root, the rest lower and lower.
fn nodes(lattice: &Lattice, center: [f64; 3], points: usize, spacing: f64) -> Vec<Content> {
    let mut order = Vec::new();
    let mut nodes: BTreeMap<_, Content> = BTreeMap::new();
    let located: Vec<_> = torus(points, center, 5)
        .into_iter()
        .map(|(p, color)| (lattice.lattice_from_world(p).unwrap(), u32::from_le_bytes(color)))
        .collect();
    let root = located.iter().map(|(p, _)| Cube::containing(*p, 0)).reduce(|a, b| Cube::spanning(a.low(), b.high(), 0));
    let root = located.iter().fold(root.unwrap(), |cube, (p, _)| Cube::spanning(cube.low(), *p, cube.k()));
    for (i, (point, value)) in located.into_iter().enumerate() {
        let depth = if i < 600 { 0 } else { 1 + u8::from(i % 3 > 0) + u8::from(i % 5 > 2 && point.0[0] % 2 == 0) };
        // A quarter of the site is left coarse.
        let coarse = root.octant_of(point) % 4 == 0;
        let depth = if coarse { depth.min(1) } else { depth };
        let cube = Cube::containing(point, root.k() - depth);
        let spacing = spacing / 2_f64.powi(depth.into());
        let node = nodes.entry(cube.node_key()).or_insert_with(|| {
            order.push(cube);
            (cube, spacing, Vec::new(), Vec::new())
        });
        node.2.push(point);
        node.3.push(value);
    }
    nodes.into_values().collect()
}

/// The pool with the nodes in it, blocks in an order by `seed`, and the list that draws them.
fn pooled(lattice: &Lattice, nodes: &[Content], seed: u64) -> (GpuPool, DrawList) {
    let needed: u32 = nodes.iter().map(|n| (n.2.len() as u32).div_ceil(BLOCK_POINTS)).sum();
    let mut free: Vec<u32> = (0..needed + 10).collect();
    if seed > 0 {
        free.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
    }
    // Slabs of a few blocks, so that a picture needs many.
    let mut pool = renderer().pool_of_slabs(needed + 10, BLOCK_POINTS, 7 * 16 * u64::from(BLOCK_POINTS)).unwrap();
    let mut list = DrawList::empty(lattice.clone(), 0);
    let mut free = free.into_iter();
    for (cube, spacing, points, values) in nodes {
        let node = list.nodes.len() as u32;
        let parent = list.nodes.iter().position(|n| n.cube == cube.parent() && n.cube != *cube).map(|p| p as u32);
        list.nodes.push(DrawNode { cube: *cube, layer: 0, spacing: *spacing, stand_in: false, parent });
        let packed: Vec<PackedPoint> =
            points.iter().zip(values).map(|(p, value)| PackedPoint::pack(*cube, *p, *value)).collect();
        for (chunk, i) in packed.chunks(BLOCK_POINTS as usize).zip(0..) {
            let block = BlockId(free.next().unwrap());
            pool.write(block, chunk).unwrap();
            let (points, first) = (chunk.len() as u32, i * BLOCK_POINTS);
            list.blocks.push(DrawBlock { block, points, node, part: 0, first });
            list.points += u64::from(points);
        }
    }
    (pool, list)
}

fn scene_of(lattice: &Lattice, nodes: &[Content], palette: &Palette) -> Scene {
    let top = nodes.iter().map(|n| n.0.k()).max().unwrap();
    let selected = nodes.iter().map(|(cube, spacing, points, values)| {
        let level = u32::from(top - cube.k());
        let colors = values.iter().map(|&value| palette.color(value, level)).collect();
        SelectedPoints { cube: *cube, spacing: *spacing, positions: points.iter().copied().collect(), colors }
    });
    Scene::from_selection(lattice.clone(), selected.collect()).unwrap()
}

fn draw(canvas: &mut Canvas, points: &PoolPoints, list: &DrawList, view: View<'_>) -> Image {
    renderer().render_list(canvas, points, list, view).unwrap()
}

fn cameras() -> [Camera; 3] {
    [
        perspective([5.0, -5.0, 4.0], [0.0; 3], 50.0, SIZE),
        orthographic([5.0, -5.0, 4.0], [0.0; 3], 9.0, SIZE),
        perspective([3.0, -0.8, 1.2], [3.0, 1.0, 0.5], 70.0, SIZE),
    ]
}

#[test]
fn a_list_gives_the_image_of_its_scene_wherever_its_blocks_lie() {
    let lattice = Lattice::uniform(0.0001).unwrap();
    let nodes = nodes(&lattice, [0.0; 3], 20_000, 0.4);
    assert!(nodes.len() > 50);
    let palette = Palette::colors();
    let scene = scene_of(&lattice, &nodes, &palette);
    let mut canvas = renderer().canvas(false);
    for camera in &cameras() {
        for options in [options(true), RenderOptions { shadow_px: 2.0, node_boxes: true, ..options(true) }] {
            let view = View { camera, options: &options, palette: &palette };
            let expected = reference::render(&scene, camera, &options).unwrap();
            assert!(coverage(&expected, BLACK) > 0.05);
            let mut images = (0..3).map(|seed| {
                let (pool, list) = pooled(&lattice, &nodes, seed);
                draw(&mut canvas, &pool.points(), &list, view)
            });
            let first = images.next().unwrap();
            let differing = difference(&first, &expected, 2);
            assert!(differing <= 0.005, "{differing} of the pixels differ");
            assert!(images.all(|image| image == first), "residency changes the image");
        }
    }
}

#[test]
fn every_palette_gives_the_colours_of_its_twin() {
    let lattice = Lattice::uniform(0.0001).unwrap();
    let mut nodes = nodes(&lattice, [0.0; 3], 8_000, 0.4);
    let camera = &cameras()[0];
    let table: Vec<[u8; 4]> = (0..=255_u8).map(|i| [i, 255 - i, i.wrapping_mul(7), 255]).collect();
    // Of alpha 0 nothing is drawn.
    let holed =
        table.iter().zip(0..).map(|(c, i)| if (3..=10).contains(&i) { [c[0], c[1], c[2], 0] } else { *c }).collect();
    let float = |f: fn(usize) -> f32| move |i: usize| f(i).to_bits();
    let with_holes = |i: usize| if i.is_multiple_of(50) { NO_VALUE } else { (i % 300) as u32 };
    type Values = Box<dyn Fn(usize) -> u32>;
    let cases: [(Palette, Values); 6] = [
        (Palette::colors(), Box::new(|i| (i as u32).wrapping_mul(2_654_435_761))),
        (Palette::numbers(table.clone()), Box::new(with_holes)),
        (Palette::numbers(holed), Box::new(|i| i as u32 % 12)),
        (Palette::levels(table[100..104].to_vec()), Box::new(|i| i as u32)),
        (Palette::ramp(table.clone(), [-20.0, 1200.5]), Box::new(float(|i| (i % 1300) as f32 - 50.0))),
        (Palette::ramp(table, [3.0, 3.0]), Box::new(float(|i| i as f32))),
    ];
    let mut canvas = renderer().canvas(true);
    for (palette, value) in cases {
        for (number, value_of) in nodes.iter_mut().flat_map(|n| &mut n.3).enumerate() {
            *value_of = value(number);
        }
        let mut shown = nodes.clone();
        for (cube, _, points, values) in &mut shown {
            // The scene has no points that are not drawn.
            let top = nodes.iter().map(|n| n.0.k()).max().unwrap();
            let is_shown = |v: &u32| palette.color(*v, u32::from(top - cube.k()))[3] > 0;
            *points = points.iter().zip(values.iter()).filter(|(_, v)| is_shown(v)).map(|(p, _)| *p).collect();
            values.retain(is_shown);
        }
        let expected = reference::render(&scene_of(&lattice, &shown, &palette), camera, &options(false)).unwrap();
        let (pool, list) = pooled(&lattice, &nodes, 1);
        let view = View { camera, options: &options(false), palette: &palette };
        let differing = difference(&draw(&mut canvas, &pool.points(), &list, view), &expected, 3);
        assert!(differing <= 0.005, "{palette:?}: {differing} of the pixels differ");
    }
}

#[test]
fn the_point_under_a_pixel_is_the_one_that_the_picture_shows() {
    let lattice = Lattice::uniform(0.0001).unwrap();
    let nodes = nodes(&lattice, [0.0; 3], 6_000, 0.4);
    let palette = Palette::colors();
    let scene = scene_of(&lattice, &nodes, &palette);
    // Scene and list have their points in the same order.
    let mut all = nodes.iter().flat_map(|(cube, _, points, _)| (0..points.len() as u32).map(move |i| (*cube, i)));
    let all: Vec<_> = all.by_ref().collect();
    for camera in &cameras() {
        for shape in crate::render::Shape::ALL {
            let options = RenderOptions { shape, ..options(false) };
            let expected = reference::points_shown(&scene, camera, &options).unwrap();
            let (pool, list) = pooled(&lattice, &nodes, 2);
            let mut canvas = renderer().canvas(true);
            draw(&mut canvas, &pool.points(), &list, View { camera, options: &options, palette: &palette });
            let (mut asked, mut same) = (0, 0);
            for y in (0..SIZE[1]).step_by(9) {
                for x in (0..SIZE[0]).step_by(7) {
                    let picked = renderer().pick(&canvas, [x, y], 0).unwrap();
                    let expected = expected[(y * SIZE[0] + x) as usize].map(|i| all[i]);
                    asked += 1;
                    same += u32::from(picked.map(|p| (p.cube, p.index)) == expected);
                    assert!(picked.is_none_or(|p| p.pixel == [x, y] && p.part == 0));
                }
            }
            assert!(f64::from(same) >= 0.99 * f64::from(asked), "{same} of {asked}");
        }
    }
}

#[test]
fn a_pick_finds_the_nearest_point_in_reach() {
    let lattice = Lattice::uniform(0.001).unwrap();
    let point = lattice.lattice_from_world([0.0, 5.0, 0.0]).unwrap();
    let cube = Cube::containing(point, 20);
    let (pool, list) = pooled(&lattice, &[(cube, 0.0, vec![point], vec![0xff])], 0);
    let camera = perspective([0.0; 3], [0.0, 1.0, 0.0], 60.0, [61, 41]);
    let view = View { camera: &camera, options: &options(false), palette: &Palette::colors() };
    let mut canvas = renderer().canvas(true);
    assert_eq!(renderer().pick(&canvas, [0, 0], 5).unwrap(), None, "nothing was drawn yet");
    draw(&mut canvas, &pool.points(), &list, view);
    let pick = |pixel, reach| renderer().pick(&canvas, pixel, reach).unwrap();
    let picked = Some(Picked { cube, layer: 0, part: 0, index: 0, pixel: [30, 20] });
    assert_eq!(
        [pick([30, 20], 0), pick([33, 16], 4), pick([40, 20], 31), pick([0, 20], 99)],
        [picked, picked, picked, picked]
    );
    assert_eq!([pick([33, 16], 3), pick([30, 19], 0), pick([61, 0], 31), pick([0, 0], 29)], [None; 4]);
    let mut blind = renderer().canvas(false);
    draw(&mut blind, &pool.points(), &list, view);
    assert_eq!(renderer().pick(&blind, [30, 20], 0).unwrap(), None);
}

#[test]
fn stand_ins_are_twice_as_wide() {
    let lattice = Lattice::uniform(0.001).unwrap();
    let point = lattice.lattice_from_world([0.0, 5.0, 0.0]).unwrap();
    let (pool, mut list) = pooled(&lattice, &[(Cube::containing(point, 20), 0.5, vec![point], vec![0xff])], 0);
    let camera = orthographic([0.0; 3], [0.0, 1.0, 0.0], 4.0, SIZE);
    let options = RenderOptions { max_radius_of_height: 1.0, ..options(false) };
    let view = View { camera: &camera, options: &options, palette: &Palette::colors() };
    let mut canvas = renderer().canvas(false);
    let alone = coverage(&draw(&mut canvas, &pool.points(), &list, view), BLACK);
    list.nodes[0].stand_in = true;
    let stand_in = coverage(&draw(&mut canvas, &pool.points(), &list, view), BLACK);
    assert!((stand_in / alone - 4.0).abs() < 0.2, "{}", stand_in / alone);
}

#[test]
fn a_pool_keeps_its_points_when_it_is_resized() {
    let lattice = Lattice::uniform(0.0001).unwrap();
    let nodes = nodes(&lattice, [0.0; 3], 5_000, 0.4);
    let (mut pool, list) = pooled(&lattice, &nodes, 0);
    let camera = &cameras()[0];
    let view = View { camera, options: &options(true), palette: &Palette::colors() };
    let mut canvas = renderer().canvas(false);
    let before = draw(&mut canvas, &pool.points(), &list, view);
    let blocks = pool.blocks();
    for other in [blocks + 3, blocks + 40, blocks - 10, blocks] {
        pool.resize(other).unwrap();
        assert_eq!((pool.blocks(), pool.budget_bytes()), (other, u64::from(other) * u64::from(BLOCK_POINTS) * 16));
        assert!(draw(&mut canvas, &pool.points(), &list, view) == before, "{blocks} to {other}");
    }
    let point = PackedPoint { steps: [0; 3], value: 0 };
    assert!(matches!(pool.write(BlockId(blocks), &[point]), Err(PoolError::NoRoom { .. })));
    assert!(matches!(pool.write(BlockId(0), &vec![point; BLOCK_POINTS as usize + 1]), Err(PoolError::NoRoom { .. })));
    pool.resize(0).unwrap();
    assert!(coverage(&draw(&mut canvas, &pool.points(), &list, view), BLACK) == 0.0, "its blocks are gone");
}

/// A root node 134 km wide (2^27 steps of a millimetre): points next to the eye are drawn where they are, to less than
/// 0.01 mm. A hundredth of a millimetre at 20 mm is half a milliradian, 3 pixels here.
#[test]
fn points_of_a_wide_node_next_to_the_eye_are_in_place() {
    for (quantum, k, base) in [(0.001, 27, [400_000.0, 5_600_000.0, 100.0]), (0.0001, 31, [-71_234.5, 42_000.25, 3.0])]
    {
        let lattice = Lattice::uniform(quantum).unwrap();
        let anchor = lattice.lattice_from_world(base).unwrap();
        let cube = Cube::containing(anchor, k);
        assert!(cube.side() as f64 * quantum > 134_000.0);
        let world = lattice.world_from_lattice(anchor);
        let size = [2000, 1200];
        let camera = perspective(world, [world[0], world[1] + 1.0, world[2]], 10.0, size);
        let camera = camera.with_depth_range(Some(0.001), None).unwrap();
        let px_per_radian = 1200.0 / (2.0 * 5_f64.to_radians().tan());
        let mut canvas = renderer().canvas(true);
        for (dx, dy, dz) in [(0, 20, 0), (1, 20, -1), (0, 50, 3), (2, 30, 1), (100, 2000, -33)] {
            let at = [
                anchor.0[0].wrapping_add_signed(dx),
                anchor.0[1].wrapping_add_signed(dy),
                anchor.0[2].wrapping_add_signed(dz),
            ];
            let (pool, list) = pooled(&lattice, &[(cube, 0.0, vec![LatticePoint(at)], vec![0xff])], 0);
            let view = View { camera: &camera, options: &options(false), palette: &Palette::colors() };
            draw(&mut canvas, &pool.points(), &list, view);
            // The middle of the pixel is within half a pixel of the place.
            let expected =
                [1000.0 + px_per_radian * dx as f64 / dy as f64, 600.0 - px_per_radian * dz as f64 / dy as f64];
            let near = expected.map(|c| c as u32);
            let picked = renderer().pick(&canvas, near, 31).unwrap().expect("the point is on the image");
            let depth = dy as f64 * quantum;
            let error_px = (0..2).map(|i| (f64::from(picked.pixel[i]) + 0.5 - expected[i]).abs()).fold(0.0, f64::max);
            let allowed_px = 0.5 + 1e-5 / depth * px_per_radian;
            assert!(error_px <= allowed_px.min(1.5), "{error_px} pixels off at {depth} m");
        }
    }
}

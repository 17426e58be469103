//! Scenes, cameras, and images compared.

use crate::geometry::{Camera, DVec3, Projection};
use crate::lattice::Lattice;
use crate::render::{Image, RenderNode, Renderer, Scene};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::OnceLock;

/// One device for all tests of the process.
pub fn renderer() -> &'static Renderer {
    static RENDERER: OnceLock<Renderer> = OnceLock::new();
    RENDERER.get_or_init(|| Renderer::new().expect("these tests need a graphics adapter"))
}

pub fn perspective(eye: [f64; 3], target: [f64; 3], fov_y_deg: f64, size_px: [u32; 2]) -> Camera {
    let projection = Projection::Perspective { fov_y_rad: fov_y_deg.to_radians() };
    Camera::new(DVec3::from(eye), DVec3::from(target), DVec3::Z, projection, size_px).unwrap()
}

pub fn orthographic(eye: [f64; 3], target: [f64; 3], height: f64, size_px: [u32; 2]) -> Camera {
    let projection = Projection::Orthographic { height };
    Camera::new(DVec3::from(eye), DVec3::from(target), DVec3::Z, projection, size_px).unwrap()
}

/// World positions with their colours.
pub type Points = Vec<([f64; 3], [u8; 4])>;

/// The scene of world points, one node of this spacing for each slice.
pub fn scene(quantum: f64, nodes: &[(f64, Points)]) -> Scene {
    let lattice = Lattice::uniform(quantum).unwrap();
    let nodes = nodes
        .iter()
        .map(|(spacing, points)| RenderNode {
            spacing: *spacing,
            positions: points.iter().map(|(p, _)| lattice.lattice_from_world(*p).unwrap()).collect(),
            colors: points.iter().map(|(_, color)| *color).collect(),
        })
        .collect();
    Scene { lattice, nodes, boxes: Vec::new() }
}

/// Random points of random colours in a box around `center`, in nodes of 1000 points.
pub fn random_points(points: usize, center: [f64; 3], half: f64, seed: u64) -> Points {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..points)
        .map(|_| {
            let at = center.map(|c| c + rng.random_range(-half..half));
            (at, [rng.random(), rng.random(), rng.random(), 255])
        })
        .collect()
}

/// A torus around `center`, lying, with its colours by direction: 3 m of ring radius, 1 m of tube.
pub fn torus(points: usize, center: [f64; 3], seed: u64) -> Points {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut torus = Vec::with_capacity(points);
    while torus.len() < points {
        let (u, v): (f64, f64) = (rng.random_range(0.0..1.0), rng.random_range(0.0..1.0));
        let (u, v) = (u * std::f64::consts::TAU, v * std::f64::consts::TAU);
        // As many points per area everywhere.
        if rng.random_range(0.0..4.0) > 3.0 + v.cos() {
            continue;
        }
        let ring = 3.0 + v.cos();
        let at = [center[0] + ring * u.cos(), center[1] + ring * u.sin(), center[2] + v.sin()];
        let level = |x: f64| (150.0 + 80.0 * x) as u8;
        torus.push((at, [level(u.cos()), level(v.cos()), level(u.sin()), 255]));
    }
    torus
}

/// The part of pixels that differ by more than `tolerance` in any channel.
pub fn difference(a: &Image, b: &Image, tolerance: u8) -> f64 {
    assert_eq!((a.width, a.height, a.rgba.len()), (b.width, b.height, b.rgba.len()));
    let pixels = a.rgba.chunks_exact(4).zip(b.rgba.chunks_exact(4));
    let differ = pixels.filter(|(a, b)| (0..4).any(|i| a[i].abs_diff(b[i]) > tolerance)).count();
    differ as f64 / (a.rgba.len() / 4) as f64
}

/// The part of pixels that are not background.
pub fn coverage(image: &Image, background: [u8; 4]) -> f64 {
    let covered = image.rgba.chunks_exact(4).filter(|p| **p != background).count();
    covered as f64 / (image.rgba.len() / 4) as f64
}

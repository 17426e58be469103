//! Simple surfaces: a torus and concentric spheres, uniformly covered.

use super::Model;
use super::points::{Points, Sample, shaded};
use super::random::Random;

/// Radii of the torus, in metres.
const TORUS: (f64, f64) = (100.0, 40.0);
/// Radii of the spheres.
const SPHERES: [f64; 5] = [20.0, 40.0, 60.0, 80.0, 100.0];

/// Points on a torus.
pub(super) struct Torus {
    pub seed: u64,
}

/// Points on concentric spheres, equally dense on all.
pub(super) struct Spheres {
    pub seed: u64,
}

impl Model for Torus {
    fn block(&self, block: u64, first: u64, points: usize) -> Points {
        let mut random = Random::new(self.seed, block);
        let mut out = Points::with_capacity(points);
        let (ring, tube) = TORUS;
        while out.len() < points {
            let [cos, sin] = random.circle();
            let [across, up] = random.circle();
            // The outside has more surface than the inside.
            let radius = ring + tube * across;
            if !random.chance(radius / (ring + tube)) {
                continue;
            }
            let at = [radius * cos, radius * sin, tube * up];
            let color = [128.0 + 127.0 * cos, 128.0 + 127.0 * sin, 128.0 + 127.0 * up];
            out.push(&sample(at, color, first + out.len() as u64, &mut random));
        }
        out
    }
}

impl Model for Spheres {
    fn block(&self, block: u64, first: u64, points: usize) -> Points {
        let mut random = Random::new(self.seed, block);
        let mut out = Points::with_capacity(points);
        let surface: f64 = SPHERES.iter().map(|r| r * r).sum();
        while out.len() < points {
            let mut at = random.within(0.0, surface);
            let which = SPHERES.iter().position(|r| {
                at -= r * r;
                at < 0.0
            });
            let which = which.unwrap_or(SPHERES.len() - 1);
            let direction = random.sphere();
            let hue = which as f64 / (SPHERES.len() - 1) as f64;
            let light = 0.75 + 0.25 * direction[2];
            let color = [255.0 * hue * light, 160.0 * light, 255.0 * (1.0 - hue) * light];
            let at = direction.map(|d| d * SPHERES[which]);
            out.push(&sample(at, color, first + out.len() as u64, &mut random));
        }
        out
    }
}

fn sample(at: [f64; 3], color: [f64; 3], number: u64, random: &mut Random) -> Sample {
    Sample {
        at,
        color: shaded(color, 1.0),
        intensity: (20_000.0 + 4000.0 * random.normal()) as u16,
        returns: (1, 1),
        class: 1,
        angle: 0,
        forward: true,
        edge: false,
        time: super::START_TIME + number as f64 * 1e-6,
        source: 1,
    }
}

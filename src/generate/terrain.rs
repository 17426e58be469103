//! An airborne survey of a landscape: parallel flight lines, a mirror that swings across, up to three returns.

use super::Model;
use super::points::{Points, Sample, shaded};
use super::random::Random;
use super::scene::{LEAVES, Memory, Scene, ground_color};

/// Points per square metre.
const DENSITY: f64 = 16.0;
/// Metres between flight lines.
const SWATH: f64 = 100.0;
/// Largest scan angle, in degrees.
const LARGEST_ANGLE: f64 = 20.0;

/// The survey of a square that holds the points at about [`DENSITY`].
pub(super) struct Terrain {
    seed: u64,
    scene: Scene,
    points: u64,
    side: f64,
    lines: f64,
    /// Swings of the mirror, there or back, along a flight line.
    swings: f64,
}

impl Terrain {
    pub fn new(seed: u64, points: u64) -> Self {
        let side = (points as f64 / DENSITY).sqrt().max(50.0);
        let lines = (side / SWATH).ceil();
        // As far between swings as between the pulses of one.
        let spacing = side / (points as f64).sqrt();
        let swings = (side / spacing).ceil().max(1.0);
        Self { seed, scene: Scene::new(seed), points, side, lines, swings }
    }

    /// The pulse that is sent when `done` of all points are there.
    fn pulse(&self, done: f64, random: &mut Random) -> Pulse {
        let along_all = done * self.lines;
        let line = along_all.floor().min(self.lines - 1.0);
        let along = along_all - line;
        let swing = along * self.swings;
        let phase = swing - swing.floor();
        let forward = (swing.floor() as i64) % 2 == 0;
        let across = if forward { phase } else { 1.0 - phase };
        let width = self.side / self.lines;
        let jitter = 0.3 * self.side / (self.points as f64).sqrt();
        // Every other line is flown back.
        let along = if (line as i64) % 2 == 0 { along } else { 1.0 - along };
        Pulse {
            x: along * self.side - self.side / 2.0 + jitter * random.normal(),
            y: (line + across) * width - self.side / 2.0 + jitter * random.normal(),
            angle: ((2.0 * across - 1.0) * LARGEST_ANGLE / 0.006).round() as i16,
            forward,
            edge: phase < 0.01,
            source: line as u16 + 1,
        }
    }
}

struct Pulse {
    x: f64,
    y: f64,
    angle: i16,
    forward: bool,
    edge: bool,
    source: u16,
}

/// What one return hits.
#[derive(Clone, Copy)]
struct Hit {
    z: f64,
    class: u8,
    color: [f64; 3],
    reflectivity: f64,
}

impl Model for Terrain {
    fn block(&self, block: u64, first: u64, points: usize) -> Points {
        let mut random = Random::new(self.seed, block);
        let mut memory = Memory::of(self.scene);
        let mut out = Points::with_capacity(points);
        let mut hits = Vec::with_capacity(3);
        while out.len() < points {
            let number = first + out.len() as u64;
            let pulse = self.pulse(number as f64 / self.points as f64, &mut random);
            hits.clear();
            let (x, y) = (pulse.x, pulse.y);
            if let Some(roof) = memory.building(x, y) {
                hits.push(Hit { z: roof.top, class: 6, color: roof.color, reflectivity: 0.5 });
            } else {
                if let Some(tree) = memory.tree(x, y)
                    && let Some((low, high)) = tree.crown(x, y)
                {
                    let leaf = |z| Hit { z, class: 5, color: LEAVES.map(|c| c * tree.shade), reflectivity: 0.35 };
                    hits.push(leaf(high - 0.3 * random.unit()));
                    if random.chance(0.4) {
                        hits.push(leaf(random.within(low, high - 0.3)));
                    }
                }
                if hits.is_empty() || random.chance(0.6) {
                    let z = self.scene.ground(x, y);
                    hits.push(Hit { z, class: 2, color: ground_color(z), reflectivity: 0.4 });
                }
            }
            // The last pulse of a block may have more returns than there is room for.
            hits.truncate(points - out.len());
            let of = hits.len() as u8;
            for (i, hit) in hits.iter().enumerate() {
                let strength = hit.reflectivity * (1.0 + 0.1 * random.normal()) / f64::from(of);
                out.push(&Sample {
                    at: [x, y, hit.z + 0.01 * random.normal()],
                    color: shaded(hit.color, 1.0 + 0.06 * random.normal()),
                    intensity: (strength * 65_535.0) as u16,
                    returns: (i as u8 + 1, of),
                    class: hit.class,
                    angle: pulse.angle,
                    forward: pulse.forward,
                    edge: pulse.edge,
                    time: super::START_TIME + number as f64 * 2e-6,
                    source: pulse.source,
                });
            }
        }
        out
    }
}

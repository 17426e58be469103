//! Terrestrial scans of one scene: a scanner on its tripod turns once around, and every column of rays is traced
//! through the vertical plane that it lies in.
//!
//! A column needs the scene's profile along one direction only: ground, roofs and crowns at growing distances. Its rays,
//! from the steepest down to the steepest up, meet the ground and the walls at distances that never decrease, so a whole
//! column costs one walk along the profile. Density falls with the square of the distance, and what is behind a wall
//! is not seen.

use super::Model;
use super::points::{Points, Sample, shaded};
use super::random::{Random, sin_cos};
use super::scene::{Building, LEAVES, Memory, Scene, ground_color};

/// Farthest points, in metres.
const RANGE: f64 = 120.0;
/// Elevation of the first and last ray of a column, in degrees.
const ELEVATION: (f64, f64) = (-60.0, 45.0);
/// Height of the scanner over the ground.
const TRIPOD: f64 = 1.8;
/// Side of the raster of ground heights.
const RASTER: f64 = 0.5;

/// One scan.
pub(super) struct Scan {
    seed: u64,
    scene: Scene,
    ground: Raster,
    station: [f64; 3],
    number: u16,
    points: u64,
}

/// Heights of the ground around a station.
struct Raster {
    low: [f64; 2],
    side: usize,
    heights: Vec<f64>,
}

impl Raster {
    fn around(scene: &Scene, x: f64, y: f64) -> Self {
        let reach = RANGE + 2.0 * RASTER;
        let side = (2.0 * reach / RASTER).ceil() as usize + 2;
        let low = [x - reach, y - reach];
        let height = |i: usize| scene.ground(low[0] + (i % side) as f64 * RASTER, low[1] + (i / side) as f64 * RASTER);
        Self { low, side, heights: (0..side * side).map(height).collect() }
    }

    fn at(&self, x: f64, y: f64) -> f64 {
        let (u, v) = ((x - self.low[0]) / RASTER, (y - self.low[1]) / RASTER);
        let last = (self.side - 2) as f64;
        let (i, j) = (u.floor().clamp(0.0, last), v.floor().clamp(0.0, last));
        let (u, v) = (u - i, v - j);
        let at = j as usize * self.side + i as usize;
        let row = |at: usize| self.heights[at] * (1.0 - u) + self.heights[at + 1] * u;
        row(at) * (1.0 - v) + row(at + self.side) * v
    }
}

/// The scene along one direction, at one distance.
#[derive(Clone, Copy)]
struct Step {
    distance: f64,
    /// Height of what no ray passes: ground or roof.
    solid: f64,
    building: Option<Building>,
    /// Where the ray enters the building, if it does between the step before and this one.
    wall: Option<f64>,
    /// Low and high end of leaves, and how much of a ray they take; brightness.
    crown: Option<(f64, f64, f64, f64)>,
}

impl Scan {
    /// Scan `number` (from 0) of `scans`, with `points` points.
    pub fn new(seed: u64, number: u32, scans: u32, points: u64) -> Self {
        let scene = Scene::new(seed);
        let mut memory = Memory::of(scene);
        // Streams of blocks are numbers below 2^48; this one is of nobody else.
        let mut random = Random::new(seed, u64::MAX - u64::from(number));
        let reach = 25.0 * f64::from(scans).sqrt();
        let (mut x, mut y);
        loop {
            (x, y) = (random.within(-reach, reach), random.within(-reach, reach));
            let near = [(0.0, 0.0), (3.0, 0.0), (-3.0, 0.0), (0.0, 3.0), (0.0, -3.0)];
            let built = near.iter().any(|(dx, dy)| memory.building(x + dx, y + dy).is_some());
            let leafy = near.iter().any(|(dx, dy)| {
                let (x, y) = (x + dx, y + dy);
                memory.tree(x, y).is_some_and(|t| t.crown(x, y).is_some())
            });
            // Two thirds of a scene are free, so this ends soon.
            if !built && !leafy {
                break;
            }
        }
        let ground = Raster::around(&scene, x, y);
        let station = [x, y, ground.at(x, y) + TRIPOD];
        Self { seed, scene, ground, station, number: number as u16 + 1, points }
    }

    /// Where the scanner stands.
    #[cfg(test)]
    pub fn station(&self) -> [f64; 3] {
        self.station
    }

    fn profile(&self, direction: [f64; 2], memory: &mut Memory, steps: &mut Vec<Step>) {
        steps.clear();
        let mut distance: f64 = 0.8;
        let mut before: Option<(f64, Option<Building>)> = None;
        while distance < RANGE {
            let (x, y) = (self.station[0] + direction[0] * distance, self.station[1] + direction[1] * distance);
            let building = memory.building(x, y);
            let solid = building.map_or_else(|| self.ground.at(x, y), |b| b.top);
            let wall = before.and_then(|(last, there)| {
                let b = building.filter(|b| there != Some(*b))?;
                Some(self.entry(direction, &b).clamp(last, distance))
            });
            let length = before.map_or(0.1, |(last, _)| distance - last);
            let crown = memory.tree(x, y).filter(|_| building.is_none()).and_then(|tree| {
                let (low, high) = tree.crown(x, y)?;
                // A trunk is below its crown; leaves take a quarter of the rays in a metre.
                if tree.trunk(x, y) {
                    return Some((tree.ground, high, 1.0, 0.5));
                }
                Some((low, high, (0.25 * length).min(0.9), tree.shade))
            });
            steps.push(Step { distance, solid, building, wall, crown });
            before = Some((distance, building));
            distance += (0.012 * distance).max(0.1);
        }
    }

    /// The distance at which a ray from the station enters a building's plan.
    fn entry(&self, direction: [f64; 2], b: &Building) -> f64 {
        (0..2)
            .map(|i| {
                let face = if direction[i] > 0.0 { b.min[i] } else { b.max[i] };
                if direction[i] == 0.0 { 0.0 } else { (face - self.station[i]) / direction[i] }
            })
            .fold(0.0, f64::max)
    }

    /// Appends what a column of `rays` rays in direction `turns` hits.
    fn column(&self, turns: f64, rays: usize, time: f64, work: &mut Work, out: &mut Points) {
        let Work { random, memory, steps, crowns } = work;
        let (sin, cos) = sin_cos(turns);
        let direction = [cos, sin];
        self.profile(direction, memory, steps);
        crowns.clear();
        crowns.extend((0..steps.len()).filter(|&i| steps[i].crown.is_some()));
        let mut next = 0;
        for ray in 0..rays {
            let part = (ray as f64 + random.unit()) / rays as f64;
            let degrees = ELEVATION.0 + (ELEVATION.1 - ELEVATION.0) * part;
            let (sin, cos) = sin_cos(degrees / 360.0);
            let slope = sin / cos;
            let height = |distance: f64| self.station[2] + slope * distance;
            while next < steps.len() && height(steps[next].distance) > steps[next].solid {
                next += 1;
            }
            let leaves = crowns.iter().take_while(|&&i| i < next).find_map(|&i| {
                let (low, high, share, shade) = steps[i].crown?;
                let z = height(steps[i].distance);
                let hit = (low..high).contains(&z) && random.chance(share);
                hit.then_some((steps[i].distance, 5, LEAVES.map(|c| c * shade), 0.35))
            });
            let solid = || self.solid_hit(steps, next, slope);
            let Some((distance, class, color, reflectivity)) = leaves.or_else(solid) else { continue };
            let range = (distance / cos).max(0.1);
            // Two millimetres of noise along the ray.
            let distance = distance + 0.002 * random.normal() * cos;
            let strength = reflectivity * (1.0 + 0.08 * random.normal()) / (1.0 + (range / 60.0) * (range / 60.0));
            out.push(&Sample {
                at: [
                    self.station[0] + direction[0] * distance,
                    self.station[1] + direction[1] * distance,
                    height(distance),
                ],
                color: shaded(color, 1.0 + 0.05 * random.normal()),
                intensity: (strength * 65_535.0) as u16,
                returns: (1, 1),
                class,
                angle: (degrees / 0.006).round() as i16,
                forward: true,
                edge: false,
                time: time + part * 1e-3,
                source: self.number,
            });
        }
    }

    /// Where a ray meets ground, wall or roof, if step `next` is the first that is above it.
    fn solid_hit(&self, steps: &[Step], next: usize, slope: f64) -> Option<(f64, u8, [f64; 3], f64)> {
        let height = |distance: f64| self.station[2] + slope * distance;
        let step = steps.get(next)?;
        if let Some(b) = step.building {
            if let Some(wall) = step.wall.filter(|&w| height(w) <= b.top) {
                return Some((wall, 6, [206.0, 196.0, 176.0], 0.6));
            }
            let roof = if slope < 0.0 { (b.top - self.station[2]) / slope } else { step.distance };
            return Some((roof.min(step.distance), 6, b.color, 0.5));
        }
        let distance = match next.checked_sub(1).map(|i| steps[i]) {
            // Between the two, where the ray goes from above the ground to below.
            Some(last) if last.building.is_none() => {
                let (above, below) = (height(last.distance) - last.solid, step.solid - height(step.distance));
                let share = above / (above + below).max(1e-9);
                last.distance + (step.distance - last.distance) * share.clamp(0.0, 1.0)
            }
            _ => step.distance,
        };
        Some((distance, 2, ground_color(height(distance)), 0.4))
    }
}

/// What is used again from column to column.
struct Work {
    random: Random,
    memory: Memory,
    steps: Vec<Step>,
    crowns: Vec<usize>,
}

impl Model for Scan {
    fn block(&self, block: u64, first: u64, points: usize) -> Points {
        let mut work = Work {
            random: Random::new(self.seed, u64::from(self.number) << 32 | block),
            memory: Memory::of(self.scene),
            steps: Vec::new(),
            crowns: Vec::new(),
        };
        // A block is the sector that has its share of the scan.
        let (start, width) = (first as f64 / self.points as f64, points as f64 / self.points as f64);
        let scan_time = super::START_TIME + 600.0 * f64::from(self.number);
        let time = |part: f64| scan_time + 300.0 * (start + width * part);

        // How many rays hit something is not known before: a few columns tell.
        let mut trial = Points::default();
        let (columns, rays) = (16, 64);
        for i in 0..columns {
            let turns = start + width * (f64::from(i) + 0.5) / f64::from(columns);
            self.column(turns, rays, 0.0, &mut work, &mut trial);
        }
        let share = trial.len().max(16) as f64 / (f64::from(columns) * rays as f64);
        let wanted = 1.03 * points as f64 / share;
        let tall = (ELEVATION.1 - ELEVATION.0) / 360.0;
        let rays = (wanted * tall / width).sqrt().ceil().clamp(8.0, 20_000.0);
        let columns = (wanted / rays).ceil().max(1.0);

        let mut out = Points::with_capacity(points + points / 8);
        let mut column = 0.0;
        while out.len() < points || column < columns {
            // Once around may give too few: then some columns are traced twice, at other places.
            let part = if column < columns { (column + work.random.unit()) / columns } else { work.random.unit() };
            self.column(start + width * part, rays as usize, time(part), &mut work, &mut out);
            column += 1.0;
        }
        // And too many: then evenly fewer.
        let there = out.len();
        out.picked((0..points).map(|i| i * there / points))
    }
}

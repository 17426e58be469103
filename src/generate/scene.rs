//! A landscape without end: fractal ground, buildings and trees, all functions of the seed and the place.

use super::random::{hash, part};

/// Side of the squares that hold at most one building each.
const PLOT: f64 = 40.0;
/// Side of those that hold at most one tree each; a plot is a whole number of them.
const TREE_CELL: f64 = 10.0;

/// Ground, buildings and trees of a seed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scene {
    seed: u64,
}

/// A box on the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Building {
    pub min: [f64; 2],
    pub max: [f64; 2],
    pub top: f64,
    pub color: [f64; 3],
}

/// A tree whose crown lies within its cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tree {
    pub at: [f64; 2],
    pub radius: f64,
    /// Of its foot.
    pub ground: f64,
    pub height: f64,
    /// Brightness.
    pub shade: f64,
}

impl Building {
    pub fn contains(&self, x: f64, y: f64) -> bool {
        (self.min[0]..=self.max[0]).contains(&x) && (self.min[1]..=self.max[1]).contains(&y)
    }
}

impl Tree {
    /// Low and high end of the crown above a place; `None` beside it.
    pub fn crown(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        let (dx, dy) = (x - self.at[0], y - self.at[1]);
        let part = (dx * dx + dy * dy) / (self.radius * self.radius);
        if !(0.0..1.0).contains(&part) {
            return None;
        }
        // An ellipsoid over the upper two thirds.
        let (middle, half) = (self.ground + self.height * 0.65, self.height * 0.35);
        let reach = half * (1.0 - part).sqrt();
        Some((middle - reach, middle + reach))
    }

    /// Is the place in the trunk?
    pub fn trunk(&self, x: f64, y: f64) -> bool {
        let (dx, dy) = (x - self.at[0], y - self.at[1]);
        dx * dx + dy * dy < 0.2 * 0.2
    }
}

impl Scene {
    pub fn new(seed: u64) -> Self {
        Self { seed: hash(seed, 0, 0) }
    }

    /// Height of the ground: fractal noise of six octaves.
    pub fn ground(&self, x: f64, y: f64) -> f64 {
        let (mut height, mut wave, mut strength) = (0.0, 200.0, 12.0);
        for octave in 0..6 {
            height += strength * self.noise(octave, x / wave, y / wave);
            wave *= 0.5;
            strength *= 0.45;
        }
        height
    }

    /// Smooth noise in `[-1, 1]` with one value per unit square's corner.
    fn noise(&self, octave: u64, x: f64, y: f64) -> f64 {
        let seed = self.seed.wrapping_add(octave);
        let (cx, cy) = (x.floor(), y.floor());
        let smooth = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
        let (u, v) = (smooth(x - cx), smooth(y - cy));
        let (ix, iy) = (cx as i64, cy as i64);
        let corner = |i: i64, j: i64| part(hash(seed, ix + i, iy + j), 0) * 2.0 - 1.0;
        let low = corner(0, 0) * (1.0 - u) + corner(1, 0) * u;
        let high = corner(0, 1) * (1.0 - u) + corner(1, 1) * u;
        low * (1.0 - v) + high * v
    }

    fn building(&self, cell: (i64, i64)) -> Option<Building> {
        let seed = self.seed.wrapping_add(100);
        let (a, b) = (hash(seed, cell.0, cell.1), hash(seed.wrapping_add(1), cell.0, cell.1));
        if part(a, 0) >= 0.35 {
            return None;
        }
        let size = [10.0 + 12.0 * part(a, 1), 10.0 + 12.0 * part(a, 2)];
        let low = [cell.0 as f64 * PLOT, cell.1 as f64 * PLOT];
        let min: [f64; 2] = std::array::from_fn(|i| low[i] + 3.0 + (PLOT - 6.0 - size[i]) * part(b, i as u32));
        let max = [min[0] + size[0], min[1] + size[1]];
        let corners = [(min[0], min[1]), (max[0], min[1]), (min[0], max[1]), (max[0], max[1])];
        let ground = corners.iter().map(|&(x, y)| self.ground(x, y)).fold(f64::MIN, f64::max);
        let color = if part(b, 2) < 0.6 { [165.0, 84.0, 60.0] } else { [140.0, 140.0, 145.0] };
        Some(Building { min, max, top: ground + 3.0 + 9.0 * part(a, 3), color })
    }

    fn tree(&self, cell: (i64, i64)) -> Option<Tree> {
        let h = hash(self.seed.wrapping_add(200), cell.0, cell.1);
        let radius = 1.5 + 2.5 * part(h, 1);
        let reach = TREE_CELL - 2.0 * radius;
        let low = [cell.0 as f64 * TREE_CELL + radius, cell.1 as f64 * TREE_CELL + radius];
        let at = [low[0] + reach * part(h, 2), low[1] + reach * part(h, 3)];
        // Trees stand in woods.
        if part(h, 0) >= 0.35 + 0.5 * self.noise(50, at[0] / 120.0, at[1] / 120.0) {
            return None;
        }
        let plots = (TREE_CELL / PLOT * cell.0 as f64, TREE_CELL / PLOT * cell.1 as f64);
        let building = self.building((plots.0.floor() as i64, plots.1.floor() as i64));
        let clear = |b: Building| (0..2).any(|i| at[i] + radius < b.min[i] || at[i] - radius > b.max[i]);
        if !building.is_none_or(clear) {
            return None;
        }
        Some(Tree {
            at,
            radius,
            ground: self.ground(at[0], at[1]),
            height: radius * (2.5 + 1.5 * part(h, 0)),
            shade: 0.75 + 0.5 * part(h, 1),
        })
    }
}

/// What a thread remembers of the scene's cells: each is asked for again and again.
pub(super) struct Memory {
    scene: Scene,
    buildings: Vec<Option<Remembered<Building>>>,
    trees: Vec<Option<Remembered<Tree>>>,
}

/// A cell, and what stands in it, if anything.
type Remembered<T> = ((i64, i64), Option<T>);

/// Cells remembered along a side.
const SIDE: i64 = 64;

fn slot(cell: (i64, i64)) -> usize {
    (cell.0.rem_euclid(SIDE) * SIDE + cell.1.rem_euclid(SIDE)) as usize
}

impl Memory {
    pub fn of(scene: Scene) -> Self {
        let slots = (SIDE * SIDE) as usize;
        Self { scene, buildings: vec![None; slots], trees: vec![None; slots] }
    }

    /// The building over a place.
    pub fn building(&mut self, x: f64, y: f64) -> Option<Building> {
        let cell = ((x / PLOT).floor() as i64, (y / PLOT).floor() as i64);
        let slot = &mut self.buildings[slot(cell)];
        let known = slot.filter(|(there, _)| *there == cell);
        let (_, building) = *slot.insert(known.unwrap_or_else(|| (cell, self.scene.building(cell))));
        building.filter(|b| b.contains(x, y))
    }

    /// The tree of a place's cell, which is the only one whose crown may be over it.
    pub fn tree(&mut self, x: f64, y: f64) -> Option<Tree> {
        let cell = ((x / TREE_CELL).floor() as i64, (y / TREE_CELL).floor() as i64);
        let slot = &mut self.trees[slot(cell)];
        let known = slot.filter(|(there, _)| *there == cell);
        slot.insert(known.unwrap_or_else(|| (cell, self.scene.tree(cell)))).1
    }
}

/// The colour of the ground at a height: meadow below, earth and stone above.
pub(super) fn ground_color(height: f64) -> [f64; 3] {
    let t = ((height + 12.0) / 24.0).clamp(0.0, 1.0);
    [88.0 + 70.0 * t, 122.0 - 10.0 * t, 62.0 + 25.0 * t]
}

/// The colour of leaves.
pub(super) const LEAVES: [f64; 3] = [58.0, 104.0, 42.0];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ground_is_continuous() {
        let scene = Scene::new(5);
        for i in 0..20_000 {
            let (x, y) = (f64::from(i) * 0.37 - 3000.0, f64::from(i) * 0.11 - 900.0);
            assert!((scene.ground(x, y) - scene.ground(x + 0.01, y + 0.01)).abs() < 0.05, "at {x} {y}");
        }
    }

    #[test]
    fn crowns_stay_in_their_cells_and_off_buildings() {
        let scene = Scene::new(6);
        let mut memory = Memory::of(scene);
        let mut seen = (0, 0);
        for i in -100..100 {
            for j in -100..100 {
                let Some(tree) = scene.tree((i, j)) else { continue };
                seen.0 += 1;
                for (dx, dy) in [(-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0)] {
                    let (x, y) = (tree.at[0] + 0.99 * tree.radius * dx, tree.at[1] + 0.99 * tree.radius * dy);
                    assert_eq!(memory.tree(x, y), Some(tree));
                    assert_eq!(memory.building(x, y), None);
                }
                seen.1 += usize::from(scene.building((i, j)).is_some());
            }
        }
        assert!(seen.0 > 1000 && seen.1 > 100, "{seen:?}");
    }
}

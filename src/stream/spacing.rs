//! How far apart the points of a picture lie, place by place, as they were counted when they were packed.
//!
//! The tree's cells say how far apart points are where there are enough of them, and nothing of where there are not: a
//! leaf may be dense in a corner and thin elsewhere, and an octant without a child has what happened to be left there. So
//! the points of each part are counted in 64 cubes of its node, as points per *surface*: points lie on walls and ground, so
//! the cells that they occupy, of a size at which a cell has some points, say how large that surface is.

use super::gpu::{DrawList, Patch};
use crate::lattice::{BITS, Cube, LatticePoint};
use crate::points::Positions;
use std::collections::HashMap;

/// Cubes of a node in which its points are counted: those of its octants' octants.
const FINE: usize = 64;
/// The octants of those: which of the node's points lie in the fine cubes of a child.
const FINEST: usize = 8 * FINE;
/// Fewer points than these say nothing of how close they lie: they are taken to lie as those around them do.
const LEAST_POINTS: u32 = 16;
/// A cell of the size that is looked for has so many points on the mean.
const POINTS_OF_A_CELL: u32 = 3;
/// A cell has four cells of half its side on a surface, and fewer than this where most of the surface ends in them.
const BRANCHING: f32 = 2.6;
/// By so much more at twice the size: what is as thin at every size is an edge.
const RISING: f32 = 1.15;
const LEAST_CELLS: u32 = 24;
/// And no thinner is assumed than by this, or the wall would lose its shape.
const MOST_THINNER: f32 = 16.0;
/// How many times twice as far apart points of a part may lie.
const MOST_STEPS: usize = 6;
/// Points that lie anyhow leave wider gaps than those on a grid of the same density.
const REACH: f64 = 1.25;
/// Cubes beside each other that differ by less are drawn alike.
const ALIKE: f64 = 1.25;

/// How close points lie in the 64 cubes of a node.
#[derive(Clone, Debug, PartialEq)]
pub struct Densities {
    /// Points per area of a lattice step's square; 0 where there are none, or nothing is known.
    densities: [f32; FINE],
    /// Points in each of the 512 cubes, 255 if there are more.
    counts: [u8; FINEST],
}

impl Default for Densities {
    fn default() -> Self {
        Self { densities: [0.0; FINE], counts: [0; FINEST] }
    }
}

/// Neighbours in key order, by how many of their low bits differ.
#[derive(Clone)]
struct Pairs {
    points: u32,
    by_bits: [u32; BITS as usize + 1],
}

impl Default for Pairs {
    fn default() -> Self {
        Self { points: 0, by_bits: [0; BITS as usize + 1] }
    }
}

impl Pairs {
    fn add(&mut self, other: &Self) {
        self.points += other.points;
        self.by_bits.iter_mut().zip(&other.by_bits).for_each(|(a, b)| *a += b);
    }

    /// Points per area, by the finest cells that have enough points each: of the thinnest surface, if there are several.
    fn density(&self) -> Option<f32> {
        let mut cells = [1_u32; BITS as usize + 3];
        // Of the finest cells, one for each pair that differs at all, and one for the first point.
        for bits in (0..usize::from(BITS)).rev() {
            cells[bits] = cells[bits + 1] + self.by_bits[bits + 1];
        }
        let enough = |bits: &usize| self.points >= POINTS_OF_A_CELL * cells[*bits];
        let finest = (0..=usize::from(BITS)).find(enough)?;
        let branching = |bits: usize| cells[bits] as f32 / cells[bits + 1] as f32;
        // Where a dense wall stands on a thin floor it has enough points for both. But between the sizes at which the wall's
        // and the floor's cells have points each, those of the floor do not branch.
        let ends = |bits: &usize| {
            cells[bits + 1] >= LEAST_CELLS
                && branching(*bits) < BRANCHING
                && branching(bits + 1) > RISING * branching(*bits)
        };
        let coarsest = usize::from(BITS).min(finest + MOST_STEPS);
        let bits = (finest..coarsest).rev().find(ends).map_or(finest, |bits| bits + 1);
        // 4 on a surface, 8 in a cloud, where what lies behind shows through gaps: smaller splats do there.
        let through = (branching(bits) / 4.0).clamp(1.0, 2.0).powf(1.2);
        let area = 4_f32.powi(bits as i32);
        let all = self.points as f32 / (cells[finest] as f32 * 4_f32.powi(finest as i32));
        let thin = if bits > finest { all.min((POINTS_OF_A_CELL as f32 / area).max(all / MOST_THINNER)) } else { all };
        Some(thin * through)
    }
}

/// The count of a node's points as it goes on.
#[derive(Default)]
struct Count {
    densities: Densities,
    fine: Pairs,
    octant: Pairs,
    node: Pairs,
    /// Fine cubes of too few points: their octant says how close these lie, or the node.
    left_to_octant: Vec<usize>,
    left_to_node: Vec<usize>,
}

impl Count {
    fn end_fine(&mut self, at: usize) {
        match self.fine.density().filter(|_| self.fine.points >= LEAST_POINTS) {
            Some(density) => self.densities.densities[at] = density,
            None => self.left_to_octant.push(at),
        }
        self.octant.add(&std::mem::take(&mut self.fine));
    }

    fn end_octant(&mut self) {
        match self.octant.density().filter(|_| self.octant.points >= LEAST_POINTS) {
            Some(density) => self.left_to_octant.drain(..).for_each(|at| self.densities.densities[at] = density),
            None => self.left_to_node.append(&mut self.left_to_octant),
        }
        self.node.add(&std::mem::take(&mut self.octant));
    }

    /// Where a pair is counted whose points lie in these fine cubes; cubes that are left behind are ended.
    fn between(&mut self, before: usize, after: usize) -> &mut Pairs {
        if before == after {
            return &mut self.fine;
        }
        self.end_fine(before);
        if before >> 3 == after >> 3 {
            return &mut self.octant;
        }
        self.end_octant();
        &mut self.node
    }

    fn end(mut self) -> Densities {
        if let Some(density) = self.node.density() {
            self.left_to_node.iter().for_each(|&at| self.densities.densities[at] = density);
        }
        self.densities
    }
}

impl Densities {
    /// Of points in `cube`, given in key order.
    pub fn of(cube: Cube, positions: &Positions) -> Self {
        let Some(first) = positions.iter().next() else { return Self::default() };
        // Neighbours that differ in no higher bit lie in one of the finest cubes.
        let finest_bits = u32::from(cube.k().saturating_sub(3));
        let mut count = Count::default();
        let mut at = finest_place(cube, first);
        let (mut begin, mut counts) = (0, [0; FINEST]);
        count.fine.points = 1;
        for i in 1..positions.len() {
            let differ = |c: &[u64]| c[i] ^ c[i - 1];
            let differing = differ(&positions.x) | differ(&positions.y) | differ(&positions.z);
            let bits = (u64::BITS - differing.leading_zeros()).min(u32::from(BITS));
            let pairs = if bits <= finest_bits {
                &mut count.fine
            } else {
                let before = at;
                at = finest_place(cube, LatticePoint([positions.x[i], positions.y[i], positions.z[i]]));
                counts[before] += i - begin;
                begin = i;
                count.between(before >> 3, at >> 3)
            };
            pairs.by_bits[bits as usize] += 1;
            count.fine.points += 1;
        }
        counts[at] += positions.len() - begin;
        count.end_fine(at >> 3);
        count.end_octant();
        let mut all = count.end();
        all.counts = counts.map(|n| n.min(u8::MAX.into()) as u8);
        all
    }

    /// Adds those of other points in the same cube, of which a `share` is drawn.
    fn add(&mut self, other: &Self, share: f32) {
        self.densities.iter_mut().zip(&other.densities).for_each(|(a, b)| *a += b * share);
        let drawn = |count: u8| (f32::from(count) * share).round() as u8;
        self.counts.iter_mut().zip(other.counts).for_each(|(a, b)| *a = a.saturating_add(drawn(b)));
    }
}

/// Which of the 512 cubes holds the point: its octant, then the octant of that, then of that.
fn finest_place(cube: Cube, point: LatticePoint) -> usize {
    let bits = |below: u8| {
        // A cube of one step has no octants: all its points are in the first.
        let Some(shift) = cube.k().checked_sub(below) else { return 0 };
        (0..3).fold(0, |octant, i| octant | ((point.0[i] >> shift & 1) as usize) << i)
    };
    bits(1) << 6 | bits(2) << 3 | bits(3)
}

/// Gives every node of a list, and the cubes in it where that differs, the distance at which its points lie: `parts` has
/// what is drawn, each with its node and how much of it that is.
///
/// What nodes above have in a cube is counted with what the node has, and so is what other layers have.
pub fn set_spacings<'d>(list: &mut DrawList, parts: impl IntoIterator<Item = (u32, &'d Densities, f32)>) {
    let mut places: HashMap<Cube, usize> = HashMap::new();
    let mut cubes: Vec<(Cube, Densities)> = Vec::new();
    let mut place_of = Vec::with_capacity(list.nodes.len());
    for node in &list.nodes {
        let place = *places.entry(node.cube).or_insert_with(|| {
            cubes.push((node.cube, Densities::default()));
            cubes.len() - 1
        });
        place_of.push(place);
    }
    for (node, densities, share) in parts {
        if let Some(&place) = place_of.get(node as usize) {
            cubes[place].1.add(densities, share);
        }
    }
    let drawn = |cube: Cube| places.get(&cube).map(|&place| &cubes[place].1);
    let quantum = list.lattice.largest_quantum();
    let spacing = |density: f32| REACH * quantum / f64::from(density).sqrt();
    list.patches.clear();
    for (at, node) in (0_u32..).zip(&mut list.nodes) {
        let cube = node.cube;
        let (own, parent) = (&cubes[place_of[at as usize]].1, drawn(cube.parent()).filter(|_| cube.k() < BITS));
        // The parent has counted in this one's octants, and the one above that in all of this one.
        let above = cube.parent().parent();
        let far = drawn(above)
            .filter(|_| above.k() == cube.k() + 2)
            .map_or(0.0, |d| d.densities[finest_place(above, cube.low()) >> 3]);
        let in_parent = usize::from(cube.octant());
        let near = |octant: usize| parent.map_or(0.0, |d| d.densities[in_parent << 3 | octant]);
        let seen = |fine: usize| own.densities[fine] + near(fine >> 3);
        let mut total: [Option<f64>; FINE] =
            std::array::from_fn(|fine| (seen(fine) > 0.0).then(|| spacing(seen(fine) + far)));
        as_around(&mut total, |fine| {
            let points: u32 = own.counts[fine << 3..][..8].iter().map(|n| u32::from(*n)).sum();
            points + parent.map_or(0, |d| d.counts[in_parent << 6 | fine].into())
        });
        let Some(whole) = mean(&total) else { continue };
        node.spacing = whole;
        for octant in 0..8_u8 {
            let Some(child) = cube.child(octant).filter(|child| !places.contains_key(child)) else { continue };
            let fine = &total[usize::from(octant) << 3..][..8];
            let Some(spacing) = mean(fine) else { continue };
            let differs = |s: f64, from: f64| s > from * ALIKE || s < from / ALIKE;
            let inside: Vec<(Cube, f64)> = (0..8_u8)
                .filter_map(|o| Some((child.child(o)?, fine[usize::from(o)].filter(|&s| differs(s, spacing))?)))
                .collect();
            if inside.is_empty() && !differs(spacing, whole) {
                continue;
            }
            list.patches.push(Patch { node: at, cube: child, spacing });
            list.patches.extend(inside.into_iter().map(|(cube, spacing)| Patch { node: at, cube, spacing }));
        }
    }
}

/// Cubes of too few points, which `points` tells, are drawn no coarser than those around them: than the mean of their octant,
/// or of all, as far as there are enough points. What is counted there is how wide a field is that a stray lies in.
fn as_around(spacings: &mut [Option<f64>; FINE], points: impl Fn(usize) -> u32) {
    let mut known = *spacings;
    known.iter_mut().enumerate().filter(|(fine, _)| points(*fine) < LEAST_POINTS).for_each(|(_, s)| *s = None);
    let all = mean(&known);
    for (octant, known) in spacings.chunks_mut(8).zip(known.chunks(8)) {
        let Some(around) = mean(known).or(all) else { return };
        octant.iter_mut().zip(known).filter(|(_, known)| known.is_none()).for_each(|(spacing, _)| {
            *spacing = spacing.map(|spacing| spacing.min(around));
        });
    }
}

/// The geometric mean of those that are known.
fn mean(spacings: &[Option<f64>]) -> Option<f64> {
    let known: Vec<f64> = spacings.iter().flatten().map(|s| s.ln()).collect();
    (!known.is_empty()).then(|| (known.iter().sum::<f64>() / known.len() as f64).exp())
}

#[cfg(test)]
mod tests {
    use super::super::gpu::DrawNode;
    use super::*;
    use crate::lattice::{Key, Lattice};
    use proptest::prelude::*;
    use std::collections::HashSet;

    fn positions(mut points: Vec<[u64; 3]>) -> Positions {
        points.sort_by_key(|p| Key::of(LatticePoint(*p)));
        points.into_iter().map(LatticePoint).collect()
    }

    /// A floor of points `apart` from each other, moved about by less than that; `to` ends it on both axes.
    fn floor(from: [u64; 2], to: [u64; 2], apart: u64) -> Vec<[u64; 3]> {
        let mut points = Vec::new();
        for x in (from[0]..to[0]).step_by(apart as usize) {
            for y in (from[1]..to[1]).step_by(apart as usize) {
                let at = (x * 31 + y * 17) % apart;
                points.push([x + at / 2, y + (at * 7 % apart) / 2, 5]);
            }
        }
        points
    }

    fn list(cubes: &[Cube]) -> DrawList {
        let mut list = DrawList::empty(Lattice::uniform(1.0).unwrap(), 0);
        let node = |&cube: &Cube| DrawNode { cube, layer: 0, spacing: 77.0, stand_in: false, parent: None };
        list.nodes.extend(cubes.iter().map(node));
        list
    }

    /// The spacing of the finest node or patch around a point.
    fn spacing_at(list: &DrawList, point: [u64; 3]) -> f64 {
        let nodes = list.nodes.iter().map(|n| (n.cube, n.spacing));
        let all = nodes.chain(list.patches.iter().map(|p| (p.cube, p.spacing)));
        let here = all.filter(|(cube, _)| cube.contains(LatticePoint(point)));
        here.min_by_key(|(cube, _)| cube.k()).map(|(_, spacing)| spacing).unwrap()
    }

    fn is_near(spacing: f64, apart: f64) -> bool {
        (0.8..1.25).contains(&(spacing / (REACH * apart)))
    }

    #[test]
    fn points_are_drawn_as_far_apart_as_they_lie_in_each_place() {
        let cube = Cube::containing(LatticePoint([0; 3]), 12);
        // A dense corner, a thin floor beside it, some strays, and nothing anywhere else.
        let mut points = floor([0, 0], [1024, 1024], 8);
        points.extend(floor([2048, 0], [4096, 4096], 64));
        points.extend([[100, 3000, 3000], [900, 3900, 2500]]);
        let densities = Densities::of(cube, &positions(points));
        let mut list = list(&[cube]);
        set_spacings(&mut list, [(0, &densities, 1.0)]);
        for (point, apart) in [([500, 500, 5], 8.0), ([3000, 3000, 5], 64.0), ([2100, 100, 5], 64.0)] {
            let spacing = spacing_at(&list, point);
            assert!(is_near(spacing, apart), "{spacing} at {point:?} for {apart}");
        }
        let stray = spacing_at(&list, [100, 3000, 3000]);
        assert!(stray < 1.25 * REACH * 64.0, "a stray is not larger than its surroundings: {stray}");
        // A quarter of the points lies twice as far apart.
        set_spacings(&mut list, [(0, &densities, 0.25)]);
        assert!(is_near(spacing_at(&list, [500, 500, 5]), 16.0));
    }

    #[test]
    fn a_dense_wall_leaves_no_holes_in_the_thin_floor_that_it_stands_on() {
        let cube = Cube::containing(LatticePoint([0; 3]), 12);
        // One fine cube of the node is 1024 wide.
        let wall = || floor([0, 0], [1024, 192], 4).into_iter().map(|[y, z, x]| [x + 500, y, z]);
        let spacing = |points: Vec<[u64; 3]>| {
            let mut list = list(&[cube]);
            set_spacings(&mut list, [(0, &Densities::of(cube, &positions(points)), 1.0)]);
            spacing_at(&list, [500, 500, 5])
        };
        assert!(is_near(spacing(wall().collect()), 4.0), "a wall alone");
        let with_floor = |apart| spacing(floor([0, 0], [1024, 1024], apart).into_iter().chain(wall()).collect());
        for apart in [8, 16, 32] {
            let spacing = with_floor(apart);
            assert!((0.5..2.0).contains(&(spacing / (REACH * apart as f64))), "{spacing} for {apart}");
        }
        // The wall keeps its shape.
        assert!(with_floor(64) <= 4.5 * REACH * 4.0, "{}", with_floor(64));
        // An edge is thin at every size.
        let edge: Vec<_> = (0..1024).map(|x| [x, 500 + x % 3, 5 + x % 2]).collect();
        assert!(spacing(edge.clone()) < 8.0, "{}", spacing(edge));
    }

    #[test]
    fn what_lies_above_and_in_other_layers_counts() {
        let parent = Cube::containing(LatticePoint([0; 3]), 12);
        let child = parent.child(0).unwrap();
        let all = floor([0, 0], [2048, 2048], 16);
        let (above, below): (Vec<_>, Vec<_>) = all.into_iter().partition(|p| p[0] / 16 % 2 == 0);
        let mut list = list(&[parent, child, child]);
        let [above, below] = [(parent, above), (child, below)].map(|(cube, p)| Densities::of(cube, &positions(p)));
        set_spacings(&mut list, [(0, &above, 1.0), (1, &below, 1.0)]);
        assert!(is_near(spacing_at(&list, [700, 700, 5]), 16.0), "half of the points is in the parent: {list:?}");
        list.nodes[0].spacing = 77.0;
        set_spacings(&mut list, [(1, &below, 1.0), (2, &below, 1.0)]);
        assert!(is_near(spacing_at(&list, [700, 700, 5]), 16.0), "half of the points is in another layer");
        assert_eq!(list.nodes[0].spacing, 77.0, "nothing is known of it");
    }

    #[test]
    fn a_stray_of_the_node_above_is_drawn_like_what_is_around_it_and_a_thin_field_like_a_field() {
        let parent = Cube::containing(LatticePoint([0; 3]), 12);
        let child = parent.child(0).unwrap();
        // The child has a dense corner; the parent has a field beside it, thinly, or one point of it.
        let corner = Densities::of(child, &positions(floor([0, 0], [512, 512], 8)));
        let field = floor([1024, 0], [2048, 2048], 128);
        let far: Vec<_> = floor([2048, 0], [4096, 4096], 128);
        let drawn = |here: &[[u64; 3]]| {
            let above = Densities::of(parent, &positions([here, &far].concat()));
            let mut list = list(&[parent, child]);
            set_spacings(&mut list, [(0, &above, 1.0), (1, &corner, 1.0)]);
            spacing_at(&list, [1100, 1100, 5])
        };
        let (field, stray) = (drawn(&field), drawn(&[[1100, 1100, 5]]));
        assert!(is_near(field, 128.0), "{field}");
        assert!(is_near(stray, 8.0), "{stray}");
    }

    #[test]
    fn points_on_one_place_are_as_close_as_can_be() {
        for k in [0, 1, 12, BITS] {
            let cube = Cube::containing(LatticePoint([9; 3]), k);
            let densities = Densities::of(cube, &positions(vec![[9; 3]; 100_000]));
            let mut list = list(&[cube]);
            set_spacings(&mut list, [(0, &densities, 1.0)]);
            assert!(list.nodes[0].spacing < 0.01, "{k}: {}", list.nodes[0].spacing);
        }
        let empty = Densities::of(Cube::containing(LatticePoint([9; 3]), 7), &positions(vec![[9; 3], [10; 3]]));
        assert_eq!(empty.densities, [0.0; FINE], "two points say nothing");
    }

    /// As [`Pairs::density`], from the cells themselves.
    fn density_of(points: &[[u64; 3]]) -> Option<f32> {
        let cells = |bits: u32| points.iter().map(|p| p.map(|c| c >> bits)).collect::<HashSet<_>>().len() as u32;
        let enough = |bits: &u32| points.len() as u32 >= POINTS_OF_A_CELL * cells(*bits);
        let finest = (0..=u32::from(BITS)).find(enough)?;
        let branching = |bits| cells(bits) as f32 / cells(bits + 1) as f32;
        let all = points.len() as f32 / (cells(finest) as f32 * 4_f32.powi(finest as i32));
        let (mut bits, mut thin) = (finest, all);
        for at in finest..u32::from(BITS).min(finest + MOST_STEPS as u32) {
            let [now, next] = [branching(at), branching(at + 1)];
            if cells(at + 1) >= LEAST_CELLS && now < BRANCHING && next > RISING * now {
                bits = at + 1;
                thin = all.min((POINTS_OF_A_CELL as f32 / 4_f32.powi(bits as i32)).max(all / MOST_THINNER));
            }
        }
        Some(thin * (branching(bits) / 4.0).clamp(1.0, 2.0).powf(1.2))
    }

    proptest! {
        #[test]
        fn densities_are_those_of_occupied_cells(
            k in 0..14_u8,
            clusters in prop::collection::vec((any::<[u64; 3]>(), 0..14_u32, 1..90_usize), 1..9),
            seed in any::<u64>(),
        ) {
            let cube = Cube::containing(LatticePoint([0x1234_5678_9abc; 3]), k);
            let low = cube.low().0;
            let mut random = seed;
            let mut next = || {
                random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                random >> 20
            };
            let mut points = Vec::new();
            for (at, wide, count) in clusters {
                points.extend((0..count).map(|_| {
                    std::array::from_fn(|i| low[i] + (at[i].wrapping_add(next() & ((1 << wide) - 1)) & ((1 << k) - 1)))
                }));
            }
            let found = Densities::of(cube, &positions(points.clone()));
            let inside = |shift: u32, place: usize| -> Vec<[u64; 3]> {
                let there = |p: &&[u64; 3]| finest_place(cube, LatticePoint(**p)) >> (3 + shift) == place;
                points.iter().filter(there).copied().collect()
            };
            for (finest, count) in found.counts.iter().enumerate() {
                let here = |p: &&[u64; 3]| finest_place(cube, LatticePoint(**p)) == finest;
                prop_assert_eq!(usize::from(*count), points.iter().filter(here).count().min(255));
            }
            for fine in 0..FINE {
                // Itself if it has enough points, else its octant, else its node, which may have few.
                let near = [inside(0, fine), inside(3, fine >> 3)].into_iter();
                let near = near.map(|p| if p.len() < LEAST_POINTS as usize { None } else { density_of(&p) });
                let expected = near.flatten().next().or_else(|| density_of(&points)).unwrap_or(0.0);
                let expected = if inside(0, fine).is_empty() { 0.0 } else { expected };
                prop_assert!((found.densities[fine] - expected).abs() <= 1e-4 * expected, "{fine}: {} {expected}", found.densities[fine]);
            }
        }
    }
}

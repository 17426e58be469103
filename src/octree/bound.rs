//! How far the points that are left out can be from those that are there (OCTREE section 7).

use super::Step;
use crate::lattice::LatticeBox;

/// What lengths are measured in: the quantum per axis and, if it is known, how far apart two points of the tree can be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Metric {
    quantum: [f64; 3],
    extent: [f64; 3],
}

impl Metric {
    /// Lengths in lattice steps.
    pub(super) const STEPS: Self = Self { quantum: [1.0; 3], extent: [f64::INFINITY; 3] };

    /// Lengths in CRS units, `quantum` units a lattice step on each axis.
    pub fn new(quantum: [f64; 3]) -> Self {
        Self { quantum, ..Self::STEPS }
    }

    /// Caps bounds by the extent of *all* points of the tree, on each axis.
    ///
    /// A node's own bounds would be wrong here: the point that stands for a missing one may be an ancestor's.
    #[must_use]
    pub fn within(self, tree: &LatticeBox) -> Self {
        let extent = std::array::from_fn(|i| (tree.max.0[i] - tree.min.0[i]) as f64 * self.quantum[i]);
        Self { extent, ..self }
    }

    /// E(c, j): the largest distance from a point to the nearest one that is there, if all points with `win > c` are, and
    /// of those of `win = c` the ranks up to `j` in every cell of exponent `c + 1`. 0 if `c` is negative.
    ///
    /// A missing subcell has at least `j + 1` that are there before it in key order; of the other seven at most one is
    /// across the cell's diagonal and at most four across a face's or worse. So with 2 there is one across a face's
    /// diagonal at most, with 5 one next to it, with 8 none is missing.
    pub fn step_bound(&self, c: i8, j: u8) -> f64 {
        if c < 0 {
            return 0.0;
        }
        let s = 2_f64.powi(i32::from(c));
        let squared = |steps: f64, axis: usize| (steps * self.quantum[axis]).min(self.extent[axis]).powi(2);
        // On `far` axes the two are in neighbouring subcells, on the others in the same range; the worst axes are far.
        let far = match j {
            0 => 3,
            1..=3 => 2,
            4..=6 => 1,
            _ => 0,
        };
        let near: [f64; 3] = std::array::from_fn(|axis| squared(s - 1.0, axis));
        let wide: [f64; 3] = std::array::from_fn(|axis| squared(2.0 * s - 1.0, axis));
        let mut worst = [0, 1, 2];
        worst.sort_by(|&a, &b| (wide[b] - near[b]).total_cmp(&(wide[a] - near[a])));
        let mut squares = near;
        worst[..far].iter().for_each(|&axis| squares[axis] = wide[axis]);
        // Always summed in the order of the axes, so that bounds that are equal are equal to the last bit.
        squares.iter().sum::<f64>().sqrt()
    }

    /// The bound once `step` and all before it are complete.
    pub fn after(&self, step: Step) -> f64 {
        self.step_bound(step.win, step.last_rank())
    }

    /// The bound once all steps before `step` are complete, of `step` itself nothing for sure.
    pub fn before(&self, step: Step) -> f64 {
        self.step_bound(step.win, step.rank_before())
    }

    /// The bound of the first `taken` points of the order of detail, `left_out` being the step of the next: infinite if
    /// nothing is taken of something, 0 if nothing but repeated positions is left out.
    pub fn prefix(&self, taken: u64, left_out: Option<Step>) -> f64 {
        match left_out {
            None => 0.0,
            Some(_) if taken == 0 => f64::INFINITY,
            Some(step) => self.before(step),
        }
    }

    /// The bound of one node on the edge of a closed cut.
    #[cfg(test)]
    pub(super) fn frontier(&self, node: Frontier) -> f64 {
        match node {
            Frontier::Refinable { cell } => self.step_bound(cell, 7),
            Frontier::Begun { next } => self.before(next),
            Frontier::Complete => 0.0,
        }
    }

    /// The bound of a closed cut (a node is begun only when its parent is fully taken) of `taken` points, from the nodes
    /// on its edge: infinite if nothing is taken. It never grows as the cut grows.
    #[cfg(test)]
    pub(super) fn cut(&self, taken: u64, edge: impl IntoIterator<Item = Frontier>) -> f64 {
        let bound = edge.into_iter().map(|node| self.frontier(node)).fold(0.0, f64::max);
        if taken == 0 { f64::INFINITY } else { bound }
    }
}

/// A node on the edge of a closed cut.
#[cfg(test)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Frontier {
    /// A fully taken inner node with a child that is not begun.
    Refinable {
        /// The exponent of the cells that the node samples, `k - g`.
        cell: i8,
    },
    /// A node of which at least one point is taken and at least one is not.
    Begun {
        /// The step of its first point that is not taken.
        next: Step,
    },
    /// A fully taken node without a child that is not begun: it may be left out.
    Complete,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::{Cube, Key, LatticePoint};
    use crate::octree::naive::{hausdorff, tests::points};
    use crate::octree::thin::{DetailOrder, canonical_order};
    use proptest::prelude::*;

    fn sorted(points: Vec<LatticePoint>) -> (Vec<LatticePoint>, DetailOrder) {
        let mut keys: Vec<_> = points.into_iter().map(Key::of).collect();
        keys.sort_unstable();
        let order = canonical_order(&keys, 48);
        (keys.into_iter().map(Key::point).collect(), order)
    }

    fn bounds(points: &[LatticePoint]) -> LatticeBox {
        points.iter().fold(LatticeBox::of(points[0]), |b, p| b.with(*p))
    }

    const SLACK: f64 = 1.0 + 1e-12;

    proptest! {
        #[test]
        fn every_prefix_is_within_its_bound_and_bounds_never_grow(
            points in points(70),
            quantum in prop::array::uniform3(prop::sample::select(vec![1.0, 0.01, 3.0])),
        ) {
            let (points, order) = sorted(points);
            for metric in [Metric::new(quantum), Metric::new(quantum).within(&bounds(&points))] {
                let mut last = f64::INFINITY;
                for taken in 0..=points.len() {
                    let bound = order.bound(taken, &metric);
                    let some: Vec<_> = order.order[..taken].iter().map(|&i| points[i as usize]).collect();
                    let distance = hausdorff(&points, &some, quantum);
                    prop_assert!(distance <= bound * SLACK, "{distance} > {bound} with {taken}");
                    prop_assert!(bound <= last);
                    last = bound;
                }
                prop_assert_eq!(last, 0.0);
            }
        }

        #[test]
        fn every_rank_is_within_its_bound(points in points(70)) {
            // Not only where groups end: all of (c, j).
            let mut keys: Vec<_> = points.into_iter().map(Key::of).collect();
            keys.sort_unstable();
            let points: Vec<_> = keys.iter().map(|k| k.point()).collect();
            let wins = crate::octree::wins(&keys, 48);
            for c in 0..=17_i8 {
                for j in 0..=7_u8 {
                    let mut rank = 0;
                    let mut some = Vec::new();
                    for (i, &win) in wins.iter().enumerate() {
                        rank = if win > c { 0 } else { rank + u8::from(win == c) };
                        if win > c || win == c && rank <= j {
                            some.push(points[i]);
                        }
                    }
                    let distance = hausdorff(&points, &some, [1.0; 3]);
                    prop_assert!(distance <= Metric::STEPS.step_bound(c, j) * SLACK);
                }
            }
        }
    }

    #[test]
    fn the_bounds_are_those_of_the_specification() {
        let e = |c, j| Metric::STEPS.step_bound(c, j);
        for c in 0..=40_i8 {
            let s = 2_f64.powi(i32::from(c));
            for (j, far) in [3.0, 2.0, 2.0, 2.0, 1.0, 1.0, 1.0, 0.0].into_iter().enumerate() {
                let expected = (far * (2.0 * s - 1.0).powi(2) + (3.0 - far) * (s - 1.0).powi(2)).sqrt();
                assert!((e(c, j as u8) - expected).abs() <= 1e-12 * expected);
            }
            assert!((e(c, 0) - e(c + 1, 7)).abs() <= 1e-12 * e(c, 0), "nothing of c is everything of c + 1");
        }
        assert_eq!((e(0, 7), e(-1, 0)), (0.0, 0.0));
        assert_eq!(Metric::new([1.0, 2.0, 10.0]).after(Step { win: 2, group: 2 }), (9.0_f64 + 36.0 + 4900.0).sqrt());
    }

    #[test]
    fn the_bounds_are_reached() {
        // A cell of side 8; any subcells of side 4 hold a point each: the last in key order in the cell's own corner, the
        // others as far from it as they can be. What is lost if the last is missing?
        let mut largest = [0.0_f64; 7];
        let cell = Cube::containing(LatticePoint([0; 3]), 3);
        let octants = cell.octants_in_key_order();
        for mask in 1_u32..256 {
            let mut present = (0..8).filter(|digit| mask >> digit & 1 == 1).map(|digit| octants[digit as usize]);
            let Some(last) = present.next_back() else { continue };
            let outermost = |octant: u8, axis: usize| u64::from(octant >> axis & 1) * 7;
            let missing = LatticePoint(std::array::from_fn(|axis| outermost(last, axis)));
            let far = |octant: u8| {
                LatticePoint(std::array::from_fn(|axis| match outermost(octant, axis) {
                    0 if missing.0[axis] == 0 => 3,
                    7 if missing.0[axis] == 7 => 4,
                    x => x,
                }))
            };
            let taken: Vec<_> = present.map(far).collect();
            if let Some(largest) = taken.len().checked_sub(1).and_then(|j| largest.get_mut(j)) {
                *largest = largest.max(hausdorff(&[missing], &taken, [1.0; 3]));
            }
        }
        for (j, found) in (0..).zip(largest) {
            assert!((found - Metric::STEPS.step_bound(2, j)).abs() < 1e-9, "rank {j}: {found}");
        }
    }
}

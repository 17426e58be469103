//! How many points lie where in plan, and how high: counts and heights on a square grid. Nodes that lie wholly in one square
//! are counted by their rows alone.

use super::answer::{Meter, Statistics};
use super::part::{Look, Part};
use super::plan::{Plan, Prospect, Scope};
use super::{Detail, Query, QueryError};
use crate::geometry::Containment;
use crate::lattice::LatticeBox;
use crate::store::{NodeIx, Snapshot};
use std::collections::HashMap;

/// The most squares of a grid.
const MOST_SQUARES: u64 = 1 << 28;

/// A grid of squares in plan, x first: square `(i, j)` is at `j * size[0] + i`, and holds the points with
/// `floor(x / side) = first[0] + i` and `floor(y / side) = first[1] + j`.
#[derive(Clone, Debug, PartialEq)]
pub struct Density {
    /// The side of a square, in CRS units.
    pub side: f64,
    /// The number of the first square on each axis: its low edge is at `first * side`.
    pub first: [i64; 2],
    /// Squares on each axis: just those between the outermost that have a point.
    pub size: [usize; 2],
    /// Points in each square.
    pub counts: Vec<u64>,
    /// The least height in each square; NaN where there is no point.
    pub lowest: Vec<f64>,
    /// The greatest height in each square; NaN where there is no point.
    pub highest: Vec<f64>,
    /// What it cost.
    pub statistics: Statistics,
}

/// What a square holds; heights are on the lattice.
#[derive(Clone, Copy, Debug)]
struct Square {
    points: u64,
    lowest: u64,
    highest: u64,
}

type Squares = HashMap<[i64; 2], Square>;

fn add(squares: &mut Squares, at: [i64; 2], more: Square) {
    squares
        .entry(at)
        .and_modify(|square| {
            square.points += more.points;
            square.lowest = square.lowest.min(more.lowest);
            square.highest = square.highest.max(more.highest);
        })
        .or_insert(more);
}

impl Query {
    /// Counts the matching points in squares of this side.
    ///
    /// # Errors
    ///
    /// As [`Query::run`]; [`QueryError::Combination`] if the query has a level, a capacity or a view;
    /// [`QueryError::Detail`] if the side is not above 0, or so small that there would be more than 2^28 squares.
    pub fn density(&self, snapshot: &Snapshot, side: f64) -> Result<Density, QueryError> {
        if self.view.is_some() || self.capacity.is_some() || self.detail != Detail::Everything {
            return Err(QueryError::Combination(
                "all points are counted; leave out the view, level, spacing, max error and capacity",
            ));
        }
        let refused = |expected| Err(QueryError::Detail { what: "side of a square", value: side, expected });
        if !(f64::MIN_POSITIVE..f64::INFINITY).contains(&side) {
            return refused("a length above 0");
        }
        let plan = Plan::new(self, snapshot)?;
        let (mut squares, parts) = plan.by_rows(side)?;
        for window in parts.chunks(plan.window()) {
            let read = plan.each(window.to_vec(), |(node, part)| plan.squares_of(node, part, side))?;
            for one in read {
                one.into_iter().for_each(|(at, square)| add(&mut squares, at, square));
            }
        }
        let (Some(first), Some(last)) = (corner(&squares, i64::min), corner(&squares, i64::max)) else {
            let statistics = plan.finish(super::Answer::default()).statistics;
            let none = Vec::new;
            let (counts, lowest, highest) = (Vec::new(), none(), none());
            return Ok(Density { side, first: [0; 2], size: [0; 2], counts, lowest, highest, statistics });
        };
        let size: [u64; 2] = std::array::from_fn(|i| last[i].abs_diff(first[i]).saturating_add(1));
        if size[0].saturating_mul(size[1]) > MOST_SQUARES {
            return refused("larger: there would be more than 2^28 squares");
        }
        let size = size.map(|n| n as usize);
        let mut counts = vec![0; size[0] * size[1]];
        let mut lowest = vec![f64::NAN; counts.len()];
        let mut highest = lowest.clone();
        for (at, square) in squares {
            let i = (at[1] - first[1]) as usize * size[0] + (at[0] - first[0]) as usize;
            counts[i] = square.points;
            lowest[i] = plan.lattice.world_on_axis(2, square.lowest);
            highest[i] = plan.lattice.world_on_axis(2, square.highest);
        }
        let statistics = plan.finish(super::Answer::default()).statistics;
        Ok(Density { side, first, size, counts, lowest, highest, statistics })
    }
}

fn corner(squares: &Squares, choose: fn(i64, i64) -> i64) -> Option<[i64; 2]> {
    squares.keys().copied().reduce(|a, b| [choose(a[0], b[0]), choose(a[1], b[1])])
}

impl Plan {
    /// Which square; it never decreases along an axis.
    fn square_of(&self, x: u64, y: u64, side: f64) -> [i64; 2] {
        [(0, x), (1, y)].map(|(axis, v)| (self.lattice.world_on_axis(axis, v) / side).floor() as i64)
    }

    /// The square that holds all of a box.
    fn square_around(&self, bounds: &LatticeBox, side: f64) -> Option<[i64; 2]> {
        let of = |p: crate::lattice::LatticePoint| self.square_of(p.0[0], p.0[1], side);
        let (low, high) = (of(bounds.min), of(bounds.max));
        (low == high).then_some(low)
    }

    /// What the rows say, and the parts that must be read.
    fn by_rows(&self, side: f64) -> Result<(Squares, Vec<(NodeIx, usize)>), QueryError> {
        let mut squares = Squares::new();
        let mut parts = Vec::new();
        let heights = |points: u64, b: &LatticeBox| Square { points, lowest: b.min.0[2], highest: b.max.0[2] };
        self.walk(|node| {
            if let Some(at) = self.square_around(&node.subtree_bounds, side)
                && self.prospect(node, Scope::Subtree)? == Prospect::Everything
            {
                add(&mut squares, at, heights(node.subtree_points, &node.subtree_bounds));
                return Ok(false);
            }
            let (Some(bounds), own) = (&node.own_bounds, self.prospect(node, Scope::Own)?) else { return Ok(true) };
            match (own, self.square_around(bounds, side)) {
                (Prospect::Nothing, _) => {}
                (Prospect::Everything, Some(at)) => add(&mut squares, at, heights(node.own_points, bounds)),
                _ => {
                    Meter::add(&self.meter.nodes, 1);
                    parts.extend((0..node.parts.len()).map(|part| (node.ix(), part)));
                }
            }
            Ok(true)
        })?;
        Ok((squares, parts))
    }

    /// What a part has in each square.
    fn squares_of(&self, node: NodeIx, part: usize, side: f64) -> Result<Squares, QueryError> {
        self.cancel.check()?;
        let outside = |bounds: &LatticeBox| self.region.classify(bounds) == Containment::Outside;
        let mut squares = Squares::new();
        for found in Part::at(self, node, part)?.find(&Look { skips: &outside, misses: false, positions: true })? {
            for i in found.mask.indices() {
                let [x, y, z] = found.content.positions.point(i as usize).0;
                add(&mut squares, self.square_of(x, y, side), Square { points: 1, lowest: z, highest: z });
            }
        }
        Ok(squares)
    }
}

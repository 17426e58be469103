//! How many points lie where in plan, and how high: counts and heights on a square grid. Nodes that lie wholly in one square
//! are counted by their rows alone.

use super::answer::{Meter, Statistics};
use super::part::{Look, Part};
use super::plan::{Plan, Prospect, Scope};
use super::{Detail, Query, QueryError};
use crate::geometry::Containment;
use crate::lattice::{BIAS, BITS, Decimal, Lattice, LatticeBox, LatticePoint};
use crate::store::{NodeIx, Snapshot};
use std::collections::HashMap;

/// The most squares of a grid.
const MOST_SQUARES: u64 = 1 << 28;

/// A grid of squares in plan, of which those are kept that have points: square `(i, j)` has the points with
/// `floor(x / side) = i` and `floor(y / side) = j`: exact, the side and the coordinates being decimals.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Density {
    /// The side of a square, in CRS units.
    pub side: f64,
    /// The number of the first square on each axis: its low edge is at `first * side`.
    pub first: [i64; 2],
    /// Squares on each axis: just those between the outermost that have a point.
    pub size: [usize; 2],
    /// Those that have points, row by row: by y, then by x.
    pub squares: Vec<DensitySquare>,
    /// What it cost.
    pub statistics: Statistics,
}

/// A square that has points.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct DensitySquare {
    /// Its number on each axis.
    pub at: [i64; 2],
    /// Points in it; never 0.
    pub points: u64,
    /// The least height.
    pub lowest: f64,
    /// The greatest height.
    pub highest: f64,
}

impl Density {
    /// Where a square is in the grid: x first, `j * size[0] + i` for the one that is `i` squares from the first in x and `j`
    /// in y.
    pub fn place(&self, square: &DensitySquare) -> usize {
        let [i, j] = [0, 1].map(|axis| square.at[axis].abs_diff(self.first[axis]) as usize);
        j * self.size[0] + i
    }

    /// A value of every square of the grid, in the order of [`Density::place`]; those without points have `empty`. Memory
    /// for all of them, however few have points.
    pub fn grid<T: Clone>(&self, empty: T, value: impl Fn(&DensitySquare) -> T) -> Vec<T> {
        let mut grid = vec![empty; self.size[0] * self.size[1]];
        self.squares.iter().for_each(|square| grid[self.place(square)] = value(square));
        grid
    }
}

/// What a square holds; heights are on the lattice.
#[derive(Clone, Copy, Debug)]
struct Square {
    points: u64,
    lowest: u64,
    highest: u64,
}

/// Squares that have points, and the least grid that they span.
#[derive(Debug, Default)]
struct Squares {
    full: HashMap<[i64; 2], Square>,
    /// The numbers of the first and the last square on each axis.
    span: Option<[[i64; 2]; 2]>,
}

impl Squares {
    fn add(&mut self, at: [i64; 2], more: Square) {
        let [first, last] = self.span.unwrap_or([at, at]);
        self.span = Some([[0, 1].map(|i| first[i].min(at[i])), [0, 1].map(|i| last[i].max(at[i]))]);
        self.full
            .entry(at)
            .and_modify(|square| {
                square.points += more.points;
                square.lowest = square.lowest.min(more.lowest);
                square.highest = square.highest.max(more.highest);
            })
            .or_insert(more);
    }

    /// Squares on each axis, with none left out.
    fn size(&self) -> [u64; 2] {
        self.span.map_or([0; 2], |[first, last]| [0, 1].map(|i| last[i].abs_diff(first[i]).saturating_add(1)))
    }

    /// An error once the grid is too large: points come coarse to fine, so that is known soon and not when all are read.
    fn check(&self, side: f64) -> Result<(), QueryError> {
        let [across, up] = self.size();
        match across.saturating_mul(up) {
            ..=MOST_SQUARES => Ok(()),
            _ => Err(refused(side, "larger: there would be more than 2^28 squares")),
        }
    }
}

/// One axis in integers: `floor(coordinate / side) = floor((index * quantum + origin) / side)`.
#[derive(Clone, Copy, Debug)]
struct Ruler {
    quantum: i128,
    origin: i128,
    side: i128,
}

impl Ruler {
    /// Of an axis and a side above 0; `None` if they have no common power of ten that fits.
    fn new(lattice: &Lattice, axis: usize, side: Decimal) -> Option<Self> {
        let (quantum, phase) = (lattice.quantum()[axis], lattice.phase()[axis]);
        let exponent = quantum.common_exponent(phase).min(side.exponent());
        // Every coordinate is less than 2^126; a side that does not fit is more than that, as this one is.
        let side = side.scaled_to(exponent).unwrap_or(i128::MAX);
        let quantum = quantum.scaled_to(exponent).filter(|q| q >> (126 - BITS) == 0)?;
        let origin = phase.scaled_to(exponent)? - i128::from(BIAS) * quantum;
        Some(Self { quantum, origin, side })
    }

    /// The number of the square; it never decreases. `None` if it does not fit.
    fn square(&self, index: u64) -> Option<i64> {
        let units = i128::from(index) * self.quantum + self.origin;
        match (i64::try_from(units), i64::try_from(self.side)) {
            // Many times as fast.
            (Ok(units), Ok(side)) => Some(units.div_euclid(side)),
            _ => i64::try_from(units.div_euclid(self.side)).ok(),
        }
    }
}

/// Which square a point is in.
#[derive(Clone, Copy, Debug)]
struct Grid {
    side: f64,
    axes: [Ruler; 2],
}

impl Grid {
    fn new(lattice: &Lattice, side: f64) -> Result<Self, QueryError> {
        let ruler = |axis| {
            let ruler = Decimal::from_f64(side).and_then(|side| Ruler::new(lattice, axis, side));
            ruler.ok_or_else(|| refused(side, "larger: it has too many digits beside the quantum"))
        };
        Ok(Self { side, axes: [ruler(0)?, ruler(1)?] })
    }

    fn square(&self, x: u64, y: u64) -> Result<[i64; 2], QueryError> {
        let [across, up] = self.axes;
        let square = across.square(x).zip(up.square(y)).map(<[i64; 2]>::from);
        square.ok_or_else(|| refused(self.side, "larger: the numbers of its squares do not fit"))
    }

    /// The square that holds all of a box.
    fn around(&self, bounds: &LatticeBox) -> Result<Option<[i64; 2]>, QueryError> {
        let of = |p: LatticePoint| self.square(p.0[0], p.0[1]);
        let (low, high) = (of(bounds.min)?, of(bounds.max)?);
        Ok((low == high).then_some(low))
    }
}

fn refused(side: f64, expected: &'static str) -> QueryError {
    QueryError::Detail { what: "side of a square", value: side, expected }
}

impl Query {
    /// Counts the matching points in squares of this side.
    ///
    /// # Errors
    ///
    /// As [`Query::run`]; [`QueryError::Combination`] if the query has a level, a capacity or a view;
    /// [`QueryError::Detail`] if the side is not above 0, or so small that there would be more than 2^28 squares or that
    /// its digits do not fit.
    pub fn density(&self, snapshot: &Snapshot, side: f64) -> Result<Density, QueryError> {
        if self.view.is_some() || self.capacity.is_some() || self.detail != Detail::Everything {
            return Err(QueryError::Combination(
                "all points are counted; leave out the view, level, spacing, max error and capacity",
            ));
        }
        if !(f64::MIN_POSITIVE..f64::INFINITY).contains(&side) {
            return Err(refused(side, "a length above 0"));
        }
        let plan = Plan::new(self, snapshot)?;
        let grid = Grid::new(&plan.lattice, side)?;
        let (mut squares, parts) = plan.by_rows(&grid)?;
        for window in parts.chunks(plan.window()) {
            let read = plan.each(window.to_vec(), |(node, part)| plan.squares_of(node, part, &grid))?;
            for one in read {
                one.full.into_iter().for_each(|(at, square)| squares.add(at, square));
                squares.check(side)?;
            }
        }
        let first = squares.span.map_or([0; 2], |[first, _]| first);
        let size = squares.size().map(|n| n as usize);
        let height = |h| plan.lattice.world_on_axis(2, h);
        let full = squares.full.into_iter().map(|(at, Square { points, lowest, highest })| {
            let (lowest, highest) = (height(lowest), height(highest));
            DensitySquare { at, points, lowest, highest }
        });
        let mut squares: Vec<_> = full.collect();
        squares.sort_unstable_by_key(|square| [square.at[1], square.at[0]]);
        let statistics = plan.finish(super::Answer::default()).statistics;
        Ok(Density { side, first, size, squares, statistics })
    }
}

impl Plan {
    /// What the rows say, and the parts that must be read.
    fn by_rows(&self, grid: &Grid) -> Result<(Squares, Vec<(NodeIx, usize)>), QueryError> {
        let mut squares = Squares::default();
        let (mut parts, mut points) = (Vec::new(), 0);
        let heights = |points: u64, b: &LatticeBox| Square { points, lowest: b.min.0[2], highest: b.max.0[2] };
        self.walk(|node| {
            if let Some(at) = grid.around(&node.subtree_bounds)?
                && self.prospect(node, Scope::Subtree)? == Prospect::Everything
            {
                squares.add(at, heights(node.subtree_points, &node.subtree_bounds));
                squares.check(grid.side)?;
                return Ok(false);
            }
            let (Some(bounds), own) = (&node.own_bounds, self.prospect(node, Scope::Own)?) else { return Ok(true) };
            match (own, grid.around(bounds)?) {
                (Prospect::Nothing, _) => {}
                (Prospect::Everything, Some(at)) => squares.add(at, heights(node.own_points, bounds)),
                _ => {
                    Meter::add(&self.meter.nodes, 1);
                    points += node.own_points;
                    parts.extend((0..node.parts.len()).map(|part| (node.ix(), part)));
                }
            }
            Ok(true)
        })?;
        self.expects(points);
        Ok((squares, parts))
    }

    /// What a part has in each square.
    fn squares_of(&self, node: NodeIx, part: usize, grid: &Grid) -> Result<Squares, QueryError> {
        self.cancel.check()?;
        let outside = |bounds: &LatticeBox| self.region.classify(bounds) == Containment::Outside;
        let mut squares = Squares::default();
        for found in Part::at(self, node, part)?.find(&Look { skips: &outside, misses: false, positions: true })? {
            for i in found.mask.indices() {
                let [x, y, z] = found.content.positions.point(i as usize).0;
                squares.add(grid.square(x, y)?, Square { points: 1, lowest: z, highest: z });
            }
        }
        Ok(squares)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three numbers for every square between two points: gigabytes, where these are 12 km apart and squares have a side of 1.
    #[test]
    fn squares_without_points_take_no_memory_until_a_grid_is_asked_for() {
        let square = |at, points| DensitySquare { at, points, lowest: -1.0, highest: points as f64 };
        let mut density = Density {
            side: 1.0,
            first: [-3, 5],
            size: [4, 2],
            squares: vec![square([-3, 5], 7), square([0, 5], 1), square([-2, 6], 2)],
            statistics: Statistics::default(),
        };
        assert_eq!(density.grid(0, |s| s.points), [7, 0, 0, 1, 0, 2, 0, 0]);
        density.size = [12_000, 12_000];
        density.squares.push(square([11_996, 12_004], 3));
        assert_eq!(density.place(&density.squares[3]), 12_000 * 12_000 - 1);
    }

    /// All squares were gathered before their number was looked at: gigabytes, for a side in millimetres by mistake.
    #[test]
    fn a_grid_that_is_too_large_is_refused_at_the_first_points_that_show_it() {
        let square = Square { points: 1, lowest: 0, highest: 0 };
        let mut squares = Squares::default();
        for at in [[0, 0], [-7, 3], [1 << 20, 0]] {
            squares.add(at, square);
            squares.check(0.5).unwrap();
        }
        assert_eq!((squares.size(), squares.full.len()), ([(1 << 20) + 8, 4], 3));
        squares.add([0, -252], square);
        let refused = squares.check(0.5).unwrap_err().to_string();
        assert!(refused.contains("2^28") && refused.contains("0.5"), "{refused}");
        squares.add([i64::MIN, i64::MAX], square);
        assert!(squares.check(0.5).is_err());
    }

    /// Division of floats put 0.3 into square 2 of side 0.1.
    #[test]
    fn points_on_an_edge_are_in_the_square_above_it() {
        let decimal = |v: f64| Decimal::from_f64(v).unwrap();
        for (quantum, phase, side) in [
            (0.01, 0.0, 0.1),
            (0.001, 0.0, 0.3),
            (0.001, 0.0002, 1.1),
            (0.1, 0.0, 0.007),
            (2.5, 0.5, 1e300),
            (100.0, 0.0, 30.0),
        ] {
            let lattice = Lattice::new([decimal(quantum); 3], [decimal(phase); 3]).unwrap();
            let grid = Grid::new(&lattice, side).unwrap();
            for steps in (-2000_i64..2000).chain([-BIAS, BIAS, 1 << 40]) {
                let index = (BIAS + steps) as u64;
                let coordinate = lattice.decimal_on_axis(0, index);
                let [n, _] = grid.square(index, index).unwrap();
                let edge = |n: i64| Decimal::new(i128::from(n) * decimal(side).mantissa(), decimal(side).exponent());
                assert!((edge(n)..edge(n + 1)).contains(&coordinate), "{coordinate} is not in square {n} of {side}");
            }
        }
        let lattice = Lattice::uniform(0.01).unwrap();
        let square = |side, steps| Grid::new(&lattice, side).and_then(|g| g.square((BIAS + steps) as u64, BIAS as u64));
        assert_eq!(square(0.1, 30).unwrap(), [3, 0]);
        assert!(square(1e-16, 2).is_ok() && square(1e-300, 2).is_err() && square(1e-16, 1 << 40).is_err());
    }
}

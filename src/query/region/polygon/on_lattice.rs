//! Polygons on one lattice, over a range of heights: boxes are classified and points are tested.

use super::exact::{Place, REACH, side};
use super::{PLACES, Polygons};
use crate::geometry::Containment;
use crate::lattice::{BIAS, BITS, Lattice, LatticeBox, LatticePoint};
use crate::points::Positions;
use crate::query::QueryError;
use crate::query::mask::Mask;
use std::cmp::Ordering;

/// One past the greatest index.
const END: i128 = 1 << BITS;

/// A vertical prism over polygons.
#[derive(Clone, Debug)]
pub(crate) struct Prism {
    axes: [Axis; 2],
    polygons: Vec<Polygon>,
    /// The indices of its heights, the last one included; `None`: there are none.
    heights: Option<(u64, u64)>,
}

/// From an index to exact units: `(index - BIAS) * quantum + phase`.
#[derive(Clone, Copy, Debug)]
struct Axis {
    quantum: i128,
    phase: i128,
}

impl Axis {
    fn units(self, index: u64) -> i128 {
        (i128::from(index) - i128::from(BIAS)) * self.quantum + self.phase
    }

    /// The greatest index whose coordinate is at most `units`; it may lie outside the lattice.
    fn floor(self, units: i128) -> i128 {
        (units - self.phase).div_euclid(self.quantum) + i128::from(BIAS)
    }

    /// The least index whose coordinate is at least `units`.
    fn ceil(self, units: i128) -> i128 {
        -(self.phase - units).div_euclid(self.quantum) + i128::from(BIAS)
    }
}

/// One polygon: its edges, and which of them are at which height in the plan.
#[derive(Clone, Debug)]
struct Polygon {
    edges: Vec<Edge>,
    /// Of the whole polygon: the indices that can be inside.
    bounds: [(i128, i128); 2],
    /// Edges by rows of `2^shift` indices of y, from `first_row` on: those of row `i` are `listed[rows[i]..rows[i + 1]]`.
    shift: u32,
    first_row: i128,
    rows: Vec<u32>,
    listed: Vec<u32>,
}

/// An edge, from its lower end to its higher one.
#[derive(Clone, Debug)]
struct Edge {
    low: Place,
    high: Place,
    /// Indices of y at which a line to the right can meet it: from the first up to, but without, the second.
    active: (i128, i128),
    /// The least and the greatest index at most so far out on either axis as the edge reaches.
    reach: [(i128, i128); 2],
    /// In lattice steps, for the quick test: an index near `low`, `low` minus it, and `high` minus `low`.
    anchor: [i64; 2],
    rest: [f64; 2],
    along: [f64; 2],
}

impl Edge {
    fn new(axes: &[Axis; 2], a: Place, b: Place) -> Self {
        let (low, high) = if a[1] <= b[1] { (a, b) } else { (b, a) };
        let reach = std::array::from_fn(|i| {
            let (least, greatest) = (low[i].min(high[i]), low[i].max(high[i]));
            (axes[i].ceil(least), axes[i].floor(greatest))
        });
        let anchor: [i64; 2] = std::array::from_fn(|i| axes[i].floor(low[i]).clamp(-(1 << 60), 1 << 60) as i64);
        let steps = |i: usize, units: i128| units as f64 / axes[i].quantum as f64;
        let unit_at = |i: usize| (i128::from(anchor[i]) - i128::from(BIAS)) * axes[i].quantum + axes[i].phase;
        Self {
            active: (axes[1].ceil(low[1]), axes[1].ceil(high[1])),
            reach,
            anchor,
            rest: std::array::from_fn(|i| steps(i, low[i] - unit_at(i))),
            along: std::array::from_fn(|i| steps(i, high[i] - low[i])),
            low,
            high,
        }
    }

    /// On which side of the edge's line, seen along it, a point lies: `Greater` is to the left.
    #[inline]
    fn side(&self, axes: &[Axis; 2], p: [u64; 2]) -> Ordering {
        let x = (p[0] as i64 - self.anchor[0]) as f64 - self.rest[0];
        let y = (p[1] as i64 - self.anchor[1]) as f64 - self.rest[1];
        let (left, right) = (self.along[0] * y, self.along[1] * x);
        // Every number here is within a few units in the last place of what it stands for, or of one step.
        let doubt = 2e-15 * (self.along[0].abs() * (y.abs() + 1.0) + self.along[1].abs() * (x.abs() + 1.0));
        if left - right > doubt {
            Ordering::Greater
        } else if right - left > doubt {
            Ordering::Less
        } else {
            side(self.low, self.high, [axes[0].units(p[0]), axes[1].units(p[1])])
        }
    }

    /// Does a line from the point to the right meet the edge? One that lies wholly to the right is met for sure.
    #[inline]
    fn is_crossed(&self, axes: &[Axis; 2], p: [u64; 2], (x, y): (i128, i128)) -> bool {
        self.active.0 <= y
            && y < self.active.1
            && self.reach[0].1 >= x
            && (x < self.reach[0].0 || self.side(axes, p) == Ordering::Greater)
    }

    /// Can the edge have a place in common with the closed box? `false` is certain.
    fn touches(&self, axes: &[Axis; 2], bounds: &LatticeBox) -> bool {
        for i in 0..2 {
            // `reach` is empty for an edge between two indices; then it can only lie within the box or beside it.
            let (least, greatest) = (i128::from(bounds.min.0[i]), i128::from(bounds.max.0[i]));
            if self.reach[i].0 > greatest || self.reach[i].1 < least {
                return false;
            }
        }
        let corner = |i: usize| {
            let pick = |axis: usize| if i >> axis & 1 == 0 { bounds.min.0[axis] } else { bounds.max.0[axis] };
            self.side(axes, [pick(0), pick(1)])
        };
        let first = corner(0);
        first == Ordering::Equal || (1..4).any(|i| corner(i) != first)
    }
}

impl Polygon {
    fn new(axes: &[Axis; 2], rings: &[Vec<Place>]) -> Self {
        let pairs = rings.iter().flat_map(|ring| super::edges(ring));
        let edges: Vec<Edge> = pairs.map(|(a, b)| Edge::new(axes, a, b)).collect();
        let bounds = std::array::from_fn(|i| {
            let low = edges.iter().map(|e| e.reach[i].0).min().unwrap_or(0);
            (low, edges.iter().map(|e| e.reach[i].1).max().unwrap_or(-1))
        });
        // Rows as low as there are edges for, but so high that an edge is in few of them.
        let (first, last) = (bounds[1].0.clamp(0, END), bounds[1].1.clamp(-1, END - 1));
        let height = (last - first + 1).max(1);
        let mut shift = 0;
        while height >> shift > (edges.len() as i128).max(16) * 2 {
            shift += 1;
        }
        let rows_of = |e: &Edge, shift: u32| {
            // One more on both sides: an edge between two rows of points touches boxes over both.
            let (low, high) = (e.reach[1].0.min(e.reach[1].1), e.reach[1].0.max(e.reach[1].1));
            let row = |y: i128| (y.clamp(first, last.max(first)) - first) >> shift;
            (row(low), row(high))
        };
        let total = |shift: u32| edges.iter().map(|e| rows_of(e, shift)).map(|(a, b)| b - a + 1).sum::<i128>();
        while height >> shift > 1 && total(shift) > 8 * edges.len() as i128 {
            shift += 1;
        }
        let count = ((height - 1) >> shift) as usize + 1;
        let mut by_row = vec![Vec::new(); count];
        for (n, edge) in edges.iter().enumerate() {
            let (a, b) = rows_of(edge, shift);
            by_row[a as usize..=(b as usize).min(count - 1)].iter_mut().for_each(|row| row.push(n as u32));
        }
        let mut rows = vec![0];
        let mut listed = Vec::new();
        for row in by_row {
            listed.extend(row);
            rows.push(listed.len() as u32);
        }
        Self { edges, bounds, shift, first_row: first, rows, listed }
    }

    fn row(&self, y: i128) -> Option<usize> {
        let row = usize::try_from((y - self.first_row) >> self.shift).ok()?;
        (row + 1 < self.rows.len()).then_some(row)
    }

    fn edges_of_row(&self, row: usize) -> impl Iterator<Item = &Edge> {
        self.listed[self.rows[row] as usize..self.rows[row + 1] as usize].iter().map(|&n| &self.edges[n as usize])
    }

    fn within_bounds(&self, p: [u64; 2]) -> bool {
        (0..2).all(|i| (self.bounds[i].0..=self.bounds[i].1).contains(&i128::from(p[i])))
    }

    fn contains(&self, axes: &[Axis; 2], p: [u64; 2]) -> bool {
        let y = i128::from(p[1]);
        if !self.within_bounds(p) {
            return false;
        }
        let Some(row) = self.row(y) else { return false };
        let x = i128::from(p[0]);
        self.edges_of_row(row).filter(|edge| edge.is_crossed(axes, p, (x, y))).count() % 2 == 1
    }

    /// What decides about `points` points between these indices of x and of y, if looking for it is less work than testing each
    /// against the edges of its row.
    fn near(&self, points: usize, [xs, ys]: [(i128, i128); 2]) -> Option<Near<'_>> {
        let last = self.rows.len().saturating_sub(2) as i128;
        let row_of = |y: i128| ((y - self.first_row) >> self.shift).clamp(0, last);
        let (first_row, last_row) = (row_of(ys.0), row_of(ys.1));
        if (last_row - first_row + 1) * ROW_POINTS > points as i128 {
            return None;
        }
        let mut near = Near { edges: Vec::new(), inside: false, turns: Vec::new() };
        for row in first_row..=last_row {
            // An edge is in several rows: it is taken in the first.
            let begins = |e: &&Edge| row == first_row || row_of(e.reach[1].0.min(e.reach[1].1)) == row;
            let active = |e: &&Edge| e.active.0 <= ys.1 && ys.0 < e.active.1;
            for edge in self.edges_of_row(row as usize).filter(active).filter(begins) {
                if edge.reach[0].1 < xs.0 {
                    // On the left of all.
                } else if edge.reach[0].1 >= xs.1 && xs.1 < edge.reach[0].0 {
                    for turn in [edge.active.0, edge.active.1] {
                        if turn <= ys.0 {
                            near.inside = !near.inside;
                        } else if turn <= ys.1 {
                            near.turns.push(turn);
                        }
                    }
                } else {
                    near.edges.push(edge);
                }
            }
        }
        near.turns.sort_unstable();
        Some(near)
    }

    fn classify(&self, axes: &[Axis; 2], bounds: &LatticeBox) -> Containment {
        let beside =
            |i: usize| self.bounds[i].0 > i128::from(bounds.max.0[i]) || self.bounds[i].1 < i128::from(bounds.min.0[i]);
        if beside(0) || beside(1) {
            return Containment::Outside;
        }
        let last = self.rows.len().saturating_sub(2);
        let row = |y: u64| ((i128::from(y) - self.first_row) >> self.shift).clamp(0, last as i128) as usize;
        for row in row(bounds.min.0[1])..=row(bounds.max.0[1]) {
            if self.edges_of_row(row).any(|e| e.touches(axes, bounds)) {
                return Containment::Partly;
            }
        }
        // No edge comes between any two points of the box.
        let [x, y, _] = bounds.min.0;
        if self.contains(axes, [x, y]) { Containment::Inside } else { Containment::Outside }
    }
}

/// What is needed of a polygon for points that lie together: of tens of thousands of edges at their height most are on one
/// side of all of them.
struct Near<'p> {
    /// Edges that may be on either side.
    edges: Vec<&'p Edge>,
    /// Is the least y inside, as far as the edges on the right of all points decide it?
    inside: bool,
    /// Where that turns, ascending.
    turns: Vec<i128>,
}

impl Near<'_> {
    fn contains(&self, axes: &[Axis; 2], p: [u64; 2]) -> bool {
        let (x, y) = (i128::from(p[0]), i128::from(p[1]));
        let crossed = self.edges.iter().filter(|edge| edge.is_crossed(axes, p, (x, y))).count();
        let turned = self.turns.partition_point(|turn| *turn <= y);
        self.inside ^ ((crossed + turned) % 2 == 1)
    }
}

/// Going through the edges of a row costs as much as testing so many points against them.
const ROW_POINTS: i128 = 4;

impl Prism {
    /// The prism over `polygons` at heights `[min, max)`.
    ///
    /// # Errors
    ///
    /// [`QueryError::Region`] if the lattice has so many decimals that the two do not fit 128 bits.
    pub fn new(polygons: &Polygons, heights: [f64; 2], lattice: &Lattice) -> Result<Self, QueryError> {
        let exponents = (0..2).map(|i| lattice.quantum()[i].common_exponent(lattice.phase()[i]));
        let exponent = exponents.fold(-PLACES, i32::min);
        let too_fine =
            || QueryError::Region("the store's lattice has too many decimals for a polygon this large".into());
        let factor =
            u32::try_from(-PLACES - exponent).ok().and_then(|e| 10_i128.checked_pow(e)).ok_or_else(too_fine)?;
        let axis = |i: usize| {
            let quantum = lattice.quantum()[i].scaled_to(exponent).filter(|&q| 0 < q && q < REACH >> BITS)?;
            Some(Axis { quantum, phase: lattice.phase()[i].scaled_to(exponent)? })
        };
        let axes = [axis(0).ok_or_else(too_fine)?, axis(1).ok_or_else(too_fine)?];
        let scaled = |p: &Place| {
            let coordinate = |v: i128| v.checked_mul(factor).filter(|v| v.abs() < REACH);
            Some([coordinate(p[0])?, coordinate(p[1])?])
        };
        let mut on_lattice = Vec::with_capacity(polygons.polygons.len());
        for rings in &polygons.polygons {
            let rings: Option<Vec<Vec<Place>>> = rings.iter().map(|r| r.iter().map(scaled).collect()).collect();
            on_lattice.push(Polygon::new(&axes, &rings.ok_or_else(too_fine)?));
        }
        let first = lattice.first_index_at_least(2, heights[0]);
        let end = lattice.first_index_at_least(2, heights[1]).unwrap_or(1 << BITS);
        let heights = first.zip(end.checked_sub(1)).filter(|(first, last)| first <= last);
        Ok(Self { axes, polygons: on_lattice, heights })
    }

    pub fn classify(&self, bounds: &LatticeBox) -> Containment {
        let Some((first, last)) = self.heights else { return Containment::Outside };
        if bounds.max.0[2] < first || last < bounds.min.0[2] {
            return Containment::Outside;
        }
        let mut answer = Containment::Outside;
        for polygon in &self.polygons {
            match polygon.classify(&self.axes, bounds) {
                Containment::Inside => {
                    answer = Containment::Inside;
                    break;
                }
                Containment::Partly => answer = Containment::Partly,
                Containment::Outside => {}
            }
        }
        let within_heights = first <= bounds.min.0[2] && bounds.max.0[2] <= last;
        if answer == Containment::Inside && !within_heights { Containment::Partly } else { answer }
    }

    pub fn contains(&self, point: LatticePoint) -> bool {
        let [x, y, z] = point.0;
        self.heights.is_some_and(|(first, last)| (first..=last).contains(&z))
            && self.polygons.iter().any(|p| p.contains(&self.axes, [x, y]))
    }

    pub fn test(&self, positions: &Positions) -> Mask {
        let Some((first, last)) = self.heights else { return Mask::none(positions.len()) };
        let span = |values: &[u64]| {
            values.iter().fold((i128::MAX, i128::MIN), |(a, b), &v| (a.min(v.into()), b.max(v.into())))
        };
        let spans = [span(&positions.x), span(&positions.y)];
        let near = |p: &&Polygon| (0..2).all(|i| p.bounds[i].0 <= spans[i].1 && spans[i].0 <= p.bounds[i].1);
        let at_height = |i: usize| (first..=last).contains(&positions.z[i]);
        let polygons = self.polygons.iter().filter(near);
        let polygons: Vec<_> = polygons.map(|p| (p, p.near(positions.len(), spans))).collect();
        let inside = |p: [u64; 2]| {
            polygons.iter().any(|(polygon, near)| match near {
                Some(near) => polygon.within_bounds(p) && near.contains(&self.axes, p),
                None => polygon.contains(&self.axes, p),
            })
        };
        Mask::where_index(positions.len(), |i| at_height(i) && inside([positions.x[i], positions.y[i]]))
    }
}

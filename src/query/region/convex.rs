//! Half-spaces on a lattice: oriented boxes and frusta.

use crate::geometry::{Containment, Convex};
use crate::lattice::{BIAS, BITS, Lattice, LatticeBox, LatticePoint};

/// A convex set, with what decides most points without forming their world coordinates.
#[derive(Clone, Debug)]
pub(super) struct HalfSpaces {
    lattice: Lattice,
    convex: Convex,
    /// A lattice index near the origin, and the origin minus that index's world coordinate.
    anchor: [i64; 3],
    rest: [f64; 3],
    quantum: [f64; 3],
    /// Of each half-space: what two ways of computing its value can differ by, at the origin and per unit of distance.
    doubt: Vec<(f64, f64)>,
}

impl HalfSpaces {
    pub fn new(lattice: &Lattice, convex: &Convex) -> Self {
        let origin = convex.origin();
        let anchor: [i64; 3] = std::array::from_fn(|i| {
            let beyond = if origin[i] < lattice.world_on_axis(i, BIAS as u64) { 0 } else { (1 << BITS) - 1 };
            lattice.nearest_index(i, origin[i]).unwrap_or(beyond) as i64
        });
        let rest = std::array::from_fn(|i| origin[i] - lattice.world_on_axis(i, anchor[i] as u64));
        // A few roundings of numbers as large as a coordinate; the distance is added for each point.
        let doubt = convex.halves().iter().map(|half| {
            let terms = half.normal.iter().zip(origin).map(|(n, o)| n.abs() * (o.abs() + 1e-300)).sum::<f64>();
            let steepest = half.normal.iter().fold(0.0_f64, |a, n| a.max(n.abs()));
            (1e-14 * (terms + half.offset.abs()), 1e-14 * steepest)
        });
        Self {
            lattice: lattice.clone(),
            convex: convex.clone(),
            anchor,
            rest,
            quantum: lattice.quantum_f64(),
            doubt: doubt.collect(),
        }
    }

    /// The documented test.
    pub fn contains(&self, point: LatticePoint) -> bool {
        self.convex.contains(self.lattice.world_from_lattice(point))
    }

    /// The same answer, mostly without forming world coordinates.
    #[inline]
    pub fn contains_fast(&self, point: LatticePoint) -> bool {
        let d: [f64; 3] =
            std::array::from_fn(|i| (point.0[i] as i64 - self.anchor[i]) as f64 * self.quantum[i] - self.rest[i]);
        let size = d[0].abs() + d[1].abs() + d[2].abs();
        for (half, (fixed, by_size)) in self.convex.halves().iter().zip(&self.doubt) {
            let value = half.value(d);
            let doubt = fixed + by_size * size;
            if value < -doubt {
                return false;
            }
            if !(value > doubt) {
                return self.contains(point);
            }
        }
        true
    }

    /// Every step of the test is monotonic in each coordinate, rounding included: so the corners decide for each half-space.
    pub fn classify(&self, bounds: &LatticeBox) -> Containment {
        let origin = self.convex.origin();
        let relative = |p: LatticePoint| -> [f64; 3] {
            let world = self.lattice.world_from_lattice(p);
            std::array::from_fn(|i| world[i] - origin[i])
        };
        let (low, high) = (relative(bounds.min), relative(bounds.max));
        let mut answer = Containment::Inside;
        for half in self.convex.halves() {
            let towards =
                |up: bool| std::array::from_fn(|i| if (half.normal[i] > 0.0) == up { high[i] } else { low[i] });
            if !half.holds(half.value(towards(true))) {
                return Containment::Outside;
            }
            if !half.holds(half.value(towards(false))) {
                answer = Containment::Partly;
            }
        }
        answer
    }
}

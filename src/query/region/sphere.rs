//! Balls on a lattice.

use crate::geometry::Containment;
use crate::lattice::{BIAS, BITS, Lattice, LatticeBox, LatticePoint};

/// A ball, with what decides most points in a few operations.
#[derive(Clone, Debug)]
pub(super) struct Sphere {
    lattice: Lattice,
    center: [f64; 3],
    square: f64,
    /// A lattice index near the centre, and the centre minus that index's world coordinate.
    anchor: [i64; 3],
    rest: [f64; 3],
    quantum: [f64; 3],
    /// Squared distances, computed from the anchor, below and above which [`Sphere::contains`] is certain.
    surely_inside: f64,
    surely_outside: f64,
}

impl Sphere {
    pub fn new(lattice: &Lattice, center: [f64; 3], radius: f64) -> Self {
        let anchor: [i64; 3] = std::array::from_fn(|i| {
            let beyond = if center[i] < lattice.world_on_axis(i, BIAS as u64) { 0 } else { (1 << BITS) - 1 };
            lattice.nearest_index(i, center[i]).unwrap_or(beyond) as i64
        });
        let rest = std::array::from_fn(|i| center[i] - lattice.world_on_axis(i, anchor[i] as u64));
        // What the two ways of computing a distance can differ by: a few roundings of numbers of this size.
        let size = center.iter().map(|c| c.abs()).fold(radius, f64::max) + radius;
        let error = size * 1e-14;
        let (inner, outer) = ((radius - error).max(0.0), radius + error);
        Self {
            lattice: lattice.clone(),
            center,
            square: radius * radius,
            anchor,
            rest,
            quantum: lattice.quantum_f64(),
            surely_inside: inner * inner * (1.0 - 1e-12),
            surely_outside: outer * outer * (1.0 + 1e-12),
        }
    }

    /// The documented test.
    pub fn contains(&self, point: LatticePoint) -> bool {
        self.passes(std::array::from_fn(|i| self.lattice.world_on_axis(i, point.0[i]) - self.center[i]))
    }

    fn passes(&self, [dx, dy, dz]: [f64; 3]) -> bool {
        (dx * dx + dy * dy) + dz * dz <= self.square
    }

    /// The same answer, mostly without forming world coordinates.
    #[inline]
    pub fn contains_fast(&self, point: LatticePoint) -> bool {
        let d: [f64; 3] =
            std::array::from_fn(|i| (point.0[i] as i64 - self.anchor[i]) as f64 * self.quantum[i] - self.rest[i]);
        let square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
        if square < self.surely_inside {
            true
        } else if square > self.surely_outside {
            false
        } else {
            self.contains(point)
        }
    }

    /// Every step of the test is monotonic in the distance on each axis, rounding included: so the corners decide.
    pub fn classify(&self, bounds: &LatticeBox) -> Containment {
        let (mut nearest, mut farthest) = ([0.0; 3], [0.0; 3]);
        for i in 0..3 {
            let low = self.lattice.world_on_axis(i, bounds.min.0[i]) - self.center[i];
            let high = self.lattice.world_on_axis(i, bounds.max.0[i]) - self.center[i];
            nearest[i] = low.max(-high).max(0.0);
            farthest[i] = high.max(-low);
        }
        if !self.passes(nearest) {
            Containment::Outside
        } else if self.passes(farthest) {
            Containment::Inside
        } else {
            Containment::Partly
        }
    }
}

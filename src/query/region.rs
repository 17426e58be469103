//! Where: regions in world coordinates, decided on the lattice.

use super::QueryError;
use super::mask::Mask;
use crate::geometry::Containment;
use crate::lattice::{BIAS, BITS, Lattice, LatticeBox, LatticePoint};
use crate::points::Positions;

/// A set of places in world coordinates.
///
/// A region classifies cubes and tests points, and the two agree: a cube that is outside holds no point that passes.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub enum Region {
    /// Everywhere.
    #[default]
    Everything,
    /// The half-open box `[min, max)`: neighbouring boxes share no point. Faces may be infinite; they are the shortest
    /// decimals of their numbers, and are compared with the points' exact decimals.
    Box {
        /// The low corner, inside.
        min: [f64; 3],
        /// The high corner, outside.
        max: [f64; 3],
    },
    /// The closed ball: a point is inside iff `(dx * dx + dy * dy) + dz * dz <= radius * radius` in f64, where
    /// `dx = x - center[0]` and `x` is the point's world coordinate as [`Lattice::world_from_lattice`] gives it.
    Sphere {
        /// The centre.
        center: [f64; 3],
        /// The radius.
        radius: f64,
    },
}

impl Region {
    /// The box `[min, max)`.
    ///
    /// # Errors
    ///
    /// [`QueryError::Region`] if a number is NaN or a minimum is above its maximum. Equal faces make an empty box.
    pub fn new_box(min: [f64; 3], max: [f64; 3]) -> Result<Self, QueryError> {
        for axis in 0..3 {
            if !(..=max[axis]).contains(&min[axis]) {
                let (low, high) = (min[axis], max[axis]);
                let axis = ["x", "y", "z"][axis];
                return Err(QueryError::Region(format!(
                    "the box has {axis} from {low} to {high}; give the smaller number first"
                )));
            }
        }
        Ok(Self::Box { min, max })
    }

    /// The closed ball.
    ///
    /// # Errors
    ///
    /// [`QueryError::Region`] unless the centre is finite and the radius is 0 or more.
    pub fn new_sphere(center: [f64; 3], radius: f64) -> Result<Self, QueryError> {
        if center.iter().any(|c| !c.is_finite()) {
            return Err(QueryError::Region("the centre of the sphere must be three finite numbers".into()));
        }
        if !(0.0..).contains(&radius) {
            return Err(QueryError::Region(format!("the radius of the sphere is {radius}; it must be 0 or more")));
        }
        Ok(Self::Sphere { center, radius })
    }

    /// Reads `X0,Y0,X1,Y1` (any z) or `X0,Y0,Z0,X1,Y1,Z1`; `inf` and `-inf` are numbers.
    ///
    /// # Errors
    ///
    /// [`QueryError::Region`] for other counts and as [`Region::new_box`].
    pub fn parse_box(text: &str) -> Result<Self, QueryError> {
        let inf = f64::INFINITY;
        match numbers(text)?.as_slice() {
            &[x0, y0, x1, y1] => Self::new_box([x0, y0, -inf], [x1, y1, inf]),
            &[x0, y0, z0, x1, y1, z1] => Self::new_box([x0, y0, z0], [x1, y1, z1]),
            other => Err(QueryError::Region(format!(
                "a box has 4 numbers X0,Y0,X1,Y1 or 6 numbers X0,Y0,Z0,X1,Y1,Z1; there are {}",
                other.len()
            ))),
        }
    }

    /// Reads `X,Y,Z,R`.
    ///
    /// # Errors
    ///
    /// [`QueryError::Region`] for other counts and as [`Region::new_sphere`].
    pub fn parse_sphere(text: &str) -> Result<Self, QueryError> {
        match numbers(text)?.as_slice() {
            &[x, y, z, radius] => Self::new_sphere([x, y, z], radius),
            other => Err(QueryError::Region(format!("a sphere has 4 numbers X,Y,Z,R; there are {}", other.len()))),
        }
    }

    /// The same with its maximum faces: a box that is one lattice step larger where points can lie exactly on the face.
    #[must_use]
    pub fn closed_on(&self, lattice: &Lattice) -> Self {
        let Self::Box { min, max } = *self else { return self.clone() };
        let last = (1 << BITS) - 1;
        let max = std::array::from_fn(|axis| match lattice.first_index_at_least(axis, max[axis]) {
            // Only a point exactly on the face is new; the next step lies outside of it anyway.
            Some(index) if index < last && lattice.world_on_axis(axis, index) <= max[axis] => {
                lattice.world_on_axis(axis, index + 1)
            }
            _ => max[axis],
        });
        Self::Box { min, max }
    }

    /// The region on a lattice.
    pub fn on_lattice(&self, lattice: &Lattice) -> LatticeRegion {
        let kind = match *self {
            Self::Everything => Kind::Everything,
            Self::Box { min, max } => lattice.box_from_world(min, max).map_or(Kind::Nothing, Kind::Box),
            Self::Sphere { radius, .. } if radius == f64::INFINITY => Kind::Everything,
            Self::Sphere { center, radius } => Kind::Sphere(Box::new(Sphere::new(lattice, center, radius))),
        };
        LatticeRegion { kind }
    }
}

fn numbers(text: &str) -> Result<Vec<f64>, QueryError> {
    let number = |part: &str| {
        let part = part.trim();
        part.parse::<f64>()
            .ok()
            .filter(|n| !n.is_nan())
            .ok_or_else(|| QueryError::Region(format!("\"{part}\" is not a number")))
    };
    text.split(',').map(number).collect()
}

/// A region on one lattice, ready to classify cubes and to test points.
#[derive(Clone, Debug)]
pub struct LatticeRegion {
    kind: Kind,
}

#[derive(Clone, Debug)]
enum Kind {
    Everything,
    Nothing,
    Box(LatticeBox),
    Sphere(Box<Sphere>),
}

impl LatticeRegion {
    /// Does it hold everything, whatever the points?
    pub fn is_everything(&self) -> bool {
        matches!(self.kind, Kind::Everything)
    }

    /// How all the lattice points of `bounds` lie to the region. `Outside` and `Inside` are certain.
    pub fn classify(&self, bounds: &LatticeBox) -> Containment {
        match &self.kind {
            Kind::Everything => Containment::Inside,
            Kind::Nothing => Containment::Outside,
            Kind::Box(region) if region.contains_box(bounds) => Containment::Inside,
            Kind::Box(region) if !region.meets(bounds) => Containment::Outside,
            Kind::Box(_) => Containment::Partly,
            Kind::Sphere(sphere) => sphere.classify(bounds),
        }
    }

    /// Is the point inside?
    pub fn contains(&self, point: LatticePoint) -> bool {
        match &self.kind {
            Kind::Everything => true,
            Kind::Nothing => false,
            Kind::Box(region) => region.contains(point),
            Kind::Sphere(sphere) => sphere.contains(point),
        }
    }

    /// The points that are inside.
    pub(crate) fn test(&self, positions: &Positions) -> Mask {
        match &self.kind {
            Kind::Everything => Mask::all(positions.len()),
            Kind::Nothing => Mask::none(positions.len()),
            Kind::Box(region) => {
                let axis = |i: usize, values: &[u64]| {
                    let (min, span) = (region.min.0[i], region.max.0[i] - region.min.0[i]);
                    Mask::where_each(values, |v: u64| v.wrapping_sub(min) <= span)
                };
                let mut mask = axis(0, &positions.x);
                mask.and(&axis(1, &positions.y));
                mask.and(&axis(2, &positions.z));
                mask
            }
            Kind::Sphere(sphere) => Mask::where_index(positions.len(), |i| sphere.contains_fast(positions.point(i))),
        }
    }
}

/// A ball, with what decides most points in a few operations.
#[derive(Clone, Debug)]
struct Sphere {
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
    fn new(lattice: &Lattice, center: [f64; 3], radius: f64) -> Self {
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
    fn contains(&self, point: LatticePoint) -> bool {
        self.passes(std::array::from_fn(|i| self.lattice.world_on_axis(i, point.0[i]) - self.center[i]))
    }

    fn passes(&self, [dx, dy, dz]: [f64; 3]) -> bool {
        (dx * dx + dy * dy) + dz * dz <= self.square
    }

    /// The same answer, mostly without forming world coordinates.
    #[inline]
    fn contains_fast(&self, point: LatticePoint) -> bool {
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
    fn classify(&self, bounds: &LatticeBox) -> Containment {
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn lattice() -> impl Strategy<Value = Lattice> {
        prop::sample::select(vec![1e-6, 0.001, 0.01, 0.3, 1000.0]).prop_map(|q| Lattice::uniform(q).unwrap())
    }

    /// Points and boxes near the biased origin, so that small regions meet them.
    fn near() -> impl Strategy<Value = LatticePoint> {
        prop::array::uniform3(-40_i64..40).prop_map(|p| LatticePoint(p.map(|c| (c + BIAS) as u64)))
    }

    fn region() -> impl Strategy<Value = (Lattice, Region)> {
        let corner = || prop::array::uniform3(prop_oneof![-45_i32..45, Just(i32::MIN), Just(i32::MAX)]);
        (lattice(), corner(), corner(), 0_u8..3, prop::sample::select(vec![0.0, 0.5, 0.1])).prop_map(
            |(lattice, a, b, kind, part)| {
                let q = lattice.largest_quantum();
                let world = |c: i32| match c {
                    i32::MIN => f64::NEG_INFINITY,
                    i32::MAX => f64::INFINITY,
                    c => (f64::from(c) + part) * q,
                };
                let (a3, b3) = (a.map(world), b.map(world));
                let region = match kind {
                    0 => Region::Everything,
                    1 => {
                        let min = std::array::from_fn(|i| a3[i].min(b3[i]));
                        Region::new_box(min, std::array::from_fn(|i| a3[i].max(b3[i]))).unwrap()
                    }
                    _ => {
                        let center = a3.map(|c| if c.is_finite() { c } else { 1e9 * q });
                        Region::new_sphere(center, b3[0].abs()).unwrap()
                    }
                };
                (lattice, region)
            },
        )
    }

    proptest! {
        #[test]
        fn cubes_and_points_agree(
            (lattice, region) in region(), a in near(), b in near(), t in prop::collection::vec(near(), 1..60)
        ) {
            let on = region.on_lattice(&lattice);
            let bounds = LatticeBox::of(a).with(b);
            let mut points: Vec<LatticePoint> = t;
            points.extend([bounds.min, bounds.max, a, b]);
            let mask = on.test(&points.iter().copied().collect());
            for (i, &p) in points.iter().enumerate() {
                let w = lattice.world_from_lattice(p);
                let naive = match region {
                    Region::Box { min, max } => {
                        let exact = |v: f64| crate::lattice::Decimal::from_f64(v);
                        (0..3).all(|i| {
                            let d = lattice.decimal_on_axis(i, p.0[i]);
                            exact(min[i]).map_or(min[i] < 0.0, |m| m <= d) && exact(max[i]).map_or(max[i] > 0.0, |m| d < m)
                        })
                    }
                    Region::Sphere { center, radius } => {
                        let d: [f64; 3] = std::array::from_fn(|i| w[i] - center[i]);
                        (d[0] * d[0] + d[1] * d[1]) + d[2] * d[2] <= radius * radius
                    }
                    Region::Everything => true,
                };
                prop_assert_eq!(on.contains(p), naive);
                prop_assert_eq!(mask.contains(i), naive);
                if bounds.contains(p) {
                    match on.classify(&bounds) {
                        Containment::Inside => prop_assert!(naive),
                        Containment::Outside => prop_assert!(!naive),
                        Containment::Partly => {}
                    }
                }
            }
        }
    }

    #[test]
    fn a_sphere_far_from_the_origin_is_decided_by_the_documented_test() {
        let lattice = Lattice::uniform(1e-4).unwrap();
        let center = [4_321_987.654_3, -1_234_567.890_1, 12.5];
        let middle = lattice.lattice_from_world(center).unwrap();
        let sphere = Region::new_sphere(center, 0.001).unwrap().on_lattice(&lattice);
        let mut points = Vec::new();
        for step in 0..21_u64.pow(3) {
            let offset = [step % 21, step / 21 % 21, step / 441];
            points.push(LatticePoint(std::array::from_fn(|i| middle.0[i] + offset[i] - 10)));
        }
        let mask = sphere.test(&points.iter().copied().collect());
        assert!(points.iter().enumerate().all(|(i, &p)| mask.contains(i) == sphere.contains(p)));
        assert!(mask.count() > 3000 && mask.count() < 5000, "{}", mask.count());
    }

    #[test]
    fn regions_are_read_from_text_and_refused_with_a_reason() {
        let inf = f64::INFINITY;
        let plan = Region::parse_box("-1, -2.5, inf, 4").unwrap();
        assert_eq!(plan, Region::Box { min: [-1.0, -2.5, -inf], max: [inf, 4.0, inf] });
        assert!(Region::parse_box("0,0,0,0,0,0").is_ok());
        for bad in ["", "1,2,3", "1,2,3,4,5", "1,2,x,4", "nan,0,1,1", "3,0,1,1"] {
            assert!(Region::parse_box(bad).is_err(), "{bad}");
        }
        assert_eq!(Region::parse_sphere("1,2,3,4").unwrap(), Region::Sphere { center: [1.0, 2.0, 3.0], radius: 4.0 });
        for bad in ["1,2,3", "1,2,3,-4", "inf,2,3,4", "1,2,3,nan"] {
            assert!(Region::parse_sphere(bad).is_err(), "{bad}");
        }
    }
}

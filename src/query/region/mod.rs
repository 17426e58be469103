//! Where: regions in world coordinates, decided on the lattice.

mod convex;
mod on_lattice;
mod parse;
mod polygon;
mod sphere;
#[cfg(test)]
mod tests;
mod units;
mod view;

use super::QueryError;
use crate::geometry::{Camera, ClipDepth, Convex, DMat4};
use crate::lattice::Lattice;
pub use on_lattice::LatticeRegion;
pub use polygon::Polygons;
use std::sync::Arc;

/// A set of places in world coordinates.
///
/// A region classifies cubes and tests points, and the two agree: a cube that is outside holds no point that passes, one
/// that is inside none that fails.
///
/// ```
/// use esker::query::Region;
///
/// let plot = Region::parse_polygon("POLYGON ((0 0, 50 0, 50 30, 0 30, 0 0), (10 10, 20 10, 20 20, 10 20, 10 10))", [0.0, 40.0])?;
/// let tree = Region::new_sphere([12.0, 5.0, 8.0], 3.0)?;
/// let region = Region::all([plot, tree.inverted()]);
/// // The same in words.
/// let same = Region::parse(
///     "polygon((0 0, 50 0, 50 30, 0 30, 0 0), (10 10, 20 10, 20 20, 10 20, 10 10)) and z(0, 40) and not sphere(12, 5, 8, 3)",
/// )?;
/// # let lattice = esker::lattice::Lattice::uniform(0.01)?;
/// # let (a, b) = (region.on_lattice(&lattice)?, same.on_lattice(&lattice)?);
/// # let p = |x, y, z| lattice.lattice_from_world([x, y, z]).unwrap();
/// # for (q, inside) in [(p(5.0, 5.0, 3.0), true), (p(15.0, 15.0, 3.0), false), (p(12.0, 5.0, 8.0), false), (p(5.0, 5.0, 40.0), false)] {
/// #     assert!(a.contains(q) == inside && b.contains(q) == inside);
/// # }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
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
    /// An intersection of half-spaces, an oriented box or a frustum: a point is inside iff [`Convex::contains`] says so of its
    /// world coordinates.
    Convex(Convex),
    /// What stands over polygons at heights `[z[0], z[1])`. Decided exactly, like a box: neighbours that share an edge share
    /// no point.
    Prism {
        /// The polygons in the plan.
        area: Arc<Polygons>,
        /// The lowest height, inside, and the highest, outside; they may be infinite.
        z: [f64; 2],
    },
    /// What is in all of these; of none, everything.
    All(Vec<Region>),
    /// What is in one of these at least; of none, nothing.
    Any(Vec<Region>),
    /// What is not in this.
    Not(Box<Region>),
}

impl Region {
    /// The box `[min, max)`.
    ///
    /// # Errors
    ///
    /// [`QueryError::Region`] if a number is NaN or a minimum is above its maximum. Equal faces make an empty box.
    pub fn new_box(min: [f64; 3], max: [f64; 3]) -> Result<Self, QueryError> {
        for axis in 0..3 {
            ordered(["x", "y", "z"][axis], "box", min[axis], max[axis])?;
        }
        Ok(Self::Box { min, max })
    }

    /// All places of heights `[min, max)`.
    ///
    /// # Errors
    ///
    /// As [`Region::new_box`].
    pub fn new_heights(min: f64, max: f64) -> Result<Self, QueryError> {
        let inf = f64::INFINITY;
        Self::new_box([-inf, -inf, min], [inf, inf, max])
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

    /// A box of full side lengths `size` about `center`, turned by yaw, pitch and roll in degrees
    /// ([`Convex::oriented_box`]); half-open along its own axes.
    ///
    /// # Errors
    ///
    /// [`QueryError::Region`] for a number that is not finite and for a negative side.
    pub fn new_oriented_box(center: [f64; 3], size: [f64; 3], rotation_deg: [f64; 3]) -> Result<Self, QueryError> {
        if let Some(side) = size.iter().find(|s| !(0.0..).contains(*s)) {
            return Err(QueryError::Region(format!("a side of the oriented box is {side}; it must be 0 or more")));
        }
        let finite = "the centre, sides and angles of an oriented box must be finite numbers";
        let convex = Convex::oriented_box(center, size, rotation_deg);
        convex.map(Self::Convex).ok_or_else(|| QueryError::Region(finite.into()))
    }

    /// What stands over polygons at heights `[z[0], z[1])`.
    ///
    /// # Errors
    ///
    /// [`QueryError::Region`] if a height is NaN or the first is above the second.
    pub fn new_prism(area: Polygons, z: [f64; 2]) -> Result<Self, QueryError> {
        ordered("z", "prism", z[0], z[1])?;
        Ok(Self::Prism { area: Arc::new(area), z })
    }

    /// What can be on a camera's image, at any distance that its planes allow.
    pub fn new_frustum(camera: &Camera) -> Self {
        Self::Convex(Convex::of_camera(camera))
    }

    /// What a clip matrix of world coordinates (column vectors) keeps.
    ///
    /// # Errors
    ///
    /// [`QueryError::Region`] if a number is not finite or beyond 1e100.
    pub fn new_clip_matrix(clip_from_world: DMat4, depth: ClipDepth) -> Result<Self, QueryError> {
        let convex = Convex::from_clip_matrix(clip_from_world, depth);
        convex.map(Self::Convex).ok_or_else(|| QueryError::Region("the clip matrix must be 16 finite numbers".into()))
    }

    /// What is in all of these.
    pub fn all(regions: impl IntoIterator<Item = Self>) -> Self {
        let mut regions: Vec<_> = regions.into_iter().filter(|r| *r != Self::Everything).collect();
        match regions.len() {
            0 => Self::Everything,
            1 => regions.remove(0),
            _ => Self::All(regions),
        }
    }

    /// What is in one of these at least.
    pub fn any(regions: impl IntoIterator<Item = Self>) -> Self {
        let mut regions: Vec<_> = regions.into_iter().collect();
        if regions.len() == 1 { regions.remove(0) } else { Self::Any(regions) }
    }

    /// What is not in this.
    #[must_use]
    pub fn inverted(self) -> Self {
        Self::Not(Box::new(self))
    }

    /// Are its numbers as the constructors ask for? The variants can be made without these.
    fn check(&self) -> Result<(), QueryError> {
        match self {
            Self::Box { min, max } => Self::new_box(*min, *max).map(drop),
            Self::Sphere { center, radius } => Self::new_sphere(*center, *radius).map(drop),
            Self::Prism { z, .. } => ordered("z", "prism", z[0], z[1]),
            _ => Ok(()),
        }
    }

    /// Is it a box, or what is in one of several?
    pub(crate) fn is_of_boxes(&self) -> bool {
        match self {
            Self::Box { .. } => true,
            Self::Any(terms) => !terms.is_empty() && terms.iter().all(Self::is_of_boxes),
            _ => false,
        }
    }

    /// The axis, 0 to 2, on which a box ends where it begins, so that it holds nothing without its maximum faces.
    pub fn empty_axis(&self) -> Option<usize> {
        let Self::Box { min, max } = self else { return None };
        (0..3).find(|&axis| min[axis] == max[axis])
    }

    /// The same with the maximum faces of its boxes: a box is one lattice step larger where points can lie exactly on a face, a
    /// turned one has all its faces. Other shapes, and boxes in an inverted region, stay as they are.
    #[must_use]
    pub fn closed_on(&self, lattice: &Lattice) -> Self {
        let each = |terms: &[Self]| terms.iter().map(|t| t.closed_on(lattice)).collect();
        let (min, max) = match self {
            Self::Box { min, max } => (*min, *max),
            Self::Convex(convex) => return Self::Convex(convex.closed()),
            Self::All(terms) => return Self::All(each(terms)),
            Self::Any(terms) => return Self::Any(each(terms)),
            other => return other.clone(),
        };
        // The decimal of a point on a face may have more digits than a float: whoever reads it as a float means that point.
        let as_float = |axis, index| {
            let nearest = lattice.decimal_on_axis(axis, index).to_f64();
            nearest.min(lattice.world_on_axis(axis, index))
        };
        let max = std::array::from_fn(|axis| match lattice.first_index_at_least(axis, max[axis]) {
            // Only a point on the face is new; the next step lies outside of it anyway.
            Some(index) if as_float(axis, index) <= max[axis] => lattice.face_at(axis, index + 1),
            _ => max[axis],
        });
        Self::Box { min, max }
    }

    /// The region on a lattice.
    ///
    /// # Errors
    ///
    /// [`QueryError::Region`] if a polygon does not fit the exact arithmetic: on a lattice of more than 19 decimals.
    pub fn on_lattice(&self, lattice: &Lattice) -> Result<LatticeRegion, QueryError> {
        LatticeRegion::new(self, lattice)
    }
}

/// NaN is in no order.
fn ordered(axis: &str, shape: &str, low: f64, high: f64) -> Result<(), QueryError> {
    if (..=high).contains(&low) {
        return Ok(());
    }
    Err(QueryError::Region(format!("the {shape} has {axis} from {low} to {high}; give the smaller number first")))
}

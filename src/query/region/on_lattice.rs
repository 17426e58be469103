//! A region on one lattice, ready to classify boxes and to test points.

use super::Region;
use super::convex::HalfSpaces;
use super::polygon::Prism;
use super::sphere::Sphere;
use crate::geometry::Containment;
use crate::lattice::{Lattice, LatticeBox, LatticePoint};
use crate::points::Positions;
use crate::query::QueryError;
use crate::query::mask::Mask;

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
    Convex(Box<HalfSpaces>),
    Prism(Box<Prism>),
    All(Vec<Kind>),
    Any(Vec<Kind>),
    Not(Box<Kind>),
}

impl LatticeRegion {
    pub(super) fn new(region: &Region, lattice: &Lattice) -> Result<Self, QueryError> {
        Ok(Self { kind: Kind::new(region, lattice)? })
    }

    /// Does it hold everything, whatever the points?
    pub fn is_everything(&self) -> bool {
        matches!(self.kind, Kind::Everything)
    }

    /// How all the lattice points of `bounds` lie to the region. `Outside` and `Inside` are certain.
    pub fn classify(&self, bounds: &LatticeBox) -> Containment {
        self.kind.classify(bounds)
    }

    /// Is the point inside?
    pub fn contains(&self, point: LatticePoint) -> bool {
        self.kind.contains(point)
    }

    /// The points that are inside, of some that `bounds` holds.
    pub(crate) fn test(&self, positions: &Positions, bounds: &LatticeBox) -> Mask {
        self.kind.test(positions, bounds)
    }

    /// The box, if it is one.
    pub(crate) fn as_box(&self) -> Option<&LatticeBox> {
        match &self.kind {
            Kind::Box(region) => Some(region),
            _ => None,
        }
    }
}

impl Kind {
    fn new(region: &Region, lattice: &Lattice) -> Result<Self, QueryError> {
        let each = |terms: &[Region]| terms.iter().map(|t| Self::new(t, lattice)).collect::<Result<Vec<_>, _>>();
        region.check()?;
        Ok(match region {
            Region::Everything => Self::Everything,
            Region::Box { min, max } => lattice.box_from_world(*min, *max).map_or(Self::Nothing, Self::Box),
            Region::Sphere { radius, .. } if *radius == f64::INFINITY => Self::Everything,
            Region::Sphere { center, radius } => Self::Sphere(Box::new(Sphere::new(lattice, *center, *radius))),
            Region::Convex(convex) => Self::Convex(Box::new(HalfSpaces::new(lattice, convex))),
            Region::Prism { area, z } => Self::Prism(Box::new(Prism::new(area, *z, lattice)?)),
            Region::All(terms) => {
                let mut terms = each(terms)?;
                terms.retain(|t| !matches!(t, Self::Everything));
                match terms.len() {
                    0 => Self::Everything,
                    1 => terms.remove(0),
                    _ => Self::All(terms),
                }
            }
            Region::Any(terms) => {
                let mut terms = each(terms)?;
                terms.retain(|t| !matches!(t, Self::Nothing));
                match terms.len() {
                    0 => Self::Nothing,
                    _ if terms.iter().any(|t| matches!(t, Self::Everything)) => Self::Everything,
                    1 => terms.remove(0),
                    _ => Self::Any(terms),
                }
            }
            Region::Not(inner) => match Self::new(inner, lattice)? {
                Self::Everything => Self::Nothing,
                Self::Nothing => Self::Everything,
                Self::Not(twice) => *twice,
                other => Self::Not(Box::new(other)),
            },
        })
    }

    fn classify(&self, bounds: &LatticeBox) -> Containment {
        match self {
            Self::Everything => Containment::Inside,
            Self::Nothing => Containment::Outside,
            Self::Box(region) if region.contains_box(bounds) => Containment::Inside,
            Self::Box(region) if !region.meets(bounds) => Containment::Outside,
            Self::Box(_) => Containment::Partly,
            Self::Sphere(sphere) => sphere.classify(bounds),
            Self::Convex(convex) => convex.classify(bounds),
            Self::Prism(prism) => prism.classify(bounds),
            Self::All(terms) => until(terms, bounds, Containment::Outside, Containment::Inside),
            Self::Any(terms) => until(terms, bounds, Containment::Inside, Containment::Outside),
            Self::Not(inner) => match inner.classify(bounds) {
                Containment::Outside => Containment::Inside,
                Containment::Partly => Containment::Partly,
                Containment::Inside => Containment::Outside,
            },
        }
    }

    fn contains(&self, point: LatticePoint) -> bool {
        match self {
            Self::Everything => true,
            Self::Nothing => false,
            Self::Box(region) => region.contains(point),
            Self::Sphere(sphere) => sphere.contains(point),
            Self::Convex(convex) => convex.contains(point),
            Self::Prism(prism) => prism.contains(point),
            Self::All(terms) => terms.iter().all(|t| t.contains(point)),
            Self::Any(terms) => terms.iter().any(|t| t.contains(point)),
            Self::Not(inner) => !inner.contains(point),
        }
    }

    fn test(&self, positions: &Positions, bounds: &LatticeBox) -> Mask {
        let len = positions.len();
        match self {
            Self::Everything => Mask::all(len),
            Self::Nothing => Mask::none(len),
            Self::Box(region) => {
                let mut mask: Option<Mask> = None;
                for (axis, values) in [&positions.x, &positions.y, &positions.z].into_iter().enumerate() {
                    let (min, max) = (region.min.0[axis], region.max.0[axis]);
                    // Most blocks reach beyond one face only.
                    if min <= bounds.min.0[axis] && bounds.max.0[axis] <= max {
                        continue;
                    }
                    let within = Mask::where_each(values, |v: u64| v.wrapping_sub(min) <= max - min);
                    match &mut mask {
                        None => mask = Some(within),
                        Some(mask) => mask.and(&within),
                    }
                }
                mask.unwrap_or_else(|| Mask::all(len))
            }
            Self::Sphere(sphere) => Mask::where_index(len, |i| sphere.contains_fast(positions.point(i))),
            Self::Convex(convex) => Mask::where_index(len, |i| convex.contains_fast(positions.point(i))),
            Self::Prism(prism) => prism.test(positions),
            Self::All(terms) => {
                let mut mask = Mask::all(len);
                for term in terms {
                    if mask.is_none() {
                        break;
                    }
                    mask.and(&term.test(positions, bounds));
                }
                mask
            }
            Self::Any(terms) => {
                let mut mask = Mask::none(len);
                for term in terms {
                    if mask.is_all() {
                        break;
                    }
                    mask.or(&term.test(positions, bounds));
                }
                mask
            }
            Self::Not(inner) => {
                let mut mask = Mask::all(len);
                mask.and_not(&inner.test(positions, bounds));
                mask
            }
        }
    }
}

/// The answer that one term can give for all of them, else that of all of them, else partly.
fn until(terms: &[Kind], bounds: &LatticeBox, decisive: Containment, common: Containment) -> Containment {
    let mut answer = common;
    for term in terms {
        match term.classify(bounds) {
            found if found == decisive => return decisive,
            Containment::Partly => answer = Containment::Partly,
            _ => {}
        }
    }
    answer
}

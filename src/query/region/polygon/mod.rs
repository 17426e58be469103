//! Areas in the plan: polygons with holes, read from well-known text or GeoJSON.
//!
//! A vertex *is* the shortest decimal of its number, of at most [`PLACES`] places; all that is decided of it is decided in
//! integers. A place on the outline belongs to the side where the area is on its greater x, or on a horizontal edge on
//! its greater y: as in a half-open box, so that polygons which share an edge share no point and leave none out.

mod crossing;
mod exact;
mod geojson;
mod on_lattice;
#[cfg(test)]
pub(super) mod tests;
mod wkt;

use crate::lattice::Decimal;
use crate::query::QueryError;
use exact::Place;
pub(super) use on_lattice::Prism;
use std::cmp::Ordering;

/// The outer ring of a polygon, then its holes, as they were written.
type Rings = Vec<Vec<[f64; 2]>>;

/// Digits after the point of a vertex.
const PLACES: i32 = 15;
/// The greatest coordinate of a vertex.
const MAX_COORDINATE: f64 = 1e15;

/// Polygons in the plan; a place is inside if it is inside one of them.
///
/// Inside a polygon is what a line to the right leaves through its rings an odd number of times. Rings may touch, but not
/// cross.
#[derive(Clone, Debug, PartialEq)]
pub struct Polygons {
    /// Of each polygon its rings, without a repeated last vertex, in units of `10^-PLACES`.
    polygons: Vec<Vec<Vec<Place>>>,
    /// Least and greatest x and y; `None` if there is no vertex.
    bounds: Option<([f64; 2], [f64; 2])>,
    /// What the text says of its coordinates.
    epsg: Option<u32>,
}

impl Polygons {
    /// Polygons from rings of vertices: of each polygon the outer ring, then the holes. A ring's last vertex may repeat the
    /// first.
    ///
    /// # Errors
    ///
    /// [`QueryError::Region`] naming the place: a coordinate that is not finite or beyond 1e15, a ring of fewer than three
    /// places, rings that cross, a hole outside.
    pub fn new(polygons: &[Vec<Vec<[f64; 2]>>]) -> Result<Self, QueryError> {
        let mut exact = Vec::with_capacity(polygons.len());
        for (n, rings) in polygons.iter().enumerate() {
            let name = |ring: usize| match (polygons.len(), ring) {
                (1, 0) => "the polygon".to_owned(),
                (1, hole) => format!("hole {hole} of the polygon"),
                (_, 0) => format!("polygon {}", n + 1),
                (_, hole) => format!("hole {hole} of polygon {}", n + 1),
            };
            let rings = rings
                .iter()
                .enumerate()
                .map(|(i, ring)| exact_ring(ring).map_err(|what| refused(format!("{} {what}", name(i)))))
                .collect::<Result<Vec<_>, _>>()?;
            if let Some([(r, i), (s, j)]) = crossing::find(&rings) {
                let edge = |r: usize, i: usize| {
                    let ring = &rings[r];
                    format!("{} to {}", shown(ring[i]), shown(ring[(i + 1) % ring.len()]))
                };
                let whom = if r == s { "itself".to_owned() } else { name(s) };
                return Err(refused(format!(
                    "{} crosses {whom}: the edge from {} meets the edge from {}",
                    name(r),
                    edge(r, i),
                    edge(s, j)
                )));
            }
            for (hole, ring) in rings.iter().enumerate().skip(1) {
                let outside = ring.iter().find(|&&p| !on_outline(&rings[0], p) && !is_inside(&rings[0], p));
                if let Some(&p) = outside {
                    return Err(refused(format!("{} lies outside of its outline, at {}", name(hole), shown(p))));
                }
            }
            exact.push(rings);
        }
        let vertices = || polygons.iter().flatten().flatten();
        let fold = |f: fn(f64, f64) -> f64| vertices().copied().reduce(|a, b| [f(a[0], b[0]), f(a[1], b[1])]);
        Ok(Self { polygons: exact, bounds: fold(f64::min).zip(fold(f64::max)), epsg: None })
    }

    /// Reads well-known text: `POLYGON ((0 0, 10 0, 10 10, 0 0))`, `MULTIPOLYGON`, a `GEOMETRYCOLLECTION` of them; `SRID=n;`
    /// may stand before it. Heights are passed over.
    ///
    /// # Errors
    ///
    /// [`QueryError::Region`] with line and column of what cannot be read, and as [`Polygons::new`].
    pub fn from_wkt(text: &str) -> Result<Self, QueryError> {
        let (polygons, epsg) = wkt::parse(text).map_err(|e| {
            let before = &text[..e.at];
            let line = before.matches('\n').count() + 1;
            let column = before.rsplit('\n').next().map_or(0, |l| l.chars().count()) + 1;
            let place =
                if text.contains('\n') { format!("line {line} column {column}") } else { format!("column {column}") };
            refused(format!("WKT, {place}: {}", e.message))
        })?;
        Ok(Self { epsg, ..Self::new(&polygons)? })
    }

    /// Reads GeoJSON: a `Polygon` or `MultiPolygon`, a feature or a collection of features, all together. Coordinates are
    /// the store's, whatever RFC 7946 says; heights are passed over.
    ///
    /// # Errors
    ///
    /// [`QueryError::Region`] for what is no GeoJSON, for geometries without area and collections without a feature, and as [`Polygons::new`].
    pub fn from_geojson(text: &str) -> Result<Self, QueryError> {
        let (polygons, epsg) = geojson::parse(text).map_err(|what| refused(format!("the text {what}")))?;
        Ok(Self { epsg, ..Self::new(&polygons)? })
    }

    /// Reads either of the two.
    ///
    /// # Errors
    ///
    /// As [`Polygons::from_wkt`] and [`Polygons::from_geojson`].
    pub fn parse(text: &str) -> Result<Self, QueryError> {
        let text = text.trim_start_matches('\u{feff}');
        if text.trim_start().starts_with('{') { Self::from_geojson(text) } else { Self::from_wkt(text) }
    }

    /// Is a text meant as polygons, rather than as the name of a file?
    pub(super) fn looks_like_text(text: &str) -> bool {
        wkt::looks_like(text) || text.trim_start().starts_with('{')
    }

    /// Least and greatest x and y; `None` if there is no vertex.
    pub fn bounds(&self) -> Option<([f64; 2], [f64; 2])> {
        self.bounds
    }

    /// The EPSG code that the text gave for its coordinates.
    pub fn epsg(&self) -> Option<u32> {
        self.epsg
    }
}

fn refused(what: impl Into<String>) -> QueryError {
    QueryError::Region(what.into())
}

/// A ring in exact units, without repeated neighbours.
fn exact_ring(ring: &[[f64; 2]]) -> Result<Vec<Place>, String> {
    let mut places: Vec<Place> = Vec::with_capacity(ring.len());
    for vertex in ring {
        let place = exact_place(*vertex).ok_or_else(|| {
            format!("has a vertex at {} {}; coordinates must be numbers up to 1e15", vertex[0], vertex[1])
        })?;
        if places.last() != Some(&place) {
            places.push(place);
        }
    }
    if places.len() > 1 && places.first() == places.last() {
        places.pop();
    }
    if places.len() < 3 {
        return Err(format!("has a ring of {} different places; three are the least", places.len()));
    }
    Ok(places)
}

fn exact_place(vertex: [f64; 2]) -> Option<Place> {
    let coordinate = |v: f64| {
        let decimal = Decimal::from_f64(v).filter(|_| (-MAX_COORDINATE..=MAX_COORDINATE).contains(&v))?;
        // Beyond the last place: to the nearest.
        decimal.scaled_to(-PLACES).or_else(|| {
            let cut = u32::try_from(-PLACES - decimal.exponent()).ok()?;
            let Some(divisor) = 10_i128.checked_pow(cut) else { return Some(0) };
            Some((decimal.mantissa() + divisor / 2).div_euclid(divisor))
        })
    };
    Some([coordinate(vertex[0])?, coordinate(vertex[1])?])
}

fn shown(place: Place) -> String {
    let number = |v| Decimal::new(v, -PLACES).to_f64();
    format!("{} {}", number(place[0]), number(place[1]))
}

fn edges(ring: &[Place]) -> impl Iterator<Item = (Place, Place)> + '_ {
    ring.iter().enumerate().map(|(i, &a)| (a, ring[(i + 1) % ring.len()]))
}

/// Does the edge, of which `low` has the smaller y, have `p` on its left and at its height?
fn is_left_of(low: Place, high: Place, p: Place) -> bool {
    low[1] <= p[1] && p[1] < high[1] && exact::side(low, high, p) == Ordering::Greater
}

fn is_inside(ring: &[Place], p: Place) -> bool {
    let crossed = |(a, b): &(Place, Place)| if a[1] < b[1] { is_left_of(*a, *b, p) } else { is_left_of(*b, *a, p) };
    edges(ring).filter(crossed).count() % 2 == 1
}

fn on_outline(ring: &[Place], p: Place) -> bool {
    edges(ring).any(|(a, b)| {
        let within = |i: usize| (a[i].min(b[i])..=a[i].max(b[i])).contains(&p[i]);
        within(0) && within(1) && exact::side(a, b, p) == Ordering::Equal
    })
}

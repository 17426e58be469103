//! A query from the keywords of `esker.Store.query`.

use crate::errors::{Failure, bad_query};
use esker::geometry::Camera;
use esker::query::{Detail, Filter, Policy, Query, QueryError, Region};
use esker::store::Snapshot;
use pyo3::prelude::*;

/// The keywords, all of them given, as the package brings them into one form.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Options {
    #[pyo3(item("box"))]
    cuboid: Option<Vec<f64>>,
    closed: bool,
    sphere: Option<Vec<f64>>,
    /// Centre, full sides, angles in degrees.
    obox: Option<Vec<f64>>,
    /// WKT, GeoJSON, or a file with one of the two.
    polygon: Option<String>,
    /// Heights from the first, up to the second.
    z: Option<[f64; 2]>,
    /// A view file's JSON, or a clip matrix's.
    frustum: Option<String>,
    /// An expression of shapes.
    region: Option<String>,
    #[pyo3(item("where"))]
    filter: Option<String>,
    scans: Option<Vec<String>>,
    /// A view file's JSON.
    view: Option<String>,
    max_error_px: f64,
    /// As the command line takes it.
    policy: Option<String>,
    max_error: Option<f64>,
    spacing: Option<f64>,
    level: Option<i64>,
    capacity: Option<i64>,
    attributes: Option<Vec<String>>,
    /// Lattice indices instead of world coordinates?
    lattice: bool,
    /// Stored values instead of scaled ones?
    raw: bool,
    /// Masks of nulls?
    masked: bool,
    /// The scan of every point?
    with_scan: bool,
}

/// How an answer's values are to be given.
#[derive(Clone, Copy, Debug)]
pub struct Give {
    /// Lattice indices instead of world coordinates.
    pub lattice: bool,
    /// Stored values instead of scaled ones.
    pub raw: bool,
    /// Which values are null.
    pub masked: bool,
    /// The scan of every point.
    pub scan: bool,
}

impl Options {
    /// How values are to be given.
    pub fn give(&self) -> Give {
        Give { lattice: self.lattice, raw: self.raw, masked: self.masked, scan: self.with_scan }
    }

    /// The query.
    pub fn query(&self, snapshot: &Snapshot) -> PyResult<Query> {
        // Masks need to know which scan a point is of.
        let mut query = Query::new().with_scans(self.with_scan || self.masked);
        if let Some(region) = self.region(snapshot)? {
            query = query.region(region);
        }
        if let Some(text) = &self.filter {
            query = query.filter(Filter::parse(text).map_err(|e| Failure::Query(e.into()))?);
        }
        if let Some(scans) = &self.scans {
            query = query.scans(scans.iter().cloned());
        }
        if let Some(json) = &self.view {
            query = query.view(parse_view(json)?, self.max_error_px);
        }
        if let Some(text) = &self.policy {
            if self.view.is_none() {
                return Err(bad_query("a policy says how a view spreads its points; give a view"));
            }
            query = query.policy(Policy::parse(text).map_err(Failure::from)?);
        }
        if let Some(detail) = self.detail()? {
            query = query.detail(detail);
        }
        if let Some(capacity) = self.capacity {
            query = query.capacity(not_negative("capacity", capacity)?);
        }
        Ok(match self.attributes.as_deref() {
            None => query,
            Some([]) => query.positions_only(),
            Some(names) => query.attributes(names.iter().cloned()),
        })
    }

    /// What is in all the shapes that are given.
    fn region(&self, snapshot: &Snapshot) -> PyResult<Option<Region>> {
        let inf = f64::INFINITY;
        let shapes = [
            self.cuboid.as_deref().map(cuboid),
            self.sphere.as_deref().map(sphere),
            self.obox.as_deref().map(oriented_box),
            self.polygon.as_deref().map(|text| Region::parse_polygon(text, [-inf, inf])),
            self.z.map(|[min, max]| Region::new_heights(min, max)),
            self.frustum.as_deref().map(Region::parse_frustum),
            self.region.as_deref().map(Region::parse),
        ];
        let shapes = shapes.into_iter().flatten().collect::<Result<Vec<_>, _>>().map_err(Failure::from)?;
        if shapes.is_empty() {
            return if self.closed { Err(bad_query("closed is about the faces of boxes; give one")) } else { Ok(None) };
        }
        let region = Region::all(shapes);
        Ok(Some(if self.closed { region.closed_on(&snapshot.site().lattice) } else { region }))
    }

    fn detail(&self) -> PyResult<Option<Detail>> {
        let details = [
            self.max_error.map(Detail::MaxError),
            self.spacing.map(Detail::Spacing),
            self.level.map(|level| not_negative("level", level)).transpose()?.map(|level| {
                // Beyond the finest level there is everything.
                Detail::Level(u32::try_from(level).unwrap_or(u32::MAX))
            }),
        ];
        let mut given = details.into_iter().flatten();
        let detail = given.next();
        if given.next().is_some() {
            return Err(bad_query("give one of max_error, spacing and level"));
        }
        Ok(detail)
    }
}

fn not_negative(what: &str, value: i64) -> PyResult<u64> {
    u64::try_from(value).map_err(|_| bad_query(format!("the {what} is {value}; it must be 0 or more")))
}

fn cuboid(faces: &[f64]) -> Result<Region, QueryError> {
    let inf = f64::INFINITY;
    match *faces {
        [x0, y0, x1, y1] => Region::new_box([x0, y0, -inf], [x1, y1, inf]),
        [x0, y0, z0, x1, y1, z1] => Region::new_box([x0, y0, z0], [x1, y1, z1]),
        _ => Err(QueryError::Region(format!(
            "a box has 4 numbers x0, y0, x1, y1 or 6 numbers x0, y0, z0, x1, y1, z1; there are {}",
            faces.len()
        ))),
    }
}

fn sphere(numbers: &[f64]) -> Result<Region, QueryError> {
    match *numbers {
        [x, y, z, radius] => Region::new_sphere([x, y, z], radius),
        _ => Err(QueryError::Region(format!("a sphere has 4 numbers x, y, z, radius; there are {}", numbers.len()))),
    }
}

fn oriented_box(numbers: &[f64]) -> Result<Region, QueryError> {
    let (center, size, rotation) = match *numbers {
        [x, y, z, sx, sy, sz, yaw] => ([x, y, z], [sx, sy, sz], [yaw, 0.0, 0.0]),
        [x, y, z, sx, sy, sz, yaw, pitch, roll] => ([x, y, z], [sx, sy, sz], [yaw, pitch, roll]),
        _ => {
            return Err(QueryError::Region(format!(
                "an oriented box has 7 numbers x, y, z, sx, sy, sz, yaw or 9 with pitch, roll; there are {}",
                numbers.len()
            )));
        }
    };
    Region::new_oriented_box(center, size, rotation)
}

/// A view file's JSON.
pub fn parse_view(json: &str) -> PyResult<Camera> {
    serde_json::from_str(json).map_err(|e| bad_query(format!("this is no view: {e}")))
}

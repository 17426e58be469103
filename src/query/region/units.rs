//! Degrees against metres: a polygon in other coordinates than the store's is an error, not an empty answer.

use super::{Polygons, Region};
use crate::points::Crs;
use crate::query::QueryError;

impl Region {
    /// Refuses polygons whose coordinates cannot be the store's: by the EPSG codes where both have one, else degrees that lie
    /// nowhere near the site. `site` is least and greatest x and y of the store's points.
    pub(crate) fn check_coordinates(
        &self,
        crs: Option<&Crs>,
        site: Option<([f64; 2], [f64; 2])>,
    ) -> Result<(), QueryError> {
        match self {
            Self::Prism { area, .. } => check(area, crs, site),
            Self::All(terms) | Self::Any(terms) => terms.iter().try_for_each(|t| t.check_coordinates(crs, site)),
            Self::Not(inner) => inner.check_coordinates(crs, site),
            Self::Everything | Self::Box { .. } | Self::Sphere { .. } | Self::Convex(_) => Ok(()),
        }
    }
}

/// How many times as wide as the site is the least that is between coordinates in degrees and in metres.
const MANY_SITES: f64 = 10.0;

fn check(area: &Polygons, crs: Option<&Crs>, site: Option<([f64; 2], [f64; 2])>) -> Result<(), QueryError> {
    let named = |crs: &Crs| match (crs.describe(), crs.unit_name()) {
        (name, Some(unit)) => format!("in {name}, unit {unit}"),
        (name, None) => format!("in {name}"),
    };
    if let (Some(code), Some(crs)) = (area.epsg(), crs)
        && let Some(own) = crs.horizontal_epsg
        && own != code
    {
        return Err(QueryError::Region(format!(
            "the polygon is in EPSG:{code}, but the store is {}; reproject the polygon",
            named(crs)
        )));
    }
    let (Some((min, max)), Some((low, high))) = (area.bounds(), site) else { return Ok(()) };
    let degrees =
        |min: [f64; 2], max: [f64; 2]| min[0] >= -360.0 && max[0] <= 360.0 && min[1] >= -90.0 && max[1] <= 90.0;
    let geographic = crs.map(Crs::is_geographic);
    // What lies beside a small site on a grid of its own looks like degrees, too.
    let wide = (high[0] - low[0]).max(high[1] - low[1]);
    let apart = (0..2).any(|i| (low[i] - max[i]).max(min[i] - high[i]) > MANY_SITES * wide);
    let (polygon, store) = (degrees(min, max), degrees(low, high));
    if apart && polygon != store && geographic != Some(polygon) {
        let unit = if polygon { "degrees" } else { "metres or feet" };
        let crs = crs.filter(|c| !c.is_empty()).map_or_else(String::new, |c| format!(" {} and", named(c)));
        return Err(QueryError::Region(format!(
            "the polygon, x {} to {} and y {} to {}, seems to be in {unit}, but the store is{crs} at x {} to {} and y {} to {}; \
             reproject the polygon",
            min[0], max[0], min[1], max[1], low[0], high[0], low[1], high[1]
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polygons_of_other_coordinates_are_refused() {
        let region = |text: &str| Region::parse_polygon(text, [f64::NEG_INFINITY, f64::INFINITY]).unwrap();
        let degrees = region("POLYGON((5.1 45.2, 5.2 45.2, 5.2 45.3, 5.1 45.2))");
        let metres = region("POLYGON((770500 6277550, 770600 6277550, 770600 6277650, 770500 6277550))");
        let lambert = Crs::from_epsg(2154, None);
        let wgs = Crs::from_epsg(4326, None);
        let site = Some(([770_000.0, 6_277_000.0], [771_000.0, 6_278_000.0]));
        let globe = Some(([5.0, 45.0], [5.4, 45.4]));
        for crs in [Some(&lambert), None] {
            let error = degrees.check_coordinates(crs, site).unwrap_err().to_string();
            assert!(error.contains("degrees") && error.contains("5.1 to 5.2") && error.contains("771000"), "{error}");
            assert!(Region::all([metres.clone(), degrees.clone().inverted()]).check_coordinates(crs, site).is_err());
            assert!(metres.check_coordinates(crs, site).is_ok());
        }
        assert!(metres.check_coordinates(Some(&wgs), globe).is_err());
        assert!(degrees.check_coordinates(Some(&wgs), globe).is_ok());
        // A small local site, and one that nothing is known of.
        assert!(degrees.check_coordinates(None, Some(([0.0, 0.0], [50.0, 60.0]))).is_ok());
        assert!(degrees.check_coordinates(Some(&lambert), None).is_ok());
        let local = region("POLYGON((5 104,11 104,11 110,5 104))");
        assert!(local.check_coordinates(None, Some(([-100.0, -75.0], [100.0, 75.0]))).is_ok());
        let small = region("POLYGON((66 -39,68 -39,68 -37,66 -39))");
        assert!(small.check_coordinates(None, Some(([-50.0, -100.0], [50.0, 700.0]))).is_ok());
        // Beside the site, but in its own coordinates: that is an empty answer.
        let away = region("POLYGON((0 6000000, 10 6000000, 10 6000010, 0 6000000))");
        assert!(away.check_coordinates(Some(&lambert), site).is_ok());
        let marked = region("SRID=4326;POLYGON((770500 6277550, 770600 6277550, 770600 6277650, 770500 6277550))");
        assert!(marked.check_coordinates(Some(&lambert), site).unwrap_err().to_string().contains("EPSG:4326"));
        assert!(marked.check_coordinates(None, site).is_ok());
    }
}

//! Areas from GeoJSON: a geometry, a feature or a collection of features; all their polygons together. Geometries may be
//! empty, as in well-known text.

use super::Rings;
use ::geojson::{Error, Feature, GeoJson, Geometry, GeometryValue};

/// The polygons of a text, and the EPSG code of its `crs` member, which old files have.
pub(super) fn parse(text: &str) -> Result<(Vec<Rings>, Option<u32>), String> {
    let read: GeoJson = text.parse().map_err(|error: Error| match error {
        Error::MalformedGeoJson(json) => format!("is no GeoJSON: {json}"),
        other => format!("is no GeoJSON: {other}"),
    })?;
    let mut polygons = Vec::new();
    let features = match &read {
        GeoJson::Geometry(_) => 1,
        GeoJson::Feature(feature) => usize::from(feature.geometry.is_some()),
        GeoJson::FeatureCollection(collection) => collection.features.iter().filter(|f| f.geometry.is_some()).count(),
    };
    if features == 0 {
        return Err("holds no feature with a geometry".to_owned());
    }
    let foreign = match read {
        GeoJson::Geometry(geometry) => {
            of_geometry(&geometry, &mut polygons)?;
            geometry.foreign_members
        }
        GeoJson::Feature(feature) => {
            of_feature(&feature, &mut polygons)?;
            feature.foreign_members
        }
        GeoJson::FeatureCollection(collection) => {
            for (number, feature) in (1..).zip(&collection.features) {
                of_feature(feature, &mut polygons).map_err(|words| format!("feature {number} {words}"))?;
            }
            collection.foreign_members
        }
    };
    // {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::2154"}}
    let name = foreign.as_ref().and_then(|members| members.get("crs")?.pointer("/properties/name")?.as_str());
    let code = name.filter(|n| n.contains("EPSG")).and_then(|n| n.rsplit(':').next()?.parse().ok());
    Ok((polygons, code))
}

fn of_feature(feature: &Feature, polygons: &mut Vec<Rings>) -> Result<(), String> {
    feature.geometry.as_ref().map_or(Ok(()), |geometry| of_geometry(geometry, polygons))
}

fn of_geometry(geometry: &Geometry, polygons: &mut Vec<Rings>) -> Result<(), String> {
    match &geometry.value {
        GeometryValue::Polygon { coordinates } if coordinates.is_empty() => {}
        GeometryValue::Polygon { coordinates } => polygons.push(rings(coordinates)?),
        GeometryValue::MultiPolygon { coordinates } => {
            for polygon in coordinates.iter().filter(|polygon| !polygon.is_empty()) {
                polygons.push(rings(polygon)?);
            }
        }
        GeometryValue::GeometryCollection { geometries } => {
            geometries.iter().try_for_each(|inner| of_geometry(inner, polygons))?;
        }
        other => {
            return Err(format!("holds a {}, which has no area; expected Polygon or MultiPolygon", other.type_name()));
        }
    }
    Ok(())
}

fn rings(coordinates: &[Vec<::geojson::Position>]) -> Result<Rings, String> {
    let vertex = |position: &::geojson::Position| match position.as_slice() {
        &[x, y, ..] => Ok([x, y]),
        _ => Err("has a position with fewer than two numbers".to_owned()),
    };
    coordinates.iter().map(|ring| ring.iter().map(vertex).collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polygons_of_all_forms_are_read() {
        let polygon = r#"{"type":"Polygon","coordinates":[[[0,0],[1.5,0,9],[1.5,-2],[0,0]]]}"#;
        let square = vec![vec![[0.0, 0.0], [1.5, 0.0], [1.5, -2.0], [0.0, 0.0]]];
        assert_eq!(parse(polygon), Ok((vec![square.clone()], None)));
        let feature = format!(r#"{{"type":"Feature","properties":{{"a":1}},"geometry":{polygon}}}"#);
        assert_eq!(parse(&feature), Ok((vec![square.clone()], None)));
        let collection = format!(
            r#"{{"type":"FeatureCollection","crs":{{"type":"name","properties":{{"name":"urn:ogc:def:crs:EPSG::2154"}}}},
               "features":[{feature},{feature},{{"type":"Feature","properties":null,"geometry":null}}]}}"#
        );
        assert_eq!(parse(&collection), Ok((vec![square.clone(), square.clone()], Some(2154))));
        let multi = r#"{"type":"MultiPolygon","coordinates":[[[[0,0],[1.5,0],[1.5,-2],[0,0]]]]}"#;
        assert_eq!(
            parse(&format!(r#"{{"type":"GeometryCollection","geometries":[{multi}]}}"#)),
            Ok((vec![square], None))
        );
    }

    #[test]
    fn empty_geometries_are_empty_areas() {
        let empty = [
            r#"{"type":"Polygon","coordinates":[]}"#,
            r#"{"type":"MultiPolygon","coordinates":[]}"#,
            r#"{"type":"GeometryCollection","geometries":[]}"#,
        ];
        for geometry in empty {
            assert_eq!(parse(geometry), Ok((vec![], None)), "{geometry}");
            let feature = format!(r#"{{"type":"Feature","properties":null,"geometry":{geometry}}}"#);
            assert_eq!(parse(&feature), Ok((vec![], None)), "{feature}");
        }
        // But a layer without any feature is hardly meant.
        for none in
            [r#"{"type":"FeatureCollection","features":[]}"#, r#"{"type":"Feature","properties":null,"geometry":null}"#]
        {
            assert!(parse(none).unwrap_err().contains("no feature"), "{none}");
        }
    }

    #[test]
    fn what_is_wrong_is_said_with_its_place() {
        let wrong = |text: &str| parse(text).unwrap_err();
        assert!(
            wrong("{\"type\":\"Polygon\",\n \"coordinates\":[[[0,0],[1,}").contains("line 2 column"),
            "{}",
            wrong("{")
        );
        assert!(wrong(r#"{"type":"LineString","coordinates":[[0,0],[1,1]]}"#).contains("LineString"));
        assert!(wrong(r#"{"type":"Polygon","coordinates":[[[0]]]}"#).contains("position"));
        let feature = |geometry: &str| format!(r#"{{"type":"Feature","properties":null,"geometry":{geometry}}}"#);
        let plot = feature(r#"{"type":"Polygon","coordinates":[[[0,0],[1,0],[1,1],[0,0]]]}"#);
        let place = feature(r#"{"type":"Point","coordinates":[1,2]}"#);
        let told = wrong(&format!(r#"{{"type":"FeatureCollection","features":[{plot},{place}]}}"#));
        assert!(told.starts_with("feature 2 holds a Point, which has no area"), "{told}");
    }
}

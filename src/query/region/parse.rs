//! Regions from text: lists of numbers, and expressions of shapes.

use super::{Polygons, Region};
use crate::query::QueryError;
use std::path::Path;

/// How deep parentheses and `not` may nest.
const MAX_DEPTH: usize = 100;

/// What an expression can name, for messages.
const SHAPES: &str = "box(...), sphere(...), obox(...), polygon(...), frustum(FILE) or z(...)";

impl Region {
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
            other => Err(refused(format!(
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
            other => Err(refused(format!("a sphere has 4 numbers X,Y,Z,R; there are {}", other.len()))),
        }
    }

    /// Reads `X,Y,Z,SX,SY,SZ,YAW` or with `,PITCH,ROLL` after it: centre, full sides, degrees.
    ///
    /// # Errors
    ///
    /// [`QueryError::Region`] for other counts and as [`Region::new_oriented_box`].
    pub fn parse_oriented_box(text: &str) -> Result<Self, QueryError> {
        let (n, mut rotation) = (numbers(text)?, [0.0; 3]);
        if !matches!(n.len(), 7 | 9) {
            return Err(refused(format!(
                "an oriented box has 7 numbers X,Y,Z,SX,SY,SZ,YAW or 9 with PITCH,ROLL; there are {}",
                n.len()
            )));
        }
        rotation[..n.len() - 6].copy_from_slice(&n[6..]);
        Self::new_oriented_box([n[0], n[1], n[2]], [n[3], n[4], n[5]], rotation)
    }

    /// Reads `MIN,MAX`: the places at heights `[MIN, MAX)`.
    ///
    /// # Errors
    ///
    /// [`QueryError::Region`] for other counts and as [`Region::new_heights`].
    pub fn parse_heights(text: &str) -> Result<Self, QueryError> {
        match numbers(text)?.as_slice() {
            &[min, max] => Self::new_heights(min, max),
            other => Err(refused(format!("a range of heights has 2 numbers MIN,MAX; there are {}", other.len()))),
        }
    }

    /// Reads polygons from well-known text or GeoJSON, or from a file with one of the two, for heights `[z[0], z[1])`.
    ///
    /// # Errors
    ///
    /// [`QueryError::Region`] as [`Polygons::parse`], with the file's name, or if there is no such file.
    pub fn parse_polygon(text_or_file: &str, z: [f64; 2]) -> Result<Self, QueryError> {
        if Polygons::looks_like_text(text_or_file) {
            return Self::new_prism(Polygons::parse(text_or_file)?, z);
        }
        if text_or_file.trim().is_empty() {
            return Err(refused("the polygon is an empty text; expected WKT, GeoJSON or the name of a file"));
        }
        let ending = std::path::Path::new(text_or_file).extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        if let Some(form @ ("shp" | "gpkg" | "kml" | "kmz" | "dxf" | "gml" | "zip")) = ending.as_deref() {
            let remedy = "polygons are read from GeoJSON and WKT: convert it, with `ogr2ogr plots.geojson` for example";
            return Err(refused(format!("{text_or_file}: .{form} is not read; {remedy}")));
        }
        let text = read(text_or_file, "neither WKT nor GeoJSON, and as a file it")?;
        let area = Polygons::parse(&text).map_err(|e| refused(format!("{text_or_file}: {e}")))?;
        Self::new_prism(area, z)
    }

    /// Reads a frustum from a file as [`Region::parse_frustum`].
    ///
    /// # Errors
    ///
    /// [`QueryError::Region`] with the file's name.
    pub fn read_frustum(file: &str) -> Result<Self, QueryError> {
        let text = read(file, "the view")?;
        Self::parse_frustum(&text).map_err(|e| refused(format!("{file}: {e}")))
    }

    /// Reads an expression of shapes: `box(...)`, `sphere(...)`, `obox(...)` and `z(...)` with the numbers of the functions
    /// above, `polygon(FILE)` or well-known text as it is, `frustum(FILE)`, joined by `and`, `or`, `not` and parentheses.
    /// `or` binds least, `not` most.
    ///
    /// # Errors
    ///
    /// [`QueryError::Region`] with the column of what does not fit, and as the shapes.
    pub fn parse(text: &str) -> Result<Self, QueryError> {
        let mut parser = Parser { text, at: 0, depth: 0 };
        let region = parser.or()?;
        parser.skip_space();
        match parser.rest().chars().next() {
            None => Ok(region),
            Some(')') => Err(parser.error("this parenthesis closes nothing")),
            Some(_) => Err(parser.error("expected \"and\", \"or\" or the end")),
        }
    }
}

fn refused(what: impl Into<String>) -> QueryError {
    QueryError::Region(what.into())
}

fn read(file: &str, what: &str) -> Result<String, QueryError> {
    std::fs::read_to_string(Path::new(file)).map_err(|e| refused(format!("{file}: {what} cannot be read: {e}")))
}

fn numbers(text: &str) -> Result<Vec<f64>, QueryError> {
    let number = |part: &str| {
        let part = part.trim();
        let number = part.parse::<f64>().ok().filter(|n| !n.is_nan());
        number.ok_or_else(|| refused(format!("\"{part}\" is not a number")))
    };
    text.split(',').map(number).collect()
}

struct Parser<'t> {
    text: &'t str,
    at: usize,
    depth: usize,
}

impl<'t> Parser<'t> {
    fn rest(&self) -> &'t str {
        &self.text[self.at..]
    }

    fn error(&self, message: impl AsRef<str>) -> QueryError {
        let column = self.text[..self.at].chars().count() + 1;
        refused(format!("region, column {column}: {}", message.as_ref()))
    }

    fn skip_space(&mut self) {
        self.at += self.rest().len() - self.rest().trim_start().len();
    }

    fn word(&mut self) -> &'t str {
        self.skip_space();
        let rest = self.rest();
        &rest[..rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len())]
    }

    fn take(&mut self, word: &str) -> bool {
        let found = self.word().eq_ignore_ascii_case(word);
        if found {
            self.at += word.len();
        }
        found
    }

    fn take_sign(&mut self, sign: char) -> bool {
        self.skip_space();
        let found = self.rest().starts_with(sign);
        if found {
            self.at += sign.len_utf8();
        }
        found
    }

    fn or(&mut self) -> Result<Region, QueryError> {
        let mut terms = vec![self.and()?];
        while self.take("or") {
            terms.push(self.and()?);
        }
        Ok(Region::any(terms))
    }

    fn and(&mut self) -> Result<Region, QueryError> {
        let mut terms = vec![self.not()?];
        while self.take("and") {
            terms.push(self.not()?);
        }
        Ok(Region::all(terms))
    }

    fn not(&mut self) -> Result<Region, QueryError> {
        self.depth += 1;
        if self.depth > MAX_DEPTH {
            return Err(self.error(format!("nested deeper than {MAX_DEPTH}")));
        }
        let region = if self.take("not") {
            self.not()?.inverted()
        } else if self.take_sign('(') {
            let inner = self.or()?;
            if !self.take_sign(')') {
                return Err(self.error("expected \")\""));
            }
            inner
        } else {
            self.shape()?
        };
        self.depth -= 1;
        Ok(region)
    }

    fn shape(&mut self) -> Result<Region, QueryError> {
        let name = self.word();
        let start = self.at;
        let after = self.rest()[name.len()..].trim_start();
        // `polygon((0 0, ...))` is well-known text, `polygon(plots.geojson)` is not.
        let is_text = match name.to_ascii_lowercase().as_str() {
            "polygon" => !after.starts_with('(') || after[1..].trim_start().starts_with('('),
            "multipolygon" | "geometrycollection" | "srid" => true,
            "polygonz" | "polygonm" | "polygonzm" | "multipolygonz" | "multipolygonm" | "multipolygonzm" => true,
            _ => false,
        };
        if name.is_empty() {
            return Err(self.error(format!("expected {SHAPES}")));
        }
        if is_text && after.get(..5).is_some_and(|w| w.eq_ignore_ascii_case("empty")) {
            self.at += self.rest().len() - after.len() + 5;
            return Region::new_prism(
                Polygons::from_wkt(&self.text[start..self.at])?,
                [f64::NEG_INFINITY, f64::INFINITY],
            );
        }
        let Some(open) = self.rest().find('(').filter(|_| is_text || after.starts_with('(')) else {
            return Err(self.error(format!("expected {SHAPES}")));
        };
        self.at += open + 1;
        let inside = self.inside().ok_or_else(|| {
            let open = Parser { text: self.text, at: start + open, depth: 0 };
            open.error("this parenthesis is not closed")
        })?;
        let arguments = inside.trim();
        let unquoted =
            ['\'', '"'].iter().find_map(|q| arguments.strip_prefix(*q)?.strip_suffix(*q)).unwrap_or(arguments);
        let inf = f64::INFINITY;
        let region = match name.to_ascii_lowercase().as_str() {
            _ if is_text => {
                Polygons::from_wkt(&self.text[start..self.at]).and_then(|p| Region::new_prism(p, [-inf, inf]))
            }
            "box" => Region::parse_box(arguments),
            "sphere" => Region::parse_sphere(arguments),
            "obox" => Region::parse_oriented_box(arguments),
            "z" => Region::parse_heights(arguments),
            "polygon" => Region::parse_polygon(unquoted, [-inf, inf]),
            "frustum" => Region::read_frustum(unquoted),
            _ => Err(refused(format!("\"{name}\" is no shape; expected {SHAPES}"))),
        };
        region.map_err(|e| Parser { text: self.text, at: start, depth: 0 }.error(e.to_string()))
    }

    /// What is between an open parenthesis, which was taken, and its partner, which is taken too.
    fn inside(&mut self) -> Option<&'t str> {
        let (start, mut depth, mut quote) = (self.at, 1, None);
        for (i, c) in self.rest().char_indices() {
            match (c, quote) {
                (c, Some(q)) if c == q => quote = None,
                (_, Some(_)) => {}
                ('\'' | '"', None) => quote = Some(c),
                ('(', None) => depth += 1,
                (')', None) => depth -= 1,
                _ => {}
            }
            if depth == 0 {
                self.at = start + i + 1;
                return Some(&self.text[start..start + i]);
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shown(region: &Region) -> String {
        let join = |terms: &[Region], word: &str| terms.iter().map(shown).collect::<Vec<_>>().join(word);
        match region {
            Region::Everything => "everything".into(),
            Region::Box { min, .. } => format!("box{}", min[0]),
            Region::Sphere { .. } => "sphere".into(),
            Region::Convex(c) => format!("convex{}", c.halves().len()),
            Region::Prism { area, .. } => format!("prism{}", area.bounds().map_or(-1.0, |b| b.1[0])),
            Region::All(terms) => format!("({})", join(terms, " and ")),
            Region::Any(terms) => format!("({})", join(terms, " or ")),
            Region::Not(inner) => format!("not {}", shown(inner)),
        }
    }

    #[test]
    fn files_of_other_forms_of_polygons_are_named() {
        for name in ["plots.gpkg", "a/b.SHP", "c.kml"] {
            let error = Region::parse_polygon(name, [0.0, 1.0]).unwrap_err().to_string();
            assert!(error.contains("is not read; polygons are read from GeoJSON and WKT"), "{error}");
        }
    }

    #[test]
    fn shapes_are_joined_as_in_a_filter() {
        let folder = tempfile::tempdir().unwrap();
        let (plots, view) = (folder.path().join("plots (1).wkt"), folder.path().join("v.json"));
        std::fs::write(&plots, "POLYGON((0 0,8 0,8 8,0 0))").unwrap();
        std::fs::write(&view, r#"{"eye":[0,0,9],"target":[0,0,0]}"#).unwrap();
        let of = |text: &str| shown(&Region::parse(text).unwrap());
        assert_eq!(of("box(1,2,3,4) or box(5,6,7,8,9,10) and not sphere(1,2,3,4)"), "(box1 or (box5 and not sphere))");
        assert_eq!(of("NOT (z(0,inf) OR obox(1,1,1,2,2,2,45))"), "not (box-inf or convex6)");
        assert_eq!(of("polygon((0 0, 5 0, 5 5, 0 0), (1 0.5, 2 0.5, 2 1, 1 0.5)) and z(-1,1)"), "(prism5 and box-inf)");
        assert_eq!(of("MULTIPOLYGON Z (((0 0 1, 5 0 1, 5 5 1, 0 0 1)))"), "prism5");
        assert_eq!(of("polygonz((0 0 1, 5 0 1, 5 5 1, 0 0 1)) and z(0,1)"), "(prism5 and box-inf)");
        assert_eq!(of("POLYGON EMPTY or SRID=7;POLYGON((0 0,6 0,6 6,0 0))"), "(prism-1 or prism6)");
        assert_eq!(of(&format!("polygon('{}')", plots.display())), "prism8");
        assert_eq!(
            of(&format!("frustum({}) and not polygon(\"{}\")", view.display(), plots.display())),
            "(convex5 and not prism8)"
        );
    }

    #[test]
    fn closed_boxes_have_all_their_faces_turned_or_not() {
        // --closed was without effect on --obox.
        let lattice = crate::lattice::Lattice::uniform(0.5).unwrap();
        let corner = lattice.lattice_from_world([10.0, 10.0, 10.0]).unwrap();
        let beyond = lattice.lattice_from_world([10.0, 10.5, 10.0]).unwrap();
        for text in ["box(0,0,0,10,10,10)", "obox(5,5,5,10,10,10,0)", "obox(5,5,5,10,10,10,90) and z(0,20)"] {
            let region = Region::parse(text).unwrap();
            let on = |region: &Region| region.on_lattice(&lattice).unwrap();
            let (open, closed) = (on(&region), on(&region.closed_on(&lattice)));
            assert!(!open.contains(corner) && closed.contains(corner), "{text}");
            assert!(!closed.contains(beyond), "{text}");
        }
    }

    #[test]
    fn what_is_no_area_or_no_file_is_told() {
        let told = |text: &str| Region::parse_polygon(text, [0.0, 1.0]).unwrap_err().to_string();
        for empty in ["", "  "] {
            assert!(told(empty).contains("empty text") && told(empty).contains("GeoJSON"), "{}", told(empty));
        }
        let line = told("LINESTRING(0 0, 1 1)");
        assert!(line.contains("found LINESTRING") && line.contains("expected POLYGON"), "{line}");
        assert!(told("nope.wkt").starts_with("nope.wkt: neither WKT nor GeoJSON, and as a file it cannot be read: "));
        let view = Region::read_frustum("nope.json").unwrap_err().to_string();
        assert!(view.starts_with("nope.json: the view cannot be read: "), "{view}");
        assert!(Region::parse_polygon(r#"{"type":"Polygon","coordinates":[]}"#, [0.0, 1.0]).is_ok());
    }

    #[test]
    fn errors_point_at_the_column() {
        let cases = [
            ("", 1),
            ("box(1,2,3,4) box(1,2,3,4)", 14),
            ("box(1,2,3,4) and", 17),
            ("box(1,2,3,4) and cube(1)", 18),
            ("(box(1,2,3,4)", 14),
            ("box(1,2,3,4))", 13),
            ("not box(1,2,3", 8),
            ("not sphere(1,2,3,-1)", 5),
            ("polygon((0 0, 1 1, 1))", 1),
            ("polygon", 1),
            ("box 1,2,3,4", 1),
            ("polygon(no_such_file.wkt)", 1),
        ];
        for (text, column) in cases {
            let error = Region::parse(text).expect_err(text).to_string();
            assert!(error.starts_with(&format!("region, column {column}: ")), "{text}: {error}");
            assert!(!error.contains('\n'));
        }
        let inner = Region::parse("not polygon((0 0, 1 1, 1))").unwrap_err().to_string();
        assert!(inner.ends_with("WKT, column 21: expected a number, found ')'"), "{inner}");
        assert!(Region::parse(&format!("{}box(1,2,3,4)", "not ".repeat(5000))).is_err());
    }
}

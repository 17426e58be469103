//! Well-known text of areas. Own code, since the crate for it does not say where a text is wrong.
//!
//! ```text
//! POLYGON ((0 0, 10 0, 10 10, 0 0), (2 1, 3 1, 3 2, 2 1))        MULTIPOLYGON Z (((...)), ((...)))
//! SRID=2154;POLYGON (...)                                        GEOMETRYCOLLECTION (POLYGON (...), ...)
//! ```

use super::Rings;

/// What is wrong with a text, and at which byte.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Malformed {
    pub at: usize,
    pub message: String,
}

/// The polygons of a text, and its `SRID` if it has one.
pub(super) fn parse(text: &str) -> Result<(Vec<Rings>, Option<u32>), Malformed> {
    let mut reader = Reader { text, at: 0 };
    let mut srid = None;
    if reader.word_is("SRID") {
        reader.word();
        reader.expect('=')?;
        srid = Some(reader.integer()?);
        reader.expect(';')?;
    }
    let mut polygons = Vec::new();
    reader.geometry(&mut polygons, 0)?;
    reader.skip_space();
    if reader.at < text.len() {
        return Err(reader.error("there is more after the end of the geometry"));
    }
    Ok((polygons, srid))
}

/// Does a text begin as well-known text of an area does?
pub(super) fn looks_like(text: &str) -> bool {
    let word: String = text.trim_start().chars().take_while(char::is_ascii_alphabetic).collect();
    let rest = text.trim_start()[word.len()..].trim_start();
    let begins = rest.is_empty() || rest.starts_with(['(', '=']) || rest.starts_with(|c: char| c.is_ascii_alphabetic());
    let word = untagged(word.to_ascii_uppercase());
    if AREAS.contains(&&*word) || word == "SRID" {
        return begins;
    }
    // What has no area is told so, unless it can be the name of a file.
    let next: String = rest.chars().take_while(char::is_ascii_alphabetic).collect();
    OTHERS.contains(&&*word)
        && (rest.starts_with('(') || ["Z", "M", "ZM", "EMPTY"].iter().any(|t| next.eq_ignore_ascii_case(t)))
}

/// What is read.
const AREAS: [&str; 3] = ["POLYGON", "MULTIPOLYGON", "GEOMETRYCOLLECTION"];
/// What is not.
const OTHERS: [&str; 13] = [
    "POINT",
    "MULTIPOINT",
    "LINESTRING",
    "MULTILINESTRING",
    "CIRCULARSTRING",
    "COMPOUNDCURVE",
    "MULTICURVE",
    "CURVEPOLYGON",
    "MULTISURFACE",
    "POLYHEDRALSURFACE",
    "TIN",
    "TRIANGLE",
    "GEOMETRY",
];

/// The kind without the dimensions that some programs write in one word with it: `POLYGONZ`, `MULTIPOLYGONZM`.
fn untagged(kind: String) -> String {
    let known = |kind: &&str| AREAS.contains(kind) || OTHERS.contains(kind);
    ["ZM", "Z", "M"].iter().find_map(|t| kind.strip_suffix(t).filter(known)).map_or(kind.clone(), str::to_owned)
}

/// How deep collections may nest.
const MAX_DEPTH: usize = 16;

struct Reader<'t> {
    text: &'t str,
    at: usize,
}

impl Reader<'_> {
    fn rest(&self) -> &str {
        &self.text[self.at..]
    }

    fn error(&self, message: impl Into<String>) -> Malformed {
        Malformed { at: self.at, message: message.into() }
    }

    fn skip_space(&mut self) {
        self.at += self.rest().len() - self.rest().trim_start().len();
    }

    /// The next character that is no space.
    fn peek(&mut self) -> Option<char> {
        self.skip_space();
        self.rest().chars().next()
    }

    fn take(&mut self, c: char) -> bool {
        let found = self.peek() == Some(c);
        if found {
            self.at += c.len_utf8();
        }
        found
    }

    fn found(&mut self) -> String {
        self.peek().map_or_else(|| "the end".to_owned(), |c| format!("'{c}'"))
    }

    fn expect(&mut self, c: char) -> Result<(), Malformed> {
        if self.take(c) {
            return Ok(());
        }
        let found = self.found();
        Err(self.error(format!("expected '{c}', found {found}")))
    }

    fn word(&mut self) -> String {
        self.skip_space();
        let word: String = self.rest().chars().take_while(char::is_ascii_alphabetic).collect();
        self.at += word.len();
        word.to_ascii_uppercase()
    }

    fn word_is(&mut self, expected: &str) -> bool {
        let start = self.at;
        let found = self.word() == expected;
        self.at = start;
        found
    }

    fn integer(&mut self) -> Result<u32, Malformed> {
        self.skip_space();
        let digits: String = self.rest().chars().take_while(char::is_ascii_digit).collect();
        let number = digits.parse().map_err(|_| self.error("expected a number"))?;
        self.at += digits.len();
        Ok(number)
    }

    fn geometry(&mut self, polygons: &mut Vec<Rings>, depth: usize) -> Result<(), Malformed> {
        self.skip_space();
        let start = self.at;
        let kind = untagged(self.word());
        if matches!(self.peek_word().as_str(), "Z" | "M" | "ZM") {
            self.word();
        }
        let empty = self.word_is("EMPTY");
        match kind.as_str() {
            "POLYGON" | "MULTIPOLYGON" | "GEOMETRYCOLLECTION" if empty => {
                self.word();
                Ok(())
            }
            "POLYGON" => {
                polygons.push(self.rings()?);
                Ok(())
            }
            "MULTIPOLYGON" => self.list(|reader| {
                match reader.word_is("EMPTY") {
                    true => drop(reader.word()),
                    false => polygons.push(reader.rings()?),
                }
                Ok(())
            }),
            "GEOMETRYCOLLECTION" if depth < MAX_DEPTH => self.list(|reader| reader.geometry(polygons, depth + 1)),
            "GEOMETRYCOLLECTION" => Err(Malformed { at: start, message: "collections nest too deep".into() }),
            "" => Err(Malformed {
                at: start,
                message: "expected POLYGON, MULTIPOLYGON or a GEOMETRYCOLLECTION of them".into(),
            }),
            other => {
                let what = match OTHERS.contains(&other) {
                    // Curved or in space, some of these have an area, but not one of straight edges in the plan.
                    true => format!("found {other}, which is not an area with straight edges"),
                    false => format!("found {other}"),
                };
                let message = format!("{what}; expected POLYGON, MULTIPOLYGON or a GEOMETRYCOLLECTION of them");
                Err(Malformed { at: start, message })
            }
        }
    }

    fn peek_word(&mut self) -> String {
        let start = self.at;
        let word = self.word();
        self.at = start;
        word
    }

    /// `( item , item ... )`
    fn list(&mut self, mut item: impl FnMut(&mut Self) -> Result<(), Malformed>) -> Result<(), Malformed> {
        self.expect('(')?;
        loop {
            item(self)?;
            if !self.take(',') {
                break;
            }
        }
        if self.take(')') {
            return Ok(());
        }
        let found = self.found();
        Err(self.error(format!("expected ',' or ')', found {found}")))
    }

    fn rings(&mut self) -> Result<Rings, Malformed> {
        let mut rings = Vec::new();
        self.list(|reader| {
            let mut ring = Vec::new();
            reader.list(|reader| {
                ring.push(reader.vertex()?);
                Ok(())
            })?;
            rings.push(ring);
            Ok(())
        })?;
        Ok(rings)
    }

    /// `x y`, and up to two more numbers that do not count.
    fn vertex(&mut self) -> Result<[f64; 2], Malformed> {
        let vertex = [self.number()?, self.number()?];
        for _ in 0..2 {
            if matches!(self.peek(), None | Some(',' | ')')) {
                break;
            }
            self.number()?;
        }
        Ok(vertex)
    }

    fn number(&mut self) -> Result<f64, Malformed> {
        self.skip_space();
        let is_part = |c: &char| !c.is_whitespace() && !matches!(c, ',' | '(' | ')');
        let text: String = self.rest().chars().take_while(is_part).collect();
        let number = text.parse::<f64>().ok().filter(|n| n.is_finite());
        let Some(number) = number else {
            let found = if text.is_empty() { self.found() } else { format!("\"{text}\"") };
            return Err(self.error(format!("expected a number, found {found}")));
        };
        self.at += text.len();
        Ok(number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polygons_of_all_forms_are_read() {
        let square = vec![vec![[0.0, 0.0], [1.5, 0.0], [1.5, -2e1], [0.0, 0.0]]];
        let one = |text: &str| parse(text).unwrap();
        assert_eq!(one("POLYGON((0 0,1.5 0,1.5 -2e1,0 0))"), (vec![square.clone()], None));
        assert_eq!(one(" polygon Z ( ( 0 0 7 , 1.5 0 7,1.5 -20 7 8, 0 0 1 ) ) "), (vec![square.clone()], None));
        assert_eq!(
            one("SRID=2154;MULTIPOLYGON(((0 0,1.5 0,1.5 -20,0 0)),((0 0,1.5 0,1.5 -20,0 0),(1 1,2 2,3 1)))").1,
            Some(2154)
        );
        assert_eq!(
            one("MULTIPOLYGON(((0 0,1.5 0,1.5 -20,0 0)),((0 0,1.5 0,1.5 -20,0 0),(1 1,2 2,3 1)))").0[1].len(),
            2
        );
        assert_eq!(one("GEOMETRYCOLLECTION(POLYGON((0 0,1.5 0,1.5 -20,0 0)), POLYGON EMPTY)").0, vec![square]);
        assert_eq!(one("MULTIPOLYGON EMPTY"), (vec![], None));
        // Empty members, and the dimensions in one word with the kind, as PostGIS and GEOS write them.
        let square = one("POLYGON((0 0,1.5 0,1.5 -2e1,0 0))").0;
        assert_eq!(one("MULTIPOLYGON(((0 0,1.5 0,1.5 -20,0 0)),EMPTY)").0, square);
        assert_eq!(one("MULTIPOLYGON(EMPTY, ((0 0,1.5 0,1.5 -20,0 0)) )").0, square);
        for tagged in
            ["POLYGONZ((0 0 1,1.5 0 1,1.5 -20 1,0 0 1))", "polygonzm((0 0 1 2,1.5 0 1 2,1.5 -20 1 2,0 0 1 2))"]
        {
            assert_eq!(one(tagged).0, square, "{tagged}");
            assert!(looks_like(tagged));
        }
        assert_eq!(one("MultiPolygonM(((0 0 1,1.5 0 1,1.5 -20 1,0 0 1)))").0, square);
    }

    #[test]
    fn errors_point_at_the_byte() {
        let cases = [
            ("", 0),
            ("POLYGON", 7),
            ("POLYGON (0 0, 1 1)", 9),
            ("POLYGON ((0 0, 1 x, 1 1))", 17),
            ("POLYGON ((0 0, 1, 1 1))", 16),
            ("POLYGON ((0 0, 1 1)", 19),
            ("POLYGON ((0 0, 1 1)) 7", 21),
            ("POLYGON ((0 0, 1 nan, 2 2))", 17),
            ("POINT (1 2)", 0),
            ("SRID=x;POLYGON((0 0,1 1,2 0))", 5),
            ("POLYGON ((0 0 0 0 0, 1 1))", 18),
        ];
        for (text, at) in cases {
            let error = parse(text).expect_err(text);
            assert_eq!(error.at, at, "{text}: {}", error.message);
        }
        let found = parse("LINESTRINGZ(0 0 1, 1 1 1)").unwrap_err().message;
        assert!(found.contains("found LINESTRING,") && found.contains("expected POLYGON"), "{found}");
        assert!(parse(&"GEOMETRYCOLLECTION(".repeat(100_000)).is_err());
    }

    #[test]
    fn file_names_are_not_taken_for_text() {
        assert!(looks_like("polygon((0 0") && looks_like(" SRID=4326;POINT(1 1)") && looks_like("POLYGON Z ((1"));
        assert!(looks_like("LINESTRING(0 0, 1 1)") && looks_like("point z (1 2 3)") && looks_like("PointZ(1 2 3)"));
        assert!(!looks_like("point cloud.wkt") && !looks_like("points (1).wkt") && !looks_like("line.wkt"));
        assert!(!looks_like("polygon.geojson") && !looks_like("multipolygon_1.wkt") && !looks_like("site.wkt"));
    }
}

//! A tolerant scanner for CRS texts (WKT 1 and 2): codes, units and kinds, nothing more.

/// `KEYWORD[arguments]`.
#[derive(Debug, PartialEq)]
pub(super) struct Node {
    /// In upper case.
    pub keyword: String,
    /// What is between the brackets.
    pub arguments: Vec<Argument>,
}

/// An argument of a node.
#[derive(Debug, PartialEq)]
pub(super) enum Argument {
    /// Between quotes.
    Text(String),
    /// A number or a bare word.
    Word(String),
    /// Another node.
    Node(Node),
}

/// Deeper nesting is no CRS.
const DEEPEST: usize = 32;

const HORIZONTAL: &[&str] = &[
    "PROJCS",
    "PROJCRS",
    "PROJECTEDCRS",
    "GEOGCS",
    "GEOGCRS",
    "GEOGRAPHICCRS",
    "GEODCRS",
    "GEODETICCRS",
    "GEOCCS",
    "LOCAL_CS",
    "ENGCRS",
    "ENGINEERINGCRS",
    "DERIVEDPROJCRS",
];
const VERTICAL: &[&str] = &["VERT_CS", "VERTCS", "VERTCRS", "VERTICALCRS"];
const COMPOUND: &[&str] = &["COMPD_CS", "COMPOUNDCRS"];
/// What says who or where, not what.
const IGNORED: &[&str] =
    &["AUTHORITY", "ID", "EXTENSION", "AXIS", "REMARK", "USAGE", "SCOPE", "AREA", "BBOX", "VERTICALEXTENT"];

impl Node {
    /// The outermost node of `text`; `None` if it is no WKT.
    pub fn parse(text: &str) -> Option<Self> {
        let mut rest = text.trim_matches(['\0', ' ', '\t', '\r', '\n', '\u{feff}']);
        let Argument::Node(node) = argument(&mut rest, 0)? else { return None };
        Some(node)
    }

    fn children(&self) -> impl Iterator<Item = &Self> {
        self.arguments.iter().filter_map(|a| if let Argument::Node(n) = a { Some(n) } else { None })
    }

    /// The first child with one of these keywords.
    fn child(&self, keywords: &[&str]) -> Option<&Self> {
        self.children().find(|n| keywords.contains(&&*n.keyword))
    }

    fn text(&self, index: usize) -> Option<&str> {
        match self.arguments.get(index)? {
            Argument::Text(text) | Argument::Word(text) => Some(text),
            Argument::Node(_) => None,
        }
    }

    /// The name, which comes first.
    pub fn name(&self) -> Option<&str> {
        self.text(0).filter(|n| !n.is_empty())
    }

    fn part(&self, keywords: &[&str]) -> Option<&Self> {
        if keywords.contains(&&*self.keyword) {
            return Some(self);
        }
        if self.keyword == "BOUNDCRS" {
            return self.child(&["SOURCECRS"])?.children().find_map(|n| n.part(keywords));
        }
        if COMPOUND.contains(&&*self.keyword) {
            return self.children().find_map(|n| n.part(keywords));
        }
        None
    }

    /// The horizontal part: itself, or of a compound.
    pub fn horizontal(&self) -> Option<&Self> {
        self.part(HORIZONTAL)
    }

    /// The vertical part: itself, or of a compound.
    pub fn vertical(&self) -> Option<&Self> {
        self.part(VERTICAL)
    }

    /// The EPSG code that this node itself carries.
    pub fn epsg(&self) -> Option<u32> {
        let codes = self.children().filter(|n| matches!(&*n.keyword, "AUTHORITY" | "ID"));
        codes
            .filter(|n| n.text(0).is_some_and(|t| t.eq_ignore_ascii_case("EPSG")))
            .find_map(|n| n.text(1)?.parse().ok())
    }

    /// Are its coordinates longitude and latitude?
    pub fn is_geographic(&self) -> bool {
        match &*self.keyword {
            "GEOGCS" | "GEOGCRS" | "GEOGRAPHICCRS" => true,
            "GEODCRS" | "GEODETICCRS" => self
                .child(&["CS"])
                .and_then(|cs| cs.text(0))
                .is_some_and(|kind| kind.eq_ignore_ascii_case("ellipsoidal")),
            _ => false,
        }
    }

    /// How many metres its unit has (degrees: radians), as the text says.
    pub fn unit_factor(&self) -> Option<f64> {
        const UNITS: &[&str] = &["UNIT", "LENGTHUNIT", "ANGLEUNIT"];
        let axis = || self.children().filter(|n| n.keyword == "AXIS").find_map(|n| n.child(UNITS));
        self.child(UNITS).or_else(axis)?.text(1)?.parse().ok()
    }

    /// The text without what only names its origin, numbers and names in one spelling: equal for equal systems that were
    /// written differently.
    pub fn normalized(&self) -> String {
        let mut out = format!("{}[", self.keyword);
        for argument in &self.arguments {
            match argument {
                Argument::Node(node) if IGNORED.contains(&&*node.keyword) => continue,
                Argument::Node(node) => out += &node.normalized(),
                Argument::Text(text) | Argument::Word(text) => match text.parse::<f64>() {
                    Ok(number) => out += &number.to_string(),
                    Err(_) => out.extend(text.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase)),
                },
            }
            out.push(',');
        }
        out + "]"
    }
}

fn argument(rest: &mut &str, depth: usize) -> Option<Argument> {
    *rest = rest.trim_start();
    if let Some(mut after) = rest.strip_prefix('"') {
        let mut text = String::new();
        loop {
            let (part, tail) = after.split_once('"')?;
            text += part;
            match tail.strip_prefix('"') {
                // A doubled quote stands for one.
                Some(more) => {
                    text.push('"');
                    after = more;
                }
                None => {
                    *rest = tail;
                    return Some(Argument::Text(text));
                }
            }
        }
    }
    let end = rest.find(['[', '(', ',', ']', ')', '"'])?;
    let (word, after) = rest.split_at(end);
    let word = word.trim();
    if !after.starts_with(['[', '(']) {
        *rest = after;
        return Some(Argument::Word(word.to_owned()));
    }
    if depth == DEEPEST || word.is_empty() {
        return None;
    }
    *rest = &after[1..];
    let mut arguments = Vec::new();
    loop {
        *rest = rest.trim_start();
        if !(arguments.is_empty() && rest.starts_with([']', ')'])) {
            arguments.push(argument(rest, depth + 1)?);
        }
        *rest = rest.trim_start();
        let separator = rest.chars().next()?;
        *rest = &rest[separator.len_utf8()..];
        match separator {
            ',' => {}
            ']' | ')' => return Some(Argument::Node(Node { keyword: word.to_ascii_uppercase(), arguments })),
            _ => return None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const UTM: &str = r#"PROJCS["NAD83 / UTM zone 10N",GEOGCS["NAD83",DATUM["D",SPHEROID["GRS 1980",6378137,298.2,AUTHORITY["EPSG","7019"]]],
        UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4269"]],PROJECTION["Transverse_Mercator"],UNIT["metre",1,AUTHORITY["EPSG","9001"]],
        AXIS["Easting",EAST],AUTHORITY["EPSG","26910"]]"#;

    #[test]
    fn codes_are_those_of_the_outermost_parts() {
        let node = Node::parse(UTM).unwrap();
        assert_eq!(node.horizontal().unwrap().epsg(), Some(26910));
        assert_eq!(node.unit_factor(), Some(1.0));
        assert!(!node.is_geographic());
        let compound = format!(r#"COMPD_CS["both",{UTM},VERT_CS["NAVD88",UNIT["m",1.0],AUTHORITY["EPSG","5703"]]]"#);
        let node = Node::parse(&compound).unwrap();
        assert_eq!(node.horizontal().unwrap().epsg(), Some(26910));
        assert_eq!(node.vertical().unwrap().epsg(), Some(5703));
        let wkt2 =
            r#"GEOGCRS["WGS 84 ""x""",CS[ellipsoidal,2],AXIS["lat",north,ANGLEUNIT["degree",0.017]],ID["EPSG",4326]]"#;
        let node = Node::parse(wkt2).unwrap();
        assert_eq!((node.epsg(), node.is_geographic(), node.unit_factor()), (Some(4326), true, Some(0.017)));
        assert_eq!(node.name(), Some("WGS 84 \"x\""));
    }

    #[test]
    fn spelling_does_not_count() {
        let a = Node::parse(r#"GEOGCS["WGS 84", UNIT["degree", 0.10],AUTHORITY["EPSG","4326"]]"#).unwrap();
        let b = Node::parse("geogcs(\"WGS_84\",\n UNIT(\"Degree\",1e-1))").unwrap();
        let c = Node::parse(r#"GEOGCS["WGS 84",UNIT["degree",0.2]]"#).unwrap();
        assert_eq!(a.normalized(), b.normalized());
        assert_ne!(a.normalized(), c.normalized());
    }

    proptest! {
        #[test]
        fn any_text_is_survived(text in r#"[A-C"\[\](), 1.é]{0,60}"#, cut in 0..UTM.len()) {
            let _ = Node::parse(&text);
            prop_assert_eq!(Node::parse(UTM.get(..cut).unwrap_or_default()), None);
        }
    }

    #[test]
    fn deep_nesting_is_refused() {
        assert_eq!(Node::parse(&"A[".repeat(100_000)), None);
    }
}

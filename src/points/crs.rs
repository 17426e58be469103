//! What a coordinate reference system says: codes, kind, unit, and whether two are the same.

use super::Crs;
use super::geokeys::{EPSG_CODES, GeoKeys};
use super::wkt::Node;

/// GTModelTypeGeoKey of geographic systems.
const GEOGRAPHIC: u16 = 2;

impl Crs {
    /// A CRS from what a LAS file holds: the codes are taken from the text and from the keys, first from the text if
    /// `wkt_first`. Text that is no WKT gives no codes.
    pub fn from_las(wkt: Option<String>, geotiff: Vec<(u16, Vec<u8>)>, wkt_first: bool) -> Self {
        let mut crs = Self { wkt, horizontal_epsg: None, vertical_epsg: None, geotiff };
        let node = crs.node();
        let part = |node: Option<&Node>| node.and_then(Node::epsg);
        let of_text = node.as_ref().map_or((None, None), |n| (part(n.horizontal()), part(n.vertical())));
        let keys = GeoKeys::of(&crs);
        let of_keys = (keys.horizontal_epsg(), keys.vertical_epsg());
        let (first, second) = if wkt_first { (of_text, of_keys) } else { (of_keys, of_text) };
        (crs.horizontal_epsg, crs.vertical_epsg) = (first.0.or(second.0), first.1.or(second.1));
        crs
    }

    /// A CRS from a WKT alone.
    pub fn from_wkt(wkt: impl Into<String>) -> Self {
        Self::from_las(Some(wkt.into()), Vec::new(), true)
    }

    /// A CRS from EPSG codes alone.
    pub fn from_epsg(horizontal: u32, vertical: Option<u32>) -> Self {
        Self { horizontal_epsg: Some(horizontal), vertical_epsg: vertical, ..Self::default() }
    }

    /// Reads `EPSG:N`, `EPSG:N+V`, the URN or URL of a code (`urn:ogc:def:crs:EPSG::N`) or WKT; `None` if it is none of these.
    /// Other numbers than those of the register's systems would be lost in files.
    pub fn parse(text: &str) -> Option<Self> {
        let text = text.trim();
        if let Some(code) = code_of_name(text) {
            let known =
                |code: &str| code.trim().parse::<u16>().ok().filter(|code| EPSG_CODES.contains(code)).map(u32::from);
            let mut codes = code.splitn(2, '+').map(known);
            let horizontal = codes.next()??;
            let vertical = codes.next().map_or(Some(None), |code| code.map(Some))?;
            return Some(Self::from_epsg(horizontal, vertical));
        }
        is_closed(text).then(|| Self::from_wkt(text))
    }

    fn node(&self) -> Option<Node> {
        self.wkt.as_deref().and_then(Node::parse)
    }

    /// Does it say nothing?
    pub fn is_empty(&self) -> bool {
        let codes = self.horizontal_epsg.is_some() || self.vertical_epsg.is_some();
        !codes && self.wkt.as_deref().is_none_or(|w| w.trim().is_empty()) && GeoKeys::of(self).is_empty()
    }

    /// Are its coordinates longitude and latitude in degrees, as far as it says?
    pub fn is_geographic(&self) -> bool {
        let of_text = self.node().and_then(|n| n.horizontal().map(Node::is_geographic));
        of_text.or_else(|| GeoKeys::of(self).model().map(|m| m == GEOGRAPHIC)).unwrap_or_else(|| {
            // Blocks of the register that hold geographic systems only, and the common newer ones.
            const CODES: &[u32] = &[4490, 4979, 6318, 6319, 6706, 7843, 7844, 9755];
            let block = |code| matches!(code, 4120..=4326 | 4600..=4821) || CODES.contains(&code);
            self.horizontal_epsg.is_some_and(block)
        })
    }

    /// `metre`, `foot`, `US survey foot` or `degree`: the unit of its horizontal coordinates, if it says.
    pub fn unit_name(&self) -> Option<&'static str> {
        if self.is_geographic() {
            return Some("degree");
        }
        let of_text = self.node().and_then(|n| n.horizontal()?.unit_factor()).and_then(|factor| {
            let near = |unit: f64| (factor / unit - 1.0).abs() < 1e-7;
            if near(1.0) {
                Some("metre")
            } else if near(0.3048) {
                Some("foot")
            } else if near(1200.0 / 3937.0) {
                Some("US survey foot")
            } else {
                None
            }
        });
        let of_keys = || match GeoKeys::of(self).linear_unit()? {
            9001 => Some("metre"),
            9002 => Some("foot"),
            9003 => Some("US survey foot"),
            _ => None,
        };
        // UTM on WGS 84, NAD83 and ETRS89 is in metres, and so are many countries' systems.
        let of_code = || {
            let code = self.horizontal_epsg?;
            let utm = matches!(code, 32601..=32660 | 32701..=32760 | 26901..=26923 | 25828..=25838);
            // Those of France, Switzerland, Great Britain, the Netherlands, Belgium, Austria, Poland; web maps.
            const METRES: &[u32] = &[2154, 2056, 21781, 27700, 28992, 31370, 3812, 31287, 2180, 3857];
            (utm || METRES.contains(&code)).then_some("metre")
        };
        of_text.or_else(of_keys).or_else(of_code)
    }

    /// Is `other` the same system? By the unit where both say one and it differs; by EPSG code where both are known (vertical
    /// ones only count where both have one), else by WKT without regard to spelling; `None` if that can't be told.
    pub fn same_as(&self, other: &Self) -> Option<bool> {
        if self.has_another_unit(other) {
            return Some(false);
        }
        if let (Some(a), Some(b)) = (self.horizontal_epsg, other.horizontal_epsg) {
            let vertical = match (self.vertical_epsg, other.vertical_epsg) {
                (Some(a), Some(b)) => a == b,
                _ => true,
            };
            return Some(a == b && vertical);
        }
        let text = |crs: &Self| match crs.node() {
            Some(node) => Some(node.normalized()),
            None => crs.wkt.as_deref().map(|w| w.split_whitespace().collect::<String>()),
        };
        if let (Some(a), Some(b)) = (text(self), text(other)) {
            return Some(a == b);
        }
        // The same keys are the same system; different ones may yet be.
        (!self.geotiff.is_empty() && self.geotiff == other.geotiff && self.wkt == other.wkt).then_some(true)
    }

    fn has_another_unit(&self, other: &Self) -> bool {
        self.unit_name().zip(other.unit_name()).is_some_and(|(own, other)| own != other)
    }

    /// [`Crs::describe`] beside another one: with the unit, where that differs.
    pub fn describe_beside(&self, other: &Self) -> String {
        match self.unit_name() {
            Some(unit) if self.has_another_unit(other) => format!("{} in {unit}", self.describe()),
            _ => self.describe(),
        }
    }

    /// One line for people: name and codes, as far as known.
    pub fn describe(&self) -> String {
        let codes: Vec<_> =
            [self.horizontal_epsg, self.vertical_epsg].into_iter().flatten().map(|c| format!("EPSG:{c}")).collect();
        let codes = codes.join(" + ");
        let of_text = self.node().and_then(|n| n.name().map(str::to_owned));
        // As writers of text that know codes alone have it.
        let is_name = |name: &String| codes.is_empty() || !name.eq_ignore_ascii_case("unknown");
        match of_text.or_else(|| GeoKeys::of(self).citation()).filter(is_name) {
            Some(name) if codes.is_empty() => name,
            Some(name) => format!("{name} ({codes})"),
            None if codes.is_empty() => "unknown".to_owned(),
            None => codes,
        }
    }
}

/// What stands behind `EPSG:`, or for it in the longer names of a code.
fn code_of_name(text: &str) -> Option<&str> {
    if let Some((authority, code)) = text.split_once(':')
        && authority.eq_ignore_ascii_case("EPSG")
    {
        return Some(code);
    }
    let lower = text.to_ascii_lowercase();
    let urn = lower.strip_prefix("urn:ogc:def:crs:epsg:").and_then(|rest| Some((rest, rest.split_once(':')?.1)));
    let url = ["http://www.opengis.net/def/crs/epsg/", "https://www.opengis.net/def/crs/epsg/"];
    let url =
        url.iter().find_map(|start| lower.strip_prefix(start)).and_then(|rest| Some((rest, rest.split_once('/')?.1)));
    // The version of the register may be anything, or missing.
    let (_, code) = urn.or(url)?;
    text.get(text.len() - code.len()..)
}

/// Is it as WKT is: brackets of which each is closed, the last one at the end?
fn is_closed(wkt: &str) -> bool {
    let mut depth = 0_u32;
    // In quotes brackets are letters; a quote in quotes is two.
    let outside = wkt.split('"').step_by(2).flat_map(str::bytes);
    for byte in outside.filter(|b| matches!(b, b'[' | b']')) {
        match (byte, depth) {
            (b'[', _) => depth += 1,
            (_, 0) => return false,
            _ => depth -= 1,
        }
    }
    depth == 0 && wkt.ends_with(']')
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Writers of text that know codes alone call the system so.
    #[test]
    fn a_system_that_is_called_unknown_is_named_by_its_codes() {
        let wkt = r#"COMPD_CS["unknown",PROJCS["a",UNIT["metre",1]]]"#;
        let crs = |horizontal_epsg| Crs { wkt: Some(wkt.into()), horizontal_epsg, ..Crs::default() };
        assert_eq!(crs(Some(3005)).describe(), "EPSG:3005");
        assert_eq!(crs(None).describe(), "unknown");
    }

    #[test]
    fn codes_and_wkt_are_told_apart() {
        assert_eq!(Crs::parse(" EPSG:25832 "), Some(Crs::from_epsg(25_832, None)));
        assert_eq!(Crs::parse("epsg:25832+7837"), Some(Crs::from_epsg(25_832, Some(7837))));
        for name in [
            "urn:ogc:def:crs:EPSG::25832",
            "urn:ogc:def:crs:epsg:9.9:25832",
            "http://www.opengis.net/def/crs/EPSG/0/25832",
        ] {
            assert_eq!(Crs::parse(name), Some(Crs::from_epsg(25_832, None)), "{name}");
        }
        // The code in a text counts as much as one that stands alone.
        let wkt = r#"PROJCS["ETRS89 / UTM zone 32N",UNIT["metre",1],AUTHORITY["EPSG","25832"]]"#;
        assert_eq!(Crs::parse(wkt).unwrap().same_as(&Crs::from_epsg(25_832, None)), Some(true));
        let wkt = r#"PROJCS["here ]",UNIT["m"]]"#;
        assert_eq!(Crs::parse(wkt).and_then(|c| c.wkt).as_deref(), Some(wkt));
        for neither in [
            "EPSG:0",
            "EPSG:70000",
            "EPSG:25832+0",
            "",
            "EPSG:",
            "EPSG:x",
            "EPSG:1+",
            "urn:ogc:def:crs:EPSG::",
            "urn:ogc:def:crs:OGC::CRS84",
            "25832",
            "UTM",
            "GEOGCS[",
            "A[]]",
            "A[][",
        ] {
            assert_eq!(Crs::parse(neither), None, "{neither}");
        }
    }

    fn keys(entries: &[(u16, u16)]) -> Crs {
        let mut words = vec![1, 1, 0, entries.len() as u16];
        entries.iter().for_each(|&(key, value)| words.extend([key, 0, 1, value]));
        let data = words.into_iter().flat_map(u16::to_le_bytes).collect();
        Crs::from_las(None, vec![(34735, data)], false)
    }

    #[test]
    fn geokeys_give_codes_unit_and_kind() {
        let utm = keys(&[(1024, 1), (2048, 4269), (3072, 26915), (4096, 5703)]);
        assert_eq!((utm.horizontal_epsg, utm.vertical_epsg), (Some(26915), Some(5703)));
        assert_eq!((utm.unit_name(), utm.is_geographic()), (Some("metre"), false));
        let own = keys(&[(1024, 1), (2048, 4269), (3072, 32767), (3076, 9003)]);
        assert_eq!((own.horizontal_epsg, own.unit_name()), (None, Some("US survey foot")));
        let degrees = keys(&[(1024, 2), (2048, 4326)]);
        assert_eq!((degrees.horizontal_epsg, degrees.unit_name()), (Some(4326), Some("degree")));
        assert!(keys(&[]).is_empty() && !own.is_empty());
        assert_eq!(utm.describe(), "EPSG:26915 + EPSG:5703");
    }

    #[test]
    fn sameness_is_told_only_where_it_can_be() {
        let utm = |vertical| Crs::from_epsg(26915, vertical);
        assert_eq!(utm(Some(5703)).same_as(&utm(None)), Some(true));
        assert_eq!(utm(Some(5703)).same_as(&utm(Some(6360))), Some(false));
        assert_eq!(utm(None).same_as(&Crs::from_epsg(26916, None)), Some(false));
        let text = |t: &str| Crs::from_wkt(t);
        assert_eq!(text("LOCAL_CS[\"a b\"]").same_as(&text("LOCAL_CS[ \"A_B\" ]")), Some(true));
        assert_eq!(text("LOCAL_CS[\"a\"]").same_as(&text("LOCAL_CS[\"b\"]")), Some(false));
        assert_eq!(text("rubbish").same_as(&text("rub bish")), Some(true));
        assert_eq!(utm(None).same_as(&text("LOCAL_CS[\"a\"]")), None);
        // Feet are not metres, nor degrees, whatever else they are.
        let feet = keys(&[(1024, 1), (3072, 26915), (3076, 9003)]);
        assert_eq!(utm(None).same_as(&feet), Some(false));
        assert_eq!(feet.describe_beside(&utm(None)), "EPSG:26915 in US survey foot");
        assert_eq!(feet.describe_beside(&feet), "EPSG:26915");
        assert_eq!(utm(None).same_as(&text("GEOGCS[\"a\",UNIT[\"degree\",0.0174532925199433]]")), Some(false));
        assert_eq!(keys(&[(1024, 1), (3076, 9002)]).same_as(&text("PROJCS[\"a\",UNIT[\"metre\",1]]")), Some(false));
        assert_eq!(keys(&[(1024, 1), (3072, 32767)]).same_as(&keys(&[(1024, 1), (3072, 32767)])), Some(true));
    }

    #[test]
    fn common_codes_tell_their_kind_and_unit() {
        let unit = |code| Crs::from_epsg(code, None).unit_name();
        assert_eq!([unit(4326), unit(4269), unit(7844)], [Some("degree"); 3]);
        assert_eq!([unit(32632), unit(25833)], [Some("metre"); 2]);
        assert_eq!([unit(4978), unit(2992), unit(4087)], [None; 3]);
    }

    #[test]
    fn the_encoding_bit_decides_between_text_and_keys() {
        let text = Some("GEOGCS[\"WGS 84\",AUTHORITY[\"EPSG\",\"4326\"]]".to_owned());
        let geotiff = keys(&[(1024, 1), (3072, 26915), (4096, 5703)]).geotiff;
        let by_text = Crs::from_las(text.clone(), geotiff.clone(), true);
        assert_eq!((by_text.horizontal_epsg, by_text.vertical_epsg), (Some(4326), Some(5703)));
        assert_eq!(Crs::from_las(text, geotiff, false).horizontal_epsg, Some(26915));
    }
}

//! The CRS of a merged file: a WKT record, or the GeoTIFF ones.

use super::header;
use crate::points::{Crs, RawVlr};

const USER_ID: &str = "LASF_Projection";
const WKT_RECORD: u16 = 2112;
const GEO_KEYS_RECORD: u16 = 34_735;

const MODEL_TYPE_KEY: u16 = 1024;
const GEOGRAPHIC_KEY: u16 = 2048;
const PROJECTED_KEY: u16 = 3072;
const VERTICAL_KEY: u16 = 4096;

/// Records of a CRS.
#[derive(Debug)]
pub(super) struct Written {
    pub vlrs: Vec<RawVlr>,
    /// Is it WKT?
    pub wkt: bool,
}

/// The records for a CRS; `None` if nothing is known of it.
pub(super) fn vlrs(crs: &Crs, notes: &mut Vec<String>) -> Option<Written> {
    if let Some(wkt) = &crs.wkt {
        let mut text = wkt.trim_end_matches('\0').as_bytes().to_vec();
        text.push(0);
        return Some(Written { vlrs: vec![header::vlr(USER_ID, WKT_RECORD, "OGC WKT", text)], wkt: true });
    }
    let vlr = |id: u16, data: Vec<u8>| header::vlr(USER_ID, id, "GeoTIFF", data);
    if !crs.geotiff.is_empty() {
        // Point formats 6 and up ask for WKT, which nobody can derive from the keys without a data base of CRSs.
        notes.push("the CRS is written as GeoTIFF keys, as the source has it; some tools expect WKT in LAS 1.4".into());
        return Some(Written {
            vlrs: crs.geotiff.iter().map(|(id, data)| vlr(*id, data.clone())).collect(),
            wkt: false,
        });
    }
    let keys = epsg_keys(crs)?;
    Some(Written { vlrs: vec![vlr(GEO_KEYS_RECORD, keys)], wkt: false })
}

/// A GeoKey directory that names the EPSG codes; `None` without a code that fits one.
fn epsg_keys(crs: &Crs) -> Option<Vec<u8>> {
    let code = |c: Option<u32>| c.and_then(|c| u16::try_from(c).ok());
    let mut keys = Vec::new();
    if let Some(horizontal) = code(crs.horizontal_epsg) {
        // EPSG gives geographic systems codes from 4000 to 4999.
        let geographic = (4000..5000).contains(&horizontal);
        keys.push([MODEL_TYPE_KEY, if geographic { 2 } else { 1 }]);
        keys.push([if geographic { GEOGRAPHIC_KEY } else { PROJECTED_KEY }, horizontal]);
    }
    if let Some(vertical) = code(crs.vertical_epsg) {
        keys.push([VERTICAL_KEY, vertical]);
    }
    if keys.is_empty() {
        return None;
    }
    let mut words = vec![1, 1, 0, keys.len() as u16];
    for [key, value] in keys {
        words.extend([key, 0, 1, value]);
    }
    Some(words.into_iter().flat_map(u16::to_le_bytes).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wkt_goes_before_keys_and_ends_with_a_zero() {
        let mut notes = Vec::new();
        let crs = Crs { wkt: Some("PROJCS[]".into()), geotiff: vec![(34_735, vec![1])], ..Crs::default() };
        let written = vlrs(&crs, &mut notes).unwrap();
        assert!(written.wkt && notes.is_empty());
        assert_eq!(written.vlrs[0].data, b"PROJCS[]\0");
        let long = Crs { wkt: Some("x".repeat(70_000)), ..Crs::default() };
        assert!(vlrs(&long, &mut notes).unwrap().vlrs[0].extended);
        assert!(vlrs(&Crs::default(), &mut notes).is_none());
    }

    #[test]
    fn codes_alone_become_keys() {
        let crs = Crs { horizontal_epsg: Some(25_832), vertical_epsg: Some(5783), ..Crs::default() };
        let written = vlrs(&crs, &mut Vec::new()).unwrap();
        assert!(!written.wkt);
        let words: Vec<_> = written.vlrs[0].data.chunks(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
        assert_eq!(words, [1, 1, 0, 3, 1024, 0, 1, 1, 3072, 0, 1, 25_832, 4096, 0, 1, 5783]);
    }
}

//! The CRS of a LAS file: WKT and GeoTIFF keys, from VLRs and EVLRs.

use super::extra::has_user_id;
use super::records::Records;
use crate::points::{Crs, LasFacts, RawVlr};

const USER_ID: &[u8] = b"LASF_Projection";
/// libLAS wrote WKT under its own name before the specification had a place for it.
const LIBLAS: &[u8] = b"liblas";
const WKT: u16 = 2112;
/// Key directory, doubles, text.
const GEOTIFF: [u16; 3] = [34735, 34736, 34737];
/// The bit of the global encoding that says that the CRS is the WKT.
const WKT_BIT: u16 = 1 << 4;

/// The CRS, if the records say anything of one.
pub(super) fn read(records: &Records, global_encoding: u16) -> Option<Crs> {
    of_records(&records.vlrs, global_encoding)
}

/// The CRS that a file's own records say.
pub(crate) fn of_facts(facts: &LasFacts) -> Option<Crs> {
    of_records(&facts.vlrs, facts.global_encoding)
}

/// Is it a record of [`of_facts`]?
pub(crate) fn says_crs(vlr: &RawVlr) -> bool {
    has_user_id(vlr, USER_ID) || has_user_id(vlr, LIBLAS) && vlr.record_id == WKT
}

fn of_records(vlrs: &[RawVlr], global_encoding: u16) -> Option<Crs> {
    let find = |user: &[u8], id: u16| vlrs.iter().find(|v| v.record_id == id && has_user_id(v, user));
    let wkt = [USER_ID, LIBLAS].into_iter().find_map(|user| {
        let raw = &find(user, WKT)?.data;
        let raw = raw.split(|&b| b == 0).next()?;
        let text = String::from_utf8_lossy(raw).trim().to_owned();
        (!text.is_empty()).then_some(text)
    });
    let geotiff = GEOTIFF.into_iter().filter_map(|id| Some((id, find(USER_ID, id)?.data.clone()))).collect();
    let crs = Crs::from_las(wkt, geotiff, global_encoding & WKT_BIT != 0);
    (!crs.is_empty()).then_some(crs)
}

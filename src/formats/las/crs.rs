//! The CRS of a LAS file: WKT and GeoTIFF keys, from VLRs and EVLRs.

use super::records::Records;
use crate::points::Crs;

const USER_ID: &[u8] = b"LASF_Projection";
const WKT: u16 = 2112;
/// Key directory, doubles, text.
const GEOTIFF: [u16; 3] = [34735, 34736, 34737];
/// The bit of the global encoding that says that the CRS is the WKT.
const WKT_BIT: u16 = 1 << 4;

/// The CRS, if the records say anything of one.
pub(super) fn read(records: &Records, global_encoding: u16) -> Option<Crs> {
    // libLAS wrote WKT under its own name before the specification had a place for it.
    let wkt = [USER_ID, b"liblas"].into_iter().find_map(|user| {
        let raw = &records.find(user, WKT)?.data;
        let raw = raw.split(|&b| b == 0).next()?;
        let text = String::from_utf8_lossy(raw).trim().to_owned();
        (!text.is_empty()).then_some(text)
    });
    let geotiff = GEOTIFF.into_iter().filter_map(|id| Some((id, records.find(USER_ID, id)?.data.clone()))).collect();
    let crs = Crs::from_las(wkt, geotiff, global_encoding & WKT_BIT != 0);
    (!crs.is_empty()).then_some(crs)
}

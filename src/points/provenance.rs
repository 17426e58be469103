//! Where points come from, as far as it must be kept to write them back.

use serde::{Deserialize, Serialize};

/// The coordinate reference system as a source gave it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Crs {
    /// OGC WKT, if there is one.
    pub wkt: Option<String>,
    /// Horizontal EPSG code, where known.
    pub horizontal_epsg: Option<u32>,
    /// Vertical EPSG code, where known.
    pub vertical_epsg: Option<u32>,
    /// The raw GeoTIFF VLRs (record id, bytes) of a LAS file, kept for writing back.
    pub geotiff: Vec<(u16, Vec<u8>)>,
}

/// What is needed to write a LAS source back as it was.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LasFacts {
    /// Major and minor version.
    pub version: (u8, u8),
    /// Point data record format, without the compression bits.
    pub point_format: u8,
    /// Scale factors.
    pub scale: [f64; 3],
    /// Offsets.
    pub offset: [f64; 3],
    /// Global encoding bits (GPS time kind, WKT, synthetic returns).
    pub global_encoding: u16,
    /// File source id.
    pub file_source_id: u16,
    /// Project GUID.
    pub guid: [u8; 16],
    /// System identifier, raw.
    pub system_identifier: [u8; 32],
    /// Generating software, raw.
    pub generating_software: [u8; 32],
    /// VLRs then EVLRs, raw, in the file's order.
    pub vlrs: Vec<RawVlr>,
    /// Bytes between the end of the standard fields and of the record that no extra-bytes VLR describes.
    pub undescribed_bytes: u16,
}

/// A variable length record as it was in the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RawVlr {
    /// Was it an extended one, after the points?
    pub extended: bool,
    /// User id, raw.
    pub user_id: [u8; 16],
    /// Record id.
    pub record_id: u16,
    /// Description, raw.
    pub description: [u8; 32],
    /// The record itself.
    pub data: Vec<u8>,
}

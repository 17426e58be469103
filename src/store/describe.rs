//! What a store holds, in world coordinates and plain words, for people and programs: what `info` and `scans` say.

use super::error::StoreError;
use super::info::info;
use super::model::{Range, Scan, Slot, Zones};
use super::snapshot::Snapshot;
use crate::lattice::{Cube, Decimal, Lattice, LatticeBox};
use crate::points::{Attribute, Number, Real, Scaling};
use serde::Serialize;
use std::sync::Arc;

/// What a store holds.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Description {
    /// Points.
    pub points: u64,
    /// How many scans there are.
    pub scans: usize,
    /// How many of them are hidden.
    pub scans_hidden: usize,
    /// Nodes of all layers.
    pub nodes: u64,
    /// Levels of the deepest tree.
    pub levels: u32,
    /// The spacing of the samples that the root holds, in CRS units.
    pub root_spacing: Option<f64>,
    /// Where the points are.
    pub bounds: Option<WorldBounds>,
    /// The lattice's step per axis.
    pub quantum: [f64; 3],
    /// The lattice's offset per axis.
    pub phase: [f64; 3],
    /// The site's CRS.
    pub crs: Option<CrsDescription>,
    /// The unit of horizontal coordinates, as far as the CRS says.
    pub unit: Option<&'static str>,
    /// What is stored of each point, and what it costs: positions first, the scan of each point last.
    pub attributes: Vec<AttributeCost>,
    /// Bytes of the store's file, its log included.
    pub bytes_total: u64,
    /// Bytes of all encoded columns.
    pub bytes_encoded: u64,
    /// Bytes of the file by points.
    pub bytes_per_point: f64,
    /// Names of the views that are kept in it.
    pub bookmarks: Vec<String>,
    /// Counts committed changes.
    pub generation: u64,
    /// Is a writer at work, or is there a log that is not yet in the file?
    pub in_use: bool,
}

/// Bounds in world coordinates whose maximum is one quantum up, so that they take everything when used as a half-open
/// box.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WorldBounds {
    /// The low corner.
    pub min: [f64; 3],
    /// One quantum beyond the high corner.
    pub max: [f64; 3],
}

impl WorldBounds {
    /// The bounds of these lattice points.
    pub fn new(lattice: &Lattice, bounds: &LatticeBox) -> Self {
        Self {
            min: std::array::from_fn(|axis| lattice.face_at(axis, bounds.min.0[axis])),
            max: std::array::from_fn(|axis| lattice.face_at(axis, bounds.max.0[axis] + 1)),
        }
    }

    /// The least box of these lattice points, on whose maximum there are some: one point has no extent.
    pub fn closed(lattice: &Lattice, bounds: &LatticeBox) -> Self {
        Self { min: lattice.world_from_lattice(bounds.min), max: lattice.world_from_lattice(bounds.max) }
    }
}

/// A coordinate reference system.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct CrsDescription {
    /// One line for people.
    pub description: String,
    /// Its text, as it was given.
    pub wkt: Option<String>,
    /// The code of its horizontal part.
    pub horizontal_epsg: Option<u32>,
    /// The code of its vertical part.
    pub vertical_epsg: Option<u32>,
}

/// What an attribute costs.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct AttributeCost {
    /// Its name; `position` and `(scan of each point)` are none.
    pub name: String,
    /// The type of its values.
    #[serde(rename = "type")]
    pub ty: &'static str,
    /// Bytes of its encoded columns.
    pub bytes: u64,
    /// The least value, scaled, whole ones exactly, NaN left out; `None` where the zone maps cannot tell: of positions, and of
    /// attributes that have a value for "no data".
    pub min: Option<Number>,
    /// The greatest, in the same way.
    pub max: Option<Number>,
    /// What makes real values of stored ones.
    pub scaling: Option<Scaling>,
    /// The stored value that means "no data".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub no_data: Option<Number>,
}

/// A scan of a store.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ScanDescription {
    /// The number.
    pub id: u32,
    /// Unique in the store.
    pub name: String,
    /// The file's path, from the root.
    pub source: String,
    /// `las`, `laz`, `e57`, ...
    pub format: String,
    /// Records that the source announced or held.
    pub read: u64,
    /// Points stored.
    pub stored: u64,
    /// Records that were not stored.
    pub rejected: u64,
    /// Of those: no valid position, because a coordinate is NaN or infinite or the scanner marked it as no measurement.
    pub rejected_not_finite: u64,
    /// Of those: coordinates outside the lattice.
    pub rejected_out_of_range: u64,
    /// Of those: announced by the header but not in the file.
    pub rejected_truncated: u64,
    /// `exact`, `recoverable` or `rounded`.
    pub positions: &'static str,
    /// The largest distance on one axis between a source coordinate and the stored one, in CRS units.
    pub max_error: f64,
    /// Where its points are.
    pub bounds: Option<WorldBounds>,
    /// 4 x 4, row-major, world from scan.
    pub pose: [f64; 16],
    /// Where the scanner stood: where the pose takes the origin.
    pub scanner: [f64; 3],
    /// 8 or 16; `None` without colours.
    pub color_depth: Option<u8>,
    /// Does it take part unless asked otherwise?
    pub visible: bool,
    /// Seconds since 1970, when it was stored.
    pub time: i64,
}

/// The scaled range of an attribute over all layers.
fn range_of(slot: Slot, attribute: &Attribute, zones: &[Arc<Zones>]) -> Option<[Number; 2]> {
    let of_layer = |zones: &Arc<Zones>| {
        let found = zones.subtree.binary_search_by_key(&slot, |z| z.0).ok()?;
        Some(zones.subtree[found].1)
    };
    let ends = match zones.iter().filter_map(of_layer).reduce(Range::union)? {
        Range::Unsigned(a, b) => [a, b].map(Number::Unsigned),
        Range::Signed(a, b) => [a, b].map(Number::Signed),
        Range::Float(a, b) => [a, b].map(Number::Float),
        Range::OnlyNan => return None,
    };
    if attribute.scaling.is_none() {
        return Some(ends);
    }
    let real = Real::new(attribute.scaling);
    let [a, b] = ends.map(|v| match v {
        Number::Unsigned(v) => real.of_integer(v.into()),
        Number::Signed(v) => real.of_integer(v.into()),
        Number::Float(v) => real.of_float(v),
    });
    Some([a.min(b), a.max(b)].map(Number::Float))
}

/// The least and the greatest value of an attribute, scaled; `None` where there is none, or the index can't be read.
pub(crate) fn scaled_ends(snapshot: &Snapshot, slot: Slot) -> Option<[f64; 2]> {
    let nodes = snapshot.nodes();
    let zones =
        nodes.roots().and_then(|roots| roots.iter().map(|root| nodes.zones(root)).collect::<Result<Vec<_>, _>>());
    let ends = range_of(slot, &snapshot.attribute(slot)?.attribute, &zones.ok()?)?;
    Some(ends.map(|end| match end {
        Number::Unsigned(v) => v as f64,
        Number::Signed(v) => v as f64,
        Number::Float(v) => v,
    }))
}

/// Describes a store; reads its index, no points.
///
/// # Errors
///
/// As [`info`].
pub fn describe(snapshot: &Snapshot) -> Result<Description, StoreError> {
    let info = info(snapshot)?;
    let site = snapshot.site();
    let root = site.root().map(Cube::k);
    let spacing = |k: u8| site.lattice.largest_quantum() * 2_f64.powi(i32::from(k) - i32::from(site.g));
    let nodes = snapshot.nodes();
    let zones = nodes.roots()?.iter().map(|root| nodes.zones(root)).collect::<Result<Vec<_>, _>>()?;
    let stored = info.attribute_bytes.iter().filter_map(|&(slot, bytes)| {
        let attribute = &snapshot.attribute(slot)?.attribute;
        let range = (attribute.no_data.is_none()).then(|| range_of(slot, attribute, &zones)).flatten();
        let (name, ty) = (attribute.name.clone(), attribute.ty.word());
        let (scaling, no_data) = (attribute.scaling, attribute.no_data_value());
        let (min, max) = range.map(|[min, max]| (min, max)).unzip();
        Some(AttributeCost { name, ty, bytes, min, max, scaling, no_data })
    });
    let cost = |name: &str, ty, bytes| {
        let (min, max, scaling, no_data) = (None, None, None, None);
        std::iter::once(AttributeCost { name: name.into(), ty, bytes, min, max, scaling, no_data })
    };
    let attributes = cost("position", "3 x u48", info.position_bytes).chain(stored);
    Ok(Description {
        points: info.points,
        scans: snapshot.scans().len(),
        scans_hidden: snapshot.scans().iter().filter(|s| !s.visible).count(),
        nodes: info.nodes,
        levels: info.levels,
        root_spacing: root.map(spacing),
        bounds: info.bounds.map(|b| WorldBounds::new(&site.lattice, &b)),
        quantum: site.lattice.quantum_f64(),
        phase: site.lattice.phase().map(Decimal::to_f64),
        crs: site.crs.as_ref().map(|c| CrsDescription {
            description: c.describe(),
            wkt: c.wkt.clone(),
            horizontal_epsg: c.horizontal_epsg,
            vertical_epsg: c.vertical_epsg,
        }),
        unit: site.crs.as_ref().and_then(|c| c.unit_name()),
        attributes: attributes.chain(cost("(scan of each point)", "u32", info.scan_bytes)).collect(),
        bytes_total: info.total_bytes,
        bytes_encoded: info.chunk_bytes,
        bytes_per_point: if info.points == 0 { 0.0 } else { info.total_bytes as f64 / info.points as f64 },
        bookmarks: snapshot.bookmarks()?.into_iter().map(|(name, _)| name).collect(),
        generation: site.generation,
        in_use: info.in_use,
    })
}

impl ScanDescription {
    /// Describes a scan of a store on this lattice.
    pub fn new(scan: &Scan, lattice: &Lattice) -> Self {
        Self {
            id: scan.id,
            name: scan.name.clone(),
            source: scan.source.clone(),
            format: scan.format.clone(),
            read: scan.read,
            stored: scan.stored,
            rejected: scan.rejected.total(),
            rejected_not_finite: scan.rejected.not_finite,
            rejected_out_of_range: scan.rejected.out_of_range,
            rejected_truncated: scan.rejected.truncated,
            positions: scan.exactness.word(),
            max_error: scan.largest_error,
            bounds: scan.bounds.map(|b| WorldBounds::new(lattice, &b)),
            pose: scan.pose,
            scanner: [scan.pose[3], scan.pose[7], scan.pose[11]],
            color_depth: scan.color_depth,
            visible: scan.visible,
            time: scan.time,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::{BIAS, BITS, LatticePoint};
    use crate::points::{ScalarType, Scaling};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn bounds_as_a_box_take_all_points_and_no_other_place(
            phase in prop::array::uniform3(0_i128..10_000_000_000_000_000),
            a in prop::array::uniform3(-1_000_000_i64..1_000_000), extent in prop::array::uniform3(0_u64..100_000),
        ) {
            // A phase of 16 digits, as that of a file whose offset is the mean of its points: the nearest float to the
            // minimum may be above it, and a box from there lost the lowest points.
            let lattice = Lattice::new([Decimal::new(1, -3); 3], phase.map(|p| Decimal::new(p, -19))).unwrap();
            let min = LatticePoint(a.map(|i| (BIAS + i) as u64));
            let max = LatticePoint(std::array::from_fn(|i| min.0[i] + extent[i]));
            let bounds = LatticeBox { min, max };
            let world = WorldBounds::new(&lattice, &bounds);
            prop_assert_eq!(lattice.box_from_world(world.min, world.max), Some(bounds));
        }
    }

    #[test]
    fn bounds_of_the_whole_lattice_take_its_last_index() {
        let lattice = Lattice::uniform(0.001).unwrap();
        let all = LatticeBox { min: LatticePoint::default(), max: LatticePoint([(1 << BITS) - 1; 3]) };
        let world = WorldBounds::new(&lattice, &all);
        assert_eq!(lattice.box_from_world(world.min, world.max), Some(all));
    }

    #[test]
    fn ranges_of_whole_numbers_keep_all_their_digits() {
        // They went through f64: 2^53 + 1 was told as 2^53.
        let zones = |slot, range| Arc::new(Zones { subtree: vec![(slot, range)], ..Zones::default() });
        let layers = [
            zones(3, Range::Unsigned((1 << 53) + 1, 1 << 60)),
            zones(3, Range::Unsigned(1 << 60, u64::MAX)),
            zones(4, Range::Signed(i64::MIN + 1, -1)),
        ];
        let range = |slot, ty, scaling| {
            let attribute = Attribute { scaling, ..Attribute::new("id", ty) };
            range_of(slot, &attribute, &layers).map(|range| serde_json::to_string(&range).unwrap())
        };
        assert_eq!(range(3, ScalarType::U64, None).unwrap(), "[9007199254740993,18446744073709551615]");
        assert_eq!(range(4, ScalarType::I64, None).unwrap(), "[-9223372036854775807,-1]");
        let down = Some(Scaling { scale: -1.0, offset: 0.5 });
        assert_eq!(range(4, ScalarType::I64, down).unwrap(), "[1.5,9.223372036854776e+18]");
        assert_eq!(range(5, ScalarType::U8, None), None);
    }
}

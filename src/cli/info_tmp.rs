//! tmp
use crate::lattice::{Lattice, LatticeBox, LatticePoint};
use crate::store::model::Scan;
use serde_json::{Value, json};
/// World bounds whose maximum is one quantum up, so that they take everything when used as a half-open box.
pub(super) fn world_bounds(lattice: &Lattice, bounds: &LatticeBox) -> ([f64; 3], [f64; 3]) {
    let last = (1 << crate::lattice::BITS) - 1;
    let up = LatticePoint(bounds.max.0.map(|i| (i + 1).min(last)));
    (lattice.world_from_lattice(bounds.min), lattice.world_from_lattice(up))
}

fn bounds_json(lattice: &Lattice, bounds: Option<&LatticeBox>) -> Value {
    bounds.map_or(Value::Null, |b| {
        let (min, max) = world_bounds(lattice, b);
        json!({ "min": min, "max": max })
    })
}

/// One scan as JSON.
pub(super) fn scan_json(scan: &Scan, lattice: &Lattice) -> Value {
    json!({
        "id": scan.id,
        "name": scan.name,
        "source": scan.source,
        "format": scan.format,
        "points": scan.stored,
        "read": scan.read,
        "rejected": {
            "not_finite": scan.rejected.not_finite,
            "out_of_range": scan.rejected.out_of_range,
            "truncated": scan.rejected.truncated,
        },
        "positions": scan.exactness.word(),
        "max_error": scan.largest_error,
        "bounds": bounds_json(lattice, scan.bounds.as_ref()),
        "color_depth": scan.color_depth,
        "visible": scan.visible,
        "time": scan.time,
    })
}


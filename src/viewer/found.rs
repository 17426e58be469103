//! A stored point as text.

use super::model::Found;
use super::site::Site;
use crate::geometry::DVec3;
use crate::points::Batch;

/// The one point of `batch`, with its exact coordinates and all that its scan recorded.
pub(super) fn found(batch: &Batch, site: &Site) -> Option<Found> {
    if batch.is_empty() {
        return None;
    }
    let point = batch.positions.point(0);
    let lattice = &site.lattice;
    let mut values: Vec<(String, String)> = ["x", "y", "z"]
        .into_iter()
        .enumerate()
        .map(|(axis, name)| (name.to_owned(), lattice.decimal_on_axis(axis, point.0[axis]).to_string()))
        .collect();
    if let Some(scan) = batch.scans.first().and_then(|id| site.scans.iter().find(|s| s.id == *id)) {
        values.push(("scan".into(), scan.name.clone()));
    }
    for (attribute, column) in batch.attributes.iter().zip(&batch.columns) {
        values.push((attribute.name.clone(), format!("{}", column.as_f64(0))));
    }
    Some(Found { world: DVec3::from_array(lattice.world_from_lattice(point)), values })
}

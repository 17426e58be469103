//! [`Frame::Scan`](super::Frame::Scan): the points of one scan where its scanner saw them.

use super::plan::is_las;
use super::{ExportError, Planned};
use crate::formats::{LasTarget, OutputFormat};
use crate::geometry::Pose;
use crate::lattice::{Decimal, Lattice};
use crate::points::{Batch, Column, Positions, normals_in};
use crate::query::OutputForm;
use crate::store::Snapshot;

/// The map from the store's lattice to one of the same quantum in the scan's frame.
pub(super) struct ScanFrame {
    pose: Pose,
    world: Lattice,
    frame: Lattice,
    /// A box around the scan, in its frame.
    bounds: ([f64; 3], [f64; 3]),
}

impl ScanFrame {
    /// Of the one scan that the answer is of.
    pub fn of(snapshot: &Snapshot, form: &OutputForm) -> Result<Self, ExportError> {
        let &[id] = form.scans.as_slice() else {
            return Err(ExportError::FrameOfSeveral);
        };
        let scan = snapshot.scan(id).ok_or(ExportError::NoScan(id))?;
        let pose =
            Pose::from_matrix(&scan.pose).map_err(|source| ExportError::Pose { scan: scan.name.clone(), source })?;
        let world = snapshot.site().lattice.clone();
        let frame = Lattice::new(world.quantum(), [Decimal::ZERO; 3])?;
        let mut bounds = ([0.0; 3], [0.0; 3]);
        if let Some(stored) = &scan.bounds {
            let (min, max) = (world.world_from_lattice(stored.min), world.world_from_lattice(stored.max));
            bounds = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
            for corner in 0..8 {
                let p = std::array::from_fn(|i| if corner >> i & 1 == 0 { min[i] } else { max[i] });
                for (i, v) in pose.scan_from_world(p).into_iter().enumerate() {
                    bounds.0[i] = bounds.0[i].min(v);
                    bounds.1[i] = bounds.1[i].max(v);
                }
            }
        }
        Ok(Self { pose, world, frame, bounds })
    }

    /// Makes the plan one for points in the scan's frame: no CRS, and a grid of the store's quantum, or `scale`.
    pub fn plan(
        &self,
        planned: &mut Planned,
        format: OutputFormat,
        scale: Option<[f64; 3]>,
    ) -> Result<(), ExportError> {
        let scale = scale.unwrap_or(self.frame.quantum_f64());
        let mut offset = [0.0; 3];
        for axis in (0..3).filter(|_| is_las(format)) {
            let (min, max) = (self.bounds.0[axis], self.bounds.1[axis]);
            // Zero, the scanner's place, where it fits: then other scans' files of this kind look the same.
            let fits = |o: f64| (max - o).max(o - min) / scale[axis] < f64::from(i32::MAX) - 1.0;
            let middle = (min / 2.0 + max / 2.0).round();
            let found = [0.0, middle].into_iter().find(|&o| fits(o));
            offset[axis] = found.ok_or(ExportError::TooWide { width: max - min, axis, scale: scale[axis] })?;
        }
        planned.plan.lattice = self.frame.clone();
        planned.plan.crs = None;
        planned.plan.las = LasTarget::Merged { scale, offset };
        Ok(())
    }

    /// Moves the points of a batch to the scan's frame, each coordinate to the nearest step there, and turns normals.
    pub fn apply(&self, batch: &mut Batch) -> Result<(), ExportError> {
        let mut moved = Positions::with_capacity(batch.len());
        for point in batch.positions.iter() {
            let p = self.pose.scan_from_world(self.world.world_from_lattice(point));
            moved.push(self.frame.lattice_from_world(p)?);
        }
        batch.positions = moved;
        if let Some(places) = normals_in(&batch.attributes).filter(|_| self.pose.turns()) {
            self.turn(&mut batch.columns, places);
        }
        Ok(())
    }

    /// Turns the normals back, which the ingest has turned to the world.
    fn turn(&self, columns: &mut [Column], places: [usize; 3]) {
        for i in 0..columns[places[0]].len() {
            let normal = places.map(|place| columns[place].as_f64(i));
            if normal.iter().any(|v| v.is_nan()) || normal == [0.0; 3] {
                continue;
            }
            for (place, v) in places.into_iter().zip(self.pose.scan_direction(normal)) {
                match &mut columns[place] {
                    Column::F32(values) => values[i] = v as f32,
                    Column::F64(values) => values[i] = v,
                    _ => {}
                }
            }
        }
    }
}

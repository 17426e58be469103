//! A source whose points are moved to the world by a pose, in f64, and whose normals are turned by it.

use super::{FormatError, Piece, PointSource, SourceInfo, Tally};
use crate::geometry::{Pose, PoseError};
use crate::points::{PositionKind, RecordLayout, ScalarType, has_other_normals, normals_in};

/// `source`, whose own pose its info names but its positions do not have yet, placed by it and then by `given`.
///
/// # Errors
///
/// [`PoseError`] if the two poses together leave the range of f64.
pub(crate) fn place(source: Box<dyn PointSource>, given: &Pose) -> Result<Box<dyn PointSource>, PoseError> {
    let pose = given.after(&source.info().pose)?;
    Ok(place_at(source, pose))
}

/// `source` placed by `pose`, whatever its own pose is.
pub(super) fn place_at(source: Box<dyn PointSource>, pose: Pose) -> Box<dyn PointSource> {
    let mut info = source.info().clone();
    if pose.is_identity() && info.pose.is_identity() {
        return source;
    }
    let scale = info.las.as_ref().map(|l| (l.scale, l.offset));
    let grid = info.grid.map(|g| scale.unwrap_or((g.scale.map(|d| d.to_f64()), g.offset.map(|d| d.to_f64()))));
    // The grid belongs to another frame.
    (info.grid, info.step) = (None, None);
    info.pose = pose;
    let hint = |(min, max): ([f64; 3], [f64; 3])| pose.world_bounds(min, max);
    info.bounds_hint = info.bounds_hint.map(hint).filter(|(a, b)| a.iter().chain(b).all(|v| v.is_finite()));
    info.layout = RecordLayout { position: PositionKind::World, ..info.layout };
    let turns = pose.turns();
    if turns && has_other_normals(&info.layout.attributes) {
        let kept = "its normals are not three floats of one type: they stay in the scan's own frame";
        info.warnings.push(kept.into());
    }
    let normals = turns.then(|| Normals::of(&info.layout)).flatten();
    Box::new(Posed { source, info, grid, normals })
}

struct Posed {
    source: Box<dyn PointSource>,
    info: SourceInfo,
    /// Scale and offset of the source's own grid, if it has one.
    grid: Option<([f64; 3], [f64; 3])>,
    normals: Option<Normals>,
}

/// Where a record's normal is, behind its position.
struct Normals {
    offsets: [usize; 3],
    ty: ScalarType,
}

impl Normals {
    fn of(layout: &RecordLayout) -> Option<Self> {
        let places = normals_in(&layout.attributes)?;
        let offsets = places.map(|i| layout.fields[i].offset);
        Some(Self { offsets, ty: layout.attributes[places[0]].ty })
    }

    /// Turns the normal in the bytes behind a position; one that is zero or NaN has no direction and stays as it is.
    fn turn(&self, pose: &Pose, payload: &mut [u8]) {
        let normal = self.offsets.map(|at| match self.ty {
            ScalarType::F32 => f64::from(f32::from_le_bytes(bytes(payload, at))),
            _ => f64::from_le_bytes(bytes(payload, at)),
        });
        if normal.iter().any(|v| v.is_nan()) || normal == [0.0; 3] {
            return;
        }
        for (at, v) in self.offsets.into_iter().zip(pose.world_direction(normal)) {
            match self.ty {
                ScalarType::F32 => payload[at..at + 4].copy_from_slice(&(v as f32).to_le_bytes()),
                _ => payload[at..at + 8].copy_from_slice(&v.to_le_bytes()),
            }
        }
    }
}

fn bytes<const N: usize>(payload: &[u8], at: usize) -> [u8; N] {
    let mut bytes = [0; N];
    bytes.copy_from_slice(&payload[at..at + N]);
    bytes
}

impl Posed {
    /// The position at the start of a record, in the scan's frame.
    fn position(&self, record: &[u8]) -> [f64; 3] {
        match self.grid {
            Some((scale, offset)) => std::array::from_fn(|i| {
                let mut raw = [0; 4];
                raw.copy_from_slice(&record[4 * i..4 * i + 4]);
                f64::from(i32::from_le_bytes(raw)) * scale[i] + offset[i]
            }),
            None => std::array::from_fn(|i| {
                let mut raw = [0; 8];
                raw.copy_from_slice(&record[8 * i..8 * i + 8]);
                f64::from_le_bytes(raw)
            }),
        }
    }
}

impl PointSource for Posed {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn warn(&mut self, warning: String) {
        self.info.warnings.push(warning);
    }

    fn found_while_reading(&self) -> Option<String> {
        self.source.found_while_reading()
    }

    fn pieces(&self, target_records: u64) -> Vec<Piece> {
        self.source.pieces(target_records)
    }

    fn read(&self, piece: Piece, sink: &mut dyn FnMut(&[u8]) -> bool) -> Result<Tally, FormatError> {
        let head = if self.grid.is_some() { PositionKind::Grid.size() } else { PositionKind::World.size() };
        let payload = self.info.layout.payload;
        let mut placed = Vec::new();
        self.source.read(piece, &mut |run| {
            placed.clear();
            for record in run.chunks_exact(head + payload) {
                let world = self.info.pose.world_from_scan(self.position(record));
                world.iter().for_each(|v| placed.extend_from_slice(&v.to_le_bytes()));
                let at = placed.len();
                placed.extend_from_slice(&record[head..]);
                if let Some(normals) = &self.normals {
                    normals.turn(&self.info.pose, &mut placed[at..]);
                }
            }
            sink(&placed)
        })
    }
}

//! The attributes of generated points, and a batch of them.

use crate::lattice::{BIAS, Lattice, LatticeError, LatticePoint};
use crate::points::{Attribute, Batch, Column, Positions, ScalarType};
use std::sync::Arc;

/// Where the models' local zero is, in metres: somewhere in Bavaria, if it is UTM zone 32 north.
pub(super) const ORIGIN: [f64; 3] = [690_000.0, 5_330_000.0, 500.0];
/// Steps per metre.
const STEPS: f64 = 1000.0;

/// Millimetres.
pub(super) fn lattice() -> Result<Lattice, LatticeError> {
    Lattice::uniform(1.0 / STEPS)
}

/// A point of a model.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// Metres from [`ORIGIN`].
    pub at: [f64; 3],
    pub color: [u8; 3],
    pub intensity: u16,
    /// Return number and number of returns.
    pub returns: (u8, u8),
    pub class: u8,
    /// Steps of 0.006 degrees.
    pub angle: i16,
    /// Does the mirror move towards positive angles, and does it turn here?
    pub forward: bool,
    pub edge: bool,
    pub time: f64,
    pub source: u16,
}

/// The columns, in this order.
pub(super) fn attributes() -> Arc<[Attribute]> {
    use ScalarType::{F64, I16, U8, U16};
    let all = [
        ("Blue", U16),
        ("Classification", U8),
        ("EdgeOfFlightLine", U8),
        ("GpsTime", F64),
        ("Green", U16),
        ("Intensity", U16),
        ("NumberOfReturns", U8),
        ("PointSourceId", U16),
        ("Red", U16),
        ("ReturnNumber", U8),
        ("ScanAngleRank", I16),
        ("ScanDirectionFlag", U8),
    ];
    all.map(|(name, ty)| Attribute::new(name, ty)).into()
}

/// Points by column, while they are made.
#[derive(Default)]
pub(super) struct Points {
    positions: Positions,
    bytes: [Vec<u8>; 5],
    words: [Vec<u16>; 5],
    angles: Vec<i16>,
    times: Vec<f64>,
}

impl Points {
    /// Room for `capacity` points.
    pub fn with_capacity(capacity: usize) -> Self {
        Self {
            positions: Positions::with_capacity(capacity),
            bytes: std::array::from_fn(|_| Vec::with_capacity(capacity)),
            words: std::array::from_fn(|_| Vec::with_capacity(capacity)),
            angles: Vec::with_capacity(capacity),
            times: Vec::with_capacity(capacity),
        }
    }

    /// The number of points.
    pub fn len(&self) -> usize {
        self.angles.len()
    }

    /// Appends a point.
    pub fn push(&mut self, s: &Sample) {
        let index = |axis: usize| {
            let steps = ((ORIGIN[axis] + s.at[axis]) * STEPS).round() as i64;
            (steps + BIAS).cast_unsigned()
        };
        self.positions.push(LatticePoint([index(0), index(1), index(2)]));
        let bytes = [s.class, u8::from(s.edge), s.returns.1, s.returns.0, u8::from(s.forward)];
        self.bytes.iter_mut().zip(bytes).for_each(|(v, b)| v.push(b));
        let [red, green, blue] = s.color.map(|c| u16::from(c) * 257);
        let words = [blue, green, s.intensity, s.source, red];
        self.words.iter_mut().zip(words).for_each(|(v, w)| v.push(w));
        self.angles.push(s.angle);
        self.times.push(s.time);
    }

    /// The points at `indices`.
    pub fn picked(&self, indices: impl Iterator<Item = usize> + Clone) -> Self {
        Self {
            positions: indices.clone().map(|i| self.positions.point(i)).collect(),
            bytes: std::array::from_fn(|c| indices.clone().map(|i| self.bytes[c][i]).collect()),
            words: std::array::from_fn(|c| indices.clone().map(|i| self.words[c][i]).collect()),
            angles: indices.clone().map(|i| self.angles[i]).collect(),
            times: indices.map(|i| self.times[i]).collect(),
        }
    }

    /// As a batch.
    pub fn into_batch(self) -> Batch {
        let [class, edge, of, number, forward] = self.bytes.map(Column::U8);
        let [blue, green, intensity, source, red] = self.words.map(Column::U16);
        let (times, angles) = (Column::F64(self.times), Column::I16(self.angles));
        let columns = vec![blue, class, edge, times, green, intensity, of, source, red, number, angles, forward];
        Batch { attributes: attributes(), positions: self.positions, scans: Vec::new(), columns }
    }
}

/// A colour made brighter or darker.
pub(super) fn shaded(color: [f64; 3], factor: f64) -> [u8; 3] {
    color.map(|c| (c * factor).round().clamp(0.0, 255.0) as u8)
}

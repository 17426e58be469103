//! Statistics of an answer's attributes: what `query` says when nothing is written.

use crate::lattice::Lattice;
use crate::points::{Attribute, Batch, Column};
use crate::store::model::{ScanId, StoredAttribute};
use serde::Serialize;

/// Least, greatest and mean value of one attribute over the points that have it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AttributeSummary {
    /// The attribute.
    pub name: String,
    /// `u8`, `f64`, ...; `coordinate` for `X`, `Y`, `Z`.
    #[serde(rename = "type")]
    pub ty: &'static str,
    /// Points with a value: not null, and not NaN.
    pub count: u64,
    /// The least value; an extra byte's is scaled.
    pub min: Option<f64>,
    /// The greatest value.
    pub max: Option<f64>,
    /// The mean.
    pub mean: Option<f64>,
}

/// Gathers the summaries of the batches of an answer.
#[derive(Clone, Debug)]
pub struct Summary {
    lattice: Lattice,
    axes: [Running; 3],
    columns: Vec<(Attribute, Option<Vec<ScanId>>, Running)>,
}

/// A mean that neither overflows nor loses small numbers after many.
#[derive(Clone, Copy, Debug)]
struct Running {
    count: u64,
    min: f64,
    max: f64,
    mean: f64,
}

impl Running {
    const EMPTY: Self = Self { count: 0, min: f64::INFINITY, max: f64::NEG_INFINITY, mean: 0.0 };

    fn add(&mut self, value: f64) {
        if value.is_nan() {
            return;
        }
        self.count += 1;
        self.min = self.min.min(value);
        self.max = self.max.max(value);
        self.mean += (value - self.mean) / self.count as f64;
    }

    fn summary(&self, name: &str, ty: &'static str) -> AttributeSummary {
        let some = |v: f64| (self.count > 0 && v.is_finite()).then_some(v);
        let (min, max, mean) = (some(self.min), some(self.max), some(self.mean));
        AttributeSummary { name: name.into(), ty, count: self.count, min, max, mean }
    }
}

impl Summary {
    /// For batches with these attributes; `scans_having` says which scans have an attribute, `None` for all.
    pub(crate) fn new(
        lattice: &Lattice,
        attributes: &[StoredAttribute],
        scans_having: impl Fn(&StoredAttribute) -> Option<Vec<ScanId>>,
    ) -> Self {
        let columns = attributes.iter().map(|a| (a.attribute.clone(), scans_having(a), Running::EMPTY));
        Self { lattice: lattice.clone(), axes: [Running::EMPTY; 3], columns: columns.collect() }
    }

    /// Takes in a batch. If some scan lacks an attribute, the batch must have its scans.
    pub fn add(&mut self, batch: &Batch) {
        let positions = &batch.positions;
        for (axis, values) in [&positions.x, &positions.y, &positions.z].into_iter().enumerate() {
            let running = &mut self.axes[axis];
            values.iter().for_each(|&v| running.add(self.lattice.world_on_axis(axis, v)));
        }
        for ((attribute, having, running), column) in self.columns.iter_mut().zip(&batch.columns) {
            let no_data = attribute.no_data.map(|mut bytes| {
                bytes[attribute.ty.size()..].fill(0);
                bytes
            });
            for i in 0..column.len() {
                let lacking =
                    |having: &Vec<ScanId>| batch.scans.get(i).is_some_and(|scan| having.binary_search(scan).is_err());
                if having.as_ref().is_some_and(lacking) || no_data.is_some_and(|n| column.raw(i) == n) {
                    continue;
                }
                running.add(value(attribute, column, i));
            }
        }
    }

    /// X, Y, Z, then the attributes.
    pub fn finish(&self) -> Vec<AttributeSummary> {
        let axes = ["X", "Y", "Z"].into_iter().zip(&self.axes).map(|(name, axis)| axis.summary(name, "coordinate"));
        axes.chain(self.columns.iter().map(|(a, _, running)| running.summary(&a.name, a.ty.word()))).collect()
    }
}

fn value(attribute: &Attribute, column: &Column, i: usize) -> f64 {
    let stored = column.as_f64(i);
    attribute.scaling.map_or(stored, |s| stored * s.scale + s.offset)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::{BIAS, LatticePoint};
    use crate::points::{Positions, ScalarType, Scaling};

    #[test]
    fn nulls_and_nan_are_left_out() {
        let mut height = Attribute::new("height", ScalarType::I16);
        height.scaling = Some(Scaling { scale: 0.5, offset: 1.0 });
        height.no_data = Some((-1_i16).to_le_bytes().into_iter().chain([9; 6]).collect::<Vec<_>>().try_into().unwrap());
        let attributes = [height, Attribute::new("time", ScalarType::F64)];
        let stored: Vec<_> =
            (2..).zip(attributes.clone()).map(|(id, attribute)| StoredAttribute { id, attribute }).collect();
        let lattice = Lattice::uniform(0.25).unwrap();
        let mut summary = Summary::new(&lattice, &stored, |a| (a.id == 2).then(|| vec![7]));
        let positions: Positions = (0..4).map(|i| LatticePoint([BIAS as u64 + i; 3])).collect();
        let columns = vec![Column::I16(vec![4, -1, 8, 100]), Column::F64(vec![1.0, f64::NAN, 3.0, 8.0])];
        summary.add(&Batch { attributes: attributes.into(), positions, scans: vec![7, 7, 7, 5], columns });
        let found = summary.finish();
        let numbers = |i: usize| (found[i].count, found[i].min, found[i].max, found[i].mean);
        assert_eq!(numbers(0), (4, Some(0.0), Some(0.75), Some(0.375)));
        assert_eq!(numbers(3), (2, Some(3.0), Some(5.0), Some(4.0)));
        assert_eq!(numbers(4), (3, Some(1.0), Some(8.0), Some(4.0)));
        assert_eq!(found[3].ty, "i16");
        let none = Summary::new(&lattice, &stored, |_| None).finish();
        assert_eq!((none[0].count, none[0].mean), (0, None));
    }
}

//! Points by column.

use super::{Attribute, Column, canonical_name, same_name};
use crate::lattice::LatticePoint;
use std::sync::Arc;

/// Lattice positions by axis; the three vectors have one length.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Positions {
    /// Indices on the x axis.
    pub x: Vec<u64>,
    /// Indices on the y axis.
    pub y: Vec<u64>,
    /// Indices on the z axis.
    pub z: Vec<u64>,
}

impl Positions {
    /// Room for `capacity` points.
    pub fn with_capacity(capacity: usize) -> Self {
        Self { x: Vec::with_capacity(capacity), y: Vec::with_capacity(capacity), z: Vec::with_capacity(capacity) }
    }

    /// The number of points.
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// No points?
    pub fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    /// Point `i`.
    ///
    /// # Panics
    ///
    /// If `i` is out of range.
    #[inline]
    pub fn point(&self, i: usize) -> LatticePoint {
        LatticePoint([self.x[i], self.y[i], self.z[i]])
    }

    /// Appends a point.
    #[inline]
    pub fn push(&mut self, point: LatticePoint) {
        self.x.push(point.0[0]);
        self.y.push(point.0[1]);
        self.z.push(point.0[2]);
    }

    /// All points in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = LatticePoint> + '_ {
        (0..self.len()).map(|i| self.point(i))
    }
}

impl FromIterator<LatticePoint> for Positions {
    fn from_iter<I: IntoIterator<Item = LatticePoint>>(points: I) -> Self {
        let mut positions = Self::default();
        points.into_iter().for_each(|p| positions.push(p));
        positions
    }
}

/// Points of one or several scans, by column. Every column has as many values as there are positions.
///
/// A point whose scan lacks an attribute has zero there; which scans have which attributes is the store's to say.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// What [`Batch::columns`] hold, in the same order.
    pub attributes: Arc<[Attribute]>,
    /// Where.
    pub positions: Positions,
    /// The id of each point's scan; empty if it was not asked for.
    pub scans: Vec<u32>,
    /// The values.
    pub columns: Vec<Column>,
}

impl Batch {
    /// An empty batch with these attributes.
    pub fn empty(attributes: Arc<[Attribute]>) -> Self {
        let columns = attributes.iter().map(|a| Column::with_capacity(a.ty, 0)).collect();
        Self { attributes, positions: Positions::default(), scans: Vec::new(), columns }
    }

    /// The number of points.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// No points?
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// The column of the attribute of this name, if it is there (the first, if several types share the name): exactly so, or
    /// as queries look names up, `intensity` or `return_number`. Its values are as they are stored: [`Real`](super::Real) makes
    /// real values of those of an attribute with a scaling. A point whose scan lacks the attribute has 0.
    pub fn column(&self, name: &str) -> Option<&Column> {
        let place = |test: &dyn Fn(&str) -> bool| self.attributes.iter().position(|a| test(&a.name));
        let found = place(&|n| n == name).or_else(|| place(&|n| same_name(n, name)));
        let found = found.or_else(|| canonical_name(name).and_then(|canonical| place(&|n| n == canonical)));
        found.map(|i| &self.columns[i])
    }

    /// The points at `indices`, in that order.
    ///
    /// # Panics
    ///
    /// If an index is out of range.
    #[must_use]
    pub fn gathered(&self, indices: &[u32]) -> Self {
        let pick = |v: &[u64]| indices.iter().map(|&i| v[i as usize]).collect();
        let positions =
            Positions { x: pick(&self.positions.x), y: pick(&self.positions.y), z: pick(&self.positions.z) };
        let scans =
            if self.scans.is_empty() { Vec::new() } else { indices.iter().map(|&i| self.scans[i as usize]).collect() };
        let columns = self
            .columns
            .iter()
            .map(|c| {
                let mut column = Column::with_capacity(c.ty(), indices.len());
                column.extend_gathered(c, indices);
                column
            })
            .collect();
        Self { attributes: self.attributes.clone(), positions, scans, columns }
    }

    /// Appends the points of `other`, which must have the same attributes.
    ///
    /// # Panics
    ///
    /// If number or types of the columns differ, or one of two batches with points knows their scans and the other doesn't.
    pub fn append(&mut self, other: &Self) {
        assert_eq!(self.columns.len(), other.columns.len(), "batches of other columns");
        let knows = |batch: &Self| batch.is_empty() || !batch.scans.is_empty();
        let neither = self.scans.is_empty() && other.scans.is_empty();
        assert!(neither || knows(self) && knows(other), "batches of which one has scans");
        self.positions.x.extend_from_slice(&other.positions.x);
        self.positions.y.extend_from_slice(&other.positions.y);
        self.positions.z.extend_from_slice(&other.positions.z);
        self.scans.extend_from_slice(&other.scans);
        for (a, b) in self.columns.iter_mut().zip(&other.columns) {
            a.append(b);
        }
    }
}

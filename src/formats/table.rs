//! Points that a program has in memory, as a source: columns instead of a file.

use super::las::even_pieces;
use super::names::{attribute_name, unique};
use super::{FormatError, Piece, PointSource, SourceInfo, Tally};
use crate::points::{Attribute, Column, Field, FieldKind, PositionKind, RecordLayout, ScalarType};
use crate::with_column;
use std::collections::HashSet;
use std::path::Path;
use std::sync::Arc;
use thiserror::Error;

/// Bytes that are given to a sink at a time, about.
const RUN_BYTES: usize = 1 << 18;

/// Points of a program: coordinates and columns of attributes, one value for each point.
///
/// ```
/// use esker::formats::PointTable;
/// use esker::points::Column;
///
/// let mut table = PointTable::new("trees", vec![1.0, 2.0], vec![5.0, 6.0], vec![10.25, 11.5])?;
/// table.add("Intensity", Column::U16(vec![700, 800]))?;
/// assert_eq!(table.len(), 2);
/// assert!(table.add("height", Column::F32(vec![1.0])).is_err());
/// # Ok::<(), esker::formats::TableError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct PointTable {
    name: String,
    axes: [Vec<f64>; 3],
    columns: Vec<(Attribute, Column)>,
}

/// Why columns are no table.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum TableError {
    /// A column is shorter or longer than the first.
    #[error("{name} has {values} values for {points} points")]
    Length {
        /// The column.
        name: String,
        /// Its values.
        values: usize,
        /// The points, as many as x has.
        points: usize,
    },
    /// Two columns are one attribute.
    #[error("{name} ({}) is there twice", ty.word())]
    Twice {
        /// The attribute.
        name: String,
        /// Its type.
        ty: ScalarType,
    },
    /// A name without a character.
    #[error("a name is empty")]
    NoName,
}

impl PointTable {
    /// Points at these places, in world coordinates and units of the CRS. One with a coordinate that is NaN or infinite will
    /// be rejected and counted. `name` is the scan's.
    ///
    /// # Errors
    ///
    /// [`TableError::Length`] if there are more or fewer of one axis; [`TableError::NoName`].
    pub fn new(name: impl Into<String>, x: Vec<f64>, y: Vec<f64>, z: Vec<f64>) -> Result<Self, TableError> {
        let (name, points) = (name.into(), x.len());
        if name.trim().is_empty() {
            return Err(TableError::NoName);
        }
        for (axis, values) in [("y", y.len()), ("z", z.len())] {
            if values != points {
                return Err(TableError::Length { name: axis.into(), values, points });
            }
        }
        Ok(Self { name, axes: [x, y, z], columns: Vec::new() })
    }

    /// An attribute of every point, under the name that a property of a PLY file would have: `intensity` is `Intensity`,
    /// `red` of 8 or 16 bits is `Red`, and so on for what LAS has.
    ///
    /// # Errors
    ///
    /// [`TableError`].
    pub fn add(&mut self, name: &str, column: Column) -> Result<(), TableError> {
        let (ty, points) = (column.ty(), self.len());
        if name.trim().is_empty() {
            return Err(TableError::NoName);
        }
        if column.len() != points {
            return Err(TableError::Length { name: name.into(), values: column.len(), points });
        }
        let mut taken: HashSet<_> = self.columns.iter().map(|(a, _)| (a.name.clone(), a.ty)).collect();
        let canonical = attribute_name(name, ty);
        if unique(canonical.clone(), name, ty, &mut taken) != canonical {
            return Err(TableError::Twice { name: canonical, ty });
        }
        self.columns.push((Attribute::new(canonical, ty), column));
        Ok(())
    }

    /// How many points there are.
    pub fn len(&self) -> usize {
        self.axes[0].len()
    }

    /// Are there none?
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A table as a source.
pub(crate) struct TableSource {
    info: SourceInfo,
    table: Arc<PointTable>,
    /// The place of each column's values behind the position.
    offsets: Vec<usize>,
}

impl TableSource {
    /// Of all its points.
    pub fn new(table: Arc<PointTable>) -> Self {
        // In canonical order: the same columns are the same points, however they were added.
        let mut order: Vec<usize> = (0..table.columns.len()).collect();
        order.sort_by(|&a, &b| table.columns[a].0.identity().cmp(&table.columns[b].0.identity()));
        let (mut end, mut fields, mut offsets) = (0, Vec::new(), vec![0; table.columns.len()]);
        for i in order {
            let attribute = &table.columns[i].0;
            fields.push((attribute.clone(), Field { offset: end, kind: FieldKind::Whole }));
            offsets[i] = end;
            end += attribute.ty.size();
        }
        let layout = RecordLayout::new(PositionKind::World, end, fields);
        let mut info = SourceInfo::new(Path::new(&table.name), "table", table.len() as u64, 0, layout);
        info.scan_name = Some(table.name.clone());
        Self { info, table, offsets }
    }

    /// Bytes of all its records.
    pub fn bytes(&self) -> u64 {
        self.info.records * self.info.layout.stride() as u64
    }

    /// BLAKE3 of what each point has, which stands for the bytes of a file. `go_on`: false ends it with `None`.
    pub fn content(&self, go_on: &dyn Fn() -> bool) -> Option<[u8; 32]> {
        let mut hasher = blake3::Hasher::new();
        hasher.update(b"esker table 1");
        for (attribute, field) in self.info.layout.attributes.iter().zip(&self.info.layout.fields) {
            let place = (field.offset as u64).to_le_bytes();
            for part in [attribute.name.as_bytes(), attribute.ty.word().as_bytes(), &place] {
                hasher.update(&(part.len() as u64).to_le_bytes()).update(part);
            }
        }
        let all = Piece { first: 0, records: self.info.records };
        let mut goes_on = true;
        self.records(all, &mut |run| {
            hasher.update(run);
            goes_on = go_on();
            goes_on
        });
        goes_on.then(|| *hasher.finalize().as_bytes())
    }

    fn records(&self, piece: Piece, sink: &mut dyn FnMut(&[u8]) -> bool) -> u64 {
        let stride = self.info.layout.stride();
        let at_once = (RUN_BYTES / stride).max(1);
        let (mut first, end) = (piece.first as usize, (piece.first + piece.records) as usize);
        let mut run = Vec::new();
        while first < end {
            let last = (first + at_once).min(end);
            run.clear();
            run.resize((last - first) * stride, 0);
            for (axis, values) in self.table.axes.iter().enumerate() {
                for (record, value) in run.chunks_exact_mut(stride).zip(&values[first..last]) {
                    record[8 * axis..8 * axis + 8].copy_from_slice(&value.to_le_bytes());
                }
            }
            for (offset, (_, column)) in self.offsets.iter().zip(&self.table.columns) {
                let at = PositionKind::World.size() + offset;
                with_column!(column, values => {
                    for (record, value) in run.chunks_exact_mut(stride).zip(&values[first..last]) {
                        let bytes = value.to_le_bytes();
                        record[at..at + bytes.len()].copy_from_slice(&bytes);
                    }
                });
            }
            first = last;
            if !sink(&run) {
                break;
            }
        }
        first as u64 - piece.first
    }
}

impl PointSource for TableSource {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn warn(&mut self, warning: String) {
        self.info.warnings.push(warning);
    }

    fn pieces(&self, target_records: u64) -> Vec<Piece> {
        even_pieces(self.info.records, target_records)
    }

    fn read(&self, piece: Piece, sink: &mut dyn FnMut(&[u8]) -> bool) -> Result<Tally, FormatError> {
        Ok(Tally { read: self.records(piece, sink), truncated: 0 })
    }
}

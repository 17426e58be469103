//! Points of scans that tell no returns, in a LAS file beside others that do: no pulse has returns 0 of 0, and readers that
//! keep first or last returns would drop them. As PDAL has it, they are return 1 of 1.

use crate::points::{Attribute, Batch, Column};
use crate::store::model::ScanId;

/// What tells returns.
pub(super) const RETURNS: [&str; 2] = ["ReturnNumber", "NumberOfReturns"];

/// Scans without returns.
#[derive(Clone, Debug, Default)]
pub struct WithoutReturns {
    /// The columns to fill.
    columns: Vec<usize>,
    /// Ascending.
    scans: Vec<ScanId>,
}

impl WithoutReturns {
    /// For a file with these attributes. Where none tells returns, the writer does as much for all points.
    pub(super) fn of(attributes: &[Attribute], mut scans: Vec<ScanId>) -> Self {
        let is_column = |a: &Attribute| RETURNS.contains(&a.name.as_str());
        let columns: Vec<usize> = (0..attributes.len()).filter(|&i| is_column(&attributes[i])).collect();
        if columns.is_empty() {
            scans.clear();
        }
        scans.sort_unstable();
        Self { columns, scans }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.scans.is_empty()
    }

    pub(super) fn note(&self) -> Option<String> {
        let note = || "some of the scans have no returns: their points are return 1 of 1 there".to_owned();
        (!self.is_empty()).then(note)
    }

    /// Fills the columns of a batch, whose scans must be known.
    pub(super) fn apply(&self, batch: &mut Batch) {
        if self.is_empty() {
            return;
        }
        for &column in &self.columns {
            // LAS has them in bytes; an attribute of the name in another type is an extra byte.
            if let Column::U8(values) = &mut batch.columns[column] {
                let lacks = |scan: &ScanId| self.scans.binary_search(scan).is_ok();
                values.iter_mut().zip(&batch.scans).filter(|(_, scan)| lacks(scan)).for_each(|(value, _)| *value = 1);
            }
        }
    }
}

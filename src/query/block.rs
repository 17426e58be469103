//! The decoded columns of one block of a part.

use super::mask::Mask;
use crate::points::{Column, Positions};
use crate::store::model::{ScanId, Slot};
use std::sync::Arc;

/// What was decoded of a block.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Block {
    /// The number of points.
    pub len: usize,
    /// Where they are; empty if that was not asked for.
    pub positions: Arc<Positions>,
    /// Whose they are.
    pub scans: BlockScans,
    /// The attributes asked for; `None` where no point of the part has it.
    pub columns: Vec<(Slot, Option<Arc<Column>>)>,
}

impl Block {
    /// Of which nothing is known yet.
    pub fn undecoded(len: usize) -> Self {
        Self { len, positions: Arc::default(), scans: BlockScans::One(0), columns: Vec::new() }
    }

    /// An attribute's values; `None` if it was not decoded or no point of the part has it.
    pub fn column(&self, slot: Slot) -> Option<&Column> {
        self.shared_column(slot).map(|column| &**column)
    }

    /// The same to keep.
    pub fn shared_column(&self, slot: Slot) -> Option<&Arc<Column>> {
        self.columns.iter().find(|(s, _)| *s == slot).and_then(|(_, c)| c.as_ref())
    }
}

/// The scans of the points of a block.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum BlockScans {
    /// All points are of one scan.
    One(ScanId),
    /// Each point's scan.
    Each(Vec<ScanId>),
}

impl BlockScans {
    /// The points whose scan is in `set`, which ascends.
    pub fn within(&self, set: &[ScanId], len: usize) -> Mask {
        match self {
            Self::One(scan) if set.binary_search(scan).is_ok() => Mask::all(len),
            Self::One(_) => Mask::none(len),
            Self::Each(scans) => match set {
                &[one] => Mask::where_each(scans, |s| s == one),
                set => Mask::where_each(scans, |s| set.binary_search(&s).is_ok()),
            },
        }
    }

    /// The scan of point `i`.
    pub fn of(&self, i: usize) -> ScanId {
        match self {
            Self::One(scan) => *scan,
            Self::Each(scans) => scans[i],
        }
    }
}

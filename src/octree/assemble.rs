//! The bulk builder: bottom-up from sorted buckets, nodes given out in post-order, for ingest.
//!
//! A *bucket* is an aligned cube with its points sorted by key; the buckets of a tree are disjoint, hold all its points,
//! and may have different exponents. [`build_bucket`] gives out all nodes inside a bucket, buckets in parallel as one
//! likes; what belongs to nodes at or above the bucket is left over. An [`Assembler`] takes the left-overs as
//! [`Subtree`]s in key order and gives out the nodes above: blocks of points, which may be anywhere meanwhile. Both are
//! pure functions of the points.
//!
//! What makes it work: a node of exponent `k` below the root has in its cube exactly the points with
//! `win < k + 1 - g` that coarser nodes have not taken, so it is decided from the wins of its run alone.

mod bucket;
mod join;

pub use bucket::{BucketRest, EmittedNode, build_bucket};
pub use join::{Assembler, Block, OwnedNode, Subtree};

use super::Params;

/// Where a cube stands in its tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// It is the root: nothing above takes points from it.
    Root,
    /// It lies inside the root.
    Below,
}

impl Place {
    /// Points of a cube of exponent `k` with at least this win are stored above it.
    fn taken(self, k: u8, params: Params) -> i8 {
        match self {
            Self::Root => i8::MAX,
            Self::Below => params.cell(k) + 1,
        }
    }
}

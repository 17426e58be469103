//! The canonical layered octree as pure functions on points in memory: where a point is stored, in which order a node's
//! points give detail, and how far from the truth any part of them is. Specified by `OCTREE.md`.
//!
//! Nothing here knows of attributes, bytes or files. [`assemble`](mod@assemble) builds a tree from sorted buckets, for
//! ingest; [`Tree`] changes one in place, on any storage of nodes.

pub mod assemble;
#[doc(hidden)]
pub mod naive;
mod params;
mod step;
mod win;

pub use params::{Params, root_of};
pub use step::Step;
pub use win::{first_win, steps, wins};

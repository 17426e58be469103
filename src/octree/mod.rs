//! The canonical layered octree as pure functions on points in memory: where a point is stored, in which order a node's
//! points give detail, and how far from the truth any part of them is. Specified by `docs/octree.md`.
//!
//! Nothing here knows of attributes, bytes or files. [`assemble`] builds a tree from sorted buckets, for
//! ingest; [`Tree`] changes one in place, on any storage of nodes.

pub mod assemble;
mod bound;
mod insert;
#[cfg(test)]
mod laws;
#[cfg(test)]
mod layers;
#[cfg(test)]
mod memory;
#[cfg(test)]
pub(crate) mod naive;
mod nodes;
mod params;
mod parts;
mod remove;
mod step;
mod thin;
mod tree;
mod win;

#[cfg(test)]
use bound::Frontier;
pub use bound::Metric;
#[cfg(test)]
use layers::{filtered, level};
#[cfg(test)]
use memory::{Matching, MemoryTree, Node, Requests};
pub use nodes::{Nodes, Row, TreePoint};
pub use params::{Params, root_of};
#[cfg(test)]
pub(crate) use parts::split_at_least;
pub use parts::{LEAST_PART_POINTS, MOST_PARTS, MOST_REPEATED_POINTS, PartPlan, split};
pub use remove::Doomed;
pub use step::Step;
#[cfg(test)]
pub(crate) use thin::canonical_order;
pub use thin::{EvenPrefix, even_order};
pub use tree::Tree;
pub use win::{first_win, put_wins, steps, wins};

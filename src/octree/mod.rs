//! The canonical layered octree as pure functions on points in memory: where a point is stored, in which order a node's
//! points give detail, and how far from the truth any part of them is. Specified by `OCTREE.md`.
//!
//! Nothing here knows of attributes, bytes or files. [`assemble`](mod@assemble) builds a tree from sorted buckets, for
//! ingest; [`Tree`] changes one in place, on any storage of nodes.

pub mod assemble;
mod bound;
mod insert;
#[cfg(test)]
mod laws;
mod layers;
#[doc(hidden)]
pub mod naive;
mod nodes;
mod params;
mod parts;
mod remove;
mod step;
mod thin;
mod tree;
mod win;

pub use bound::{Frontier, Metric, step_bound};
pub use layers::{filtered, level};
pub use nodes::{MemoryNodes, Node, Nodes, Row, TreePoint};
pub use params::{Params, root_of};
#[cfg(test)]
pub(crate) use parts::split_at_least;
pub use parts::{LEAST_PART_POINTS, MOST_PARTS, MOST_REPEATED_POINTS, PartPlan, split};
pub use remove::{Doomed, Matching, Requests};
pub use step::Step;
pub use thin::{DetailOrder, EvenPrefix, canonical_order, even_order};
pub use tree::{MemoryTree, Tree};
pub use win::{first_win, put_wins, steps, wins};

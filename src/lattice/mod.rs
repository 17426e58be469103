//! The integer grid that every coordinate lives on: exact decimals, lattice points, Morton keys, cubes.
//!
//! Nothing here knows about attributes, nodes or files.

mod cube;
mod decimal;
mod grid;
mod morton;
mod source;

pub use cube::{Cube, LatticeBox, NodeKey};
pub use decimal::Decimal;
pub use grid::{BIAS, Lattice, LatticeError};
pub use morton::{Key, LOW_DIGITS, PRIORITY_MASK, SortKey};
pub use source::{Exactness, SourceGrid, SourceMap};

/// Bits per axis.
pub const BITS: u8 = 48;

/// A point on the lattice: three indices of [`BITS`] bits each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct LatticePoint(pub [u64; 3]);

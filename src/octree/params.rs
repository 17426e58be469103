//! The two numbers that the sampling rule depends on, and the root's cube.

use crate::lattice::{BITS, Cube, LatticeBox};

/// The parameters of the sampling rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Params {
    /// A node of exponent `k` samples on cells of exponent `k - g`.
    pub g: u8,
    /// A node with at most this many remaining points is a leaf.
    pub leaf_capacity: u32,
}

impl Params {
    /// Is a node of exponent `k` with `rem` remaining points a leaf?
    pub fn is_leaf(self, k: u8, rem: u64) -> bool {
        rem <= u64::from(self.leaf_capacity) || k <= self.g
    }

    /// The exponent of the cells on which a node of exponent `k` samples; negative below the finest node.
    pub fn cell(self, k: u8) -> i8 {
        // Exponents are at most 48 each.
        k.min(BITS) as i8 - self.g.min(BITS) as i8
    }
}

/// The root of a tree whose points have these bounds: the smallest aligned cube of exponent at least `g` around them.
pub fn root_of(bounds: &LatticeBox, params: Params) -> Cube {
    Cube::spanning(bounds.min, bounds.max, params.g)
}

//! The sampling rule as pure functions: `../shared/OCTREE.md` is its specification.

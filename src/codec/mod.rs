//! Batches to bytes and back; pure.

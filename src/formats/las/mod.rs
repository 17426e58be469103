//! LAS, LAZ and COPC files in.

pub mod tables;

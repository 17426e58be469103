//! Boxes, frusta, cameras, in f64.

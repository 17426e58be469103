//! What must be on the graphics adapter for a camera that moves, without a window and without wgpu.

pub mod gpu;

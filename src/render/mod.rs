//! Pictures: wgpu passes and the reference renderer.

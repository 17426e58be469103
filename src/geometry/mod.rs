//! Boxes, frusta, cameras, poses, in f64.
//!
//! World coordinates may be as large as ECEF or UTM ones, so whatever is compared with a camera is given relative to its
//! eye: the difference is formed once, where the coordinates are exact, and everything after it is small.

mod bounds;
mod camera;
mod camera_file;
mod convex;
mod framing;
mod frustum;
mod pose;
#[cfg(test)]
mod tests;

pub use bounds::WorldBox;
pub use camera::{Camera, CameraError, Projection};
pub use convex::{ClipDepth, Convex, HalfSpace};
pub use framing::{Framed, Framing, ImageArea};
pub use frustum::{Containment, Frustum};
pub use pose::{Pose, PoseError};

pub use glam::{DMat4, DVec3, DVec4};

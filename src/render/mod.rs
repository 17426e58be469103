//! Pictures of points without a window: wgpu passes, and, for tests, a reference renderer that states what the image must be.
//!
//! A [`Scene`] holds points on a lattice with their colours, grouped by how far apart they lie; where they come from is
//! the caller's business. [`Renderer`] draws it on the graphics adapter, a software one if there is no other;
//! `reference.rs` draws the same image on the CPU, point by point in `f64`. The two agree up to the bound stated there.
//!
//! What an image is, in both:
//!
//! - Each point is a disc that faces the eye, at the point's depth, its radius a factor of the spacing, at least half a
//!   pixel and at most a part of the image. A pixel belongs to the disc if its centre lies inside; the pixel that holds
//!   the disc's centre always does, so no point vanishes.
//! - The nearest disc wins a pixel; of equally near ones (in `f32`) the first drawn stays: drawing order is the order of
//!   nodes in the scene, then of points in the node.
//! - Colours are sRGB-coded bytes. Eye-dome lighting darkens them in linear light; without it, and for points without
//!   nearer neighbours, they are the image's bytes exactly.
//! - Depth is reversed, with infinite far, in 32-bit floats, and counted from the nearest point of the scene, so that a
//!   camera 10,000 km away still tells centimetres apart.
//!
//! ```no_run
//! use esker::geometry::{Camera, DVec3, Projection, WorldBox};
//! use esker::lattice::Lattice;
//! use esker::render::{RenderNode, RenderOptions, Renderer, Scene};
//!
//! let lattice = Lattice::uniform(0.001)?;
//! let positions = [lattice.lattice_from_world([500_000.0, 5_000_000.0, 120.0])?].into_iter().collect();
//! let nodes = vec![RenderNode { spacing: 0.05, positions, colors: vec![[200, 100, 50, 255]] }];
//! let scene = Scene { lattice, nodes, boxes: Vec::new() };
//! let camera = Camera::new(
//!     DVec3::new(500_000.0, 4_999_999.0, 120.0),
//!     DVec3::new(500_000.0, 5_000_000.0, 120.0),
//!     DVec3::Z,
//!     Projection::Perspective { fov_y_rad: 1.0 },
//!     [640, 480],
//! )?;
//! let image = Renderer::new()?.render(&scene, &camera, &RenderOptions::default())?;
//! image.write_png("point.png", false)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod adapter;
mod canvas;
mod clip;
mod color;
mod cut;
mod error;
mod font;
mod frame;
mod gpu_types;
mod image;
mod legend_image;
mod lines;
mod list;
mod options;
mod pack;
mod passes;
mod pick;
mod pool;
mod read_back;
#[cfg(test)]
mod reference;
mod renderer;
mod scene;

pub use adapter::{adapter, instance};
pub use canvas::Canvas;
pub use clip::{ClipBox, MAX_CLIPS};
pub use color::{
    ColorDepths, ColorMode, ColorOptions, Colored, Coloring, Legend, LegendEntry, LegendKey, NO_VALUE, Palette,
    ValuePaint, colors,
};
pub use error::RenderError;
pub use image::Image;
pub use options::{Background, Edl, Fog, RenderOptions, Shape};
pub use pick::{PickRequest, Picked};
pub use pool::{GpuPool, PoolPoints};
pub use renderer::{Renderer, View};
pub use scene::{RenderNode, Scene};

#[cfg(test)]
mod tests;

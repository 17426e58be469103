//! One picture's camera in the numbers that drawing needs, in `f64`: shared by the passes and the reference renderer.

use super::{RenderError, RenderOptions};
use crate::geometry::{Camera, DVec3, Projection};
use crate::lattice::{Lattice, LatticeBox, LatticePoint};
use glam::DMat3;

/// No nearer than this in any unit: keeps the depth a normal `f32`.
const LEAST_NEAR: f64 = 1e-18;

/// The camera, and where the scene's depth begins.
#[derive(Clone, Debug)]
pub(super) struct Frame {
    pub eye: DVec3,
    /// Rows right, up, forward.
    pub view_from_relative: DMat3,
    pub size_px: [u32; 2],
    /// Pixels per unit of length: at depth 1 in perspective, anywhere in orthographic.
    pub focal_px: f64,
    pub perspective: bool,
    pub near: f64,
    pub far: Option<f64>,
    /// The depth of the nearest point that could be seen, or less.
    pub front: f64,
    /// Reversed depth is `depth_scale / (depth_scale + depth - front)`.
    pub depth_scale: f64,
    pub min_radius_px: f64,
    pub max_radius_px: f64,
    /// 0 without eye-dome lighting.
    pub edl_strength: f32,
    pub edl_radius_px: f32,
    /// Those to keep first.
    pub clips: Vec<ViewClip>,
}

/// A clip box in view coordinates: a point is inside if `unit_from_view * view + offset` is from -1 to 1 on all axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct ViewClip {
    pub unit_from_view: DMat3,
    pub offset: DVec3,
    pub keep: bool,
}

impl Frame {
    /// `bounds` hold everything that is drawn; the depth begins there.
    ///
    /// # Errors
    ///
    /// As [`RenderOptions::check`]; [`RenderError::Size`] for sides of 0 or above `limit`.
    pub fn new(
        lattice: &Lattice,
        bounds: impl Iterator<Item = LatticeBox>,
        camera: &Camera,
        options: &RenderOptions,
        limit: u32,
    ) -> Result<Self, RenderError> {
        options.check()?;
        let size_px = camera.size_px();
        let [width, height] = size_px;
        if size_px.iter().any(|side| !(1..=limit).contains(side)) {
            return Err(RenderError::Size { width, height, limit });
        }
        let to_view = camera.view_from_relative();
        let view_from_relative = DMat3::from_cols(to_view.row(0), to_view.row(1), -to_view.row(2)).transpose();
        let height = f64::from(height);
        let (focal_px, perspective) = match camera.projection() {
            Projection::Perspective { fov_y_rad } => (height / (2.0 * (fov_y_rad / 2.0).tan()), true),
            Projection::Orthographic { height: seen } => (height / seen, false),
        };
        let near = if perspective { camera.near().max(LEAST_NEAR) } else { camera.near() };
        let clip = |keep: bool| options.clips.iter().filter(move |clip| clip.keeps() == keep);
        let clips = clip(true).chain(clip(false)).map(|clip| {
            let (unit_from_view, offset) = clip.unit_from_view(camera.eye(), view_from_relative);
            ViewClip { unit_from_view, offset, keep: clip.keeps() }
        });
        let mut frame = Self {
            eye: camera.eye(),
            view_from_relative,
            size_px,
            focal_px,
            perspective,
            near,
            far: camera.far(),
            front: near,
            depth_scale: 1.0,
            min_radius_px: options.min_radius_px,
            max_radius_px: (options.max_radius_of_height * height)
                .min(options.max_radius_px)
                .max(options.min_radius_px),
            edl_strength: options.edl.map_or(0.0, |edl| edl.strength),
            edl_radius_px: options.edl.map_or(1.0, |edl| edl.radius_px),
            clips: clips.collect(),
        };
        frame.fit_depth(lattice, bounds);
        Ok(frame)
    }

    /// View coordinates of a world position: right, up, depth.
    pub fn view_from_world(&self, world: [f64; 3]) -> DVec3 {
        self.view_from_relative * (DVec3::from_array(world) - self.eye)
    }

    /// Do the clip boxes leave the point at these view coordinates?
    #[cfg(test)]
    pub fn keeps(&self, view: DVec3) -> bool {
        let inside = |clip: &&ViewClip| {
            let unit = clip.unit_from_view * view + clip.offset;
            unit.abs().cmple(DVec3::ONE).all()
        };
        let (keep, cut) = self.clips.split_at(self.clips.iter().filter(|clip| clip.keep).count());
        (keep.is_empty() || keep.iter().any(|c| inside(&c))) && !cut.iter().any(|c| inside(&c))
    }

    /// Reversed depth, 1 at the front and before it.
    #[cfg(test)]
    pub fn reversed(&self, depth: f64) -> f32 {
        (self.depth_scale / (self.depth_scale + (depth - self.front))).clamp(0.0, 1.0) as f32
    }

    /// Begins the depth at the scene, and spreads it over the scene's extent.
    ///
    /// `f32` resolves `depth_scale / (depth_scale + x)` to about `6e-8 * (depth_scale + x)`. With the scale at the front's own
    /// depth this is the usual reversed depth, near / depth; if the scene is much further away than it is deep, its
    /// extent is the better scale.
    fn fit_depth(&mut self, lattice: &Lattice, bounds: impl Iterator<Item = LatticeBox>) {
        let (mut nearest, mut farthest) = (f64::INFINITY, f64::NEG_INFINITY);
        for bounds in bounds {
            for corner in corners(&bounds) {
                let depth = self.view_from_world(lattice.world_from_lattice(corner)).z;
                nearest = nearest.min(depth);
                farthest = farthest.max(depth);
            }
        }
        if farthest < self.near {
            // Nothing can be seen; -infinity without points.
            return;
        }
        self.front = nearest.max(self.near);
        let extent = farthest - self.front;
        self.depth_scale = match (self.perspective, extent > LEAST_NEAR) {
            (true, true) => self.front.min(extent),
            (true, false) => self.front,
            (false, true) => extent,
            (false, false) => 1.0,
        };
    }
}

pub(super) fn corners(bounds: &LatticeBox) -> impl Iterator<Item = LatticePoint> {
    let ends = [bounds.min.0, bounds.max.0];
    (0..8).map(move |corner| LatticePoint(std::array::from_fn(|i| ends[corner >> i & 1][i])))
}

//! Boxes that keep or cut out points.

use super::RenderError;
use crate::geometry::{DVec3, WorldBox};
use glam::DMat3;

/// The most boxes of one picture.
pub const MAX_CLIPS: usize = 8;

/// A box, in any direction, whose points are kept or cut out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClipBox {
    center: DVec3,
    /// From a direction to half sides.
    unit_from_world: DMat3,
    keep: bool,
}

impl ClipBox {
    /// The box around `center` with these half sides: three vectors that are perpendicular to each other or nearly so.
    ///
    /// # Errors
    ///
    /// [`RenderError::Number`] if the half sides span no volume, or a number is not finite.
    pub fn new(center: DVec3, half_sides: [DVec3; 3], keep: bool) -> Result<Self, RenderError> {
        let world_from_unit = DMat3::from_cols(half_sides[0], half_sides[1], half_sides[2]);
        let volume = world_from_unit.determinant().abs();
        let unit_from_world = world_from_unit.inverse();
        if !(volume > 0.0 && center.is_finite() && unit_from_world.is_finite()) {
            let (name, expected) = ("the volume of a clip box", "positive, from finite corners");
            return Err(RenderError::Number { name, value: volume, expected });
        }
        Ok(Self { center, unit_from_world, keep })
    }

    /// The box between two corners.
    ///
    /// # Errors
    ///
    /// As [`ClipBox::new`].
    pub fn from_bounds(bounds: &WorldBox, keep: bool) -> Result<Self, RenderError> {
        let half = (bounds.max() - bounds.min()) / 2.0;
        Self::new(bounds.center(), [DVec3::X * half.x, DVec3::Y * half.y, DVec3::Z * half.z], keep)
    }

    /// Are the points inside kept (and those outside not drawn), or cut out?
    pub fn keeps(&self) -> bool {
        self.keep
    }

    /// Three rows and three numbers: `row * view + number` is from -1 to 1 on all three for a point inside, where `view`
    /// is relative to `eye`.
    pub(super) fn unit_from_view(&self, eye: DVec3, view_from_relative: DMat3) -> (DMat3, DVec3) {
        (self.unit_from_world * view_from_relative.transpose(), self.unit_from_world * (eye - self.center))
    }
}

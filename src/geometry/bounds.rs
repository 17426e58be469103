//! Axis-aligned boxes in world coordinates, or relative to an eye.

use glam::DVec3;

/// A closed axis-aligned box: finite, `min <= max` on every axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorldBox {
    min: DVec3,
    max: DVec3,
}

impl WorldBox {
    /// The box between two corners; `None` if a number is not finite or a minimum is above its maximum.
    pub fn new(min: [f64; 3], max: [f64; 3]) -> Option<Self> {
        let (min, max) = (DVec3::from_array(min), DVec3::from_array(max));
        (min.is_finite() && max.is_finite() && min.cmple(max).all()).then_some(Self { min, max })
    }

    /// The low corner.
    pub fn min(&self) -> DVec3 {
        self.min
    }

    /// The high corner.
    pub fn max(&self) -> DVec3 {
        self.max
    }

    /// The centre.
    pub fn center(&self) -> DVec3 {
        self.min + (self.max - self.min) * 0.5
    }

    /// The sides.
    pub fn extent(&self) -> DVec3 {
        self.max - self.min
    }

    /// The eight corners; bit 0 of the index is x, bit 1 y, bit 2 z.
    pub fn corners(&self) -> [DVec3; 8] {
        std::array::from_fn(|i| {
            let pick = |axis: usize| if i >> axis & 1 == 1 { self.max[axis] } else { self.min[axis] };
            DVec3::new(pick(0), pick(1), pick(2))
        })
    }

    /// The distance from `point` to the nearest point of the box; 0 inside.
    pub fn distance_to(&self, point: DVec3) -> f64 {
        (self.min - point).max(point - self.max).max(DVec3::ZERO).length()
    }

    /// The distance from `point` to the farthest point of the box.
    pub fn farthest_distance_to(&self, point: DVec3) -> f64 {
        (self.min - point).abs().max((self.max - point).abs()).length()
    }
}

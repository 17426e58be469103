//! What a camera can see, as planes relative to its eye.

use super::{Camera, HalfSpace, Projection, WorldBox};
use glam::DVec3;

/// How a box lies to a region.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Containment {
    /// No point of the box is inside.
    Outside,
    /// Some points of the box may be inside.
    Partly,
    /// All points of the box are inside.
    Inside,
}

/// The convex set of points that can be on a camera's image, in coordinates relative to the eye.
///
/// Boxes at 1e7 m and millimetres before the eye are told apart alike, because nothing here is larger than what it is
/// compared with.
#[derive(Clone, Debug, PartialEq)]
pub struct Frustum {
    planes: Vec<Plane>,
}

/// `normal . p + offset >= 0` is inside; the normal has unit length.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Plane {
    normal: DVec3,
    offset: f64,
}

/// Rounding in a plane's test, relative to the size of its terms.
const SLACK: f64 = 1e-13;

impl Frustum {
    pub(super) fn of(camera: &Camera) -> Self {
        let view_from_relative = camera.view_from_relative();
        let (right, up, forward) = (view_from_relative.row(0), view_from_relative.row(1), camera.forward());
        let mut planes = Vec::with_capacity(6);
        match camera.projection() {
            Projection::Perspective { fov_y_rad } => {
                let tan_y = (fov_y_rad / 2.0).tan();
                let tan_x = tan_y * camera.aspect();
                for (across, tan) in [(right, tan_x), (-right, tan_x), (up, tan_y), (-up, tan_y)] {
                    planes.push(Plane { normal: (forward * tan + across).normalize(), offset: 0.0 });
                }
            }
            Projection::Orthographic { height } => {
                let (half_x, half_y) = (height * camera.aspect() / 2.0, height / 2.0);
                for (across, half) in [(right, half_x), (-right, half_x), (up, half_y), (-up, half_y)] {
                    planes.push(Plane { normal: across, offset: half });
                }
            }
        }
        planes.push(Plane { normal: forward, offset: -camera.near() });
        if let Some(far) = camera.far() {
            planes.push(Plane { normal: -forward, offset: far });
        }
        Self { planes }
    }

    /// How a box, given relative to the eye, lies to the frustum. `Outside` and `Inside` are certain; a box that only
    /// comes near an edge may be called `Partly`.
    pub fn classify(&self, relative: &WorldBox) -> Containment {
        let mut answer = Containment::Inside;
        for plane in &self.planes {
            let (farthest, nearest) = plane.extremes(relative);
            let reach = relative.min().abs().max(relative.max().abs()).element_sum() + plane.offset.abs();
            let slack = reach * SLACK;
            if farthest < -slack {
                return Containment::Outside;
            }
            if nearest < slack {
                answer = Containment::Partly;
            }
        }
        answer
    }

    /// Its planes, for points relative to the eye.
    pub(super) fn half_spaces(&self) -> impl Iterator<Item = HalfSpace> + '_ {
        self.planes.iter().map(|p| HalfSpace { normal: p.normal.to_array(), offset: p.offset, open: false })
    }

    /// Is a point, given relative to the eye, inside?
    pub fn contains(&self, relative: DVec3) -> bool {
        self.planes.iter().all(|p| p.normal.dot(relative) + p.offset >= 0.0)
    }
}

impl Plane {
    /// The greatest and the least signed distance of a point of the box.
    fn extremes(&self, relative: &WorldBox) -> (f64, f64) {
        let (a, b) = (self.normal * relative.min(), self.normal * relative.max());
        (a.max(b).element_sum() + self.offset, a.min(b).element_sum() + self.offset)
    }
}

//! Convex sets as intersections of half-spaces: oriented boxes, what a camera sees, what a clip matrix keeps.

use super::Camera;
use glam::{DMat3, DMat4};

/// The largest number in a half-space: products with coordinates then stay finite.
const MAX_NUMBER: f64 = 1e200;

/// `normal . (p - origin) + offset >= 0`, or `> 0` if it is open.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfSpace {
    /// Towards the inside; of any length.
    pub normal: [f64; 3],
    /// Added to the product.
    pub offset: f64,
    /// Is its face outside?
    pub open: bool,
}

impl HalfSpace {
    /// The number whose sign decides, for a point given relative to the origin: `((nx * dx + ny * dy) + nz * dz) + offset`
    /// in f64. Each step is monotonic in each coordinate, rounding included.
    #[inline]
    pub fn value(&self, relative: [f64; 3]) -> f64 {
        let [x, y, z] = std::array::from_fn(|i| self.normal[i] * relative[i]);
        ((x + y) + z) + self.offset
    }

    /// Does a point of this [`HalfSpace::value`] lie inside?
    #[inline]
    pub fn holds(&self, value: f64) -> bool {
        if self.open { value > 0.0 } else { value >= 0.0 }
    }
}

/// How the z of a clip matrix runs from near to far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ClipDepth {
    /// Between 0 and w, in either direction: Vulkan, Metal, DirectX, wgpu, and Esker's own.
    #[default]
    ZeroToOne,
    /// Between -w and w: OpenGL.
    MinusOneToOne,
}

/// The points that are inside all of some half-spaces.
///
/// A point is inside iff [`HalfSpace::holds`] for each, of the point's world coordinates minus `origin` in f64.
#[derive(Clone, Debug, PartialEq)]
pub struct Convex {
    origin: [f64; 3],
    halves: Vec<HalfSpace>,
}

impl Convex {
    /// An intersection of half-spaces; `None` if a number is not finite or beyond 1e200.
    pub fn new(origin: [f64; 3], halves: Vec<HalfSpace>) -> Option<Self> {
        let fine = |v: &f64| (-MAX_NUMBER..=MAX_NUMBER).contains(v);
        let all = origin.iter().all(fine) && halves.iter().all(|h| h.normal.iter().all(fine) && fine(&h.offset));
        all.then_some(Self { origin, halves })
    }

    /// A box of full side lengths `size` about `center`, turned by `rotation_deg`: about its z axis by the first angle,
    /// counter-clockwise seen from above, after about its y axis by the second, after about its x axis by the third (yaw,
    /// pitch, roll). Along its own axes it is half-open, as boxes are.
    ///
    /// `None` if a number is not finite or beyond 1e200, or a side is negative.
    pub fn oriented_box(center: [f64; 3], size: [f64; 3], rotation_deg: [f64; 3]) -> Option<Self> {
        if !size.iter().all(|s| (0.0..=MAX_NUMBER).contains(s)) || !rotation_deg.iter().all(|a| a.is_finite()) {
            return None;
        }
        let [yaw, pitch, roll] = rotation_deg;
        // Quarter turns are exact.
        let turn = |axis: usize, degrees: f64| {
            let (sine, cosine) = sin_cos_of_degrees(degrees);
            let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
            let mut columns = [[0.0; 3]; 3];
            columns[axis][axis] = 1.0;
            (columns[a][a], columns[a][b], columns[b][a], columns[b][b]) = (cosine, sine, -sine, cosine);
            DMat3::from_cols_array_2d(&columns)
        };
        let world_from_box = turn(2, yaw) * turn(1, pitch) * turn(0, roll);
        let mut halves = Vec::with_capacity(6);
        for axis in 0..3 {
            let along = world_from_box.col(axis);
            let offset = size[axis] / 2.0;
            halves.push(HalfSpace { normal: along.to_array(), offset, open: false });
            halves.push(HalfSpace { normal: (-along).to_array(), offset, open: true });
        }
        Self::new(center, halves)
    }

    /// What can be on a camera's image.
    pub fn of_camera(camera: &Camera) -> Self {
        let halves = camera.frustum().half_spaces().collect();
        Self { origin: camera.eye().to_array(), halves }
    }

    /// What a clip matrix keeps: `clip = matrix * (x, y, z, 1)`, column vectors, and `-w <= x, y <= w` with the depth as said.
    /// `None` if a number is not finite or beyond 1e100.
    pub fn from_clip_matrix(clip_from_world: DMat4, depth: ClipDepth) -> Option<Self> {
        let [x, y, z, w] = std::array::from_fn(|i| clip_from_world.row(i));
        let nearest = match depth {
            ClipDepth::ZeroToOne => z,
            ClipDepth::MinusOneToOne => w + z,
        };
        let halves = [w + x, w - x, w + y, w - y, nearest, w - z].map(|row| HalfSpace {
            normal: [row.x, row.y, row.z],
            offset: row.w,
            open: false,
        });
        let small = clip_from_world.to_cols_array().iter().all(|v| (-1e100..=1e100).contains(v));
        Self::new([0.0; 3], halves.to_vec()).filter(|_| small)
    }

    /// The same with all its faces.
    #[must_use]
    pub fn closed(&self) -> Self {
        let halves = self.halves.iter().map(|h| HalfSpace { open: false, ..*h }).collect();
        Self { origin: self.origin, halves }
    }

    /// What is subtracted from world coordinates.
    pub fn origin(&self) -> [f64; 3] {
        self.origin
    }

    /// The half-spaces.
    pub fn halves(&self) -> &[HalfSpace] {
        &self.halves
    }

    /// Is a point inside?
    pub fn contains(&self, world: [f64; 3]) -> bool {
        let relative = std::array::from_fn(|i| world[i] - self.origin[i]);
        self.halves.iter().all(|h| h.holds(h.value(relative)))
    }
}

/// Sine and cosine, exact at multiples of 90 degrees.
fn sin_cos_of_degrees(degrees: f64) -> (f64, f64) {
    let turn = degrees.rem_euclid(360.0);
    match turn {
        0.0 => (0.0, 1.0),
        90.0 => (1.0, 0.0),
        180.0 => (0.0, -1.0),
        270.0 => (-1.0, 0.0),
        _ => turn.to_radians().sin_cos(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{DVec3, Projection};

    #[test]
    fn an_oriented_box_turns_counter_clockwise_and_is_half_open() {
        let long = Convex::oriented_box([10.0, 20.0, 0.0], [8.0, 2.0, 2.0], [90.0, 0.0, 0.0]).unwrap();
        assert!(long.contains([10.0, 16.0, 0.0]) && !long.contains([10.0, 24.0, 0.0]));
        assert!(!long.contains([13.0, 20.0, 0.0]));
        // Its own y axis is the world's -x: the face that is in it is the one of greater x.
        assert!(long.contains([11.0, 20.0, 0.0]) && !long.contains([9.0, 20.0, 0.0]));
        let slanted = Convex::oriented_box([0.0; 3], [10.0, 1.0, 1.0], [45.0, 0.0, 0.0]).unwrap();
        assert!(slanted.contains([3.0, 3.0, 0.0]) && !slanted.contains([3.0, -3.0, 0.0]));
        // A positive pitch brings the x axis down, a positive roll the y axis up.
        let down = Convex::oriented_box([0.0; 3], [10.0, 1.0, 1.0], [0.0, 45.0, 0.0]).unwrap();
        assert!(down.contains([3.0, 0.0, -3.0]) && !down.contains([3.0, 0.0, 3.0]));
        let up = Convex::oriented_box([0.0; 3], [1.0, 10.0, 1.0], [0.0, 0.0, 45.0]).unwrap();
        assert!(up.contains([0.0, 3.0, 3.0]) && !up.contains([0.0, 3.0, -3.0]));
        for bad in [[f64::NAN, 1.0, 1.0], [-1.0, 1.0, 1.0], [f64::INFINITY, 1.0, 1.0]] {
            assert_eq!(Convex::oriented_box([0.0; 3], bad, [0.0; 3]), None);
        }
        assert_eq!(Convex::oriented_box([0.0; 3], [1.0; 3], [f64::NAN, 0.0, 0.0]), None);
    }

    #[test]
    fn a_camera_and_its_clip_matrix_keep_the_same_points() {
        let projections = [Projection::Perspective { fov_y_rad: 0.9 }, Projection::Orthographic { height: 12.0 }];
        for projection in projections {
            let eye = DVec3::new(3.0, -8.0, 5.0);
            let camera = Camera::new(eye, DVec3::new(1.0, 2.0, 0.0), DVec3::Z, projection, [640, 480]).unwrap();
            let camera = camera.with_depth_range(Some(0.5), Some(30.0)).unwrap();
            let matrix = camera.clip_from_view() * camera.view_from_world();
            let (seen, kept) =
                (Convex::of_camera(&camera), Convex::from_clip_matrix(matrix, ClipDepth::ZeroToOne).unwrap());
            // The same for OpenGL: z from 0..w to -w..w.
            let gl = DMat4::from_cols_array_2d(&[
                [1.0, 0.0, 0.0, 0.0],
                [0.0, 1.0, 0.0, 0.0],
                [0.0, 0.0, 2.0, 0.0],
                [0.0, 0.0, -1.0, 1.0],
            ]) * matrix;
            let gl = Convex::from_clip_matrix(gl, ClipDepth::MinusOneToOne).unwrap();
            let mut inside = 0;
            for n in 0..8000 {
                let p = [n % 20, n / 20 % 20, n / 400].map(|c| f64::from(c) * 2.03 - 20.0);
                assert_eq!(seen.contains(p), kept.contains(p), "{p:?}");
                assert_eq!(seen.contains(p), gl.contains(p), "{p:?}");
                inside += usize::from(seen.contains(p));
            }
            assert!(inside > 50 && inside < 4000, "{inside}");
        }
        assert_eq!(Convex::from_clip_matrix(DMat4::NAN, ClipDepth::ZeroToOne), None);
    }
}

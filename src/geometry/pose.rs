//! Where a scanner stood: the map from a scan's own frame to the world, in f64.

use thiserror::Error;

/// Rows of a rigid matrix may be off from unit length and right angles by this much: poses are written with few digits.
const RIGID_TOLERANCE: f64 = 1e-4;

/// An affine map from a scan's frame to the world: `world = linear * p + translation`. It can be inverted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    linear: [[f64; 3]; 3],
    translation: [f64; 3],
    inverse: [[f64; 3]; 3],
    /// By how much it enlarges, as long as that is one factor.
    scale: f64,
}

/// Why numbers are no pose.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum PoseError {
    /// A number is NaN or infinite.
    #[error("a number is NaN or infinite")]
    NotFinite,
    /// The last row is another one.
    #[error("the last row is not 0 0 0 1 (the matrix is row-major and takes column vectors)")]
    LastRow,
    /// The matrix flattens space.
    #[error("the matrix is singular: it has no inverse")]
    Singular,
    /// The quaternion has no direction.
    #[error("the quaternion is zero")]
    Quaternion,
    /// The matrix shears, stretches axes by different factors or mirrors.
    #[error("the matrix is not a rotation and translation, with one scale at most: it {0}")]
    NotRigid(&'static str),
}

impl Pose {
    /// The map that leaves everything where it is.
    pub const IDENTITY: Self = Self { linear: UNIT, translation: [0.0; 3], inverse: UNIT, scale: 1.0 };

    /// From a row-major 4 x 4 matrix that takes column vectors: the translation is the last column.
    ///
    /// # Errors
    ///
    /// [`PoseError`] unless all numbers are finite, the last row is 0 0 0 1 and there is an inverse.
    pub fn from_matrix(m: &[f64; 16]) -> Result<Self, PoseError> {
        if !m.iter().all(|v| v.is_finite()) {
            return Err(PoseError::NotFinite);
        }
        if m[12..] != [0.0, 0.0, 0.0, 1.0] {
            return Err(PoseError::LastRow);
        }
        let linear = [[m[0], m[1], m[2]], [m[4], m[5], m[6]], [m[8], m[9], m[10]]];
        Self::from_parts(linear, [m[3], m[7], m[11]])
    }

    /// From a translation and a quaternion `w x y z` of any length but zero.
    ///
    /// # Errors
    ///
    /// [`PoseError::NotFinite`], [`PoseError::Quaternion`].
    pub fn from_quaternion(translation: [f64; 3], quaternion: [f64; 4]) -> Result<Self, PoseError> {
        if !quaternion.iter().all(|v| v.is_finite()) {
            return Err(PoseError::NotFinite);
        }
        let largest = quaternion.iter().fold(0.0_f64, |a, v| a.max(v.abs()));
        if !(largest > 0.0) {
            return Err(PoseError::Quaternion);
        }
        // Brought near 1 first: squares of tiny or huge numbers leave the range.
        let q = quaternion.map(|v| v / largest);
        let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        let [w, x, y, z] = q.map(|v| v / length);
        let linear = [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ];
        Self::from_parts(linear, translation)
    }

    fn from_parts(linear: [[f64; 3]; 3], translation: [f64; 3]) -> Result<Self, PoseError> {
        if !translation.iter().all(|v| v.is_finite()) {
            return Err(PoseError::NotFinite);
        }
        let [a, b, c] = linear;
        let minors = [cross(b, c), cross(c, a), cross(a, b)];
        let determinant = dot(a, minors[0]);
        let size = linear.map(|row| dot(row, row).sqrt()).iter().product::<f64>();
        if !(determinant.abs() > 1e-12 * size) {
            return Err(PoseError::Singular);
        }
        let inverse: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| minors[j][i] / determinant));
        if !inverse.as_flattened().iter().all(|v| v.is_finite()) {
            return Err(PoseError::Singular);
        }
        let scale = determinant.abs().cbrt();
        // Rotations are rounded: what is nearly 1 is 1.
        let scale = if (scale - 1.0).abs() < 1e-9 { 1.0 } else { scale };
        Ok(Self { linear, translation, inverse, scale })
    }

    /// The row-major 4 x 4 matrix.
    pub fn to_matrix(&self) -> [f64; 16] {
        let ([a, b, c], t) = (self.linear, self.translation);
        [a[0], a[1], a[2], t[0], b[0], b[1], b[2], t[1], c[0], c[1], c[2], t[2], 0.0, 0.0, 0.0, 1.0]
    }

    /// Is it [`Pose::IDENTITY`]?
    pub fn is_identity(&self) -> bool {
        self.linear == UNIT && self.translation == [0.0; 3]
    }

    /// Where the scanner stood: the world position of the frame's origin.
    pub fn scanner(&self) -> [f64; 3] {
        self.translation
    }

    /// The one factor by which it enlarges.
    ///
    /// # Errors
    ///
    /// [`PoseError::NotRigid`] if it shears, mirrors, or enlarges axes differently.
    pub fn rigid_scale(&self) -> Result<f64, PoseError> {
        let [a, b, c] = self.linear;
        let lengths = [a, b, c].map(|row| dot(row, row).sqrt());
        let scale = lengths.iter().sum::<f64>() / 3.0;
        let even = |v: f64| (v / scale - 1.0).abs() <= RIGID_TOLERANCE;
        if !lengths.into_iter().all(even) {
            return Err(PoseError::NotRigid("stretches axes by different factors"));
        }
        let right = |v: f64| (v / (scale * scale)).abs() <= RIGID_TOLERANCE;
        if ![dot(a, b), dot(b, c), dot(c, a)].into_iter().all(right) {
            return Err(PoseError::NotRigid("shears"));
        }
        if !(dot(a, cross(b, c)) > 0.0) {
            return Err(PoseError::NotRigid("mirrors"));
        }
        Ok(scale)
    }

    /// From the scan's frame to the world.
    #[inline]
    pub fn world_from_scan(&self, p: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|i| dot(self.linear[i], p) + self.translation[i])
    }

    /// From the world to the scan's frame. The translation goes first, where world coordinates are exact.
    #[inline]
    pub fn scan_from_world(&self, world: [f64; 3]) -> [f64; 3] {
        let p = std::array::from_fn(|i| world[i] - self.translation[i]);
        self.inverse.map(|row| dot(row, p))
    }

    /// A direction of the scan's frame in the world: turned, of the same length.
    #[inline]
    pub fn world_direction(&self, v: [f64; 3]) -> [f64; 3] {
        self.linear.map(|row| dot(row, v) / self.scale)
    }

    /// A direction of the world in the scan's frame: turned back, of the same length.
    #[inline]
    pub fn scan_direction(&self, v: [f64; 3]) -> [f64; 3] {
        self.inverse.map(|row| dot(row, v) * self.scale)
    }

    /// Does it turn directions?
    pub fn turns(&self) -> bool {
        self.linear != UNIT
    }

    /// The map that does `first`, then this.
    ///
    /// # Errors
    ///
    /// [`PoseError`] if the product leaves the range of f64.
    pub fn after(&self, first: &Self) -> Result<Self, PoseError> {
        let linear = self.linear.map(|row| {
            std::array::from_fn(|j| {
                row[0] * first.linear[0][j] + row[1] * first.linear[1][j] + row[2] * first.linear[2][j]
            })
        });
        Self::from_parts(linear, self.world_from_scan(first.translation))
    }

    /// The map back.
    ///
    /// # Errors
    ///
    /// [`PoseError`] if its numbers leave the range of f64.
    pub fn inverted(&self) -> Result<Self, PoseError> {
        Self::from_parts(self.inverse, self.scan_from_world([0.0; 3]))
    }

    /// A world box around a box of the scan's frame.
    pub fn world_bounds(&self, min: [f64; 3], max: [f64; 3]) -> ([f64; 3], [f64; 3]) {
        let mut bounds = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for corner in 0..8 {
            let p = self.world_from_scan(std::array::from_fn(|i| if corner >> i & 1 == 0 { min[i] } else { max[i] }));
            for i in 0..3 {
                bounds.0[i] = bounds.0[i].min(p[i]);
                bounds.1[i] = bounds.1[i].max(p[i]);
            }
        }
        bounds
    }
}

impl Default for Pose {
    fn default() -> Self {
        Self::IDENTITY
    }
}

const UNIT: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

#[inline]
fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn near(a: [f64; 3], b: [f64; 3], tolerance: f64) -> bool {
        (0..3).all(|i| (a[i] - b[i]).abs() <= tolerance)
    }

    #[test]
    fn a_quarter_turn_about_z_takes_x_to_y() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        for length in [1.0, 1e-200, 1e200] {
            let pose = Pose::from_quaternion([10.0, 20.0, 30.0], [half, 0.0, 0.0, half].map(|v| v * length)).unwrap();
            assert!(near(pose.world_from_scan([1.0, 0.0, 0.0]), [10.0, 21.0, 30.0], 1e-15));
            assert_eq!(pose.scanner(), [10.0, 20.0, 30.0]);
            assert_eq!(Pose::from_matrix(&pose.to_matrix()), Ok(pose));
        }
    }

    #[test]
    fn what_is_no_pose_is_refused() {
        let with = |i: usize, v: f64| {
            let mut m = Pose::IDENTITY.to_matrix();
            m[i] = v;
            Pose::from_matrix(&m)
        };
        assert_eq!(with(3, f64::NAN), Err(PoseError::NotFinite));
        assert_eq!(with(12, 1.0), Err(PoseError::LastRow));
        assert_eq!(with(0, 0.0), Err(PoseError::Singular));
        assert_eq!(with(0, 1e-320), Err(PoseError::Singular));
        assert!(matches!(
            with(0, 2.0).unwrap().rigid_scale(),
            Err(PoseError::NotRigid("stretches axes by different factors"))
        ));
        assert!(matches!(with(1, 0.01).unwrap().rigid_scale(), Err(PoseError::NotRigid("shears"))));
        assert!(matches!(with(0, -1.0).unwrap().rigid_scale(), Err(PoseError::NotRigid("mirrors"))));
        assert_eq!(Pose::from_quaternion([0.0; 3], [0.0; 4]), Err(PoseError::Quaternion));
        assert_eq!(Pose::from_quaternion([f64::INFINITY; 3], [1.0; 4]), Err(PoseError::NotFinite));
        // Six digits are enough for a pose.
        let m = [0.999979, -0.003604, -0.005365, 0.0, 0.003613, 0.999992, 0.001630, 0.0];
        let m = [&m[..], &[0.005359, -0.001650, 0.999984, 0.0, 0.0, 0.0, 0.0, 1.0]].concat().try_into().unwrap();
        assert!((Pose::from_matrix(&m).unwrap().rigid_scale().unwrap() - 1.0).abs() < 1e-5);
    }

    proptest! {
        #[test]
        fn there_and_back_is_the_same_point(
            q in prop::array::uniform4(-1.0_f64..1.0), t in prop::array::uniform3(-5e6_f64..5e6),
            p in prop::array::uniform3(-500.0_f64..500.0), scale in 0.1_f64..10.0,
        ) {
            prop_assume!(q.iter().any(|v| v.abs() > 0.01));
            let mut m = Pose::from_quaternion(t, q).unwrap().to_matrix();
            for row in 0..3 {
                m[4 * row..4 * row + 3].iter_mut().for_each(|v| *v *= scale);
            }
            let pose = Pose::from_matrix(&m).unwrap();
            prop_assert!((pose.rigid_scale().unwrap() / scale - 1.0).abs() < 1e-12);
            prop_assert!(near(pose.scan_from_world(pose.world_from_scan(p)), p, 1e-7));
            let twice = pose.after(&pose).unwrap();
            prop_assert!(near(twice.world_from_scan(p), pose.world_from_scan(pose.world_from_scan(p)), 1e-5));
            prop_assert!(near(pose.inverted().unwrap().world_from_scan(pose.world_from_scan(p)), p, 1e-5));
            let (min, max) = pose.world_bounds(p.map(|v| v - 1.0), p.map(|v| v + 1.0));
            let world = pose.world_from_scan(p);
            prop_assert!((0..3).all(|i| min[i] <= world[i] && world[i] <= max[i]));
        }
    }
}

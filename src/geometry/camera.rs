//! A camera: where it is, what it looks at, and how the world becomes pixels.

use super::camera_file::CameraFile;
use super::{Frustum, WorldBox};
use glam::{DMat3, DMat4, DVec3, DVec4};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The most pixels on a side.
pub(super) const MAX_SIZE_PX: u32 = 32_768;
/// The greatest coordinate, and the greatest distance, that a camera takes.
pub(super) const MAX_COORDINATE: f64 = 1e15;
/// The sine of the smallest angle between `up` and the line of sight.
const MIN_UP_SINE: f64 = 1e-6;
/// The default near plane of a perspective, relative to the distance of the target.
const NEAR_OF_DISTANCE: f64 = 1e-4;

/// How directions become places on the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Lines of sight through the eye.
    Perspective {
        /// The full vertical field of view, between 0 and 180 degrees.
        fov_y_rad: f64,
    },
    /// Parallel lines of sight.
    Orthographic {
        /// The height of what is seen, in CRS units.
        height: f64,
    },
}

/// What is wrong with a camera; every message names the field of the view file.
#[derive(Debug, Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum CameraError {
    /// A number that must be finite, or within a range, is not.
    #[error("view: \"{field}\" is {value}; it must be {expected}")]
    Number {
        /// The field of the view file.
        field: &'static str,
        /// What it holds.
        value: f64,
        /// What it should.
        expected: &'static str,
    },
    /// Eye and target coincide.
    #[error("view: \"target\" is where \"eye\" is; it must be another point, so that there is a direction to look")]
    NoDirection,
    /// Up is parallel to the line of sight.
    #[error("view: \"up\" is parallel to the line from \"eye\" to \"target\"; give another direction, such as [0,1,0]")]
    UpParallel,
    /// A field is there that the projection does not have, or one is missing that it needs.
    #[error("view: \"{field}\" {problem}")]
    Field {
        /// The field of the view file.
        field: &'static str,
        /// What about it.
        problem: &'static str,
    },
}

/// A camera in world coordinates. Eye, target and up make a right-handed view space: x right, y up, looking along -z.
///
/// Serialises as the view file: `{"eye":[x,y,z],"target":[x,y,z],"up":[0,0,1],"projection":"perspective",
/// "fov_y_deg":60,"size":[1280,720]}`, or `"projection":"orthographic"` with `"height"`; `near` and `far` are optional.
///
/// Clip space is wgpu's with reversed depth: 1 at the near plane, towards 0 far away (0 at infinity without `far`).
///
/// ```
/// use esker::geometry::{Camera, DVec3};
///
/// let camera: Camera = serde_json::from_str(
///     r#"{"eye":[0,-10,2],"target":[0,0,0],"fov_y_deg":60,"size":[1280,720]}"#,
/// )?;
/// let [x, y, _] = camera.pixel_from_relative(camera.target() - camera.eye()).unwrap();
/// assert_eq!((x.round(), y.round()), (640.0, 360.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "CameraFile", into = "CameraFile")]
pub struct Camera {
    eye: DVec3,
    target: DVec3,
    up: DVec3,
    projection: Projection,
    size_px: [u32; 2],
    near: Option<f64>,
    far: Option<f64>,
    /// Rows are right, up, backward: unit vectors.
    view_from_relative: DMat3,
}

impl Camera {
    /// A camera without a far plane and with the default near plane.
    ///
    /// # Errors
    ///
    /// [`CameraError`] naming the field: not finite or beyond 1e15, eye = target, up parallel to the line of sight, a
    /// field of view outside (0, 180) degrees, a height that is not positive, a size of 0 or above 32,768.
    pub fn new(
        eye: DVec3,
        target: DVec3,
        up: DVec3,
        projection: Projection,
        size_px: [u32; 2],
    ) -> Result<Self, CameraError> {
        for (field, v) in [("eye", eye), ("target", target), ("up", up)] {
            if let Some(&value) = v.to_array().iter().find(|c| !(-MAX_COORDINATE..=MAX_COORDINATE).contains(*c)) {
                return Err(CameraError::Number { field, value, expected: "three finite numbers up to 1e15" });
            }
        }
        match projection {
            Projection::Perspective { fov_y_rad } => {
                let value = fov_y_rad.to_degrees();
                if !(value > 0.0 && value < 180.0 && (fov_y_rad / 2.0).tan() > 0.0) {
                    return Err(CameraError::Number { field: "fov_y_deg", value, expected: "between 0 and 180" });
                }
            }
            Projection::Orthographic { height } => {
                if !(height > 0.0 && height <= MAX_COORDINATE) {
                    let expected = "positive and at most 1e15";
                    return Err(CameraError::Number { field: "height", value: height, expected });
                }
            }
        }
        if let Some(&side) = size_px.iter().find(|s| !(1..=MAX_SIZE_PX).contains(*s)) {
            let expected = "two whole numbers from 1 to 32768";
            return Err(CameraError::Number { field: "size", value: f64::from(side), expected });
        }
        let backward = (eye - target).try_normalize().ok_or(CameraError::NoDirection)?;
        // A length of 1e-300 is a direction as well.
        let up_unit = up.try_normalize().or_else(|| (up * 1e200).try_normalize()).ok_or(CameraError::Number {
            field: "up",
            value: 0.0,
            expected: "a direction, not zero",
        })?;
        let across = up_unit.cross(backward);
        if !(MIN_UP_SINE..).contains(&across.length()) {
            return Err(CameraError::UpParallel);
        }
        let right = across.normalize();
        let view_from_relative = DMat3::from_cols(right, backward.cross(right), backward).transpose();
        Ok(Self { eye, target, up, projection, size_px, near: None, far: None, view_from_relative })
    }

    /// [`Camera::seeing`] the corners of a box.
    ///
    /// # Errors
    ///
    /// As [`Camera::new`], for sizes of 0 and coordinates beyond 1e15.
    pub fn looking_at_all(bounds: &WorldBox, size_px: [u32; 2]) -> Result<Self, CameraError> {
        Self::seeing(&bounds.corners(), size_px)
    }

    /// The same camera with these planes, as distances along the line of sight.
    ///
    /// # Errors
    ///
    /// [`CameraError::Number`] unless near is positive (for an orthographic camera: not negative) and far is beyond it.
    pub fn with_depth_range(mut self, near: Option<f64>, far: Option<f64>) -> Result<Self, CameraError> {
        if let Some(value) = near {
            let positive = matches!(self.projection, Projection::Perspective { .. });
            let fine = value <= MAX_COORDINATE && if positive { value > 0.0 } else { value >= 0.0 };
            if !fine {
                return Err(CameraError::Number { field: "near", value, expected: "positive and at most 1e15" });
            }
        }
        (self.near, self.far) = (near, None);
        if let Some(value) = far
            && !(value > self.near() && value <= MAX_COORDINATE)
        {
            return Err(CameraError::Number { field: "far", value, expected: "beyond \"near\" and at most 1e15" });
        }
        self.far = far;
        Ok(self)
    }

    /// The same camera with another image.
    ///
    /// # Errors
    ///
    /// [`CameraError::Number`] for a side of 0 or above 32,768.
    pub fn with_size(self, size_px: [u32; 2]) -> Result<Self, CameraError> {
        Self::new(self.eye, self.target, self.up, self.projection, size_px)?.with_depth_range(self.near, self.far)
    }

    /// The same camera with a far plane behind everything in `bounds`, if it is orthographic and has none: parallel
    /// depth needs an end. A perspective goes to infinity and stays as it is.
    #[must_use]
    pub fn reaching(mut self, bounds: &WorldBox) -> Self {
        if matches!(self.projection, Projection::Orthographic { .. }) && self.far.is_none() {
            let reach = bounds.farthest_distance_to(self.eye) * 1.001;
            self.far = Some(reach.max(self.near() + (self.target - self.eye).length()));
        }
        self
    }

    /// Where the camera is.
    pub fn eye(&self) -> DVec3 {
        self.eye
    }

    /// What is at the centre of the image.
    pub fn target(&self) -> DVec3 {
        self.target
    }

    /// The direction that points up on the image, as it was given.
    pub fn up(&self) -> DVec3 {
        self.up
    }

    /// How directions become places on the image.
    pub fn projection(&self) -> Projection {
        self.projection
    }

    /// Width and height of the image in pixels.
    pub fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    /// Width over height.
    pub fn aspect(&self) -> f64 {
        f64::from(self.size_px[0]) / f64::from(self.size_px[1])
    }

    /// The near plane's distance: as given, else a ten-thousandth of the distance to the target (0 for orthographic).
    pub fn near(&self) -> f64 {
        self.near.unwrap_or_else(|| match self.projection {
            Projection::Perspective { .. } => {
                ((self.target - self.eye).length() * NEAR_OF_DISTANCE).max(f64::MIN_POSITIVE)
            }
            Projection::Orthographic { .. } => 0.0,
        })
    }

    /// The near plane's distance if one was asked for.
    pub fn near_given(&self) -> Option<f64> {
        self.near
    }

    /// The far plane's distance; `None`: there is none.
    pub fn far(&self) -> Option<f64> {
        self.far
    }

    /// The unit vector along the line of sight.
    pub fn forward(&self) -> DVec3 {
        -self.view_from_relative.row(2)
    }

    /// View space from world coordinates relative to the eye: a rotation.
    pub fn view_from_relative(&self) -> DMat3 {
        self.view_from_relative
    }

    /// View space from world coordinates. Prefer [`Camera::view_from_relative`]: here the translation cancels large
    /// numbers.
    pub fn view_from_world(&self) -> DMat4 {
        DMat4::from_mat3(self.view_from_relative) * DMat4::from_translation(-self.eye)
    }

    /// Clip space from view space, with reversed depth.
    ///
    /// An orthographic camera without a far plane gets one at twice the distance of the target plus the height seen;
    /// see [`Camera::reaching`].
    pub fn clip_from_view(&self) -> DMat4 {
        let near = self.near();
        match self.projection {
            Projection::Perspective { fov_y_rad } => {
                let focal = 1.0 / (fov_y_rad / 2.0).tan();
                let (slope, constant) = match self.far {
                    None => (0.0, near),
                    Some(far) => (near / (far - near), near * far / (far - near)),
                };
                DMat4::from_cols(
                    DVec4::new(focal / self.aspect(), 0.0, 0.0, 0.0),
                    DVec4::new(0.0, focal, 0.0, 0.0),
                    DVec4::new(0.0, 0.0, slope, -1.0),
                    DVec4::new(0.0, 0.0, constant, 0.0),
                )
            }
            Projection::Orthographic { height } => {
                let far = self.far.unwrap_or_else(|| near + 2.0 * (self.target - self.eye).length() + height);
                DMat4::from_cols(
                    DVec4::new(2.0 / (height * self.aspect()), 0.0, 0.0, 0.0),
                    DVec4::new(0.0, 2.0 / height, 0.0, 0.0),
                    DVec4::new(0.0, 0.0, 1.0 / (far - near), 0.0),
                    DVec4::new(0.0, 0.0, far / (far - near), 1.0),
                )
            }
        }
    }

    /// Clip space from world coordinates relative to the eye.
    pub fn clip_from_relative(&self) -> DMat4 {
        self.clip_from_view() * DMat4::from_mat3(self.view_from_relative)
    }

    /// Clip space from world coordinates. Prefer [`Camera::clip_from_relative`] where coordinates are large.
    pub fn clip_from_world(&self) -> DMat4 {
        self.clip_from_view() * self.view_from_world()
    }

    /// Where a point, given relative to the eye, is on the image: x to the right and y down in pixels from the top left
    /// corner, and the reversed depth. `None` if it is not in front of the eye.
    pub fn pixel_from_relative(&self, relative: DVec3) -> Option<[f64; 3]> {
        let clip = self.clip_from_relative() * relative.extend(1.0);
        let [width, height] = self.size_px.map(f64::from);
        (clip.w > 0.0).then(|| {
            let ndc = clip.truncate() / clip.w;
            [(ndc.x + 1.0) / 2.0 * width, (1.0 - ndc.y) / 2.0 * height, ndc.z]
        })
    }

    /// The height in pixels of a `length`, in CRS units, that faces the eye at `distance`: at the centre of the image.
    /// Infinite at distance 0 in perspective; the same at any distance in orthographic.
    pub fn pixels_of_length(&self, length: f64, distance: f64) -> f64 {
        let height_px = f64::from(self.size_px[1]);
        match self.projection {
            Projection::Perspective { fov_y_rad } if distance > 0.0 => {
                length * height_px / (2.0 * (fov_y_rad / 2.0).tan() * distance)
            }
            Projection::Perspective { .. } if length > 0.0 => f64::INFINITY,
            Projection::Perspective { .. } => 0.0,
            Projection::Orthographic { height } => length * height_px / height,
        }
    }

    /// What can be on the image.
    pub fn frustum(&self) -> Frustum {
        Frustum::of(self)
    }
}

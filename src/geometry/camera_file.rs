//! The view file: a camera as JSON.

use super::{Camera, CameraError, Projection};
use glam::DVec3;
use serde::{Deserialize, Serialize};

const DEFAULT_FOV_Y_DEG: f64 = 60.0;
const DEFAULT_SIZE_PX: [u32; 2] = [1280, 720];

/// The fields as they are written; not checked yet.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraFile {
    eye: [f64; 3],
    target: [f64; 3],
    #[serde(default)]
    up: Option<[f64; 3]>,
    #[serde(default)]
    projection: Kind,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    fov_y_deg: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    height: Option<f64>,
    #[serde(default)]
    size: Option<[u32; 2]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    near: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    far: Option<f64>,
}

#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Kind {
    #[default]
    Perspective,
    Orthographic,
}

impl TryFrom<CameraFile> for Camera {
    type Error = CameraError;

    fn try_from(file: CameraFile) -> Result<Self, CameraError> {
        let refused = |field, problem| Err(CameraError::Field { field, problem });
        let projection = match (file.projection, file.fov_y_deg, file.height) {
            (Kind::Perspective, fov, None) => {
                Projection::Perspective { fov_y_rad: fov.unwrap_or(DEFAULT_FOV_Y_DEG).to_radians() }
            }
            (Kind::Perspective, _, Some(_)) => {
                return refused("height", "is only for \"projection\":\"orthographic\"");
            }
            (Kind::Orthographic, None, Some(height)) => Projection::Orthographic { height },
            (Kind::Orthographic, None, None) => return refused("height", "is missing: an orthographic view needs it"),
            (Kind::Orthographic, Some(_), _) => {
                return refused("fov_y_deg", "is only for \"projection\":\"perspective\"");
            }
        };
        let (eye, target) = (DVec3::from_array(file.eye), DVec3::from_array(file.target));
        let size_px = file.size.unwrap_or(DEFAULT_SIZE_PX);
        let with_up = |up| Self::new(eye, target, up, projection, size_px);
        let camera = match file.up {
            Some(up) => with_up(DVec3::from_array(up)),
            // Looking straight down, north is up.
            None => match with_up(DVec3::Z) {
                Err(CameraError::UpParallel) => with_up(DVec3::Y),
                other => other,
            },
        };
        camera?.with_depth_range(file.near, file.far)
    }
}

/// As few digits as give the angle back.
fn degrees(rad: f64) -> f64 {
    let exact = rad.to_degrees();
    let rounded = (exact * 1e9).round() / 1e9;
    if (rounded.to_radians() - rad).abs() <= 1e-15 { rounded } else { exact }
}

impl From<Camera> for CameraFile {
    fn from(camera: Camera) -> Self {
        let (projection, fov_y_deg, height) = match camera.projection() {
            Projection::Perspective { fov_y_rad } => (Kind::Perspective, Some(degrees(fov_y_rad)), None),
            Projection::Orthographic { height } => (Kind::Orthographic, None, Some(height)),
        };
        Self {
            eye: camera.eye().to_array(),
            target: camera.target().to_array(),
            up: Some(camera.up().to_array()),
            projection,
            fov_y_deg,
            height,
            size: Some(camera.size_px()),
            near: camera.near_given(),
            far: camera.far(),
        }
    }
}

//! Cameras of a walk: a JSON file with every frame, or with keyframes and a number of frames.

use crate::geometry::{Camera, DVec3, Projection};
use anyhow::{Context, bail, ensure};
use serde::Deserialize;
use std::path::Path;

/// The most frames of a walk.
const MAX_FRAMES: usize = 1_000_000;

#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum WalkFile {
    Frames(Vec<Camera>),
    Keyframes(Keyframes),
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Keyframes {
    keyframes: Vec<Camera>,
    frames: usize,
}

/// The cameras of a walk, one a frame.
///
/// # Errors
///
/// If the file can't be read, is no walk, or has no frames.
pub(super) fn read(path: &Path) -> anyhow::Result<Vec<Camera>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("{}: reading the walk failed", path.display()))?;
    // An untagged enum would hide what is wrong with a view.
    let value: serde_json::Value =
        serde_json::from_str(&text).with_context(|| format!("{}: is no JSON", path.display()))?;
    let walk = if value.is_array() {
        serde_json::from_value(value).map(WalkFile::Frames)
    } else {
        serde_json::from_value(value).map(WalkFile::Keyframes)
    };
    let walk = walk.with_context(|| {
        format!("{}: is no walk; write [VIEW, VIEW, ...] or {{\"keyframes\":[VIEW, ...],\"frames\":N}}", path.display())
    })?;
    let cameras = match walk {
        WalkFile::Frames(cameras) => cameras,
        WalkFile::Keyframes(Keyframes { keyframes, frames }) => between(&keyframes, frames)
            .with_context(|| format!("{}: a camera between two keyframes can't be", path.display()))?,
    };
    ensure!(!cameras.is_empty(), "{}: the walk has no frames", path.display());
    Ok(cameras)
}

/// `frames` cameras, evenly from the first key to the last: eye and target on a smooth curve through the keys
/// (Catmull-Rom), the rest in straight lines.
fn between(keys: &[Camera], frames: usize) -> anyhow::Result<Vec<Camera>> {
    ensure!(!keys.is_empty() && frames >= keys.len(), "there must be a keyframe, and a frame for each of them");
    ensure!(frames <= MAX_FRAMES, "{frames} frames; at most {MAX_FRAMES} are drawn");
    let spans = keys.len() - 1;
    (0..frames)
        .map(|frame| {
            // The last frame is the last key itself, without a rounding on the way.
            let along = if frames > 1 { (frame * spans) as f64 / (frames - 1) as f64 } else { 0.0 };
            let span = (along as usize).min(spans.saturating_sub(1));
            at(keys, span, along - span as f64)
        })
        .collect()
}

fn at(keys: &[Camera], span: usize, t: f64) -> anyhow::Result<Camera> {
    let (a, b) = (&keys[span], &keys[(span + 1).min(keys.len() - 1)]);
    if t <= 0.0 {
        return Ok(a.clone());
    }
    if t >= 1.0 {
        return Ok(b.clone());
    }
    let curve = |place: fn(&Camera) -> DVec3| {
        let key = |i: usize| place(&keys[i.min(keys.len() - 1)]);
        let (before, p, q, after) = (key(span.saturating_sub(1)), key(span), key(span + 1), key(span + 2));
        // Relative to `p`: far from the origin differences are exact where sums are not.
        let (to_q, leave, arrive) = (q - p, (q - before) / 2.0, (after - p) / 2.0);
        let (t2, t3) = (t * t, t * t * t);
        p + leave * (t3 - 2.0 * t2 + t) + to_q * (3.0 * t2 - 2.0 * t3) + arrive * (t3 - t2)
    };
    let mix = |a: f64, b: f64| a + (b - a) * t;
    let projection = match (a.projection(), b.projection()) {
        (Projection::Perspective { fov_y_rad: a }, Projection::Perspective { fov_y_rad: b }) => {
            Projection::Perspective { fov_y_rad: mix(a, b) }
        }
        (Projection::Orthographic { height: a }, Projection::Orthographic { height: b }) => {
            Projection::Orthographic { height: mix(a, b) }
        }
        _ => bail!("one keyframe is perspective and the next is orthographic"),
    };
    let near = a.near_given().zip(b.near_given()).map(|(a, b)| mix(a, b));
    let far = a.far().zip(b.far()).map(|(a, b)| mix(a, b));
    let up = a.up().normalize_or_zero().lerp(b.up().normalize_or_zero(), t);
    let camera = Camera::new(curve(Camera::eye), curve(Camera::target), up, projection, a.size_px())?;
    Ok(camera.with_depth_range(near, far)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(x: f64, fov_y_deg: f64) -> Camera {
        let projection = Projection::Perspective { fov_y_rad: fov_y_deg.to_radians() };
        let eye = DVec3::new(5e6 + x, -10.0, 2.0);
        Camera::new(eye, DVec3::new(5e6 + x, 0.0, 0.0), DVec3::Z, projection, [64, 48]).unwrap()
    }

    #[test]
    fn a_walk_goes_through_its_keyframes() {
        let keys = [camera(0.0, 50.0), camera(10.0, 60.0), camera(15.0, 60.0)];
        let walk = between(&keys, 9).unwrap();
        assert_eq!(walk.len(), 9);
        assert_eq!([&walk[0], &walk[4], &walk[8]], [&keys[0], &keys[1], &keys[2]]);
        assert!(walk.windows(2).all(|pair| pair[0].eye().x < pair[1].eye().x));
        assert_eq!(between(&keys[..1], 3).unwrap(), vec![keys[0].clone(); 3]);
        assert!(between(&keys, 2).is_err() && between(&[], 2).is_err());
        let flat = Projection::Orthographic { height: 1.0 };
        let flat = Camera::new(DVec3::Y, DVec3::ZERO, DVec3::Z, flat, [64, 48]).unwrap();
        assert!(between(&[keys[0].clone(), flat], 5).is_err());
    }

    #[test]
    fn both_forms_of_a_walk_are_read_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("walk.json");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            super::read(&path)
        };
        let view = r#"{"eye":[0,-3,0],"target":[0,0,0]}"#;
        assert_eq!(read(&format!("[{view},{view}]")).unwrap().len(), 2);
        assert_eq!(read(&format!(r#"{{"keyframes":[{view}],"frames":5}}"#)).unwrap().len(), 5);
        for wrong in ["[]", "{}", "3", "[{\"eye\":[0,0,0]}]", &format!(r#"{{"keyframes":[{view}],"frames":0}}"#)] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
        let told = format!("{:#}", read(r#"[{"eye":[0,0,0],"target":[0,0,0]}]"#).unwrap_err());
        assert!(told.contains("\"target\""), "{told}");
    }
}

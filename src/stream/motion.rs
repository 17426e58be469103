//! How the camera moves, and where it will be.

use crate::geometry::{Camera, DVec3};
use std::time::Duration;
use tokio::time::Instant;

/// Older than this, a camera says nothing about the motion now.
const MEMORY: Duration = Duration::from_millis(400);

/// The cameras of the last moments.
#[derive(Debug, Default)]
pub(super) struct Motion {
    seen: Vec<(Instant, DVec3, DVec3)>,
}

impl Motion {
    /// The camera is here now.
    pub fn see(&mut self, camera: &Camera, now: Instant) {
        self.forget(now);
        if self.seen.len() > 64 {
            self.seen.remove(0);
        }
        self.seen.push((now, camera.eye(), camera.target()));
    }

    fn forget(&mut self, now: Instant) {
        self.seen.retain(|(then, ..)| now.duration_since(*then) <= MEMORY);
    }

    /// Velocities of eye and target, in units a second; `None` at rest or after a jump without a past.
    fn velocity(&self) -> Option<(DVec3, DVec3)> {
        let (first, last) = (self.seen.first()?, self.seen.last()?);
        let seconds = last.0.duration_since(first.0).as_secs_f64();
        let (eye, target) = (last.1 - first.1, last.2 - first.2);
        let moves = seconds > 0.01 && (eye.length_squared() > 0.0 || target.length_squared() > 0.0);
        moves.then(|| (eye / seconds, target / seconds))
    }

    /// Where the eye is heading: a unit vector.
    pub fn heading(&mut self, now: Instant) -> Option<DVec3> {
        self.forget(now);
        self.velocity()?.0.try_normalize()
    }

    /// The camera as it will be if it goes on like this.
    pub fn ahead(&mut self, camera: &Camera, now: Instant, by: Duration) -> Option<Camera> {
        self.forget(now);
        let (eye, target) = self.velocity()?;
        let seconds = by.as_secs_f64();
        let (eye, target) = (camera.eye() + eye * seconds, camera.target() + target * seconds);
        let camera = Camera::new(eye, target, camera.up(), camera.projection(), camera.size_px());
        camera.ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Projection;

    fn camera(x: f64) -> Camera {
        let projection = Projection::Perspective { fov_y_rad: 1.0 };
        Camera::new(DVec3::new(x, 0.0, 0.0), DVec3::new(x, 5.0, 0.0), DVec3::Z, projection, [100, 100]).unwrap()
    }

    #[test]
    fn a_moving_camera_is_foreseen_and_one_at_rest_is_not() {
        let start = Instant::now();
        let at = |ms: u64| start + Duration::from_millis(ms);
        let mut motion = Motion::default();
        assert_eq!(motion.ahead(&camera(0.0), start, Duration::from_millis(500)), None);
        for i in 0..6 {
            motion.see(&camera(i as f64), at(i * 50));
        }
        let ahead = motion.ahead(&camera(5.0), at(250), Duration::from_millis(500)).unwrap();
        assert!((ahead.eye().x - 15.0).abs() < 1e-9, "{:?}", ahead.eye());
        assert_eq!(motion.heading(at(250)), Some(DVec3::X));
        assert_eq!(motion.heading(at(900)), None, "long ago");
    }
}

//! Where the camera is and how it moves: pure geometry, no window, no clock of its own.

use crate::geometry::{Camera, CameraError, DVec3, Framed, Framing, ImageArea, Projection};
use glam::DMat3;

/// Straight down and up, no further.
const STEEPEST_RAD: f64 = std::f64::consts::FRAC_PI_2;
/// The camera of a person who walks is so high above the ground, in metres; in other units it is the same number.
pub const EYE_HEIGHT: f64 = 1.7;
/// How long it takes to get to another place.
const FLIGHT_SECONDS: f64 = 0.45;

/// How the camera is moved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// About a point.
    #[default]
    Orbit,
    /// Freely.
    Fly,
    /// On the ground.
    Walk,
}

/// What something is fitted onto.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Onto {
    /// Width over height of the image.
    pub aspect: f64,
    /// The part of the image that nothing covers.
    pub area: ImageArea,
}

/// The camera as something that is moved.
#[derive(Clone, Debug, PartialEq)]
pub struct Rig {
    /// How it is moved.
    pub mode: Mode,
    eye: DVec3,
    /// Of the line of sight, from east, counter-clockwise.
    yaw_rad: f64,
    /// Above the horizon.
    pitch_rad: f64,
    roll_rad: f64,
    /// To what is looked at.
    distance: f64,
    fov_y_rad: f64,
    orthographic: bool,
    flight: Option<Flight>,
}

/// On the way to another place.
#[derive(Clone, Debug, PartialEq)]
struct Flight {
    from: Pose,
    to: Pose,
    seconds: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Pose {
    eye: DVec3,
    yaw_rad: f64,
    pitch_rad: f64,
    distance: f64,
}

impl Default for Rig {
    /// Looking north from the south of the origin.
    fn default() -> Self {
        Self {
            mode: Mode::Orbit,
            eye: DVec3::new(0.0, -10.0, 2.0),
            yaw_rad: std::f64::consts::FRAC_PI_2,
            pitch_rad: -0.2,
            roll_rad: 0.0,
            distance: 10.0,
            fov_y_rad: 60_f64.to_radians(),
            orthographic: false,
            flight: None,
        }
    }
}

impl Rig {
    /// Where `camera` is.
    #[cfg(test)]
    pub fn of(camera: &Camera) -> Self {
        let mut rig = Self::default();
        rig.place(camera);
        rig
    }

    /// To `camera`, at once.
    pub fn place(&mut self, camera: &Camera) {
        let pose = self.projected(camera);
        self.set(pose);
        (self.flight, self.roll_rad) = (None, 0.0);
    }

    /// To `camera`, in some frames.
    pub fn fly_to(&mut self, camera: &Camera) {
        let pose = self.projected(camera);
        self.start(pose);
    }

    /// Projects as `camera` does; gives where it is.
    fn projected(&mut self, camera: &Camera) -> Pose {
        let pose = Pose::of(camera);
        match camera.projection() {
            Projection::Perspective { fov_y_rad } => {
                (self.fov_y_rad, self.orthographic) = (fov_y_rad, false);
                pose
            }
            Projection::Orthographic { height } => {
                self.orthographic = true;
                // At the distance at which a perspective would see that height.
                Pose { distance: height / (2.0 * (self.fov_y_rad / 2.0).tan()), ..pose }
            }
        }
    }

    fn start(&mut self, to: Pose) {
        let from = self.pose();
        self.flight = Some(Flight { from, to, seconds: 0.0 });
        self.roll_rad = 0.0;
    }

    fn pose(&self) -> Pose {
        Pose { eye: self.eye, yaw_rad: self.yaw_rad, pitch_rad: self.pitch_rad, distance: self.distance }
    }

    fn set(&mut self, pose: Pose) {
        (self.eye, self.yaw_rad, self.pitch_rad) = (pose.eye, pose.yaw_rad, pose.pitch_rad);
        self.distance = pose.distance;
    }

    /// Is it on the way somewhere?
    pub fn is_flying_to(&self) -> bool {
        self.flight.is_some()
    }

    /// Where the eye is.
    pub fn eye(&self) -> DVec3 {
        self.eye
    }

    /// The line of sight.
    pub fn forward(&self) -> DVec3 {
        direction(self.yaw_rad, self.pitch_rad)
    }

    /// How far away what is looked at is.
    pub fn distance(&self) -> f64 {
        self.distance
    }

    /// What is looked at is that far away.
    pub fn set_distance(&mut self, distance: f64) {
        if distance.is_finite() && distance > 0.0 && !self.orthographic {
            self.distance = distance;
        }
    }

    /// Is it a parallel projection?
    pub fn is_orthographic(&self) -> bool {
        self.orthographic
    }

    /// Parallel or in perspective; what is looked at keeps its size.
    pub fn set_orthographic(&mut self, orthographic: bool) {
        self.orthographic = orthographic;
    }

    /// The full vertical field of view.
    pub fn fov_y_deg(&self) -> f64 {
        self.fov_y_rad.to_degrees()
    }

    /// The full vertical field of view; from 5 to 140 degrees.
    pub fn set_fov_y_deg(&mut self, degrees: f64) {
        if degrees.is_finite() {
            self.fov_y_rad = degrees.clamp(5.0, 140.0).to_radians();
        }
    }

    /// Right, up, backward.
    fn axes(&self) -> DMat3 {
        let forward = self.forward();
        let right = DVec3::new(self.yaw_rad.sin(), -self.yaw_rad.cos(), 0.0);
        let up = right.cross(forward);
        let (sin, cos) = self.roll_rad.sin_cos();
        DMat3::from_cols(right * cos + up * sin, up * cos - right * sin, -forward)
    }

    /// The height that is seen at `distance`.
    fn seen_height(&self, distance: f64) -> f64 {
        2.0 * (self.fov_y_rad / 2.0).tan() * if self.orthographic { self.distance } else { distance }
    }

    /// The camera for an image of this size.
    ///
    /// # Errors
    ///
    /// As [`Camera::new`]: far out, or for a size of 0.
    pub fn camera(&self, size_px: [u32; 2]) -> Result<Camera, CameraError> {
        let target = self.eye + self.forward() * self.distance;
        let projection = if self.orthographic {
            Projection::Orthographic { height: self.seen_height(self.distance) }
        } else {
            Projection::Perspective { fov_y_rad: self.fov_y_rad }
        };
        Camera::new(self.eye, target, self.axes().y_axis, projection, size_px)
    }

    /// Turns about `pivot` by a drag of so many pixels on an image of that height.
    pub fn orbit(&mut self, pivot: DVec3, drag_px: [f64; 2], height_px: f64) {
        self.flight = None;
        let local = self.axes().transpose() * (self.eye - pivot);
        self.turn(drag_px, height_px, -1.0);
        self.eye = pivot + self.axes() * local;
    }

    /// Looks elsewhere from the same place.
    pub fn look(&mut self, drag_px: [f64; 2], height_px: f64) {
        self.flight = None;
        let per_px = self.fov_y_rad / height_px.max(1.0);
        self.yaw_rad += drag_px[0] * per_px;
        self.pitch_rad = (self.pitch_rad + drag_px[1] * per_px).clamp(-STEEPEST_RAD, STEEPEST_RAD);
    }

    fn turn(&mut self, drag_px: [f64; 2], height_px: f64, sign: f64) {
        // A drag over the height of the image is half a turn.
        let per_px = std::f64::consts::PI / height_px.max(1.0);
        self.yaw_rad += sign * drag_px[0] * per_px;
        self.pitch_rad = (self.pitch_rad + sign * drag_px[1] * per_px).clamp(-STEEPEST_RAD, STEEPEST_RAD);
    }

    /// Moves sideways, so that what is `distance` away follows the pointer.
    pub fn pan(&mut self, drag_px: [f64; 2], distance: f64, height_px: f64) {
        self.flight = None;
        let per_px = self.seen_height(distance) / height_px.max(1.0);
        let axes = self.axes();
        self.eye += (axes.x_axis * -drag_px[0] + axes.y_axis * drag_px[1]) * per_px;
    }

    /// Comes nearer to `to` by a wheel's steps; away for negative ones.
    pub fn zoom(&mut self, to: DVec3, steps: f64) {
        self.flight = None;
        let factor = 0.86_f64.powf(steps.clamp(-50.0, 50.0));
        if self.orthographic {
            // What is under the pointer stays there; the distance along the line of sight does not matter.
            let beside = to - self.eye;
            let beside = beside - self.forward() * self.forward().dot(beside);
            self.eye += beside * (1.0 - factor);
        } else {
            self.eye = to + (self.eye - to) * factor;
        }
        let distance = self.distance * factor;
        if (1e-9..1e12).contains(&distance) {
            self.distance = distance;
        }
    }

    /// Leans over.
    pub fn roll(&mut self, steps: f64) {
        self.roll_rad += steps * 0.05;
    }

    /// Moves: right, forward and up, each from -1 to 1, at `speed` a second. A walker stays at the height of `ground`.
    pub fn advance(&mut self, [right, forward, up]: [f64; 3], speed: f64, seconds: f64, ground: Option<f64>) {
        let axes = self.axes();
        let step = if self.mode == Mode::Walk {
            let ahead = DVec3::new(self.yaw_rad.cos(), self.yaw_rad.sin(), 0.0);
            DVec3::new(ahead.y, -ahead.x, 0.0) * right + ahead * forward
        } else {
            axes.x_axis * right - axes.z_axis * forward + DVec3::Z * up
        };
        if step != DVec3::ZERO {
            self.flight = None;
        }
        self.eye += step.clamp_length_max(1.0) * speed * seconds;
        if let (Mode::Walk, Some(ground)) = (self.mode, ground) {
            // Steps and slopes are taken smoothly: half of the way in a tenth of a second.
            let share = 1.0 - 0.5_f64.powf(seconds / 0.1);
            self.eye.z += (ground + EYE_HEIGHT - self.eye.z) * share;
        }
    }

    /// Goes on with the way to another place; is it still on the way?
    pub fn fly_on(&mut self, seconds: f64) -> bool {
        let Some(flight) = &mut self.flight else { return false };
        flight.seconds += seconds;
        let t = (flight.seconds / FLIGHT_SECONDS).clamp(0.0, 1.0);
        // Starts and ends at rest.
        let t = t * t * (3.0 - 2.0 * t);
        let pose = flight.from.towards(&flight.to, t);
        let done = flight.seconds >= FLIGHT_SECONDS;
        self.set(pose);
        if done {
            self.flight = None;
        }
        !done
    }

    /// Goes to where `point` is in the middle of the free part of the image and near.
    pub fn go_to(&mut self, point: DVec3, onto: Onto) {
        let distance = ((point - self.eye).length() * 0.35).max(f64::MIN_POSITIVE);
        let pose = self.pose();
        self.start(Pose { eye: point - self.ahead(distance, onto), distance, ..pose });
    }

    /// From the eye to what is looked at: what is at its distance in the middle of the free part of the image.
    pub fn looked_at(&self, onto: Onto) -> DVec3 {
        self.eye + self.ahead(self.distance, onto)
    }

    /// From the eye to the middle of the free part of the image, `distance` along the line of sight.
    fn ahead(&self, distance: f64, onto: Onto) -> DVec3 {
        let [x, y] = onto.area.center();
        let height = 2.0 * (self.fov_y_rad / 2.0).tan() * distance;
        let axes = self.axes();
        axes.x_axis * ((x - 0.5) * height * onto.aspect) + axes.y_axis * ((0.5 - y) * height) - axes.z_axis * distance
    }

    /// Looks at the horizon, if it looks down or up steeply.
    pub fn level(&mut self) {
        if self.pitch_rad.abs() > 0.8 {
            self.pitch_rad = 0.0;
        }
    }

    /// Goes to where all of `places` are seen, in the direction that is looked in now.
    pub fn fit(&mut self, places: &[DVec3], onto: Onto) {
        self.fit_from(places, onto, self.yaw_rad, self.pitch_rad);
    }

    /// Goes to where all of `places` are seen from one side.
    pub fn fit_from(&mut self, places: &[DVec3], onto: Onto, yaw_rad: f64, pitch_rad: f64) {
        if let Some(pose) = self.framed(places, onto, yaw_rad, pitch_rad) {
            self.start(pose);
        }
    }

    /// To where all of `places` are seen in the direction that is looked in now, at once.
    pub fn place_to_fit(&mut self, places: &[DVec3], onto: Onto) {
        if let Some(pose) = self.framed(places, onto, self.yaw_rad, self.pitch_rad) {
            self.set(pose);
            (self.flight, self.roll_rad) = (None, 0.0);
        }
    }

    fn framed(&self, places: &[DVec3], onto: Onto, yaw_rad: f64, pitch_rad: f64) -> Option<Pose> {
        let pitch_rad = pitch_rad.clamp(-STEEPEST_RAD, STEEPEST_RAD);
        let level = Self { yaw_rad, pitch_rad, roll_rad: 0.0, ..Self::default() };
        let framing = Framing {
            axes: level.axes(),
            fov_y_rad: self.fov_y_rad,
            aspect: onto.aspect.max(1e-3),
            parallel: self.orthographic,
            area: onto.area,
        };
        let Framed { eye, distance, .. } = framing.eye_for(places)?;
        Some(Pose { eye, yaw_rad, pitch_rad, distance })
    }

    /// Stands at a place, such as a scanner's, looking the way it does now.
    pub fn stand_at(&mut self, place: DVec3) {
        let pose = Pose { eye: place, pitch_rad: 0.0, ..self.pose() };
        self.start(pose);
    }
}

impl Pose {
    fn of(camera: &Camera) -> Self {
        let sight = camera.target() - camera.eye();
        let forward = camera.forward();
        // Straight down or up, the image's upper edge says which way the camera is turned.
        let level = DVec3::new(forward.x, forward.y, 0.0);
        let turned = if level.length() > 1e-3 { level } else { camera.up() * -forward.z.signum() };
        Self {
            eye: camera.eye(),
            yaw_rad: turned.y.atan2(turned.x),
            pitch_rad: forward.z.clamp(-1.0, 1.0).asin().clamp(-STEEPEST_RAD, STEEPEST_RAD),
            distance: sight.length(),
        }
    }

    fn towards(&self, to: &Self, t: f64) -> Self {
        let full = std::f64::consts::TAU;
        // The short way round.
        let turn = (to.yaw_rad - self.yaw_rad + full / 2.0).rem_euclid(full) - full / 2.0;
        Self {
            eye: self.eye + (to.eye - self.eye) * t,
            yaw_rad: self.yaw_rad + turn * t,
            pitch_rad: self.pitch_rad + (to.pitch_rad - self.pitch_rad) * t,
            distance: self.distance + (to.distance - self.distance) * t,
        }
    }
}

fn direction(yaw_rad: f64, pitch_rad: f64) -> DVec3 {
    // The cosine of the nearest f64 to a right angle is not 0, and a plan must not lean.
    if pitch_rad.abs() >= STEEPEST_RAD {
        return DVec3::Z * pitch_rad.signum();
    }
    DVec3::new(yaw_rad.cos() * pitch_rad.cos(), yaw_rad.sin() * pitch_rad.cos(), pitch_rad.sin())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::WorldBox;
    use proptest::prelude::*;

    const SIZE: [u32; 2] = [800, 600];

    fn camera() -> impl Strategy<Value = Camera> {
        let place = || prop::array::uniform3(-100.0_f64..100.0).prop_map(DVec3::from_array);
        (place(), place(), any::<bool>()).prop_filter_map("steep", |(eye, target, parallel)| {
            let sight = target - eye;
            let flat = sight.truncate().length();
            let projection = if parallel {
                Projection::Orthographic { height: 50.0 }
            } else {
                Projection::Perspective { fov_y_rad: 1.1 }
            };
            (flat > 0.2 * sight.length() && flat > 1.0)
                .then(|| Camera::new(eye, target, DVec3::Z, projection, SIZE).unwrap())
        })
    }

    fn pixel(rig: &Rig, point: DVec3) -> [f64; 2] {
        let camera = rig.camera(SIZE).unwrap();
        let [x, y, _] = camera.pixel_from_relative(point - camera.eye()).unwrap();
        [x, y]
    }

    fn near(a: [f64; 2], b: [f64; 2], px: f64) -> bool {
        (a[0] - b[0]).abs() < px && (a[1] - b[1]).abs() < px
    }

    proptest! {
        #[test]
        fn a_camera_comes_back(camera in camera()) {
            let back = Rig::of(&camera).camera(SIZE).unwrap();
            prop_assert!((back.eye() - camera.eye()).length() < 1e-9);
            prop_assert!((back.forward() - camera.forward()).length() < 1e-9);
            let px = |c: &Camera, p: DVec3| c.pixel_from_relative(p - c.eye()).map(|p| [p[0], p[1]]);
            let point = camera.target() + DVec3::new(0.5, 0.2, 0.1);
            if let (Some(a), Some(b)) = (px(&camera, point), px(&back, point)) {
                prop_assert!(near(a, b, 1e-4), "{:?} {:?}", a, b);
            }
        }

        #[test]
        fn a_flight_ends_with_the_picture_of_the_camera(from in camera(), to in camera()) {
            let mut rig = Rig::of(&from);
            rig.fly_to(&to);
            while rig.fly_on(0.1) {}
            prop_assert_eq!(rig.is_orthographic(), matches!(to.projection(), Projection::Orthographic { .. }));
            let back = rig.camera(SIZE).unwrap();
            let px = |c: &Camera, p: DVec3| c.pixel_from_relative(p - c.eye()).map(|p| [p[0], p[1]]);
            let point = to.target() + DVec3::new(0.5, 0.2, 0.1);
            if let (Some(a), Some(b)) = (px(&to, point), px(&back, point)) {
                prop_assert!(near(a, b, 1e-3), "{:?} {:?}", a, b);
            }
        }

        #[test]
        fn the_pivot_of_a_turn_stays_where_it_is(camera in camera(), drag in prop::array::uniform2(-80.0_f64..80.0), depth in 0.3_f64..2.0) {
            let mut rig = Rig::of(&camera);
            let pivot = rig.eye() + rig.forward() * rig.distance() * depth + DVec3::new(0.3, -0.2, 0.1);
            let (before, away) = (pixel(&rig, pivot), (rig.eye() - pivot).length());
            rig.orbit(pivot, drag, 600.0);
            prop_assert!(near(before, pixel(&rig, pivot), 1e-3));
            prop_assert!(((rig.eye() - pivot).length() - away).abs() < 1e-6 * away.max(1.0));
        }

        #[test]
        fn what_is_dragged_follows_the_pointer(camera in camera(), drag in prop::array::uniform2(-80.0_f64..80.0)) {
            let mut rig = Rig::of(&camera);
            let grabbed = rig.eye() + rig.forward() * rig.distance();
            let before = pixel(&rig, grabbed);
            rig.pan(drag, rig.distance(), 600.0);
            let after = pixel(&rig, grabbed);
            prop_assert!(near(after, [before[0] + drag[0], before[1] + drag[1]], 1e-3));
        }

        #[test]
        fn what_is_under_the_pointer_stays_there_while_zooming(camera in camera(), steps in -6.0_f64..6.0) {
            let mut rig = Rig::of(&camera);
            let axes = rig.axes();
            let point = rig.eye() + (rig.forward() + axes.x_axis * 0.2 - axes.y_axis * 0.1) * rig.distance();
            let before = pixel(&rig, point);
            rig.zoom(point, steps);
            prop_assert!(near(before, pixel(&rig, point), 1e-3));
        }

        #[test]
        fn everything_is_seen_beside_the_panels_after_a_fit(
            camera in camera(),
            corner in prop::array::uniform3(-50.0_f64..50.0),
            side in prop::array::uniform3(0.1_f64..80.0),
            covered in 0.0_f64..0.6,
        ) {
            let mut rig = Rig::of(&camera);
            let bounds = WorldBox::new(corner, std::array::from_fn(|i| corner[i] + side[i])).unwrap();
            let onto = Onto { aspect: 800.0 / 600.0, area: ImageArea::new([0.0, 0.05], [1.0 - covered, 1.0]) };
            rig.fit(&bounds.corners(), onto);
            while rig.fly_on(0.1) {}
            for corner in bounds.corners() {
                let [x, y] = pixel(&rig, corner);
                prop_assert!((0.0..=800.0 * (1.0 - covered)).contains(&x) && (30.0..=600.0).contains(&y), "{} {}", x, y);
            }
        }
    }

    #[test]
    fn a_walker_stays_on_the_ground_and_a_flyer_does_not() {
        let projection = Projection::Perspective { fov_y_rad: 1.0 };
        let camera = Camera::new(DVec3::new(0.0, 0.0, 5.0), DVec3::new(0.0, 9.0, -2.0), DVec3::Z, projection, SIZE);
        let mut rig = Rig::of(&camera.unwrap());
        rig.mode = Mode::Walk;
        for _ in 0..60 {
            rig.advance([0.0, 1.0, 0.0], 2.0, 0.05, Some(1.0));
        }
        assert!((rig.eye() - DVec3::new(0.0, 6.0, 1.0 + EYE_HEIGHT)).length() < 1e-4, "{}", rig.eye());
        rig.mode = Mode::Fly;
        rig.advance([0.0, 1.0, 0.0], 2.0, 1.0, Some(1.0));
        assert!(rig.eye().z < 1.0 + EYE_HEIGHT - 0.5, "it flies where it looks");
        rig.advance([1.0, 0.0, 0.0], 2.0, 1.0, None);
        assert!(rig.eye().x > 1.9, "right is right: {}", rig.eye());
        rig.advance([0.0, 0.0, 1.0], 2.0, 1.0, None);
    }

    #[test]
    fn far_from_the_origin_the_camera_is_still_a_camera() {
        let projection = Projection::Perspective { fov_y_rad: 1.0 };
        let eye = DVec3::new(690_000.0, 5_330_000.0, 500.0);
        let camera = Camera::new(eye, eye + DVec3::new(1.0, 2.0, -0.5), DVec3::Z, projection, SIZE).unwrap();
        let mut rig = Rig::of(&camera);
        for _ in 0..1000 {
            rig.zoom(eye + DVec3::new(1.0, 2.0, -0.5), 3.0);
        }
        assert!(rig.camera(SIZE).is_ok() || rig.distance() < 1e-8);
        assert!(rig.camera([0, 10]).is_err(), "a window of no size has no camera");
    }
}

//! From mouse and keys to the camera's movement: state without a window.

use super::bindings::{self, Key};
use super::rig::{Mode, Rig};
use crate::geometry::DVec3;

/// Two clicks within this time and distance are a double click.
const DOUBLE_SECONDS: f64 = 0.4;
const DOUBLE_PX: f64 = 6.0;
/// A button that moved less than this while it was down was clicked, not dragged.
const CLICK_PX: f64 = 4.0;
/// Shift.
const FAST: f64 = 10.0;

/// The keys that are held down.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[allow(missing_docs)]
pub struct Held {
    pub forward: bool,
    pub back: bool,
    pub left: bool,
    pub right: bool,
    pub up: bool,
    pub down: bool,
    pub fast: bool,
    pub alt: bool,
}

/// A mouse button.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Button {
    Left,
    Middle,
    Right,
}

/// What a button that went up had done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Click {
    /// The left one was pressed and released in one place.
    Single,
    /// It was so for the second time.
    Double,
}

/// What the mouse drags.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Drag {
    button: Button,
    from: [f64; 2],
    last: [f64; 2],
    /// The point that was under the pointer.
    pivot: DVec3,
    moved: bool,
}

/// The camera with what moves it.
#[derive(Clone, Debug)]
pub struct Navigator {
    /// Where the camera is.
    pub rig: Rig,
    /// The keys that are held.
    pub held: Held,
    /// Of flying and walking, relative to what the distance suggests.
    pub speed: f64,
    /// The height of the ground under a walker.
    pub ground: Option<f64>,
    drag: Option<Drag>,
    pointer: [f64; 2],
    last_click: Option<(f64, [f64; 2])>,
    /// Seconds since the beginning.
    now: f64,
}

impl Navigator {
    /// At rest.
    pub fn new(rig: Rig) -> Self {
        Self {
            rig,
            held: Held::default(),
            speed: 1.0,
            ground: None,
            drag: None,
            pointer: [0.0; 2],
            last_click: None,
            now: 0.0,
        }
    }

    /// Where the pointer is, in pixels.
    pub fn pointer(&self) -> [f64; 2] {
        self.pointer
    }

    /// Is a button down that drags?
    pub fn is_dragging(&self) -> bool {
        self.drag.is_some_and(|d| d.moved)
    }

    /// Is a key held, or is it on its way somewhere?
    pub fn is_moving(&self) -> bool {
        let Held { forward, back, left, right, up, down, .. } = self.held;
        self.rig.is_flying_to() || [forward, back, left, right, up, down].contains(&true)
    }

    /// A key goes down or up. A key that moves ends orbiting.
    pub fn key(&mut self, key: Key, down: bool) {
        // Alone it begins no flight: whoever presses it may have another key in mind.
        if down && key == Key::Control && self.rig.mode == Mode::Orbit {
            return;
        }
        let Some(held) = bindings::held(&mut self.held, key) else { return };
        *held = down;
        let moves = !matches!(key, Key::Shift | Key::Alt);
        if down && moves && self.rig.mode == Mode::Orbit {
            self.rig.mode = Mode::Fly;
        }
    }

    /// No key is held any more: the window lost the keyboard.
    pub fn release_all(&mut self) {
        self.held = Held::default();
        self.drag = None;
    }

    /// A button goes down; `under` is the point under the pointer, if it is known.
    pub fn press(&mut self, button: Button, at: [f64; 2], under: Option<DVec3>) {
        let ahead = self.rig.eye() + self.rig.forward() * self.rig.distance();
        self.pointer = at;
        self.drag = Some(Drag { button, from: at, last: at, pivot: under.unwrap_or(ahead), moved: false });
    }

    /// The pointer is there now, on an image of that height.
    pub fn point(&mut self, at: [f64; 2], height_px: f64) {
        self.pointer = at;
        let Some(drag) = &mut self.drag else { return };
        let by = [at[0] - drag.last[0], at[1] - drag.last[1]];
        let away = (at[0] - drag.from[0]).hypot(at[1] - drag.from[1]);
        if !drag.moved && away < CLICK_PX {
            return;
        }
        drag.moved = true;
        drag.last = at;
        let (button, pivot) = (drag.button, drag.pivot);
        match (button, self.rig.mode) {
            (Button::Left, Mode::Orbit) => self.rig.orbit(pivot, by, height_px),
            (Button::Left, _) => self.rig.look(by, height_px),
            (Button::Right | Button::Middle, _) => {
                let depth = (pivot - self.rig.eye()).dot(self.rig.forward());
                let depth = if depth > 0.0 { depth } else { self.rig.distance() };
                self.rig.pan(by, depth, height_px);
            }
        }
    }

    /// The button goes up.
    pub fn release(&mut self, button: Button) -> Option<Click> {
        let drag = self.drag.take_if(|d| d.button == button)?;
        if drag.moved || button != Button::Left {
            return None;
        }
        let near = |at: [f64; 2]| (at[0] - drag.from[0]).hypot(at[1] - drag.from[1]) < DOUBLE_PX;
        if self.last_click.take_if(|(then, at)| self.now - *then < DOUBLE_SECONDS && near(*at)).is_some() {
            return Some(Click::Double);
        }
        self.last_click = Some((self.now, drag.from));
        Some(Click::Single)
    }

    /// The wheel turns by so many steps, away from the hand; `under` is the point under the pointer, if it is known.
    pub fn wheel(&mut self, steps: f64, under: Option<DVec3>) {
        if self.held.alt {
            self.rig.roll(steps);
        } else if self.rig.mode == Mode::Orbit {
            let ahead = self.rig.eye() + self.rig.forward() * self.rig.distance();
            self.rig.zoom(under.unwrap_or(ahead), steps);
        } else {
            self.speed = (self.speed * 1.25_f64.powf(steps)).clamp(1e-3, 1e3);
        }
    }

    /// How fast the camera flies, in units a second: what is looked at is reached in about two seconds.
    pub fn units_per_second(&self) -> f64 {
        let fast = if self.held.fast { FAST } else { 1.0 };
        let pace = if self.rig.mode == Mode::Walk { 2.0 } else { self.rig.distance() * 0.5 };
        pace * self.speed * fast
    }

    /// Some time goes by; does anything move?
    pub fn advance(&mut self, seconds: f64) -> bool {
        self.now += seconds;
        let way = self.rig.fly_on(seconds);
        let axis = |plus: bool, minus: bool| f64::from(i8::from(plus) - i8::from(minus));
        let Held { forward, back, left, right, up, down, .. } = self.held;
        let motion = [axis(right, left), axis(forward, back), axis(up, down)];
        let moves = motion != [0.0; 3];
        let sinks = self.rig.mode == Mode::Walk && self.ground.is_some();
        if moves || sinks {
            self.rig.advance(motion, self.units_per_second(), seconds, self.ground);
        }
        way || moves || sinks
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Camera, Projection};

    fn navigator() -> Navigator {
        let projection = Projection::Perspective { fov_y_rad: 1.0 };
        let camera = Camera::new(DVec3::new(0.0, -10.0, 3.0), DVec3::ZERO, DVec3::Z, projection, [800, 600]).unwrap();
        Navigator::new(Rig::of(&camera))
    }

    #[test]
    fn a_move_key_begins_flight_and_speed_follows_the_distance() {
        let mut nav = navigator();
        assert_eq!(nav.rig.mode, Mode::Orbit);
        nav.key(Key::W, true);
        assert_eq!(nav.rig.mode, Mode::Fly);
        let before = nav.rig.eye();
        assert!(nav.advance(0.1));
        let step = (nav.rig.eye() - before).length();
        nav.key(Key::Shift, true);
        let before = nav.rig.eye();
        nav.advance(0.1);
        assert!(((nav.rig.eye() - before).length() / step - FAST).abs() < 1e-9);
        nav.key(Key::Shift, false);
        nav.rig.set_distance(nav.rig.distance() * 4.0);
        let before = nav.rig.eye();
        nav.advance(0.1);
        assert!(((nav.rig.eye() - before).length() / step - 4.0).abs() < 1e-9);
        nav.key(Key::W, false);
        assert!(!nav.advance(0.1), "at rest");
        nav.rig.mode = Mode::Orbit;
        nav.key(Key::Control, true);
        assert!(!nav.advance(0.1) && nav.rig.mode == Mode::Orbit, "Ctrl alone");
        nav.rig.mode = Mode::Fly;
        nav.key(Key::Control, true);
        assert!(nav.advance(0.1), "down");
        nav.key(Key::Control, false);
        nav.key(Key::D, true);
        nav.release_all();
        assert!(!nav.is_moving());
    }

    #[test]
    fn a_click_is_not_a_drag_and_two_are_a_double_click() {
        let mut nav = navigator();
        let before = nav.rig.clone();
        nav.press(Button::Left, [100.0, 100.0], None);
        nav.point([102.0, 101.0], 600.0);
        assert_eq!(nav.release(Button::Left), Some(Click::Single));
        assert_eq!(nav.rig, before, "a hand trembles");
        nav.advance(0.1);
        nav.press(Button::Left, [101.0, 100.0], None);
        assert_eq!(nav.release(Button::Left), Some(Click::Double));
        nav.advance(0.1);
        nav.press(Button::Left, [101.0, 100.0], None);
        assert_eq!(nav.release(Button::Left), Some(Click::Single), "a third click is a first one");
        nav.advance(1.0);
        nav.press(Button::Left, [101.0, 100.0], None);
        assert_eq!(nav.release(Button::Left), Some(Click::Single), "too late");
        nav.press(Button::Left, [100.0, 100.0], Some(DVec3::ZERO));
        nav.point([160.0, 100.0], 600.0);
        assert!(nav.is_dragging());
        assert_eq!(nav.release(Button::Right), None, "another button");
        assert_eq!(nav.release(Button::Left), None);
        assert_ne!(nav.rig, before);
    }

    #[test]
    fn the_wheel_zooms_in_orbit_sets_the_speed_in_flight_and_leans_with_alt() {
        let mut nav = navigator();
        let away = nav.rig.eye().length();
        nav.wheel(2.0, Some(DVec3::ZERO));
        assert!(nav.rig.eye().length() < away);
        nav.key(Key::W, true);
        let (eye, speed) = (nav.rig.eye(), nav.speed);
        nav.wheel(2.0, Some(DVec3::ZERO));
        assert!(nav.speed > speed && nav.rig.eye() == eye);
        nav.key(Key::Alt, true);
        let rig = nav.rig.clone();
        nav.wheel(1.0, None);
        assert_ne!(nav.rig, rig);
    }
}

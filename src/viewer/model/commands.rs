//! What keys, buttons and clicks do to the model.

use super::{Action, Model, Section, size_of_aspect};
use crate::geometry::DVec3;
use crate::viewer::bindings::{self, Command, Key};
use crate::viewer::navigate::Click;
use crate::viewer::rig::Mode;

impl Model {
    /// A key goes down or up, which no text field wants.
    pub fn key(&mut self, key: Key, down: bool, aspect: f64) {
        self.nav.key(key, down);
        if let (true, Some(command)) = (down, bindings::command(key)) {
            self.command(command, aspect);
        }
    }

    /// Does what a key or a button says.
    pub fn command(&mut self, command: Command, aspect: f64) {
        use std::f64::consts::FRAC_PI_2;
        let (places, onto) = (self.places(), self.onto(aspect));
        let mut from = |yaw: f64, pitch: f64| {
            self.nav.rig.mode = Mode::Orbit;
            self.nav.rig.fit_from(&places, onto, yaw, pitch);
        };
        match command {
            Command::Top => from(FRAC_PI_2, -FRAC_PI_2),
            Command::Front => from(FRAC_PI_2, 0.0),
            Command::Side => from(2.0 * FRAC_PI_2, 0.0),
            Command::Fit => self.fit(aspect),
            Command::Orthographic => {
                let parallel = self.nav.rig.is_orthographic();
                self.nav.rig.set_orthographic(!parallel);
            }
            Command::Mode(mode) => {
                let now = self.nav.rig.mode;
                self.set_mode(if now == mode && mode == Mode::Walk { Mode::Fly } else { mode });
            }
            Command::Measure => {
                self.measuring = !self.measuring;
                if self.measuring {
                    self.open.insert(Section::Measure);
                }
            }
            Command::Undo => self.measured.undo(),
            Command::Bookmark => self.bookmark(aspect),
            Command::NextStation => self.next_station(),
            Command::Screenshot => self.actions.push(Action::Screenshot),
            Command::Help => {
                self.help = !self.help;
                self.set.knows_help = true;
            }
            Command::Panels => self.set.panels = !self.set.panels,
            Command::FullScreen => self.actions.push(Action::FullScreen),
            Command::Escape => {
                if self.help {
                    self.command(Command::Help, aspect);
                } else if self.measuring {
                    self.measuring = false;
                } else {
                    self.nav.rig.mode = Mode::Orbit;
                }
            }
        }
    }

    /// Moves in another way. Who begins to walk looks ahead.
    pub fn set_mode(&mut self, mode: Mode) {
        if mode == Mode::Walk && self.nav.rig.mode != mode {
            self.nav.rig.level();
        }
        self.nav.rig.mode = mode;
    }

    /// Keeps the view under the name that was typed, or a new one.
    fn bookmark(&mut self, aspect: f64) {
        let typed = self.bookmark_name.trim().to_owned();
        let taken = |name: &str| self.site.as_ref().is_some_and(|s| s.bookmarks.iter().any(|(n, _)| n == name));
        let numbered = || (1..).map(|i| format!("view {i}")).find(|name| !taken(name)).unwrap_or_default();
        if taken(&typed) {
            return self.tell(format!("There is a view '{typed}' already: give another name, or remove that one"));
        }
        let name = if typed.is_empty() { numbered() } else { typed };
        if let Ok(camera) = self.nav.rig.camera(size_of_aspect(aspect)) {
            self.actions.push(Action::SaveBookmark(name, Box::new(camera)));
            self.bookmark_name.clear();
        }
    }

    fn next_station(&mut self) {
        let stations: Vec<(String, DVec3)> = match &self.site {
            Some(site) => site.stations().map(|(name, place)| (name.to_owned(), place)).collect(),
            None => Vec::new(),
        };
        if stations.is_empty() {
            return self.tell("These scans don't say where their scanners stood");
        }
        let (name, place) = stations[self.next_station % stations.len()].clone();
        self.next_station += 1;
        self.stand_at(&name, place);
    }

    /// Stands where a scanner stood.
    pub fn stand_at(&mut self, name: &str, place: DVec3) {
        self.nav.rig.mode = Mode::Fly;
        self.nav.rig.stand_at(place);
        self.tell(format!("Scanner of {name}"));
    }

    /// The point under the pointer was clicked, or nothing was.
    pub fn click(&mut self, click: Click, aspect: f64) {
        let Some(found) = self.hover.clone() else { return };
        let onto = self.onto(aspect);
        match click {
            Click::Double => self.nav.rig.go_to(found.world, onto),
            Click::Single if self.measuring => {
                self.measured.add(found.world);
                self.picked = Some(found);
            }
            Click::Single => {
                // The first one shows where what is stored of it is to be seen; whoever closes that keeps it closed.
                if self.picked.is_none() {
                    self.open.insert(Section::Point);
                }
                self.picked = Some(found);
            }
        }
    }
}

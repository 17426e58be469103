//! All that the window shows and that its panels change: state and what follows from it, without a window.

use super::bindings::{self, Command, Key};
use super::measure::Measurement;
use super::navigate::{Click, Navigator};
use super::remembered::Remembered;
use super::rig::{Mode, Rig};
use super::site::Site;
use crate::geometry::{Camera, DVec3, WorldBox};
use crate::lattice::Lattice;
use crate::points::Batch;
use crate::query::Filter;
use crate::render::{ClipBox, ColorMode, ColorOptions, Coloring, Edl, Fog, MAX_CLIPS, Palette, RenderOptions, Shape};
use crate::stream::gpu::Paint;
use crate::stream::{Limits, ScanChoice, Shown, Status};
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// How long a message is shown.
const MESSAGE_SECONDS: f64 = 6.0;

/// So many palettes are kept for points that are still shown in old colours.
const KEPT_PALETTES: usize = 4;

/// What the window has to do for the model.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// A picture of the points, without panels.
    Screenshot,
    /// Keep this camera in the store.
    SaveBookmark(String, Box<Camera>),
    /// Take it out of the store.
    RemoveBookmark(String),
    /// The points of a box to a file.
    Export(WorldBox, PathBuf),
    /// Full screen or not.
    FullScreen,
}

/// A box that keeps or cuts out points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clip {
    /// The low corner.
    pub min: [f64; 3],
    /// The high corner.
    pub max: [f64; 3],
    /// Keep what is inside, or cut it out?
    pub keep: bool,
    /// Is it used?
    pub on: bool,
}

impl Clip {
    /// As a box; `None` if it has no volume.
    pub fn bounds(&self) -> Option<WorldBox> {
        WorldBox::new(self.min, self.max).filter(|b| b.extent().min_element() > 0.0)
    }
}

/// A point of the store, looked up.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// Where it is.
    pub world: DVec3,
    /// Its exact coordinates and its attributes, as text.
    pub values: Vec<(String, String)>,
}

/// Which sections of the panel are open.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Section {
    /// Scans.
    Scans,
    /// Colours and their legend.
    Color,
    /// Budget and looks.
    Quality,
    /// Clip boxes and export.
    Clip,
    /// Measuring.
    Measure,
    /// Bookmarks and stations.
    Places,
    /// The point under the pointer.
    Point,
    /// Statistics.
    Statistics,
}

impl Section {
    /// All, in the order of the panel.
    pub const ALL: [Self; 8] = [
        Self::Scans,
        Self::Color,
        Self::Quality,
        Self::Places,
        Self::Measure,
        Self::Clip,
        Self::Point,
        Self::Statistics,
    ];

    /// The word by which settings and scripts name it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Scans => "scans",
            Self::Color => "color",
            Self::Quality => "quality",
            Self::Clip => "clip",
            Self::Measure => "measure",
            Self::Places => "places",
            Self::Point => "point",
            Self::Statistics => "statistics",
        }
    }

    /// The heading.
    pub fn title(self) -> &'static str {
        match self {
            Self::Scans => "Scans",
            Self::Color => "Colour",
            Self::Quality => "Budget and looks",
            Self::Clip => "Clip boxes, export",
            Self::Measure => "Measure",
            Self::Places => "Bookmarks, stations",
            Self::Point => "Point",
            Self::Statistics => "Statistics",
        }
    }
}

/// What is measured of drawing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameTimes {
    /// A frame's work on this thread, smoothed.
    pub work: Duration,
    /// From frame to frame, smoothed.
    pub interval: Duration,
    /// From the start to the first picture with points.
    pub first_picture: Option<Duration>,
    /// From the start to the first complete picture.
    pub first_complete: Option<Duration>,
}

/// The viewer's state.
pub struct Model {
    /// The camera.
    pub nav: Navigator,
    /// What is remembered; the panels change it directly.
    pub set: Remembered,
    /// What is known of the store.
    pub site: Option<Site>,
    /// Which scans are seen.
    pub scans: ScanChoice,
    /// Colours.
    pub mode: ColorMode,
    /// The ends of a ramp, if they are not to be found by the sample.
    pub range: Option<[f64; 2]>,
    /// Classes that are not seen.
    pub classes_off: BTreeSet<u32>,
    /// Boxes.
    pub clips: Vec<Clip>,
    /// Is a click a measured point?
    pub measuring: bool,
    /// What has been measured.
    pub measured: Measurement,
    /// The point under the pointer.
    pub hover: Option<Found>,
    /// The point that was clicked.
    pub picked: Option<Found>,
    /// The open sections.
    pub open: BTreeSet<Section>,
    /// Is the help open?
    pub help: bool,
    /// The name for the next bookmark.
    pub bookmark_name: String,
    /// The file for the next export.
    pub export_path: String,
    /// Nodes as boxes.
    pub node_boxes: bool,
    /// What the window should do.
    pub actions: Vec<Action>,
    /// How far the stream is.
    pub status: Status,
    /// How long frames take.
    pub times: FrameTimes,
    /// The adapter's name.
    pub adapter: String,
    /// The store's name.
    pub store: String,
    /// Where widgets are on the window, for scripts: centre, in points.
    pub widgets: BTreeMap<String, [f32; 2]>,
    coloring: Option<(u64, ColorKey, Coloring)>,
    /// By the tags of their paints, the newest last.
    palettes: Vec<(u64, Palette)>,
    /// What is told, and until when.
    message: Option<(String, f64)>,
    next_station: usize,
    placed: bool,
    now: f64,
}

/// What a colouring was made for.
type ColorKey = (ColorMode, Option<[u64; 2]>);

impl Model {
    /// Before anything is known of the store.
    pub fn new(store: String, set: Remembered) -> Self {
        let open = Section::ALL.into_iter().filter(|s| set.open.iter().any(|o| o == s.word())).collect();
        let mut nav = Navigator::new(Rig::default());
        nav.rig.set_fov_y_deg(set.fov_y_deg);
        Self {
            nav,
            help: !set.knows_help,
            set,
            site: None,
            scans: ScanChoice::default(),
            mode: ColorMode::Rgb,
            range: None,
            classes_off: BTreeSet::new(),
            clips: Vec::new(),
            measuring: false,
            measured: Measurement::default(),
            hover: None,
            picked: None,
            open,
            bookmark_name: String::new(),
            export_path: String::new(),
            node_boxes: false,
            actions: Vec::new(),
            status: Status::default(),
            times: FrameTimes::default(),
            adapter: String::new(),
            store,
            widgets: BTreeMap::new(),
            coloring: None,
            palettes: Vec::new(),
            message: None,
            next_station: 0,
            placed: false,
            now: 0.0,
        }
    }

    /// What there is to remember now.
    pub fn remembered(&self) -> Remembered {
        let open = self.open.iter().map(|s| s.word().to_owned()).collect();
        Remembered { open, fov_y_deg: self.nav.rig.fov_y_deg(), ..self.set.clone() }
    }

    /// A newer generation is known. The first one with points is shown whole.
    pub fn set_site(&mut self, site: Site, aspect: f64) {
        if let (false, Some(bounds)) = (self.placed, site.bounds) {
            if let Ok(camera) = Camera::looking_at_all(&bounds, size_of_aspect(aspect)) {
                self.nav.rig.place(&camera);
                self.nav.rig.set_fov_y_deg(self.set.fov_y_deg);
            }
            self.placed = true;
        }
        if let Some(before) = &self.site {
            let new: Vec<&str> = site
                .scans
                .iter()
                .filter(|s| before.scans.iter().all(|b| b.id != s.id))
                .map(|s| s.name.as_str())
                .collect();
            if !new.is_empty() {
                let words = format!("New: {}", new.join(", "));
                self.tell(words);
            }
        }
        self.site = Some(site);
    }

    /// Shows a message for some seconds.
    pub fn tell(&mut self, words: impl Into<String>) {
        self.message = Some((words.into(), self.now + MESSAGE_SECONDS));
    }

    /// What is told now.
    pub fn message(&self) -> Option<&str> {
        self.message.as_ref().map(|(words, _)| words.as_str())
    }

    /// Some time goes by; does anything change by itself?
    pub fn advance(&mut self, seconds: f64) -> bool {
        self.now += seconds;
        if self.message.as_ref().is_some_and(|(_, until)| self.now > *until) {
            self.message = None;
        }
        self.nav.advance(seconds)
    }

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
        let bounds = self.seen_bounds();
        let mut from = |yaw: f64, pitch: f64| {
            if let Some(bounds) = &bounds {
                self.nav.rig.mode = Mode::Orbit;
                self.nav.rig.fit_from(bounds, aspect, yaw, pitch);
            }
        };
        match command {
            Command::Top => from(FRAC_PI_2, -FRAC_PI_2),
            Command::Front => from(FRAC_PI_2, 0.0),
            Command::Side => from(2.0 * FRAC_PI_2, 0.0),
            Command::Fit => {
                if let Some(bounds) = &bounds {
                    self.nav.fit(bounds, aspect);
                }
            }
            Command::Orthographic => {
                let parallel = self.nav.rig.is_orthographic();
                self.nav.rig.set_orthographic(!parallel);
            }
            Command::Mode(mode) => {
                let now = self.nav.rig.mode;
                self.nav.rig.mode = if now == mode && mode == Mode::Walk { Mode::Fly } else { mode };
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

    /// The bounds of the scans that are seen.
    pub fn seen_bounds(&self) -> Option<WorldBox> {
        let site = self.site.as_ref()?;
        let seen = site.scans.iter().filter(|s| self.scans.sees(s.id, s.visible)).filter_map(|s| s.bounds);
        let join = |a: WorldBox, b: WorldBox| {
            WorldBox::new(a.min().min(b.min()).to_array(), a.max().max(b.max()).to_array()).unwrap_or(a)
        };
        seen.reduce(join).or(site.bounds)
    }

    /// Keeps the view under the name that was typed, or a new one.
    fn bookmark(&mut self, aspect: f64) {
        let typed = self.bookmark_name.trim().to_owned();
        let taken = |name: &str| self.site.as_ref().is_some_and(|s| s.bookmarks.iter().any(|(n, _)| n == name));
        let numbered = || (1..).map(|i| format!("view {i}")).find(|name| !taken(name)).unwrap_or_default();
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
    pub fn click(&mut self, click: Click) {
        let Some(found) = self.hover.clone() else { return };
        match click {
            Click::Double => self.nav.rig.go_to(found.world),
            Click::Single if self.measuring => {
                self.measured.add(found.world);
                self.picked = Some(found);
            }
            Click::Single => {
                self.picked = Some(found);
            }
        }
    }

    /// A box around what is looked at.
    pub fn add_clip(&mut self) {
        if self.clips.len() >= MAX_CLIPS {
            return self.tell(format!("There are {MAX_CLIPS} boxes already, the most that there can be"));
        }
        let rig = &self.nav.rig;
        let middle = match &self.picked {
            Some(found) => found.world,
            None => rig.eye() + rig.forward() * rig.distance(),
        };
        let half = DVec3::splat((rig.distance() * 0.25).max(1e-6));
        self.clips.push(Clip {
            min: (middle - half).to_array(),
            max: (middle + half).to_array(),
            keep: true,
            on: true,
        });
    }

    /// How the points are drawn.
    pub fn options(&self) -> RenderOptions {
        let set = &self.set;
        let clip = |c: &Clip| ClipBox::from_bounds(&c.bounds()?, c.keep).ok();
        let reach = self.seen_bounds().map_or(1.0, |b| b.extent().length());
        RenderOptions {
            radius_factor: set.splat,
            min_radius_px: set.least_px,
            shape: set.shape.parse::<Shape>().unwrap_or_default(),
            edl: (set.edl > 0.0).then(|| Edl { strength: set.edl, ..Edl::default() }),
            shadow_px: set.shadow_px,
            // Half of the site away at full haze everything is half hidden.
            fog: (set.haze > 0.0).then(|| Fog { color: None, start: 0.0, half: (reach * 0.25 / set.haze).max(1e-9) }),
            clips: self.clips.iter().filter(|c| c.on).filter_map(clip).take(MAX_CLIPS).collect(),
            node_boxes: self.node_boxes,
            ..RenderOptions::default()
        }
    }

    /// How much may be used.
    pub fn limits(&self) -> Limits {
        Limits { points: self.set.budget_points, error_px: self.set.error_px, ..Limits::default() }
    }

    /// The colouring of the site; made when something that it depends on has changed.
    pub fn coloring(&mut self) -> Option<&Coloring> {
        let site = self.site.as_ref()?;
        let key: ColorKey = (self.mode, self.range.map(|r| r.map(f64::to_bits)));
        let fresh = self.coloring.as_ref().is_some_and(|(g, k, _)| (*g, *k) == (site.generation, key));
        if !fresh {
            let options = ColorOptions {
                mode: self.mode,
                depths: site.depths.clone(),
                range: self.range,
                scan_names: site.scans.iter().map(|s| (s.id, s.name.clone())).collect(),
            };
            let made = Coloring::new(&[&site.sample], &site.lattice, &options).or_else(|_| {
                // The mode shows what these points lack: heights are always there.
                Coloring::new(&[&site.sample], &site.lattice, &ColorOptions { mode: ColorMode::Height, ..options })
            });
            self.coloring = Some((site.generation, key, made.ok()?));
        }
        self.coloring.as_ref().map(|(_, _, coloring)| coloring)
    }

    /// The colours of the values that a paint made: while points of a new paint are on their way the old ones are shown as
    /// they were.
    pub fn palette_for(&mut self, paint: u64) -> Palette {
        if let Some(coloring) = self.coloring() {
            let (tag, palette) = (coloring.paint.tag(), coloring.palette.clone());
            self.palettes.retain(|(t, _)| *t != tag);
            self.palettes.push((tag, palette));
            let old = self.palettes.len().saturating_sub(KEPT_PALETTES);
            self.palettes.drain(..old);
        }
        let found = self.palettes.iter().find(|(tag, _)| *tag == paint);
        found.map(|(_, palette)| palette.clone()).unwrap_or_default()
    }

    /// What the stream is to show.
    pub fn shown(&mut self) -> Option<Shown> {
        let filter = self.class_filter();
        let scans = self.scans.clone();
        let paint = self.coloring()?.paint.clone();
        Some(Shown { scans, filter, paint })
    }

    /// Hides the classes that are off.
    fn class_filter(&self) -> Option<Filter> {
        let there = self.site.as_ref().is_some_and(|s| s.has("Classification"));
        if self.classes_off.is_empty() || !there {
            return None;
        }
        let classes: Vec<String> = self.classes_off.iter().map(u32::to_string).collect();
        let text = format!("Classification is null or not (Classification in ({}))", classes.join(", "));
        Filter::parse(&text).ok()
    }
}

/// What is shown before anything is known of the store.
pub(super) fn plain_shown() -> Shown {
    Shown { scans: ScanChoice::default(), filter: None, paint: Arc::new(Grey) }
}

/// All points are grey.
#[derive(Debug)]
struct Grey;

impl Paint for Grey {
    fn tag(&self) -> u64 {
        0
    }

    fn attributes(&self) -> Vec<String> {
        Vec::new()
    }

    fn needs_scans(&self) -> bool {
        false
    }

    fn paint(&self, batch: &Batch, _: &Lattice, values: &mut Vec<u32>) {
        values.resize(values.len() + batch.len(), u32::from_le_bytes([150, 150, 150, 255]));
    }
}

fn size_of_aspect(aspect: f64) -> [u32; 2] {
    let height = 720.0;
    [(height * aspect.clamp(0.05, 20.0)).round() as u32, height as u32]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::ColorDepths;
    use crate::viewer::site::ScanFacts;

    fn site(generation: u64, names: &[&str]) -> Site {
        let scan = |(id, name): (u32, &&str)| ScanFacts {
            id,
            name: (*name).to_owned(),
            points: 10,
            visible: true,
            station: (id == 2).then_some(DVec3::new(5.0, 5.0, 1.0)),
            bounds: WorldBox::new([f64::from(id) * 10.0, 0.0, 0.0], [f64::from(id) * 10.0 + 8.0, 20.0, 5.0]),
        };
        Site {
            generation,
            lattice: Lattice::uniform(0.001).unwrap(),
            scans: (1..).zip(names).map(scan).collect(),
            bounds: WorldBox::new([10.0, 0.0, 0.0], [28.0, 20.0, 5.0]),
            points: 20,
            attributes: vec!["Classification".into()],
            unit: "m".into(),
            bookmarks: Vec::new(),
            sample: Batch::empty(Vec::new().into()),
            depths: ColorDepths::default(),
        }
    }

    fn model() -> Model {
        let mut model = Model::new("s.esker".into(), Remembered::default());
        model.set_site(site(1, &["north", "roof"]), 1.5);
        model
    }

    #[test]
    fn the_first_site_is_seen_whole_and_a_later_one_leaves_the_camera() {
        let mut model = model();
        let eye = model.nav.rig.eye();
        assert!(eye.x > 0.0 && model.message().is_none());
        model.set_site(site(2, &["north", "roof", "door"]), 1.5);
        assert_eq!(model.nav.rig.eye(), eye);
        assert_eq!(model.message(), Some("New: door"));
        model.advance(MESSAGE_SECONDS + 1.0);
        assert_eq!(model.message(), None);
    }

    #[test]
    fn classes_that_are_off_become_a_filter_and_scans_a_choice() {
        let mut model = model();
        assert_eq!(model.shown().unwrap().filter, None);
        model.classes_off.extend([7, 18]);
        let text = model.shown().unwrap().filter.unwrap().to_string();
        assert_eq!(text, "Classification is null or not (Classification in (7, 18))");
        let all = model.seen_bounds().unwrap();
        model.scans.set(1, true, false);
        assert!(model.seen_bounds().unwrap().extent().x < all.extent().x, "what is hidden is not fitted");
        assert!(model.shown().unwrap().scans.hidden.contains(&1));
    }

    #[test]
    fn a_view_is_kept_under_a_name_that_is_free() {
        let mut model = model();
        model.key(Key::B, true, 1.5);
        model.bookmark_name = " door ".into();
        model.command(Command::Bookmark, 1.5);
        let names: Vec<_> = model
            .actions
            .iter()
            .map(|a| match a {
                Action::SaveBookmark(name, _) => name.as_str(),
                _ => "",
            })
            .collect();
        assert_eq!(names, ["view 1", "door"]);
        assert!(model.bookmark_name.is_empty());
    }

    #[test]
    fn clicks_measure_pick_and_go() {
        let mut model = model();
        model.click(Click::Single);
        assert_eq!(model.picked, None, "nothing was under the pointer");
        let found = Found { world: DVec3::new(12.0, 3.0, 1.0), values: Vec::new() };
        model.hover = Some(found.clone());
        model.click(Click::Single);
        assert_eq!((model.picked.as_ref(), model.measured.points().len()), (Some(&found), 0));
        model.key(Key::M, true, 1.5);
        model.click(Click::Single);
        model.click(Click::Single);
        model.key(Key::Backspace, true, 1.5);
        assert_eq!(model.measured.points().len(), 1);
        model.key(Key::Escape, true, 1.5);
        model.key(Key::Escape, true, 1.5);
        assert!(!model.measuring && !model.help);
        model.click(Click::Double);
        while model.advance(0.1) {}
        let (to, forward) = (found.world - model.nav.rig.eye(), model.nav.rig.forward());
        assert!(to.normalize().dot(forward) > 0.999_999, "what was double-clicked is in the middle");
    }

    #[test]
    fn boxes_are_drawn_when_they_have_a_volume() {
        let mut model = model();
        for _ in 0..MAX_CLIPS + 2 {
            model.add_clip();
        }
        assert_eq!((model.clips.len(), model.options().clips.len()), (MAX_CLIPS, MAX_CLIPS));
        model.clips[0].on = false;
        model.clips[1].max = model.clips[1].min;
        assert_eq!(model.options().clips.len(), MAX_CLIPS - 2);
    }

    #[test]
    fn from_the_top_north_is_up() {
        let mut model = model();
        model.key(Key::Digit(1), true, 1.5);
        while model.advance(0.1) {}
        let camera = model.nav.rig.camera([300, 200]).unwrap();
        let middle = model.seen_bounds().unwrap().center();
        let px = |p: DVec3| camera.pixel_from_relative(p - camera.eye()).unwrap();
        let (center, north) = (px(middle), px(middle + DVec3::Y));
        assert!(north[1] < center[1] - 1.0 && (north[0] - center[0]).abs() < 0.1, "{center:?} {north:?}");
        model.key(Key::L, true, 1.5);
        while model.advance(0.1) {}
        assert_eq!(model.nav.rig.eye(), DVec3::new(5.0, 5.0, 1.0), "at the scanner");
    }
}

//! All that the window shows and that its panels change: state and what follows from it, without a window.

mod commands;
mod looks;
mod section;

pub(super) use looks::plain_shown;
pub use section::Section;

use super::measure::Measurement;
use super::navigate::Navigator;
use super::remembered::Remembered;
use super::rig::{Onto, Rig};
use super::site::Site;
use crate::geometry::{Camera, DVec3, ImageArea, WorldBox};
use crate::query::Filter;
use crate::render::{ColorMode, Coloring, MAX_CLIPS, Palette};
use crate::stream::{ScanChoice, Status};
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::time::Duration;

/// How long a message is shown.
const MESSAGE_SECONDS: f64 = 6.0;

/// What is seen at first.
#[derive(Clone, Debug, Default)]
pub struct Start {
    /// From where; `None`: from where everything is seen.
    pub camera: Option<Camera>,
    /// In which colours; `None`: the recorded ones.
    pub mode: Option<ColorMode>,
    /// Of which scans.
    pub scans: ScanChoice,
    /// Which of their points; `None`: all.
    pub filter: Option<Filter>,
}

/// What the window has to do for the model.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// A picture of the points, without panels.
    Screenshot,
    /// Keep this camera in the store.
    SaveBookmark(String, Box<Camera>),
    /// Take it out of the store.
    RemoveBookmark(String),
    /// Show only points for which this is true, if it means something in the store.
    Filter(String),
    /// The points of a box that are seen to a file: of the scans and the classes that are on, under the filter.
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
    /// To so many digits behind the point: what is shown is what is used.
    pub fn round(&mut self, decimals: usize) {
        let power = 10_f64.powi(decimals as i32);
        for value in self.min.iter_mut().chain(&mut self.max) {
            let rounded = (*value * power).round() / power;
            if rounded.is_finite() {
                *value = rounded;
            }
        }
    }

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

/// What is measured of drawing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameTimes {
    /// A frame's work on this thread, smoothed.
    pub work: Duration,
    /// From frame to frame, smoothed.
    pub interval: Duration,
    /// From the start until the adapter was there.
    pub adapter: Option<Duration>,
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
    /// Only points for which it is true are seen.
    pub filter: Option<Filter>,
    /// The filter that is being typed.
    pub filter_text: String,
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
    /// Where widgets are on the window, for scripts: centre, in points.
    pub widgets: BTreeMap<String, [f32; 2]>,
    coloring: Option<(u64, ColorKey, Coloring)>,
    /// By the tags of their paints, the newest last.
    palettes: Vec<(u64, Palette)>,
    /// What is told, and until when.
    message: Option<(String, f64)>,
    next_station: usize,
    /// The camera that shows everything, as long as nobody has moved it.
    placed: Option<Rig>,
    area: ImageArea,
    now: f64,
}

/// What a colouring was made for.
type ColorKey = (ColorMode, Option<[u64; 2]>);

impl Model {
    /// Before anything is known of the store.
    pub fn new(set: Remembered) -> Self {
        let open = Section::ALL.into_iter().filter(|s| set.open.iter().any(|o| o == s.word())).collect();
        let mut nav = Navigator::new(Rig::default());
        nav.rig.set_fov_y_deg(set.fov_y_deg);
        Self {
            nav,
            help: false,
            set,
            site: None,
            scans: ScanChoice::default(),
            mode: ColorMode::Rgb,
            range: None,
            classes_off: BTreeSet::new(),
            filter: None,
            filter_text: String::new(),
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
            widgets: BTreeMap::new(),
            coloring: None,
            palettes: Vec::new(),
            message: None,
            next_station: 0,
            placed: None,
            area: ImageArea::WHOLE,
            now: 0.0,
        }
    }

    /// Begins otherwise than with all of the site in its recorded colours.
    pub fn begin(&mut self, start: Start) {
        let Start { camera, mode, scans, filter } = start;
        if let Some(camera) = camera {
            self.nav.rig.place(&camera);
            // As if somebody had moved it there.
            self.placed = Some(Rig::default());
        }
        self.mode = mode.unwrap_or(self.mode);
        self.scans = scans;
        self.filter_text = filter.as_ref().map(Filter::to_string).unwrap_or_default();
        self.filter = filter;
    }

    /// What there is to remember now.
    pub fn remembered(&self) -> Remembered {
        let open = self.open.iter().map(|s| s.word().to_owned()).collect();
        Remembered { open, ..self.set.clone() }
    }

    /// A newer generation is known. The first one with points is shown whole.
    pub fn set_site(&mut self, site: Site, aspect: f64) {
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
        if self.placed.is_none() {
            self.place(aspect);
        }
    }

    /// Panels leave this part of the picture free.
    pub fn set_free_area(&mut self, area: ImageArea, aspect: f64) {
        self.area = area;
        self.place(aspect);
    }

    /// Shows everything for as long as nobody has moved the camera.
    fn place(&mut self, aspect: f64) {
        let untouched = self.placed.as_ref().is_none_or(|placed| *placed == self.nav.rig);
        let places = self.places();
        if !untouched || places.is_empty() {
            return;
        }
        if self.placed.is_none()
            && let Ok(camera) = Camera::seeing(&places, size_of_aspect(aspect))
        {
            self.nav.rig.place(&camera);
            self.nav.rig.set_fov_y_deg(self.set.fov_y_deg);
        }
        self.nav.rig.place_to_fit(&places, self.onto(aspect));
        self.placed = Some(self.nav.rig.clone());
    }

    fn onto(&self, aspect: f64) -> Onto {
        Onto { aspect, area: self.area }
    }

    /// Where the points of the scans that are seen are: corners of boxes around them.
    fn places(&self) -> Vec<DVec3> {
        let (Some(site), Some(bounds)) = (&self.site, self.seen_bounds()) else { return Vec::new() };
        let common =
            |b: &WorldBox| WorldBox::new(b.min().max(bounds.min()).to_array(), b.max().min(bounds.max()).to_array());
        let places: Vec<DVec3> = site.outline.iter().filter_map(common).flat_map(|b| b.corners()).collect();
        if places.is_empty() { bounds.corners().to_vec() } else { places }
    }

    /// Goes to where everything is seen.
    pub fn fit(&mut self, aspect: f64) {
        self.nav.rig.fit(&self.places(), self.onto(aspect));
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

    /// The bounds of the scans that are seen.
    pub fn seen_bounds(&self) -> Option<WorldBox> {
        let site = self.site.as_ref()?;
        let seen = site.scans.iter().filter(|s| self.scans.sees(s.id, s.visible)).filter_map(|s| s.bounds);
        let join = |a: WorldBox, b: WorldBox| {
            WorldBox::new(a.min().min(b.min()).to_array(), a.max().max(b.max()).to_array()).unwrap_or(a)
        };
        seen.reduce(join).or(site.bounds)
    }

    /// A box around what is looked at.
    pub fn add_clip(&mut self, aspect: f64) {
        if self.clips.len() >= MAX_CLIPS {
            return self.tell(format!("There are {MAX_CLIPS} boxes already, the most that there can be"));
        }
        let rig = &self.nav.rig;
        let middle = match &self.picked {
            Some(found) => found.world,
            None => rig.looked_at(self.onto(aspect)),
        };
        let half = DVec3::splat((rig.distance() * 0.25).max(1e-6));
        let mut clip = Clip { min: (middle - half).to_array(), max: (middle + half).to_array(), keep: true, on: true };
        clip.round(self.decimals());
        self.clips.push(clip);
    }

    /// Digits behind the point that coordinates of the store have.
    pub fn decimals(&self) -> usize {
        let quantum = self.site.as_ref().map(|site| site.lattice.quantum());
        let digits = quantum.into_iter().flatten().map(|step| (-step.exponent()).clamp(0, 9) as usize);
        digits.max().unwrap_or(3)
    }

    /// A coordinate with these digits.
    pub fn coordinate(&self, value: f64) -> String {
        format!("{value:.*}", self.decimals())
    }
}

fn size_of_aspect(aspect: f64) -> [u32; 2] {
    let height = 720.0;
    [(height * aspect.clamp(0.05, 20.0)).round() as u32, height as u32]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Projection;
    use crate::lattice::Lattice;
    use crate::points::Batch;
    use crate::render::ColorDepths;
    use crate::viewer::bindings::{Command, Key};
    use crate::viewer::navigate::Click;
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
            outline: Vec::new(),
            points: 20,
            attributes: vec!["Classification".into()],
            unit: "m".into(),
            bookmarks: Vec::new(),
            sample: Batch::empty(Vec::new().into()),
            depths: ColorDepths::default(),
        }
    }

    fn model() -> Model {
        let mut model = Model::new(Remembered::default());
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
    fn a_view_may_begin_where_it_was_asked_to() {
        let (eye, target) = (DVec3::new(3.0, 4.0, 50.0), DVec3::new(20.0, 30.0, 5.0));
        let projection = Projection::Perspective { fov_y_rad: 0.5 };
        let seen = Camera::new(eye, target, DVec3::Z, projection, [300, 200]).unwrap();
        let filter = Filter::parse("Intensity > 5").unwrap();
        let mut model = Model::new(Remembered::default());
        let mut scans = ScanChoice::default();
        scans.set(1, true, false);
        model.begin(Start { camera: Some(seen.clone()), mode: Some(ColorMode::Height), scans, filter: Some(filter) });
        model.set_site(site(1, &["north", "roof"]), 1.5);
        model.set_free_area(ImageArea::new([0.0; 2], [0.7, 1.0]), 1.5);
        let there = model.nav.rig.camera(seen.size_px()).unwrap();
        assert!((there.eye() - seen.eye()).length() < 1e-9 && (there.forward() - seen.forward()).length() < 1e-9);
        assert_eq!(model.remembered().fov_y_deg, Remembered::default().fov_y_deg, "a view's angle is not a setting");
        let shown = model.shown().unwrap();
        assert_eq!((shown.filter.unwrap().to_string(), shown.scans.sees(1, true)), ("Intensity > 5".into(), false));
        model.classes_off.insert(7);
        let both = "(Intensity > 5) and (Classification is null or not (Classification in (7)))";
        assert_eq!(model.shown_filter().unwrap().to_string(), both);
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
        // One that is there is not lost.
        let camera = model.nav.rig.camera([300, 200]).unwrap();
        if let Some(site) = &mut model.site {
            site.bookmarks.push(("door".into(), camera));
        }
        model.bookmark_name = "door".into();
        model.command(Command::Bookmark, 1.5);
        assert_eq!(model.actions.len(), 2);
        assert!(model.message().unwrap().contains("'door' already"));
        model.bookmark_name.clear();
        assert!(model.bookmark_name.is_empty());
    }

    #[test]
    fn clicks_measure_pick_and_go() {
        let mut model = model();
        model.click(Click::Single, 1.5);
        assert_eq!(model.picked, None, "nothing was under the pointer");
        let found = Found { world: DVec3::new(12.0, 3.0, 1.0), values: Vec::new() };
        model.hover = Some(found.clone());
        model.click(Click::Single, 1.5);
        assert_eq!((model.picked.as_ref(), model.measured.points().len()), (Some(&found), 0));
        model.key(Key::M, true, 1.5);
        model.click(Click::Single, 1.5);
        model.click(Click::Single, 1.5);
        model.key(Key::Backspace, true, 1.5);
        assert_eq!(model.measured.points().len(), 1);
        model.key(Key::Escape, true, 1.5);
        model.key(Key::Escape, true, 1.5);
        assert!(!model.measuring && !model.help);
        model.click(Click::Double, 1.5);
        while model.advance(0.1) {}
        let (to, forward) = (found.world - model.nav.rig.eye(), model.nav.rig.forward());
        assert!(to.normalize().dot(forward) > 0.999_999, "what was double-clicked is in the middle");
    }

    #[test]
    fn a_box_lies_where_the_panels_leave_the_picture_free_in_whole_steps() {
        let mut model = model();
        model.set_free_area(ImageArea::new([0.0, 0.1], [0.6, 1.0]), 1.5);
        model.key(Key::Digit(1), true, 1.5);
        while model.advance(0.1) {}
        model.add_clip(1.5);
        let clip = model.clips[0].bounds().unwrap();
        let site = model.seen_bounds().unwrap().center();
        let off = (clip.center() - site).truncate().length();
        assert!(off < 0.05 * clip.extent().x, "{off}: the site is fitted into the free part");
        for value in model.clips[0].min.iter().chain(&model.clips[0].max) {
            assert_eq!(model.coordinate(*value).parse::<f64>().unwrap(), *value);
        }
        model.key(Key::G, true, 1.5);
        assert!(model.nav.rig.forward().z.abs() < 1e-9, "who walks looks ahead");
    }

    #[test]
    fn boxes_are_drawn_when_they_have_a_volume() {
        let mut model = model();
        for _ in 0..MAX_CLIPS + 2 {
            model.add_clip(1.5);
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
        // It leaned by a degree, and so did every house in the plan.
        assert_eq!(camera.forward(), -DVec3::Z);
        assert_eq!(
            (Rig::of(&camera).forward(), Rig::of(&camera).camera([300, 200]).unwrap().up()),
            (-DVec3::Z, camera.up())
        );
        let middle = model.seen_bounds().unwrap().center();
        let px = |p: DVec3| camera.pixel_from_relative(p - camera.eye()).unwrap();
        let (center, north) = (px(middle), px(middle + DVec3::Y));
        assert!(north[1] < center[1] - 1.0 && (north[0] - center[0]).abs() < 0.1, "{center:?} {north:?}");
        model.key(Key::L, true, 1.5);
        while model.advance(0.1) {}
        assert_eq!(model.nav.rig.eye(), DVec3::new(5.0, 5.0, 1.0), "at the scanner");
    }
}

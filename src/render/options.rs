//! How a scene is to look.

use super::{ClipBox, MAX_CLIPS, RenderError};
use std::str::FromStr;

/// What is where no point is: sRGB-coded bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Background {
    /// One colour; an alpha below 255 makes the picture transparent there.
    Plain([u8; 4]),
    /// From the top row to the bottom row, in equal steps of the coded values.
    Gradient {
        /// At the top edge.
        top: [u8; 4],
        /// At the bottom edge.
        bottom: [u8; 4],
    },
}

impl Default for Background {
    /// A slate gradient, darker at the top: points of any colour, black and white included, stand out from it.
    fn default() -> Self {
        Self::Gradient { top: [30, 35, 44, 255], bottom: [104, 114, 128, 255] }
    }
}

impl Background {
    /// Colours at the top and the bottom edge, 0 to 1.
    pub(super) fn ends(self) -> [[f32; 4]; 2] {
        let (top, bottom) = match self {
            Self::Plain(color) => (color, color),
            Self::Gradient { top, bottom } => (top, bottom),
        };
        [top, bottom].map(|color| color.map(|byte| f32::from(byte) / 255.0))
    }
}

/// Eye-dome lighting: shading from depth alone, which shows shape where points have no normals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edl {
    /// How strong; 1 is a good default.
    pub strength: f32,
    /// How far away the neighbours are that a pixel is compared with, in pixels; further for splats that are larger.
    pub radius_px: f32,
}

impl Default for Edl {
    fn default() -> Self {
        Self { strength: 1.0, radius_px: 1.4 }
    }
}

/// The outline and the relief of a splat.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Shape {
    /// A disc that faces the eye, all of it at the point's depth.
    #[default]
    Round,
    /// A square around that disc.
    Square,
    /// The disc bent away from the eye towards its rim, by its radius: where splats overlap the nearer centre wins, so
    /// that each point has the pixels around it (Schütz and Wimmer, 2015).
    Paraboloid,
}

impl Shape {
    /// All shapes.
    pub const ALL: [Self; 3] = [Self::Round, Self::Square, Self::Paraboloid];

    /// The word on the command line.
    pub fn word(self) -> &'static str {
        match self {
            Self::Round => "round",
            Self::Square => "square",
            Self::Paraboloid => "paraboloid",
        }
    }
}

impl FromStr for Shape {
    type Err = RenderError;

    fn from_str(word: &str) -> Result<Self, RenderError> {
        let folded = word.to_ascii_lowercase();
        Self::ALL.into_iter().find(|s| s.word() == folded).ok_or_else(|| RenderError::UnknownShape(word.into()))
    }
}

/// Haze: colours go over to another with the depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fog {
    /// To which, sRGB-coded; `None`: the background behind the pixel.
    pub color: Option<[u8; 3]>,
    /// Up to this depth, in CRS units, there is none.
    pub start: f64,
    /// Over this length, in CRS units, the rest of the point's colour is halved.
    pub half: f64,
}

/// How a scene is drawn; the image's size is the camera's.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderOptions {
    /// What is where no point is.
    pub background: Background,
    /// What a point looks like.
    pub shape: Shape,
    /// A splat's radius relative to its node's spacing. Points on a square grid leave no hole from 0.71 up.
    pub radius_factor: f64,
    /// The least radius of a splat, in pixels; not below 0.5, a diameter of one pixel.
    pub min_radius_px: f64,
    /// The greatest radius of a splat, relative to the height of the image: a point right before the eye does not hide
    /// all others.
    pub max_radius_of_height: f64,
    /// Neither above this, in pixels; infinite: only the image says.
    pub max_radius_px: f64,
    /// Shading; `None` shows the colours as they are.
    pub edl: Option<Edl>,
    /// Haze; `None`: the air is clear.
    pub fog: Option<Fog>,
    /// Point shadows: each point has a black disc behind it that is so many pixels wider all round, four of its radii
    /// behind (after Lenertz 2014, 2.5.1). So surfaces stay as they are up to 76 degrees from their normal, and what stands
    /// before another is outlined. 0: none.
    pub shadow_px: f64,
    /// What is drawn: the points inside any of the boxes to keep, if there are any, and in none of those to cut out. At
    /// most [`MAX_CLIPS`].
    pub clips: Vec<ClipBox>,
    /// Draw the cubes of the nodes, too: to see what a selection is made of.
    pub node_boxes: bool,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            background: Background::default(),
            shape: Shape::default(),
            radius_factor: 0.75,
            min_radius_px: 0.5,
            max_radius_of_height: 0.05,
            max_radius_px: f64::INFINITY,
            edl: Some(Edl::default()),
            fog: None,
            shadow_px: 0.0,
            clips: Vec::new(),
            node_boxes: false,
        }
    }
}

impl RenderOptions {
    /// # Errors
    ///
    /// [`RenderError::Number`] for what is not a number, negative or absurdly large.
    pub(super) fn check(&self) -> Result<(), RenderError> {
        if self.clips.len() > MAX_CLIPS {
            return Err(RenderError::TooManyClips { count: self.clips.len() });
        }
        let edl = self.edl.unwrap_or_default();
        let fog = self.fog.unwrap_or(Fog { color: None, start: 0.0, half: 1.0 });
        let numbers = [
            ("the splats' radius factor", self.radius_factor, 0.0, 1e6, "from 0 to 1e6"),
            ("the least radius of a splat", self.min_radius_px, 0.5, 1e4, "from 0.5 to 1e4 pixels"),
            ("the greatest radius of a splat", self.max_radius_of_height, 0.0, 1.0, "from 0 to 1 image heights"),
            ("the greatest radius of a splat", self.max_radius_px, 0.5, f64::INFINITY, "from 0.5 pixels"),
            ("the strength of eye-dome lighting", f64::from(edl.strength), 0.0, 1e6, "from 0 to 1e6"),
            ("the radius of eye-dome lighting", f64::from(edl.radius_px), 1.0, 1e3, "from 1 to 1000 pixels"),
            ("the start of the fog", fog.start, 0.0, 1e15, "from 0 to 1e15"),
            ("the half depth of the fog", fog.half, 1e-12, 1e15, "from 1e-12 to 1e15"),
            ("the width of point shadows", self.shadow_px, 0.0, 100.0, "from 0 to 100 pixels"),
        ];
        for (name, value, least, greatest, expected) in numbers {
            if !(least..=greatest).contains(&value) {
                return Err(RenderError::Number { name, value, expected });
            }
        }
        Ok(())
    }
}

//! What colour shows.

use crate::render::RenderError;
use std::collections::BTreeMap;
use std::str::FromStr;

/// What colour shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ColorMode {
    /// The recorded colours; where there are none at all, intensity or else height.
    #[default]
    Rgb,
    /// Grey by intensity.
    Intensity,
    /// A ramp over z, dark blue to yellow.
    Height,
    /// The classes of ASPRS, each in its usual colour.
    Class,
    /// First, second, third ... return.
    Return,
    /// A colour for each scan.
    Scan,
    /// A colour for each level of the octree: what a selection is made of.
    Level,
    /// A ramp over GPS time.
    Time,
}

impl ColorMode {
    /// All modes.
    pub const ALL: [Self; 8] =
        [Self::Rgb, Self::Intensity, Self::Height, Self::Class, Self::Return, Self::Scan, Self::Level, Self::Time];

    /// The word on the command line.
    pub fn word(self) -> &'static str {
        match self {
            Self::Rgb => "rgb",
            Self::Intensity => "intensity",
            Self::Height => "height",
            Self::Class => "class",
            Self::Return => "return",
            Self::Scan => "scan",
            Self::Level => "level",
            Self::Time => "time",
        }
    }

    /// All words, for messages.
    pub fn words() -> String {
        Self::ALL.map(Self::word).join(", ")
    }

    /// The attributes that the mode shows.
    pub fn attributes(self) -> &'static [&'static str] {
        match self {
            Self::Rgb => &["Red", "Green", "Blue"],
            Self::Intensity => &["Intensity"],
            Self::Class => &["Classification"],
            Self::Return => &["ReturnNumber"],
            Self::Time => &["GpsTime"],
            Self::Height | Self::Scan | Self::Level => &[],
        }
    }

    /// Are values places on a ramp, which has a range?
    pub fn has_range(self) -> bool {
        matches!(self, Self::Intensity | Self::Height | Self::Time)
    }

    /// Are the attributes of the mode there?
    pub fn is_available(self, has: impl Fn(&str) -> bool) -> bool {
        self.attributes().iter().all(|name| has(name))
    }

    /// Does an attribute show anything, if those in `flat` have one value everywhere? Some files have room for colours, or
    /// intensities, and none in it: points of one grey would show nothing.
    pub fn shows(name: &str, flat: &BTreeMap<String, f64>) -> bool {
        let colors = Self::Rgb.attributes();
        let black = || colors.iter().all(|color| flat.get(*color) == Some(&0.0));
        if colors.contains(&name) { !black() } else { name != "Intensity" || !flat.contains_key(name) }
    }

    /// The mode itself if its attributes are there; for [`ColorMode::Rgb`] else intensity, else height.
    ///
    /// # Errors
    ///
    /// [`RenderError::NoAttribute`] if another mode lacks its attribute.
    pub fn resolved(self, has: impl Fn(&str) -> bool) -> Result<Self, RenderError> {
        if self.is_available(&has) {
            return Ok(self);
        }
        match self {
            Self::Rgb if Self::Intensity.is_available(&has) => Ok(Self::Intensity),
            Self::Rgb => Ok(Self::Height),
            _ => {
                let attribute = self.attributes().iter().find(|name| !has(name)).copied().unwrap_or_default();
                Err(RenderError::NoAttribute { mode: self.word(), attribute })
            }
        }
    }
}

impl FromStr for ColorMode {
    type Err = RenderError;

    fn from_str(word: &str) -> Result<Self, RenderError> {
        let folded = word.to_ascii_lowercase();
        Self::ALL.into_iter().find(|mode| mode.word() == folded).ok_or_else(|| RenderError::UnknownColor(word.into()))
    }
}

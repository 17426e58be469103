//! The sections of the panel.

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

//! What colours mean, as data: a viewer shows it, `esker render` writes it into the picture.

/// The key to a picture's colours.
#[derive(Clone, Debug, PartialEq)]
pub struct Legend {
    /// What is shown.
    pub title: String,
    /// Its colours.
    pub key: LegendKey,
}

/// The colours of a legend.
#[derive(Clone, Debug, PartialEq)]
pub enum LegendKey {
    /// Colours are as recorded: there is nothing to explain.
    Recorded,
    /// A continuous range.
    Ramp {
        /// From the low end to the high end, in equal steps.
        colors: Vec<[u8; 4]>,
        /// The number at the low end.
        low: f64,
        /// The number at the high end.
        high: f64,
    },
    /// Single values.
    Entries(Vec<LegendEntry>),
}

/// A value with its colour.
#[derive(Clone, Debug, PartialEq)]
pub struct LegendEntry {
    /// The class, the scan's number, ...: the place in the palette.
    pub number: u32,
    /// What it is called.
    pub name: String,
    /// How it is shown.
    pub color: [u8; 4],
}

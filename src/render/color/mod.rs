//! From columns to colours: what a point's values look like, as sRGB-coded bytes.

mod palette;
mod stretch;

use super::RenderError;
use crate::lattice::Lattice;
use crate::points::{Batch, Column};
use std::collections::BTreeMap;
use std::str::FromStr;
use stretch::Stretch;

/// Mid-grey, for points that lack what others of the picture show.
const NOTHING: [u8; 4] = [150, 150, 150, 255];

/// What colour shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
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
}

impl ColorMode {
    /// All modes.
    pub const ALL: [Self; 6] = [Self::Rgb, Self::Intensity, Self::Height, Self::Class, Self::Return, Self::Scan];

    /// The word on the command line.
    pub fn word(self) -> &'static str {
        match self {
            Self::Rgb => "rgb",
            Self::Intensity => "intensity",
            Self::Height => "height",
            Self::Class => "class",
            Self::Return => "return",
            Self::Scan => "scan",
        }
    }

    /// The attributes that the mode reads; for [`ColorMode::Scan`] the scan ids are needed instead.
    pub fn attributes(self) -> &'static [&'static str] {
        match self {
            Self::Rgb => &["Red", "Green", "Blue"],
            Self::Intensity => &["Intensity"],
            Self::Class => &["Classification"],
            Self::Return => &["ReturnNumber"],
            Self::Height | Self::Scan => &[],
        }
    }

    /// Are the attributes of the mode there?
    pub fn is_available(self, has: impl Fn(&str) -> bool) -> bool {
        self.attributes().iter().all(|name| has(name))
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

/// How many bits the colours of a scan have: 8 (0 to 255, whatever the column's type) or 16.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ColorDepths {
    /// For scans that aren't listed, and for points whose scan isn't known; `None`: without colours.
    pub others: Option<u8>,
    /// By scan; `None`: without colours.
    pub by_scan: BTreeMap<u32, Option<u8>>,
}

impl Default for ColorDepths {
    fn default() -> Self {
        Self { others: Some(16), by_scan: BTreeMap::new() }
    }
}

impl ColorDepths {
    fn of(&self, scan: Option<u32>) -> Option<u8> {
        scan.and_then(|scan| self.by_scan.get(&scan).copied()).unwrap_or(self.others)
    }
}

/// How points are coloured.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ColorOptions {
    /// What colour shows.
    pub mode: ColorMode,
    /// How to read recorded colours.
    pub depths: ColorDepths,
    /// The z at the two ends of the height ramp, in CRS units; `None`: the 1st and the 99th percentile of the points.
    pub height_range: Option<[f64; 2]>,
    /// The intensities shown darkest and lightest; `None`: the 1st and the 99th percentile of the points.
    pub intensity_range: Option<[f64; 2]>,
}

/// Colours, and the mode that they show after all.
#[derive(Clone, Debug, PartialEq)]
pub struct Colored {
    /// The mode asked for, or what [`ColorMode::resolved`] put in its place.
    pub mode: ColorMode,
    /// Per batch, per point.
    pub colors: Vec<Vec<[u8; 4]>>,
}

/// The colours of the points of all `batches` of one picture: ranges are found over all of them, so that the same value
/// has the same colour everywhere.
///
/// Points of scans without colours are shown by intensity, or in grey, beside coloured ones.
///
/// # Errors
///
/// [`RenderError::NoAttribute`] if the mode shows an attribute that no batch has (the recorded colours excepted).
pub fn colors(batches: &[&Batch], lattice: &Lattice, options: &ColorOptions) -> Result<Colored, RenderError> {
    let has = |name: &str| {
        let usable = |column: &Column| name == "Intensity" || matches!(column, Column::U8(_) | Column::U16(_));
        batches.iter().any(|batch| batch.column(name).is_some_and(usable))
    };
    let mode = if batches.iter().all(|b| b.is_empty()) { options.mode } else { options.mode.resolved(has)? };
    let colors = match mode {
        ColorMode::Rgb => {
            let grey = has("Intensity").then(|| intensity_stretch(batches, options));
            each(batches, |batch| rgb(batch, &options.depths, grey.as_ref()))
        }
        ColorMode::Intensity => {
            let stretch = intensity_stretch(batches, options);
            each(batches, |batch| greys(batch, &stretch))
        }
        ColorMode::Height => {
            let heights = batches.iter().map(|b| (b.len(), |i: usize| lattice.world_on_axis(2, b.positions.z[i])));
            let stretch = Stretch::new(options.height_range, heights);
            each(batches, |batch| {
                batch.positions.z.iter().map(|&z| palette::ramp(stretch.place(lattice.world_on_axis(2, z)))).collect()
            })
        }
        ColorMode::Class => each(batches, |batch| by_column(batch, "Classification", palette::class)),
        ColorMode::Return => each(batches, |batch| by_column(batch, "ReturnNumber", palette::category)),
        ColorMode::Scan => each(batches, |batch| {
            (0..batch.len()).map(|i| batch.scans.get(i).map_or(NOTHING, |&scan| palette::category(scan))).collect()
        }),
    };
    Ok(Colored { mode, colors })
}

fn each(batches: &[&Batch], color: impl Fn(&Batch) -> Vec<[u8; 4]>) -> Vec<Vec<[u8; 4]>> {
    batches.iter().map(|batch| color(batch)).collect()
}

fn intensity_stretch(batches: &[&Batch], options: &ColorOptions) -> Stretch {
    let columns = batches.iter().filter_map(|batch| batch.column("Intensity"));
    Stretch::new(options.intensity_range, columns.map(|column| (column.len(), |i| column.as_f64(i))))
}

fn greys(batch: &Batch, stretch: &Stretch) -> Vec<[u8; 4]> {
    match batch.column("Intensity") {
        Some(column) => (0..batch.len()).map(|i| palette::grey(stretch.place(column.as_f64(i)))).collect(),
        None => vec![NOTHING; batch.len()],
    }
}

fn by_column(batch: &Batch, name: &str, color: impl Fn(u32) -> [u8; 4]) -> Vec<[u8; 4]> {
    match batch.column(name) {
        Some(Column::U8(values)) => values.iter().map(|&v| color(v.into())).collect(),
        Some(Column::U16(values)) => values.iter().map(|&v| color(v.into())).collect(),
        _ => vec![NOTHING; batch.len()],
    }
}

fn rgb(batch: &Batch, depths: &ColorDepths, grey: Option<&Stretch>) -> Vec<[u8; 4]> {
    let channels = ["Red", "Green", "Blue"].map(|name| batch.column(name));
    let [Some(red), Some(green), Some(blue)] = channels else {
        return grey.map_or_else(|| vec![NOTHING; batch.len()], |stretch| greys(batch, stretch));
    };
    let intensity = grey.zip(batch.column("Intensity"));
    (0..batch.len())
        .map(|i| match depths.of(batch.scans.get(i).copied()) {
            Some(depth) => [byte(red, i, depth), byte(green, i, depth), byte(blue, i, depth), 255],
            None => intensity.map_or(NOTHING, |(stretch, column)| palette::grey(stretch.place(column.as_f64(i)))),
        })
        .collect()
}

/// The high byte of 16 bits, so that both ways to widen a byte, times 256 and times 257, give the byte back.
fn byte(column: &Column, i: usize, depth: u8) -> u8 {
    match column {
        Column::U8(values) => values[i],
        Column::U16(values) if depth <= 8 => values[i].min(255) as u8,
        Column::U16(values) => (values[i] >> 8) as u8,
        _ => NOTHING[0],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::LatticePoint;
    use crate::points::{Attribute, Positions, ScalarType};

    fn batch(columns: Vec<(&str, ScalarType, Column)>, scans: Vec<u32>, z: Vec<u64>) -> Batch {
        let attributes: Vec<_> = columns.iter().map(|(name, ty, _)| Attribute::new(*name, *ty)).collect();
        let positions: Positions = z.iter().map(|&z| LatticePoint([0, 0, z])).collect();
        let columns = columns.into_iter().map(|(_, _, column)| column).collect();
        Batch { attributes: attributes.into(), positions, scans, columns }
    }

    fn rgb_columns(values: &[u16]) -> Vec<(&'static str, ScalarType, Column)> {
        ["Red", "Green", "Blue"].map(|name| (name, ScalarType::U16, Column::U16(values.to_vec()))).into()
    }

    fn colored(batch: &Batch, options: &ColorOptions) -> Vec<[u8; 4]> {
        colors(&[batch], &Lattice::uniform(0.01).unwrap(), options).unwrap().colors.remove(0)
    }

    #[test]
    fn sixteen_bits_give_back_the_byte_they_were_widened_from() {
        for value in 0..=255 {
            let batch = batch(rgb_columns(&[value * 256, value * 257]), vec![], vec![0, 0]);
            let expected = [value as u8, value as u8, value as u8, 255];
            assert_eq!(colored(&batch, &ColorOptions::default()), [expected, expected]);
        }
    }

    #[test]
    fn each_scan_is_read_in_its_own_depth_and_one_without_colours_is_grey() {
        let mut columns = rgb_columns(&[200, 200 << 8, 0]);
        columns.push(("Intensity", ScalarType::U16, Column::U16(vec![0, 50, 100])));
        let batch = batch(columns, vec![1, 2, 3], vec![0; 3]);
        let by_scan = [(1, Some(8)), (2, Some(16)), (3, None)].into();
        let options = ColorOptions {
            depths: ColorDepths { others: Some(16), by_scan },
            intensity_range: Some([0.0, 100.0]),
            ..Default::default()
        };
        assert_eq!(colored(&batch, &options), [[200, 200, 200, 255], [200, 200, 200, 255], [255, 255, 255, 255]]);
    }

    #[test]
    fn without_colours_intensity_is_shown_and_without_intensity_height() {
        let lattice = Lattice::uniform(0.01).unwrap();
        let grey = batch(vec![("Intensity", ScalarType::U16, Column::U16(vec![10, 20]))], vec![], vec![1, 2]);
        let shown = colors(&[&grey], &lattice, &ColorOptions::default()).unwrap();
        assert_eq!(shown.mode, ColorMode::Intensity);
        assert!(shown.colors[0][0] < shown.colors[0][1]);
        let bare = batch(vec![], vec![], vec![1, 2]);
        assert_eq!(colors(&[&bare], &lattice, &ColorOptions::default()).unwrap().mode, ColorMode::Height);
        let class = ColorOptions { mode: ColorMode::Class, ..Default::default() };
        let refused = colors(&[&bare], &lattice, &class);
        assert!(matches!(refused, Err(RenderError::NoAttribute { attribute: "Classification", .. })));
    }

    #[test]
    fn ranges_are_found_over_all_batches() {
        let lattice = Lattice::uniform(0.01).unwrap();
        let low = batch(vec![], vec![], (0..100).collect());
        let high = batch(vec![], vec![], (900..1000).collect());
        let options = ColorOptions { mode: ColorMode::Height, ..Default::default() };
        let shown = colors(&[&low, &high], &lattice, &options).unwrap().colors;
        assert_eq!((shown[0][0], shown[1][99]), (palette::ramp(0.0), palette::ramp(1.0)));
    }

    #[test]
    fn words_and_modes_correspond() {
        for mode in ColorMode::ALL {
            assert_eq!(mode.word().parse::<ColorMode>().unwrap(), mode);
        }
        assert!("colour".parse::<ColorMode>().unwrap_err().to_string().contains("\"colour\""));
    }

    #[test]
    fn no_value_of_any_type_is_beyond_the_colours() {
        let values = vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -0.0];
        let odd =
            batch(vec![("Intensity", ScalarType::F64, Column::F64(values))], vec![], vec![0, 1, 2, 3, u64::MAX >> 16]);
        assert_eq!(colored(&odd, &ColorOptions { mode: ColorMode::Intensity, ..Default::default() }).len(), 5);
        let class =
            batch(vec![("Classification", ScalarType::U8, Column::U8((0..=255).collect()))], vec![], vec![0; 256]);
        let shown = colored(&class, &ColorOptions { mode: ColorMode::Class, ..Default::default() });
        assert_ne!(shown[2], shown[6]);
        assert_eq!(shown.len(), 256);
    }
}

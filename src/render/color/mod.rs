//! From columns to colours: what a point's values look like, as sRGB-coded bytes.

mod coloring;
mod legend;
mod mode;
mod palette;
mod stretch;
mod tables;

use super::RenderError;
use crate::lattice::Lattice;
use crate::points::Batch;
use crate::stream::gpu::Paint;
pub use coloring::{ColorOptions, Coloring, ValuePaint};
pub use legend::{Legend, LegendEntry, LegendKey};
pub use mode::ColorMode;
pub use palette::{NO_VALUE, Palette};
use std::collections::BTreeMap;

/// Mid-grey, for points that lack what others of the picture show.
const NOTHING: [u8; 4] = [150, 150, 150, 255];

/// How many bits the colours of a scan have: 8 (0 to 255, whatever the column's type) or 16.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
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
    /// The depths of these scans; those of scans that aren't listed are the same if these all agree.
    pub fn of_scans(scans: impl IntoIterator<Item = (u32, Option<u8>)>) -> Self {
        let by_scan: BTreeMap<u32, Option<u8>> = scans.into_iter().collect();
        let mut depths = by_scan.values().copied();
        let first = depths.next().unwrap_or(Some(16));
        let others = if depths.all(|depth| depth == first) { first } else { Some(16) };
        Self { others, by_scan }
    }

    fn of(&self, scan: Option<u32>) -> Option<u8> {
        scan.and_then(|scan| self.by_scan.get(&scan).copied()).unwrap_or(self.others)
    }
}

/// The colour of a level of the octree, 0 being the root's.
pub(super) fn level_color(level: u32) -> [u8; 4] {
    tables::category(level)
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
/// has the same colour everywhere. By level all points have the root's colour: batches don't know their nodes.
///
/// Points of scans without colours are shown by intensity, or in grey, beside coloured ones.
///
/// # Errors
///
/// [`RenderError::NoAttribute`] if the mode shows an attribute that no batch has (the recorded colours excepted).
pub fn colors(batches: &[&Batch], lattice: &Lattice, options: &ColorOptions) -> Result<Colored, RenderError> {
    let coloring = Coloring::new(batches, lattice, options)?;
    let mut values = Vec::new();
    let mut colors_of = |batch: &&Batch| {
        values.clear();
        coloring.paint.paint(batch, lattice, &mut values);
        values.iter().map(|&value| coloring.palette.color(value, 0)).collect()
    };
    Ok(Colored { mode: coloring.mode, colors: batches.iter().map(&mut colors_of).collect() })
}

#[cfg(test)]
mod tests {
    use super::tables;
    use super::*;
    use crate::lattice::LatticePoint;
    use crate::points::Column;
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
        let options = ColorOptions { depths: ColorDepths { others: Some(16), by_scan }, ..Default::default() };
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
        assert_eq!((shown[0][0], shown[1][99]), (tables::ramp(0.0), tables::ramp(1.0)));
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

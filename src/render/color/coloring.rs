//! From columns to the values of packed points, and the palette and legend that go with them.

use super::legend::{Legend, LegendEntry, LegendKey};
use super::palette::{NO_VALUE, Palette, ramp_value};
use super::stretch::Stretch;
use super::{ColorDepths, ColorMode, NOTHING, tables};
use crate::lattice::Lattice;
use crate::points::{Batch, Column};
use crate::render::RenderError;
use crate::stream::gpu::Paint;
use std::collections::{BTreeMap, BTreeSet};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

/// How points are coloured.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ColorOptions {
    /// What colour shows.
    pub mode: ColorMode,
    /// How to read recorded colours.
    pub depths: ColorDepths,
    /// The numbers at the two ends of a ramp: of height in CRS units, of intensity, of GPS time; `None`: the 1st and the
    /// 99th percentile of the sample.
    pub range: Option<[f64; 2]>,
    /// What scans are called in the legend.
    pub scan_names: BTreeMap<u32, String>,
    /// How many levels the legend lists; `None`: the first twelve.
    pub levels: Option<u32>,
}

/// How the points of a site are coloured: what their values are, what colours these have, and what that means.
///
/// It is made from a sample of the site, such as the points of the root node, so that the same value has the same colour
/// in every picture, however little of the site that shows.
#[derive(Clone, Debug)]
pub struct Coloring {
    /// The mode asked for, or what [`ColorMode::resolved`] put in its place.
    pub mode: ColorMode,
    /// Makes values from batches.
    pub paint: Arc<ValuePaint>,
    /// Makes colours from values.
    pub palette: Palette,
    /// Explains the colours.
    pub legend: Legend,
}

/// Gives each point its value, for [`Palette::color`] or the passes.
#[derive(Clone, Debug)]
pub struct ValuePaint {
    mode: ColorMode,
    depths: ColorDepths,
    /// Values of a ramp are relative to this, so that `f32` resolves them.
    origin: f64,
    /// Shows points without recorded colours among those with them.
    greys: Option<Stretch>,
}

/// The most entries of a table by scan.
const MAX_SCANS: u32 = 1 << 16;

impl Coloring {
    /// The colouring that fits a sample.
    ///
    /// # Errors
    ///
    /// [`RenderError::NoAttribute`] if the mode shows an attribute that no batch has (the recorded colours excepted).
    pub fn new(sample: &[&Batch], lattice: &Lattice, options: &ColorOptions) -> Result<Self, RenderError> {
        let has = |name: &str| {
            let usable = |column: &Column| match name {
                "Red" | "Green" | "Blue" => matches!(column, Column::U8(_) | Column::U16(_)),
                _ => true,
            };
            sample.iter().any(|batch| batch.column(name).is_some_and(usable))
        };
        let mode = if sample.iter().all(|b| b.is_empty()) { options.mode } else { options.mode.resolved(has)? };
        let stretch = |range, name: &str| {
            let columns = sample.iter().filter_map(|batch| batch.column(name));
            Stretch::new(range, columns.map(|column| (column.len(), |i| column.as_f64(i))))
        };
        let range = match mode {
            ColorMode::Intensity => stretch(options.range, "Intensity").ends(),
            ColorMode::Time => stretch(options.range, "GpsTime").ends(),
            ColorMode::Height => {
                let heights = sample.iter().map(|b| (b.len(), |i: usize| lattice.world_on_axis(2, b.positions.z[i])));
                Stretch::new(options.range, heights).ends()
            }
            _ => [0.0; 2],
        };
        let depths = &options.depths;
        let uncolored = depths.others.is_none() || depths.by_scan.values().any(Option::is_none);
        let greys = (mode == ColorMode::Rgb && uncolored && has("Intensity")).then(|| stretch(None, "Intensity"));
        let paint = ValuePaint { mode, depths: options.depths.clone(), origin: range[0], greys };
        let (palette, legend) = paint.palette_of(sample, lattice, range, options);
        Ok(Self { mode, paint: Arc::new(paint), palette, legend })
    }
}

impl ValuePaint {
    fn palette_of(
        &self,
        sample: &[&Batch],
        lattice: &Lattice,
        range: [f64; 2],
        options: &ColorOptions,
    ) -> (Palette, Legend) {
        let entries = |colors: &dyn Fn(u32) -> [u8; 4], names: &dyn Fn(u32) -> String, numbers: BTreeSet<u32>| {
            let entry = |number| LegendEntry { number, name: names(number), color: colors(number) };
            LegendKey::Entries(numbers.into_iter().map(entry).collect())
        };
        let seen = || {
            let mut numbers = BTreeSet::new();
            for batch in sample {
                let mut values = Vec::new();
                self.paint(batch, lattice, &mut values);
                numbers.extend(values.into_iter().filter(|&value| value != NO_VALUE));
            }
            numbers
        };
        let ramp = |title: &str, colors: Vec<[u8; 4]>| {
            let [low, high] = range.map(|end| end - self.origin);
            let legend = Legend {
                title: title.into(),
                key: LegendKey::Ramp { colors: colors.clone(), low: range[0], high: range[1] },
            };
            (Palette::ramp(colors, [low, high]), legend)
        };
        let table = |len: u32, color: &dyn Fn(u32) -> [u8; 4]| Palette::numbers((0..len).map(color).collect());
        match self.mode {
            ColorMode::Rgb => (Palette::colors(), Legend { title: "RGB".into(), key: LegendKey::Recorded }),
            ColorMode::Intensity => ramp("Intensity", tables::grey_table()),
            ColorMode::Height => ramp("Height", tables::ramp_table()),
            ColorMode::Time => ramp("GPS time", tables::ramp_table()),
            ColorMode::Class => {
                let key = entries(&tables::class, &tables::class_name, seen());
                (table(256, &tables::class), Legend { title: "Classification".into(), key })
            }
            ColorMode::Return => {
                let key = entries(&tables::category, &|number| format!("return {number}"), seen());
                (table(256, &tables::category), Legend { title: "Return".into(), key })
            }
            ColorMode::Scan => {
                let named: BTreeSet<u32> = options.scan_names.keys().copied().collect();
                let numbers = if named.is_empty() { seen() } else { named };
                let len = numbers.last().map_or(1, |&last| last.min(MAX_SCANS - 1) + 1);
                let name = |n| options.scan_names.get(&n).cloned().unwrap_or_else(|| format!("scan {n}"));
                let key = entries(&tables::category, &name, numbers);
                (table(len, &tables::category), Legend { title: "Scan".into(), key })
            }
            ColorMode::Level => {
                let colors: Vec<_> = (0..=u32::from(crate::lattice::BITS)).map(tables::category).collect();
                let key = entries(
                    &tables::category,
                    &|number| format!("level {number}"),
                    (0..options.levels.unwrap_or(12)).collect(),
                );
                (Palette::levels(colors), Legend { title: "Level".into(), key })
            }
        }
    }

    fn rgb(&self, batch: &Batch, values: &mut Vec<u32>) {
        let intensity = self.greys.as_ref().zip(batch.column("Intensity"));
        let grey = |i: usize| {
            let color = intensity.map_or(NOTHING, |(stretch, column)| tables::grey(stretch.place(column.as_f64(i))));
            u32::from_le_bytes(color)
        };
        let channels = ["Red", "Green", "Blue"].map(|name| batch.column(name));
        let [Some(red), Some(green), Some(blue)] = channels else {
            values.extend((0..batch.len()).map(grey));
            return;
        };
        let packed = |[red, green, blue]: [u8; 3]| u32::from_le_bytes([red, green, blue, 255]);
        let scans = &batch.scans;
        // The scan is mostly the same all the way, and the columns have one type: no choice is left for each point.
        let one_depth = match scans.as_slice() {
            [] => Some(self.depths.of(None)),
            [first, rest @ ..] if rest.iter().all(|scan| scan == first) => Some(self.depths.of(Some(*first))),
            _ => None,
        };
        match (one_depth, red, green, blue) {
            (Some(Some(depth)), Column::U16(red), Column::U16(green), Column::U16(blue)) => {
                let byte = |v: u16| if depth <= 8 { v.min(255) as u8 } else { (v >> 8) as u8 };
                let channels = red.iter().zip(green).zip(blue);
                values.extend(channels.map(|((&r, &g), &b)| packed([byte(r), byte(g), byte(b)])));
            }
            _ => values.extend((0..batch.len()).map(|i| match self.depths.of(scans.get(i).copied()) {
                Some(depth) => packed([byte(red, i, depth), byte(green, i, depth), byte(blue, i, depth)]),
                None => grey(i),
            })),
        }
    }
}

impl Paint for ValuePaint {
    fn tag(&self) -> u64 {
        // Without a random start: the same in every process.
        let mut hasher = DefaultHasher::new();
        (self.mode, self.origin.to_bits(), &self.depths, self.greys.map(|s| s.ends().map(f64::to_bits)))
            .hash(&mut hasher);
        hasher.finish()
    }

    fn attributes(&self) -> Vec<String> {
        let grey = if self.greys.is_some() { ColorMode::Intensity.attributes() } else { &[] };
        self.mode.attributes().iter().chain(grey).map(|name| (*name).to_owned()).collect()
    }

    fn needs_scans(&self) -> bool {
        match self.mode {
            ColorMode::Scan => true,
            // Where all scans are read alike it does not matter which it is.
            ColorMode::Rgb => self.depths.by_scan.values().any(|depth| *depth != self.depths.others),
            _ => false,
        }
    }

    fn paint(&self, batch: &Batch, lattice: &Lattice, values: &mut Vec<u32>) {
        let numbers = |values: &mut Vec<u32>, name: &str| match batch.column(name) {
            Some(Column::U8(column)) => values.extend(column.iter().map(|&v| u32::from(v))),
            Some(Column::U16(column)) => values.extend(column.iter().map(|&v| u32::from(v))),
            _ => values.resize(values.len() + batch.len(), NO_VALUE),
        };
        let ramp = |values: &mut Vec<u32>, name: &str| match batch.column(name) {
            Some(Column::U16(column)) => {
                values.extend(column.iter().map(|&v| ramp_value(f64::from(v) - self.origin)));
            }
            Some(column) => values.extend((0..batch.len()).map(|i| ramp_value(column.as_f64(i) - self.origin))),
            None => values.resize(values.len() + batch.len(), NO_VALUE),
        };
        match self.mode {
            ColorMode::Rgb => self.rgb(batch, values),
            ColorMode::Intensity => ramp(values, "Intensity"),
            ColorMode::Time => ramp(values, "GpsTime"),
            ColorMode::Height => {
                // From the nearest step: exact differences, and no decimal for each point.
                let zero = lattice.nearest_index(2, self.origin).unwrap_or(crate::lattice::BIAS as u64);
                let rest = lattice.world_on_axis(2, zero) - self.origin;
                let quantum = lattice.quantum_f64()[2];
                let height = |z: u64| z.wrapping_sub(zero).cast_signed() as f64 * quantum + rest;
                values.extend(batch.positions.z.iter().map(|&z| ramp_value(height(z))));
            }
            ColorMode::Class => numbers(values, "Classification"),
            ColorMode::Return => numbers(values, "ReturnNumber"),
            ColorMode::Scan => {
                let known = batch.scans.len();
                values.extend_from_slice(&batch.scans);
                values.resize(values.len() + batch.len() - known, NO_VALUE);
            }
            ColorMode::Level => values.resize(values.len() + batch.len(), 0),
        }
    }
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

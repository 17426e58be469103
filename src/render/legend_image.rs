//! A legend written into a picture's lower left corner.

use super::font::{COLUMNS, ROWS, glyph};
use super::{Image, Legend, LegendKey};

const TEXT: [u8; 3] = [240, 240, 240];
/// Of the panel's own colour, of 255; the rest is the picture.
const PANEL_OPACITY: u32 = 190;
const PANEL: [u8; 3] = [20, 22, 26];
/// In letter pixels.
const MARGIN: u32 = 4;
const LINE: u32 = ROWS + 3;
const SWATCH: u32 = 8;
/// Numbers beside a ramp.
const MARKS: usize = 5;

impl Image {
    /// Writes what the colours mean into the lower left corner, as much of it as there is room for; nothing for recorded
    /// colours.
    pub fn draw_legend(&mut self, legend: &Legend) {
        // Letters of 14 pixels on an image of 720 rows or more.
        let scale = (self.height / 360).clamp(1, 8);
        let room = (self.height / scale).saturating_sub(2 * MARGIN) / LINE;
        let mut lines: Vec<(Option<[u8; 4]>, String)> = match &legend.key {
            LegendKey::Recorded => return,
            LegendKey::Entries(entries) => entries.iter().map(|e| (Some(e.color), e.name.clone())).collect(),
            LegendKey::Ramp { low, high, .. } if low == high => vec![(None, number(*low, 0.0))],
            LegendKey::Ramp { low, high, .. } => {
                let part = |mark: usize| 1.0 - mark as f64 / (MARKS - 1) as f64;
                (0..MARKS).map(|mark| (None, number(low + (high - low) * part(mark), high - low))).collect()
            }
        };
        let room = (room as usize).saturating_sub(1);
        // The panel takes half of the picture's width at most, or what a short word needs.
        let letters = ((self.width / scale / 2).saturating_sub(3 * MARGIN + SWATCH) / (COLUMNS + 1)).max(12) as usize;
        lines.iter_mut().for_each(|(_, text)| *text = plain(text, letters));
        if room < 2 {
            return;
        }
        if lines.len() > room {
            let more = lines.len() - (room - 1);
            lines.truncate(room - 1);
            lines.push((None, format!("and {more} more")));
        }
        let longest = lines.iter().map(|(_, text)| text.chars().count()).chain([legend.title.chars().count()]).max();
        let text_width = longest.unwrap_or(0) as u32 * (COLUMNS + 1);
        let width = 2 * MARGIN + SWATCH + MARGIN + text_width;
        let height = 2 * MARGIN + LINE * (lines.len() as u32 + 1);
        let mut pen = Pen { top: (self.height / scale).saturating_sub(height + MARGIN), scale, image: self };
        pen.panel(MARGIN, 0, width, height);
        let left = 2 * MARGIN;
        pen.text(left, MARGIN, &legend.title);
        let first = MARGIN + LINE;
        for (row, (color, text)) in (0..).zip(&lines) {
            let y = first + row * LINE;
            if let Some([red, green, blue, _]) = *color {
                pen.fill(left, y, SWATCH, SWATCH, [red, green, blue]);
            }
            pen.text(left + SWATCH + MARGIN, y, text);
        }
        if let LegendKey::Ramp { colors, .. } = &legend.key {
            // From the middle of the first number to the middle of the last.
            let rows = LINE * (lines.len() as u32 - 1);
            for row in 0..=rows {
                let place = (rows - row) as usize * (colors.len().saturating_sub(1)) / rows.max(1) as usize;
                let [red, green, blue, _] = colors.get(place).copied().unwrap_or_default();
                pen.fill(left, first + ROWS / 2 + row, SWATCH, 1, [red, green, blue]);
            }
        }
    }
}

/// A name in letters that there are, shortened in its middle if it has too many: files are told apart by their ends.
fn plain(name: &str, most: usize) -> String {
    let name = deunicode::deunicode_with_tofu(name, "?");
    if name.len() <= most {
        return name;
    }
    let kept = most.saturating_sub(3);
    format!("{}...{}", &name[..kept.div_ceil(2)], &name[name.len() - kept / 2..])
}

/// A number with as many digits as its range is worth.
fn number(value: f64, range: f64) -> String {
    let digits = if range > 0.0 { (2.0 - range.log10().floor()).clamp(0.0, 9.0) as usize } else { 3 };
    format!("{value:.digits$}")
}

/// Draws in letter pixels, downwards from `top`.
struct Pen<'i> {
    image: &'i mut Image,
    scale: u32,
    top: u32,
}

impl Pen<'_> {
    /// Every pixel of the image within a box of letter pixels.
    fn each(&mut self, x: u32, y: u32, width: u32, height: u32, mut change: impl FnMut(&mut [u8])) {
        let columns = (x * self.scale).min(self.image.width)..((x + width) * self.scale).min(self.image.width);
        let y = self.top + y;
        let rows = (y * self.scale).min(self.image.height)..((y + height) * self.scale).min(self.image.height);
        for row in rows {
            for column in columns.clone() {
                let start = (row as usize * self.image.width as usize + column as usize) * 4;
                change(&mut self.image.rgba[start..start + 4]);
            }
        }
    }

    fn panel(&mut self, x: u32, y: u32, width: u32, height: u32) {
        self.each(x, y, width, height, |pixel| {
            for (channel, panel) in pixel.iter_mut().zip(PANEL) {
                let mixed = u32::from(*channel) * (255 - PANEL_OPACITY) + u32::from(panel) * PANEL_OPACITY;
                *channel = (mixed / 255) as u8;
            }
            pixel[3] = pixel[3].max(PANEL_OPACITY as u8);
        });
    }

    fn fill(&mut self, x: u32, y: u32, width: u32, height: u32, color: [u8; 3]) {
        self.each(x, y, width, height, |pixel| {
            pixel[..3].copy_from_slice(&color);
            pixel[3] = 255;
        });
    }

    fn text(&mut self, x: u32, y: u32, text: &str) {
        for (place, character) in (0..).zip(text.chars()) {
            for (column, bits) in (0..).zip(glyph(character)) {
                for row in (0..ROWS).filter(|row| bits >> row & 1 == 1) {
                    self.fill(x + place * (COLUMNS + 1) + column, y + row, 1, 1, TEXT);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::LegendEntry;

    fn blank(width: u32, height: u32) -> Image {
        Image { width, height, rgba: [9, 9, 9, 255].repeat((width * height) as usize) }
    }

    fn count(image: &Image, color: [u8; 3]) -> usize {
        image.rgba.chunks_exact(4).filter(|p| p[..3] == color).count()
    }

    fn entries(n: u8) -> Legend {
        let entry = |i| LegendEntry { number: u32::from(i), name: format!("class {i}"), color: [i, 200, 0, 255] };
        Legend { title: "Classification".into(), key: LegendKey::Entries((1..=n).map(entry).collect()) }
    }

    #[test]
    fn every_entry_has_its_swatch_as_far_as_there_is_room() {
        let mut image = blank(400, 300);
        image.draw_legend(&entries(5));
        for i in 1..=5 {
            assert_eq!(count(&image, [i, 200, 0]), (SWATCH * SWATCH) as usize);
        }
        assert!(count(&image, TEXT) > 200);
        assert_eq!(image.pixel(399, 299), [9, 9, 9, 255], "the rest stays");
        assert_eq!(image.pixel(5, 100), [9, 9, 9, 255], "the rest stays");
        let mut small = blank(400, 80);
        small.draw_legend(&entries(50));
        assert_eq!(count(&small, [1, 200, 0]), (SWATCH * SWATCH) as usize);
        assert_eq!(count(&small, [50, 200, 0]), 0);
        let mut large = blank(1000, 800);
        large.draw_legend(&entries(1));
        assert_eq!(count(&large, [1, 200, 0]), (4 * SWATCH * SWATCH) as usize);
    }

    #[test]
    fn a_ramp_has_both_its_ends() {
        let colors: Vec<[u8; 4]> = (0..=255).map(|i| [i, 100, 50, 255]).collect();
        let legend = Legend { title: "Height".into(), key: LegendKey::Ramp { colors, low: -1.25, high: 8.0 } };
        let mut image = blank(300, 200);
        image.draw_legend(&legend);
        assert!(count(&image, [0, 100, 50]) >= SWATCH as usize && count(&image, [255, 100, 50]) >= SWATCH as usize);
        assert_eq!(
            [number(-1.25, 9.25), number(1234.5678, 900.0), number(0.00012, 0.001)],
            ["-1.25", "1235", "0.00012"]
        );
    }

    #[test]
    fn names_are_written_in_plain_letters_and_fit() {
        assert_eq!(plain("Straße_Größe_é", 40), "Strasse_Grosse_e");
        assert!(!plain("日本語", 40).contains('?') && plain("日本語", 40).is_ascii());
        assert_eq!(plain("station_0123456789_north", 13), "stati...north");
        let named = |name: &str| Legend {
            title: "Scan".into(),
            key: LegendKey::Entries(vec![LegendEntry { number: 1, name: name.into(), color: [1, 200, 0, 255] }]),
        };
        let mut image = blank(600, 300);
        image.draw_legend(&named(&"scan_".repeat(60)));
        assert_eq!(image.pixel(320, 290), [9, 9, 9, 255], "the right half is the picture's");
        assert!(count(&image, TEXT) > 200);
    }

    #[test]
    fn a_constant_is_one_number() {
        let key = |low| LegendKey::Ramp { colors: vec![[7, 100, 50, 255]; 256], low, high: 3.0 };
        let [mut constant, mut ramp] = [blank(300, 200), blank(300, 200)];
        constant.draw_legend(&Legend { title: "Height".into(), key: key(3.0) });
        ramp.draw_legend(&Legend { title: "Height".into(), key: key(2.0) });
        assert!(count(&constant, [7, 100, 50]) > 0);
        assert!(count(&constant, TEXT) < count(&ramp, TEXT) - 100);
    }

    #[test]
    fn no_image_is_too_small() {
        for (width, height) in [(1, 1), (3, 100), (500, 20), (30, 3000)] {
            let mut image = blank(width, height);
            image.draw_legend(&entries(3));
            assert_eq!(image.rgba.len(), (width * height * 4) as usize);
        }
        let mut image = blank(300, 200);
        image.draw_legend(&Legend { title: "RGB".into(), key: LegendKey::Recorded });
        assert_eq!(image, blank(300, 200));
    }

    #[test]
    fn letters_differ() {
        let all: std::collections::BTreeSet<[u8; 5]> = (' '..='~').map(glyph).collect();
        assert_eq!(all.len(), 95);
        assert_eq!(glyph('ü'), glyph('?'));
    }
}

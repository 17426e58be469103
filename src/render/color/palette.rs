//! From the value of a packed point to its colour: the twin of `color_of` in `points.wgsl`.

use super::NOTHING;

/// The value of a point that lacks what the others of the picture show.
pub const NO_VALUE: u32 = u32::MAX;

/// The most entries of a table.
const MAX_COLORS: usize = 1 << 16;

/// How values become colours. Changing it uploads no points: only this.
#[derive(Clone, Debug, PartialEq)]
pub struct Palette {
    kind: Kind,
    /// sRGB-coded; never empty. Points whose entry has alpha 0 are not drawn.
    colors: Vec<[u8; 4]>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Colors,
    Numbers,
    Ramp { scale: f32, offset: f32 },
    Levels,
}

impl Default for Palette {
    fn default() -> Self {
        Self::colors()
    }
}

impl Palette {
    /// Values are colours already: RGBA8, red in the lowest byte, alpha not read.
    pub fn colors() -> Self {
        Self { kind: Kind::Colors, colors: vec![NOTHING] }
    }

    /// Values are whole numbers, each with its entry of the table; those beyond have the last one. At most 65,536
    /// entries count.
    pub fn numbers(colors: Vec<[u8; 4]>) -> Self {
        Self::table(Kind::Numbers, colors)
    }

    /// Every point has the entry of its node's level, 0 being the root's, whatever its value; deeper ones have the last.
    pub fn levels(colors: Vec<[u8; 4]>) -> Self {
        Self::table(Kind::Levels, colors)
    }

    /// Values are the bits of `f32` numbers; the table is spread evenly from `low` to `high`. What is beyond has the end's
    /// colour, and everything the middle's if the range has no extent.
    pub fn ramp(colors: Vec<[u8; 4]>, [low, high]: [f64; 2]) -> Self {
        // Halved, so that the widest ranges of f64 don't overflow.
        let half = high / 2.0 - low / 2.0;
        let kind = if half > 0.0 && half.is_finite() {
            Kind::Ramp { scale: (0.5 / half) as f32, offset: (-low / 2.0 / half) as f32 }
        } else {
            Kind::Ramp { scale: 0.0, offset: 0.5 }
        };
        Self::table(kind, colors)
    }

    fn table(kind: Kind, mut colors: Vec<[u8; 4]>) -> Self {
        colors.truncate(MAX_COLORS);
        if colors.is_empty() {
            colors.push(NOTHING);
        }
        Self { kind, colors }
    }

    /// The table.
    pub fn entries(&self) -> &[[u8; 4]] {
        &self.colors
    }

    /// The colour of a value in a node of this level; alpha 0 for a point that is not drawn.
    pub fn color(&self, value: u32, level: u32) -> [u8; 4] {
        let last = self.colors.len() - 1;
        match self.kind {
            Kind::Colors => {
                let [red, green, blue, _] = value.to_le_bytes();
                [red, green, blue, 255]
            }
            Kind::Numbers | Kind::Ramp { .. } if value == NO_VALUE => NOTHING,
            Kind::Numbers => self.colors[(value as usize).min(last)],
            Kind::Ramp { scale, offset } => {
                let place = (f32::from_bits(value) * scale + offset).clamp(0.0, 1.0);
                self.colors[((place * last as f32 + 0.5) as usize).min(last)]
            }
            Kind::Levels => self.colors[(level as usize).min(last)],
        }
    }

    /// `VALUES_*` of the shader.
    pub(in super::super) fn kind(&self) -> u32 {
        match self.kind {
            Kind::Colors => 0,
            Kind::Numbers => 1,
            Kind::Ramp { .. } => 2,
            Kind::Levels => 3,
        }
    }

    pub(in super::super) fn last(&self) -> u32 {
        (self.colors.len() - 1) as u32
    }

    /// Scale and offset of a ramp.
    pub(in super::super) fn ramp_of(&self) -> (f32, f32) {
        match self.kind {
            Kind::Ramp { scale, offset } => (scale, offset),
            _ => (0.0, 0.0),
        }
    }
}

/// The bits of a number for a ramp: NaN lies at the low end, and nothing is infinite.
pub(super) fn ramp_value(number: f64) -> u32 {
    if number.is_nan() { f32::MIN.to_bits() } else { (number as f32).clamp(f32::MIN, f32::MAX).to_bits() }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RED: [u8; 4] = [255, 0, 0, 255];
    const GREEN: [u8; 4] = [0, 255, 0, 255];
    const BLUE: [u8; 4] = [0, 0, 255, 255];

    #[test]
    fn numbers_and_levels_have_their_entries_and_the_last_beyond() {
        let table = vec![RED, GREEN, BLUE];
        let numbers = Palette::numbers(table.clone());
        assert_eq!([0, 1, 2, 3, NO_VALUE].map(|n| numbers.color(n, 9)), [RED, GREEN, BLUE, BLUE, NOTHING]);
        let levels = Palette::levels(table);
        assert_eq!([0, 1, 7].map(|level| levels.color(5, level)), [RED, GREEN, BLUE]);
        assert_eq!(Palette::numbers(Vec::new()).color(5, 0), NOTHING);
    }

    #[test]
    fn a_ramp_goes_from_its_low_end_to_its_high_end() {
        let ramp = Palette::ramp(vec![RED, GREEN, BLUE], [10.0, 20.0]);
        let colors = [-1e300, 10.0, 12.0, 13.0, 15.0, 18.0, 20.0, 1e300].map(|n| ramp.color(ramp_value(n), 0));
        assert_eq!(colors, [RED, RED, RED, GREEN, GREEN, BLUE, BLUE, BLUE]);
        assert_eq!(ramp.color(ramp_value(f64::NAN), 0), RED);
        for flat in [[5.0, 5.0], [f64::NAN, 1.0], [2.0, 1.0]] {
            let ramp = Palette::ramp(vec![RED, GREEN, BLUE], flat);
            assert_eq!([-1e300, 5.0, f64::INFINITY].map(|n| ramp.color(ramp_value(n), 0)), [GREEN; 3]);
        }
        let widest = Palette::ramp(vec![RED, GREEN, BLUE], [f64::MIN, f64::MAX]);
        assert_eq!(widest.color(ramp_value(0.0), 0), GREEN);
    }
}

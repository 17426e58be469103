//! Tables and ramps, as sRGB-coded bytes.

/// Grey from almost black at 0 to white at 1: black points would look like holes.
pub(super) fn grey(t: f64) -> [u8; 4] {
    let level = (24.0 + 231.0 * t).round() as u8;
    [level, level, level, 255]
}

/// The perceptually uniform ramp "viridis" (Smith and van der Walt, 2015), dark blue at 0 to yellow at 1, as Matt
/// Zucker's polynomial of degree 6: at most 2 of 255 from the table.
pub(super) fn ramp(t: f64) -> [u8; 4] {
    const COEFFICIENTS: [[f64; 3]; 7] = [
        [0.277_727_327, 0.005_407_345, 0.334_099_805],
        [0.105_093_043, 1.404_613_530, 1.384_590_163],
        [-0.330_861_829, 0.214_847_559, 0.095_095_163],
        [-4.634_230_499, -5.799_100_973, -19.332_440_956],
        [6.228_269_936, 14.179_933_367, 56.690_552_601],
        [4.776_384_998, -13.745_145_378, -65.353_032_633],
        [-5.435_455_856, 4.645_852_612, 26.312_435_250],
    ];
    let channel = |i: usize| {
        let value = COEFFICIENTS.iter().rev().fold(0.0, |sum, c| sum * t + c[i]);
        (value * 255.0).round().clamp(0.0, 255.0) as u8
    };
    [channel(0), channel(1), channel(2), 255]
}

/// The classes of LAS 1.4 R15, in colours that GIS users know: ground brown, plants green, buildings orange-red, water
/// blue. Classes above are user-defined and get one of the categories.
pub(super) fn class(class: u32) -> [u8; 4] {
    const CLASSES: [[u8; 3]; 23] = [
        [170, 170, 170], // created, never classified
        [145, 145, 150], // unassigned
        [161, 119, 74],  // ground
        [164, 205, 108], // low vegetation
        [95, 173, 72],   // medium vegetation
        [43, 125, 56],   // high vegetation
        [224, 104, 64],  // building
        [232, 52, 168],  // low point (noise)
        [236, 222, 168], // reserved, formerly model key point
        [66, 133, 214],  // water
        [112, 82, 140],  // rail
        [92, 94, 104],   // road surface
        [204, 190, 132], // reserved, formerly overlap
        [240, 216, 66],  // wire, guard
        [245, 178, 46],  // wire, conductor
        [196, 120, 204], // transmission tower
        [140, 222, 222], // wire-structure connector
        [118, 152, 176], // bridge deck
        [255, 0, 110],   // high noise
        [170, 132, 98],  // overhead structure
        [196, 142, 92],  // ignored ground
        [232, 242, 250], // snow
        [120, 90, 160],  // temporal exclusion
    ];
    match CLASSES.get(class as usize) {
        Some(&[red, green, blue]) => [red, green, blue, 255],
        None => category(class),
    }
}

/// What the classes of LAS 1.4 R15 are called.
pub(super) fn class_name(class: u32) -> String {
    const NAMES: [&str; 23] = [
        "never classified",
        "unassigned",
        "ground",
        "low vegetation",
        "medium vegetation",
        "high vegetation",
        "building",
        "low point",
        "reserved (8)",
        "water",
        "rail",
        "road surface",
        "reserved (12)",
        "wire, guard",
        "wire, conductor",
        "transmission tower",
        "wire connector",
        "bridge deck",
        "high noise",
        "overhead structure",
        "ignored ground",
        "snow",
        "temporal exclusion",
    ];
    NAMES.get(class as usize).map_or_else(|| format!("class {class}"), |name| (*name).to_owned())
}

/// [`ramp`] in 256 steps.
pub(super) fn ramp_table() -> Vec<[u8; 4]> {
    (0..=255).map(|i| ramp(f64::from(i) / 255.0)).collect()
}

/// [`grey`] in 256 steps.
pub(super) fn grey_table() -> Vec<[u8; 4]> {
    (0..=255).map(|i| grey(f64::from(i) / 255.0)).collect()
}

/// A colour for a number: neighbouring numbers look different. The hues go round by the golden angle.
pub(super) fn category(number: u32) -> [u8; 4] {
    const GOLDEN_TURN: f64 = 0.618_033_988_749_895;
    let hue = (0.58 + f64::from(number) * GOLDEN_TURN).fract() * 6.0;
    // Every other number is lighter: hues come round again close by after 13 numbers.
    let (saturation, value) = if number.is_multiple_of(2) { (0.62, 0.90) } else { (0.48, 0.98) };
    let channel = |shift: f64| {
        let k = (shift + hue) % 6.0;
        let level: f64 = value - value * saturation * k.min(4.0 - k).clamp(0.0, 1.0);
        (level * 255.0).round() as u8
    };
    [channel(5.0), channel(3.0), channel(1.0), 255]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ramp_gets_lighter_all_the_way() {
        let light = |[r, g, b, _]: [u8; 4]| 2 * u32::from(r) + 7 * u32::from(g) + u32::from(b);
        let steps: Vec<u32> = (0..=20).map(|i| light(ramp(f64::from(i) / 20.0))).collect();
        assert!(steps.windows(2).all(|w| w[0] < w[1]), "{steps:?}");
        // The ends of the published table.
        for (t, expected) in [(0.0, [68, 1, 84]), (1.0, [253, 231, 37])] {
            let got = ramp(t);
            assert!((0..3).all(|i| got[i].abs_diff(expected[i]) <= 4), "{got:?}");
        }
    }

    #[test]
    fn near_numbers_have_different_colours() {
        let far = |a: [u8; 4], b: [u8; 4]| (0..3).map(|i| a[i].abs_diff(b[i])).max() > Some(20);
        for a in 0..100 {
            assert!((a + 1..a + 8).all(|b| far(category(a), category(b))), "{a}");
        }
    }
}

//! The options that say how a picture looks.

use crate::cli::{Usage, values};
use crate::geometry::WorldBox;
use crate::render::{Background, ClipBox, Edl, Fog, RenderOptions, Shape};
use clap::Args;

/// How points look.
#[derive(Debug, Args)]
#[command(next_help_heading = "Look")]
pub(super) struct Look {
    /// round, square or paraboloid.
    #[arg(long, value_name = "SHAPE", default_value = "round")]
    shape: Shape,
    /// Radius of a splat relative to the spacing of the points around it (default: 0.75, which leaves no holes).
    #[arg(long, value_name = "FACTOR", value_parser = values::not_negative)]
    point_size: Option<f64>,
    /// Least diameter of a splat (default: 1).
    #[arg(long, value_name = "PX", value_parser = values::positive)]
    min_px: Option<f64>,
    /// Greatest diameter of a splat, for single points and those right before the eye (default: a tenth of the height).
    #[arg(long, value_name = "PX", value_parser = values::positive)]
    max_px: Option<f64>,
    /// Flat colours, without eye-dome lighting.
    #[arg(long, conflicts_with = "edl")]
    unlit: bool,
    /// Strength of eye-dome lighting (default: 1).
    #[arg(long, value_name = "STRENGTH", value_parser = values::not_negative)]
    edl: Option<f64>,
    /// Point shadows: black discs behind the points, so many pixels wider.
    #[arg(long, value_name = "PX", value_parser = values::not_negative, default_value = "0")]
    shadows: f64,
    /// Fog from this distance on, in CRS units, that halves colours over that length; in a colour or the background's.
    #[arg(long, value_name = "START,HALF[,RRGGBB]", value_parser = fog)]
    fog: Option<Fog>,
    /// One colour, two for a gradient from top to bottom, or none for a transparent picture.
    #[arg(long, value_name = "RRGGBB[,RRGGBB]|none", value_parser = background)]
    background: Option<Background>,
    /// Only the points in this box; may be given several times (inf is a number).
    #[arg(long = "clip", value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = corners, allow_hyphen_values = true)]
    clips: Vec<Corners>,
    /// Without the points in this box; may be given several times.
    #[arg(long = "cut", value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = corners, allow_hyphen_values = true)]
    cuts: Vec<Corners>,
    /// Draw the cubes of the octree's nodes, too.
    #[arg(long)]
    node_boxes: bool,
    /// Write what the colours mean into the picture.
    #[arg(long)]
    pub legend: bool,
}

/// Low and high corner.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Corners([[f64; 3]; 2]);

/// Farther than any camera can be: what `inf` means for a clip box.
const FARTHEST: f64 = 1e15;

impl Look {
    /// As the passes take it.
    ///
    /// # Errors
    ///
    /// If a box has no volume, or the least diameter is above the greatest.
    pub fn options(&self) -> anyhow::Result<RenderOptions> {
        let base = RenderOptions::default();
        if let (Some(least), Some(most)) = (self.min_px, self.max_px)
            && least > most
        {
            return Err(Usage(format!("--min-px {least} is more than --max-px {most}")).into());
        }
        let clip = |corners: &Corners, keep| -> anyhow::Result<ClipBox> {
            let [min, max] = corners.0.map(|corner| corner.map(|c| c.clamp(-FARTHEST, FARTHEST)));
            let bounds = WorldBox::new(min, max).ok_or_else(|| anyhow::anyhow!("a clip box ends before it begins"))?;
            Ok(ClipBox::from_bounds(&bounds, keep)?)
        };
        let keep = self.clips.iter().map(|corners| clip(corners, true));
        let clips = keep.chain(self.cuts.iter().map(|corners| clip(corners, false))).collect::<Result<_, _>>()?;
        let edl = self
            .edl
            .map_or(base.edl, |strength| (strength > 0.0).then(|| Edl { strength: strength as f32, ..Edl::default() }));
        Ok(RenderOptions {
            background: self.background.unwrap_or(base.background),
            shape: self.shape,
            radius_factor: self.point_size.unwrap_or(base.radius_factor),
            min_radius_px: self.min_px.map_or(base.min_radius_px, |px| px / 2.0),
            max_radius_px: self.max_px.map_or(base.max_radius_px, |px| px / 2.0),
            edl: if self.unlit { None } else { edl },
            fog: self.fog,
            shadow_px: self.shadows,
            clips,
            node_boxes: self.node_boxes,
            ..base
        })
    }

    /// Low and high corner of the box whose points are kept, if there is just one.
    pub fn kept_box(&self) -> Option<[[f64; 3]; 2]> {
        match self.clips.as_slice() {
            [one] => Some(one.0),
            _ => None,
        }
    }
}

/// Two numbers, the first below the second.
pub(super) fn range(text: &str) -> Result<[f64; 2], String> {
    match values::numbers(text)?.as_slice() {
        &[low, high] if low < high && low.is_finite() && high.is_finite() => Ok([low, high]),
        _ => Err(format!("'{text}' is no range; write two numbers, the lower first")),
    }
}

fn corners(text: &str) -> Result<Corners, String> {
    match values::numbers(text)?.as_slice() {
        &[x0, y0, z0, x1, y1, z1] if x0 < x1 && y0 < y1 && z0 < z1 => Ok(Corners([[x0, y0, z0], [x1, y1, z1]])),
        _ => Err(format!("'{text}' is no box; write X0,Y0,Z0,X1,Y1,Z1, the lower corner first")),
    }
}

fn color(text: &str) -> Result<[u8; 3], String> {
    let digits = text.trim().trim_start_matches('#');
    let wrong = || format!("'{text}' is no color; write six hexadecimal digits, such as ff8000");
    if digits.len() != 6 || !digits.is_ascii() {
        return Err(wrong());
    }
    let byte = |i: usize| u8::from_str_radix(&digits[2 * i..2 * i + 2], 16).map_err(|_| wrong());
    Ok([byte(0)?, byte(1)?, byte(2)?])
}

fn background(text: &str) -> Result<Background, String> {
    let opaque = |[red, green, blue]: [u8; 3]| [red, green, blue, 255];
    match text.split_once(',') {
        None if text == "none" => Ok(Background::Plain([0; 4])),
        None => Ok(Background::Plain(opaque(color(text)?))),
        Some((top, bottom)) => Ok(Background::Gradient { top: opaque(color(top)?), bottom: opaque(color(bottom)?) }),
    }
}

fn fog(text: &str) -> Result<Fog, String> {
    let parts: Vec<&str> = text.split(',').collect();
    let wrong = || format!("'{text}' is no fog; write START,HALF or START,HALF,RRGGBB");
    let (start, half) = match parts.as_slice() {
        [start, half] | [start, half, _] => (values::not_negative(start)?, values::positive(half)?),
        _ => return Err(wrong()),
    };
    Ok(Fog { color: parts.get(2).map(|text| color(text)).transpose()?, start, half })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_boxes_and_fog_are_read_and_checked() {
        assert_eq!(background("ff8000"), Ok(Background::Plain([255, 128, 0, 255])));
        assert_eq!(background("none"), Ok(Background::Plain([0; 4])));
        let gradient = Background::Gradient { top: [0, 0, 0, 255], bottom: [1, 2, 3, 255] };
        assert_eq!(background("#000000,010203"), Ok(gradient));
        assert!(background("red").is_err() && background("00000").is_err() && background("äöü").is_err());
        assert_eq!(fog("10,20"), Ok(Fog { color: None, start: 10.0, half: 20.0 }));
        assert_eq!(fog("0,5,0000ff"), Ok(Fog { color: Some([0, 0, 255]), start: 0.0, half: 5.0 }));
        assert!(fog("10").is_err() && fog("1,0").is_err() && fog("1,2,3,4").is_err());
        assert_eq!(corners("0,0,-inf,1,1,inf").unwrap().0[1], [1.0, 1.0, f64::INFINITY]);
        assert!(corners("0,0,0,1,1,0").is_err() && corners("0,0,1,1").is_err());
        assert_eq!(range("-1,2.5"), Ok([-1.0, 2.5]));
        assert!(range("2,1").is_err() && range("0,inf").is_err());
    }
}

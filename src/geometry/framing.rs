//! From where places are seen as large as an image allows.

use super::{Camera, CameraError, DVec3, Projection};
use glam::DMat3;

/// Enough to centre something to a millionth of a pixel.
const HALVINGS: usize = 48;
/// So much of the area stays free on each side.
const MARGIN: f64 = 0.04;
/// The field of view of a view that nobody chose: narrower than that of somebody who walks, so that what is near does not
/// loom.
const DEFAULT_FOV_Y_DEG: f64 = 40.0;
/// Where the eye is, for a view that nobody chose: south-west and above first, then others from the south, then steeper.
const DEFAULT_BACKWARD: [[f64; 3]; 8] = [
    [-0.45, -0.75, 0.55],
    [0.45, -0.75, 0.55],
    [-0.75, -0.45, 0.55],
    [0.75, -0.45, 0.55],
    [-0.45, -0.75, 0.9],
    [0.45, -0.75, 0.9],
    [-0.75, -0.45, 0.9],
    [0.75, -0.45, 0.9],
];
/// Another direction than the first is taken if so much more of the image is filled there.
const WORTH_TURNING: f64 = 1.15;

/// The part of an image in which something is to be seen, in parts of its width and height from the top left corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageArea {
    min: [f64; 2],
    max: [f64; 2],
}

impl ImageArea {
    /// All of the image.
    pub const WHOLE: Self = Self { min: [0.0; 2], max: [1.0; 2] };

    /// The area between these corners; all of the image if that is less than a tenth of it each way, or not on it.
    pub fn new(min: [f64; 2], max: [f64; 2]) -> Self {
        let fine = |i: usize| min[i] >= 0.0 && max[i] <= 1.0 && max[i] - min[i] >= 0.1;
        if fine(0) && fine(1) { Self { min, max } } else { Self::WHOLE }
    }

    /// Its middle: shares of the image's width and height, from the left and from above.
    pub fn center(&self) -> [f64; 2] {
        std::array::from_fn(|i| (self.min[i] + self.max[i]) / 2.0)
    }
}

/// How an image sees, wherever its eye is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Framing {
    /// Columns are right, up, backward: unit vectors.
    pub axes: DMat3,
    /// The full vertical field of view.
    pub fov_y_rad: f64,
    /// Width over height of the image.
    pub aspect: f64,
    /// Without perspective: the height seen is that of a perspective at the target's distance.
    pub parallel: bool,
    /// Where on the image.
    pub area: ImageArea,
}

/// From where [`Framing::eye_for`] sees its places.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Framed {
    /// The eye.
    pub eye: DVec3,
    /// To the middle of the places, along the line of sight.
    pub distance: f64,
    /// Which share of the area lies between the places.
    pub filled: f64,
}

impl Framing {
    /// The eye nearest to the places that sees all of them in the area, with a small margin, and in the middle of it.
    /// `None` without places.
    ///
    /// A single place is looked at from one unit, or from where `f64` can tell the two apart.
    pub fn eye_for(&self, places: &[DVec3]) -> Option<Framed> {
        let (low, high) = (places.iter().copied().reduce(DVec3::min)?, places.iter().copied().reduce(DVec3::max)?);
        let middle = low + (high - low) / 2.0;
        let to_view = self.axes.transpose();
        let views: Vec<DVec3> = places.iter().map(|&place| to_view * (place - middle)).collect();
        let most = |f: &dyn Fn(DVec3) -> f64| views.iter().map(|&v| f(v)).fold(f64::NEG_INFINITY, f64::max);
        let tan_y = (self.fov_y_rad / 2.0).tan();
        // The slopes of the area's edges against the line of sight, to the right and up.
        let edge =
            |i: usize, at: f64| if i == 0 { (2.0 * at - 1.0) * tan_y * self.aspect } else { (1.0 - 2.0 * at) * tan_y };
        let inset = |i: usize| {
            let ImageArea { min, max } = self.area;
            let by = MARGIN * (max[i] - min[i]);
            let (a, b) = (edge(i, min[i] + by), edge(i, max[i] - by));
            [a.min(b), a.max(b)]
        };
        let edges = [inset(0), inset(1)];
        // A place at `along` on an axis and `back` towards the eye is between the edges of an eye at (e, back_e) if
        // low (back_e - back) <= along - e <= high (back_e - back). The extremes over all places are all that counts.
        let slope = |s: f64| if self.parallel { 0.0 } else { s };
        let reach = [0, 1].map(|i| {
            let [low, high] = edges[i].map(slope);
            [most(&|v| -v[i] - low * v.z), most(&|v| v[i] + high * v.z)]
        });
        let needed = |i: usize| (reach[i][0] + reach[i][1]) / (edges[i][1] - edges[i][0]);
        let front = most(&|v| v.z);
        let extent = (high - low).max_element();
        let resolution = middle.abs().max_element() * 1e-9;
        let least = if extent > 0.0 { resolution.max(extent * 1e-6) } else { resolution.max(1.0) };
        // In parallel the distance says how much is seen, and the eye is before everything all the same.
        let distance = needed(0).max(needed(1)).max(front + least);
        let depth = |v: DVec3| if self.parallel { distance } else { (distance - v.z).max(f64::MIN_POSITIVE) };
        // Where the outermost places are seen from an eye at `e` on the axis: the farther it goes, the lower they are.
        let seen = |i: usize, e: f64| {
            let slopes = || views.iter().map(|v| (v[i] - e) / depth(*v));
            [slopes().fold(f64::INFINITY, f64::min), slopes().fold(f64::NEG_INFINITY, f64::max)]
        };
        let centered = |i: usize| {
            let [low, high] = edges[i];
            let mut ends = [reach[i][1] - high * distance, -reach[i][0] - low * distance];
            for _ in 0..HALVINGS {
                let e = (ends[0] + ends[1]) / 2.0;
                let [least, greatest] = seen(i, e);
                // Room above and below alike.
                let too_high = greatest - high > low - least;
                ends[usize::from(!too_high)] = e;
            }
            (ends[0] + ends[1]) / 2.0
        };
        let at = [centered(0), centered(1)];
        let on_image = views.iter().map(|v| [0, 1].map(|i| (v[i] - at[i]) / depth(*v))).collect();
        let filled = hull_area(on_image) / edges.map(|[low, high]| high - low).iter().product::<f64>();
        let eye = middle + self.axes * DVec3::new(at[0], at[1], distance);
        Some(Framed { eye, distance, filled })
    }
}

/// The area of the convex hull.
fn hull_area(mut points: Vec<[f64; 2]>) -> f64 {
    points.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let turn = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    // The lower side from left to right, then the upper one back.
    let half = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut side: Vec<[f64; 2]> = Vec::new();
        for point in points {
            while let [.., a, b] = side[..]
                && turn(a, b, point) <= 0.0
            {
                side.pop();
            }
            side.push(point);
        }
        side
    };
    let (lower, upper) = (half(&mut points.iter().copied()), half(&mut points.iter().rev().copied()));
    let double = |side: &[[f64; 2]]| side.windows(2).map(|w| w[0][0] * w[1][1] - w[1][0] * w[0][1]).sum::<f64>();
    (double(&lower) + double(&upper)) / 2.0
}

impl Camera {
    /// The view of a whole site that nobody chose: all places are on the image, as large as they can be in perspective
    /// (40 degrees), from the south and above, from the side on which they fill the image best.
    ///
    /// # Errors
    ///
    /// As [`Camera::new`], for sizes of 0 and coordinates beyond 1e15.
    pub fn seeing(places: &[DVec3], size_px: [u32; 2]) -> Result<Self, CameraError> {
        let fov_y_rad = DEFAULT_FOV_Y_DEG.to_radians();
        let projection = Projection::Perspective { fov_y_rad };
        let mut best: Option<(Framed, DVec3)> = None;
        for backward in DEFAULT_BACKWARD.map(|b| DVec3::from_array(b).normalize()) {
            // Near the origin, where any direction has its full resolution.
            let unit = Self::new(backward, DVec3::ZERO, DVec3::Z, projection, size_px)?;
            let axes = unit.view_from_relative().transpose();
            let framing = Framing { axes, fov_y_rad, aspect: unit.aspect(), parallel: false, area: ImageArea::WHOLE };
            let framed = framing.eye_for(places).unwrap_or(Framed { eye: backward, distance: 1.0, filled: 0.0 });
            if best.is_none_or(|(b, _)| framed.filled > b.filled * WORTH_TURNING) {
                best = Some((framed, backward));
            }
        }
        let (Framed { eye, distance, .. }, backward) = best.ok_or(CameraError::NoDirection)?;
        Self::new(eye, eye - backward * distance, DVec3::Z, projection, size_px)
    }

    /// The plan of a whole site: straight from above, north up, in parallel; all places are on the image, as large as they can
    /// be.
    ///
    /// # Errors
    ///
    /// As [`Camera::seeing`].
    pub fn above(places: &[DVec3], size_px: [u32; 2]) -> Result<Self, CameraError> {
        let fov_y_rad = DEFAULT_FOV_Y_DEG.to_radians();
        let high = |distance: f64| Projection::Orthographic { height: 2.0 * (fov_y_rad / 2.0).tan() * distance };
        let unit = Self::new(DVec3::Z, DVec3::ZERO, DVec3::Y, high(1.0), size_px)?;
        let axes = unit.view_from_relative().transpose();
        let framing = Framing { axes, fov_y_rad, aspect: unit.aspect(), parallel: true, area: ImageArea::WHOLE };
        let framed = framing.eye_for(places);
        let Framed { eye, distance, .. } = framed.unwrap_or(Framed { eye: DVec3::Z, distance: 1.0, filled: 0.0 });
        Self::new(eye, eye - DVec3::Z * distance, DVec3::Y, high(distance), size_px)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn framing(camera: &Camera, area: ImageArea) -> Framing {
        let axes = camera.view_from_relative().transpose();
        Framing { axes, fov_y_rad: 1.0, aspect: camera.aspect(), parallel: false, area }
    }

    proptest! {
        /// Everything is in the area, and it can't be larger: it touches the margins on both sides of one axis.
        #[test]
        fn places_fill_the_area_and_no_more(
            places in prop::collection::vec(prop::array::uniform3(-50.0_f64..50.0), 2..40),
            towards in prop::array::uniform3(-1.0_f64..1.0),
            area in prop::array::uniform4(0.0_f64..0.35),
            far in prop::sample::select(vec![0.0, 4e6]),
            parallel in any::<bool>(),
        ) {
            let towards = DVec3::from_array(towards);
            prop_assume!(towards.truncate().length() > 0.1);
            let places: Vec<DVec3> = places.into_iter().map(|p| DVec3::from_array(p) + far).collect();
            let size = [800_u32, 500];
            let fov_y_rad = 1.0_f64;
            let projection = Projection::Perspective { fov_y_rad };
            let unit = Camera::new(DVec3::ZERO, towards, DVec3::Z, projection, size).unwrap();
            let area = ImageArea::new([area[0], area[1]], [1.0 - area[2], 1.0 - area[3]]);
            let Framed { eye, distance, .. } = Framing { parallel, ..framing(&unit, area) }.eye_for(&places).unwrap();
            let height = 2.0 * (fov_y_rad / 2.0).tan() * distance;
            let projection = if parallel { Projection::Orthographic { height } } else { projection };
            let camera = Camera::new(eye, eye + unit.forward() * distance, DVec3::Z, projection, size).unwrap();
            let px: Vec<[f64; 3]> = places.iter().map(|p| camera.pixel_from_relative(*p - eye).unwrap()).collect();
            let mut free = [f64::INFINITY; 2];
            for i in 0..2 {
                let side = f64::from(size[i]);
                let (low, high) = (area.min[i] * side, area.max[i] * side);
                let margin = MARGIN * (high - low);
                let least = px.iter().map(|p| p[i]).fold(f64::INFINITY, f64::min);
                let greatest = px.iter().map(|p| p[i]).fold(f64::NEG_INFINITY, f64::max);
                prop_assert!(least > low + margin - 0.01 && greatest < high - margin + 0.01, "{i}: {least} {greatest}");
                free[i] = (least - low - margin).max(high - margin - greatest);
                prop_assert!(((least - low) - (high - greatest)).abs() < 0.01, "{i} is not in the middle");
            }
            let nearest = places.iter().map(|p| (*p - eye).dot(unit.forward())).fold(f64::INFINITY, f64::min);
            let as_near_as_can_be = nearest < 1e-2;
            prop_assert!(free[0].min(free[1]) < 0.01 || as_near_as_can_be, "{:?}", free);
        }
    }

    #[test]
    fn one_place_is_seen_from_one_unit_and_a_long_site_from_its_long_side() {
        let place = DVec3::new(500_000.0, 5e6, 100.0);
        let camera = Camera::seeing(&[place], [640, 480]).unwrap();
        assert!(((camera.eye() - place).length() - 1.0).abs() < 1e-6);
        // From the south-west a strip that runs from south-west to north-east is seen along.
        let strip = |y: f64| -> Vec<DVec3> {
            let at = |i: u32| DVec3::new(f64::from(i / 2), y * f64::from(i / 2), 4.0 * f64::from(i % 2));
            (0..100).map(at).collect()
        };
        assert!(Camera::seeing(&strip(1.0), [640, 480]).unwrap().forward().x < 0.0, "from the south-east");
        assert!(Camera::seeing(&strip(-1.0), [640, 480]).unwrap().forward().x > 0.0, "from the south-west");
        assert_eq!(hull_area(vec![[0.0, 0.0], [2.0, 0.0], [1.0, 0.5], [0.0, 2.0], [2.0, 2.0], [1.0, 1.0]]), 4.0);
        assert!(Camera::seeing(&[], [640, 480]).is_ok(), "an empty site has a view, too");
    }
}

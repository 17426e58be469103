//! In which order missing parts are loaded: what would be missed most comes first.

use crate::geometry::{Camera, DVec3, WorldBox};
use crate::lattice::{Cube, Lattice};
use crate::query::Wanted;

/// At this angle from the centre of the view a part is worth half as much as in the centre.
const HALF_WORTH_RAD: f64 = 0.35;

/// The places in `wanted.parts`, most urgent first; what a part needs before it comes before it.
///
/// A part's urgency is the size on the image of the gaps that it fills, less far from the centre of view, more where the
/// camera is heading.
pub(super) fn load_order(wanted: &Wanted, camera: &Camera, heading: Option<DVec3>, lattice: &Lattice) -> Vec<u32> {
    let worth: Vec<f64> = wanted.nodes.iter().map(|n| worth(n.cube, camera, heading, lattice)).collect();
    let mut urgency: Vec<f64> = Vec::with_capacity(wanted.parts.len());
    for part in &wanted.parts {
        let node = &wanted.nodes[part.node as usize];
        let before = part.after.map(|i| &wanted.parts[i as usize]).filter(|p| p.node == part.node);
        let gap = before.map_or(node.spacing_before, |p| p.spacing);
        let own = gap * worth[part.node as usize];
        let limit = part.after.map_or(f64::INFINITY, |i| urgency[i as usize]);
        urgency.push(own.min(limit));
    }
    let mut order: Vec<u32> = (0..wanted.parts.len() as u32).collect();
    // Stable: among equals the sequence decides, in which what is needed before comes before.
    order.sort_by(|&a, &b| urgency[b as usize].total_cmp(&urgency[a as usize]));
    order
}

/// Pixels per unit of length at the cube's nearest point, weighed by where it is.
fn worth(cube: Cube, camera: &Camera, heading: Option<DVec3>, lattice: &Lattice) -> f64 {
    let corners = [cube.low(), cube.high()].map(|p| lattice.world_from_lattice(p));
    let Some(bounds) = WorldBox::new(corners[0], corners[1]) else { return 0.0 };
    let to_center = bounds.center() - camera.eye();
    let distance = bounds.distance_to(camera.eye()).max(camera.near()).max(f64::MIN_POSITIVE);
    let px = camera.pixels_of_length(1.0, distance);
    let Some(direction) = to_center.try_normalize() else { return px };
    let radius = bounds.extent().length() / 2.0;
    let off_center =
        (camera.forward().angle_between(direction) - (radius / to_center.length()).min(1.0).asin()).max(0.0);
    let center = 1.0 / (1.0 + (off_center / HALF_WORTH_RAD).powi(2));
    let ahead = heading.map_or(1.0, |h| 1.0 + 0.5 * h.dot(direction));
    px * center * ahead
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Projection;
    use crate::lattice::LatticePoint;
    use crate::query::{PartId, WantedNode, WantedPart};

    const MIDDLE: u64 = 0x5555_5555_5555;

    fn wanted(cubes: &[(Cube, Option<u32>)]) -> Wanted {
        let mut wanted = Wanted::default();
        for (i, &(cube, parent)) in (0..).zip(cubes) {
            let side = cube.side() as f64 * 0.01;
            wanted.nodes.push(WantedNode { cube, layer: 0, parent, spacing_before: side / 64.0 });
            let id = PartId::for_test(i);
            wanted.parts.push(WantedPart::for_test(id, i, cube, 100, parent, side / 128.0));
        }
        wanted
    }

    #[test]
    fn parents_come_first_then_what_is_near_and_in_the_centre() {
        let lattice = Lattice::uniform(0.01).unwrap();
        let root = Cube::containing(LatticePoint([MIDDLE; 3]), 16);
        let low = root.low().0;
        let child = |octant| root.child(octant).unwrap();
        // Looking along +y from below the south face, at the middle of the western half.
        let world = |x: f64, y: f64, z: f64| {
            let at = lattice.world_from_lattice(LatticePoint(low));
            DVec3::new(at[0] + x * 655.36, at[1] + y * 655.36, at[2] + z * 655.36)
        };
        let projection = Projection::Perspective { fov_y_rad: 1.5 };
        let camera =
            Camera::new(world(0.2, -0.4, 0.25), world(0.2, 1.0, 0.25), DVec3::Z, projection, [1000, 1000]).unwrap();
        let cubes = [(root, None), (child(7), Some(0)), (child(2), Some(0)), (child(1), Some(0)), (child(0), Some(0))];
        let order = load_order(&wanted(&cubes), &camera, None, &lattice);
        assert_eq!(order[0], 0, "the root");
        assert_eq!(order[1], 4, "near and in the centre");
        let place = |i: u32| order.iter().position(|&o| o == i).unwrap();
        assert!(place(1) > place(4) && place(1) > place(2), "far, high and beside");
        let east = load_order(&wanted(&cubes), &camera, Some(DVec3::X), &lattice);
        let earlier = east.iter().position(|&o| o == 3).unwrap();
        assert!(earlier <= place(3), "what lies ahead is not later for that");
    }
}

//! The nodes of a picture as a tree: which of them is the finest that holds a point.

use super::gpu_types::GpuNode;
#[cfg(test)]
use crate::lattice::LatticePoint;
use crate::lattice::{BITS, Cube};
use std::collections::HashMap;

/// Cubes with their spacings, children of one cube side by side.
#[derive(Debug, Default)]
pub(super) struct Cut {
    nodes: Vec<CutNode>,
    places: HashMap<Cube, u32>,
}

#[derive(Clone, Copy, Debug)]
struct CutNode {
    cube: Cube,
    spacing: f64,
    /// Bit `octant` is set where there is a child.
    mask: u8,
    /// The place of the first child; the others follow in octant order.
    first_child: u32,
}

impl Cut {
    /// The tree of these cubes, each with the distance between points there; of the same cube (several layers, together
    /// at least as fine as the finest) the least distance counts. A cube is another's child only if it is that of an
    /// octant, none between left out.
    pub fn new(nodes: impl IntoIterator<Item = (Cube, f64)>) -> Self {
        let mut spacings: HashMap<Cube, (f64, u8)> = HashMap::new();
        let mut order = Vec::new();
        for (cube, spacing) in nodes {
            let entry = spacings.entry(cube).or_insert_with(|| {
                order.push(cube);
                (spacing, 0)
            });
            entry.0 = entry.0.min(spacing);
        }
        let mut roots = Vec::new();
        for &cube in &order {
            match spacings.get_mut(&cube.parent()).filter(|_| cube.k() < BITS) {
                Some((_, mask)) => *mask |= 1 << cube.octant(),
                None => roots.push(cube),
            }
        }
        let mut cut = Self { nodes: Vec::with_capacity(order.len()), places: HashMap::with_capacity(order.len()) };
        let add = |cut: &mut Self, cube: Cube| {
            let (spacing, mask) = spacings.get(&cube).copied().unwrap_or_default();
            cut.places.insert(cube, cut.nodes.len() as u32);
            cut.nodes.push(CutNode { cube, spacing, mask, first_child: 0 });
        };
        roots.into_iter().for_each(|root| add(&mut cut, root));
        let mut next = 0;
        while next < cut.nodes.len() {
            let CutNode { cube, mask, .. } = cut.nodes[next];
            cut.nodes[next].first_child = cut.nodes.len() as u32;
            for octant in (0..8).filter(|octant| mask >> octant & 1 == 1) {
                if let Some(child) = cube.child(octant) {
                    add(&mut cut, child);
                }
            }
            next += 1;
        }
        cut
    }

    /// Where a cube is in [`Cut::gpu_nodes`]; `None` if it isn't.
    pub fn place(&self, cube: Cube) -> Option<u32> {
        self.places.get(&cube).copied()
    }

    /// Does a finer node lie in this cube?
    #[cfg(test)]
    pub fn has_finer(&self, cube: Cube) -> bool {
        self.place(cube).is_some_and(|place| self.nodes[place as usize].mask != 0)
    }

    /// The spacing of the finest node around `point`, from `cube` down; `None` if the cube isn't there.
    #[cfg(test)]
    pub fn spacing_at(&self, cube: Cube, point: LatticePoint) -> Option<f64> {
        let mut node = self.nodes[self.place(cube)? as usize];
        while node.mask != 0 {
            let octant = node.cube.octant_of(point);
            if node.mask >> octant & 1 == 0 {
                break;
            }
            let before = (node.mask & ((1 << octant) - 1)).count_ones();
            node = self.nodes[(node.first_child + before) as usize];
        }
        Some(node.spacing)
    }

    /// The table of `points.wgsl`, radii as a factor of the spacing.
    pub fn gpu_nodes(&self, radius_factor: f64) -> Vec<GpuNode> {
        let node = |n: &CutNode| GpuNode {
            radius: (n.spacing * radius_factor) as f32,
            children: n.first_child << 8 | u32::from(n.mask),
        };
        self.nodes.iter().map(node).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The least cube of the list, by going through all of it, reached through cubes of the list alone.
    fn finest(nodes: &[(Cube, f64)], from: Cube, point: LatticePoint) -> f64 {
        let spacing = |cube| nodes.iter().filter(|(c, _)| *c == cube).map(|(_, s)| *s).reduce(f64::min);
        let mut cube = from;
        while let Some(child) = cube.child(cube.octant_of(point)).filter(|c| spacing(*c).is_some()) {
            cube = child;
        }
        spacing(cube).unwrap()
    }

    proptest! {
        #[test]
        fn the_finest_node_is_found(
            nodes in prop::collection::vec(([0_u64..32, 0_u64..32, 0_u64..32], 0_u8..=5, 1_u32..100), 1..60),
            points in prop::collection::vec([0_u64..32, 0_u64..32, 0_u64..32], 1..20),
        ) {
            let nodes: Vec<(Cube, f64)> =
                nodes.into_iter().map(|(p, k, s)| (Cube::containing(LatticePoint(p), k), f64::from(s))).collect();
            let cut = Cut::new(nodes.iter().copied());
            let table = cut.gpu_nodes(1.0);
            for &(cube, _) in &nodes {
                for point in points.iter().map(|p| LatticePoint(*p)).filter(|p| cube.contains(*p)) {
                    let expected = finest(&nodes, cube, point);
                    prop_assert_eq!(cut.spacing_at(cube, point), Some(expected));
                    // As the shader goes.
                    let (mut node, mut bit) = (table[cut.place(cube).unwrap() as usize], cube.k());
                    loop {
                        let mask = node.children & 0xff;
                        if mask == 0 || bit == 0 { break }
                        bit -= 1;
                        let octant = (0..3).fold(0, |o, i| o | ((point.0[i] - cube.low().0[i]) >> bit & 1) << i);
                        if mask >> octant & 1 == 0 { break }
                        let before = (mask & ((1 << octant) - 1)).count_ones();
                        node = table[((node.children >> 8) + before) as usize];
                    }
                    prop_assert_eq!(f64::from(node.radius), expected);
                }
            }
        }
    }
}

//! What is drawn: points on a lattice, grouped by spacing.

use super::color::level_color;
#[cfg(test)]
use super::cut::Cut;
use super::{RenderError, RenderOptions};
use crate::lattice::{Cube, Lattice, LatticeBox, LatticePoint};
use crate::points::Positions;
use std::collections::HashSet;

/// Points that lie about equally far apart.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RenderNode {
    /// The distance between neighbouring points of the picture here, in CRS units: the side of a cell for a sampled node,
    /// so that the default radius reaches over all but the rarest gaps; twice that while finer points are still missing.
    pub spacing: f64,
    /// Where.
    pub positions: Positions,
    /// One per position: sRGB-coded red, green, blue. The fourth byte is not used: points are opaque.
    pub colors: Vec<[u8; 4]>,
}

/// All that is drawn, in drawing order.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// What the positions mean.
    pub lattice: Lattice,
    /// In drawing order, which decides between equally near points: node-key order for a store's nodes.
    pub nodes: Vec<RenderNode>,
    /// Drawn as wire frames, each in its colour, if the options ask for node boxes.
    pub boxes: Vec<(LatticeBox, [u8; 4])>,
}

/// The cubes of nodes in the colours of their levels, each once.
pub(super) fn node_boxes(cubes: impl Iterator<Item = Cube> + Clone) -> Vec<(LatticeBox, [u8; 4])> {
    let top = cubes.clone().map(Cube::k).max().unwrap_or(0);
    let mut seen = HashSet::new();
    let once = cubes.filter(|&cube| seen.insert(cube));
    // A little inside: edges that cubes of several levels share would fight for their pixels.
    let inset = |cube: Cube| {
        let (LatticeBox { min, max }, by) = (cube.to_box(), cube.side() >> 8);
        LatticeBox { min: LatticePoint(min.0.map(|c| c + by)), max: LatticePoint(max.0.map(|c| c - by)) }
    };
    once.map(|cube| (inset(cube), level_color((top - cube.k()).into()))).collect()
}

/// The points that a selection takes from one node of the octree.
#[cfg(test)]
#[derive(Clone, Debug, PartialEq)]
pub(super) struct SelectedPoints {
    /// The node's cube.
    pub cube: Cube,
    /// The spacing that the selection reaches in the cube, where no finer node is selected; in CRS units.
    pub spacing: f64,
    /// Where.
    pub positions: Positions,
    /// One per position.
    pub colors: Vec<[u8; 4]>,
}

impl Scene {
    /// The scene of a selection, given in drawing order: each point is as large as the spacing of the *finest* selected
    /// node whose cube holds it asks for, so that the sparse points of coarse nodes don't cover the fine ones around.
    ///
    /// A node counts as the finer one only if all nodes between are selected too, which holds in any selection that
    /// starts at the root.
    ///
    /// # Errors
    ///
    /// [`RenderError::ColorCount`] if a node's colours are not as many as its positions.
    #[cfg(test)]
    pub(super) fn from_selection(lattice: Lattice, selected: Vec<SelectedPoints>) -> Result<Self, RenderError> {
        let cut = Cut::new(selected.iter().map(|node| (node.cube, node.spacing)));
        let boxes = node_boxes(selected.iter().map(|node| node.cube));
        let mut nodes = Vec::with_capacity(selected.len());
        for (place, node) in selected.into_iter().enumerate() {
            check_counts(place, &node.positions, &node.colors)?;
            if !cut.has_finer(node.cube) {
                nodes.push(RenderNode { spacing: node.spacing, positions: node.positions, colors: node.colors });
                continue;
            }
            // Runs, not groups: the drawing order stays.
            let mut run = RenderNode::default();
            for (point, color) in node.positions.iter().zip(node.colors) {
                let spacing = cut.spacing_at(node.cube, point).unwrap_or(node.spacing);
                if spacing != run.spacing && !run.positions.is_empty() {
                    nodes.push(std::mem::take(&mut run));
                }
                run.spacing = spacing;
                run.positions.push(point);
                run.colors.push(color);
            }
            nodes.push(run);
        }
        Ok(Self { lattice, nodes, boxes })
    }

    /// The number of points.
    pub fn len(&self) -> usize {
        self.nodes.iter().map(|node| node.positions.len()).sum()
    }

    /// No points?
    pub fn is_empty(&self) -> bool {
        self.nodes.iter().all(|node| node.positions.is_empty())
    }

    /// Boxes that hold everything that is drawn.
    pub(super) fn bounds(&self, options: &RenderOptions) -> impl Iterator<Item = LatticeBox> + '_ {
        let boxes = if options.node_boxes { self.boxes.as_slice() } else { &[] };
        self.nodes.iter().filter_map(RenderNode::bounds).chain(boxes.iter().map(|(bounds, _)| *bounds))
    }

    /// # Errors
    ///
    /// [`RenderError::ColorCount`], [`RenderError::Number`] for a spacing that is no length.
    pub(super) fn check(&self) -> Result<(), RenderError> {
        for (place, node) in self.nodes.iter().enumerate() {
            check_counts(place, &node.positions, &node.colors)?;
            if !(0.0..=1e15).contains(&node.spacing) {
                let (name, expected) = ("the spacing of a node", "from 0 to 1e15");
                return Err(RenderError::Number { name, value: node.spacing, expected });
            }
        }
        Ok(())
    }
}

impl RenderNode {
    /// The tight box of the points; `None` without points.
    pub(super) fn bounds(&self) -> Option<LatticeBox> {
        let axis = |values: &[u64]| Some((*values.iter().min()?, *values.iter().max()?));
        let (x, y, z) = (axis(&self.positions.x)?, axis(&self.positions.y)?, axis(&self.positions.z)?);
        Some(LatticeBox { min: LatticePoint([x.0, y.0, z.0]), max: LatticePoint([x.1, y.1, z.1]) })
    }
}

fn check_counts(node: usize, positions: &Positions, colors: &[[u8; 4]]) -> Result<(), RenderError> {
    let (points, colors) = (positions.len(), colors.len());
    if points == colors { Ok(()) } else { Err(RenderError::ColorCount { node, points, colors }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn selected(cube: Cube, spacing: f64, points: &[[u64; 3]]) -> SelectedPoints {
        let positions = points.iter().map(|&p| LatticePoint(p)).collect();
        SelectedPoints { cube, spacing, positions, colors: vec![[0; 4]; points.len()] }
    }

    #[test]
    fn a_point_has_the_spacing_of_the_finest_selected_node_around_it() {
        let root = Cube::containing(LatticePoint([0; 3]), 10);
        let child = root.child(0).unwrap();
        let grandchild = child.child(7).unwrap();
        let scene = Scene::from_selection(
            Lattice::uniform(0.01).unwrap(),
            vec![
                selected(root, 8.0, &[[1000, 0, 0], [10, 0, 0], [11, 0, 0], [400, 400, 400], [1000, 1000, 0]]),
                selected(child, 4.0, &[[20, 0, 0], [300, 300, 300]]),
                selected(grandchild, 2.0, &[[260, 260, 260]]),
            ],
        )
        .unwrap();
        let runs: Vec<(f64, Vec<u64>)> = scene.nodes.iter().map(|n| (n.spacing, n.positions.x.clone())).collect();
        let expected = vec![
            (8.0, vec![1000]),
            (4.0, vec![10, 11]),
            (2.0, vec![400]),
            (8.0, vec![1000]),
            (4.0, vec![20]),
            (2.0, vec![300]),
            (2.0, vec![260]),
        ];
        assert_eq!(runs, expected);
        assert!(scene.nodes.iter().all(|n| n.colors.len() == n.positions.len()));
    }

    #[test]
    fn colours_must_be_as_many_as_points() {
        let mut node = selected(Cube::containing(LatticePoint([0; 3]), 10), 1.0, &[[0; 3]]);
        node.colors.clear();
        let refused = Scene::from_selection(Lattice::uniform(1.0).unwrap(), vec![node]);
        assert!(matches!(refused, Err(RenderError::ColorCount { node: 0, points: 1, colors: 0 })));
    }
}

//! A draw list as the passes take it: nodes as a table, blocks as draws.

use super::canvas::Draw;
use super::cut::Cut;
use super::frame::Frame;
use super::gpu_types::{GpuBlock, GpuNode};
use super::pack::PlacedBox;
use super::pick::PickTable;
use super::pool::Slabs;
use super::{RenderError, RenderOptions, scene};
use crate::geometry::Camera;
use crate::lattice::{Cube, LatticeBox};
use crate::stream::gpu::{DrawList, step_shift};

/// A point that stands in for finer ones has this many times its radius.
const STAND_IN: f64 = 2.0;

/// A list, ready to draw.
#[derive(Debug, Default)]
pub(super) struct ListData {
    pub blocks: Vec<GpuBlock>,
    pub nodes: Vec<GpuNode>,
    pub draws: Vec<Draw>,
    pub picks: PickTable,
    pub boxes: Vec<(LatticeBox, [u8; 4])>,
}

/// The camera's frame for a list. The depth begins at the roots' cubes, so that what is resident does not change it.
///
/// # Errors
///
/// As [`Frame::new`].
pub(super) fn frame_of(
    list: &DrawList,
    camera: &Camera,
    options: &RenderOptions,
    limit: u32,
) -> Result<Frame, RenderError> {
    let roots = list.nodes.iter().filter(|node| node.parent.is_none());
    Frame::new(&list.lattice, roots.map(|node| node.cube.to_box()), camera, options, limit)
}

/// How far apart points are drawn in the nodes of a list, and in the patches of these.
pub(super) fn drawn_spacings(list: &DrawList) -> impl Iterator<Item = (Cube, f64)> + '_ {
    let drawn = |spacing: f64, stand_in: bool| if stand_in { STAND_IN * spacing } else { spacing };
    let nodes = list.nodes.iter().map(move |node| (node.cube, drawn(node.spacing, node.stand_in)));
    let patches = list.patches.iter().filter_map(move |patch| {
        let node = list.nodes.get(patch.node as usize)?;
        Some((patch.cube, drawn(patch.spacing, node.stand_in)))
    });
    nodes.chain(patches)
}

impl ListData {
    /// Blocks that the pool doesn't have, and nodes that the list doesn't, are left out.
    pub fn new(list: &DrawList, slabs: &Slabs, frame: &Frame, options: &RenderOptions) -> Self {
        let cut = Cut::new(drawn_spacings(list));
        let top = list.nodes.iter().map(|node| node.cube.k()).max().unwrap_or(0);
        let mut data = Self { nodes: cut.gpu_nodes(options.radius_factor), ..Self::default() };
        if options.node_boxes {
            data.boxes = scene::node_boxes(list.nodes.iter().map(|node| node.cube));
        }
        // Blocks follow their nodes, so a node's numbers are worked out once.
        let mut current: Option<(u32, GpuBlock)> = None;
        let mut next_id = 1_u32;
        for drawn in &list.blocks {
            let Some((slab, first_point)) = slabs.place(drawn.block) else { continue };
            let Some(node) = list.nodes.get(drawn.node as usize) else { continue };
            let points = drawn.points.min(slabs.block_points);
            let mut block = match current {
                Some((of, block)) if of == drawn.node => block,
                _ => {
                    let shift = step_shift(node.cube);
                    let side = [node.cube.side() - 1; 3];
                    let placed = PlacedBox { low: node.cube.low().0, side, step_scale: 1 << shift };
                    let mut block = placed.block(&list.lattice, frame);
                    block.node = cut.place(node.cube).unwrap_or(0);
                    block.bits = u32::from(node.cube.k() - shift);
                    block.level = u32::from(top - node.cube.k());
                    current = Some((drawn.node, block));
                    block
                }
            };
            (block.first_point, block.first_id) = (first_point, next_id);
            data.picks.push(next_id, node, drawn);
            next_id = next_id.wrapping_add(points);
            // A node's blocks are often neighbours: then one draw does for both.
            let is_next = |draw: &&mut Draw| draw.slab == slab && draw.first_point + draw.points == first_point;
            let same_node = data.blocks.last().is_some_and(|last| {
                last.node == block.node && last.bits == block.bits && last.anchor_steps == block.anchor_steps
            });
            match data.draws.last_mut().filter(|_| same_node).filter(is_next) {
                Some(draw) => draw.points += points,
                None => {
                    data.draws.push(Draw { slab, first_point, points });
                    data.blocks.push(block);
                }
            }
        }
        data
    }
}

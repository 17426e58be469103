//! Points as the passes have them: blocks of packed points, and scenes cut into pages of such blocks.
//!
//! A scene's block is a run of a node's points in a box of at most 2^32 steps a side: positions are offsets from the
//! box's low corner, so nothing is rounded, however large the node. Runs keep the drawing order.

use super::frame::Frame;
use super::gpu_types::{GpuBlock, GpuNode};
use super::{RenderNode, Scene};
use crate::geometry::DVec3;
use crate::lattice::{Lattice, LatticePoint};
use crate::stream::gpu::PackedPoint;

/// Points and blocks that are uploaded and drawn together.
#[derive(Debug, Default)]
pub(super) struct Page {
    pub points: Vec<PackedPoint>,
    pub blocks: Vec<GpuBlock>,
    /// One for each spacing that the page has.
    pub nodes: Vec<GpuNode>,
    /// Points of each block.
    pub counts: Vec<u32>,
}

/// Hands the scene's points to `draw`, in drawing order, in pages of at most `page_points` points and as many blocks.
///
/// # Errors
///
/// What `draw` returns.
pub(super) fn for_each_page<E>(
    scene: &Scene,
    frame: &Frame,
    radius_factor: f64,
    page_points: usize,
    page_blocks: usize,
    mut draw: impl FnMut(&Page) -> Result<(), E>,
) -> Result<(), E> {
    let mut page = Page::default();
    // 0 is nobody's.
    let mut next_id = 1_u32;
    for node in &scene.nodes {
        let mut start = 0;
        while start < node.positions.len() {
            if page.points.len() >= page_points || page.blocks.len() >= page_blocks {
                draw(&page)?;
                page = Page::default();
            }
            let room = page_points - page.points.len();
            let run = Run::starting_at(node, start, room);
            let gpu_node = GpuNode { radius: (node.spacing * radius_factor) as f32, children: 0 };
            if page.nodes.last() != Some(&gpu_node) {
                page.nodes.push(gpu_node);
            }
            let mut block = PlacedBox { low: run.corner, side: run.side(), step_scale: 1 }.block(&scene.lattice, frame);
            block.node = (page.nodes.len() - 1) as u32;
            block.first_point = page.points.len() as u32;
            block.first_id = next_id;
            page.blocks.push(block);
            page.counts.push(run.points as u32);
            page.points.extend((start..start + run.points).map(|i| run.packed(node, i)));
            start += run.points;
            next_id = next_id.wrapping_add(run.points as u32);
        }
    }
    if page.points.is_empty() { Ok(()) } else { draw(&page) }
}

/// A box of steps on the lattice.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlacedBox {
    pub low: [u64; 3],
    /// In lattice steps.
    pub side: [u64; 3],
    /// Lattice steps that a step of the packed points stands for.
    pub step_scale: u64,
}

impl PlacedBox {
    /// The block's place, as the eye sees it.
    ///
    /// The anchor is the step of the box that is nearest to the eye (in an orthographic view: to the line of sight,
    /// beside the box's middle), since what is seen large is near there, and f32 is fine near there.
    pub fn block(&self, lattice: &Lattice, frame: &Frame) -> GpuBlock {
        let world_corner = lattice.world_from_lattice(LatticePoint(self.low));
        let quantum = lattice.quantum_f64();
        let side: [f64; 3] = self.side.map(|side| side as f64);
        let scale = self.step_scale as f64;
        // From the eye to the corner: the difference of two f64 coordinates, formed before anything is scaled.
        let to_corner = DVec3::from_array(world_corner) - frame.eye;
        let mut to_focus = DVec3::ZERO;
        if !frame.perspective {
            let forward = frame.view_from_relative.row(2);
            let middle = to_corner + DVec3::from_array(std::array::from_fn(|axis| side[axis] * quantum[axis] / 2.0));
            to_focus = forward * forward.dot(middle);
        }
        let focus = (to_focus - to_corner).to_array();
        let anchor_steps: [u32; 3] =
            std::array::from_fn(|axis| ((focus[axis] / quantum[axis]).clamp(0.0, side[axis]) / scale) as u32);
        let steps = anchor_steps.map(|steps| f64::from(steps) * scale);
        let anchor = DVec3::from_array(std::array::from_fn(|axis| steps[axis] * quantum[axis]));
        let view = frame.view_from_relative * (to_corner + anchor);
        let anchor_view = [view.x as f32, view.y as f32, (view.z - frame.front) as f32];
        GpuBlock {
            anchor_steps,
            node: 0,
            anchor_view,
            step_scale: scale as f32,
            first_point: 0,
            first_id: 1,
            bits: 0,
            level: 0,
        }
    }
}

/// Consecutive points of a node whose box is small enough.
struct Run {
    points: usize,
    corner: [u64; 3],
    high: [u64; 3],
}

impl Run {
    /// The longest run from point `start` with at most `room` points; at least one.
    fn starting_at(node: &RenderNode, start: usize, room: usize) -> Self {
        let first = node.positions.point(start).0;
        let mut run = Self { points: 1, corner: first, high: first };
        let end = node.positions.len().min(start + room);
        for i in start + 1..end {
            let point = node.positions.point(i).0;
            let corner: [u64; 3] = std::array::from_fn(|axis| run.corner[axis].min(point[axis]));
            let high: [u64; 3] = std::array::from_fn(|axis| run.high[axis].max(point[axis]));
            if (0..3).any(|axis| high[axis] - corner[axis] > u64::from(u32::MAX)) {
                break;
            }
            run = Self { points: run.points + 1, corner, high };
        }
        run
    }

    fn side(&self) -> [u64; 3] {
        std::array::from_fn(|axis| self.high[axis] - self.corner[axis])
    }

    fn packed(&self, node: &RenderNode, i: usize) -> PackedPoint {
        let point = node.positions.point(i).0;
        let steps = std::array::from_fn(|axis| (point[axis] - self.corner[axis]) as u32);
        PackedPoint { steps, value: u32::from_le_bytes(node.colors[i]) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Camera, Projection};
    use crate::render::RenderOptions;
    use proptest::prelude::*;

    /// Indices that are near each other, or anywhere.
    fn index() -> impl Strategy<Value = u64> {
        prop_oneof![0_u64..1 << 48, (1_u64 << 46)..(1 << 46) + 1000, (0_u64..4).prop_map(|n| n << 32)]
    }

    proptest! {
        #[test]
        fn pages_hold_every_point_exactly_and_in_order(
            nodes in prop::collection::vec(prop::collection::vec([index(), index(), index()], 0..20), 0..5),
            page_points in 1_usize..30,
            page_blocks in 1_usize..5,
            height in prop::option::of(1.0_f64..1e9),
        ) {
            let mut number = 0_u32;
            let nodes: Vec<RenderNode> = nodes.into_iter().map(|points| RenderNode {
                spacing: 1.0,
                colors: points.iter().map(|_| { number += 1; number.to_le_bytes() }).collect(),
                positions: points.into_iter().map(LatticePoint).collect(),
            }).collect();
            let lattice = Lattice::uniform(0.001).unwrap();
            let scene = Scene { lattice, nodes, boxes: Vec::new() };
            let projection = height.map_or(Projection::Perspective { fov_y_rad: 1.0 }, |height| Projection::Orthographic { height });
            let camera = Camera::new(DVec3::new(1.0, 2.0, 3.0), DVec3::ZERO, DVec3::Z, projection, [64, 64]).unwrap();
            let bounds = scene.nodes.iter().filter_map(|node| node.bounds());
            let frame = Frame::new(&scene.lattice, bounds, &camera, &RenderOptions::default(), 64).unwrap();

            let mut unpacked = Vec::new();
            for_each_page(&scene, &frame, 1.0, page_points, page_blocks, |page| {
                assert!(page.points.len() <= page_points && page.blocks.len() <= page_blocks);
                assert_eq!(page.blocks.len(), page.counts.len());
                let mut points = page.points.iter();
                for (block, &count) in page.blocks.iter().zip(&page.counts) {
                    assert!(block.anchor_view.iter().all(|c| c.is_finite()));
                    for point in points.by_ref().take(count as usize) {
                        // Back from the anchor, in view space: within what f32 resolves at that size.
                        let relative: [f64; 3] = std::array::from_fn(|i| {
                            (f64::from(point.steps[i]) - f64::from(block.anchor_steps[i])) * 0.001
                        });
                        let view = frame.view_from_relative * DVec3::from_array(relative);
                        let view = view + DVec3::from_array(block.anchor_view.map(f64::from));
                        unpacked.push((point.value.to_le_bytes(), view + DVec3::Z * frame.front));
                    }
                }
                assert!(points.next().is_none());
                Ok::<(), ()>(())
            }).unwrap();

            let expected: Vec<([u8; 4], LatticePoint)> = scene.nodes.iter()
                .flat_map(|node| node.colors.iter().copied().zip(node.positions.iter())).collect();
            prop_assert_eq!(unpacked.len(), expected.len());
            for ((color, view), (expected_color, point)) in unpacked.into_iter().zip(expected) {
                prop_assert_eq!(color, expected_color);
                let exact = frame.view_from_world(scene.lattice.world_from_lattice(point));
                let error = (view - exact).length();
                prop_assert!(error <= exact.length() * 3e-7 + frame.front * 1e-15 + 1e-6, "{} of {}", error, exact);
            }
        }
    }
}

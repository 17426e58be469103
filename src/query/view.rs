//! Which parts a camera needs: best first, from the rows alone (OCTREE section 7).
//!
//! A node is begun only when its parent is fully taken, and its parts follow in order; the next node is the one whose
//! spacing is largest on the image. The sequence depends on the camera and the pixel threshold, never on the capacity,
//! which only says where it ends.

use super::extent::metric;
use super::gaps::Gap;
use crate::geometry::{Camera, Containment, DVec3, Frustum, WorldBox};
use crate::lattice::{BIAS, BITS, Cube, Lattice, LatticeBox, NodeKey};
use crate::octree::{Metric, Step};
use crate::store::model::NodeHead;
use crate::store::{Node, NodeIx, Nodes, StoreError};
use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

/// The parts chosen for a view, coarse to fine.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Selection {
    /// What to take, in the order of the sequence.
    pub parts: Vec<SelectedPart>,
    /// Points of all parts together.
    pub points: u64,
    /// Every visible point of the store has a selected one within this distance, in CRS units; `None` if nothing is
    /// selected but something is visible.
    pub error_bound: Option<f64>,
    /// The same in pixels, at the centre of the image.
    pub error_bound_px: Option<f64>,
    /// Nodes whose rows were looked at.
    pub nodes_visited: u64,
}

/// A part of a node, or an even thinning of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SelectedPart {
    /// The node.
    pub node: NodeIx,
    /// The part.
    pub part: u32,
    /// How many of its points: the first so many of [`crate::octree::even_order`] over the part.
    pub points: u32,
}

/// Selects for a camera at most `capacity` points, until every node is finer than `max_error_px` on the image.
///
/// Looks at node rows only, a microsecond or so a node once they are loaded.
///
/// # Errors
///
/// [`StoreError::Damaged`] if a row that it looks at is missing or wrong.
pub fn select_view(
    nodes: &Nodes,
    lattice: &Lattice,
    g: u8,
    camera: &Camera,
    max_error_px: f64,
    capacity: Option<u64>,
) -> Result<Selection, StoreError> {
    let cut = ViewCut::new(nodes, lattice, g, camera, max_error_px, |_| Ok::<_, StoreError>(true))?;
    select(&mut { cut }, capacity)
}

/// The first `capacity` points of a cut.
pub(crate) fn select<E: From<StoreError>, F: FnMut(&Node) -> Result<bool, E>>(
    cut: &mut ViewCut<F>,
    capacity: Option<u64>,
) -> Result<Selection, E> {
    let mut selection = Selection::default();
    let mut left = capacity.unwrap_or(u64::MAX);
    while left > 0 {
        let Some((node, part)) = cut.advance()? else { break };
        let all = node.parts[part].points;
        let points = u32::try_from(left).unwrap_or(u32::MAX).min(all);
        if points < all {
            cut.take_back();
        }
        left -= u64::from(points);
        selection.points += u64::from(points);
        selection.parts.push(SelectedPart { node: node.ix(), part: part as u32, points });
    }
    let (bound, bound_px) = cut.bounds(selection.points > 0)?;
    (selection.error_bound, selection.error_bound_px) = (bound, bound_px);
    selection.nodes_visited = cut.visited;
    Ok(selection)
}

/// The state of a best-first cut.
pub(crate) struct ViewCut<'a, F> {
    nodes: &'a Nodes,
    lattice: RelativeLattice,
    g: u8,
    camera: &'a Camera,
    frustum: Frustum,
    max_error_px: f64,
    may: F,
    metric: Metric,
    quantum: f64,
    heap: BinaryHeap<Waiting>,
    /// The cube of the node that was begun first.
    first: Option<Cube>,
    /// The node whose parts are being taken, its distance, and how many parts are taken.
    current: Option<(Node, f64, usize)>,
    /// The largest bounds of what is left below the threshold for good.
    settled: (f64, f64),
    /// The same one by one.
    left: Vec<Gap>,
    /// Cells of this exponent are fine enough, however many pixels they have.
    finest: Option<u8>,
    /// Nodes that were refused, if that is to be told.
    refused: Option<Vec<(Node, Refusal)>>,
    visited: u64,
}

/// Why a node is not taken, apart from a capacity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Refusal {
    /// No place of it is on the image.
    OutOfView,
    /// None of its points can match.
    NoMatch,
    /// What is there is as fine as was asked for.
    FineEnough,
}

/// The nodes of a cut that were not taken.
#[derive(Clone, Debug, Default)]
pub(crate) struct Refusals {
    /// Those that were refused.
    pub refused: Vec<(Node, Refusal)>,
    /// Those that still wait, with the pixels of their spacing.
    pub waiting: Vec<(Node, f64)>,
}

/// A node that is worth taking, whose parent is fully taken.
#[derive(Clone, Debug)]
struct Waiting {
    /// Pixels of its spacing at its nearest point.
    spacing_px: f64,
    k: u8,
    key: Reverse<(NodeKey, u16)>,
    node: Node,
    distance: f64,
}

impl Ord for Waiting {
    fn cmp(&self, other: &Self) -> Ordering {
        self.spacing_px.total_cmp(&other.spacing_px).then(self.k.cmp(&other.k)).then(self.key.cmp(&other.key))
    }
}

impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Waiting {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Waiting {}

impl<'a, E: From<StoreError>, F: FnMut(&Node) -> Result<bool, E>> ViewCut<'a, F> {
    /// Before the first node. Subtrees for which `may` says no are as if they were not there.
    pub fn new(
        nodes: &'a Nodes,
        lattice: &Lattice,
        g: u8,
        camera: &'a Camera,
        max_error_px: f64,
        may: F,
    ) -> Result<Self, E> {
        let roots = nodes.roots()?;
        let mut cut = Self {
            nodes,
            lattice: RelativeLattice::new(lattice, camera.eye()),
            g,
            camera,
            frustum: camera.frustum(),
            max_error_px,
            may,
            metric: metric(lattice, &roots),
            quantum: lattice.largest_quantum(),
            heap: BinaryHeap::new(),
            first: None,
            current: None,
            settled: (0.0, 0.0),
            left: Vec::new(),
            finest: None,
            refused: None,
            visited: 0,
        };
        for root in roots {
            if let Some(distance) = cut.visible(&root)? {
                cut.wait(root, distance);
            }
        }
        Ok(cut)
    }

    /// Begins to note why nodes are refused; to be called before the first part.
    pub fn note_refusals(&mut self) {
        self.refused = Some(Vec::new());
    }

    /// The nodes that were refused since, and those that still wait.
    pub fn refusals(&self) -> Refusals {
        let waiting = self.heap.iter().map(|w| (w.node.clone(), w.spacing_px)).collect();
        Refusals { refused: self.refused.clone().unwrap_or_default(), waiting }
    }

    /// The same, going no finer than cells of this exponent.
    #[must_use]
    pub fn no_finer_than(mut self, cell: Option<u8>) -> Self {
        self.finest = cell;
        self
    }

    /// Is a cell of this exponent fine enough, at this distance?
    fn suffices(&self, cell: i16, distance: f64) -> bool {
        self.finest.is_some_and(|finest| cell <= i16::from(finest))
            || self.spacing_px(cell, distance) <= self.max_error_px
    }

    /// The distance of a subtree from the eye, if any of it can be on the image.
    fn visible(&mut self, node: &Node) -> Result<Option<f64>, E> {
        self.visited += 1;
        let Some(relative) = self.lattice.relative(&node.subtree_bounds) else { return Ok(None) };
        let in_view = self.frustum.classify(&relative) != Containment::Outside;
        let seen = in_view && (self.may)(node)?;
        if let Some(refused) = self.refused.as_mut().filter(|_| !seen) {
            refused.push((node.clone(), if in_view { Refusal::NoMatch } else { Refusal::OutOfView }));
        }
        // What is nearer than the near plane is not seen.
        let near = self.camera.near();
        Ok(seen.then(|| relative.distance_to(DVec3::ZERO).max(near)))
    }

    /// Can a place of this box be on the image?
    pub fn sees(&self, bounds: &LatticeBox) -> bool {
        self.lattice.relative(bounds).is_some_and(|relative| self.frustum.classify(&relative) != Containment::Outside)
    }

    fn spacing_px(&self, cell: i16, distance: f64) -> f64 {
        self.camera.pixels_of_length(2_f64.powi(cell.into()) * self.quantum, distance)
    }

    fn wait(&mut self, node: Node, distance: f64) {
        let k = node.cube.k();
        let spacing_px = self.spacing_px(i16::from(k) - i16::from(self.g), distance);
        self.heap.push(Waiting { spacing_px, k, key: Reverse((node.cube.node_key(), node.layer)), node, distance });
    }

    /// The next part of the sequence.
    pub fn advance(&mut self) -> Result<Option<(Node, usize)>, E> {
        loop {
            if let Some((node, distance, taken)) = self.current.take() {
                if taken == node.parts.len() {
                    if !node.leaf {
                        self.open_children(&node)?;
                    }
                    continue;
                }
                if self.is_fine_enough(&node, taken, distance) {
                    let bound = after_parts(&self.metric, &node, taken);
                    self.left.push(partly_taken(&node, taken, self.g, distance));
                    self.settle(bound, distance);
                    continue;
                }
                self.first.get_or_insert(node.cube);
                self.current = Some((node.clone(), distance, taken + 1));
                return Ok(Some((node, taken)));
            }
            let Some(next) = self.heap.pop() else { return Ok(None) };
            self.current = Some((next.node, next.distance, 0));
        }
    }

    /// Unsays the last [`ViewCut::advance`]: the part is not wholly taken.
    pub fn take_back(&mut self) {
        if let Some((_, _, taken)) = &mut self.current {
            *taken = taken.saturating_sub(1);
        }
    }

    /// Once some parts are taken, is what is left below the threshold?
    fn is_fine_enough(&self, head: &NodeHead, taken: usize, distance: f64) -> bool {
        let step = taken.checked_sub(1).and_then(|last| head.parts[last].last_step);
        step.is_some_and(|Step { win, group }| {
            let cell = i16::from(win) + i16::from(group < 3);
            self.suffices(cell, distance)
        })
    }

    fn open_children(&mut self, node: &Node) -> Result<(), E> {
        let cell = i16::from(node.cube.k()) - i16::from(self.g);
        for child in self.nodes.children(node)? {
            let Some(distance) = self.visible(&child)? else { continue };
            if !self.suffices(cell, distance) {
                self.wait(child, distance);
            } else {
                self.left.push(not_begun(&child, self.g, distance));
                if let Some(refused) = &mut self.refused {
                    refused.push((child, Refusal::FineEnough));
                }
                self.settle(self.metric.step_bound(cell as i8, 7), distance);
            }
        }
        Ok(())
    }

    fn settle(&mut self, bound: f64, distance: f64) {
        let px = self.camera.pixels_of_length(bound, distance);
        self.settled = (self.settled.0.max(bound), self.settled.1.max(px));
    }

    /// The bounds of what has been taken so far, in CRS units and in pixels; `any`: at least one point was.
    pub fn bounds(&self, any: bool) -> Result<(Option<f64>, Option<f64>), E> {
        let mut bounds = self.settled;
        let mut include = |bound: f64, distance: f64| {
            bounds.0 = bounds.0.max(bound);
            bounds.1 = bounds.1.max(self.camera.pixels_of_length(bound, distance));
        };
        for waiting in &self.heap {
            let bound = if waiting.node.is_root() {
                let Some(first) = self.first.filter(|_| any) else { return Ok((None, None)) };
                not_begun_root(&self.metric, &waiting.node, first)
            } else {
                self.metric.step_bound(waiting.k as i8 + 1 - self.g as i8, 7)
            };
            include(bound, waiting.distance);
        }
        if let Some((head, distance, taken)) = &self.current {
            let (distance, taken) = (*distance, *taken);
            if taken < head.parts.len() {
                if !any {
                    return Ok((None, None));
                }
                include(after_parts(&self.metric, head, taken), distance);
            } else if !head.leaf {
                let cell = head.cube.k() as i8 - self.g as i8;
                for child in self.nodes.children(head)? {
                    // Whether it is visible was not asked yet: assume that it is.
                    let relative = self.lattice.relative(&child.subtree_bounds);
                    let distance = relative.map_or(0.0, |r| r.distance_to(DVec3::ZERO));
                    include(self.metric.step_bound(cell, 7), distance.max(self.camera.near()));
                }
            }
        }
        Ok((Some(bounds.0), Some(bounds.1).filter(|px| px.is_finite())))
    }

    /// Where not everything was taken.
    pub fn gaps(&self) -> Vec<Gap> {
        let mut gaps = self.left.clone();
        gaps.extend(self.heap.iter().map(|w| not_begun(&w.node, self.g, w.distance)));
        if let Some((head, distance, taken)) = &self.current {
            let (distance, taken) = (*distance, *taken);
            if taken < head.parts.len() {
                gaps.push(match complete_step(head, taken) {
                    Some(_) => partly_taken(head, taken, self.g, distance),
                    None => not_begun(head, self.g, distance),
                });
            } else if !head.leaf && head.children != 0 {
                let cell = head.cube.k().saturating_sub(self.g);
                gaps.push(Gap { node: head.ix(), cube: head.cube, layer: head.layer, cell: Some(cell), distance });
            }
        }
        gaps
    }

    /// Is there nothing that the threshold or the capacity left out? Repeated positions are, too: the filter may have left out
    /// what stands for them.
    pub fn is_complete(&self) -> bool {
        let done =
            |(node, _, taken): &(Node, f64, usize)| *taken == node.parts.len() && (node.leaf || node.children == 0);
        self.heap.is_empty() && self.current.as_ref().is_none_or(done) && self.left.is_empty()
    }

    /// Nodes whose rows were looked at.
    pub fn visited(&self) -> u64 {
        self.visited
    }
}

/// The last step that is complete once the first `taken` parts of a node are there.
fn complete_step(head: &NodeHead, taken: usize) -> Option<Step> {
    head.parts[..taken].iter().rev().find_map(|p| p.last_step)
}

/// A node of which the first parts are there.
fn partly_taken(head: &Node, taken: usize, g: u8, distance: f64) -> Gap {
    // After the last group of a step all cells of its size have their first point, after another those of twice the size.
    let cell = complete_step(head, taken).map(|s| (i16::from(s.win) + i16::from(s.group < 3)).max(0) as u8);
    let of_parent = (head.cube.k() + 1).saturating_sub(g);
    Gap { node: head.ix(), cube: head.cube, layer: head.layer, cell: Some(cell.unwrap_or(of_parent)), distance }
}

/// A node of which nothing is there; its parent, if it is no root, is taken.
fn not_begun(head: &Node, g: u8, distance: f64) -> Gap {
    let cell = (!head.is_root()).then(|| (head.cube.k() + 1).saturating_sub(g));
    Gap { node: head.ix(), cube: head.cube, layer: head.layer, cell, distance }
}

/// The bound of a layer of which nothing is there, but a point in the cube `begun`, of another layer: both lie in one cube.
pub(crate) fn not_begun_root(metric: &Metric, root: &NodeHead, begun: Cube) -> f64 {
    let k = root.cube.k().max(begun.k());
    let around = (k..=BITS).find(|&k| root.cube.ancestor(k) == begun.ancestor(k)).unwrap_or(BITS);
    // No less than what holds once the root is begun.
    metric.step_bound(around as i8, 7).max(after_parts(metric, root, 0))
}

/// The bound once the first `taken` parts of a node are there, and of the next nothing for sure.
pub(crate) fn after_parts(metric: &Metric, head: &NodeHead, taken: usize) -> f64 {
    match (complete_step(head, taken), head.parts.first()) {
        (Some(step), _) => metric.after(step),
        (None, Some(first)) => metric.before(first.first_step),
        (None, None) => 0.0,
    }
}

/// Lattice coordinates relative to an eye, without the loss that world coordinates would bring.
pub(crate) struct RelativeLattice {
    /// A lattice point near the eye, and the eye minus its world coordinates.
    anchor: [i64; 3],
    rest: [f64; 3],
    quantum: [f64; 3],
}

impl RelativeLattice {
    pub fn new(lattice: &Lattice, eye: DVec3) -> Self {
        let anchor: [i64; 3] = std::array::from_fn(|i| {
            let beyond = if eye[i] < lattice.world_on_axis(i, BIAS as u64) { 0 } else { (1 << BITS) - 1 };
            lattice.nearest_index(i, eye[i]).unwrap_or(beyond) as i64
        });
        let rest = std::array::from_fn(|i| eye[i] - lattice.world_on_axis(i, anchor[i] as u64));
        Self { anchor, rest, quantum: lattice.quantum_f64() }
    }

    pub fn relative(&self, bounds: &LatticeBox) -> Option<WorldBox> {
        let corner = |p: [u64; 3]| {
            std::array::from_fn(|i| (p[i] as i64 - self.anchor[i]) as f64 * self.quantum[i] - self.rest[i])
        };
        WorldBox::new(corner(bounds.min.0), corner(bounds.max.0))
    }
}

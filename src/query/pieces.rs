//! A store cut into aligned cubes in key order, each small enough for one task: where a thinned answer is found piece by
//! piece, so that no more of it is in memory than a few pieces have.
//!
//! From the root down, cubes are taken apart as long as much lies below them. The nodes of those cubes, the *large* ones,
//! lie above several pieces; each is read once, when a piece first asks for it. Layers are taken apart together.

use super::QueryError;
use super::cells::{Level, Pick, read_node};
use super::plan::{Plan, Prospect, Scope};
use crate::geometry::Containment;
use crate::lattice::{Cube, Key};
use crate::store::Node;
use std::sync::{Arc, Mutex, PoisonError};

/// A cube below which there are at most as many points as in so many full leaves is one piece.
const PIECE_LEAVES: u64 = 5;

/// What is one layer's in a cube.
#[derive(Clone)]
pub(crate) struct Tree {
    /// The root of the layer.
    pub root: Cube,
    /// The topmost node in the cube.
    pub node: Option<Node>,
    /// The node above it, which is a large one.
    pub above: Option<Arc<Above>>,
}

/// An aligned cube with its points, and those that the nodes above it have there.
pub(crate) struct Piece {
    pub cube: Cube,
    pub trees: Vec<Tree>,
}

impl Piece {
    /// Points that are stored in it, the nodes above left out; of one whose nodes are much finer than the level asked
    /// for as many as a piece has at most.
    pub fn points(&self, plan: &Plan) -> u64 {
        points(&self.trees).min(most(plan))
    }
}

/// A node above pieces.
pub(crate) struct Above {
    node: Node,
    root: Cube,
    parent: Option<Arc<Self>>,
    read: Mutex<Option<Arc<Known>>>,
}

/// What a large node gives to a level. Ascending.
pub(crate) struct Known {
    pub picks: Vec<Pick>,
    /// The cells with a point that does not match, by their least key.
    pub missed: Vec<Key>,
}

impl Above {
    /// The node and those above it, the root first.
    pub fn path(this: Option<&Arc<Self>>) -> Vec<&Self> {
        let mut path: Vec<&Self> = std::iter::successors(this.map(|a| &**a), |a| a.parent.as_deref()).collect();
        path.reverse();
        path
    }

    /// Read by who asks first; the others wait.
    pub fn known(&self, plan: &Plan, c: Option<u8>) -> Result<Arc<Known>, QueryError> {
        let mut read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = &*read {
            return Ok(known.clone());
        }
        let mut level = Level::default();
        read_node(plan, &self.node, self.root, c, &mut level)?;
        let mut picks = Vec::new();
        level.readings.iter().for_each(|r| r.picks(&mut picks));
        // Runs that ascend are merged.
        picks.sort();
        level.missed.sort_unstable();
        level.missed.dedup();
        Ok(read.insert(Arc::new(Known { picks, missed: level.missed })).clone())
    }
}

fn most(plan: &Plan) -> u64 {
    PIECE_LEAVES * u64::from(plan.snapshot.site().leaf_capacity)
}

fn points(trees: &[Tree]) -> u64 {
    trees.iter().filter_map(|t| t.node.as_ref()).map(|n| n.subtree_points).sum()
}

/// Does the cube belong to one piece? Below the nodes that sample on cells of exponent `c` only holes are filled.
fn is_piece(plan: &Plan, c: Option<u8>, cube: Cube, trees: &[Tree]) -> bool {
    c.is_some_and(|c| i16::from(cube.k()) <= i16::from(c) + i16::from(plan.g))
        || cube.k() == 0
        || trees.iter().filter_map(|t| t.node.as_ref()).all(|n| n.leaf)
        || points(trees) <= most(plan)
}

/// The pieces of a store, in key order. They are disjoint, and all matching points lie in them.
pub(crate) struct Pieces {
    c: Option<u8>,
    /// Cubes that are still to come, the next one last.
    open: Vec<(Cube, Vec<Tree>)>,
}

impl Pieces {
    /// For a level of cells of exponent `c`, or for all points.
    pub fn new(plan: &Plan, c: Option<u8>) -> Self {
        let tree = |root: &Node| Tree { root: root.cube, node: Some(root.clone()), above: None };
        let trees: Vec<Tree> = plan.roots.iter().map(tree).collect();
        Self { c, open: plan.root().map(|cube| (cube, trees)).into_iter().collect() }
    }

    /// The next piece in which something may match.
    pub fn next(&mut self, plan: &Plan) -> Result<Option<Piece>, QueryError> {
        while let Some((cube, mut trees)) = self.open.pop() {
            plan.cancel.check()?;
            if plan.region.classify(&cube.to_box()) == Containment::Outside {
                continue;
            }
            for tree in &mut trees {
                if let Some(node) = &tree.node
                    && plan.prospect(node, Scope::Subtree)? == Prospect::Nothing
                {
                    tree.node = None;
                }
            }
            trees.retain(|tree| tree.node.is_some() || tree.above.is_some());
            if trees.is_empty() {
                continue;
            }
            if is_piece(plan, self.c, cube, &trees) {
                return Ok(Some(Piece { cube, trees }));
            }
            self.open_below(plan, cube, &trees)?;
        }
        Ok(None)
    }

    /// Takes a cube apart.
    fn open_below(&mut self, plan: &Plan, cube: Cube, trees: &[Tree]) -> Result<(), QueryError> {
        let octants = cube.octants_in_key_order().map(|octant| cube.child(octant));
        let first = self.open.len();
        self.open.extend(octants.into_iter().flatten().map(|cube| (cube, Vec::new())));
        let below = &mut self.open[first..];
        for Tree { root, node, above } in trees {
            match node {
                // Its children, or what it and those above it have where it has none.
                Some(node) if node.cube == cube => {
                    let (node, root, parent) = (node.clone(), *root, above.clone());
                    let children: Vec<Node> = plan.nodes.children(&node)?.collect();
                    let above = Arc::new(Above { node, root, parent, read: Mutex::default() });
                    for (cube, trees) in &mut *below {
                        let node = children.iter().find(|child| child.cube == *cube).cloned();
                        trees.push(Tree { root, node, above: Some(above.clone()) });
                    }
                }
                // A root further down.
                Some(node) => {
                    let tree = Tree { root: *root, node: Some(node.clone()), above: None };
                    let inside = below.iter_mut().find(|(cube, _)| cube.contains_cube(node.cube));
                    inside.into_iter().for_each(|(_, trees)| trees.push(tree.clone()));
                }
                None => {
                    let tree = Tree { root: *root, node: None, above: above.clone() };
                    below.iter_mut().for_each(|(_, trees)| trees.push(tree.clone()));
                }
            }
        }
        below.reverse();
        Ok(())
    }
}

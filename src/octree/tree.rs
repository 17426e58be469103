//! A tree that changes in place: how it is built, and what insert and remove share.

use super::nodes::{Nodes, Row, TreePoint};
use super::{Params, root_of, wins};
use crate::lattice::{Cube, Key, LatticeBox};
use rayon::prelude::*;

/// Points that are worth other threads' while.
pub(super) const SPREAD: usize = if cfg!(test) { 8 } else { 2048 };

/// The canonical tree of a set of points, on any storage of nodes. After every change it is the tree that building it
/// from its points would give.
#[derive(Clone, Debug)]
pub struct Tree<S> {
    pub(super) params: Params,
    pub(super) root: Option<Cube>,
    pub(super) nodes: S,
}

impl<S: Nodes> Tree<S> {
    /// The tree that is in `nodes`, with its root.
    pub fn existing(params: Params, root: Option<Cube>, nodes: S) -> Self {
        Self { params, root, nodes }
    }

    /// The parameters of the sampling rule.
    #[cfg(test)]
    pub(super) fn params(&self) -> Params {
        self.params
    }

    /// The root's cube; `None` if there are no points.
    pub fn root(&self) -> Option<Cube> {
        self.root
    }

    /// The storage.
    pub fn nodes(&self) -> &S {
        &self.nodes
    }

    /// Writes the tree of `points` into a storage without nodes.
    pub(super) fn rebuild(&mut self, mut points: Vec<S::Point>) -> Result<(), S::Error> {
        points.sort();
        self.root = bounds_of(&points).map(|bounds| root_of(&bounds, self.params));
        if let Some(root) = self.root {
            let keys: Vec<Key> = points.iter().map(TreePoint::key).collect();
            let wins = wins(&keys, root.k() as i8);
            self.build(root, &points, &wins, i8::MAX)?;
        }
        Ok(())
    }

    /// Writes the nodes of a run of points, of which those with `win >= taken` are stored above.
    pub(super) fn build(&self, cube: Cube, run: &[S::Point], wins: &[i8], taken: i8) -> Result<(), S::Error> {
        let rem = wins.iter().filter(|&&w| w < taken).count() as u64;
        if rem == 0 {
            return Ok(());
        }
        let leaf = self.params.is_leaf(cube.k(), rem);
        let cell = self.params.cell(cube.k());
        let here = |win: i8| win < taken && (leaf || win >= cell);
        let own = run.iter().zip(wins).filter(|(_, w)| here(**w)).map(|(p, _)| p.clone()).collect();
        self.nodes.write(cube, leaf, rem, own)?;
        if leaf {
            return Ok(());
        }
        let below = |child: Cube| {
            let range = run_inside(run, TreePoint::key, child);
            self.build(child, &run[range.clone()], &wins[range], cell)
        };
        if run.len() < SPREAD {
            return children(cube).try_for_each(below);
        }
        children(cube).collect::<Vec<_>>().into_par_iter().try_for_each(below)
    }

    /// The own points of a node; not a read if it has none.
    pub(super) fn own(&self, cube: Cube, row: Row) -> Result<Vec<S::Point>, S::Error> {
        if row.own == 0 { Ok(Vec::new()) } else { self.nodes.read(cube) }
    }

    /// Deletes a node and all below it; their points, ascending.
    pub(super) fn take_subtree(&self, cube: Cube) -> Result<Vec<S::Point>, S::Error> {
        let mut points = Vec::new();
        let mut open = vec![cube];
        while let Some(cube) = open.pop() {
            let Some(row) = self.nodes.row(cube)? else { continue };
            points.extend(self.own(cube, row)?);
            self.nodes.delete(cube)?;
            if !row.leaf {
                open.extend(children(cube));
            }
        }
        points.sort();
        Ok(points)
    }
}

/// The children's cubes, in key order.
pub(super) fn children(cube: Cube) -> impl Iterator<Item = Cube> {
    cube.octants_in_key_order().into_iter().filter_map(move |octant| cube.child(octant))
}

/// Which of `sorted` lie inside `cube`.
pub(super) fn run_inside<T>(sorted: &[T], key: impl Fn(&T) -> Key, cube: Cube) -> std::ops::Range<usize> {
    let (first, last) = (cube.first_key(), cube.last_key());
    sorted.partition_point(|t| key(t) < first)..sorted.partition_point(|t| key(t) <= last)
}

/// Two ascending lists as one; of equals those of `a` come first.
pub(super) fn merged<T: Ord + Clone>(a: &[T], b: &[T]) -> Vec<T> {
    let mut both = Vec::with_capacity(a.len() + b.len());
    let mut rest = b;
    for item in a {
        let before = rest.iter().take_while(|other| *other < item).count();
        both.extend_from_slice(&rest[..before]);
        both.push(item.clone());
        rest = &rest[before..];
    }
    both.extend_from_slice(rest);
    both
}

/// Tight bounds; `None` without points.
pub(super) fn bounds_of<P: TreePoint>(points: &[P]) -> Option<LatticeBox> {
    points.iter().map(|p| LatticeBox::of(p.key().point())).reduce(|a, b| a.union(&b))
}

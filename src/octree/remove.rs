//! Points out of a tree (OCTREE section 4).

use super::nodes::{Nodes, TreePoint};
use super::root_of;
use super::tree::{SPREAD, Tree, children, merged, run_inside};
use crate::lattice::{BITS, Cube, Key};
use rayon::prelude::*;

/// Which points are to go.
pub trait Doomed<S: Nodes>: Sync {
    /// At most how many of them are stored in the node of `cube`, from its row alone; 0 only if there are none.
    ///
    /// # Errors
    ///
    /// The storage's.
    fn own(&self, nodes: &S, cube: Cube) -> Result<u64, S::Error>;
    /// The same for the node and all below it.
    ///
    /// # Errors
    ///
    /// The storage's.
    fn subtree(&self, nodes: &S, cube: Cube) -> Result<u64, S::Error>;
    /// Is this stored point to go? Asked once for each point met.
    fn takes(&self, point: &S::Point) -> bool;
}

impl<S: Nodes> Tree<S> {
    /// Removes points; how many went.
    ///
    /// Reads the points of nodes that lose some; of nodes whose cube holds a position that lost its point there or
    /// above, all the way down; of what collapses into a leaf; and, if the root shrinks, of the nodes that are given up
    /// and of the new root.
    ///
    /// # Errors
    ///
    /// The storage's.
    pub fn remove(&mut self, doomed: &impl Doomed<S>) -> Result<u64, S::Error> {
        let Some(root) = self.root else { return Ok(0) };
        // The cells that the root's points win are those that hold any point.
        let may_shrink = doomed.own(&self.nodes, root)? > 0;
        let gone = self.withdraw(root, &[], doomed)?;
        if gone > 0 {
            self.collapse(root)?;
            if self.nodes.row(root)?.is_none() {
                self.root = None;
            } else if may_shrink {
                self.shrink()?;
            }
        }
        Ok(gone)
    }

    /// Removes from the node of `cube` and below, and pulls points up into the cells that lost their owner there;
    /// `vacated` are the positions of points removed from proper ancestors, inside the cube, ascending.
    fn withdraw(&self, cube: Cube, vacated: &[Key], doomed: &impl Doomed<S>) -> Result<u64, S::Error> {
        let Some(row) = self.nodes.row(cube)? else { return Ok(0) };
        let below = doomed.subtree(&self.nodes, cube)?;
        if vacated.is_empty() && below == 0 {
            return Ok(0);
        }
        let (mut lost, mut points) = (Vec::new(), Vec::new());
        if !vacated.is_empty() || doomed.own(&self.nodes, cube)? > 0 {
            let own = self.own(cube, row)?;
            (lost, points) = own.into_iter().partition(|p| doomed.takes(p));
        }
        let mut gone = lost.len() as u64;
        if row.leaf {
            if gone > 0 {
                self.nodes.write(cube, true, row.rem.saturating_sub(gone), points)?;
            }
            return Ok(gone);
        }
        let lost: Vec<Key> = lost.iter().map(TreePoint::key).collect();
        let vacated = merged(vacated, &lost);
        let repair = |child: Cube| {
            let vacated = &vacated[run_inside(&vacated, |k| *k, child)];
            // A child is repaired before points are pulled from it, and has its leaf test after.
            let gone = self.withdraw(child, vacated, doomed)?;
            let pulled = match vacated {
                [] => Vec::new(),
                vacated => self.pull(child, vacated, self.params.cell(cube.k()))?,
            };
            self.collapse(child)?;
            Ok((gone, pulled))
        };
        let repaired: Vec<(u64, Vec<S::Point>)> = if below + (vacated.len() as u64) < SPREAD as u64 {
            children(cube).map(repair).collect::<Result<_, _>>()?
        } else {
            children(cube).collect::<Vec<_>>().into_par_iter().map(repair).collect::<Result<_, _>>()?
        };
        gone += repaired.iter().map(|(gone, _)| gone).sum::<u64>();
        // In key order, as the children are.
        let pulled: Vec<S::Point> = repaired.into_iter().flat_map(|(_, pulled)| pulled).collect();
        let rem = row.rem.saturating_sub(gone);
        if lost.is_empty() && pulled.is_empty() {
            self.nodes.set_rem(cube, rem)?;
        } else {
            self.nodes.write(cube, false, rem, merged(&points, &pulled))?;
        }
        Ok(gone)
    }

    /// Takes from the node of `child` its first point in each cell of exponent `cell` that holds a vacated position.
    fn pull(&self, child: Cube, vacated: &[Key], cell: i8) -> Result<Vec<S::Point>, S::Error> {
        let Some(row) = self.nodes.row(child)? else { return Ok(Vec::new()) };
        let cell = u8::try_from(cell).unwrap_or(0).min(BITS);
        let mut open = vacated.iter().map(|key| key.prefix(cell)).peekable();
        let (pulled, rest): (Vec<_>, Vec<_>) = self.own(child, row)?.into_iter().partition(|p| {
            let prefix = p.key().prefix(cell);
            while open.next_if(|v| *v < prefix).is_some() {}
            // The cell's first point takes all of its vacancies.
            let first = open.peek() == Some(&prefix);
            while open.next_if_eq(&prefix).is_some() {}
            first
        });
        if !pulled.is_empty() {
            self.nodes.write(child, row.leaf, row.rem.saturating_sub(pulled.len() as u64), rest)?;
        }
        Ok(pulled)
    }

    /// The leaf test of a node that may have lost points: deleted without any, a leaf with few.
    fn collapse(&self, cube: Cube) -> Result<(), S::Error> {
        match self.nodes.row(cube)? {
            Some(row) if row.rem == 0 => self.nodes.delete(cube),
            Some(row) if !row.leaf && self.params.is_leaf(cube.k(), row.rem) => {
                let points = self.take_subtree(cube)?;
                self.nodes.write(cube, true, row.rem, points)
            }
            _ => Ok(()),
        }
    }

    /// Makes the smallest possible cube the root, if it is not.
    fn shrink(&mut self) -> Result<(), S::Error> {
        let Some(old) = self.root else { return Ok(()) };
        let Some(row) = self.nodes.row(old)? else { return Ok(()) };
        let own = self.own(old, row)?;
        if let (Some(first), Some(last)) = (own.first(), own.last())
            && (old.k() == self.params.g || old.octant_of(first.key().point()) != old.octant_of(last.key().point()))
        {
            return Ok(());
        }
        let Some(bounds) = self.nodes.bounds(old)? else { return Ok(()) };
        let root = root_of(&bounds, self.params);
        if root == old {
            return Ok(());
        }
        // All points are inside the new root, so the nodes above it are a chain, and what they store goes to it.
        let mut moved = Vec::new();
        let mut chain = Some(old);
        while let Some(cube) = chain.take() {
            let Some(row) = self.nodes.row(cube)? else { break };
            moved.extend(self.own(cube, row)?);
            self.nodes.delete(cube)?;
            if !row.leaf {
                chain = cube.child(cube.octant_of(root.low())).filter(|child| *child != root);
            }
        }
        match self.nodes.row(root)? {
            Some(row) if !row.leaf && root.k() > self.params.g => {
                let rem = row.rem + moved.len() as u64;
                let own = self.own(root, row)?;
                moved.sort();
                self.nodes.write(root, false, rem, merged(&own, &moved))?;
                self.root = Some(root);
                Ok(())
            }
            _ => {
                let below = self.take_subtree(root)?;
                self.rebuild([below, moved].concat())
            }
        }
    }
}

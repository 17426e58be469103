//! Points into an existing tree (OCTREE section 3).

use super::nodes::{Nodes, Row, TreePoint};
use super::root_of;
use super::tree::{Tree, bounds_of, children, merged, run_inside};
use crate::lattice::{BITS, Cube, Key};

impl<S: Nodes> Tree<S> {
    /// Adds points, in any order.
    ///
    /// Reads the points of nodes that receive at least one; of the old root if the root grows; and, where the old root or
    /// a node above it turns out to be a leaf, of what lies below it.
    ///
    /// # Errors
    ///
    /// The storage's.
    pub fn insert(&mut self, mut batch: Vec<S::Point>) -> Result<(), S::Error> {
        let Some(bounds) = bounds_of(&batch) else { return Ok(()) };
        batch.sort();
        let Some(old) = self.root else { return self.insert_at(root_of(&bounds, self.params), batch, None) };
        let root = root_of(&bounds.union(&old.to_box()), self.params);
        if root == old {
            return self.insert_at(root, batch, None);
        }
        let remaining = self.grow(old, root, &mut batch)?;
        batch.sort();
        self.insert_at(root, batch, remaining)
    }

    fn insert_at(&mut self, root: Cube, batch: Vec<S::Point>, old: Option<Cube>) -> Result<(), S::Error> {
        self.root = Some(root);
        self.settle(root, batch, &[], old)
    }

    /// Prepares the growth of the root from `old` to `root`: the points of the old root that may move up join the batch.
    /// The old root, under a new chain of nodes without points, if anything remains there.
    fn grow(&mut self, old: Cube, root: Cube, batch: &mut Vec<S::Point>) -> Result<Option<Cube>, S::Error> {
        let Some(row) = self.nodes.row(old)? else { return Ok(None) };
        let points = self.own(old, row)?;
        if row.leaf {
            batch.extend(points);
            self.nodes.delete(old)?;
            return Ok(None);
        }
        // Winners are nested: whatever wins a cell coarser than the old root's is the first of its points in that cell.
        let (up, stay) = first_of_cells(points, &[], self.params.cell(old.k()) + 1);
        let rem = row.rem.saturating_sub(up.len() as u64);
        batch.extend(up);
        if rem == 0 {
            self.nodes.delete(old)?;
            return Ok(None);
        }
        self.nodes.write(old, false, rem, stay)?;
        for k in old.k() + 1..=root.k() {
            self.nodes.write(old.ancestor(k), false, rem, Vec::new())?;
        }
        Ok(Some(old))
    }

    /// Places `incoming`, ascending, at or below `cube`. `above` are the keys of the points stored in its proper ancestors
    /// and inside it, `old` the former root where the root has grown: it and the chain above need their leaf test.
    fn settle(
        &mut self,
        cube: Cube,
        incoming: Vec<S::Point>,
        above: &[Key],
        old: Option<Cube>,
    ) -> Result<(), S::Error> {
        let found = self.nodes.row(cube)?;
        let row = found.unwrap_or(Row { leaf: true, rem: 0, own: 0 });
        let rem = row.rem + incoming.len() as u64;
        if self.params.is_leaf(cube.k(), rem) {
            let points = if row.leaf { self.own(cube, row)? } else { self.take_subtree(cube)? };
            return match (rem, found) {
                (0, None) => Ok(()),
                (0, Some(_)) => self.nodes.delete(cube),
                _ => self.nodes.write(cube, true, rem, merged(points, incoming)),
            };
        }
        let old_below = |child: &Cube| old.is_some_and(|old| child.contains_cube(old));
        if incoming.is_empty() && !row.leaf {
            return match children(cube).find(old_below) {
                Some(child) => self.settle(child, incoming, &[], old),
                None => Ok(()),
            };
        }
        let points = merged(self.own(cube, row)?, incoming);
        let (kept, mut down) = first_of_cells(points, above, self.params.cell(cube.k()));
        let above = merged(above.to_vec(), kept.iter().map(TreePoint::key));
        self.nodes.write(cube, false, rem, kept)?;
        for child in children(cube) {
            let rest = down.split_off(run_inside(&down, TreePoint::key, child).end);
            let incoming = std::mem::replace(&mut down, rest);
            if !incoming.is_empty() || old_below(&child) {
                self.settle(child, incoming, &above[run_inside(&above, |k| *k, child)], old)?;
            }
        }
        Ok(())
    }
}

/// Parts ascending points into the first of every cell of exponent `cell` where `above` has none, and the others.
fn first_of_cells<P: TreePoint>(points: Vec<P>, above: &[Key], cell: i8) -> (Vec<P>, Vec<P>) {
    let cell = u8::try_from(cell).unwrap_or(0).min(BITS);
    let mut owner = None;
    let mut above = above.iter().map(|key| key.prefix(cell)).peekable();
    points.into_iter().partition(|p| {
        let prefix = p.key().prefix(cell);
        while above.next_if(|a| *a < prefix).is_some() {}
        above.peek() != Some(&prefix) && owner.replace(prefix) != Some(prefix)
    })
}

//! Points into an existing tree (OCTREE section 3).

use super::nodes::{Nodes, Row, TreePoint};
use super::tree::{SPREAD, Tree, children, merged, run_inside};
use crate::lattice::{BITS, Cube, Key, SortKey};
use rayon::prelude::*;

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
        batch.sort();
        let (Some(first), Some(last)) = (batch.first().map(TreePoint::key), batch.last().map(TreePoint::key)) else {
            return Ok(());
        };
        // The smallest cube around the first and the last of a run of keys holds all between.
        let spanning = |first: Key, last: Key| Cube::spanning(first.point(), last.point(), self.params.g);
        let (root, remaining) = match self.root {
            None => (spanning(first, last), None),
            Some(old) => {
                let root = spanning(first.min(old.first_key()), last.max(old.last_key()));
                (root, if root == old { None } else { self.grow(old, root, &mut batch)? })
            }
        };
        // What was in order is passed over quickly.
        batch.sort();
        self.root = Some(root);
        self.settle(root, &batch, &[], remaining)
    }

    /// Prepares the growth of the root from `old` to `root`: the points of the old root that may move up join the batch.
    /// The old root, under a new chain of nodes without points, if anything remains there.
    fn grow(&self, old: Cube, root: Cube, batch: &mut Vec<S::Point>) -> Result<Option<Cube>, S::Error> {
        let Some(row) = self.nodes.row(old)? else { return Ok(None) };
        let points = self.own(old, row)?;
        if row.leaf {
            batch.extend(points);
            self.nodes.delete(old)?;
            return Ok(None);
        }
        // Winners are nested: whatever wins a cell coarser than the old root's is the first of its points in that cell.
        let (up, stay) = first_of_cells(&points, &[], &[], self.params.cell(old.k()) + 1);
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
    fn settle(&self, cube: Cube, incoming: &[S::Point], above: &[Key], old: Option<Cube>) -> Result<(), S::Error> {
        let found = self.nodes.row(cube)?;
        let row = found.unwrap_or(Row { leaf: true, rem: 0, own: 0 });
        let rem = row.rem + incoming.len() as u64;
        if self.params.is_leaf(cube.k(), rem) {
            let points = if row.leaf { self.own(cube, row)? } else { self.take_subtree(cube)? };
            return match (rem, found) {
                (0, None) => Ok(()),
                (0, Some(_)) => self.nodes.delete(cube),
                _ => self.nodes.write(cube, true, rem, merged(&points, incoming)),
            };
        }
        if found.is_none() {
            return self.build(cube, incoming, &wins_after(above, incoming), i8::MAX);
        }
        let old_below = |child: &Cube| old.is_some_and(|old| child.contains_cube(old));
        if incoming.is_empty() && !row.leaf {
            return match children(cube).find(old_below) {
                Some(child) => self.settle(child, incoming, &[], old),
                None => Ok(()),
            };
        }
        let (kept, down) = first_of_cells(&self.own(cube, row)?, incoming, above, self.params.cell(cube.k()));
        let keys: Vec<Key> = kept.iter().map(TreePoint::key).collect();
        let above = merged(above, &keys);
        self.nodes.write(cube, false, rem, kept)?;
        let below = |child: Cube| (child, &down[run_inside(&down, TreePoint::key, child)]);
        let visited = children(cube).map(below).filter(|(child, down)| !down.is_empty() || old_below(child));
        let settle = |(child, down): (Cube, &[S::Point])| {
            self.settle(child, down, &above[run_inside(&above, |k| *k, child)], old)
        };
        if down.len() < SPREAD {
            let mut visited = visited;
            return visited.try_for_each(settle);
        }
        visited.collect::<Vec<_>>().into_par_iter().try_for_each(settle)
    }
}

/// The wins of ascending points among themselves and the points above them with these keys, ascending, too: an
/// ancestor's point comes before all others of its cell.
fn wins_after<P: TreePoint>(above: &[Key], points: &[P]) -> Vec<i8> {
    let mut above = above.iter().peekable();
    let mut last: Option<Key> = None;
    let win = |point: &P| {
        let key = point.key();
        while let Some(key) = above.next_if(|above| **above <= key) {
            last = Some(*key);
        }
        // Without any before it, it wins whatever cell is asked for.
        let win = last.map_or(BITS as i8, |last| last.differing_digit(key));
        last = Some(key);
        win
    };
    points.iter().map(win).collect()
}

/// Parts two ascending runs of points into the first of every cell of exponent `cell` where `above` has none, and the
/// others.
fn first_of_cells<P: TreePoint>(own: &[P], incoming: &[P], above: &[Key], cell: i8) -> (Vec<P>, Vec<P>) {
    let cell = u8::try_from(cell).unwrap_or(0).min(BITS);
    let (mut own, mut incoming, mut above) = (own, incoming, above);
    let (mut first, mut others) = (Vec::with_capacity(own.len()), Vec::with_capacity(incoming.len()));
    // Cell by cell: where they are large, most of a cell's points go down as they lie.
    loop {
        let next = match (own.first(), incoming.first()) {
            (Some(a), Some(b)) => a.key().min(b.key()),
            (Some(point), None) | (None, Some(point)) => point.key(),
            (None, None) => return (first, others),
        };
        let prefix = next.prefix(cell);
        let mut ours = take_cell(&mut own, TreePoint::key, prefix, cell);
        let mut new = take_cell(&mut incoming, TreePoint::key, prefix, cell);
        above = &above[leading(above, |key| key.prefix(cell) < prefix)..];
        let is_free = above.first().is_none_or(|key| key.prefix(cell) != prefix);
        if is_free {
            let from = match (ours.first(), new.first()) {
                (Some(a), Some(b)) if b < a => &mut new,
                (Some(_), _) => &mut ours,
                (None, _) => &mut new,
            };
            if let Some((least, rest)) = from.split_first() {
                first.push(least.clone());
                *from = rest;
            }
        }
        match (ours, new) {
            (all, []) | ([], all) => others.extend_from_slice(all),
            (ours, new) => others.append(&mut merged(ours, new)),
        }
    }
}

/// Takes the leading run of one cell.
fn take_cell<'p, P>(points: &mut &'p [P], key: impl Fn(&P) -> Key, prefix: Key, cell: u8) -> &'p [P] {
    let (run, rest) = points.split_at(leading(points, |point| key(point).prefix(cell) == prefix));
    *points = rest;
    run
}

/// How many at the start pass a test that none after them does: in steps that grow, since runs may be of any length.
fn leading<T>(items: &[T], test: impl Fn(&T) -> bool) -> usize {
    let mut reach = 1;
    while reach <= items.len() && test(&items[reach - 1]) {
        reach *= 2;
    }
    let passed = reach / 2;
    passed + items[passed..items.len().min(reach - 1)].partition_point(test)
}

//! Answers at a level from several trees on one lattice, plain and filtered (OCTREE sections 5 and 6).

use super::nodes::{Nodes, TreePoint};
use super::tree::{Tree, children, run_inside};
use crate::lattice::{BITS, Cube, Key};
use std::collections::BTreeMap;

/// The least point of every occupied cell of exponent `c` inside `within` over all layers, ascending; `c` is at most the
/// exponent of `within`.
///
/// # Errors
///
/// The storage's.
pub fn level<S: Nodes>(layers: &[&Tree<S>], within: Cube, c: u8) -> Result<Vec<S::Point>, S::Error> {
    let mut points = Vec::new();
    for layer in layers {
        need(layer, within, c, &mut points)?;
    }
    points.sort();
    points.dedup_by_key(|p| p.key().prefix(c));
    Ok(points)
}

/// The points of one layer inside `within` that [`level`] has to look at: those of the nodes that sample on cells of
/// exponent `c` or coarser, and of the root. Appended to `points`.
fn need<S: Nodes>(layer: &Tree<S>, within: Cube, c: u8, points: &mut Vec<S::Point>) -> Result<(), S::Error> {
    let mut open: Vec<Cube> = layer.root.into_iter().collect();
    while let Some(cube) = open.pop() {
        if !cube.contains_cube(within) && !within.contains_cube(cube) {
            continue;
        }
        let Some(row) = layer.nodes.row(cube)? else { continue };
        let mut own = layer.own(cube, row)?;
        let inside = run_inside(&own, TreePoint::key, within);
        points.extend(own.drain(inside));
        if !row.leaf && layer.params.cell(cube.k()) > c as i8 {
            open.extend(children(cube));
        }
    }
    Ok(())
}

/// A filtered query at one level.
struct Filter<'a, S: Nodes, M, Y> {
    layers: &'a [&'a Tree<S>],
    c: u8,
    matches: M,
    may: Y,
    /// The least matching point of each cell, by the cell's prefix.
    best: BTreeMap<Key, S::Point>,
    /// Inner nodes at the level, as layer and cube, with their cells whose owner does not match, ascending.
    open: Vec<(usize, Cube, Vec<Key>)>,
}

/// The least *matching* point of every cell of exponent `c` that has one, over all layers, ascending.
///
/// `may(layer, cube)` says whether the node of `cube` or anything below it can match. Below the level only what can hold
/// the least match of an open cell is read: exact, and everything if the filter mixes with everything.
///
/// # Errors
///
/// The storage's.
pub fn filtered<S: Nodes>(
    layers: &[&Tree<S>],
    c: u8,
    matches: impl Fn(&S::Point) -> bool,
    may: impl Fn(usize, Cube) -> bool,
) -> Result<Vec<S::Point>, S::Error> {
    let mut filter = Filter { layers, c: c.min(BITS), matches, may, best: BTreeMap::new(), open: Vec::new() };
    for (layer, tree) in layers.iter().enumerate() {
        if let Some(root) = tree.root {
            filter.above(layer, root, &[])?;
        }
    }
    // After the levels of all layers, so that any layer's match can close a cell.
    for (layer, cube, holes) in std::mem::take(&mut filter.open) {
        filter.fill(layer, cube, &holes)?;
    }
    Ok(filter.best.into_values().collect())
}

impl<S: Nodes, M: Fn(&S::Point) -> bool, Y: Fn(usize, Cube) -> bool> Filter<'_, S, M, Y> {
    fn offer(&mut self, point: &S::Point) {
        if (self.matches)(point) {
            let best = self.best.entry(point.key().prefix(self.c)).or_insert_with(|| point.clone());
            if point < best {
                *best = point.clone();
            }
        }
    }

    /// Reads the nodes that sample on cells of exponent `c` or coarser; `above` are the points stored in proper ancestors
    /// and inside the cube, ascending.
    fn above(&mut self, layer: usize, cube: Cube, above: &[S::Point]) -> Result<(), S::Error> {
        let tree = self.layers[layer];
        let Some(row) = tree.nodes.row(cube)? else { return Ok(()) };
        if !(self.may)(layer, cube) {
            return Ok(());
        }
        let mut owners = tree.own(cube, row)?;
        owners.iter().for_each(|p| self.offer(p));
        if row.leaf {
            return Ok(());
        }
        owners.extend_from_slice(above);
        owners.sort();
        if tree.params.cell(cube.k()) > self.c as i8 {
            for child in children(cube) {
                self.above(layer, child, &owners[run_inside(&owners, TreePoint::key, child)])?;
            }
            return Ok(());
        }
        owners.dedup_by_key(|p| p.key().prefix(self.c));
        let holes = owners.iter().filter(|p| !(self.matches)(p)).map(|p| p.key().prefix(self.c)).collect();
        self.open.push((layer, cube, holes));
        Ok(())
    }

    /// Looks below the node of `cube` for the least match of each of the cells `holes`.
    fn fill(&mut self, layer: usize, cube: Cube, holes: &[Key]) -> Result<(), S::Error> {
        for child in children(cube) {
            let tree = self.layers[layer];
            let Some(row) = tree.nodes.row(child)? else { continue };
            if !(self.may)(layer, child) {
                continue;
            }
            // The cells that meet the child: of larger ones there is at most one.
            let (first, last) = (child.first_key(), child.last_key());
            let from = holes.partition_point(|cell| *cell < first.prefix(self.c));
            let to = holes.partition_point(|cell| *cell <= last.prefix(self.c));
            // A match with the same key can still be less, so equal keys stay open.
            let open =
                |cell: &Key| self.best.get(cell).is_none_or(|best| best.key() >= first.max(least_of(*cell, self.c)));
            let holes: Vec<Key> = holes[from..to].iter().copied().filter(open).collect();
            if holes.is_empty() {
                continue;
            }
            for point in tree.own(child, row)? {
                if holes.binary_search(&point.key().prefix(self.c)).is_ok() {
                    self.offer(&point);
                }
            }
            if !row.leaf {
                self.fill(layer, child, &holes)?;
            }
        }
        Ok(())
    }
}

/// The least key with this prefix, `k` digits being cut off.
fn least_of(prefix: Key, k: u8) -> Key {
    let bits = 3 * u32::from(k);
    if bits >= 63 {
        Key { high: prefix.high.checked_shl(bits - 63).unwrap_or(0), low: 0 }
    } else {
        Key { high: prefix.high, low: prefix.low << bits }
    }
}

//! What a view under a filter may have left out, and how far that can be from what it has (OCTREE section 6).
//!
//! In a gap the first points of all cells of some size are known; those that match were returned. A cell whose first point
//! does not match is a hole: what lies in it is as near as the smallest cell around it that holds a returned point says.

use crate::geometry::Camera;
use crate::lattice::{BITS, Cube, Key};
use crate::octree::Metric;
use crate::store::NodeIx;

/// A cube in which a cut did not take everything.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Gap {
    /// The first node of which something was not taken; what was not is in it and below it.
    pub node: NodeIx,
    /// Its cube and layer.
    pub cube: Cube,
    pub layer: u16,
    /// The first points of cells of this exponent were taken; `None`: not even that of the whole cube.
    pub cell: Option<u8>,
    /// From the eye to the nearest place of it that can be seen.
    pub distance: f64,
}

/// A point that does not match: the layer and the key of where it is.
pub(crate) type Missed = (u16, Key);

/// Collects the holes of gaps of which none lies in another.
pub(crate) struct Holes<'g> {
    gaps: &'g [Gap],
    /// Numbers of gaps, by layer and first key.
    places: Vec<usize>,
    /// The gap's number and the cell's least key.
    cells: Vec<(usize, Key)>,
}

impl<'g> Holes<'g> {
    pub fn new(gaps: &'g [Gap]) -> Self {
        let mut places: Vec<usize> = (0..gaps.len()).collect();
        places.sort_by_key(|&i| (gaps[i].layer, gaps[i].cube.first_key()));
        Self { gaps, places, cells: Vec::new() }
    }

    /// Takes in points that do not match.
    pub fn miss(&mut self, missed: impl Iterator<Item = Missed>) {
        let start = self.cells.len();
        for (layer, key) in missed {
            let after =
                self.places.partition_point(|&i| (self.gaps[i].layer, self.gaps[i].cube.first_key()) <= (layer, key));
            let Some(&i) = after.checked_sub(1).and_then(|at| self.places.get(at)) else { continue };
            let gap = &self.gaps[i];
            if let Some(c) = gap.cell
                && gap.layer == layer
                && key <= gap.cube.last_key()
            {
                self.cells.push((i, key.floor(c)));
            }
        }
        self.cells[start..].sort_unstable();
        self.cells.dedup();
    }

    /// The cells of each gap that has some, ascending, in which there is none of `returned`, which ascend.
    pub fn empty(mut self, returned: &[Key]) -> Vec<(usize, Vec<Key>)> {
        self.cells.sort_unstable();
        self.cells.dedup();
        let is_empty = |&(i, floor): &(usize, Key)| {
            let last = self.gaps[i].cell.map_or(floor, |c| floor.ceil(c));
            returned.get(returned.partition_point(|k| *k < floor)).is_none_or(|k| *k > last)
        };
        self.cells.retain(is_empty);
        let of_gap = |cells: &[(usize, Key)]| (cells[0].0, cells.iter().map(|c| c.1).collect());
        self.cells.chunk_by(|a, b| a.0 == b.0).map(of_gap).collect()
    }
}

/// How far what was left out is from what was returned.
pub(crate) struct Bound<'g> {
    /// The keys of the points that are in the answer, ascending.
    returned: Vec<Key>,
    gaps: &'g [Gap],
    /// For each gap the largest cell that may be empty of returned points: so far that of none that was missed.
    cells: Vec<Option<u8>>,
}

impl<'g> Bound<'g> {
    /// Of what was left out in these gaps, with the keys of the points that were returned.
    pub fn new(mut returned: Vec<Key>, gaps: &'g [Gap]) -> Self {
        returned.sort_unstable();
        let cell = |gap: &Gap| match gap.cell {
            None => smallest_around(&returned, gap.cube.first_key(), gap.cube.k()),
            cell => cell,
        };
        let cells = gaps.iter().map(cell).collect();
        Self { returned, gaps, cells }
    }

    /// Takes in holes by a key in each.
    pub fn miss(&mut self, holes: &[Missed]) {
        let mut missed = holes.to_vec();
        missed.sort_unstable();
        for (gap, cell) in self.gaps.iter().zip(&mut self.cells) {
            let Some(c) = gap.cell else { continue };
            let from = missed.partition_point(|m| *m < (gap.layer, gap.cube.first_key()));
            let to = missed.partition_point(|m| *m <= (gap.layer, gap.cube.last_key()));
            let mut before = None;
            for (_, key) in &missed[from..to] {
                let hole = key.floor(c);
                if before.replace(hole) != Some(hole) {
                    *cell = (*cell).max(smallest_around(&self.returned, hole, c));
                }
            }
        }
    }

    /// Within which distance of a returned point everything in the gaps lies, in CRS units and in pixels; `None` if nothing
    /// was returned of something. No larger for an answer that holds more of the same sequence.
    pub fn finish(self, metric: &Metric, camera: &Camera) -> (Option<f64>, Option<f64>) {
        if self.gaps.is_empty() {
            return (Some(0.0), Some(0.0));
        }
        if self.returned.is_empty() {
            return (None, None);
        }
        let (mut world, mut px) = (0.0_f64, 0.0_f64);
        for (gap, cell) in self.gaps.iter().zip(&self.cells) {
            let bound = metric.step_bound(cell.unwrap_or(BITS) as i8, 7);
            world = world.max(bound);
            px = px.max(camera.pixels_of_length(bound, gap.distance));
        }
        (Some(world), Some(px).filter(|px| px.is_finite()))
    }
}

/// The exponent, at least `c`, of the smallest cell around the cell of exponent `c` with this first key that holds one of
/// the keys, which ascend; `None` if there is no key.
fn smallest_around(keys: &[Key], floor: Key, c: u8) -> Option<u8> {
    let at = keys.partition_point(|k| *k < floor);
    let neighbours = [at.checked_sub(1).map(|i| keys[i]), keys.get(at).copied()];
    // Keys are in the order of cells: of all keys these two share the largest and the smallest cells with it.
    let around = |key: Key| (c..=BITS).find(|&k| key.prefix(k) == floor.prefix(k));
    neighbours.into_iter().flatten().filter_map(around).min()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::LatticePoint;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_smallest_cell_is_the_one_that_all_cells_give(
            points in prop::collection::vec(prop::array::uniform3(0_u64..64), 0..9), at in prop::array::uniform3(0_u64..64), c in 0_u8..5,
        ) {
            let mut keys: Vec<Key> = points.iter().map(|&p| Key::of(LatticePoint(p))).collect();
            keys.sort_unstable();
            let floor = Key::of(LatticePoint(at)).floor(c);
            let cube = Cube::containing(LatticePoint(at), c);
            let naive = (c..=BITS).find(|&k| points.iter().any(|&p| cube.ancestor(k).contains(LatticePoint(p))));
            prop_assert_eq!(smallest_around(&keys, floor, c), naive);
        }
    }
}

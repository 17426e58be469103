//! What a node's row says of its own points, apart from how they are cut into parts.

use super::encode::{ColumnSlices, ScanTable};
use super::model::{Range, ScanCount, ScanId, Shape, Slot};
use super::shape::Relative;
use super::zones::{merge_ranges, range_of_all, range_where};
use crate::lattice::{Cube, LatticeBox, SortKey};
use crate::points::{Column, ScalarType};

/// Counts, bounds, shape and zone maps: functions of the points alone.
#[derive(Debug, PartialEq)]
pub(super) struct Description {
    pub scans: Vec<ScanCount>,
    pub bounds: Option<LatticeBox>,
    pub shape: Shape,
    /// Ascending by slot.
    pub zones: Vec<(Slot, Range)>,
}

/// Describes a node's own points: the attributes of some after the other, in any order, and at the end all keys.
pub(super) struct Describer<'t> {
    table: &'t ScanTable,
    points: usize,
    scans: Vec<ScanCount>,
    zones: Vec<(Slot, Range)>,
    color: ColorSum,
}

impl<'t> Describer<'t> {
    pub fn new(table: &'t ScanTable) -> Self {
        Self { table, points: 0, scans: Vec::new(), zones: Vec::new(), color: ColorSum::default() }
    }

    /// Takes some points.
    pub fn add(&mut self, part: &ColumnSlices<'_>) {
        let table = self.table;
        assert!(part.columns.iter().all(|c| c.1.len() == part.scans.len()), "a part's columns have one length");
        self.points += part.scans.len();
        let counts = count_scans(part.scans);
        self.color.add(part, table, &counts);
        for (slot, column) in part.columns {
            let having = counts.iter().filter(|c| table.has(c.scan, *slot)).count();
            let range = match having {
                0 => None,
                n if n == counts.len() => range_of_all(column),
                _ => range_where(column, |i| table.has(part.scans[i], *slot)),
            };
            if let Some(range) = range {
                merge_ranges(&mut self.zones, &[(*slot, range)]);
            }
        }
        counts.into_iter().for_each(|count| add_count(&mut self.scans, count));
    }

    /// With the keys of all points, in order.
    pub fn finish<K: SortKey>(self, cube: Cube, keys: &[K], relative: &mut Relative) -> Description {
        assert!(self.points == keys.len(), "the parts are all of the node");
        relative.fill(cube, keys);
        let shape = Shape { color: self.color.mean(), ..relative.shape() };
        Description { scans: self.scans, bounds: relative.bounds(cube), shape, zones: self.zones }
    }
}

/// How many points of each scan there are, ascending by scan.
pub(super) fn count_scans(scans: &[ScanId]) -> Vec<ScanCount> {
    let mut counts: Vec<ScanCount> = Vec::new();
    let mut add = |scan: ScanId, n: usize| add_count(&mut counts, ScanCount { scan, own: n as u64, subtree: n as u64 });
    // In blocks, of which most are of one scan: so the compiler compares many at once.
    for block in scans.chunks(256) {
        if block.iter().fold(0, |d, scan| d | (scan ^ block[0])) == 0 {
            add(block[0], block.len());
        } else {
            block.chunk_by(|a, b| a == b).for_each(|run| add(run[0], run.len()));
        }
    }
    counts
}

fn add_count(counts: &mut Vec<ScanCount>, more: ScanCount) {
    match counts.binary_search_by_key(&more.scan, |c| c.scan) {
        Ok(i) => {
            counts[i].own += more.own;
            counts[i].subtree += more.subtree;
        }
        Err(i) => counts.insert(i, more),
    }
}

/// The colours at 16 bits, added up, of the points that have all three.
#[derive(Default)]
struct ColorSum {
    sums: [u64; 3],
    points: u64,
}

impl ColorSum {
    /// Adds points, of which `counts` says how many each scan has.
    fn add(&mut self, part: &ColumnSlices<'_>, table: &ScanTable, counts: &[ScanCount]) {
        let column = |slot: Slot| part.columns.iter().find(|c| c.0 == slot).map(|c| &c.1);
        for count in counts {
            let Some(facts) = table.facts(count.scan) else { continue };
            let of_scan =
                |slots: &[Slot]| slots.iter().find(|s| facts.slots.binary_search(s).is_ok()).and_then(|s| column(*s));
            let [Some(red), Some(green), Some(blue)] = std::array::from_fn(|i| of_scan(&table.colors[i])) else {
                continue;
            };
            for (sum, channel) in self.sums.iter_mut().zip([red, green, blue]) {
                let deep = if facts.eight_bit || channel.ty() == ScalarType::U8 { 257 } else { 1 };
                let all = counts.len() == 1;
                let add = match channel {
                    Column::U8(v) => sum_of(v, part.scans, count.scan, all),
                    Column::U16(v) => sum_of(v, part.scans, count.scan, all),
                    _ => 0,
                };
                *sum = sum.saturating_add(add.saturating_mul(deep));
            }
            self.points += count.own;
        }
    }

    /// Rounded to the nearest, halves up.
    fn mean(&self) -> Option<[u16; 3]> {
        let n = self.points;
        (n > 0).then(|| self.sums.map(|s| u16::try_from((2 * s + n) / (2 * n)).unwrap_or(u16::MAX)))
    }
}

fn sum_of<T: Copy + Into<u64>>(values: &[T], scans: &[ScanId], scan: ScanId, all: bool) -> u64 {
    if all {
        values.iter().map(|&v| v.into()).sum()
    } else {
        values.iter().zip(scans).filter(|(_, s)| **s == scan).map(|(&v, _)| v.into()).sum()
    }
}

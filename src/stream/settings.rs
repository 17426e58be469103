//! What is to be seen, and how much of it.

use super::gpu::Paint;
use crate::query::Filter;
use crate::store::Snapshot;
use crate::store::model::ScanId;
use std::collections::BTreeSet;
use std::sync::Arc;

/// Which points are seen, and what is known of each.
#[derive(Clone, Debug)]
pub struct Shown {
    /// Which scans.
    pub scans: ScanChoice,
    /// Only points for which this is true.
    pub filter: Option<Filter>,
    /// What the adapter is told of each point.
    pub paint: Arc<dyn Paint>,
}

impl PartialEq for Shown {
    fn eq(&self, other: &Self) -> bool {
        self.scans == other.scans && self.filter == other.filter && self.paint.tag() == other.paint.tag()
    }
}

/// Which scans are seen: those that the store shows, but for what was said otherwise here. So scans that come later are
/// seen, too.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ScanChoice {
    /// Seen although the store hides them.
    pub shown: BTreeSet<ScanId>,
    /// Not seen although the store shows them.
    pub hidden: BTreeSet<ScanId>,
}

impl ScanChoice {
    /// Is the scan seen, which the store shows or hides?
    pub fn sees(&self, scan: ScanId, visible: bool) -> bool {
        !self.hidden.contains(&scan) && (visible || self.shown.contains(&scan))
    }

    /// Shows or hides a scan that the store shows or hides.
    pub fn set(&mut self, scan: ScanId, visible: bool, seen: bool) {
        self.shown.remove(&scan);
        self.hidden.remove(&scan);
        match (visible, seen) {
            (false, true) => drop(self.shown.insert(scan)),
            (true, false) => drop(self.hidden.insert(scan)),
            _ => {}
        }
    }

    /// The scans of a snapshot that are seen, by name; `None`: just those that the store shows.
    pub(super) fn names(&self, snapshot: &Snapshot) -> Option<Vec<String>> {
        let seen = |visible: bool, id| self.sees(id, visible);
        let same = snapshot.scans().iter().all(|s| seen(s.visible, s.id) == s.visible);
        let names = snapshot.scans().iter().filter(|s| seen(s.visible, s.id)).map(|s| s.name.clone());
        (!same).then(|| names.collect())
    }
}

/// Points of a node of the usual leaf capacity, all in one part: the largest parts but for masses of points on one place.
const MOST_PART_POINTS: u64 = 32_768;

/// How much may be used, and how fine it should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// The most points of a draw list; the pool has room for twice as many.
    pub points: u64,
    /// Nothing finer than so many pixels is wanted.
    pub error_px: f64,
    /// The most bytes of points on their way: decoded, not yet uploaded.
    pub loading_bytes: u64,
    /// Is what lies ahead of a moving camera loaded in advance?
    pub prefetch: bool,
}

impl Default for Limits {
    fn default() -> Self {
        Self { points: 2_000_000, error_px: 1.0, loading_bytes: 128 << 20, prefetch: true }
    }
}

impl Limits {
    /// Blocks of a pool for twice `points` points: the front and the back draw list. Half as much again, because the last
    /// block of a part is seldom full, and room for one part in each, since the last one of a list is there whole though
    /// only its beginning is drawn. Where parts are so small that this is not enough, a list ends when its blocks do.
    pub fn blocks(&self, block_points: u32) -> u32 {
        let points = self.points.max(1).min(u64::from(u32::MAX) / 4);
        let block_points = u64::from(block_points.max(1));
        let one = (points * 3).div_ceil(block_points * 2) + MOST_PART_POINTS.div_ceil(block_points);
        2 * u32::try_from(one).unwrap_or(u32::MAX / 2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_choice_is_an_exception_from_what_the_store_says() {
        let mut choice = ScanChoice::default();
        assert!(choice.sees(1, true) && !choice.sees(2, false));
        choice.set(1, true, false);
        choice.set(2, false, true);
        assert!(!choice.sees(1, true) && choice.sees(2, false));
        choice.set(1, true, true);
        choice.set(2, false, false);
        assert_eq!(choice, ScanChoice::default());
    }

    #[test]
    fn the_pool_has_room_for_two_lists() {
        let limits = Limits { points: 2_000_000, ..Limits::default() };
        let blocks = limits.blocks(2048);
        assert!(u64::from(blocks) * 2048 >= 4_000_000 && u64::from(blocks) * 2048 <= 6_080_000);
        assert_eq!(Limits { points: 0, ..limits }.blocks(2048), 2 * (1 + 16));
    }
}

//! How far a query is, seen from elsewhere.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// What stands for "not known".
const UNKNOWN: u64 = u64::MAX;

/// Says how far the queries are that were given it ([`Query::watch`](super::Query::watch)), from any thread. Clones are the
/// same one.
///
/// ```
/// use esker::lattice::Lattice;
/// use esker::query::{Query, Watch};
/// use esker::store::{SiteOptions, Store};
///
/// # let store = Store::in_memory(SiteOptions::new(Lattice::uniform(0.001)?))?;
/// let watch = Watch::new();
/// let elsewhere = watch.clone();
/// let bar = std::thread::spawn(move || println!("{} of {:?}", elsewhere.points(), elsewhere.expected()));
/// Query::new().watch(&watch).collect(&store.snapshot()?)?;
/// bar.join().ok();
/// assert_eq!((watch.points(), watch.expected()), (0, Some(0)));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Watch(Arc<Counts>);

#[derive(Debug)]
struct Counts {
    points: AtomicU64,
    expected: AtomicU64,
}

impl Watch {
    /// Nothing is read yet.
    pub fn new() -> Self {
        Self(Arc::new(Counts { points: AtomicU64::new(0), expected: AtomicU64::new(UNKNOWN) }))
    }

    /// Points whose positions were decoded so far, by all these queries.
    pub fn points(&self) -> u64 {
        self.0.points.load(Ordering::Relaxed)
    }

    /// How many it will be at most, once that is known: of queries at full detail and of views without a filter. Of a level or
    /// a capacity it is not, since these look at some points several times.
    pub fn expected(&self) -> Option<u64> {
        Some(self.0.expected.load(Ordering::Relaxed)).filter(|&points| points != UNKNOWN)
    }

    pub(crate) fn add(&self, points: u64) {
        self.0.points.fetch_add(points, Ordering::Relaxed);
    }

    /// So many more will be read from now on.
    pub(crate) fn expect(&self, points: u64) {
        // Others may be reading at the same time: what they expect stays.
        let more = |expected: u64| {
            let before = if expected == UNKNOWN { self.points() } else { expected.max(self.points()) };
            before.saturating_add(points).min(UNKNOWN - 1)
        };
        self.0.expected.update(Ordering::Relaxed, Ordering::Relaxed, more);
    }
}

impl Default for Watch {
    fn default() -> Self {
        Self::new()
    }
}

/// Two of them are equal if they are the same one.
impl PartialEq for Watch {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the second expected took the place of what the first did, and the total was below what was read.
    #[test]
    fn what_queries_expect_at_the_same_time_adds_up() {
        let watch = Watch::new();
        assert_eq!(watch.expected(), None);
        watch.expect(100);
        watch.add(30);
        watch.expect(50);
        assert_eq!(watch.expected(), Some(150));
        watch.add(120);
        // What was read by one that expects nothing counts, too.
        watch.add(10);
        watch.expect(5);
        assert_eq!((watch.points(), watch.expected()), (160, Some(165)));
        watch.expect(u64::MAX);
        assert_eq!(watch.expected(), Some(UNKNOWN - 1));
    }
}

//! The nearest neighbours of points.

use super::answer::Statistics;
use super::near::Near;
use super::neighbors::{Candidate, Search, settle};
use super::plan::Plan;
use super::task::{by_part, work};
use super::{Detail, Query, QueryError};
use crate::lattice::Key;
use crate::points::Batch;
use crate::store::Snapshot;

/// The neighbours of some points.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Neighbors {
    /// All neighbours: those of the first point, nearest first, then those of the second, and so on.
    pub batch: Batch,
    /// The distance of each, in CRS units.
    pub distances: Vec<f64>,
    /// Where the neighbours of each point end. Fewer than were asked for are there if no more match.
    pub ends: Vec<usize>,
    /// What it cost.
    pub statistics: Statistics,
}

/// Places that are looked at together: those that are near each other find most of what they need read already.
const TOGETHER: usize = 256;

/// Farther away squares of distances would have no number.
const FARTHEST: f64 = 1e150;

impl Query {
    /// The `k` matching points that are nearest to each of `points` and at most `radius` away. Exact; of equally near
    /// points those whose key is least come first.
    ///
    /// ```
    /// use esker::lattice::Lattice;
    /// use esker::query::{Filter, Query};
    /// use esker::store::{SiteOptions, Store};
    ///
    /// # let store = Store::in_memory(SiteOptions::new(Lattice::uniform(0.001)?))?;
    /// let ground = Query::new().filter(Filter::parse("Z < 10")?);
    /// let found = ground.nearest(&store.snapshot()?, &[[1.0, 2.0, 3.0]], 8, Some(0.5))?;
    /// assert_eq!((found.batch.len(), found.ends), (0, vec![0]));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    ///
    /// As [`Query::run`]; [`QueryError::Combination`] if the query has a level, a capacity or a view;
    /// [`QueryError::Detail`] if a coordinate is beyond ±1e150 or NaN, or the radius is negative or NaN.
    pub fn nearest(
        &self,
        snapshot: &Snapshot,
        points: &[[f64; 3]],
        k: usize,
        radius: Option<f64>,
    ) -> Result<Neighbors, QueryError> {
        if self.view.is_some() || self.capacity.is_some() || self.detail != Detail::Everything {
            return Err(QueryError::Combination(
                "neighbours are looked for among all points; leave out the view, level, spacing, max error and capacity",
            ));
        }
        if let Some(&value) = points.iter().flatten().find(|c| !(c.abs() <= FARTHEST)) {
            return Err(QueryError::Detail { what: "coordinate", value, expected: "a number from -1e150 to 1e150" });
        }
        if let Some(value) = radius.filter(|r| !(0.0..).contains(r)) {
            return Err(QueryError::Detail { what: "radius", value, expected: "a length of 0 or more" });
        }
        let mut plan = Plan::new(self, snapshot)?;
        // The neighbours of a point are read again for the point beside it.
        plan.reads(0);
        let farthest = radius.map_or(f64::INFINITY, super::radius::square_within);
        let found = find(&plan, points, k, farthest)?;
        let mut ends = Vec::with_capacity(points.len());
        let mut all: Vec<Candidate> = Vec::new();
        for found in found {
            all.extend(found);
            ends.push(all.len());
        }
        let batch = gather(&plan, &all)?;
        let distances = all.iter().map(|c| c.square.sqrt()).collect();
        let statistics = plan.finish(super::Answer::default()).statistics;
        Ok(Neighbors { batch, distances, ends, statistics })
    }
}

/// The neighbours of each place.
fn find(plan: &Plan, points: &[[f64; 3]], k: usize, farthest: f64) -> Result<Vec<Vec<Candidate>>, QueryError> {
    let search = |place: usize| Search::new(plan, points[place], k, farthest);
    let mut places: Vec<usize> = (0..points.len()).collect();
    places.sort_by_cached_key(|&place| Key::of(search(place).at()));
    let threads = plan.threads.unwrap_or_else(rayon::current_num_threads).max(1);
    let groups = places.chunks(places.len().div_ceil(4 * threads).clamp(1, TOGETHER)).collect();
    let found = plan.each(groups, |group: &[usize]| {
        let mut near = Near::new(plan);
        let mut found = group.iter().map(|&place| search(place).run(&mut near)).collect::<Result<Vec<_>, _>>()?;
        settle(plan, &mut found, k)?;
        Ok(found)
    })?;
    let mut all = vec![Vec::new(); points.len()];
    places.into_iter().zip(found.into_iter().flatten()).for_each(|(place, found)| all[place] = found);
    Ok(all)
}

/// The points of the candidates, in their order; each place is read once.
fn gather(plan: &Plan, candidates: &[Candidate]) -> Result<Batch, QueryError> {
    let place = |c: &Candidate| (c.pick.node, c.pick.part, c.pick.index);
    let mut places: Vec<_> = candidates.iter().map(place).collect();
    places.sort_unstable();
    places.dedup();
    let mut batch = Batch::empty(plan.attributes.clone());
    for read in plan.each(by_part(plan, &places)?, |task| work(plan, task))? {
        batch.append(&read);
    }
    let row = |c: &Candidate| places.binary_search(&place(c)).unwrap_or_default() as u32;
    Ok(batch.gathered(&candidates.iter().map(row).collect::<Vec<_>>()))
}

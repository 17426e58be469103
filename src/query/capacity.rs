//! Answers under a capacity: the first points of one fixed sequence, whatever the capacity (DESIGN, laws 4 and 5).
//!
//! The sequence is the canonical order of detail of the *matching* points: coarse cells before fine ones, within a cell's
//! size by group of ranks, within a group evenly; repeated positions last. Every level of cells is a prefix of it, so the
//! coarsest level with enough points is found first, and only that is put in order.

use super::QueryError;
use super::cells::{Pick, everything, filtered};
use super::plan::Plan;
use crate::octree::canonical_prefix;

/// The points of an answer and its bound.
pub(crate) struct Chosen {
    pub picks: Vec<Pick>,
    pub error_bound: Option<f64>,
}

/// All points of a level.
pub(crate) fn level(plan: &Plan, c: u8) -> Result<Chosen, QueryError> {
    Ok(Chosen { picks: filtered(plan, c)?, error_bound: Some(plan.metric().step_bound(c as i8, 7)) })
}

/// The first `capacity` points of the sequence, going no finer than cells of exponent `finest`; `None`: to the end.
pub(crate) fn limited(plan: &Plan, finest: Option<u8>, capacity: u64) -> Result<Chosen, QueryError> {
    let most = plan.most_points()?;
    if most.all == 0 {
        return Ok(Chosen { picks: Vec::new(), error_bound: Some(0.0) });
    }
    if capacity == 0 {
        return Ok(Chosen { picks: Vec::new(), error_bound: None });
    }
    let coarsest = plan.root().map_or(0, |r| r.k());
    // More than enough, so that the first point that is left out is known: it says how good the answer is. Coarser levels
    // cannot have so many.
    let start = (finest.unwrap_or(0)..=coarsest).rev().find(|&c| most.by_cell[usize::from(c)] > capacity);
    let mut cell = start.or(finest);
    let mut picks = loop {
        let picks = match cell {
            Some(c) => filtered(plan, c)?,
            None => everything(plan)?,
        };
        match cell {
            Some(c) if picks.len() as u64 <= capacity && cell != finest => {
                cell = finer(c, picks.len() as u64, capacity, finest)
            }
            _ => break picks,
        }
    };
    if picks.len() as u64 <= capacity {
        let complete = cell.map_or(0.0, |c| plan.metric().step_bound(c as i8, 7));
        // A filter may have left nothing at all.
        let error_bound = Some(if picks.is_empty() { 0.0 } else { complete });
        return Ok(Chosen { picks, error_bound });
    }
    let keys: Vec<_> = picks.iter().map(|p| p.key).collect();
    // Any cube that holds all points gives the same sequence: the first point is first.
    let prefix = canonical_prefix(&keys, crate::lattice::BITS as i8, usize::try_from(capacity).unwrap_or(usize::MAX));
    let error_bound = Some(prefix.bound(&plan.metric()));
    picks = prefix.points.iter().map(|&i| picks[i as usize]).collect();
    Ok(Chosen { picks, error_bound })
}

/// The cell to try after one with too few points: on surfaces each level has four times the points of the one before.
fn finer(c: u8, points: u64, capacity: u64, finest: Option<u8>) -> Option<u8> {
    let missing = capacity / points.max(1);
    let levels = 1 + (missing.max(1).ilog2() / 2).min(40) as u8;
    match (c.checked_sub(levels), finest) {
        (Some(next), finest) => Some(next.max(finest.unwrap_or(0))),
        (None, Some(finest)) => Some(finest),
        (None, None) if c > 0 => Some(0),
        (None, None) => None,
    }
}

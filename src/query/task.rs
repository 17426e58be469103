//! What is read and handed on together, and how that is done.

use super::QueryError;
use super::capacity::Kept;
use super::looked::Place;
use super::part::{Look, Part};
use super::pieces::Piece;
use super::plan::{Plan, Prospect};
use super::thin::{Thinned, thin};
use crate::geometry::Containment;
use crate::lattice::LatticeBox;
use crate::points::Batch;
use crate::store::NodeIx;

/// What is read and handed on together.
pub(crate) enum Task {
    /// The matching points of a part.
    Part { node: NodeIx, part: usize, points: u32, prospect: Prospect },
    /// Some points of a part, of which all of `points` are read.
    Picked { node: NodeIx, part: usize, points: u32, indices: Option<Vec<u32>> },
    /// The points of a level in a piece.
    Piece(PieceTask),
}

/// Points of a level in a piece: those that a sequence has.
pub(crate) struct PieceTask {
    pub piece: Piece,
    /// How many there are at most.
    pub points: u64,
    pub cell: Option<u8>,
    pub kept: Kept,
}

impl PieceTask {
    fn thinned<'a>(&self, plan: &'a Plan) -> Result<(Thinned<'a>, Vec<bool>), QueryError> {
        let thinned = thin(plan, &self.piece, self.cell, self.kept.needs_steps())?;
        let taken = self.kept.of(&thinned);
        Ok((thinned, taken))
    }

    fn batch(self, plan: &Plan) -> Result<Batch, QueryError> {
        let (thinned, taken) = self.thinned(plan)?;
        thinned.batch(&taken)
    }

    /// How many points of which node there are.
    pub fn count(&self, plan: &Plan) -> Result<Vec<(NodeIx, u64)>, QueryError> {
        let (thinned, taken) = self.thinned(plan)?;
        Ok(thinned.count(&taken))
    }
}

/// Does a task.
pub(crate) fn work(plan: &Plan, task: Task) -> Result<Batch, QueryError> {
    plan.cancel.check()?;
    match task {
        Task::Part { node, part, prospect, .. } => {
            let mut part = Part::at(plan, node, part)?;
            if prospect == Prospect::Everything {
                return if plan.keeps_blocks { part.gather(None) } else { part.whole() };
            }
            part.matching(&Look { skips: &outside(plan), misses: false, positions: true })
        }
        Task::Picked { node, part, points, indices } => {
            let mut part = Part::at(plan, node, part)?;
            match indices {
                Some(indices) if indices.len() < points as usize => part.gather(Some(&indices)),
                _ if plan.keeps_blocks => part.gather(None),
                _ => part.whole(),
            }
        }
        Task::Piece(task) => task.batch(plan),
    }
}

/// The points that a task takes in, for keeping memory bounded.
pub(crate) fn points(task: &Task) -> u64 {
    match task {
        Task::Part { points, .. } | Task::Picked { points, .. } => u64::from(*points),
        Task::Piece(task) => task.points,
    }
}

/// The points that a task would give.
pub(crate) fn count(plan: &Plan, task: &Task) -> Result<u64, QueryError> {
    plan.cancel.check()?;
    match task {
        Task::Part { node, part, .. } => {
            let found =
                Part::at(plan, *node, *part)?.find(&Look { skips: &outside(plan), misses: false, positions: false })?;
            Ok(found.iter().map(|f| f.mask.count() as u64).sum())
        }
        Task::Picked { points, indices, .. } => Ok(indices.as_ref().map_or(u64::from(*points), |i| i.len() as u64)),
        Task::Piece(task) => Ok(task.count(plan)?.into_iter().map(|(_, n)| n).sum()),
    }
}

/// Says of the bounds of blocks that nothing in them is in the region.
pub(crate) fn outside(plan: &Plan) -> impl Fn(&LatticeBox) -> bool + '_ {
    |bounds| plan.region.classify(bounds) == Containment::Outside
}

/// A task for each part of these places, which are in its order: node, part, index.
pub(crate) fn by_part(plan: &Plan, places: &[Place]) -> Result<Vec<Task>, QueryError> {
    places
        .chunk_by(|a, b| (a.0, a.1) == (b.0, b.1))
        .map(|run| {
            let (node, part) = (run[0].0, run[0].1 as usize);
            let points = plan.nodes.node(node)?.parts[part].points;
            Ok(Task::Picked { node, part, points, indices: Some(run.iter().map(|p| p.2).collect()) })
        })
        .collect()
}

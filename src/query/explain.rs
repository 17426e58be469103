//! Why each node is taken, tested, refused or cut.

use super::capacity;
use super::plan::{Plan, Prospect, Scope};
use super::policy::{Policy, select_by_distance};
use super::view::{Refusal, Refusals, RelativeLattice, Selection, ViewCut, select};
use super::{Answer, Query, QueryError};
use crate::geometry::{Camera, Containment};
use crate::lattice::LatticeBox;
use crate::points::counted;
use crate::store::{Node, NodeIx, Snapshot, StoreError};
use serde::Serialize;
use std::collections::HashMap;
use std::sync::Arc;

/// Why a node is refused though what lies below it is not.
pub(super) const OWN_POINTS_DO_NOT_MATCH: &str = "none of its own points can match; those below may";

/// What becomes of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Verdict {
    /// Its points are in the answer, all or some.
    Taken,
    /// Its points are read and tested one by one.
    Tested,
    /// Neither it nor anything below it is looked at.
    Refused,
    /// It would be taken, but the capacity is used.
    Cut,
}

/// A node and what becomes of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ExplainedNode {
    /// Its name, level-x-y-z; level 0 is the root.
    pub node: String,
    /// Its layer.
    pub layer: u16,
    /// The side of its sampling cells, in CRS units.
    pub spacing: f64,
    /// Points that it stores, and those with all that lie below.
    pub points: u64,
    /// Those and all below.
    pub subtree_points: u64,
    /// Of its own how many are in the answer, where that is known without reading them.
    pub taken: Option<u64>,
    /// What becomes of it.
    pub verdict: Verdict,
    /// Why.
    pub reason: String,
}

/// What a query does, node by node in pre-order; below a refused node nothing is listed.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Explanation {
    /// The nodes.
    pub nodes: Vec<ExplainedNode>,
    /// What the answer would be.
    pub answer: Answer,
}

impl Query {
    /// Says of every node that is looked at why it is taken, tested, refused or cut. Runs the query without giving points.
    ///
    /// # Errors
    ///
    /// As [`Query::run`].
    pub fn explain(&self, snapshot: &Snapshot) -> Result<Explanation, QueryError> {
        let answer = self.count(snapshot)?;
        let plan = Arc::new(Plan::new(self, snapshot)?);
        let cell = self.detail.cell(plan.root(), plan.g, plan.lattice.quantum_f64())?;
        let nodes = match &self.view {
            Some((camera, max_error_px)) if self.policy == Policy::Screen => {
                let all = |_: &Node| Ok::<_, StoreError>(true);
                let cut = ViewCut::new(&plan.nodes, &plan.lattice, plan.g, camera, *max_error_px, all)?;
                let mut cut = cut.no_finer_than(cell);
                cut.note_refusals();
                if plan.is_unfiltered() && plan.region.is_everything() {
                    let selection = select(&mut cut, self.capacity)?;
                    explain_view(&plan, &selection, &cut.refusals(), *max_error_px)?
                } else {
                    explain_region(&plan, cell, self.capacity, Some(camera))?
                }
            }
            Some((camera, _)) => {
                let Policy::Distance(policy) = &self.policy else {
                    return Ok(Explanation { nodes: Vec::new(), answer });
                };
                let selection = select_by_distance(&plan.nodes, &plan.lattice, plan.g, camera, policy, self.capacity)?;
                explain_view(&plan, &selection, &Refusals::default(), 0.0)?
            }
            None => explain_region(&plan, cell, self.capacity, None)?,
        };
        Ok(Explanation { nodes, answer })
    }
}

fn explained(plan: &Plan, head: &Node, verdict: Verdict, taken: Option<u64>, reason: String) -> ExplainedNode {
    let root = plan.roots.iter().find(|r| r.layer == head.layer).map_or(head.cube, |r| r.cube);
    let cell = i32::from(head.cube.k()) - i32::from(plan.g);
    ExplainedNode {
        node: head.cube.display_name(root),
        layer: head.layer,
        spacing: 2_f64.powi(cell) * plan.lattice.largest_quantum(),
        points: head.own_points,
        subtree_points: head.subtree_points,
        taken,
        verdict,
        reason,
    }
}

/// A view whose points are known by the rows alone.
fn explain_view(
    plan: &Plan,
    selection: &Selection,
    Refusals { refused, waiting }: &Refusals,
    max_error_px: f64,
) -> Result<Vec<ExplainedNode>, QueryError> {
    let mut taken: HashMap<NodeIx, u64> = HashMap::new();
    selection.parts.iter().for_each(|p| *taken.entry(p.node).or_default() += u64::from(p.points));
    let mut listed: Vec<(NodeIx, ExplainedNode)> = Vec::new();
    for (&node, &points) in &taken {
        let head = plan.nodes.node(node)?;
        let own = head.own_points;
        let reason = if points < own {
            format!("{points} of its {}: the rest is fine enough, or beyond the capacity", counted(own, "point"))
        } else {
            "in view, and coarser than asked for".to_owned()
        };
        listed.push((node, explained(plan, &head, Verdict::Taken, Some(points), reason)));
    }
    for (node, why) in refused {
        let reason = match why {
            Refusal::OutOfView => "out of view".to_owned(),
            Refusal::NoMatch => "nothing in it can match".to_owned(),
            Refusal::FineEnough => format!("what is above it is within {max_error_px} pixels, or as fine as asked for"),
        };
        listed.push((node.ix(), explained(plan, node, Verdict::Refused, Some(0), reason)));
    }
    for (node, px) in waiting {
        let reason = format!("the capacity is used; its spacing is {px:.2} pixels");
        listed.push((node.ix(), explained(plan, node, Verdict::Cut, Some(0), reason)));
    }
    listed.sort_by_key(|(node, _)| *node);
    Ok(listed.into_iter().map(|(_, e)| e).collect())
}

/// A region, or a view under a filter, which is one more reason to refuse.
fn explain_region(
    plan: &Arc<Plan>,
    cell: Option<u8>,
    capacity: Option<u64>,
    camera: Option<&Camera>,
) -> Result<Vec<ExplainedNode>, QueryError> {
    // Under a capacity the points themselves decide.
    let picked: Option<HashMap<NodeIx, u64>> = match (capacity, camera) {
        (Some(capacity), None) => Some(capacity::limited(plan, cell, capacity)?.by_node(plan)?),
        _ => None,
    };
    let seen = camera.map(|camera| (RelativeLattice::new(&plan.lattice, camera.eye()), camera.frustum()));
    let out_of_view = |bounds: &LatticeBox| {
        seen.as_ref().is_some_and(|(lattice, frustum)| {
            lattice.relative(bounds).is_none_or(|b| frustum.classify(&b) == Containment::Outside)
        })
    };
    let mut listed = Vec::new();
    let mut open: Vec<Node> = plan.roots.iter().rev().cloned().collect();
    while let Some(node) = open.pop() {
        let head = &node;
        if out_of_view(&head.subtree_bounds) {
            listed.push(explained(plan, head, Verdict::Refused, Some(0), "out of view".into()));
            continue;
        }
        if plan.prospect(head, Scope::Subtree)? == Prospect::Nothing {
            listed.push(explained(plan, head, Verdict::Refused, Some(0), why_not(plan, head)));
            continue;
        }
        let is_finer = |c: u8| !head.is_root() && i16::from(head.cube.k()) < i16::from(c) + i16::from(plan.g);
        if let Some(c) = cell.filter(|&c| is_finer(c)) {
            let size = 2_f64.powi(c.into()) * plan.lattice.largest_quantum();
            let reason = if plan.takes_all_of(head.cube) {
                format!("finer than cells of {size}")
            } else {
                format!("finer than cells of {size}; searched only where a coarser point does not match")
            };
            listed.push(explained(plan, head, Verdict::Refused, None, reason));
            continue;
        }
        let own = plan.prospect(head, Scope::Own)?;
        let entry = match (&picked, own) {
            (Some(picked), _) => match picked.get(&head.ix()) {
                Some(&n) => {
                    explained(plan, head, Verdict::Taken, Some(n), format!("{n} of the first points of the sequence"))
                }
                None if own == Prospect::Nothing => {
                    explained(plan, head, Verdict::Refused, Some(0), OWN_POINTS_DO_NOT_MATCH.into())
                }
                None => {
                    explained(plan, head, Verdict::Cut, Some(0), "its points come after the capacity is used".into())
                }
            },
            (None, Prospect::Everything) => {
                let (taken, reason) = match (cell, camera) {
                    (None, None) => (Some(head.own_points), "all of its points match"),
                    (Some(_), None) => (None, "all of its points match; the first of each cell are taken"),
                    (_, Some(_)) => (None, "all of its points match; as many are taken as the view has use for"),
                };
                explained(plan, head, Verdict::Taken, taken, reason.into())
            }
            (None, Prospect::Some) => explained(plan, head, Verdict::Tested, None, why_tested(plan, head)),
            (None, Prospect::Nothing) => {
                explained(plan, head, Verdict::Refused, Some(0), OWN_POINTS_DO_NOT_MATCH.into())
            }
        };
        listed.push(entry);
        let first = open.len();
        open.extend(plan.nodes.children(head)?);
        open[first..].reverse();
    }
    Ok(listed)
}

/// Why a subtree cannot match, in the order in which that is found out.
fn why_not(plan: &Plan, head: &Node) -> String {
    if plan.classify(&head.subtree_bounds) == Containment::Outside {
        "outside the region".to_owned()
    } else if plan
        .scans
        .as_ref()
        .is_some_and(|s| !head.scans.iter().any(|c| c.subtree > 0 && s.binary_search(&c.scan).is_ok()))
    {
        "no point of the scans asked for, or all of hidden ones".to_owned()
    } else {
        "the ranges of its attributes exclude the filter".to_owned()
    }
}

fn why_tested(plan: &Plan, head: &Node) -> String {
    let mut reasons = Vec::new();
    if head.own_bounds.is_some_and(|b| plan.classify(&b) == Containment::Partly) {
        reasons.push("partly in the region");
    }
    if plan.filter.is_some() {
        reasons.push("may pass the filter");
    }
    if plan.scans.is_some() {
        reasons.push("some points may be of other scans");
    }
    reasons.join(", ")
}

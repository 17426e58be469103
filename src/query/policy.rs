//! How a view spreads its points: by their error on the screen, or by distance as T. Lenertz has it (Dynamic loading of 3D
//! models, 2014, sections 2.4.4, 2.4.5, 3.4.2 and 3.7.4).
//!
//! The level of a place at distance `d` is `l = (d - d0) / b`, within 0 and `L - 1`, with the start distance `d0 = b^1.3` and
//! the step distance `b = 250 / s`; the ratio of its points that are taken is `r = 1 - (1 - r_min) (l / (L - 1))^a`. The
//! setting `s` is solved for, so that the capacity is used and never passed.
//!
//! How a ratio becomes points, which is ours to say: the tree is split from the root down at every node that is partly out of
//! view, and at every one whose nearest and farthest places are further apart than `split`. The points of nodes that were split
//! are all taken: they are few, and stand for what lies below. Of each subtree that was not split, with `n` points at
//! distance `d`, the `ceil(r(d) n)` coarsest are taken: its nodes level by level, in them part by part, of the last part an
//! even thinning. So a larger capacity only ever adds points: it makes `s` smaller, and every ratio larger.

use super::QueryError;
use super::extent::metric;
use super::view::{RelativeLattice, SelectedPart, Selection, after_parts, not_begun_root};
use crate::geometry::{Camera, Containment, DVec3, WorldBox};
use crate::lattice::{Cube, Lattice};
use crate::octree::Metric;
use crate::store::{Node, NodeIx, Nodes};
use std::cmp::Reverse;

/// How a view spreads its points.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub enum Policy {
    /// What has the largest error in pixels is refined first.
    #[default]
    Screen,
    /// Ratios that fall with distance.
    Distance(DistancePolicy),
}

/// What the distance of a cube is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CubeDistance {
    /// That of its centre.
    Center,
    /// That of its nearest place.
    #[default]
    Minimum,
    /// That of its farthest place.
    Maximum,
    /// The mean of the nearest's and the farthest's.
    Mean,
}

/// The parameters of the policy of distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DistancePolicy {
    /// `a`: how strongly the ratio falls; 2 keeps the density on the screen about even.
    pub amount: f64,
    /// `L`: after so many steps of distance the least ratio is reached.
    pub levels: u32,
    /// `r_min = n_min / n_total`: the least ratio, between 0 and 1.
    pub min_ratio: f64,
    /// What the distance of a cube is.
    pub distance: CubeDistance,
    /// Cubes are split while the distances of their nearest and farthest places differ by more, in CRS units; `None`: by more
    /// than a sixteenth of the site.
    pub split: Option<f64>,
}

impl Default for DistancePolicy {
    fn default() -> Self {
        Self { amount: 2.0, levels: 16, min_ratio: 0.001, distance: CubeDistance::default(), split: None }
    }
}

impl Policy {
    /// Reads `screen`, or `distance` with what differs from the default after it: `distance,amount=2,levels=16,cube=mean,
    /// min-ratio=0.001,split=10`; `cube` is `center`, `minimum`, `maximum` or `mean`.
    ///
    /// # Errors
    ///
    /// [`QueryError::Policy`] for other words, [`QueryError::Detail`] for numbers that make no sense.
    pub fn parse(text: &str) -> Result<Self, QueryError> {
        let refused = |what: String| QueryError::Policy(what);
        let mut words = text.split(',').map(str::trim);
        let policy = match words.next() {
            Some("screen") => Self::Screen,
            Some("distance") => Self::Distance(DistancePolicy::default()),
            other => {
                let other = other.unwrap_or_default();
                return Err(refused(format!("\"{other}\" is no policy; there are screen and distance")));
            }
        };
        let Self::Distance(mut policy) = policy else {
            let more = words.next().map(|w| refused(format!("the policy of the screen has no \"{w}\"")));
            return more.map_or(Ok(policy), Err);
        };
        for word in words {
            let (name, value) = word.split_once('=').unwrap_or((word, ""));
            let number = || {
                let number = value.parse::<f64>();
                number
                    .map_err(|_| refused(format!("{name} of the distance policy is \"{value}\"; it must be a number")))
            };
            match name {
                "amount" => policy.amount = number()?,
                "levels" => policy.levels = number().map(|n| if n.fract() == 0.0 { n as u32 } else { 0 })?,
                "min-ratio" => policy.min_ratio = number()?,
                "split" => policy.split = Some(number()?),
                "cube" => {
                    policy.distance = match value {
                        "center" => CubeDistance::Center,
                        "minimum" => CubeDistance::Minimum,
                        "maximum" => CubeDistance::Maximum,
                        "mean" => CubeDistance::Mean,
                        _ => {
                            return Err(refused(format!(
                                "cube is \"{value}\"; it must be center, minimum, maximum or mean"
                            )));
                        }
                    }
                }
                _ => {
                    let known = "amount, levels, min-ratio, split and cube";
                    return Err(refused(format!("the distance policy has no \"{name}\"; it has {known}")));
                }
            }
        }
        policy.check()?;
        Ok(Self::Distance(policy))
    }
}

impl DistancePolicy {
    fn check(&self) -> Result<(), QueryError> {
        let refused = |what, value, expected| Err(QueryError::Detail { what, value, expected });
        if !(f64::MIN_POSITIVE..=100.0).contains(&self.amount) {
            return refused("the amount of the distance policy", self.amount, "above 0 and at most 100");
        }
        if self.levels < 2 {
            return refused("the number of levels of the distance policy", self.levels.into(), "2 or more");
        }
        if !(0.0..=1.0).contains(&self.min_ratio) {
            return refused("the least ratio of the distance policy", self.min_ratio, "between 0 and 1");
        }
        match self.split {
            Some(split) if !(f64::MIN_POSITIVE..).contains(&split) => {
                refused("the split distance of the distance policy", split, "a length above 0")
            }
            _ => Ok(()),
        }
    }

    fn of_box(&self, relative: &WorldBox) -> f64 {
        let (nearest, farthest) = (relative.distance_to(DVec3::ZERO), relative.farthest_distance_to(DVec3::ZERO));
        match self.distance {
            CubeDistance::Center => relative.center().length(),
            CubeDistance::Minimum => nearest,
            CubeDistance::Maximum => farthest,
            CubeDistance::Mean => f64::midpoint(nearest, farthest),
        }
    }

    /// The ratio at a distance, for the step distance `step`.
    fn ratio(&self, distance: f64, step: f64, start: f64) -> f64 {
        let last = f64::from(self.levels - 1);
        let share = ((distance - start) / step).clamp(0.0, last) / last;
        let fallen = if self.amount == 2.0 { share * share } else { share.powf(self.amount) };
        1.0 - (1.0 - self.min_ratio) * fallen
    }
}

/// Nodes that are taken together, coarse to fine.
struct Group {
    /// Node, part and points, level by level.
    parts: Vec<(Node, usize, u32)>,
    points: u64,
    distance: f64,
    /// From the eye to its nearest place.
    nearest: f64,
}

/// Selects for a camera at most `capacity` points by distance; all that is in view, if there is no capacity.
///
/// # Errors
///
/// [`QueryError::Detail`] for parameters that make no sense.
pub(crate) fn select_by_distance(
    nodes: &Nodes,
    lattice: &Lattice,
    g: u8,
    camera: &Camera,
    policy: &DistancePolicy,
    capacity: Option<u64>,
) -> Result<Selection, QueryError> {
    policy.check()?;
    let relative = RelativeLattice::new(lattice, camera.eye());
    let bounds = |node: &Node| relative.relative(&node.subtree_bounds);
    let roots = nodes.roots()?;
    let metric = metric(lattice, &roots);
    let extent = roots.iter().filter_map(&bounds).map(|b| b.extent().max_element()).fold(0.0, f64::max);
    let split = policy.split.unwrap_or(extent / 16.0);
    let frustum = camera.frustum();
    let (mut spine, mut groups, mut visited) = (Vec::new(), Vec::new(), 0);
    let mut open = roots;
    while let Some(node) = open.pop() {
        visited += 1;
        let Some(relative) = bounds(&node) else { continue };
        let placed = frustum.classify(&relative);
        if placed == Containment::Outside {
            continue;
        }
        let (nearest, farthest) = (relative.distance_to(DVec3::ZERO), relative.farthest_distance_to(DVec3::ZERO));
        if !node.leaf && node.children != 0 && (placed == Containment::Partly || farthest - nearest > split) {
            open.extend(nodes.children(&node)?);
            spine.push((node, nearest));
            continue;
        }
        let (mut below, mut next) = (vec![node], 0);
        while let Some(node) = below.get(next).cloned() {
            below.extend(nodes.children(&node)?);
            next += 1;
        }
        below.sort_by_key(|n| (Reverse(n.cube.k()), n.ix()));
        let parts: Vec<_> = below.iter().flat_map(parts_of).collect();
        let points = parts.iter().map(|p| u64::from(p.2)).sum();
        groups.push(Group { parts, points, distance: policy.of_box(&relative), nearest: nearest.max(camera.near()) });
    }
    spine.sort_by(|a, b| {
        let k = |n: &Node| Reverse(n.cube.k());
        k(&a.0).cmp(&k(&b.0)).then(a.1.total_cmp(&b.1)).then(a.0.ix().cmp(&b.0.ix()))
    });
    let first = |group: &Group| group.parts.first().map(|p| p.0.ix());
    groups.sort_by(|a, b| a.nearest.total_cmp(&b.nearest).then(first(a).cmp(&first(b))));
    let parts: Vec<_> = spine.iter().flat_map(|(n, _)| parts_of(n)).collect();
    let points = parts.iter().map(|p| u64::from(p.2)).sum();
    let nearest = spine.iter().map(|s| s.1).fold(f64::INFINITY, f64::min).max(camera.near());
    let spine = Group { parts, points, distance: 0.0, nearest };
    let quotas = quotas(policy, &spine, &groups, capacity.unwrap_or(u64::MAX));
    let mut selection = Selection { nodes_visited: visited, ..Selection::default() };
    let mut bounds = (Some(0.0_f64), Some(0.0_f64));
    let mut begun = None;
    for (group, quota) in std::iter::once(&spine).chain(&groups).zip(quotas) {
        if quota > 0 && begun.is_none() {
            begun = group.parts.first().map(|(node, ..)| node.cube);
        }
        selection.points += quota;
        let bound = take(g, &metric, group, quota, begun, &mut selection.parts);
        let px = bound.map(|b| camera.pixels_of_length(b, group.nearest));
        let larger = |a: Option<f64>, b: Option<f64>| Some(a?.max(b?));
        bounds = (larger(bounds.0, bound), larger(bounds.1, px));
    }
    (selection.error_bound, selection.error_bound_px) = (bounds.0, bounds.1.filter(|px| px.is_finite()));
    Ok(selection)
}

fn parts_of(node: &Node) -> impl Iterator<Item = (Node, usize, u32)> + '_ {
    node.parts.iter().enumerate().map(move |(part, facts)| (node.clone(), part, facts.points))
}

/// How many points of the spine and of each group are taken.
fn quotas(policy: &DistancePolicy, spine: &Group, groups: &[Group], capacity: u64) -> Vec<u64> {
    let all: Vec<u64> = std::iter::once(spine).chain(groups).map(|g| g.points).collect();
    if all.iter().sum::<u64>() <= capacity {
        return all;
    }
    let at = |step: f64| -> Vec<u64> {
        let start = step.powf(1.3);
        let quota = |group: &Group| {
            let share = policy.ratio(group.distance, step, start) * group.points as f64;
            (share.ceil() as u64).clamp(group.points.min(1), group.points)
        };
        std::iter::once(spine.points).chain(groups.iter().map(quota)).collect()
    };
    let total = |step: f64| at(step).iter().sum::<u64>();
    // Positive floats are in the order of their bits: the two neighbours between which the capacity is passed.
    let (mut low, mut high) = (1e-9_f64.to_bits(), 1e18_f64.to_bits());
    let fits = |bits: u64| total(f64::from_bits(bits)) <= capacity;
    let (mut quotas, more) = if fits(low) {
        while high - low > 1 {
            let middle = low + (high - low) / 2;
            if fits(middle) {
                low = middle;
            } else {
                high = middle;
            }
        }
        (at(f64::from_bits(low)), at(f64::from_bits(high)))
    } else {
        // Not even the least ratio fits: the spine, then the groups near to far.
        (vec![0; groups.len() + 1], at(f64::from_bits(low)))
    };
    let mut left = capacity - quotas.iter().sum::<u64>();
    for (quota, more) in quotas.iter_mut().zip(more) {
        let added = (more.max(*quota) - *quota).min(left);
        *quota += added;
        left -= added;
    }
    quotas
}

/// Takes the first `quota` points of a group, and says how far what is left out can be; `None`: nobody knows. `begun` is the
/// cube of the first node of which anything is taken.
fn take(
    g: u8,
    metric: &Metric,
    group: &Group,
    quota: u64,
    begun: Option<Cube>,
    taken: &mut Vec<SelectedPart>,
) -> Option<f64> {
    let mut left = quota;
    let mut bound = 0.0_f64;
    // The node of which a part is not wholly there: what lies behind it in the group is not begun.
    let mut broken: Option<NodeIx> = None;
    for (node, part, all) in &group.parts {
        let (part, all) = (*part, *all);
        let points = u32::try_from(left).unwrap_or(u32::MAX).min(all);
        if points > 0 {
            taken.push(SelectedPart { node: node.ix(), part: part as u32, points });
        }
        left -= u64::from(points);
        if points == all || broken == Some(node.ix()) {
            continue;
        }
        broken = Some(node.ix());
        // Of this level and below some nodes are not there: their parents are.
        let of_parent = (node.cube.k() + 1).saturating_sub(g) as i8;
        bound = bound.max(metric.step_bound(of_parent, 7));
        // Nothing stands for a root, which each layer has.
        if node.is_root() {
            let is_begun = points > 0 || part > 0;
            let of_root = if is_begun { after_parts(metric, node, part) } else { not_begun_root(metric, node, begun?) };
            bound = bound.max(of_root);
        }
    }
    Some(bound)
}

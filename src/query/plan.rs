//! A query on one snapshot: names looked up, numbers on the lattice, and what nodes can hold by their rows alone.

use super::answer::{Answer, Meter};
use super::cancel::Cancel;
use super::extent::metric;
use super::filter::{BoundFilter, Known, Names, attributes_named};
use super::kinds::Kinds;
use super::mask::Mask;
use super::output::{contributing, passing};
use super::region::LatticeRegion;
use super::watch::Watch;
use super::{Attributes, Filter, Query, QueryError, Region, error::nearest};
use crate::geometry::Containment;
use crate::lattice::{BITS, Cube, Lattice, LatticeBox, LatticePoint};
use crate::octree::Metric;
use crate::points::{Attribute, Positions, ScalarType};
use crate::store::model::{ScanId, Slot, StoredAttribute};
use crate::store::{Node, NodeIx, Nodes, Snapshot};
use rayon::prelude::*;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// A query, ready to run.
pub(crate) struct Plan {
    pub snapshot: Snapshot,
    pub nodes: Nodes,
    /// The root of every layer that has one.
    pub roots: Vec<Node>,
    pub lattice: Lattice,
    pub g: u8,
    pub region: LatticeRegion,
    /// The half-open box or boxes, where `region` is the closed one: the points between them are counted, not taken.
    pub taken: Option<LatticeRegion>,
    pub filter: Option<BoundFilter>,
    /// What the filter looks at.
    pub filter_columns: Vec<(Slot, ScalarType)>,
    /// The scans whose points match, ascending; `None`: all.
    pub scans: Option<Vec<ScanId>>,
    /// What is returned, in this order.
    pub columns: Vec<StoredAttribute>,
    /// The same, as batches carry it.
    pub attributes: Arc<[Attribute]>,
    /// Are the scans of the points returned?
    pub with_scans: bool,
    /// Threads that decode; `None`: all of the pool.
    pub threads: Option<usize>,
    pub cancel: Cancel,
    watch: Option<Watch>,
    /// Do decoded blocks go through the store's cache? Not for large answers: they would drive out everything else, and
    /// be copied once more.
    pub keeps_blocks: bool,
    pub meter: Meter,
    start: Instant,
}

/// What is known of some points by the rows alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Prospect {
    /// None of them matches.
    Nothing,
    /// Some may match.
    Some,
    /// All of them match.
    Everything,
}

/// Which points of a node are meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scope {
    /// Those that it stores.
    Own,
    /// Those and all below.
    Subtree,
}

impl Plan {
    pub fn new(query: &Query, snapshot: &Snapshot) -> Result<Self, QueryError> {
        let start = Instant::now();
        let site = snapshot.site();
        query.region.check_coordinates(site.crs.as_ref(), bounds_in_plan(snapshot))?;
        let scans = Some(asked_scans(query, snapshot)?).filter(|scans| scans.len() < snapshot.scans().len());
        let region = query.region.on_lattice(&site.lattice)?;
        let bind = |filter: &Filter| {
            let met = Kinds::of(snapshot, &contributing(snapshot, scans.as_deref(), &region));
            let attributes = snapshot.attributes();
            filter.bind(&Names { attributes, scans: snapshot.scans(), lattice: &site.lattice, met: &met })
        };
        let filter = query.filter.as_ref().map(bind).transpose()?;
        let slots = filter.as_ref().map_or_else(Vec::new, BoundFilter::slots);
        let filter_columns = slots.into_iter().filter_map(|s| Some((s, snapshot.attribute(s)?.attribute.ty))).collect();
        let nodes = snapshot.nodes();
        let mut plan = Self {
            snapshot: snapshot.clone(),
            roots: nodes.roots()?,
            nodes,
            lattice: site.lattice.clone(),
            g: site.g,
            region,
            taken: None,
            filter,
            filter_columns,
            scans,
            columns: Vec::new(),
            attributes: Arc::default(),
            with_scans: query.with_scans,
            threads: query.threads,
            cancel: query.cancel.clone().unwrap_or_default(),
            watch: query.watch.clone(),
            keeps_blocks: false,
            meter: Meter::default(),
            start,
        };
        let of = match query.tight {
            true => Some(passing(&plan, contributing(snapshot, plan.scans.as_deref(), &plan.region))?),
            false => plan.scans.clone(),
        };
        plan.columns = columns(&query.attributes, of.as_deref(), snapshot)?;
        plan.attributes = plan.columns.iter().map(|c| c.attribute.clone()).collect();
        Ok(plan)
    }

    /// Lengths in CRS units.
    pub fn metric(&self) -> Metric {
        Metric::new(self.lattice.quantum_f64())
    }

    /// The same, of which none is longer than the site is wide. Not for levels: each has a bound of its own, which asks for it.
    pub fn metric_within(&self) -> Metric {
        metric(&self.lattice, &self.roots)
    }

    /// The root that the points of all layers would have in one.
    pub fn root(&self) -> Option<Cube> {
        self.snapshot.site().root()
    }

    /// The layer of a node, by its number.
    pub fn layer_of(&self, node: NodeIx) -> Option<u16> {
        self.roots.iter().find(|root| root.subtree().contains(&node)).map(|root| root.layer)
    }

    /// Looks at the points on the maximum faces of a box or of several, too, to count them.
    pub fn count_faces(&mut self, asked: &Region) -> Result<(), QueryError> {
        let closed = asked.closed_on(&self.lattice).on_lattice(&self.lattice)?;
        self.taken = Some(std::mem::replace(&mut self.region, closed));
        Ok(())
    }

    /// How all the lattice points of `bounds` lie to what is taken; where it is `Outside`, none of them is on a face
    /// that is counted either.
    pub fn classify(&self, bounds: &LatticeBox) -> Containment {
        match (self.region.classify(bounds), &self.taken) {
            (Containment::Inside, Some(taken)) if taken.classify(bounds) != Containment::Inside => Containment::Partly,
            (placed, _) => placed,
        }
    }

    /// Removes the points on the maximum faces, and counts them; `positions` are those of a block, which is within
    /// `bounds`.
    pub fn leave_faces(&self, positions: &Positions, bounds: &LatticeBox, mask: &mut Mask) {
        let Some(taken) = &self.taken else { return };
        if let (Some(closed), Some(taken)) = (self.region.as_box(), taken.as_box())
            && taken.contains_box(&LatticeBox {
                min: LatticePoint(std::array::from_fn(|i| closed.min.0[i].max(bounds.min.0[i]))),
                max: LatticePoint(std::array::from_fn(|i| closed.max.0[i].min(bounds.max.0[i]))),
            })
        {
            // The block reaches no maximum face.
            return;
        }
        let before = mask.count();
        mask.and(&taken.test(positions, bounds));
        Meter::add(&self.meter.on_maximum_faces, (before - mask.count()) as u64);
    }

    /// Does every point match that lies inside the region?
    pub fn is_unfiltered(&self) -> bool {
        self.filter.is_none() && self.scans.is_none()
    }

    /// Does every point of the cube match, whoever stores it?
    pub fn takes_all_of(&self, cube: Cube) -> bool {
        self.is_unfiltered() && self.region.classify(&cube.to_box()) == Containment::Inside
    }

    /// What a node, or its subtree, can hold.
    pub fn prospect(&self, head: &Node, scope: Scope) -> Result<Prospect, QueryError> {
        let bounds = match scope {
            Scope::Own => match &head.own_bounds {
                Some(bounds) => bounds,
                None => return Ok(Prospect::Nothing),
            },
            Scope::Subtree => &head.subtree_bounds,
        };
        let placed = self.classify(bounds);
        if placed == Containment::Outside {
            return Ok(Prospect::Nothing);
        }
        let count = |s: &crate::store::model::ScanCount| if scope == Scope::Own { s.own } else { s.subtree };
        let here = || head.scans.iter().filter(|s| count(s) > 0).map(|s| s.scan);
        let mut all = placed == Containment::Inside;
        if let Some(scans) = &self.scans {
            let among = |s: ScanId| scans.binary_search(&s).is_ok();
            if !here().any(among) {
                return Ok(Prospect::Nothing);
            }
            all &= here().all(among);
        }
        if let Some(filter) = &self.filter {
            let zones = self.nodes.zones(head)?;
            let ranges = if scope == Scope::Own { &zones.own } else { &zones.subtree };
            let scans: Vec<ScanId> = here().collect();
            if !filter.may_match(&Known { ranges, scans: &scans, bounds }) {
                return Ok(Prospect::Nothing);
            }
            all = false;
        }
        Ok(if all { Prospect::Everything } else { Prospect::Some })
    }

    /// Calls `visit` for every node whose subtree can match, in pre-order; `visit` says whether to go on below it.
    pub fn walk(&self, visit: impl FnMut(&Node) -> Result<bool, QueryError>) -> Result<(), QueryError> {
        self.walk_from(self.roots.iter().rev().cloned().collect(), visit)
    }

    /// The same from these nodes, the last first.
    pub fn walk_from(
        &self,
        mut open: Vec<Node>,
        mut visit: impl FnMut(&Node) -> Result<bool, QueryError>,
    ) -> Result<(), QueryError> {
        let mut visited = 0;
        while let Some(node) = open.pop() {
            visited += 1;
            self.cancel.check()?;
            if self.prospect(&node, Scope::Subtree)? != Prospect::Nothing && visit(&node)? {
                let first = open.len();
                open.extend(self.nodes.children(&node)?);
                open[first..].reverse();
            }
        }
        Meter::add(&self.meter.nodes_visited, visited);
        Ok(())
    }

    /// Decides whether decoded blocks are kept, when so many points are to be read.
    pub fn reads(&mut self, points: u64) {
        let columns = self.columns.iter().map(|c| c.attribute.ty.size());
        let filter = self.filter_columns.iter().map(|c| c.1.size());
        let point_bytes = 24 + columns.chain(filter).sum::<usize>() as u64;
        self.keeps_blocks = points.saturating_mul(point_bytes) <= self.snapshot.kept_block_bytes() / 2;
    }

    /// Says that the positions of so many points were decoded.
    pub fn decoded(&self, points: u64) {
        Meter::add(&self.meter.points_decoded, points);
        if let Some(watch) = &self.watch {
            watch.add(points);
        }
    }

    /// Says that those of so many points at most will be, and no others.
    pub fn expects(&self, points: u64) {
        if let Some(watch) = &self.watch {
            watch.expect(points);
        }
    }

    /// Does `work` for each of the items, on the query's threads; the results are in their order.
    pub fn each<T: Send, R: Send>(
        &self,
        items: Vec<T>,
        work: impl Fn(T) -> Result<R, QueryError> + Sync,
    ) -> Result<Vec<R>, QueryError> {
        if let Some(threads) = self.threads.filter(|&threads| threads < rayon::current_num_threads()) {
            return on_threads(threads, items, work);
        }
        // Collected before an error is picked, so that of several it is always the first.
        items.into_par_iter().map(&work).collect::<Vec<_>>().into_iter().collect()
    }

    /// Tasks that are worked on together, where that is done in rounds: enough that no thread waits for long.
    pub fn window(&self) -> usize {
        16 * self.threads()
    }

    /// The threads that work at a time.
    pub fn threads(&self) -> usize {
        self.threads.unwrap_or_else(rayon::current_num_threads)
    }

    /// Adds to an answer what is known in the end.
    pub fn finish(&self, answer: Answer) -> Answer {
        let on_faces = self.meter.on_maximum_faces.load(Ordering::Relaxed);
        Answer {
            region_misses_site: self.region_misses_site(),
            on_maximum_faces: self.taken.is_some().then_some(on_faces),
            statistics: self.meter.statistics(self.start.elapsed()),
            ..answer
        }
    }

    /// At most how many points an answer has: at each cell exponent down to `finest`, and, if that is `None`, in all.
    pub fn most_points(&self, finest: Option<u8>) -> Result<MostPoints, QueryError> {
        let nothing = [0; BITS as usize + 1];
        let mut most = MostPoints { by_cell: nothing, about: nothing, all: 0 };
        self.walk(|head| {
            let own = match &self.scans {
                None => head.own_points,
                // The winner of a cell may be of any scan, so cells are counted in full.
                Some(scans) => head.scans.iter().filter(|s| scans.binary_search(&s.scan).is_ok()).map(|s| s.own).sum(),
            };
            if self.prospect(head, Scope::Own)? != Prospect::Nothing {
                most.all += own;
            }
            let mut own = [0; BITS as usize + 1];
            for (part, facts) in head.parts.iter().enumerate() {
                // The first point of all wins every cell.
                let is_first = head.is_root() && part == 0;
                let coarsest = if is_first { BITS as i8 } else { facts.first_step.win.clamp(0, BITS as i8) };
                own[..=coarsest as usize].iter_mut().for_each(|n| *n += u64::from(facts.points));
            }
            for (c, most_here) in own.into_iter().enumerate() {
                let about = if head.leaf { most_here.min(cells_of_a_surface(head, c as u8)) } else { most_here };
                most.by_cell[c] += most_here;
                most.about[c] += about;
            }
            Ok(finest.is_none_or(|c| head.cube.k() > c.saturating_add(self.g)))
        })?;
        Ok(most)
    }

    /// Does the region lie outside everything that is stored?
    pub fn region_misses_site(&self) -> bool {
        let region = self.taken.as_ref().unwrap_or(&self.region);
        let outside = |r: &Node| region.classify(&r.subtree_bounds) == Containment::Outside;
        !self.roots.is_empty() && self.roots.iter().all(outside)
    }
}

/// How many cells of exponent `c` a surface in the bounds of a node's points would meet, seen from where it is largest.
fn cells_of_a_surface(head: &Node, c: u8) -> u64 {
    let Some(LatticeBox { min, max }) = head.own_bounds else { return 0 };
    let mut sides: [u64; 3] = std::array::from_fn(|axis| (max.0[axis] >> c) - (min.0[axis] >> c) + 1);
    sides.sort_unstable();
    sides[1].saturating_mul(sides[2])
}

/// Upper limits of the number of matching points.
pub(crate) struct MostPoints {
    by_cell: [u64; BITS as usize + 1],
    /// No limits, but about as many as there are, if all match.
    about: [u64; BITS as usize + 1],
    /// Of all.
    pub all: u64,
}

impl MostPoints {
    /// Of those that an answer at this cell exponent has.
    pub fn at_level(&self, cell: u8) -> u64 {
        self.by_cell[usize::from(cell.min(BITS))]
    }

    /// About how many those are, if all match: leaves hold points of several levels.
    pub fn about(&self, cell: u8) -> u64 {
        self.about[usize::from(cell.min(BITS))]
    }
}

/// Least and greatest x and y of all points.
fn bounds_in_plan(snapshot: &Snapshot) -> Option<([f64; 2], [f64; 2])> {
    let bounds = snapshot.scans().iter().filter_map(|s| s.bounds).reduce(|a, b| a.union(&b))?;
    let plan = |p| {
        let [x, y, _] = snapshot.site().lattice.world_from_lattice(p);
        [x, y]
    };
    Some((plan(bounds.min), plan(bounds.max)))
}

/// The scans that are asked for by name, or all visible ones, ascending.
pub(super) fn asked_scans(query: &Query, snapshot: &Snapshot) -> Result<Vec<ScanId>, QueryError> {
    let all = snapshot.scans();
    let mut scans: Vec<ScanId> = match &query.scans {
        None => all.iter().filter(|s| s.visible).map(|s| s.id).collect(),
        Some(names) => {
            let by_name = |name: &String| {
                let found = all.iter().find(|s| s.name == *name);
                let found = found.or_else(|| all.iter().find(|s| name.parse() == Ok(s.id)));
                found.map(|s| s.id).ok_or_else(|| QueryError::UnknownScan {
                    name: name.clone(),
                    nearest: nearest(name, all.iter().map(|s| s.name.as_str())),
                })
            };
            names.iter().map(by_name).collect::<Result<_, _>>()?
        }
    };
    scans.sort_unstable();
    scans.dedup();
    Ok(scans)
}

/// The attributes to return, in canonical order. Of several of one name those that a scan has whose points are asked for.
fn columns(
    asked: &Attributes,
    scans: Option<&[ScanId]>,
    snapshot: &Snapshot,
) -> Result<Vec<StoredAttribute>, QueryError> {
    let all = snapshot.attributes();
    let contributing = snapshot.scans().iter().filter(|s| scans.is_none_or(|ids| ids.contains(&s.id)));
    let slots: std::collections::BTreeSet<Slot> = contributing.flat_map(|s| s.attributes.iter().copied()).collect();
    let mut columns: Vec<StoredAttribute> = match asked {
        Attributes::None => Vec::new(),
        Attributes::All => all.iter().filter(|a| slots.contains(&a.id)).cloned().collect(),
        Attributes::Named(names) => {
            let mut columns = Vec::new();
            for name in names {
                let found = attributes_named(name, all);
                if found.is_empty() && ["x", "y", "z"].iter().any(|axis| name.eq_ignore_ascii_case(axis)) {
                    return Err(QueryError::Coordinate { name: name.clone() });
                }
                if found.is_empty() {
                    let nearest = nearest(name, all.iter().map(|a| a.attribute.name.as_str()));
                    return Err(QueryError::UnknownAttribute { name: name.clone(), nearest });
                }
                let is_there = |a: &StoredAttribute| slots.contains(&a.id);
                let some = found.iter().any(|a| is_there(a));
                columns.extend(found.into_iter().filter(|a| !some || is_there(a)).cloned());
            }
            columns
        }
    };
    columns.sort_by(|a, b| a.attribute.identity().cmp(&b.attribute.identity()));
    columns.dedup_by_key(|c| c.id);
    Ok(columns)
}

/// Does `work` for each of the items on so many threads; the results are in the items' order.
fn on_threads<T: Send, R: Send>(
    threads: usize,
    items: Vec<T>,
    work: impl Fn(T) -> Result<R, QueryError> + Sync,
) -> Result<Vec<R>, QueryError> {
    if threads < 2 {
        return items.into_iter().map(work).collect();
    }
    let rest = Mutex::new(items.into_iter().enumerate());
    let next = || rest.lock().unwrap_or_else(PoisonError::into_inner).next();
    let done = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while let Some((i, item)) = next() {
                    let result = work(item);
                    done.lock().unwrap_or_else(PoisonError::into_inner).push((i, result));
                }
            });
        }
    });
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_unstable_by_key(|(i, _)| *i);
    done.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A number above one was taken for all.
    #[test]
    fn work_is_done_on_so_many_threads_at_most_and_in_order() {
        for threads in [1, 2, 3] {
            let seen = Mutex::new(std::collections::HashSet::new());
            let work = |i: u64| {
                seen.lock().unwrap().insert(std::thread::current().id());
                std::thread::sleep(std::time::Duration::from_millis(i % 3));
                if i == 77 { Err(QueryError::Cancelled) } else { Ok(i * i) }
            };
            let done = on_threads(threads, (0..60).collect(), work).unwrap();
            assert_eq!(done, (0..60).map(|i| i * i).collect::<Vec<u64>>());
            assert!(on_threads(threads, (0..90).collect(), work).is_err());
            assert!(seen.lock().unwrap().len() <= 2 * threads);
        }
    }
}

//! A thinned piece: the least matching point of every cell in it, in the order of the points.

use super::QueryError;
use super::answer::Meter;
use super::cells::{Hole, Level, Pick, Reading, fill, read_node};
use super::looked::Place;
use super::pieces::{Above, Piece};
use super::plan::Plan;
use super::task::{by_part, work};
use super::ties;
use crate::lattice::{Cube, Key, LOW_DIGITS, LatticePoint, SortKey};
use crate::octree::{Step, put_wins, steps};
use crate::points::{Batch, Column, Positions};
use crate::store::{Node, NodeIx};
use std::collections::BTreeSet;

/// Where some of a piece's points are.
pub(crate) enum Source<'a> {
    /// In a node above the piece.
    Above(Vec<Pick>),
    /// In a part of it that was read.
    Read(Reading<'a>),
    /// Further down, where holes were filled.
    Filled(Vec<Pick>),
}

/// The points of a piece that an answer may hold.
pub(crate) struct Thinned<'a> {
    plan: &'a Plan,
    /// Numbered through, in this order: of equal keys in a layer the point with the least number comes first.
    sources: Vec<Source<'a>>,
    /// The number of each source's first point, and of all.
    starts: Vec<u32>,
    /// The points by number, in key order.
    pub order: Vec<u32>,
    /// The step of each, if that was asked for, as if nothing came before the piece.
    pub steps: Vec<u8>,
    /// The first key.
    pub first: Option<Key>,
}

/// Reads a piece and thins it to cells of exponent `c`; `None`: all points are kept.
pub(crate) fn thin<'a>(plan: &'a Plan, piece: &Piece, c: Option<u8>, steps: bool) -> Result<Thinned<'a>, QueryError> {
    // What fits 64 bits is sorted in a third of the time.
    if piece.cube.k() <= LOW_DIGITS {
        thin_by(plan, piece, c, steps, |point| point.low_key())
    } else {
        thin_by(plan, piece, c, steps, Key::of)
    }
}

fn thin_by<'a, K: SortKey>(
    plan: &'a Plan,
    piece: &Piece,
    c: Option<u8>,
    with_steps: bool,
    key: impl Fn(LatticePoint) -> K,
) -> Result<Thinned<'a>, QueryError> {
    let base = if piece.cube.k() <= LOW_DIGITS { piece.cube.first_key().high } else { 0 };
    let full = |key: K| {
        let (high, low) = key.halves();
        Key { high: base | high, low }
    };
    let mut sources = Vec::new();
    let mut level = Level::default();
    let mut frontier = Vec::new();
    for tree in &piece.trees {
        for above in Above::path(tree.above.as_ref()) {
            let known = above.known(plan, c)?;
            sources.push(Source::Above(within(&known.picks, |p| p.key, piece.cube, 0)));
            if let Some(c) = c {
                level.missed.extend(within(&known.missed, |m| *m, piece.cube, c));
            }
        }
        if let Some(node) = &tree.node {
            read_tree(plan, node, tree.root, c, &mut level, &mut frontier)?;
        }
    }
    sources.extend(level.readings.into_iter().map(Source::Read));
    let mut starts = vec![0];
    let mut order: Vec<(K, u32)> = Vec::new();
    let mut number = |sources: &[Source], order: &mut Vec<(K, u32)>| {
        for source in sources {
            let mut next = order.len() as u32;
            let mut push = |key: K| {
                order.push((key, next));
                next += 1;
            };
            match source {
                Source::Above(picks) | Source::Filled(picks) => picks.iter().for_each(|p| push(key(p.key.point()))),
                Source::Read(reading) => reading.positions(|point| push(key(point))),
            }
            starts.push(order.len() as u32);
        }
    };
    number(&sources, &mut order);
    // Stable, since that merges runs that ascend, and all sources do.
    order.sort();
    if let Some(c) = c {
        level.missed.sort_unstable();
        level.missed.dedup();
        let filled = filled(plan, &frontier, c, level.missed, |floor| {
            let at = order.partition_point(|(k, _)| full(*k) < floor);
            order.get(at).map(|(k, _)| full(*k)).filter(|k| k.floor(c) == floor)
        })?;
        if !filled.is_empty() {
            // In the order of their numbers again, with which `number` goes on.
            order.sort_unstable_by_key(|(_, at)| *at);
            let first = sources.len();
            sources.push(Source::Filled(filled));
            number(&sources[first..], &mut order);
            order.sort();
        }
    }
    let mut thinned = Thinned { plan, sources, starts, order: Vec::new(), steps: Vec::new(), first: None };
    thinned.settle(&mut order, full)?;
    if let Some(c) = c {
        let mut previous = None;
        order.retain(|(key, _)| {
            let is_first = previous.is_none_or(|p: K| p.differing_digit(*key) >= c as i8);
            previous = Some(*key);
            is_first
        });
    }
    thinned.first = order.first().map(|(key, _)| full(*key));
    if with_steps {
        let keys: Vec<K> = order.iter().map(|(key, _)| *key).collect();
        let mut wins = Vec::new();
        put_wins(&keys, piece.cube.k() as i8, &mut wins);
        let groups = steps(&keys, &wins);
        thinned.steps = wins.iter().zip(&groups).map(|(&win, &group)| Step { win, group }.ordinal()).collect();
    }
    thinned.order = order.into_iter().map(|(_, at)| at).collect();
    Ok(thinned)
}

/// What of an ascending list lies in a cube, or in a cell of exponent `c` that holds it.
fn within<T: Clone>(all: &[T], key: impl Fn(&T) -> Key, cube: Cube, c: u8) -> Vec<T> {
    let (first, last) = (cube.first_key().floor(c), cube.last_key());
    all[all.partition_point(|t| key(t) < first)..all.partition_point(|t| key(t) <= last)].to_vec()
}

/// Reads the nodes of a tree that have something of a level, and says below which there may be more.
fn read_tree<'a>(
    plan: &'a Plan,
    top: &Node,
    root: Cube,
    c: Option<u8>,
    level: &mut Level<'a>,
    frontier: &mut Vec<Node>,
) -> Result<(), QueryError> {
    let mut above = Vec::new();
    plan.walk_from(vec![top.clone()], |head| {
        let Some(c) = c else {
            above.push(head.clone());
            return Ok(true);
        };
        let finer = i16::from(head.cube.k()) < i16::from(c) + i16::from(plan.g);
        if finer && !head.is_root() {
            return Ok(false);
        }
        above.push(head.clone());
        let lowest = finer || head.cube.k() == c + plan.g;
        if lowest && !head.leaf {
            frontier.push(head.clone());
        }
        Ok(!lowest)
    })?;
    above.iter().try_for_each(|node| read_node(plan, node, root, c, level))
}

/// The least matching points below the frontier in cells that are missed, ascending; `best` is the least key that was
/// found in one.
fn filled(
    plan: &Plan,
    frontier: &[Node],
    c: u8,
    missed: Vec<Key>,
    best: impl Fn(Key) -> Option<Key>,
) -> Result<Vec<Pick>, QueryError> {
    let mut picks = Vec::new();
    if missed.is_empty() {
        return Ok(picks);
    }
    for node in frontier {
        let cube = node.cube;
        let from = missed.partition_point(|m| *m < cube.first_key().floor(c));
        let to = missed.partition_point(|m| *m <= cube.last_key());
        let mut holes: Vec<Hole> = missed[from..to].iter().map(|&floor| Hole::new(floor, c, best(floor))).collect();
        fill(plan, node, c, &mut holes)?;
        picks.extend(holes.into_iter().filter_map(|h| h.found));
    }
    picks.sort();
    Ok(picks)
}

impl Thinned<'_> {
    /// Puts runs of equal keys of several layers into the canonical order of points.
    fn settle<K: SortKey>(&self, order: &mut [(K, u32)], full: impl Fn(K) -> Key) -> Result<(), QueryError> {
        if self.plan.roots.len() < 2 {
            return Ok(());
        }
        // Made once, since there may be many ties.
        let indices = self.indices();
        let mut tied: Vec<(Pick, u32)> = Vec::new();
        for run in order.chunk_by(|a, b| a.0 == b.0).filter(|run| run.len() > 1) {
            tied.extend(run.iter().map(|&(key, at)| (self.pick(full(key), at, &indices), at)));
        }
        let mut picks: Vec<Pick> = tied.iter().map(|(pick, _)| *pick).collect();
        ties::settle(self.plan, &mut picks)?;
        tied.sort_unstable_by_key(|(pick, _)| *pick);
        let mut settled = picks.iter().filter_map(|pick| {
            let i = tied.binary_search_by_key(pick, |(pick, _)| *pick).ok()?;
            Some(tied[i].1)
        });
        for run in order.chunk_by_mut(|a, b| a.0 == b.0).filter(|run| run.len() > 1) {
            for (_, at) in run {
                *at = settled.next().unwrap_or(*at);
            }
        }
        Ok(())
    }

    /// Where the points of each part that was read are in it.
    fn indices(&self) -> Vec<Vec<u32>> {
        let of_source = |source: &Source| match source {
            Source::Read(reading) => reading.indices().collect(),
            Source::Above(_) | Source::Filled(_) => Vec::new(),
        };
        self.sources.iter().map(of_source).collect()
    }

    /// Where some of the points are, told by their numbers in key order.
    pub fn places(&self, some: impl ExactSizeIterator<Item = usize>) -> Vec<Place> {
        if some.len() == 0 {
            return Vec::new();
        }
        let indices = self.indices();
        let place = |i: usize| {
            let (source, within) = self.place(self.order[i]);
            match &self.sources[source] {
                Source::Above(picks) | Source::Filled(picks) => {
                    let pick = picks[within];
                    (pick.node, pick.part, pick.index)
                }
                Source::Read(reading) => (reading.node, reading.part, indices[source][within]),
            }
        };
        some.map(place).collect()
    }

    /// The source of a point, and its place there.
    fn place(&self, at: u32) -> (usize, usize) {
        let source = self.starts.partition_point(|&start| start <= at) - 1;
        (source, (at - self.starts[source]) as usize)
    }

    /// `indices` has those of each source that was read.
    fn pick(&self, key: Key, at: u32, indices: &[Vec<u32>]) -> Pick {
        let (source, i) = self.place(at);
        match &self.sources[source] {
            Source::Above(picks) | Source::Filled(picks) => picks[i],
            Source::Read(reading) => {
                let index = indices[source].get(i).copied().unwrap_or_default();
                Pick { key, node: reading.node, part: reading.part, index }
            }
        }
    }

    /// Which of the points by number are in the answer, `kept` saying so in key order.
    fn taken(&self, kept: &[bool]) -> Vec<bool> {
        let mut taken = vec![false; self.starts.last().map_or(0, |&end| end as usize)];
        self.order.iter().zip(kept).for_each(|(&at, &kept)| taken[at as usize] = kept);
        taken
    }

    /// How many points of each node are in the answer, `kept` saying so in key order.
    pub fn count(&self, kept: &[bool]) -> Vec<(NodeIx, u64)> {
        let taken = self.taken(kept);
        let mut counts = Vec::new();
        for (source, range) in self.sources.iter().zip(self.starts.windows(2)) {
            let taken = &taken[range[0] as usize..range[1] as usize];
            match source {
                Source::Read(reading) => counts.push((reading.node, taken.iter().map(|&t| u64::from(t)).sum())),
                Source::Above(picks) | Source::Filled(picks) => {
                    counts.extend(picks.iter().zip(taken).filter(|(_, taken)| **taken).map(|(pick, _)| (pick.node, 1)));
                }
            }
        }
        counts
    }

    /// The points with the attributes asked for, in the order of nodes, `kept` saying in key order which.
    pub fn batch(self, kept: &[bool]) -> Result<Batch, QueryError> {
        let plan = self.plan;
        let count = kept.iter().filter(|kept| **kept).count();
        let mut all = Batch::empty(plan.attributes.clone());
        if count == 0 {
            return Ok(all);
        }
        let taken = self.taken(kept);
        all.positions = Positions::with_capacity(count);
        all.columns = plan.columns.iter().map(|c| Column::with_capacity(c.attribute.ty, count)).collect();
        let mut nodes = BTreeSet::new();
        for (source, range) in self.sources.into_iter().zip(self.starts.windows(2)) {
            let taken = &taken[range[0] as usize..range[1] as usize];
            if !taken.contains(&true) {
                continue;
            }
            match source {
                Source::Read(mut reading) => {
                    if taken.contains(&false) {
                        let mut taken = taken.iter().copied();
                        reading.narrow(|| taken.next().unwrap_or(false));
                    }
                    nodes.insert(reading.node);
                    reading.read.take_into(&reading.found, &mut all)?;
                }
                Source::Above(picks) | Source::Filled(picks) => {
                    let taken = picks.iter().zip(taken).filter(|(_, taken)| **taken);
                    let mut places: Vec<_> = taken.map(|(p, _)| (p.node, p.part, p.index)).collect();
                    places.sort_unstable();
                    nodes.extend(places.iter().map(|p| p.0));
                    for task in by_part(plan, &places)? {
                        all.append(&work(plan, task)?);
                    }
                }
            }
        }
        Meter::add(&plan.meter.nodes, nodes.len() as u64);
        Ok(all)
    }
}

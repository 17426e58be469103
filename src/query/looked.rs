//! A first look at the pieces of a store: how many points each step of the sequence has, and where the coarsest are.

use super::QueryError;
use super::pieces::{Piece, Pieces};
use super::plan::Plan;
use super::thin::thin;
use crate::lattice::{BITS, Cube, Key};
use crate::octree::{EvenPrefix, Step, first_win, steps};
use crate::store::NodeIx;

/// Of so many points is remembered where they are, of the coarsest.
const HELD_POINTS: usize = if cfg!(test) { 40 } else { 1 << 20 };

/// Pieces of so many points are looked at together, and at least one for each thread.
const WINDOW_POINTS: u64 = 4 << 20;

/// The node, the part of it, the place in that.
pub(crate) type Place = (NodeIx, u32, u32);

/// Where the sequence is cut off.
pub(crate) struct Cut {
    /// The step in which that is.
    pub step: u8,
    /// Those of its points that are taken, by their number in key order.
    even: EvenPrefix,
}

impl Cut {
    pub fn takes(&self, step: u8, number: impl FnOnce() -> u64) -> bool {
        step < self.step || step == self.step && self.even.contains(number())
    }
}

/// What is known of a cube in which something matches.
#[derive(Clone, Copy)]
pub(crate) struct Known {
    cube: Cube,
    /// The step of its first point.
    pub first: u8,
    /// How many points of the cut step come before it.
    pub before: u64,
}

/// Disjoint cubes that have all matching points, ascending.
pub(crate) struct Places(Vec<Known>);

impl Places {
    /// What is known of the first of these cubes that lies in another; `None` if none does.
    pub fn of(&self, cube: Cube) -> Option<Known> {
        let known = self.0.get(self.0.partition_point(|k| k.cube.last_key() < cube.first_key()))?;
        (known.cube.first_key() <= cube.last_key()).then_some(*known)
    }
}

/// What a look at a piece tells.
struct Facts {
    cube: Cube,
    first: Key,
    /// How many points each step has, the first point left out.
    counts: Vec<(u8, u64)>,
    held: Vec<Held>,
}

/// A point of which is remembered where it is.
struct Held {
    place: Place,
    /// `None` for the first point of a piece: what comes before it decides.
    step: Option<u8>,
    /// How many points of its step come before it in its piece, the first left out.
    number: u32,
}

/// Points of no step after `held` are remembered. `None` if nothing matches.
fn look(plan: &Plan, piece: &Piece, cell: Option<u8>, held: Option<u8>) -> Result<Option<Facts>, QueryError> {
    let thinned = thin(plan, piece, cell, true)?;
    let Some(first) = thinned.first else { return Ok(None) };
    let mut counts = [0_u32; Step::COUNT];
    let mut coarse = Vec::new();
    for (i, &step) in thinned.steps.iter().enumerate() {
        let count = &mut counts[usize::from(step)];
        if held.is_some_and(|last| i == 0 || step <= last) {
            coarse.push((i, (i > 0).then_some(step), *count));
        }
        *count += u32::from(i > 0);
    }
    let places = thinned.places(coarse.iter().map(|c| c.0));
    let held = places.into_iter().zip(coarse).map(|(place, (_, step, number))| Held { place, step, number }).collect();
    let counts = (0..).zip(counts).filter(|(_, n)| *n > 0).map(|(step, n)| (step, u64::from(n))).collect();
    Ok(Some(Facts { cube: piece.cube, first, counts, held }))
}

/// A look at all pieces.
pub(crate) struct Looked {
    facts: Vec<Facts>,
    /// The step of the first point of each.
    firsts: Vec<u8>,
    /// How many points each step has.
    totals: Vec<u64>,
    /// The last step of which the points are remembered, if any are.
    held: Option<u8>,
}

impl Looked {
    /// Looks at a level of cells of exponent `cell`, or at all points; `holds` says whether points are remembered.
    pub fn at(plan: &Plan, cell: Option<u8>, holds: bool) -> Result<Self, QueryError> {
        let mut pieces = Pieces::new(plan, cell);
        let mut facts: Vec<Facts> = Vec::new();
        let mut held = holds.then_some(Step::COUNT as u8 - 1);
        loop {
            let (mut window, mut points) = (Vec::new(), 0);
            // All of what is in a window may be remembered before the first of it is forgotten.
            while window.len() < plan.window()
                && (held.is_none() || points < WINDOW_POINTS || window.len() < plan.threads())
                && let Some(piece) = pieces.next(plan)?
            {
                points += piece.points(plan);
                window.push(piece);
            }
            if window.is_empty() {
                break;
            }
            facts.extend(plan.each(window, |piece| look(plan, &piece, cell, held))?.into_iter().flatten());
            if let Some(last) = &mut held {
                forget(&mut facts, last);
            }
        }
        // The first points of the pieces, as a sequence of their own: of points that win a cell larger than their piece
        // there are no others.
        let mut previous = None;
        let win = |facts: &Facts| {
            // Any cube that holds all points gives the same sequence: the first point is first.
            let win = previous.map_or(BITS as i8, |p| first_win(Some(p), facts.cube, facts.cube));
            previous = Some(facts.cube);
            win
        };
        let wins: Vec<i8> = facts.iter().map(win).collect();
        let keys: Vec<Key> = facts.iter().map(|f| f.first).collect();
        let groups = steps(&keys, &wins);
        let firsts: Vec<u8> = groups.into_iter().zip(wins).map(|(group, win)| Step { win, group }.ordinal()).collect();
        let mut totals = vec![0; Step::COUNT];
        firsts.iter().for_each(|&step| totals[usize::from(step)] += 1);
        facts.iter().flat_map(|f| &f.counts).for_each(|&(step, n)| totals[usize::from(step)] += n);
        Ok(Self { facts, firsts, totals, held })
    }

    pub fn points(&self) -> u64 {
        self.totals.iter().sum()
    }

    /// Points of the level of cells of this exponent, which is none of the finer ones; `None`: all.
    pub fn at_level(&self, cell: Option<u8>) -> u64 {
        self.totals[..cell.map_or(Step::COUNT, steps_of_level)].iter().sum()
    }

    /// The step that does not fit a capacity, and how much of it does.
    pub fn cut(&self, capacity: u64) -> Option<Cut> {
        let mut room = capacity;
        for (step, &points) in (0..).zip(&self.totals) {
            match room.checked_sub(points) {
                Some(left) => room = left,
                None => return Some(Cut { step, even: EvenPrefix::new(points, room) }),
            }
        }
        None
    }

    /// The finest level of which all points are remembered; `None`: all points.
    pub fn held_level(&self) -> Option<u8> {
        self.held.and_then(|last| u8::try_from(Step::of_ordinal(last).win).ok())
    }

    /// What the pieces tell about others, and the remembered points up to a cut, each with its step; by step, then by place.
    pub fn places(self, cut: Option<&Cut>) -> (Places, Vec<(u8, Place)>) {
        let Self { facts, firsts, held: last, .. } = self;
        let mut number = 0;
        let mut taken = Vec::new();
        let known = |(facts, first): (Facts, u8)| {
            let before = number;
            let own_first = |step: u8| u64::from(first == step);
            for held in facts.held {
                let step = held.step.unwrap_or(first);
                let number = || before + held.step.map_or(0, |step| own_first(step) + u64::from(held.number));
                if last.is_some_and(|last| step <= last) && cut.is_none_or(|cut| cut.takes(step, number)) {
                    taken.push((step, held.place));
                }
            }
            if let Some(cut) = cut {
                let rest = facts.counts.binary_search_by_key(&cut.step, |c| c.0).map_or(0, |i| facts.counts[i].1);
                number += rest + own_first(cut.step);
            }
            Known { cube: facts.cube, first, before }
        };
        let places = Places(facts.into_iter().zip(firsts).map(known).collect());
        taken.sort_unstable();
        (places, taken)
    }
}

/// How many steps the levels down to an exponent have.
fn steps_of_level(c: u8) -> usize {
    usize::from(Step { win: c as i8, group: 3 }.ordinal()) + 1
}

/// Forgets the finest levels, if there are too many points.
fn forget(facts: &mut [Facts], last: &mut u8) {
    let mut points: usize = facts.iter().map(|f| f.held.len()).sum();
    if points <= HELD_POINTS {
        return;
    }
    let mut by_step = [0; Step::COUNT];
    facts.iter().flat_map(|f| &f.held).filter_map(|h| h.step).for_each(|step| by_step[usize::from(step)] += 1);
    for c in 0..=BITS {
        *last = steps_of_level(c) as u8 - 1;
        let finer = &mut by_step[usize::from(*last) + 1..];
        points -= finer.iter().sum::<usize>();
        finer.fill(0);
        if points <= HELD_POINTS {
            break;
        }
    }
    facts.iter_mut().for_each(|f| f.held.retain(|h| h.step.is_none_or(|step| step <= *last)));
}

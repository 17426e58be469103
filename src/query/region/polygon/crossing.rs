//! Does the outline of a polygon cross itself? Decided exactly.
//!
//! Rings may touch one another or themselves, and may run along one another: which side is inside stays clear. What is
//! refused is an outline that passes from one side of itself to the other, as a figure of eight does: there a slip of
//! the pen is more likely than a wish.

use super::exact::{Place, side};
use std::cmp::Ordering;

/// An edge of a ring: ring and index of its first vertex.
#[derive(Clone, Copy, Debug)]
struct Edge {
    ring: usize,
    at: usize,
    from: Place,
    to: Place,
}

impl Edge {
    fn span(&self, axis: usize) -> (i128, i128) {
        (self.from[axis].min(self.to[axis]), self.from[axis].max(self.to[axis]))
    }
}

/// Two edges that cross: ring and index of the first vertex of each.
pub(super) type Crossing = [(usize, usize); 2];

/// A place where rings, given without a repeated last vertex and without repeated neighbours, cross.
pub(super) fn find(rings: &[Vec<Place>]) -> Option<Crossing> {
    let mut edges = Vec::new();
    for (ring, places) in rings.iter().enumerate() {
        let next = |i: usize| places[(i + 1) % places.len()];
        edges.extend((0..places.len()).map(|at| Edge { ring, at, from: places[at], to: next(at) }));
    }
    let spans = edges.iter().map(|edge| [edge.span(0), edge.span(1)]).collect();
    let tree = Tree::over(spans);
    let [a, b] = tree.meeting(&mut |a, b| cross(rings, &edges[b], &edges[a]))?;
    // A hole before the outline that it crosses.
    Some([b, a].map(|i| (edges[i].ring, edges[i].at)))
}

/// Least and greatest, both inside, on each axis.
type Span = [(i128, i128); 2];

/// Rectangles around runs of edges, each twice as long as those of the level below: edges that follow one another are near
/// one another, whichever way an outline goes.
struct Tree {
    /// The edges' own come first.
    levels: Vec<Vec<Span>>,
}

impl Tree {
    fn over(edges: Vec<Span>) -> Self {
        let both = |a: Span, b: Span| [0, 1].map(|i| (a[i].0.min(b[i].0), a[i].1.max(b[i].1)));
        let mut levels = vec![edges];
        while let Some(below) = levels.last().filter(|level| level.len() > 1) {
            let level = below.chunks(2).map(|pair| pair.iter().copied().reduce(both).unwrap_or(pair[0])).collect();
            levels.push(level);
        }
        Self { levels }
    }

    /// Two edges of which this is true, of those whose rectangles meet; the first comes before the second.
    fn meeting(&self, is_true: &mut impl FnMut(usize, usize) -> bool) -> Option<[usize; 2]> {
        let mut open = vec![(self.levels.len() - 1, 0, 0)];
        while let Some((level, a, b)) = open.pop() {
            let all = &self.levels[level];
            let (Some(of_a), Some(of_b)) = (all.get(a), all.get(b)) else { continue };
            if (0..2).any(|i| of_a[i].1 < of_b[i].0 || of_b[i].1 < of_a[i].0) {
                continue;
            }
            match level.checked_sub(1) {
                Some(below) => {
                    let pairs = [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(i, j)| (below, 2 * a + i, 2 * b + j));
                    open.extend(pairs.into_iter().filter(|(_, a, b)| a <= b));
                }
                None if a != b && is_true(a, b) => return Some([a, b]),
                None => {}
            }
        }
        None
    }
}

fn cross(rings: &[Vec<Place>], a: &Edge, b: &Edge) -> bool {
    let (b_from, b_to) = (side(a.from, a.to, b.from), side(a.from, a.to, b.to));
    let (a_from, a_to) = (side(b.from, b.to, a.from), side(b.from, b.to, a.to));
    let opposite = |x: Ordering, y: Ordering| x != Ordering::Equal && x == y.reverse();
    if opposite(b_from, b_to) && opposite(a_from, a_to) {
        return true;
    }
    // Where an edge begins on the other one, inside it or at its beginning, the outline may go through.
    let begins_on = |edge: &Edge, place: Place, on_line: Ordering| {
        let within = |axis: usize| (edge.span(axis).0..=edge.span(axis).1).contains(&place[axis]);
        on_line == Ordering::Equal && within(0) && within(1) && place != edge.to
    };
    (begins_on(a, b.from, b_from) && passes(rings, b, a)) || (begins_on(b, a.from, a_from) && passes(rings, a, b))
}

/// `edge` begins on `other`: does the outline at its first vertex go from one side of the other's outline to the other?
fn passes(rings: &[Vec<Place>], edge: &Edge, other: &Edge) -> bool {
    let before = |e: &Edge| rings[e.ring][(e.at + rings[e.ring].len() - 1) % rings[e.ring].len()];
    let at = edge.from;
    let (from, to) = if at == other.from { (before(other), other.to) } else { (other.from, other.to) };
    if (edge.ring, edge.at) == (other.ring, other.at) {
        return false;
    }
    let one = within_turn(at, from, to, before(edge));
    let two = within_turn(at, from, to, edge.to);
    matches!((one, two), (Some(one), Some(two)) if one != two)
}

/// Is the direction to `p` to the left of the bend `from`, `at`, `to`; `None` if it runs along it.
fn within_turn(at: Place, from: Place, to: Place, p: Place) -> Option<bool> {
    // The left side is what lies counter-clockwise from `to` as far as `from`.
    let (bend, after, before) = (side(at, to, from), side(at, to, p), side(at, from, p));
    let same = |d: Place| side(at, d, p) == Ordering::Equal && !opposite_directions(at, d, p);
    if same(from) || same(to) {
        return None;
    }
    Some(match bend {
        Ordering::Greater => after == Ordering::Greater && before == Ordering::Less,
        Ordering::Less => !(after == Ordering::Less && before == Ordering::Greater),
        // Straight on: the half plane to the left of the way to `to`. Back on itself: everything is left.
        Ordering::Equal if opposite_directions(at, to, from) => after == Ordering::Greater,
        Ordering::Equal => true,
    })
}

/// Of two places on one line with `at`: do they lie on different sides of it?
fn opposite_directions(at: Place, a: Place, b: Place) -> bool {
    (0..2).any(|i| (a[i] - at[i]).signum() * (b[i] - at[i]).signum() < 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn crosses(rings: &[&[[i128; 2]]]) -> bool {
        // Whatever vertex comes first, and in either direction.
        let answers: Vec<bool> = (0..rings.iter().map(|r| r.len()).max().unwrap_or(0) * 2)
            .map(|turn| {
                let turned = |ring: &&[Place]| {
                    let mut ring = ring.to_vec();
                    let n = ring.len();
                    ring.rotate_left(turn / 2 % n);
                    if turn % 2 == 1 {
                        ring.reverse();
                    }
                    ring
                };
                find(&rings.iter().map(turned).collect::<Vec<_>>()).is_some()
            })
            .collect();
        assert!(answers.iter().all(|a| *a == answers[0]), "{answers:?} of {rings:?}");
        answers[0]
    }

    #[test]
    fn figures_of_eight_cross_and_touching_rings_do_not() {
        let square: &[Place] = &[[0, 0], [10, 0], [10, 10], [0, 10]];
        assert!(!crosses(&[square]));
        assert!(crosses(&[&[[0, 0], [10, 10], [10, 0], [0, 10]]]), "a bow tie");
        assert!(crosses(&[&[[0, 0], [5, 5], [10, 10], [10, 0], [5, 5], [0, 10]]]), "a bow tie through a vertex");
        assert!(crosses(&[&[[0, 0], [5, 5], [10, 10], [10, 0], [0, 10]]]), "a vertex on the crossing edge");
        assert!(!crosses(&[&[[0, 0], [5, 5], [0, 10], [10, 10], [5, 5], [10, 0]]]), "two triangles that touch");
        assert!(!crosses(&[square, &[[2, 2], [4, 2], [4, 4], [2, 4]]]), "a hole");
        assert!(!crosses(&[square, &[[0, 2], [4, 1], [4, 4]]]), "a hole that touches an edge");
        assert!(!crosses(&[square, &[[0, 0], [4, 1], [4, 4]]]), "a hole that touches a corner");
        assert!(!crosses(&[square, &[[0, 2], [4, 2], [4, 4], [0, 4]]]), "a hole along an edge");
        assert!(crosses(&[square, &[[-1, 2], [4, 2], [4, 4], [-1, 4]]]), "a hole that reaches out");
        assert!(crosses(&[square, &[[2, 2], [15, 12], [2, 4]]]), "a hole through a corner's edges");
        assert!(crosses(&[square, &[[5, 5], [10, 10], [15, 15], [16, 4]]]), "a hole out through a corner");
        assert!(!crosses(&[&[[0, 0], [10, 0], [10, 5], [15, 5], [10, 5], [10, 10], [0, 10]]]), "a spike");
    }

    #[test]
    fn a_long_outline_is_looked_at_in_time() {
        let n = 200_000_i128;
        let mut ring: Vec<Place> = (0..n).map(|i| [i * 10, i % 7]).collect();
        ring.extend((0..n).rev().map(|i| [i * 10, 1000 + i % 5]));
        // Along x, along y (which took minutes), and around a corner.
        let turned = |[x, y]: Place| [y, x];
        let bent = |[x, y]: Place| if x < 5 * n { [x, y] } else { [5 * n + y, 5 * n - x] };
        for turn in [&|place| place, &turned, &bent] as [&dyn Fn(Place) -> Place; 3] {
            let mut ring: Vec<Place> = ring.iter().copied().map(turn).collect();
            assert_eq!(find(std::slice::from_ref(&ring)), None);
            ring[100_000] = turn([1_000_000, 2000]);
            assert!(find(&[ring]).is_some());
        }
    }

    proptest! {
        #[test]
        fn what_crosses_is_what_some_two_edges_say(
            rings in prop::collection::vec(prop::collection::vec(prop::array::uniform2(0_i128..12), 3..9), 1..4),
        ) {
            // Without repeated neighbours, as rings are given.
            let rings: Vec<Vec<Place>> = rings
                .into_iter()
                .map(|mut ring| {
                    ring.dedup();
                    while ring.len() > 1 && ring.first() == ring.last() {
                        ring.pop();
                    }
                    ring
                })
                .filter(|ring| ring.len() > 2)
                .collect();
            let mut edges = Vec::new();
            for (ring, places) in rings.iter().enumerate() {
                let to = |at: usize| places[(at + 1) % places.len()];
                edges.extend((0..places.len()).map(|at| Edge { ring, at, from: places[at], to: to(at) }));
            }
            let any = (0..edges.len()).any(|b| (0..b).any(|a| cross(&rings, &edges[b], &edges[a])));
            prop_assert_eq!(find(&rings).is_some(), any);
        }
    }
}

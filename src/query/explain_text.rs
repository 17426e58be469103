//! An explanation for people: sums first, then the nodes as a table.

use super::explain::{ExplainedNode, Explanation, OWN_POINTS_DO_NOT_MATCH, Verdict};
use crate::points::counted;
use std::cmp::Reverse;
use std::fmt::{self, Write};

impl Explanation {
    /// What becomes of how many nodes and points, then a table of at most `most` nodes: the coarsest, in pre-order.
    pub fn text(&self, most: usize) -> String {
        let mut text = String::new();
        // Writing to a string does not fail.
        let _ = self.write(&mut text, most);
        text
    }

    fn write(&self, out: &mut impl Write, most: usize) -> fmt::Result {
        let bound = self.answer.error_bound.map_or_else(|| "none can be given".to_owned(), |b| b.to_string());
        writeln!(
            out,
            "{} looked at, {} in the answer, error bound {bound}",
            counted(self.nodes.len() as u64, "node"),
            counted(self.answer.points, "point")
        )?;
        for sum in self.sums() {
            let Sum { nodes, points, taken, .. } = sum;
            let taken = taken.map_or_else(|| "?".to_owned(), |t| t.to_string());
            let line = format!("{:8} {nodes:>8} nodes {points:>14} points {taken:>14} taken  {}", sum.word, sum.reason);
            writeln!(out, "{}", line.trim_end())?;
        }
        let shown = self.coarsest(most);
        if shown.is_empty() {
            return Ok(());
        }
        let (node, spacing, points, below, taken) = ("node", "spacing", "points", "with below", "taken");
        writeln!(out, "\n{node:20} {spacing:>12} {points:>12} {below:>12} {taken:>12}  {:8} why", "")?;
        for n in &shown {
            let layer = if n.layer == 0 { String::new() } else { format!(" (layer {})", n.layer) };
            let taken = n.taken.map_or_else(|| "?".to_owned(), |t| t.to_string());
            writeln!(
                out,
                "{:20} {:>12} {:>12} {:>12} {:>12}  {:8} {}",
                n.node.clone() + &layer,
                format!("{:.6}", n.spacing).trim_end_matches('0').trim_end_matches('.'),
                n.points,
                n.subtree_points,
                taken,
                n.verdict.word(),
                n.reason
            )?;
        }
        match self.nodes.len() - shown.len() {
            0 => Ok(()),
            more => writeln!(out, "and {more} finer nodes"),
        }
    }

    /// By verdict and, where it is the same for many nodes, reason.
    fn sums(&self) -> Vec<Sum<'_>> {
        let mut sums: Vec<Sum<'_>> = Vec::new();
        for n in &self.nodes {
            let reason = match n.verdict {
                Verdict::Taken | Verdict::Cut => "",
                Verdict::Tested | Verdict::Refused => &n.reason,
            };
            // What lies below a node that was refused is not listed.
            let is_whole = n.verdict == Verdict::Refused && n.reason != OWN_POINTS_DO_NOT_MATCH;
            let points = if is_whole { n.subtree_points } else { n.points };
            match sums.iter_mut().find(|s| s.verdict == n.verdict && s.reason == reason) {
                Some(sum) => {
                    sum.nodes += 1;
                    sum.points += points;
                    sum.taken = sum.taken.zip(n.taken).map(|(a, b)| a + b);
                }
                None => {
                    let (verdict, word) = (n.verdict, n.verdict.word());
                    sums.push(Sum { verdict, word, reason, nodes: 1, points, taken: n.taken });
                }
            }
        }
        sums.sort_by_key(|s| (s.verdict as u8, Reverse(s.points)));
        sums
    }

    fn coarsest(&self, most: usize) -> Vec<&ExplainedNode> {
        let mut ranked: Vec<(usize, &ExplainedNode)> = self.nodes.iter().enumerate().collect();
        ranked.sort_by(|(_, a), (_, b)| b.spacing.total_cmp(&a.spacing));
        ranked.truncate(most);
        ranked.sort_by_key(|(place, _)| *place);
        ranked.into_iter().map(|(_, n)| n).collect()
    }
}

/// What becomes of some nodes.
struct Sum<'e> {
    verdict: Verdict,
    word: &'static str,
    reason: &'e str,
    nodes: u64,
    points: u64,
    /// `None` if it is not known of one of them.
    taken: Option<u64>,
}

impl Verdict {
    fn word(self) -> &'static str {
        match self {
            Self::Taken => "taken",
            Self::Tested => "tested",
            Self::Refused => "refused",
            Self::Cut => "cut",
        }
    }
}

impl fmt::Display for Explanation {
    /// [`Explanation::text`] with all nodes.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.write(f, usize::MAX)
    }
}

//! From what is wanted and what is there to what is drawn: the largest closed cut.

use super::gpu::{DrawBlock, DrawList, DrawNode};
use super::residency::{Key, Residency};
use super::spacing::set_spacings;
use crate::lattice::Lattice;
use crate::query::{PartId, Wanted, WantedPart};

/// A draw list, and which parts it shows.
#[derive(Debug)]
pub(super) struct Cut {
    pub list: DrawList,
    /// The parts that are drawn, in the order of the sequence.
    pub keys: Vec<Key>,
    /// Points that are wanted but not there.
    pub missing_points: u64,
}

/// All parts of `wanted` that are there and whose ancestors are.
pub(super) fn closed_cut(wanted: &Wanted, residency: &Residency, lattice: &Lattice, paint: u64) -> Cut {
    let mut drawn = vec![false; wanted.parts.len()];
    // By node: the last part drawn, and whether something finer is missing.
    let mut last: Vec<Option<u32>> = vec![None; wanted.nodes.len()];
    let mut stand_in = vec![false; wanted.nodes.len()];
    let mut listed = vec![false; wanted.nodes.len()];
    let mut keys = Vec::new();
    let mut missing_points = 0;
    for (i, part) in wanted.parts.iter().enumerate() {
        let key = (part.id, paint);
        let reachable = part.after.is_none_or(|before| drawn[before as usize]);
        let node = part.node as usize;
        if reachable && residency.get(&key).is_some() {
            drawn[i] = true;
            last[node] = Some(i as u32);
            keys.push(key);
            // With all nodes above, those that store nothing included.
            let mut above = Some(part.node);
            while let Some(n) = above.filter(|&n| !listed[n as usize]) {
                listed[n as usize] = true;
                above = wanted.nodes[n as usize].parent;
            }
        } else {
            missing_points += u64::from(part.points);
            // What stands in is the node itself, or the nearest one above that is drawn.
            let mut above = Some(part.node);
            while let Some(n) = above {
                stand_in[n as usize] = true;
                above = if last[n as usize].is_some() { None } else { wanted.nodes[n as usize].parent };
            }
        }
    }
    let mut order: Vec<u32> = (0..wanted.nodes.len() as u32).filter(|&n| listed[n as usize]).collect();
    order.sort_by_key(|&n| (wanted.nodes[n as usize].cube.node_key(), wanted.nodes[n as usize].layer));
    let mut place = vec![u32::MAX; wanted.nodes.len()];
    for (at, &n) in (0..).zip(&order) {
        place[n as usize] = at;
    }
    let node = |&n: &u32| {
        let node = &wanted.nodes[n as usize];
        DrawNode {
            cube: node.cube,
            layer: node.layer,
            spacing: last[n as usize].map_or(node.spacing_before, |i| wanted.parts[i as usize].spacing),
            stand_in: stand_in[n as usize],
            parent: node.parent.map(|p| place[p as usize]),
        }
    };
    let nodes: Vec<DrawNode> = order.iter().map(node).collect();
    let mut parts: Vec<(u32, u32, usize)> = (0..wanted.parts.len())
        .filter(|&i| drawn[i])
        .map(|i| (place[wanted.parts[i].node as usize], wanted.parts[i].part, i))
        .collect();
    parts.sort_unstable();
    let mut list = DrawList { nodes, complete: missing_points == 0, ..DrawList::empty(lattice.clone(), paint) };
    let mut counted = Vec::with_capacity(parts.len());
    for (node, part, i) in parts {
        let Some(resident) = residency.get(&(wanted.parts[i].id, paint)) else { continue };
        let all = resident.points.min(wanted.parts[i].points);
        counted.push((node, &*resident.densities, all as f32 / resident.points.max(1) as f32));
        let mut first = 0;
        for &block in &resident.blocks {
            let points = (all - first).min(residency.block_points());
            if points == 0 {
                break;
            }
            list.blocks.push(DrawBlock { block, points, node, part, first });
            list.points += u64::from(points);
            first += points;
        }
    }
    set_spacings(&mut list, counted);
    list.complete &= drawn.iter().all(|&d| d);
    Cut { list, keys, missing_points }
}

/// The ids of what is wanted, for one paint.
pub(super) fn keys(wanted: &Wanted, paint: u64) -> impl Iterator<Item = Key> + '_ {
    wanted.parts.iter().map(move |p: &WantedPart| -> (PartId, u64) { (p.id, paint) })
}

//! Points of different layers on one position: which of them comes first is decided by their records, as in one tree
//! (OCTREE sections 1 and 5). Within a layer they are in order already.

use super::QueryError;
use super::cells::Pick;
use super::plan::Plan;
use crate::codec::Decoder;
use crate::store::{DecodedPart, NodeIx, decode_part};
use std::collections::HashMap;

/// Puts runs of picks with equal keys, which are in key order, into the canonical order of points.
pub(crate) fn settle(plan: &Plan, picks: &mut [Pick]) -> Result<(), QueryError> {
    if plan.roots.len() < 2 {
        return Ok(());
    }
    let mut parts = Parts { plan, decoder: Decoder::new(), decoded: HashMap::new() };
    for run in picks.chunk_by_mut(|a, b| a.key == b.key) {
        let layer = |pick: &Pick| plan.layer_of(pick.node);
        let first = layer(&run[0]);
        if run.iter().any(|pick| layer(pick) != first) {
            let mut ranked = run.iter().map(|p| Ok((parts.record(p)?, *p))).collect::<Result<Vec<_>, QueryError>>()?;
            // Stable: records that are the same in all of it are interchangeable.
            ranked.sort_by(|a, b| a.0.cmp(&b.0));
            run.iter_mut().zip(ranked).for_each(|(to, (_, from))| *to = from);
        }
    }
    Ok(())
}

/// What decides between points on one position: record bytes, then attributes, then the scan's content.
type Record = (Vec<u8>, Vec<(String, &'static str)>, [u8; 32]);

struct Parts<'a> {
    plan: &'a Plan,
    decoder: Decoder,
    /// The parts met so far; ties are rare.
    decoded: HashMap<(NodeIx, u32), DecodedPart>,
}

impl Parts<'_> {
    fn record(&mut self, pick: &Pick) -> Result<Record, QueryError> {
        let snapshot = &self.plan.snapshot;
        let place = (pick.node, pick.part);
        if !self.decoded.contains_key(&place) {
            let head = self.plan.nodes.node(pick.node)?;
            let part = decode_part(snapshot, &head, pick.part as usize, &mut self.decoder)?;
            self.decoded.insert(place, part);
        }
        let part = &self.decoded[&place];
        let i = pick.index as usize;
        let mut record = Record::default();
        let Some(scan) = part.scans.get(i).and_then(|&id| snapshot.scan(id)) else { return Ok(record) };
        for slot in &scan.attributes {
            let Some(stored) = snapshot.attribute(*slot) else { continue };
            let ty = stored.attribute.ty;
            if let Ok(found) = part.columns.binary_search_by_key(slot, |c| c.0) {
                record.0.extend_from_slice(&part.columns[found].1.raw(i)[..ty.size()]);
            }
            record.1.push((stored.attribute.name.clone(), ty.word()));
        }
        record.2 = scan.identity;
        Ok(record)
    }
}

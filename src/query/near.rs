//! What is read around places whose neighbours are looked for: blocks of points, each read once for many places, with the
//! bounds of short runs of its points.
//!
//! Points of a block lie in key order, so those of a run are close together: of most runs their bounds tell that none of
//! their points is near.

use super::QueryError;
use super::mask::Mask;
use super::part::{Look, Part};
use super::plan::Plan;
use crate::lattice::{LatticeBox, LatticePoint};
use crate::points::Positions;
use crate::store::{Node, NodeIx};
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::Arc;

/// Points of a run: those of a word of a mask.
pub(super) const RUN: usize = 64;

/// So many blocks are kept: 25 MB at most. Tests have few.
const MOST_BLOCKS: usize = if cfg!(test) { 3 } else { 256 };

/// Parts and blocks that were read.
pub(super) struct Near<'a> {
    plan: &'a Plan,
    parts: HashMap<(NodeIx, usize), NearPart>,
    blocks: usize,
}

struct NearPart {
    bounds: Arc<[LatticeBox]>,
    /// `None`: not read.
    blocks: Vec<Option<Arc<NearBlock>>>,
}

/// The points of a block.
#[derive(Debug, Default)]
pub(super) struct NearBlock {
    pub positions: Arc<Positions>,
    /// Those that match.
    pub mask: Mask,
    /// The bounds of each run; none if nothing matches.
    pub runs: Vec<LatticeBox>,
}

impl<'a> Near<'a> {
    pub fn new(plan: &'a Plan) -> Self {
        Self { plan, parts: HashMap::new(), blocks: 0 }
    }

    fn part(&mut self, node: &Node, part: usize) -> Result<&mut NearPart, QueryError> {
        match self.parts.entry((node.ix(), part)) {
            Entry::Occupied(known) => Ok(known.into_mut()),
            Entry::Vacant(place) => {
                let mut read = Part::new(self.plan, node, part);
                read.read_positions(&|_| true)?;
                let bounds: Arc<[LatticeBox]> = read.positions()?.blocks().into();
                Ok(place.insert(NearPart { blocks: vec![None; bounds.len()], bounds }))
            }
        }
    }

    /// The bounds of the blocks of a part.
    pub fn bounds(&mut self, node: &Node, part: usize) -> Result<Arc<[LatticeBox]>, QueryError> {
        Ok(self.part(node, part)?.bounds.clone())
    }

    /// A block of a part.
    pub fn block(&mut self, node: &Node, part: usize, block: usize) -> Result<Arc<NearBlock>, QueryError> {
        let known = self.part(node, part)?;
        if let Some(read) = &known.blocks[block] {
            return Ok(read.clone());
        }
        let of_block = known.bounds[block];
        let skips = |bounds: &LatticeBox| *bounds != of_block;
        let found = Part::new(self.plan, node, part).find(&Look { skips: &skips, misses: false, positions: true })?;
        // Several have the same bounds where many points are in one place.
        let found = found.into_iter().find(|found| found.block == block).map(|found| {
            let positions = found.content.positions;
            NearBlock { runs: runs(&positions), positions, mask: found.mask }
        });
        let read = Arc::new(found.unwrap_or_default());
        if self.blocks >= MOST_BLOCKS {
            self.parts.values_mut().for_each(|part| part.blocks.fill(None));
            self.blocks = 0;
        }
        self.part(node, part)?.blocks[block] = Some(read.clone());
        self.blocks += 1;
        Ok(read)
    }
}

fn runs(positions: &Positions) -> Vec<LatticeBox> {
    let ends = |values: &[u64]| values.iter().fold((u64::MAX, 0), |(min, max), &v| (v.min(min), v.max(max)));
    let axes = positions.x.chunks(RUN).zip(positions.y.chunks(RUN)).zip(positions.z.chunks(RUN));
    axes.map(|((x, y), z)| {
        let (x, y, z) = (ends(x), ends(y), ends(z));
        LatticeBox { min: LatticePoint([x.0, y.0, z.0]), max: LatticePoint([x.1, y.1, z.1]) }
    })
    .collect()
}

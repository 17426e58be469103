//! One part of a node: reading its columns, block by block, and which of its points match.

use super::QueryError;
use super::answer::{Meter, Stage};
use super::block::{Block, BlockScans};
use super::mask::Mask;
use super::plan::Plan;
use crate::codec::{Blocks, CodecError, ColumnChunk, Decoder, PositionChunk};
use crate::geometry::Containment;
use crate::lattice::LatticeBox;
use crate::points::{Column, Positions, ScalarType};
use crate::store::model::{SLOT_POSITION, SLOT_SCAN, Slot};
use crate::store::{CachedBlock, ChunkBytes, Node, NodeIx, ReadCost, WantedBlocks, follow};
use std::cell::RefCell;
use std::sync::Arc;

thread_local! {
    pub(super) static DECODER: RefCell<Decoder> = RefCell::new(Decoder::new());
}

/// A part and its chunks as far as they have been read.
pub(crate) struct Part<'a> {
    pub(super) plan: &'a Plan,
    head: Node,
    part: usize,
    pub(super) blocks: Blocks,
    chunks: Vec<(Slot, Option<ChunkBytes>)>,
    /// The blocks that are looked at; `None`: all. Of what is read, those are there.
    wanted: Option<Vec<bool>>,
}

/// What was found in one block.
pub(crate) struct Found {
    /// Which block.
    pub block: usize,
    /// Its columns, as far as they were needed.
    pub content: Block,
    /// The points that match.
    pub mask: Mask,
}

/// Which blocks are looked at, and for what.
pub(crate) struct Look<'a> {
    /// Blocks with these bounds are left out.
    pub skips: &'a dyn Fn(&LatticeBox) -> bool,
    /// Are positions needed also of points that do not match?
    pub misses: bool,
    /// Are positions needed at all?
    pub positions: bool,
}

/// The columns that decide what matches.
pub(super) struct Tested<'c> {
    positions: &'c PositionChunk<'c>,
    scans: Option<ColumnChunk<'c>>,
    columns: Vec<(Slot, ScalarType, Option<ColumnChunk<'c>>)>,
}

impl<'a> Part<'a> {
    /// Of a node, by its number.
    pub fn at(plan: &'a Plan, node: NodeIx, part: usize) -> Result<Self, QueryError> {
        Ok(Self::new(plan, &plan.nodes.node(node)?, part))
    }

    pub fn new(plan: &'a Plan, head: &Node, part: usize) -> Self {
        Meter::add(&plan.meter.parts, 1);
        Self { plan, head: head.clone(), part, blocks: head.blocks(part), chunks: Vec::new(), wanted: None }
    }

    /// Reads the chunks of these columns that are not there yet.
    pub(super) fn read(&mut self, slots: impl IntoIterator<Item = Slot>) -> Result<(), QueryError> {
        let mut missing: Vec<Slot> = Vec::new();
        for slot in slots {
            // Columns can be decoded only with those that they follow.
            for slot in [slot].into_iter().chain(self.plan.snapshot.leaders(slot)) {
                if !missing.contains(&slot) && !self.has_read(slot) {
                    missing.push(slot);
                }
            }
        }
        if missing.is_empty() {
            return Ok(());
        }
        self.chunks.retain(|(have, _)| !missing.contains(have));
        // A row of which everything is wanted is quicker read in one go.
        match self.wanted.clone().filter(|blocks| blocks.contains(&false)) {
            None => self.read_blocks(&missing, None),
            wanted => self.read_blocks(&missing, Some(&mut |_, _| wanted.clone())),
        }
    }

    /// Reads the positions of the blocks that are not skipped, and no others of what is read later.
    pub(super) fn read_positions(&mut self, skips: &dyn Fn(&LatticeBox) -> bool) -> Result<(), QueryError> {
        let (cube, blocks) = (self.head.cube, self.blocks);
        let unskipped = |bytes: &[u8]| {
            let positions = PositionChunk::parse(bytes, cube, blocks).ok()?;
            Some(positions.blocks().iter().map(|bounds| !skips(bounds)).collect::<Vec<bool>>())
        };
        let mut wanted = None;
        self.read_blocks(
            &[SLOT_POSITION],
            Some(&mut |slot, bytes| {
                // Small ones are in a row with others, and are read whole.
                wanted = (slot == SLOT_POSITION).then(|| unskipped(bytes)).flatten();
                wanted.clone()
            }),
        )?;
        // Not asked for where the row was there already or has one block.
        self.wanted = wanted.or_else(|| unskipped(self.chunk(SLOT_POSITION)?));
        Ok(())
    }

    /// Of what is read from now on only these blocks are wanted.
    pub(super) fn want(&mut self, blocks: impl Iterator<Item = usize>) {
        let mut wanted = vec![false; self.blocks.count()];
        for block in blocks {
            if let Some(wanted) = wanted.get_mut(block) {
                *wanted = true;
            }
        }
        self.wanted = Some(wanted);
    }

    /// Is no block looked at?
    pub(super) fn wants_nothing(&self) -> bool {
        self.wanted.as_ref().is_some_and(|blocks| !blocks.contains(&true))
    }

    /// Was of a column all read that is wanted?
    fn has_read(&self, slot: Slot) -> bool {
        let is_there = |chunk: &ChunkBytes| {
            (0..self.blocks.count())
                .all(|block| chunk.has(block) || self.wanted.as_ref().is_some_and(|wanted| !wanted[block]))
        };
        self.chunks.iter().any(|(have, chunk)| *have == slot && chunk.as_ref().is_none_or(is_there))
    }

    /// Reads so much of these columns, of which none is there yet.
    fn read_blocks(&mut self, slots: &[Slot], wanted: Option<&mut WantedBlocks<'_>>) -> Result<(), QueryError> {
        let meter = &self.plan.meter;
        let mut cost = ReadCost::default();
        let read = meter
            .time(Stage::Reading, || self.plan.snapshot.read_blocks(&self.head, self.part, slots, wanted, &mut cost))?;
        Meter::add(&meter.chunks, cost.rows);
        Meter::add(&meter.bytes_read, cost.bytes);
        Meter::add(&meter.chunks_cached, cost.cached);
        self.chunks.extend(slots.iter().copied().zip(read));
        Ok(())
    }

    /// Bytes of the columns that were read, whole or some blocks of them.
    pub fn bytes_read(&self) -> u64 {
        self.chunks.iter().flat_map(|(_, chunk)| chunk).map(|chunk| chunk.len() as u64).sum()
    }

    /// Counts what would have been enough to read: of the chunks that were, so many blocks.
    pub(super) fn count_needed(&self, blocks: usize) {
        let of = self.blocks.count().max(1) as u64;
        Meter::add(&self.plan.meter.bytes_needed, self.bytes_read() * blocks as u64 / of);
    }

    fn chunk(&self, slot: Slot) -> Option<&ChunkBytes> {
        self.chunks.iter().find(|(s, _)| *s == slot).and_then(|(_, c)| c.as_ref())
    }

    pub(super) fn damaged(&self, slot: Slot, error: &CodecError) -> QueryError {
        let root = self.plan.root().unwrap_or(self.head.cube);
        let column = match slot {
            SLOT_POSITION => "positions".to_owned(),
            SLOT_SCAN => "scans".to_owned(),
            slot => self.plan.snapshot.attribute(slot).map_or_else(|| slot.to_string(), |a| a.attribute.name.clone()),
        };
        QueryError::Inconsistent {
            node: self.head.cube.display_name(root),
            expected: format!("a chunk of {column} in part {}", self.part),
            found: error.to_string(),
        }
    }

    pub(super) fn positions(&self) -> Result<PositionChunk<'_>, QueryError> {
        let bytes = self.chunk(SLOT_POSITION).map_or(&[][..], |c| c);
        PositionChunk::parse(bytes, self.head.cube, self.blocks).map_err(|e| self.damaged(SLOT_POSITION, &e))
    }

    /// `None` if no point of the part has the attribute.
    pub(super) fn column(&self, slot: Slot, ty: ScalarType) -> Result<Option<ColumnChunk<'_>>, QueryError> {
        let bytes_of = |slot| self.chunk(slot).map(|c| &c[..]);
        let parse = |bytes| follow(&self.plan.snapshot, slot, ty, self.blocks, bytes, &bytes_of);
        bytes_of(slot).map(parse).transpose().map_err(|e| self.damaged(slot, &e))
    }

    pub(super) fn scans(&self) -> Result<ColumnChunk<'_>, QueryError> {
        let bytes = self.chunk(SLOT_SCAN).map_or(&[][..], |c| c);
        ColumnChunk::parse(bytes, ScalarType::U32, self.blocks).map_err(|e| self.damaged(SLOT_SCAN, &e))
    }

    /// The blocks in which something matches (all that are not skipped, if misses are asked for), in order.
    pub fn find(&mut self, look: &Look) -> Result<Vec<Found>, QueryError> {
        let plan = self.plan;
        let needs_scans = plan.scans.is_some() || plan.filter.is_some();
        let slots = plan.filter_columns.iter().map(|(s, _)| *s);
        self.read_positions(look.skips)?;
        if self.wants_nothing() {
            return Ok(Vec::new());
        }
        self.read(needs_scans.then_some(SLOT_SCAN).into_iter().chain(slots))?;
        plan.meter.time(Stage::Decoding, || DECODER.with_borrow_mut(|decoder| self.find_with(decoder, look)))
    }

    fn find_with(&self, decoder: &mut Decoder, look: &Look) -> Result<Vec<Found>, QueryError> {
        let positions = self.positions()?;
        let tested = self.tested(&positions)?;
        let blocks = 0..positions.blocks().len();
        let found = blocks.filter_map(|block| self.find_block(decoder, &tested, block, look).transpose());
        found.collect()
    }

    pub(super) fn tested<'c>(&'c self, positions: &'c PositionChunk<'c>) -> Result<Tested<'c>, QueryError> {
        let plan = self.plan;
        let column = |&(slot, ty): &(Slot, ScalarType)| Ok((slot, ty, self.column(slot, ty)?.map(|c| c.at(positions))));
        Ok(Tested {
            positions,
            scans: (plan.scans.is_some() || plan.filter.is_some()).then(|| self.scans()).transpose()?,
            columns: plan.filter_columns.iter().map(column).collect::<Result<_, QueryError>>()?,
        })
    }

    /// What of a block matches; `None` if it is skipped, or nothing does and misses are not asked for.
    pub(super) fn find_block(
        &self,
        decoder: &mut Decoder,
        Tested { positions, scans, columns }: &Tested,
        block: usize,
        look: &Look,
    ) -> Result<Option<Found>, QueryError> {
        let plan = self.plan;
        let bounds = &positions.blocks()[block];
        if (look.skips)(bounds) {
            return Ok(None);
        }
        let len = self.blocks.len_of(block);
        let placed = plan.classify(bounds);
        let mut content = Block::undecoded(len);
        let decode_positions = |decoder: &mut Decoder, out: &mut Arc<Positions>| {
            if out.is_empty() {
                *out = self.block_positions(decoder, positions, block)?;
            }
            Ok::<(), QueryError>(())
        };
        let mut mask = match placed {
            Containment::Outside => Mask::none(len),
            Containment::Inside => Mask::all(len),
            Containment::Partly => {
                decode_positions(decoder, &mut content.positions)?;
                plan.region.test(&content.positions, bounds)
            }
        };
        if !mask.is_none()
            && let Some(scans) = scans
        {
            content.scans = self.block_scans(decoder, scans, block)?;
            if let Some(set) = &plan.scans {
                mask.and(&content.scans.within(set, len));
            }
        }
        if !mask.is_none()
            && let Some(filter) = &plan.filter
        {
            if filter.needs_positions() {
                decode_positions(decoder, &mut content.positions)?;
            }
            for (slot, ty, chunk) in columns {
                let column = match chunk {
                    None => None,
                    Some(chunk) => Some(match self.cached_column(*slot, block) {
                        Some(column) => column,
                        None => self.block_column(decoder, *slot, *ty, chunk, block)?,
                    }),
                };
                content.columns.push((*slot, column));
            }
            mask.and(&filter.matching(&content));
        }
        if !mask.is_none() && placed == Containment::Partly {
            plan.leave_faces(&content.positions, bounds, &mut mask);
        }
        if mask.is_none() && !look.misses {
            return Ok(None);
        }
        if look.positions {
            decode_positions(decoder, &mut content.positions)?;
        }
        Ok(Some(Found { block, content, mask }))
    }

    pub(super) fn block_scans(
        &self,
        decoder: &mut Decoder,
        chunk: &ColumnChunk,
        block: usize,
    ) -> Result<BlockScans, QueryError> {
        if let Some([a, b, c, d, ..]) = chunk.constant() {
            return Ok(BlockScans::One(u32::from_le_bytes([a, b, c, d])));
        }
        match &*self.block_column(decoder, SLOT_SCAN, ScalarType::U32, chunk, block)? {
            Column::U32(scans) => Ok(BlockScans::Each(scans.clone())),
            _ => Ok(BlockScans::Each(Vec::new())),
        }
    }

    /// What the store's cache has of a block.
    fn cached(&self, slot: Slot, block: usize) -> Option<CachedBlock> {
        if !self.plan.keeps_blocks {
            return None;
        }
        let found = self.plan.snapshot.cached_block(&self.head, self.part, slot, block)?;
        Meter::add(&self.plan.meter.blocks_cached, 1);
        Some(found)
    }

    fn keep(&self, slot: Slot, block: usize, decoded: CachedBlock) {
        if self.plan.keeps_blocks {
            self.plan.snapshot.keep_block(&self.head, self.part, slot, block, decoded);
        }
    }

    pub(super) fn block_positions(
        &self,
        decoder: &mut Decoder,
        chunk: &PositionChunk,
        block: usize,
    ) -> Result<Arc<Positions>, QueryError> {
        if let Some(CachedBlock::Positions(found)) = self.cached(SLOT_POSITION, block) {
            return Ok(found);
        }
        let len = self.blocks.len_of(block);
        let mut positions = Positions::with_capacity(len);
        chunk.decode_block(decoder, block, &mut positions).map_err(|e| self.damaged(SLOT_POSITION, &e))?;
        Meter::add(&self.plan.meter.blocks, 1);
        self.plan.decoded(len as u64);
        let positions = Arc::new(positions);
        self.keep(SLOT_POSITION, block, CachedBlock::Positions(positions.clone()));
        Ok(positions)
    }

    pub(super) fn cached_column(&self, slot: Slot, block: usize) -> Option<Arc<Column>> {
        match self.cached(slot, block) {
            Some(CachedBlock::Column(column)) => Some(column),
            _ => None,
        }
    }

    /// Decodes a block of a column; what the cache has was asked before.
    pub(super) fn block_column(
        &self,
        decoder: &mut Decoder,
        slot: Slot,
        ty: ScalarType,
        chunk: &ColumnChunk,
        block: usize,
    ) -> Result<Arc<Column>, QueryError> {
        let mut column = Column::with_capacity(ty, self.blocks.len_of(block));
        chunk.decode_block(decoder, block, &mut column).map_err(|e| self.damaged(slot, &e))?;
        Meter::add(&self.plan.meter.blocks, 1);
        let column = Arc::new(column);
        self.keep(slot, block, CachedBlock::Column(column.clone()));
        Ok(column)
    }
}

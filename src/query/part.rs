//! One part of a node: which of its points match, and their attributes.

use super::QueryError;
use super::answer::{Meter, Stage};
use super::block::{Block, BlockScans};
use super::mask::Mask;
use super::plan::Plan;
use crate::codec::{CodecError, ColumnChunk, Decoder, PositionChunk, block_count, block_range};
use crate::geometry::Containment;
use crate::lattice::LatticeBox;
use crate::points::{Batch, Column, Positions, ScalarType};
use crate::store::model::{SLOT_POSITION, SLOT_SCAN, Slot};
use crate::store::{CachedBlock, ChunkBytes, Node, NodeIx, ReadCost, follow};
use std::cell::RefCell;
use std::sync::Arc;

thread_local! {
    static DECODER: RefCell<Decoder> = RefCell::new(Decoder::new());
}

/// A part and its chunks as far as they have been read.
pub(crate) struct Part<'a> {
    plan: &'a Plan,
    head: Node,
    part: usize,
    points: usize,
    chunks: Vec<(Slot, Option<ChunkBytes>)>,
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

impl<'a> Part<'a> {
    /// Of a node, by its number.
    pub fn at(plan: &'a Plan, node: NodeIx, part: usize) -> Result<Self, QueryError> {
        Ok(Self::new(plan, &plan.nodes.node(node)?, part))
    }

    pub fn new(plan: &'a Plan, head: &Node, part: usize) -> Self {
        let points = head.parts.get(part).map_or(0, |p| p.points as usize);
        Meter::add(&plan.meter.parts, 1);
        Self { plan, head: head.clone(), part, points, chunks: Vec::new() }
    }

    /// Reads the chunks of these columns that are not there yet.
    fn read(&mut self, slots: impl IntoIterator<Item = Slot>) -> Result<(), QueryError> {
        let mut missing: Vec<Slot> = Vec::new();
        for slot in slots {
            // Columns can be decoded only with those that they follow.
            for slot in [slot].into_iter().chain(self.plan.snapshot.leaders(slot)) {
                if !missing.contains(&slot) && self.chunks.iter().all(|(have, _)| *have != slot) {
                    missing.push(slot);
                }
            }
        }
        if missing.is_empty() {
            return Ok(());
        }
        let meter = &self.plan.meter;
        let mut cost = ReadCost::default();
        let read =
            meter.time(Stage::Reading, || self.plan.snapshot.read_part(&self.head, self.part, &missing, &mut cost))?;
        Meter::add(&meter.chunks, cost.rows);
        Meter::add(&meter.bytes_read, cost.bytes);
        Meter::add(&meter.chunks_cached, cost.cached);
        self.chunks.extend(missing.into_iter().zip(read));
        Ok(())
    }

    /// Bytes of the columns read so far.
    pub fn bytes_read(&self) -> u64 {
        self.chunks.iter().flat_map(|(_, chunk)| chunk).map(|chunk| chunk.len() as u64).sum()
    }

    /// Counts what would have been enough to read: of the chunks that were, so many blocks.
    fn count_needed(&self, blocks: usize) {
        let of = block_count(self.points).max(1) as u64;
        Meter::add(&self.plan.meter.bytes_needed, self.bytes_read() * blocks as u64 / of);
    }

    fn chunk(&self, slot: Slot) -> Option<&ChunkBytes> {
        self.chunks.iter().find(|(s, _)| *s == slot).and_then(|(_, c)| c.as_ref())
    }

    fn damaged(&self, slot: Slot, error: &CodecError) -> QueryError {
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

    fn positions(&self) -> Result<PositionChunk<'_>, QueryError> {
        let bytes = self.chunk(SLOT_POSITION).map_or(&[][..], |c| c);
        PositionChunk::parse(bytes, self.head.cube, self.points).map_err(|e| self.damaged(SLOT_POSITION, &e))
    }

    /// `None` if no point of the part has the attribute.
    fn column(&self, slot: Slot, ty: ScalarType) -> Result<Option<ColumnChunk<'_>>, QueryError> {
        let bytes_of = |slot| self.chunk(slot).map(|c| &c[..]);
        let parse = |bytes| follow(&self.plan.snapshot, slot, ty, self.points, bytes, &bytes_of);
        bytes_of(slot).map(parse).transpose().map_err(|e| self.damaged(slot, &e))
    }

    fn scans(&self) -> Result<ColumnChunk<'_>, QueryError> {
        let bytes = self.chunk(SLOT_SCAN).map_or(&[][..], |c| c);
        ColumnChunk::parse(bytes, ScalarType::U32, self.points).map_err(|e| self.damaged(SLOT_SCAN, &e))
    }

    /// The blocks in which something matches (all that are not skipped, if misses are asked for), in order.
    pub fn find(&mut self, look: &Look) -> Result<Vec<Found>, QueryError> {
        let plan = self.plan;
        let needs_scans = plan.scans.is_some() || plan.filter.is_some();
        let slots = plan.filter_columns.iter().map(|(s, _)| *s);
        self.read([SLOT_POSITION].into_iter().chain(needs_scans.then_some(SLOT_SCAN)).chain(slots))?;
        plan.meter.time(Stage::Decoding, || DECODER.with_borrow_mut(|decoder| self.find_with(decoder, look)))
    }

    fn find_with(&self, decoder: &mut Decoder, look: &Look) -> Result<Vec<Found>, QueryError> {
        let plan = self.plan;
        let positions = self.positions()?;
        let scans = (plan.scans.is_some() || plan.filter.is_some()).then(|| self.scans()).transpose()?;
        let filter_columns = plan
            .filter_columns
            .iter()
            .map(|&(slot, ty)| Ok((slot, ty, self.column(slot, ty)?.map(|c| c.at(&positions)))))
            .collect::<Result<Vec<_>, QueryError>>()?;
        let needs_positions = plan.filter.as_ref().is_some_and(|f| f.needs_positions());
        let mut found = Vec::new();
        for (block, bounds) in positions.blocks().iter().enumerate() {
            if (look.skips)(bounds) {
                continue;
            }
            let len = block_range(block, self.points).len();
            let placed = plan.classify(bounds);
            let mut content = Block::undecoded(len);
            let decode_positions = |decoder: &mut Decoder, out: &mut Arc<Positions>| {
                if out.is_empty() {
                    *out = self.block_positions(decoder, &positions, block)?;
                }
                Ok::<(), QueryError>(())
            };
            let mut mask = match placed {
                Containment::Outside => Mask::none(len),
                Containment::Inside => Mask::all(len),
                Containment::Partly => {
                    decode_positions(decoder, &mut content.positions)?;
                    plan.region.test(&content.positions)
                }
            };
            if !mask.is_none()
                && let Some(scans) = &scans
            {
                content.scans = self.block_scans(decoder, scans, block)?;
                if let Some(set) = &plan.scans {
                    mask.and(&content.scans.within(set, len));
                }
            }
            if !mask.is_none()
                && let Some(filter) = &plan.filter
            {
                if needs_positions {
                    decode_positions(decoder, &mut content.positions)?;
                }
                for (slot, ty, chunk) in &filter_columns {
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
                plan.leave_faces(&content.positions, &mut mask);
            }
            if mask.is_none() && !look.misses {
                continue;
            }
            if look.positions {
                decode_positions(decoder, &mut content.positions)?;
            }
            found.push(Found { block, content, mask });
        }
        Ok(found)
    }

    fn block_scans(&self, decoder: &mut Decoder, chunk: &ColumnChunk, block: usize) -> Result<BlockScans, QueryError> {
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

    fn block_positions(
        &self,
        decoder: &mut Decoder,
        chunk: &PositionChunk,
        block: usize,
    ) -> Result<Arc<Positions>, QueryError> {
        if let Some(CachedBlock::Positions(found)) = self.cached(SLOT_POSITION, block) {
            return Ok(found);
        }
        let len = block_range(block, self.points).len();
        let mut positions = Positions::with_capacity(len);
        chunk.decode_block(decoder, block, &mut positions).map_err(|e| self.damaged(SLOT_POSITION, &e))?;
        Meter::add(&self.plan.meter.blocks, 1);
        Meter::add(&self.plan.meter.points_decoded, len as u64);
        let positions = Arc::new(positions);
        self.keep(SLOT_POSITION, block, CachedBlock::Positions(positions.clone()));
        Ok(positions)
    }

    fn cached_column(&self, slot: Slot, block: usize) -> Option<Arc<Column>> {
        match self.cached(slot, block) {
            Some(CachedBlock::Column(column)) => Some(column),
            _ => None,
        }
    }

    /// Decodes a block of a column; what the cache has was asked before.
    fn block_column(
        &self,
        decoder: &mut Decoder,
        slot: Slot,
        ty: ScalarType,
        chunk: &ColumnChunk,
        block: usize,
    ) -> Result<Arc<Column>, QueryError> {
        let mut column = Column::with_capacity(ty, block_range(block, self.points).len());
        chunk.decode_block(decoder, block, &mut column).map_err(|e| self.damaged(slot, &e))?;
        Meter::add(&self.plan.meter.blocks, 1);
        let column = Arc::new(column);
        self.keep(slot, block, CachedBlock::Column(column.clone()));
        Ok(column)
    }

    /// All points with the attributes asked for, whether they match or not.
    pub fn whole(&mut self) -> Result<Batch, QueryError> {
        let plan = self.plan;
        let slots = plan.columns.iter().map(|c| c.id);
        self.read([SLOT_POSITION].into_iter().chain(plan.with_scans.then_some(SLOT_SCAN)).chain(slots))?;
        self.count_needed(block_count(self.points));
        plan.meter.time(Stage::Decoding, || DECODER.with_borrow_mut(|decoder| self.whole_with(decoder)))
    }

    fn whole_with(&self, decoder: &mut Decoder) -> Result<Batch, QueryError> {
        let plan = self.plan;
        let mut batch = Batch::empty(plan.attributes.clone());
        let positions = self.positions()?;
        positions.decode(decoder, &mut batch.positions).map_err(|e| self.damaged(SLOT_POSITION, &e))?;
        let mut blocks = block_count(self.points) as u64;
        if plan.with_scans {
            let mut scans = Column::with_capacity(ScalarType::U32, self.points);
            self.scans()?.decode(decoder, &mut scans).map_err(|e| self.damaged(SLOT_SCAN, &e))?;
            if let Column::U32(scans) = scans {
                batch.scans = scans;
            }
            blocks += block_count(self.points) as u64;
        }
        let mut chunks = Vec::with_capacity(plan.columns.len());
        for (asked, column) in plan.columns.iter().zip(&mut batch.columns) {
            match self.column(asked.id, asked.attribute.ty)? {
                None => column.resize(self.points),
                Some(chunk) => {
                    chunks.push((asked.id, chunk.at(&positions), column));
                    blocks += block_count(self.points) as u64;
                }
            }
        }
        // Block by block, since columns that follow others find their blocks where they were just decoded.
        for block in 0..block_count(self.points) {
            for (slot, chunk, column) in &mut chunks {
                chunk.decode_block(decoder, block, column).map_err(|e| self.damaged(*slot, &e))?;
            }
        }
        Meter::add(&plan.meter.blocks, blocks);
        Meter::add(&plan.meter.points_decoded, self.points as u64);
        Ok(batch)
    }

    /// The points of `found`, whose positions are there, with the attributes asked for.
    pub fn take(&mut self, found: &[Found]) -> Result<Batch, QueryError> {
        let plan = self.plan;
        let count: usize = found.iter().map(|f| f.mask.count()).sum();
        if count == 0 {
            return Ok(Batch::empty(plan.attributes.clone()));
        }
        // Block by block, then column by column: what the filter or the cache has need not be read.
        let ready: Vec<Vec<Option<Arc<Column>>>> = found
            .iter()
            .map(|Found { block, content, mask }| {
                let column =
                    |slot: Slot| content.shared_column(slot).cloned().or_else(|| self.cached_column(slot, *block));
                let none = mask.is_none();
                plan.columns.iter().map(|asked| if none { None } else { column(asked.id) }).collect()
            })
            .collect();
        let is_ready = |i: usize| found.iter().zip(&ready).all(|(f, ready)| f.mask.is_none() || ready[i].is_some());
        let missing = plan.columns.iter().enumerate().filter(|(i, _)| !is_ready(*i)).map(|(_, asked)| asked.id);
        self.read(plan.with_scans.then_some(SLOT_SCAN).into_iter().chain(missing))?;
        self.count_needed(found.iter().filter(|f| !f.mask.is_none()).count());
        plan.meter
            .time(Stage::Decoding, || DECODER.with_borrow_mut(|decoder| self.take_with(decoder, found, ready, count)))
    }

    fn take_with(
        &self,
        decoder: &mut Decoder,
        found: &[Found],
        ready: Vec<Vec<Option<Arc<Column>>>>,
        count: usize,
    ) -> Result<Batch, QueryError> {
        let plan = self.plan;
        let mut batch = Batch::empty(plan.attributes.clone());
        batch.positions = Positions::with_capacity(count);
        batch.columns = plan.columns.iter().map(|c| Column::with_capacity(c.attribute.ty, count)).collect();
        let scans = plan.with_scans.then(|| self.scans()).transpose()?;
        let positions = self.positions()?;
        let chunks = plan
            .columns
            .iter()
            .map(|c| Ok(self.column(c.id, c.attribute.ty)?.map(|c| c.at(&positions))))
            .collect::<Result<Vec<_>, QueryError>>()?;
        for (Found { block, content, mask }, ready) in found.iter().zip(ready) {
            if mask.is_none() {
                continue;
            }
            let all = mask.is_all();
            let indices = if all { Vec::new() } else { mask.indices() };
            let axes = [
                (&mut batch.positions.x, &content.positions.x),
                (&mut batch.positions.y, &content.positions.y),
                (&mut batch.positions.z, &content.positions.z),
            ];
            for (out, values) in axes {
                if all {
                    out.extend_from_slice(values);
                } else {
                    out.extend(indices.iter().map(|&i| values[i as usize]));
                }
            }
            if let Some(scans) = &scans {
                match self.block_scans(decoder, scans, *block)? {
                    BlockScans::One(scan) => {
                        batch.scans.resize(batch.scans.len() + indices_or(all, &indices, mask), scan)
                    }
                    BlockScans::Each(each) if all => batch.scans.extend(each),
                    BlockScans::Each(each) => batch.scans.extend(indices.iter().map(|&i| each[i as usize])),
                }
            }
            for (((asked, chunk), ready), out) in plan.columns.iter().zip(&chunks).zip(ready).zip(&mut batch.columns) {
                let decoded = match (ready, chunk) {
                    (Some(column), _) => column,
                    (None, None) => {
                        out.resize(out.len() + indices_or(all, &indices, mask));
                        continue;
                    }
                    // Straight to where it belongs.
                    (None, Some(chunk)) if all && !plan.keeps_blocks => {
                        chunk.decode_block(decoder, *block, out).map_err(|e| self.damaged(asked.id, &e))?;
                        Meter::add(&plan.meter.blocks, 1);
                        continue;
                    }
                    (None, Some(chunk)) => self.block_column(decoder, asked.id, asked.attribute.ty, chunk, *block)?,
                };
                if all {
                    out.append(&decoded);
                } else {
                    out.extend_gathered(&decoded, &indices);
                }
            }
        }
        Ok(batch)
    }

    /// The points at `indices`, ascending, or all, with the attributes asked for.
    pub fn gather(&mut self, indices: Option<&[u32]>) -> Result<Batch, QueryError> {
        self.read([SLOT_POSITION])?;
        let found = self.plan.meter.time(Stage::Decoding, || {
            DECODER.with_borrow_mut(|decoder| {
                let positions = self.positions()?;
                let mut found = Vec::new();
                for block in 0..block_count(self.points) {
                    let range = block_range(block, self.points);
                    let mask = match indices {
                        None => Mask::all(range.len()),
                        Some(indices) => {
                            let here = &indices[indices.partition_point(|&i| (i as usize) < range.start)
                                ..indices.partition_point(|&i| (i as usize) < range.end)];
                            Mask::of_indices(range.len(), here.iter().map(|&i| i as usize - range.start))
                        }
                    };
                    if mask.is_none() {
                        continue;
                    }
                    let mut content = Block::undecoded(range.len());
                    content.positions = self.block_positions(decoder, &positions, block)?;
                    found.push(Found { block, content, mask });
                }
                Ok::<_, QueryError>(found)
            })
        })?;
        self.take(&found)
    }
}

/// How many points are taken of a block.
fn indices_or(all: bool, indices: &[u32], mask: &Mask) -> usize {
    if all { mask.len() } else { indices.len() }
}

//! The points of a part with the attributes asked for.

use super::QueryError;
use super::answer::{Meter, Stage};
use super::block::{Block, BlockScans};
use super::mask::Mask;
use super::part::{DECODER, Found, Look, Part};
use crate::codec::{ColumnChunk, Decoder, PositionChunk};
use crate::points::{Batch, Column, Positions, ScalarType};
use crate::store::model::{SLOT_POSITION, SLOT_SCAN, Slot, StoredAttribute};
use std::sync::Arc;

/// The columns that are handed on.
struct Taken<'c> {
    scans: Option<ColumnChunk<'c>>,
    columns: Vec<Option<ColumnChunk<'c>>>,
}

impl Part<'_> {
    /// All points with the attributes asked for, whether they match or not.
    pub fn whole(&mut self) -> Result<Batch, QueryError> {
        let plan = self.plan;
        let slots = plan.columns.iter().map(|c| c.id);
        self.read([SLOT_POSITION].into_iter().chain(plan.with_scans.then_some(SLOT_SCAN)).chain(slots))?;
        self.count_needed(self.blocks.count());
        plan.meter.time(Stage::Decoding, || DECODER.with_borrow_mut(|decoder| self.whole_with(decoder)))
    }

    fn whole_with(&self, decoder: &mut Decoder) -> Result<Batch, QueryError> {
        let plan = self.plan;
        let mut batch = Batch::empty(plan.attributes.clone());
        let positions = self.positions()?;
        positions.decode(decoder, &mut batch.positions).map_err(|e| self.damaged(SLOT_POSITION, &e))?;
        let mut blocks = self.blocks.count() as u64;
        if plan.with_scans {
            let mut scans = Column::with_capacity(ScalarType::U32, self.blocks.points());
            self.scans()?.decode(decoder, &mut scans).map_err(|e| self.damaged(SLOT_SCAN, &e))?;
            if let Column::U32(scans) = scans {
                batch.scans = scans;
            }
            blocks += self.blocks.count() as u64;
        }
        let mut chunks = Vec::with_capacity(plan.columns.len());
        for (asked, column) in plan.columns.iter().zip(&mut batch.columns) {
            match self.column(asked.id, asked.attribute.ty)? {
                None => column.resize(self.blocks.points()),
                Some(chunk) => {
                    chunks.push((asked.id, chunk.at(&positions), column));
                    blocks += self.blocks.count() as u64;
                }
            }
        }
        // Block by block, since columns that follow others find their blocks where they were just decoded.
        for block in 0..self.blocks.count() {
            for (slot, chunk, column) in &mut chunks {
                chunk.decode_block(decoder, block, column).map_err(|e| self.damaged(*slot, &e))?;
            }
        }
        Meter::add(&plan.meter.blocks, blocks);
        plan.decoded(self.blocks.points() as u64);
        Ok(batch)
    }

    /// The points of `found`, whose positions are there, with the attributes asked for.
    pub fn take(&mut self, found: &[Found]) -> Result<Batch, QueryError> {
        let plan = self.plan;
        let count: usize = found.iter().map(|f| f.mask.count()).sum();
        let mut batch = Batch::empty(plan.attributes.clone());
        if count > 0 {
            batch.positions = Positions::with_capacity(count);
            batch.columns = plan.columns.iter().map(|c| Column::with_capacity(c.attribute.ty, count)).collect();
            self.take_into(found, &mut batch)?;
        }
        Ok(batch)
    }

    /// Appends them to a batch of the query.
    pub fn take_into(&mut self, found: &[Found], batch: &mut Batch) -> Result<(), QueryError> {
        let plan = self.plan;
        if found.iter().all(|f| f.mask.is_none()) {
            return Ok(());
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
        self.want(found.iter().filter(|f| !f.mask.is_none()).map(|f| f.block));
        let is_ready = |i: usize| found.iter().zip(&ready).all(|(f, ready)| f.mask.is_none() || ready[i].is_some());
        let missing = plan.columns.iter().enumerate().filter(|(i, _)| !is_ready(*i)).map(|(_, asked)| asked.id);
        self.read(plan.with_scans.then_some(SLOT_SCAN).into_iter().chain(missing))?;
        self.count_needed(found.iter().filter(|f| !f.mask.is_none()).count());
        plan.meter
            .time(Stage::Decoding, || DECODER.with_borrow_mut(|decoder| self.take_with(decoder, found, ready, batch)))
    }

    fn take_with(
        &self,
        decoder: &mut Decoder,
        found: &[Found],
        ready: Vec<Vec<Option<Arc<Column>>>>,
        batch: &mut Batch,
    ) -> Result<(), QueryError> {
        let positions = self.positions()?;
        let taken = self.taken(&positions)?;
        let some = found.iter().zip(ready).filter(|(found, _)| !found.mask.is_none());
        for (found, ready) in some {
            self.take_block(decoder, &taken, found, ready, batch)?;
        }
        Ok(())
    }

    fn taken<'c>(&'c self, positions: &'c PositionChunk<'c>) -> Result<Taken<'c>, QueryError> {
        let plan = self.plan;
        let column = |c: &StoredAttribute| Ok(self.column(c.id, c.attribute.ty)?.map(|c| c.at(positions)));
        Ok(Taken {
            scans: plan.with_scans.then(|| self.scans()).transpose()?,
            columns: plan.columns.iter().map(column).collect::<Result<_, QueryError>>()?,
        })
    }

    /// Appends the points found in a block; `ready` has the columns that need not be decoded.
    fn take_block(
        &self,
        decoder: &mut Decoder,
        Taken { scans, columns }: &Taken,
        Found { block, content, mask }: &Found,
        ready: Vec<Option<Arc<Column>>>,
        batch: &mut Batch,
    ) -> Result<(), QueryError> {
        let plan = self.plan;
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
        if let Some(scans) = scans {
            match self.block_scans(decoder, scans, *block)? {
                BlockScans::One(scan) => batch.scans.resize(batch.scans.len() + indices_or(all, &indices, mask), scan),
                BlockScans::Each(each) if all => batch.scans.extend(each),
                BlockScans::Each(each) => batch.scans.extend(indices.iter().map(|&i| each[i as usize])),
            }
        }
        let count = indices_or(all, &indices, mask);
        for (((asked, chunk), ready), out) in plan.columns.iter().zip(columns).zip(ready).zip(&mut batch.columns) {
            let decoded = match (ready, chunk) {
                (Some(column), _) => column,
                (None, None) => {
                    out.resize(out.len() + count);
                    continue;
                }
                // Straight to where it belongs.
                (None, Some(chunk)) if !plan.keeps_blocks => {
                    if !chunk.repeat(count, out) {
                        let start = out.len();
                        chunk.decode_block(decoder, *block, out).map_err(|e| self.damaged(asked.id, &e))?;
                        if !all {
                            out.keep_after(start, &indices);
                        }
                    }
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
        Ok(())
    }

    /// The matching points with the attributes asked for.
    pub fn matching(&mut self, look: &Look) -> Result<Batch, QueryError> {
        let plan = self.plan;
        if plan.filter.is_some() || plan.keeps_blocks {
            // The other columns are read only where something passes the filter, and is not kept.
            let found = self.find(look)?;
            return self.take(&found);
        }
        self.read_positions(look.skips)?;
        if self.wants_nothing() {
            return Ok(Batch::empty(plan.attributes.clone()));
        }
        let scans = (plan.with_scans || plan.scans.is_some()).then_some(SLOT_SCAN);
        self.read(scans.into_iter().chain(plan.columns.iter().map(|c| c.id)))?;
        let (batch, blocks) = plan.meter.time(Stage::Decoding, || {
            DECODER.with_borrow_mut(|decoder| {
                let positions = self.positions()?;
                let (tested, taken) = (self.tested(&positions)?, self.taken(&positions)?);
                let mut batch = Batch::empty(plan.attributes.clone());
                let mut blocks = 0;
                // Block by block, since columns that follow positions or others find theirs where they were just decoded.
                for block in 0..positions.blocks().len() {
                    if let Some(found) = self.find_block(decoder, &tested, block, look)?
                        && !found.mask.is_none()
                    {
                        blocks += 1;
                        self.take_block(decoder, &taken, &found, vec![None; plan.columns.len()], &mut batch)?;
                    }
                }
                Ok::<_, QueryError>((batch, blocks))
            })
        })?;
        self.count_needed(blocks);
        Ok(batch)
    }

    /// The points at `indices`, ascending, or all, with the attributes asked for.
    pub fn gather(&mut self, indices: Option<&[u32]>) -> Result<Batch, QueryError> {
        if let Some(indices) = indices {
            let blocks = self.blocks;
            self.want(indices.iter().map(|&i| blocks.of_point(i as usize)));
        }
        self.read([SLOT_POSITION])?;
        let found = self.plan.meter.time(Stage::Decoding, || {
            DECODER.with_borrow_mut(|decoder| {
                let positions = self.positions()?;
                let mut found = Vec::new();
                for block in 0..self.blocks.count() {
                    let range = self.blocks.range(block);
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

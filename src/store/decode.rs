//! A node's points back from its rows, all columns: for `digest`, `verify` and changes of the tree. Queries decode what
//! they need themselves.

use super::error::{RowError, StoreError};
use super::model::{NodeHead, SLOT_PACKED, SLOT_POSITION, SLOT_SCAN, ScanId, Slot};
use super::rows::RowName;
use super::snapshot::{ChunkBytes, ReadCost, Snapshot};
use crate::codec::{Blocks, CodecError, ColumnChunk, Decoder, PositionChunk};
use crate::lattice::{Key, LatticeBox};
use crate::points::{Column, ScalarType};

/// All that a part's rows hold.
#[derive(Debug)]
pub struct DecodedPart {
    /// In the order of the chunk.
    pub keys: Vec<Key>,
    /// The bounds of each block, as the chunk gives them.
    pub blocks: Vec<LatticeBox>,
    /// The scan of each point.
    pub scans: Vec<ScanId>,
    /// Ascending by slot.
    pub columns: Vec<(Slot, Column)>,
}

/// Reads and decodes the positions of a part alone; keys are in the order of the chunk.
///
/// # Errors
///
/// As [`decode_part`].
pub fn decode_part_keys(
    snapshot: &Snapshot,
    head: &NodeHead,
    part: usize,
    decoder: &mut Decoder,
) -> Result<Vec<Key>, StoreError> {
    let damage = |what: String| snapshot.place().error(RowName { head, part, slot: SLOT_POSITION }.damage(what));
    let bytes = snapshot.chunk_bytes(head, part, SLOT_POSITION, &mut ReadCost::default())?;
    let bytes = bytes.ok_or_else(|| damage("the part has no positions".into()))?;
    let mut keys = Vec::new();
    let decoded =
        PositionChunk::parse(&bytes, head.cube, head.blocks(part)).and_then(|c| c.decode_keys(decoder, &mut keys));
    decoded.map_err(|e| damage(e.to_string()))?;
    Ok(keys)
}

/// The chunk of a column with the chunks of those that it follows; `bytes_of` has all that are there.
///
/// # Errors
///
/// As [`ColumnChunk::parse`].
pub fn follow<'a>(
    snapshot: &Snapshot,
    slot: Slot,
    ty: ScalarType,
    blocks: Blocks,
    bytes: &'a [u8],
    bytes_of: &dyn Fn(Slot) -> Option<&'a [u8]>,
) -> Result<ColumnChunk<'a>, CodecError> {
    let mut chunk = ColumnChunk::parse(bytes, ty, blocks)?;
    if snapshot.leads(slot) {
        chunk = chunk.leading();
    }
    for leader in snapshot.leaders(slot) {
        let Some(bytes) = bytes_of(leader) else { break };
        chunk = chunk.after(follow(snapshot, leader, ty, blocks, bytes, bytes_of)?);
    }
    Ok(chunk)
}

/// Reads and decodes all columns of a part.
///
/// # Errors
///
/// [`StoreError::Damaged`] if a row is missing or wrong, or a column of it is.
pub fn decode_part(
    snapshot: &Snapshot,
    head: &NodeHead,
    part: usize,
    decoder: &mut Decoder,
) -> Result<DecodedPart, StoreError> {
    let error = |e: RowError| snapshot.place().error(e);
    let name = |slot| RowName { head, part, slot };
    let facts = head.parts.get(part).ok_or_else(|| error(name(SLOT_PACKED).damage("the node has no such part")))?;
    let blocks = facts.blocks();
    let mut slots: Vec<Slot> = facts.chunks.iter().map(|c| c.0).chain(facts.packed.iter().map(|c| c.0)).collect();
    slots.sort_unstable();
    let bytes = snapshot.read_part(head, part, &slots, &mut ReadCost::default())?;
    let mut found = slots.iter().copied().zip(bytes);
    let mut next = |slot: Slot| -> Result<ChunkBytes, StoreError> {
        match found.next() {
            Some((s, Some(bytes))) if s == slot => Ok(bytes),
            _ => Err(error(name(slot).damage("the part has no such column"))),
        }
    };
    let positions = next(SLOT_POSITION)?;
    let mut keys: Vec<Key> = Vec::new();
    let positions = PositionChunk::parse(&positions, head.cube, blocks)
        .and_then(|c| c.decode_keys(decoder, &mut keys).map(|()| c))
        .map_err(|e| error(name(SLOT_POSITION).damage(e.to_string())))?;
    let scan_bytes = next(SLOT_SCAN)?;
    let mut found = Vec::with_capacity(slots.len());
    for &slot in slots.iter().skip(2) {
        let attribute =
            snapshot.attribute(slot).ok_or_else(|| error(name(slot).damage("there is no such attribute")))?;
        found.push((slot, attribute.attribute.ty, next(slot)?));
    }
    let of_slot = |slot: Slot| found.iter().find(|f| f.0 == slot).map(|f| &f.2[..]);
    let parse = |slot: Slot, ty: ScalarType, bytes| {
        let chunk = follow(snapshot, slot, ty, blocks, bytes, &of_slot);
        chunk.map(|c| c.at(&positions)).map_err(|e| error(name(slot).damage(e.to_string())))
    };
    let mut scans = Column::with_capacity(ScalarType::U32, blocks.points());
    let chunk = parse(SLOT_SCAN, ScalarType::U32, &scan_bytes[..])?;
    chunk.decode(decoder, &mut scans).map_err(|e| error(name(SLOT_SCAN).damage(e.to_string())))?;
    let Column::U32(scans) = scans else {
        return Err(error(name(SLOT_SCAN).damage("are no scan ids")));
    };
    let chunks = found.iter().map(|(slot, ty, bytes)| parse(*slot, *ty, bytes)).collect::<Result<Vec<_>, _>>()?;
    let mut columns: Vec<_> = found.iter().map(|f| (f.0, Column::with_capacity(f.1, blocks.points()))).collect();
    // Block by block, since columns that follow others find their blocks where they were just decoded.
    for block in 0..blocks.count() {
        for (chunk, (slot, column)) in chunks.iter().zip(&mut columns) {
            chunk.decode_block(decoder, block, column).map_err(|e| error(name(*slot).damage(e.to_string())))?;
        }
    }
    Ok(DecodedPart { keys, blocks: positions.blocks().to_vec(), scans, columns })
}

//! A node's points back from its rows, all columns: for `digest`, `verify` and changes of the tree. Queries decode what
//! they need themselves.

use super::error::{RowError, StoreError};
use super::model::{NodeHead, SLOT_PACKED, SLOT_POSITION, SLOT_SCAN, ScanId, Slot};
use super::rows::RowName;
use super::snapshot::{ChunkBytes, ReadCost, Snapshot};
use crate::codec::{ColumnChunk, Decoder, PositionChunk};
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
    let points = head.parts.get(part).map_or(0, |facts| facts.points as usize);
    let mut keys = Vec::new();
    let decoded = PositionChunk::parse(&bytes, head.cube, points).and_then(|c| c.decode_keys(decoder, &mut keys));
    decoded.map_err(|e| damage(e.to_string()))?;
    Ok(keys)
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
    let points = facts.points as usize;
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
    let positions = PositionChunk::parse(&positions, head.cube, points)
        .and_then(|c| c.decode_keys(decoder, &mut keys).map(|()| c))
        .map_err(|e| error(name(SLOT_POSITION).damage(e.to_string())))?;
    let mut column = |slot: Slot, ty: ScalarType, bytes: &[u8]| {
        let mut column = Column::with_capacity(ty, 0);
        ColumnChunk::parse(bytes, ty, points)
            .and_then(|c| c.at(&positions).decode(decoder, &mut column))
            .map_err(|e| error(name(slot).damage(e.to_string())))?;
        Ok::<_, StoreError>(column)
    };
    let Column::U32(scans) = column(SLOT_SCAN, ScalarType::U32, &next(SLOT_SCAN)?)? else {
        return Err(error(name(SLOT_SCAN).damage("are no scan ids")));
    };
    let mut columns = Vec::with_capacity(slots.len());
    for &slot in slots.iter().skip(2) {
        let attribute =
            snapshot.attribute(slot).ok_or_else(|| error(name(slot).damage("there is no such attribute")))?;
        columns.push((slot, column(slot, attribute.attribute.ty, &next(slot)?)?));
    }
    Ok(DecodedPart { keys, blocks: positions.blocks().to_vec(), scans, columns })
}

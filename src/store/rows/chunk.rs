//! Rows of `chunk`, and the packed rows in which small columns lie together.

use super::super::error::RowError;
use super::super::model::{NodeHead, SLOT_PACKED, Slot};
use super::node::node_name;
use super::{Put, Sql, Take, Taken, checked, put_row};
use crate::lattice::Cube;
use rusqlite::Connection;
use std::ops::Range;

const TABLE: &str = "chunk";

/// A row of `chunk`: one encoded column of one part of one node, or several small ones.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ChunkRow {
    /// `chunk_base + part * SLOT_STRIDE + slot`.
    pub id: i64,
    /// The node's layer.
    pub layer: u16,
    /// The node's cube.
    pub cube: Cube,
    /// The part, from 0.
    pub part: u32,
    /// The column, or [`SLOT_PACKED`].
    pub slot: Slot,
    /// Points of the part.
    pub points: u32,
    /// The encoded column, or what [`pack`] makes.
    pub bytes: Vec<u8>,
}

impl ChunkRow {
    /// The column `codec`: how the bytes are encoded, which is their first byte; 0 for a packed row.
    fn codec(&self) -> u8 {
        if self.slot == SLOT_PACKED { 0 } else { self.bytes.first().copied().unwrap_or(0) }
    }
}

/// Which row is meant: of a node, a part and a column.
#[derive(Clone, Copy, Debug)]
pub(in crate::store) struct RowName<'a> {
    pub head: &'a NodeHead,
    pub part: usize,
    pub slot: Slot,
}

impl RowName<'_> {
    pub fn text(&self) -> String {
        let node = node_name(self.head.layer.into(), &self.head.cube.node_key().0);
        let column = match self.slot {
            0 => "positions".to_owned(),
            1 => "scan ids".to_owned(),
            SLOT_PACKED => "small columns".to_owned(),
            slot => format!("attribute {slot}"),
        };
        format!("{node}, part {}, {column}", self.part)
    }

    pub fn damage(&self, what: impl Into<String>) -> RowError {
        RowError::damage(TABLE, self.text(), what)
    }
}

pub(in crate::store) fn put_chunk(connection: &Connection, chunk: &ChunkRow) -> Result<(), RowError> {
    let key = chunk.cube.node_key();
    put_row(
        connection,
        TABLE,
        "INSERT INTO chunk (id, layer, key, part, slot, points, codec, bytes, checksum) \
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
        &[
            Sql::Int(chunk.id),
            Sql::Int(chunk.layer.into()),
            Sql::Blob(&key.0),
            Sql::Int(chunk.part.into()),
            Sql::Int(chunk.slot.into()),
            Sql::Int(chunk.points.into()),
            Sql::Int(chunk.codec().into()),
            Sql::Blob(&chunk.bytes),
        ],
    )
}

/// The bytes of the row that is named, which must be there, be whole, and be what its node's row says.
pub(in crate::store) fn read_chunk(
    connection: &Connection,
    name: RowName<'_>,
    expected_bytes: u32,
) -> Result<Vec<u8>, RowError> {
    let head = name.head;
    let mut statement = connection
        .prepare_cached("SELECT id, layer, key, part, slot, points, codec, bytes, checksum FROM chunk WHERE id = ?")?;
    let mut rows = statement.query([head.chunk_id(name.part, name.slot)])?;
    let row = rows.next()?.ok_or_else(|| name.damage("the row is missing"))?;
    let columns = checked(TABLE, row, 9, || name.text())?;
    let points = head.parts.get(name.part).map_or(0, |p| p.points);
    let same = columns.int::<i64>(0)? == head.chunk_id(name.part, name.slot)
        && columns.int::<i64>(1)? == i64::from(head.layer)
        && columns.blob(2)? == head.cube.node_key().0
        && columns.int::<i64>(3)? == name.part as i64
        && columns.int::<i64>(4)? == i64::from(name.slot)
        && columns.int::<i64>(5)? == i64::from(points);
    if !same {
        return Err(name.damage("the row is whole but belongs elsewhere"));
    }
    let bytes = columns.blob(7)?;
    if bytes.len() as u64 != u64::from(expected_bytes) {
        return Err(name.damage(format!("has {} bytes, but the node's row says {expected_bytes}", bytes.len())));
    }
    if name.slot != SLOT_PACKED && bytes.first().copied() != Some(columns.int(6)?) {
        return Err(name.damage("the codec is not the first byte"));
    }
    Ok(bytes.to_vec())
}

/// The ranges of ids that wait to be removed, both ends inside, ascending.
pub(in crate::store) fn load_garbage(connection: &Connection) -> Result<Vec<(i64, i64)>, RowError> {
    let mut statement = connection.prepare_cached("SELECT first, last FROM garbage ORDER BY first")?;
    let ranges = statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?;
    Ok(ranges.collect::<Result<_, _>>()?)
}

/// The bytes of a packed row: how many columns, per column its slot and length as varints, then the columns.
pub fn pack<'a>(columns: impl ExactSizeIterator<Item = (Slot, &'a [u8])> + Clone) -> Vec<u8> {
    let mut put = Put::default();
    put.varint(columns.len() as u64);
    for (slot, bytes) in columns.clone() {
        put.varint(slot.into());
        put.varint(bytes.len() as u64);
    }
    columns.for_each(|(_, bytes)| put.0.extend_from_slice(bytes));
    put.0
}

/// Where each column of a packed row lies in it, ascending by slot.
pub(in crate::store) fn unpack(row: &[u8]) -> Taken<Vec<(Slot, Range<usize>)>> {
    let mut take = Take(row);
    let n = take.count(2)?;
    let mut columns: Vec<(Slot, Range<usize>)> = Vec::with_capacity(n);
    let mut end = 0_usize;
    for _ in 0..n {
        let (slot, length): (Slot, u32) = (take.small()?, take.small()?);
        let start = end;
        end = end.checked_add(length as usize).ok_or("a column is too long")?;
        columns.push((slot, start..end));
    }
    if end != take.0.len() {
        return Err(format!("the columns have {end} bytes, but {} are there", take.0.len()));
    }
    if !columns.is_sorted_by(|a, b| a.0 < b.0) {
        return Err("the columns are not ascending".into());
    }
    let offset = row.len() - end;
    columns.iter_mut().for_each(|(_, r)| *r = r.start + offset..r.end + offset);
    Ok(columns)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn packed_columns_come_back_and_noise_is_refused_or_whole(
            columns in prop::collection::btree_map(any::<u16>(), prop::collection::vec(any::<u8>(), 0..300), 0..9),
            noise in prop::collection::vec(any::<u8>(), 0..40),
        ) {
            let row = pack(columns.iter().map(|(&s, b)| (s, &b[..])));
            let found = unpack(&row).unwrap();
            prop_assert_eq!(found.len(), columns.len());
            for ((slot, range), (s, b)) in found.into_iter().zip(&columns) {
                prop_assert_eq!((slot, &row[range]), (*s, &b[..]));
            }
            if let Ok(found) = unpack(&noise) {
                prop_assert!(found.iter().all(|(_, r)| r.end <= noise.len()));
            }
        }
    }
}

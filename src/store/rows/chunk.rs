//! Rows of `chunk`, and the packed rows in which small columns lie together.

use super::super::checksum::Checksum;
use super::super::error::RowError;
use super::super::model::{NodeHead, SLOT_PACKED, SLOT_POSITION, Slot};
use super::node::node_name;
use super::pieces::Pieces;
use super::{Columns, Put, Sql, Take, Taken, checked};
use crate::codec::{self, Blocks, Cut};
use crate::lattice::Cube;
use rusqlite::blob::Blob;
use rusqlite::{Connection, MAIN_DB, params_from_iter};
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
    /// Lengths and checksums of its pieces.
    pieces: Vec<u8>,
}

impl ChunkRow {
    /// Of these bytes, which are cut into pieces where their head says that the part's blocks lie.
    pub fn new(id: i64, (layer, cube): (u16, Cube), part: u32, slot: Slot, blocks: Blocks, bytes: Vec<u8>) -> Self {
        let pieces = Pieces::of(&bytes, cuts_of(slot, cube, blocks, &bytes)).to_bytes();
        // A part has at most 2^24 points.
        let points = blocks.points() as u32;
        Self { id, layer, cube, part, slot, points, bytes, pieces }
    }

    /// The column `codec`: how the bytes are encoded, which is their first byte; 0 for a packed row.
    fn codec(&self) -> u8 {
        if self.slot == SLOT_PACKED { 0 } else { self.bytes.first().copied().unwrap_or(0) }
    }
}

/// Columns of a packed row that have fewer bytes are not cut into blocks.
const CUT_FROM_BYTES: usize = 1024;

/// Where the bytes of a row are cut into pieces.
fn cuts_of(slot: Slot, cube: Cube, blocks: Blocks, bytes: &[u8]) -> Vec<Cut> {
    let mut cuts = Vec::new();
    if blocks.count() > 1 {
        let columns = match slot {
            SLOT_PACKED => unpack(bytes).unwrap_or_default(),
            slot => vec![(slot, 0..bytes.len())],
        };
        for (slot, range) in columns.into_iter().filter(|(_, range)| range.len() >= CUT_FROM_BYTES) {
            let cube = (slot == SLOT_POSITION).then_some(cube);
            let of_column = codec::cuts(&bytes[range.clone()], cube, blocks).unwrap_or_default();
            cuts.push(Cut { end: range.start, block: None });
            cuts.extend(of_column.into_iter().map(|cut| Cut { end: range.start + cut.end, ..cut }));
        }
        cuts.retain(|cut| cut.end > 0);
    }
    cuts.push(Cut { end: bytes.len(), block: None });
    cuts
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
    let values = [
        Sql::Int(chunk.id),
        Sql::Int(chunk.layer.into()),
        Sql::Blob(&key.0),
        Sql::Int(chunk.part.into()),
        Sql::Int(chunk.slot.into()),
        Sql::Int(chunk.points.into()),
        Sql::Int(chunk.codec().into()),
        Sql::Blob(&chunk.pieces),
    ];
    let checksum = Sql::Int(Checksum::of_row(TABLE, values.iter().map(Sql::value)).to_sql());
    let insert = "INSERT INTO chunk (id, layer, key, part, slot, points, codec, pieces, checksum, bytes) \
                  VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)";
    let all = values.into_iter().chain([checksum, Sql::Blob(&chunk.bytes)]);
    connection.prepare_cached(insert)?.execute(params_from_iter(all))?;
    Ok(())
}

/// What was read of a row.
pub(in crate::store) struct ReadChunk {
    /// As long as the row's bytes; what was not read is [`UNREAD`].
    pub bytes: Vec<u8>,
    /// The blocks that were read; `None`: all.
    pub blocks: Option<Vec<bool>>,
    /// How many bytes were read.
    pub read: usize,
}

/// Stands for bytes that were not read: no block of any kind begins so.
const UNREAD: u8 = 0xff;

/// Says which blocks are wanted of a chunk whose bytes are given, of which only the head is there; `None`: all.
type Wanted<'w> = dyn FnMut(&[u8]) -> Option<Vec<bool>> + 'w;

/// The bytes of the row that is named, which must be there, be whole, and be what its node's row says.
pub(in crate::store) fn read_chunk(
    connection: &Connection,
    name: RowName<'_>,
    expected_bytes: u32,
) -> Result<ReadChunk, RowError> {
    let mut statement = connection.prepare_cached(
        "SELECT id, layer, key, part, slot, points, codec, pieces, checksum, bytes FROM chunk WHERE id = ?",
    )?;
    let mut rows = statement.query([name.id()])?;
    let row = rows.next()?.ok_or_else(|| name.damage("the row is missing"))?;
    let columns = checked(TABLE, row, 9, || name.text())?;
    let bytes = row.get_ref(9)?.as_blob().map_err(|_| name.damage("has no bytes"))?;
    let pieces = name.pieces(&columns, bytes.len() as u64, expected_bytes)?;
    (0..pieces.len()).try_for_each(|piece| name.check(&pieces, piece, &bytes[pieces.range(piece)]))?;
    name.check_codec(&columns, bytes)?;
    if !pieces.are_cut(cuts_of(name.slot, name.head.cube, name.head.blocks(name.part), bytes)) {
        return Err(name.damage("its pieces are not its blocks"));
    }
    Ok(ReadChunk { bytes: bytes.to_vec(), blocks: None, read: bytes.len() })
}

/// The same of the blocks that are wanted alone, if it has several.
pub(in crate::store) fn read_blocks(
    connection: &Connection,
    name: RowName<'_>,
    expected_bytes: u32,
    wanted: &mut Wanted<'_>,
) -> Result<ReadChunk, RowError> {
    let mut statement = connection.prepare_cached(
        "SELECT id, layer, key, part, slot, points, codec, pieces, checksum, length(bytes) FROM chunk WHERE id = ?",
    )?;
    let mut rows = statement.query([name.id()])?;
    let row = rows.next()?.ok_or_else(|| name.damage("the row is missing"))?;
    let columns = checked(TABLE, row, 9, || name.text())?;
    let length = row.get_ref(9)?.as_i64().ok().and_then(|n| u64::try_from(n).ok());
    let pieces = name.pieces(&columns, length.unwrap_or(0), expected_bytes)?;
    let blob = connection.blob_open(MAIN_DB, TABLE, "bytes", name.id(), true)?;
    let mut read = ReadChunk { bytes: vec![UNREAD; pieces.total()], blocks: None, read: 0 };
    read.pieces(name, &blob, &pieces, |block| block.is_none())?;
    name.check_codec(&columns, &read.bytes)?;
    if (0..pieces.len()).any(|piece| pieces.block(piece).is_some()) {
        read.blocks = wanted(&read.bytes).filter(|blocks| blocks.contains(&false));
        let blocks = read.blocks.clone();
        let is_wanted = |block: usize| blocks.as_ref().is_none_or(|blocks| blocks.get(block).copied().unwrap_or(false));
        read.pieces(name, &blob, &pieces, |block| block.is_some_and(is_wanted))?;
    }
    Ok(read)
}

impl ReadChunk {
    /// Reads and checks the pieces of the blocks that are wanted, those side by side at once.
    fn pieces(
        &mut self,
        name: RowName<'_>,
        blob: &Blob<'_>,
        pieces: &Pieces,
        wanted: impl Fn(Option<usize>) -> bool,
    ) -> Result<(), RowError> {
        let mut next = 0;
        while let Some(first) = (next..pieces.len()).find(|&piece| wanted(pieces.block(piece))) {
            next = (first..pieces.len()).find(|&piece| !wanted(pieces.block(piece))).unwrap_or(pieces.len());
            let run = pieces.range(first).start..pieces.range(next - 1).end;
            blob.read_at_exact(&mut self.bytes[run.clone()], run.start)?;
            self.read += run.len();
            (first..next).try_for_each(|piece| name.check(pieces, piece, &self.bytes[pieces.range(piece)]))?;
        }
        Ok(())
    }
}

impl RowName<'_> {
    fn id(&self) -> i64 {
        self.head.chunk_id(self.part, self.slot)
    }

    /// The pieces of the row with these columns, which must be the one that is named and have so many bytes.
    fn pieces<K: Fn() -> String>(
        &self,
        columns: &Columns<'_, K>,
        bytes: u64,
        expected_bytes: u32,
    ) -> Result<Pieces, RowError> {
        let head = self.head;
        let same = columns.int::<i64>(0)? == self.id()
            && columns.int::<i64>(1)? == i64::from(head.layer)
            && columns.blob(2)? == head.cube.node_key().0
            && columns.int::<i64>(3)? == self.part as i64
            && columns.int::<i64>(4)? == i64::from(self.slot)
            && columns.int::<i64>(5)? == head.blocks(self.part).points() as i64;
        if !same {
            return Err(self.damage("the row is whole but belongs elsewhere"));
        }
        if bytes != u64::from(expected_bytes) {
            return Err(self.damage(format!("has {bytes} bytes, but the node's row says {expected_bytes}")));
        }
        let pieces = Pieces::parse(columns.blob(7)?).map_err(|what| self.damage(format!("its pieces: {what}")))?;
        if pieces.total() as u64 != bytes {
            return Err(self.damage(format!("has {bytes} bytes, but its pieces have {}", pieces.total())));
        }
        Ok(pieces)
    }

    fn check(&self, pieces: &Pieces, piece: usize, bytes: &[u8]) -> Result<(), RowError> {
        if pieces.is_whole(piece, bytes) {
            return Ok(());
        }
        let range = pieces.range(piece);
        Err(self.damage(format!("the checksum of bytes {} to {} is not theirs", range.start, range.end)))
    }

    fn check_codec<K: Fn() -> String>(&self, columns: &Columns<'_, K>, bytes: &[u8]) -> Result<(), RowError> {
        if self.slot != SLOT_PACKED && bytes.first().copied() != Some(columns.int(6)?) {
            return Err(self.damage("the codec is not the first byte"));
        }
        Ok(())
    }
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

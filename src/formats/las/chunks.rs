//! Where the chunks of a LAZ file are: by its chunk table, by walking layered chunks, or one stream.

use super::header::Header;
use super::laz::Codec;
use crate::formats::file::SourceFile;
use crate::formats::guard::catching;
use crate::formats::{FormatError, Piece};
use laz::laszip::{ChunkTable, ChunkTableEntry};
use std::io::Cursor;

/// A run of records that is compressed apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chunk {
    /// The first record.
    pub first: u64,
    /// Records to take from it.
    pub records: u64,
    /// First byte in the file.
    pub offset: u64,
    /// Compressed bytes.
    pub bytes: u64,
}

/// The chunks of a file.
#[derive(Debug)]
pub enum Chunks {
    /// Each at a known place, in order.
    Known(Vec<Chunk>),
    /// All records in one stream from `offset` to at most `end`: nobody knows where its chunks begin.
    Stream {
        /// First byte of the first chunk.
        offset: u64,
        /// Where the stream ends at the latest.
        end: u64,
        /// Records that the header announces.
        records: u64,
    },
}

impl Chunks {
    /// Finds the chunks of `announced` records that lie before byte `end`.
    ///
    /// # Errors
    ///
    /// [`FormatError::Malformed`] if chunks of different sizes have no table.
    pub(in crate::formats) fn find(
        file: &SourceFile,
        header: &Header,
        codec: &Codec,
        announced: u64,
        end: u64,
        warnings: &mut Vec<String>,
    ) -> Result<Self, FormatError> {
        let start = header.points_offset;
        if announced == 0 {
            return Ok(Self::Known(Vec::new()));
        }
        if codec.point_wise {
            return Ok(Self::Stream { offset: start, end, records: announced });
        }
        let first_chunk = start + 8;
        let table = table_offset(file, start, end)?;
        let entries = match table {
            Some(offset) => read_table(file, codec, offset, first_chunk)?,
            None => None,
        };
        if let Some(entries) = entries {
            return Ok(Self::Known(from_table(file, codec, &entries, first_chunk, announced, warnings)?));
        }
        if codec.layered {
            warnings.push("the chunk table is missing or damaged: chunks were found one by one".to_owned());
            return Ok(Self::Known(walk(file, codec, first_chunk, table.unwrap_or(end), announced)?));
        }
        if codec.chunk_records.is_none() {
            return Err(file.malformed(
                start,
                "the place of a chunk table, which chunks of different sizes need",
                "none that holds; the file is damaged or was not closed by its writer",
            ));
        }
        warnings.push("the chunk table is missing or damaged: points are read as one stream".to_owned());
        Ok(Self::Stream { offset: first_chunk, end: table.unwrap_or(end), records: announced })
    }

    /// Records that can be read; of a stream, those that should.
    pub fn records(&self) -> u64 {
        match self {
            Self::Known(chunks) => chunks.last().map_or(0, |c| c.first + c.records),
            Self::Stream { records, .. } => *records,
        }
    }

    /// Whole chunks, together about `target` records.
    pub fn pieces(&self, target: u64) -> Vec<Piece> {
        let chunks = match self {
            Self::Known(chunks) => chunks,
            Self::Stream { records, .. } => return vec![Piece { first: 0, records: *records }],
        };
        let mut pieces: Vec<Piece> = Vec::new();
        for chunk in chunks {
            match pieces.last_mut() {
                // One more chunk if that comes nearer to the target.
                Some(piece) if piece.records + chunk.records / 2 < target => piece.records += chunk.records,
                _ => pieces.push(Piece { first: chunk.first, records: chunk.records }),
            }
        }
        pieces
    }
}

/// The place of the chunk table: at the start of the points, or in the file's last bytes if its writer could not go back.
fn table_offset(file: &SourceFile, start: u64, end: u64) -> Result<Option<u64>, FormatError> {
    for at in [start, file.bytes().saturating_sub(8)] {
        let offset = file.read_vec(at, 8)?.try_into().map_or(0, u64::from_le_bytes);
        if offset >= start + 8 && offset.checked_add(8).is_some_and(|table| table <= end) {
            return Ok(Some(offset));
        }
    }
    Ok(None)
}

/// The entries of the table at `offset`; `None` if it can't be right.
fn read_table(
    file: &SourceFile,
    codec: &Codec,
    offset: u64,
    first_chunk: u64,
) -> Result<Option<Vec<ChunkTableEntry>>, FormatError> {
    let head = file.read_vec(offset, 8)?;
    let Some(count) = head.get(4..8).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes) else { return Ok(None) };
    // A chunk begins with a whole record, so a count beyond that is a lie; the crate would allocate for it.
    if u64::from(count) > (offset - first_chunk) / codec.record_bytes as u64 {
        return Ok(None);
    }
    // An entry takes at most 2 * 6 bytes.
    let table = file.read_vec(offset, 64 + 12 * u64::from(count))?;
    let variable = codec.chunk_records.is_none();
    let read = catching(|| ChunkTable::read(&mut Cursor::new(&table), variable));
    let Ok(Ok(table)) = read else { return Ok(None) };
    let entries = table.as_ref().to_vec();
    let bytes = entries.iter().try_fold(0_u64, |sum, e| sum.checked_add(e.byte_count));
    let counts = entries.iter().all(|e| u32::try_from(e.point_count).is_ok());
    Ok(bytes.filter(|&b| counts && b <= offset - first_chunk).map(|_| entries))
}

/// Chunks of the table, as far as the header announces records; short of that, what the table has.
fn from_table(
    file: &SourceFile,
    codec: &Codec,
    entries: &[ChunkTableEntry],
    first_chunk: u64,
    announced: u64,
    warnings: &mut Vec<String>,
) -> Result<Vec<Chunk>, FormatError> {
    let mut chunks = Vec::with_capacity(entries.len());
    let (mut first, mut offset) = (0, first_chunk);
    let mut held = 0;
    for (i, entry) in entries.iter().enumerate() {
        let mut holds = codec.chunk_records.unwrap_or(entry.point_count);
        let last = i + 1 == entries.len();
        if last && codec.layered && codec.chunk_records.is_some() {
            // The last chunk of a fixed size may be shorter; its head says by how much.
            let head = file.read_vec(offset, entry.byte_count.min(codec.layered_head_bytes() as u64))?;
            holds = codec.layered_head(&head).map_or(holds, |(records, _)| records);
        }
        held += holds;
        let records = holds.min(announced - first);
        if records > 0 {
            chunks.push(Chunk { first, records, offset, bytes: entry.byte_count });
        }
        first += records;
        offset += entry.byte_count;
    }
    // How many records a last chunk has that is not layered, only its decoder could tell.
    let certain = codec.layered || codec.chunk_records.is_none();
    if certain && held > announced {
        warnings.push(format!("the header announces {announced} records, the chunks hold {held}: the rest is ignored"));
    }
    Ok(chunks)
}

/// Layered chunks one after the other: each says how long it is.
fn walk(
    file: &SourceFile,
    codec: &Codec,
    mut offset: u64,
    end: u64,
    announced: u64,
) -> Result<Vec<Chunk>, FormatError> {
    let mut chunks = Vec::new();
    let mut first = 0;
    while first < announced {
        let head = file.read_vec(offset, codec.layered_head_bytes() as u64)?;
        let Some((holds, bytes)) = codec.layered_head(&head) else { break };
        if holds == 0 || bytes > end.saturating_sub(offset) {
            break;
        }
        let records = holds.min(announced - first);
        chunks.push(Chunk { first, records, offset, bytes });
        first += records;
        offset += bytes;
    }
    Ok(chunks)
}

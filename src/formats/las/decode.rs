//! Chunks to records. Decompressors do the work; here their input is checked and the crate's panics become errors.

use super::chunks::{Chunk, Chunks};
use super::laz::Codec;
use super::source::RUN_BYTES;
use crate::formats::file::SourceFile;
use crate::formats::guard::catching;
use crate::formats::{FormatError, Piece, Tally};
use laz::record::RecordDecompressor;
use std::io::{BufReader, ErrorKind};

/// Gives the records of a piece to a sink, from chunks that may begin before it.
struct Feed<'a> {
    piece: Piece,
    tally: Tally,
    sink: &'a mut dyn FnMut(&[u8]) -> bool,
}

impl Feed<'_> {
    /// Takes decoded records, the first of which is `first`; false to stop.
    fn take(&mut self, first: u64, run: &[u8], stride: usize) -> bool {
        let records = (run.len() / stride) as u64;
        let skip = self.piece.first.saturating_sub(first).min(records);
        let end = (self.piece.first + self.piece.records).saturating_sub(first).min(records);
        if end <= skip {
            return true;
        }
        self.tally.read += end - skip;
        (self.sink)(&run[skip as usize * stride..end as usize * stride])
    }
}

impl Chunks {
    /// Decodes the records of a piece and gives them to `sink`, as [`PointSource::read`](crate::formats::PointSource::read)
    /// says.
    pub(in crate::formats) fn read(
        &self,
        file: &SourceFile,
        codec: &Codec,
        piece: Piece,
        sink: &mut dyn FnMut(&[u8]) -> bool,
    ) -> Result<Tally, FormatError> {
        let mut feed = Feed { piece, tally: Tally::default(), sink };
        if piece.records == 0 {
            return Ok(feed.tally);
        }
        match self {
            Self::Known(chunks) => {
                let begin = chunks.partition_point(|c| c.first + c.records <= piece.first);
                let mut buffer = Vec::new();
                for chunk in chunks[begin..].iter().take_while(|c| c.first < piece.first + piece.records) {
                    if !read_chunk(file, codec, chunk, &mut buffer, &mut feed)? {
                        break;
                    }
                }
            }
            Self::Stream { offset, end, .. } => read_stream(file, codec, (*offset, *end), &mut feed)?,
        }
        Ok(feed.tally)
    }
}

/// Decodes a chunk into the feed; gives what the sink said.
fn read_chunk(
    file: &SourceFile,
    codec: &Codec,
    chunk: &Chunk,
    buffer: &mut Vec<u8>,
    feed: &mut Feed<'_>,
) -> Result<bool, FormatError> {
    let bytes = file.read_vec(chunk.offset, chunk.bytes)?;
    if codec.layered {
        let head = codec.layered_head(&bytes);
        let fits = |&(records, length): &(u64, u64)| records >= chunk.records && length <= bytes.len() as u64;
        if head.filter(fits).is_none() {
            let expected = format!("a chunk of {} records in {} bytes", chunk.records, chunk.bytes);
            let found = match head {
                _ if (bytes.len() as u64) < chunk.bytes => format!("the end of the file after {} bytes", bytes.len()),
                Some((records, length)) => format!("{records} records in {length} bytes"),
                None => "a chunk that ends before its layers".to_owned(),
            };
            return Err(file.malformed(chunk.offset, expected, found));
        }
    }
    let stride = codec.record_bytes;
    let run = (RUN_BYTES / stride).max(1) as u64;
    buffer.resize(run.min(chunk.records) as usize * stride, 0);
    let mut decompressor = guarded(file, chunk.offset, || codec.decompressor(bytes))?
        .map_err(|e| file.unsupported(format!("its LAZ compression ({e})"), ""))?;
    let mut done = 0;
    while done < chunk.records && chunk.first + done < feed.piece.first + feed.piece.records {
        let records = run.min(chunk.records - done);
        let out = &mut buffer[..records as usize * stride];
        guarded(file, chunk.offset, || decompressor.decompress(out))?.map_err(|e| {
            let expected = format!("a chunk of {} records", chunk.records);
            file.malformed(chunk.offset, expected, format!("an undecodable one after record {done} ({e})"))
        })?;
        if !feed.take(chunk.first + done, out, stride) {
            return Ok(false);
        }
        done += records;
    }
    Ok(true)
}

/// Decodes a stream without known chunks from its start; records that the stream ends before are counted as truncated.
fn read_stream(
    file: &SourceFile,
    codec: &Codec,
    (offset, end): (u64, u64),
    feed: &mut Feed<'_>,
) -> Result<(), FormatError> {
    let stride = codec.record_bytes;
    let source = BufReader::with_capacity(RUN_BYTES / 4, file.reader(offset, end));
    let refuse = |e: laz::LasZipError| file.unsupported(format!("its LAZ compression ({e})"), "");
    let mut decompressor = codec.sequential(source).map_err(refuse)?;
    let wanted = feed.piece.first + feed.piece.records;
    let mut buffer = vec![0; (RUN_BYTES / stride).max(1).min(usize::try_from(wanted).unwrap_or(usize::MAX)) * stride];
    let chunk = codec.chunk_records.filter(|_| !codec.point_wise).unwrap_or(u64::MAX);
    let (mut done, mut left) = (0, chunk);
    while done < wanted {
        if left == 0 {
            guarded(file, offset, || codec.restart(&mut decompressor))?.map_err(refuse)?;
            left = chunk;
        }
        let records = ((buffer.len() / stride) as u64).min(wanted - done).min(left) as usize;
        let out = &mut buffer[..records * stride];
        let got = guarded(file, offset, || decode_to_end(&mut decompressor, out, stride))?.map_err(|e| {
            file.malformed(
                offset,
                "a stream of compressed points",
                format!("an undecodable one after record {done} ({e})"),
            )
        })?;
        if got > 0 && !feed.take(done, &buffer[..got * stride], stride) {
            return Ok(());
        }
        done += got as u64;
        left -= got as u64;
        if got < records {
            feed.tally.truncated = wanted - done.max(feed.piece.first);
            return Ok(());
        }
    }
    Ok(())
}

/// Decodes records until `out` is full or the stream ends; gives their number.
fn decode_to_end<R: std::io::Read>(
    decompressor: &mut impl RecordDecompressor<R>,
    out: &mut [u8],
    stride: usize,
) -> std::io::Result<usize> {
    for (i, record) in out.chunks_exact_mut(stride).enumerate() {
        match decompressor.decompress_next(record) {
            Ok(()) => {}
            Err(e) if e.kind() == ErrorKind::UnexpectedEof => return Ok(i),
            Err(e) => return Err(e),
        }
    }
    Ok(out.len() / stride)
}

/// Runs the crate's code; its panic becomes [`FormatError::Decoder`] at `offset`.
fn guarded<T>(file: &SourceFile, offset: u64, decode: impl FnOnce() -> T) -> Result<T, FormatError> {
    catching(decode).map_err(|message| FormatError::Decoder { path: file.path().to_owned(), offset, message })
}

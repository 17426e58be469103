//! What the `laz` crate alone decodes: every chunk of a LAZ file, on so many threads, each into one buffer again and again; then
//! the same by Esker's own reader. An ingest of the same file is measured against the first (docs/performance.md).
//!
//! `cargo run --release --example laz_decode -- 2 north.laz`

use esker::formats::ReadOptions;
use laz::LazVlr;
use laz::laszip::ChunkTable;
use laz::record::{LayeredPointRecordDecompressor, RecordDecompressor, SequentialPointRecordDecompressor};
use std::hint::black_box;
use std::io::{Cursor, Seek, SeekFrom};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

type Failure = Box<dyn std::error::Error + Send + Sync>;

fn main() -> Result<(), Failure> {
    let mut arguments = std::env::args().skip(1);
    let (Some(threads), Some(path)) = (arguments.next(), arguments.next()) else {
        return Err("usage: laz_decode THREADS FILE".into());
    };
    let threads: usize = threads.parse()?;
    let file = std::fs::read(&path)?;
    let vlr = LazVlr::from_buffer(laszip_record(&file)?)?;
    let points_offset = u64::from(u32::from_le_bytes(bytes(&file, 96)?));
    let mut reader = Cursor::new(&file[..]);
    reader.seek(SeekFrom::Start(points_offset))?;
    let table = ChunkTable::read_from(&mut reader, &vlr)?;
    // What the table does not say where all chunks have one size: the points of the last.
    let record_bytes = usize::from(u16::from_le_bytes(bytes(&file, 105)?));
    let mut left = u64::from(u32::from_le_bytes(bytes(&file, 107)?));
    if file[25] >= 4 {
        left = left.max(u64::from_le_bytes(bytes(&file, 247)?));
    }
    let points = left;
    let mut chunks = Vec::new();
    let mut offset = points_offset as usize + 8;
    for entry in &table {
        let size = if vlr.uses_variable_size_chunks() { entry.point_count } else { vlr.chunk_size().into() };
        let count = size.min(left);
        left -= count;
        chunks.push((offset, entry.byte_count as usize, count as usize));
        offset += entry.byte_count as usize;
    }
    let next = AtomicUsize::new(0);
    let by_crate = on_threads(threads, || {
        let mut buffer = Vec::new();
        while let Some(&(offset, length, count)) = chunks.get(next.fetch_add(1, Ordering::Relaxed)) {
            let source = Cursor::new(&file[offset..offset + length]);
            buffer.resize(count * record_bytes, 0);
            decode(&vlr, source, &mut buffer)?;
            black_box(&buffer);
        }
        Ok(())
    })?;
    let source = esker::formats::open(path.as_ref(), &ReadOptions::default())?;
    let pieces = source.pieces(1);
    let next = AtomicUsize::new(0);
    let by_esker = on_threads(threads, || {
        while let Some(&piece) = pieces.get(next.fetch_add(1, Ordering::Relaxed)) {
            source.read(piece, &mut |records| {
                black_box(records);
                true
            })?;
        }
        Ok(())
    })?;
    for (what, seconds) in [("the crate", by_crate), ("Esker's reader", by_esker)] {
        println!("{what}: {points} points, {seconds:.2} s, {:.2} million a second", points as f64 / seconds / 1e6);
    }
    Ok(())
}

/// Seconds that some threads take for a work.
fn on_threads(threads: usize, work: impl Fn() -> Result<(), Failure> + Sync) -> Result<f64, Failure> {
    let started = Instant::now();
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..threads).map(|_| scope.spawn(&work)).collect();
        threads.into_iter().try_for_each(|thread| thread.join().map_err(|_| "a decoder broke down")?)
    })?;
    Ok(started.elapsed().as_secs_f64())
}

fn decode(vlr: &LazVlr, source: Cursor<&[u8]>, buffer: &mut [u8]) -> Result<(), Failure> {
    let layered = vlr.items().first().is_some_and(|item| item.version() >= 3);
    if layered {
        let mut decompressor = LayeredPointRecordDecompressor::new(source);
        decompressor.set_fields_from(vlr.items())?;
        decompressor.decompress_many(buffer)?;
    } else {
        let mut decompressor = SequentialPointRecordDecompressor::new(source);
        decompressor.set_fields_from(vlr.items())?;
        decompressor.decompress_many(buffer)?;
    }
    Ok(())
}

/// The data of the record that says how the points are compressed.
fn laszip_record(file: &[u8]) -> Result<&[u8], Failure> {
    let mut at = usize::from(u16::from_le_bytes(bytes(file, 94)?));
    for _ in 0..u32::from_le_bytes(bytes(file, 100)?) {
        let length = usize::from(u16::from_le_bytes(bytes(file, at + 20)?));
        let id = u16::from_le_bytes(bytes(file, at + 18)?);
        let data = file.get(at + 54..at + 54 + length).ok_or("a record beyond the end of the file")?;
        if id == LazVlr::RECORD_ID && file[at + 2..].starts_with(LazVlr::USER_ID.as_bytes()) {
            return Ok(data);
        }
        at += 54 + length;
    }
    Err("not a LAZ file".into())
}

fn bytes<const N: usize>(file: &[u8], at: usize) -> Result<[u8; N], Failure> {
    Ok(file.get(at..at + N).ok_or("a file that is too short")?.try_into()?)
}

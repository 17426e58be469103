//! A stream of bytes inside a block: as it is, or as a zstd frame where that is shorter.
//!
//! `varint(length << 1 | compressed)`, then that many bytes. A frame is kept without its magic number, checksum and
//! dictionary id; its content's length is known from the block's count.

use super::CodecError;
use super::reader::{Reader, put_varint};
use std::fmt;
use zstd::zstd_safe::{CCtx, DCtx, compress_bound, get_error_name};

/// The first four bytes of every frame, which are not stored.
const MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// Higher levels look for longer matches, of which there are few, and cost more than they save.
const LEVEL: i32 = 1;

/// Below this a frame never pays.
const MIN_BYTES: usize = 24;

const PLACE: &str = "stream of symbols";

/// Writes streams.
pub(super) struct StreamWriter {
    zstd: CCtx<'static>,
    frame: Vec<u8>,
    /// Symbols of one block, for the use of callers.
    pub(super) symbols: Vec<u8>,
    /// Their open bits, for the use of callers.
    pub(super) tails: Vec<u8>,
}

/// Reads streams.
pub(super) struct StreamReader {
    zstd: DCtx<'static>,
    frame: Vec<u8>,
    /// Symbols of one block, for the use of callers.
    pub(super) symbols: Vec<u8>,
    /// Packed bits with room behind them, for the use of callers.
    pub(super) bits: Vec<u8>,
}

impl StreamWriter {
    /// Appends `bytes` to `out`.
    pub(super) fn put(&mut self, bytes: &[u8], out: &mut Vec<u8>) {
        if bytes.len() >= MIN_BYTES {
            self.frame.clear();
            self.frame.reserve(compress_bound(bytes.len()));
            // If zstd fails the bytes are stored as they are.
            if self.zstd.compress(&mut self.frame, bytes, LEVEL).is_ok()
                && let Some(frame) = self.frame.strip_prefix(&MAGIC)
                && frame.len() < bytes.len()
            {
                put_varint((frame.len() as u64) << 1 | 1, out);
                out.extend_from_slice(frame);
                return;
            }
        }
        put_varint((bytes.len() as u64) << 1, out);
        out.extend_from_slice(bytes);
    }
}

impl StreamReader {
    /// Reads a stream of exactly `length` bytes into `out`, whose content is replaced.
    pub(super) fn read(&mut self, reader: &mut Reader, length: usize, out: &mut Vec<u8>) -> Result<(), CodecError> {
        let head = reader.varint(PLACE)?;
        let stored = usize::try_from(head >> 1).unwrap_or(usize::MAX);
        let bytes = reader.take(stored, PLACE)?;
        out.clear();
        if head & 1 == 0 {
            out.extend_from_slice(bytes);
        } else {
            self.frame.clear();
            self.frame.extend_from_slice(&MAGIC);
            self.frame.extend_from_slice(bytes);
            out.reserve(length);
            // zstd may write to the whole capacity; more than `length` is an error below.
            self.zstd
                .decompress(out, &self.frame)
                .map_err(|code| CodecError::Zstd { place: PLACE, message: get_error_name(code) })?;
        }
        if out.len() != length {
            return Err(CodecError::Length { place: PLACE, expected: length, found: out.len() });
        }
        Ok(())
    }
}

impl Default for StreamWriter {
    fn default() -> Self {
        Self { zstd: CCtx::create(), frame: Vec::new(), symbols: Vec::new(), tails: Vec::new() }
    }
}

impl Default for StreamReader {
    fn default() -> Self {
        Self { zstd: DCtx::create(), frame: Vec::new(), symbols: Vec::new(), bits: Vec::new() }
    }
}

impl fmt::Debug for StreamWriter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("StreamWriter").finish_non_exhaustive()
    }
}

impl fmt::Debug for StreamReader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("StreamReader").finish_non_exhaustive()
    }
}

//! A stream of bytes inside a block: as it is, or as symbols of an entropy coder, or as a zstd frame, whichever is shortest.
//!
//! `varint(length << 2 | packing)`, then that many bytes. A frame is kept without its magic number, checksum and
//! dictionary id; its content's length is known from the block's count.

use super::reader::{Reader, put_varint};
use super::symbols::{SymbolReader, SymbolWriter};
use super::{BLOCK_POINTS, CodecError};
use std::fmt;
use zstd::zstd_safe::{CCtx, CParameter, DCtx, ParamSwitch, compress_bound, get_error_name};

/// The first four bytes of every frame, which are not stored.
const MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// Higher levels look for longer matches, of which there are few, and cost more than they save.
const LEVEL: i32 = 1;

/// How far zstd's fastest strategy steps from place to place, looking for matches: 0 is the level's own, and this beyond the
/// end of any stream.
const NO_MATCHES: u32 = 2 * BLOCK_POINTS as u32;

/// Below this nothing pays.
const MIN_BYTES: usize = 24;

/// So many bytes tell if there are repetitions, which zstd finds and the entropy coder does not: noise has none.
const PROBE_BYTES: usize = 512;

/// Streams of more bits a symbol become frames: whole bits cost next to nothing more there, and zstd's tables decode faster.
const FRAME_BITS: usize = 4;

/// And may take so much more, as a share.
const FRAME_LOSS: usize = 32;

/// Is half of the first bytes where a run of eight was seen before?
fn repeats(bytes: &[u8]) -> bool {
    let mut seen = [0_u16; 256];
    let (mut hits, mut looked) = (0, 0);
    let eight = |at: usize| bytes[at..at + 8].iter().fold(0, |word, byte| word << 8 | u64::from(*byte));
    for at in 1..bytes.len().min(PROBE_BYTES).saturating_sub(7) {
        let word = eight(at);
        let place = &mut seen[(word.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 56) as usize];
        hits += usize::from(eight(usize::from(*place)) == word);
        looked += 1;
        *place = at as u16;
    }
    2 * hits > looked
}

/// How the bytes of a stream are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Packing {
    Plain,
    Frame,
    Symbols,
}

impl Packing {
    const ALL: [Self; 3] = [Self::Plain, Self::Frame, Self::Symbols];
}

const PLACE: &str = "stream of symbols";

/// Writes streams.
pub(super) struct StreamWriter {
    zstd: CCtx<'static>,
    frame: Vec<u8>,
    pub(super) coder: SymbolWriter,
    /// Symbols of one block, for the use of callers.
    pub(super) symbols: Vec<u8>,
    /// Their open bits, for the use of callers.
    pub(super) tails: Vec<u8>,
    /// How many zeros were written last, and their stream.
    zeros: (usize, Vec<u8>),
}

/// Reads streams.
pub(super) struct StreamReader {
    zstd: DCtx<'static>,
    frame: Vec<u8>,
    pub(super) coder: SymbolReader,
    /// Symbols of one block, for the use of callers.
    pub(super) symbols: Vec<u8>,
    /// Packed bits with room behind them, for the use of callers.
    pub(super) bits: Vec<u8>,
}

impl StreamWriter {
    /// Appends at most 4,096 `bytes` to `out`.
    pub(super) fn put(&mut self, bytes: &[u8], out: &mut Vec<u8>) {
        let len = bytes.len();
        if len >= MIN_BYTES {
            let coded = self.coder.count(bytes);
            let many_bits = 8 * coded > FRAME_BITS * len;
            let repeats = repeats(bytes);
            if (many_bits || repeats)
                && let Some(frame) = self.compress(bytes, repeats)
                && frame < len.min(if many_bits { coded + coded / FRAME_LOSS } else { coded })
            {
                return put_packed(Packing::Frame, &self.frame[MAGIC.len()..], out);
            }
            if coded < len {
                self.frame.clear();
                self.coder.put(bytes, &mut self.frame);
                // What was estimated may be a little more.
                if self.frame.len() < len {
                    return put_packed(Packing::Symbols, &self.frame, out);
                }
            }
        }
        put_packed(Packing::Plain, bytes, out);
    }

    /// Appends so many zeros, at most [`BLOCK_POINTS`].
    pub(super) fn put_zeros(&mut self, count: usize, out: &mut Vec<u8>) {
        static ZEROS: [u8; BLOCK_POINTS] = [0; BLOCK_POINTS];
        // Most blocks have one length, and what is steady within a pass is zeros.
        if self.zeros.0 != count {
            let mut stream = std::mem::take(&mut self.zeros.1);
            stream.clear();
            self.put(&ZEROS[..count], &mut stream);
            self.zeros = (count, stream);
        }
        out.extend_from_slice(&self.zeros.1);
    }

    /// Makes a frame, for bytes without repetitions one of single bytes, and gives its length without the magic number; none
    /// if zstd fails.
    fn compress(&mut self, bytes: &[u8], repeats: bool) -> Option<usize> {
        self.frame.clear();
        self.frame.reserve(compress_bound(bytes.len()));
        self.zstd.set_parameter(CParameter::TargetLength(if repeats { 0 } else { NO_MATCHES })).ok()?;
        self.zstd.compress2(&mut self.frame, bytes).ok()?;
        self.frame.strip_prefix(&MAGIC).map(<[u8]>::len)
    }
}

fn put_packed(packing: Packing, bytes: &[u8], out: &mut Vec<u8>) {
    put_varint((bytes.len() as u64) << 2 | packing as u64, out);
    out.extend_from_slice(bytes);
}

impl StreamReader {
    /// Reads a stream of exactly `length` bytes into `out`, whose content is replaced.
    pub(super) fn read(&mut self, reader: &mut Reader, length: usize, out: &mut Vec<u8>) -> Result<(), CodecError> {
        let head = reader.varint(PLACE)?;
        let stored = usize::try_from(head >> 2).unwrap_or(usize::MAX);
        let bytes = reader.take(stored, PLACE)?;
        let limit = Packing::ALL.len() as u64 - 1;
        let error = CodecError::Range { place: "packing of a stream", found: head & 3, limit };
        out.clear();
        match *Packing::ALL.get((head & 3) as usize).ok_or(error)? {
            Packing::Plain => out.extend_from_slice(bytes),
            Packing::Symbols => self.coder.read(bytes, length, out)?,
            Packing::Frame => {
                self.frame.clear();
                self.frame.extend_from_slice(&MAGIC);
                self.frame.extend_from_slice(bytes);
                out.reserve(length);
                // zstd may write to the whole capacity; more than `length` is an error below.
                self.zstd
                    .decompress(out, &self.frame)
                    .map_err(|code| CodecError::Zstd { place: PLACE, message: get_error_name(code) })?;
            }
        }
        if out.len() != length {
            return Err(CodecError::Length { place: PLACE, expected: length, found: out.len() });
        }
        Ok(())
    }
}

impl Default for StreamWriter {
    fn default() -> Self {
        let mut zstd = CCtx::create();
        // Both are known to every version. Were they not, frames would be larger and that is all.
        let _ = zstd.set_parameter(CParameter::CompressionLevel(LEVEL));
        let _ = zstd.set_parameter(CParameter::LiteralCompressionMode(ParamSwitch::Enable));
        Self {
            zstd,
            frame: Vec::new(),
            coder: SymbolWriter::default(),
            symbols: Vec::new(),
            tails: Vec::new(),
            zeros: (0, Vec::new()),
        }
    }
}

impl Default for StreamReader {
    fn default() -> Self {
        Self {
            zstd: DCtx::create(),
            frame: Vec::new(),
            coder: SymbolReader::default(),
            symbols: Vec::new(),
            bits: Vec::new(),
        }
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

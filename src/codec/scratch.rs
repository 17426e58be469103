//! What encoding and decoding keep from one chunk to the next: zstd's contexts and buffers of a block's size.

use super::BlockSize;
use super::joint::{Choice, MAX_LEADERS};
use super::leaders::KeptLeaders;
use super::lines::{LineBuffers, LineScratch, Place};
use super::ranked::RankBuffers;
use super::steady::SteadyBuffers;
use super::stream::{StreamReader, StreamWriter};

/// Encodes chunks, one at a time; keep one per thread.
#[derive(Debug, Default)]
pub struct Encoder {
    pub(super) streams: StreamWriter,
    pub(super) buffers: Buffers,
    /// How chunks are cut.
    pub(super) size: BlockSize,
    /// All blocks of a chunk, before their directory is known.
    pub(super) blocks: Vec<u8>,
    /// The blocks' ends in `blocks`.
    pub(super) ends: Vec<usize>,
    /// The values of columns that a column follows.
    pub(super) leaders: [Vec<u16>; MAX_LEADERS],
}

/// The values of one block on their way into bytes.
#[derive(Debug, Default)]
pub(super) struct Buffers {
    /// The values as integers.
    pub(super) values: Vec<u64>,
    /// Differences of keys.
    pub(super) residuals: Vec<u64>,
    /// The values, where all fit, or indices of values.
    pub(super) bytes: Vec<u8>,
    /// For ranks.
    pub(super) rank: RankBuffers,
    /// For lines.
    pub(super) lines: LineBuffers,
    /// For what is steady within a pass.
    pub(super) steady: SteadyBuffers,
    /// The other bytes of a block, if two ways are tried.
    pub(super) other: Vec<u8>,
    /// Symbols.
    pub(super) packed: Vec<u8>,
    /// How the chunk's blocks follow other columns, once it is known.
    pub(super) joint: Option<Choice>,
}

/// Decodes chunks, one at a time; keep one per thread.
#[derive(Debug, Default)]
pub struct Decoder {
    pub(super) streams: StreamReader,
    /// Numbers that are bytes, or indices of values.
    pub(super) bytes: Vec<u8>,
    /// Numbers that are not.
    pub(super) wide: Vec<u64>,
    /// The values of one block as integers.
    pub(super) values: Vec<u64>,
    /// All different values.
    pub(super) table: Vec<u64>,
    /// Where the points are.
    pub(super) places: Vec<Place>,
    /// The pass of each point.
    pub(super) passes: Vec<u8>,
    /// What `passes` are a function of: the bytes of a block, and how many passes there are; 0 if they are none of a block.
    pub(super) passes_of: (Vec<u8>, usize),
    /// For lines.
    pub(super) lines: LineScratch,
    /// Columns that others follow.
    pub(super) leaders: KeptLeaders,
    /// The keys of the last block of positions that was decoded.
    pub(super) keys: KeptKeys,
}

/// The keys of a block of positions and what they are a function of, since times need places again.
#[derive(Debug, Default)]
pub(super) struct KeptKeys {
    /// The bytes of the block.
    pub(super) of: Vec<u8>,
    /// The bits that a key may have.
    pub(super) bits: u32,
    /// Relative to the cube's first key; none if the block is damaged.
    pub(super) keys: Vec<u64>,
}

impl Encoder {
    /// Fresh contexts; chunks are cut into blocks of the largest size.
    pub fn new() -> Self {
        Self::default()
    }

    /// Cuts the chunks from now on into blocks of this size: those of one part must be cut alike.
    pub fn cut_into(&mut self, size: BlockSize) {
        self.size = size;
    }
}

impl Decoder {
    /// Fresh contexts.
    pub fn new() -> Self {
        Self::default()
    }
}

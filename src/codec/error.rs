//! What can be wrong with a chunk.

use thiserror::Error;

/// Why bytes are not the chunk that they should be, or columns cannot become one.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum CodecError {
    /// The bytes end too early.
    #[error("{place}: {needed} bytes needed, {found} there")]
    Truncated {
        /// Which piece of the chunk.
        place: &'static str,
        /// Bytes that it needs.
        needed: usize,
        /// Bytes that are left.
        found: usize,
    },
    /// A first byte that this version does not know, or of another kind of chunk.
    #[error("chunk of codec {expected} expected, found {found}; a newer version may have written it")]
    Codec {
        /// The codec asked for.
        expected: u8,
        /// The chunk's first byte.
        found: u8,
    },
    /// The chunk has another number of points than its node says.
    #[error("{expected} points expected, found {found}")]
    Count {
        /// Points of the part.
        expected: usize,
        /// Points that the chunk announces.
        found: u64,
    },
    /// More points than a part may have.
    #[error("{count} points in one part; the limit is {limit}", limit = super::MAX_POINTS)]
    TooManyPoints {
        /// Points asked for.
        count: usize,
    },
    /// A chunk of values of another type, or a column of another type to decode into.
    #[error("values of {expected} expected, found {found}")]
    Type {
        /// The type asked for.
        expected: &'static str,
        /// The type there.
        found: &'static str,
    },
    /// There is no such block.
    #[error("block {block} asked for, the chunk has {blocks}")]
    Block {
        /// Which.
        block: usize,
        /// How many there are.
        blocks: usize,
    },
    /// Values that follow from positions, which were not given.
    #[error("the positions are needed to decode these values")]
    NoPositions,
    /// Values that follow those of another column, which was not given.
    #[error("the column that these values follow is needed to decode them")]
    NoLeader,
    /// A number that is out of its range.
    #[error("{place}: {found} is beyond {limit}")]
    Range {
        /// Which number.
        place: &'static str,
        /// What it is.
        found: u64,
        /// The most that it may be.
        limit: u64,
    },
    /// A piece has another length than its count says.
    #[error("{place}: {expected} bytes expected, found {found}")]
    Length {
        /// Which piece.
        place: &'static str,
        /// What it must be.
        expected: usize,
        /// What it is.
        found: usize,
    },
    /// zstd refuses a stream.
    #[error("{place}: zstd: {message}")]
    Zstd {
        /// Which stream.
        place: &'static str,
        /// zstd's word.
        message: &'static str,
    },
    /// Keys to encode that are not ascending or not in the cube, or decoded keys that leave it.
    #[error("key {index} is not in order or not in the cube")]
    Key {
        /// Which, counted from the block's first.
        index: usize,
    },
    /// Bytes that are not those that were written.
    #[error("checksum {expected:016x} expected, found {found:016x}")]
    Checksum {
        /// As recorded.
        expected: u64,
        /// As computed.
        found: u64,
    },
}

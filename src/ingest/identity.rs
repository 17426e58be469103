//! Who a scan is: its source's bytes, its place in the file, its pose, how it was read.

use crate::formats::FormatError;
use blake3::Hasher;
use blake3::hazmat::{ChainingValue, HasherExt, Mode, merge_subtrees_non_root, merge_subtrees_root};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// BLAKE3 of a file's bytes. `cancelled` is asked now and then; true gives `None`.
pub(super) fn content_hash(path: &Path, cancelled: &dyn Fn() -> bool) -> Result<Option<[u8; 32]>, FormatError> {
    let io = |action| move |source| FormatError::Io { path: path.to_owned(), action, source };
    let mut file = File::open(path).map_err(io("opening"))?;
    let mut hasher = blake3::Hasher::new();
    let mut buffer = vec![0; 1 << 20];
    loop {
        if cancelled() {
            return Ok(None);
        }
        match file.read(&mut buffer).map_err(io("reading"))? {
            0 => return Ok(Some(*hasher.finalize().as_bytes())),
            n => hasher.update(&buffer[..n]),
        };
    }
}

/// Bytes of a block of [`PieceHash`]: a power of two, and enough for the hash to work on many of its own chunks at once.
const BLOCK: usize = 64 << 10;

/// BLAKE3 of a file from pieces of it that are read anyway, in any order and on any thread: blocks of the file become
/// nodes of the hash's tree, and what no piece held whole is read again at the end.
pub(super) struct PieceHash {
    bytes: u64,
    blocks: Mutex<Vec<Option<ChainingValue>>>,
}

/// The blocks that lie in one piece.
pub(super) struct PieceBlocks<'a> {
    of: &'a PieceHash,
    /// Where in the file the next bytes are.
    offset: u64,
    /// The block that was begun.
    open: Option<Hasher>,
    done: Vec<(usize, ChainingValue)>,
}

impl PieceHash {
    /// For a file of this size.
    pub fn new(bytes: u64) -> Self {
        let blocks = usize::try_from(bytes.div_ceil(BLOCK as u64)).unwrap_or(0);
        Self { bytes, blocks: Mutex::new(vec![None; blocks]) }
    }

    /// For the bytes from `offset` on.
    pub fn piece(&self, offset: u64) -> PieceBlocks<'_> {
        PieceBlocks { of: self, offset, open: None, done: Vec::new() }
    }

    /// The hash of the file at `path`, whose pieces have been read. `cancelled` as for [`content_hash`].
    pub fn finish(self, path: &Path, cancelled: &dyn Fn() -> bool) -> Result<Option<[u8; 32]>, FormatError> {
        let io = |action| move |source| FormatError::Io { path: path.to_owned(), action, source };
        let blocks = self.blocks.into_inner().unwrap_or_else(PoisonError::into_inner);
        let mut file = File::open(path).map_err(io("opening"))?;
        if blocks.len() < 2 || file.metadata().map_err(io("reading the size of"))?.len() != self.bytes {
            return content_hash(path, cancelled);
        }
        let mut buffer = vec![0; BLOCK];
        let mut values = Vec::with_capacity(blocks.len());
        for (number, block) in blocks.into_iter().enumerate() {
            let value = match block {
                Some(value) => value,
                None => {
                    let start = (number * BLOCK) as u64;
                    let bytes = &mut buffer[..(self.bytes - start).min(BLOCK as u64) as usize];
                    file.seek(SeekFrom::Start(start)).map_err(io("reading"))?;
                    file.read_exact(bytes).map_err(io("reading"))?;
                    Hasher::new().set_input_offset(start).update(bytes).finalize_non_root()
                }
            };
            values.push(value);
        }
        let (left, right) = values.split_at(left_blocks(values.len()));
        Ok(Some(*merge_subtrees_root(&subtree(left), &subtree(right), Mode::Hash).as_bytes()))
    }
}

/// Of more than one block, how many are in the left half of the tree: the largest power of two that leaves some.
fn left_blocks(blocks: usize) -> usize {
    blocks.next_power_of_two() / 2
}

fn subtree(blocks: &[ChainingValue]) -> ChainingValue {
    match blocks {
        [only] => *only,
        blocks => {
            let (left, right) = blocks.split_at(left_blocks(blocks.len()));
            merge_subtrees_non_root(&subtree(left), &subtree(right), Mode::Hash)
        }
    }
}

impl PieceBlocks<'_> {
    /// Takes the bytes that follow.
    pub fn update(&mut self, mut bytes: &[u8]) {
        while !bytes.is_empty() {
            let inside = (self.offset % BLOCK as u64) as usize;
            let (now, rest) = bytes.split_at(bytes.len().min(BLOCK - inside));
            if inside == 0 {
                let mut hasher = Hasher::new();
                hasher.set_input_offset(self.offset);
                self.open = Some(hasher);
            }
            // A block that begins before the piece is nobody's.
            if let Some(hasher) = &mut self.open {
                hasher.update(now);
                if inside + now.len() == BLOCK {
                    self.done.push(((self.offset / BLOCK as u64) as usize, hasher.finalize_non_root()));
                    self.open = None;
                }
            }
            self.offset += now.len() as u64;
            bytes = rest;
        }
    }
}

impl Drop for PieceBlocks<'_> {
    fn drop(&mut self) {
        let mut blocks = self.of.blocks.lock().unwrap_or_else(PoisonError::into_inner);
        for (number, value) in self.done.drain(..) {
            if let Some(block) = blocks.get_mut(number) {
                *block = Some(value);
            }
        }
    }
}

/// The identity of one scan: content, index in the file, pose, reader options.
pub(super) fn scan_identity(content: &[u8; 32], index: u32, pose: &[f64; 16], options: &str) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"esker scan 1");
    hasher.update(content);
    hasher.update(&index.to_le_bytes());
    for value in pose {
        hasher.update(&value.to_bits().to_le_bytes());
    }
    hasher.update(options.as_bytes());
    *hasher.finalize().as_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn pieces_in_any_order_give_the_hash_of_the_file(
            blocks in 0_usize..9,
            rest in prop_oneof![Just(0), Just(1), 0..BLOCK],
            cuts in prop::collection::vec((any::<prop::sample::Index>(), any::<prop::sample::Index>(), 1_usize..200_000), 0..6),
            longer: bool,
        ) {
            let content: Vec<u8> = (0..blocks * BLOCK + rest).map(|i| ((i * i) >> 7) as u8).collect();
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("f");
            std::fs::write(&path, &content).unwrap();
            // A file that has changed its size is read again.
            let hash = PieceHash::new(content.len() as u64 + u64::from(longer));
            for (from, to, run) in cuts.iter().filter(|_| !content.is_empty()) {
                let (a, b) = (from.index(content.len()), to.index(content.len()));
                let mut piece = hash.piece(a.min(b) as u64);
                content[a.min(b)..a.max(b)].chunks(*run).for_each(|bytes| piece.update(bytes));
            }
            prop_assert_eq!(hash.finish(&path, &|| false).unwrap(), Some(*blake3::hash(&content).as_bytes()));
        }
    }

    #[test]
    fn everything_that_changes_a_scan_changes_its_identity() {
        let pose = Pose::IDENTITY.to_matrix();
        let moved = Pose::from_quaternion([1e-9, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]).unwrap().to_matrix();
        let all = [
            scan_identity(&[0; 32], 0, &pose, ""),
            scan_identity(&[1; 32], 0, &pose, ""),
            scan_identity(&[0; 32], 1, &pose, ""),
            scan_identity(&[0; 32], 0, &moved, ""),
            scan_identity(&[0; 32], 0, &pose, "columns x,y,z"),
        ];
        let different: std::collections::HashSet<_> = all.iter().collect();
        assert_eq!(different.len(), all.len());
    }
}

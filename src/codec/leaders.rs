//! Blocks of columns that others follow, kept while the columns of a part are decoded one after the other.

/// How many are kept: two that one column follows, and one of another group.
const KEPT: usize = 3;

/// A block.
#[derive(Debug, Default)]
pub(super) struct Kept {
    /// All that its values are a function of: its bytes, and those of the blocks that it follows.
    pub(super) key: Vec<u8>,
    pub(super) values: Vec<u16>,
}

/// The blocks that were used last.
#[derive(Debug, Default)]
pub(super) struct KeptLeaders {
    kept: Vec<Kept>,
    spare: Vec<Kept>,
}

impl KeptLeaders {
    /// An empty one, with room if there is some.
    pub(super) fn fresh(&mut self) -> Kept {
        let mut fresh = self.spare.pop().unwrap_or_default();
        fresh.key.clear();
        fresh.values.clear();
        fresh
    }

    /// Takes the block of this key out, if it is kept.
    pub(super) fn take(&mut self, key: &[u8]) -> Option<Kept> {
        let at = self.kept.iter().position(|kept| kept.key == key)?;
        Some(self.kept.remove(at))
    }

    /// Keeps a block, in the place of the one that was used longest ago.
    pub(super) fn put(&mut self, kept: Kept) {
        self.kept.push(kept);
        if self.kept.len() > KEPT {
            let oldest = self.kept.remove(0);
            self.put_spare(oldest);
        }
    }

    /// Gives the room of a block back.
    pub(super) fn put_spare(&mut self, spare: Kept) {
        if self.spare.len() < KEPT {
            self.spare.push(spare);
        }
    }
}

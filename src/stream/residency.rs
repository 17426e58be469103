//! Which parts lie in which blocks of the pool, and which of them must stay.
//!
//! A part is uploaded once and stays until its room is needed: parts that a held draw list shows, and those that are
//! wanted, are never given up; of the others the one that was of use least lately goes first. Blocks are all alike, so the
//! pool never fragments.

use super::gpu::{BlockId, DrawList, PointPool, PoolError};
use super::source::Loaded;
use super::spacing::Densities;
use crate::query::PartId;
use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

/// A part with the values of one paint.
pub(super) type Key = (PartId, u64);

/// A part on the adapter.
#[derive(Clone, Debug)]
pub(super) struct Resident {
    /// Filled one after the other.
    pub blocks: Vec<BlockId>,
    /// Points of all blocks.
    pub points: u32,
    /// How close they lie.
    pub densities: Arc<Densities>,
    used: u64,
    /// Some of its blocks will be taken away: it is drawn while it is there, but must be loaded again.
    leaving: bool,
}

/// The pool and what is in it.
pub(super) struct Residency {
    pool: Box<dyn PointPool>,
    block_points: u32,
    /// Blocks from here on are not used any more.
    limit: u32,
    free: BTreeSet<u32>,
    parts: HashMap<Key, Resident>,
    /// By block: how many held lists show it.
    pins: Vec<u32>,
    /// Blocks that belong to no part any more but are still shown.
    orphans: BTreeSet<u32>,
    held: Vec<Arc<DrawList>>,
    clock: u64,
    /// Bytes uploaded so far.
    pub uploaded_bytes: u64,
}

impl Residency {
    pub fn new(pool: Box<dyn PointPool>) -> Self {
        let blocks = pool.blocks();
        Self {
            block_points: pool.block_points().max(1),
            limit: blocks,
            free: (0..blocks).collect(),
            parts: HashMap::new(),
            pins: vec![0; blocks as usize],
            orphans: BTreeSet::new(),
            held: Vec::new(),
            clock: 0,
            uploaded_bytes: 0,
            pool,
        }
    }

    pub fn block_points(&self) -> u32 {
        self.block_points
    }

    /// The most bytes of points on the adapter.
    pub fn budget_bytes(&self) -> u64 {
        self.pool.budget_bytes()
    }

    /// Blocks that hold points, whether anybody wants them or not.
    pub fn used_blocks(&self) -> u32 {
        (self.pins.len() - self.free.len()) as u32
    }

    /// Where a part lies, if it is there.
    pub fn get(&self, key: &Key) -> Option<&Resident> {
        self.parts.get(key)
    }

    /// Need the part not be loaded?
    pub fn is_settled(&self, key: &Key) -> bool {
        self.parts.get(key).is_some_and(|r| !r.leaving)
    }

    /// These are of use now.
    pub fn touch<'k>(&mut self, keys: impl Iterator<Item = &'k Key>) {
        self.clock += 1;
        for key in keys {
            if let Some(resident) = self.parts.get_mut(key) {
                resident.used = self.clock;
            }
        }
    }

    /// Uploads a part; `Ok(false)`: there is no room until others let go of theirs. Room is made by giving up parts that
    /// `keep` does not name.
    ///
    /// # Errors
    ///
    /// As [`PointPool::write`]; the part is not there then.
    pub fn insert(&mut self, key: Key, loaded: &Loaded, keep: impl Fn(&Key) -> bool) -> Result<bool, PoolError> {
        let points = loaded.points.as_slice();
        if self.is_settled(&key) {
            return Ok(true);
        }
        let needed = points.len().div_ceil(self.block_points as usize);
        if !self.make_room(needed, keep) {
            return Ok(false);
        }
        let mut blocks = Vec::with_capacity(needed);
        for run in points.chunks(self.block_points as usize) {
            let Some(block) = self.free.pop_first() else { break };
            blocks.push(BlockId(block));
            if let Err(error) = self.pool.write(BlockId(block), run) {
                self.free.extend(blocks.iter().map(|b| b.0));
                return Err(error);
            }
            self.uploaded_bytes += size_of_val(run) as u64;
        }
        // What was leaving is replaced.
        self.remove(&key);
        let points = points.len() as u32;
        let densities = loaded.densities.clone();
        self.parts.insert(key, Resident { blocks, points, densities, used: self.clock, leaving: false });
        Ok(true)
    }

    /// Makes that many blocks free, or does nothing.
    fn make_room(&mut self, needed: usize, keep: impl Fn(&Key) -> bool) -> bool {
        let mut missing = needed.saturating_sub(self.free.len());
        if missing == 0 {
            return true;
        }
        let shown = |r: &Resident| r.blocks.iter().any(|b| self.pins[b.0 as usize] > 0);
        let mut idle: Vec<(u64, Key, usize)> = self
            .parts
            .iter()
            .filter(|(key, r)| !r.blocks.is_empty() && !shown(r) && !keep(key))
            .map(|(key, r)| (r.used, *key, r.blocks.iter().filter(|b| b.0 < self.limit).count()))
            .collect();
        idle.sort_unstable();
        let mut going = Vec::new();
        for (_, key, blocks) in idle {
            if missing == 0 {
                break;
            }
            missing = missing.saturating_sub(blocks);
            going.push(key);
        }
        if missing > 0 {
            return false;
        }
        going.iter().for_each(|key| self.remove(key));
        true
    }

    /// The part is to be loaded again.
    pub fn forget(&mut self, key: &Key) {
        self.remove(key);
    }

    fn remove(&mut self, key: &Key) {
        for block in self.parts.remove(key).into_iter().flat_map(|r| r.blocks) {
            if self.pins[block.0 as usize] > 0 {
                self.orphans.insert(block.0);
            } else {
                self.release(block.0);
            }
        }
    }

    fn release(&mut self, block: u32) {
        if block < self.limit {
            self.free.insert(block);
        }
    }

    /// From now on the list may be drawn: its blocks stay until nobody else has it.
    pub fn hold(&mut self, list: Arc<DrawList>) {
        for block in &list.blocks {
            self.pins[block.block.0 as usize] += 1;
        }
        self.held.push(list);
    }

    /// Lets go of the lists that nobody else has; says whether there were any.
    pub fn let_go(&mut self) -> bool {
        let (held, gone): (Vec<_>, Vec<_>) = self.held.drain(..).partition(|list| Arc::strong_count(list) > 1);
        self.held = held;
        for list in &gone {
            for block in &list.blocks {
                let pins = &mut self.pins[block.block.0 as usize];
                *pins -= 1;
                if *pins == 0 && self.orphans.remove(&block.block.0) {
                    self.release(block.block.0);
                }
            }
        }
        if !gone.is_empty() {
            self.finish_shrinking();
        }
        !gone.is_empty()
    }

    /// Uses that many blocks from now on. More are there at once; fewer when nothing that is shown needs them any more.
    ///
    /// # Errors
    ///
    /// As [`PointPool::resize`].
    pub fn set_limit(&mut self, blocks: u32) -> Result<(), PoolError> {
        let before = self.pool.blocks();
        if blocks > before {
            self.pool.resize(blocks)?;
            self.pins.resize(blocks as usize, 0);
        }
        self.limit = blocks;
        let owned: BTreeSet<u32> = self.parts.values().flat_map(|r| r.blocks.iter().map(|b| b.0)).collect();
        self.free = (0..blocks).filter(|b| !owned.contains(b) && !self.orphans.contains(b)).collect();
        for resident in self.parts.values_mut() {
            resident.leaving = resident.blocks.iter().any(|b| b.0 >= blocks);
        }
        self.finish_shrinking();
        Ok(())
    }

    /// Gives blocks beyond the limit back once nothing is left in them that is shown.
    fn finish_shrinking(&mut self) {
        if self.pool.blocks() <= self.limit {
            return;
        }
        let shown = |r: &Resident| r.blocks.iter().any(|b| self.pins[b.0 as usize] > 0);
        let idle: Vec<Key> = self.parts.iter().filter(|(_, r)| r.leaving && !shown(r)).map(|(k, _)| *k).collect();
        idle.iter().for_each(|key| self.remove(key));
        // A part of which a list shows only blocks below the limit still has the others.
        let leaving = self.parts.values().any(|r| r.leaving);
        let beyond = self.pins[self.limit as usize..].iter().any(|&pins| pins > 0);
        if !leaving && !beyond && self.pool.resize(self.limit).is_ok() {
            self.pins.truncate(self.limit as usize);
        }
    }

    /// What must always hold, for tests.
    #[cfg(test)]
    pub fn check(&self) {
        let owned: Vec<u32> = self.parts.values().flat_map(|r| r.blocks.iter().map(|b| b.0)).collect();
        let unique: BTreeSet<u32> = owned.iter().copied().collect();
        assert_eq!(owned.len(), unique.len(), "a block belongs to two parts");
        assert!(unique.is_disjoint(&self.free), "a block is free and in use");
        assert!(unique.is_disjoint(&self.orphans) && self.free.is_disjoint(&self.orphans));
        assert!(self.free.iter().all(|&b| b < self.limit && self.pins[b as usize] == 0), "a free block is shown");
        assert!(self.orphans.iter().all(|&b| self.pins[b as usize] > 0));
        let below = unique.union(&self.orphans).filter(|&&b| b < self.limit).count() + self.free.len();
        assert_eq!(below, self.limit as usize, "a block is lost");
        assert!(self.pool.blocks() >= self.limit && self.pins.len() == self.pool.blocks() as usize);
    }
}

#[cfg(test)]
mod tests {
    use super::super::gpu::{DrawBlock, MemoryPool, PackedPoint};
    use super::*;
    use crate::lattice::Lattice;
    use proptest::prelude::*;

    fn list(residency: &Residency, keys: &[Key]) -> Arc<DrawList> {
        let mut list = DrawList::empty(Lattice::uniform(1.0).unwrap(), 0);
        for (i, resident) in keys.iter().filter_map(|k| residency.get(k)).enumerate() {
            // Of some parts only the first block is shown, as of one that a budget cuts off.
            let shown = if i % 2 == 0 { resident.blocks.len() } else { 1.min(resident.blocks.len()) };
            let block = |&block: &BlockId| DrawBlock { block, points: 1, node: 0, part: 0, first: 0 };
            list.blocks.extend(resident.blocks[..shown].iter().map(block));
        }
        Arc::new(list)
    }

    fn of(points: &[PackedPoint]) -> Loaded {
        Loaded { points: points.to_vec(), ..Loaded::default() }
    }

    fn key(number: u32) -> Key {
        (PartId::for_test(number), 0)
    }

    #[derive(Clone, Debug)]
    enum Step {
        Insert(u32, usize),
        Show(Vec<u32>),
        Forget(usize),
        Limit(u32),
    }

    fn step() -> impl Strategy<Value = Step> {
        prop_oneof![
            6 => (0_u32..12, 0_usize..9).prop_map(|(k, n)| Step::Insert(k, n)),
            3 => prop::collection::vec(0_u32..12, 0..5).prop_map(Step::Show),
            3 => (0_usize..4).prop_map(Step::Forget),
            1 => (1_u32..14).prop_map(Step::Limit),
        ]
    }

    proptest! {
        /// Whatever comes: what a list shows is what was uploaded for it, as long as anybody has the list.
        #[test]
        fn shown_blocks_keep_their_points(steps in prop::collection::vec(step(), 1..60)) {
            let pool = MemoryPool::new(8, 2);
            let content = pool.content();
            let mut residency = Residency::new(Box::new(pool));
            let mut shown: Vec<(Arc<DrawList>, Vec<Vec<PackedPoint>>)> = Vec::new();
            for (number, step) in (0_u32..).zip(steps) {
                match step {
                    Step::Insert(k, n) => {
                        let point = PackedPoint { steps: [number, k, 0], value: n as u32 };
                        let there = residency.is_settled(&key(k));
                        let before = residency.uploaded_bytes;
                        let done = residency.insert(key(k), &of(&vec![point; n]), |other| other.0 == PartId::for_test(1)).unwrap();
                        prop_assert!(!there || done && residency.uploaded_bytes == before, "uploaded twice");
                        prop_assert!(!done || residency.is_settled(&key(k)));
                    }
                    Step::Show(keys) => {
                        let keys: Vec<Key> = keys.into_iter().map(key).collect();
                        let list = list(&residency, &keys);
                        let content = content.lock().unwrap();
                        let points = list.blocks.iter().map(|b| content.blocks[b.block.0 as usize].clone()).collect();
                        residency.hold(list.clone());
                        residency.touch(keys.iter());
                        shown.push((list, points));
                    }
                    Step::Forget(i) => {
                        if i < shown.len() {
                            shown.remove(i);
                        }
                        residency.let_go();
                    }
                    Step::Limit(blocks) => residency.set_limit(blocks).unwrap(),
                }
                residency.check();
                let content = content.lock().unwrap();
                for (list, points) in &shown {
                    for (block, points) in list.blocks.iter().zip(points) {
                        prop_assert_eq!(&content.blocks[block.block.0 as usize], points);
                    }
                }
            }
            shown.clear();
            residency.let_go();
            residency.check();
            prop_assert_eq!(residency.pool.blocks(), residency.limit, "blocks beyond the limit stay");
        }
    }

    #[test]
    fn the_least_lately_used_goes_first() {
        let mut residency = Residency::new(Box::new(MemoryPool::new(3, 1)));
        let point = [PackedPoint { steps: [0; 3], value: 0 }];
        for k in 0..3 {
            residency.touch([key(k)].iter());
            assert!(residency.insert(key(k), &of(&point), |_| false).unwrap());
        }
        residency.touch([key(0)].iter());
        assert!(residency.insert(key(3), &of(&point), |k| *k == key(1)).unwrap());
        let there: Vec<bool> = (0..4).map(|k| residency.is_settled(&key(k))).collect();
        assert_eq!(there, [true, true, false, true]);
        assert!(!residency.insert(key(4), &of(&[point[0]; 2]), |k| *k != key(0)).unwrap(), "one block is not two");
        assert!(residency.is_settled(&key(0)), "nothing is given up in vain");
    }
}

//! Encoded nodes on their way to the writer: as many as fit so many bytes.
//!
//! The writer stands still while the disk takes what it has written. A queue that is deep enough lets nodes be built
//! meanwhile, and its size in bytes is what the memory budget knows.

use crate::store::EncodedNode;
use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// A queue from many threads to one.
#[derive(Debug)]
pub(super) struct Queue {
    most_bytes: usize,
    state: Mutex<State>,
    /// Something came, or nothing more will come.
    came: Condvar,
    /// Something went, or nothing more will be taken.
    went: Condvar,
}

#[derive(Debug, Default)]
struct State {
    nodes: VecDeque<EncodedNode>,
    bytes: usize,
    /// Nothing more will come.
    ended: bool,
    /// Nothing more will be taken.
    left: bool,
}

fn bytes(node: &EncodedNode) -> usize {
    node.chunks.iter().map(|c| c.bytes.len()).sum()
}

impl Queue {
    /// For nodes of so many bytes; one that is larger goes alone.
    pub fn new(most_bytes: usize) -> Self {
        Self { most_bytes, state: Mutex::default(), came: Condvar::new(), went: Condvar::new() }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // The state is whole after every statement.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for room. False if nobody takes nodes any more.
    pub fn push(&self, node: EncodedNode) -> bool {
        let more = bytes(&node);
        let full = |s: &mut State| !s.left && !s.nodes.is_empty() && s.bytes + more > self.most_bytes;
        let mut state = self.went.wait_while(self.lock(), full).unwrap_or_else(PoisonError::into_inner);
        if state.left {
            return false;
        }
        state.bytes += more;
        state.nodes.push_back(node);
        self.came.notify_one();
        true
    }

    /// Waits for a node; `None` when all have been taken and no more will come.
    pub fn pop(&self) -> Option<EncodedNode> {
        let empty = |s: &mut State| !s.ended && s.nodes.is_empty();
        let mut state = self.came.wait_while(self.lock(), empty).unwrap_or_else(PoisonError::into_inner);
        let node = state.nodes.pop_front()?;
        state.bytes -= bytes(&node);
        self.went.notify_all();
        Some(node)
    }

    /// No more will come once this is dropped.
    pub fn ends(&self) -> Ends<'_> {
        Ends(self)
    }

    /// No more will be taken once this is dropped: whoever waits for room is told.
    pub fn leaves(&self) -> Leaves<'_> {
        Leaves(self)
    }
}

/// See [`Queue::ends`]. Dropped also where a panic unwinds, so that nobody waits for ever.
pub(super) struct Ends<'a>(&'a Queue);

impl Drop for Ends<'_> {
    fn drop(&mut self) {
        self.0.lock().ended = true;
        self.0.came.notify_all();
    }
}

/// See [`Queue::leaves`].
pub(super) struct Leaves<'a>(&'a Queue);

impl Drop for Leaves<'_> {
    fn drop(&mut self) {
        self.0.lock().left = true;
        self.0.went.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::{BlockSize, Blocks};
    use crate::lattice::{Cube, LatticePoint};
    use crate::store::ChunkRow;
    use crate::store::model::{NodeHead, Zones};
    use std::sync::Arc;
    use std::sync::mpsc::{RecvTimeoutError, channel};
    use std::time::Duration;

    fn node(id: i64, bytes: usize) -> EncodedNode {
        let cube = Cube::containing(LatticePoint::default(), 9);
        let row = ChunkRow::new(id, (0, cube), 0, 0, Blocks::new(1, BlockSize::LARGEST), vec![0; bytes]);
        EncodedNode { head: NodeHead::without_points(0, cube), zones: Zones::default(), chunks: vec![row] }
    }

    /// So long a test waits for what should come at once: a queue that lets nobody go fails, and does not hang.
    const PATIENCE: Duration = Duration::from_secs(20);

    #[test]
    fn all_nodes_arrive_and_no_more_wait_than_fit() {
        let queue = Arc::new(Queue::new(100));
        let (sender, taken) = channel();
        let taker = queue.clone();
        std::thread::spawn(move || {
            // If it fails nobody takes any more, and those who wait for room fail, too.
            let _leaves = taker.leaves();
            while let Some(node) = taker.pop() {
                let state = taker.lock();
                assert!(state.bytes <= 100 || state.nodes.len() == 1, "{} bytes wait", state.bytes);
                drop(state);
                sender.send(node.chunks[0].id).unwrap();
            }
        });
        let senders: Vec<_> = (0..3)
            .map(|thread| {
                let queue = queue.clone();
                std::thread::spawn(move || {
                    for i in 0..200 {
                        let size = if i == 77 { 300 } else { 30 };
                        assert!(queue.push(node(thread * 1000 + i, size)));
                    }
                })
            })
            .collect();
        let ending = queue.clone();
        std::thread::spawn(move || {
            let _ends = ending.ends();
            senders.into_iter().for_each(|s| s.join().unwrap());
        });
        let mut all: Vec<i64> = (0..3).flat_map(|t| (0..200).map(move |i| t * 1000 + i)).collect();
        while !all.is_empty() {
            let id = taken.recv_timeout(PATIENCE).expect("a node does not arrive");
            let at = all.iter().position(|&i| i == id).expect("a node arrives twice");
            all.swap_remove(at);
        }
        assert_eq!(taken.recv_timeout(PATIENCE), Err(RecvTimeoutError::Disconnected), "the end is not told");
    }

    #[test]
    fn who_waits_for_room_is_told_that_nobody_takes() {
        let queue = Arc::new(Queue::new(10));
        assert!(queue.push(node(1, 10)));
        let (sender, told) = channel();
        let waiting = queue.clone();
        std::thread::spawn(move || sender.send(waiting.push(node(2, 1))));
        drop(queue.leaves());
        assert_eq!(told.recv_timeout(PATIENCE), Ok(false));
        assert!(!queue.push(node(3, 1)));
    }
}

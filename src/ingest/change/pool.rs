//! Buffers that go from job to job: fresh memory is dear.

use std::sync::{Mutex, PoisonError};

/// As many of a kind as there are threads that use one.
#[derive(Debug)]
pub(super) struct Pool<T>(Mutex<Vec<T>>);

impl<T> Default for Pool<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<T: Default> Pool<T> {
    /// Runs `work` with one that nobody else has meanwhile.
    pub fn lend<R>(&self, work: impl FnOnce(&mut T) -> R) -> R {
        let free = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut lent = free().pop().unwrap_or_default();
        let result = work(&mut lent);
        free().push(lent);
        result
    }
}

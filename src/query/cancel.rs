//! Ending a query from elsewhere.

use super::QueryError;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Ends the queries that were given it ([`Query::cancel`](super::Query::cancel)), from any thread: they give
/// [`QueryError::Cancelled`] within about the time that a part takes to decode. Clones are the same token.
///
/// ```
/// use esker::query::Cancel;
///
/// let cancel = Cancel::new();
/// let elsewhere = cancel.clone();
/// std::thread::spawn(move || elsewhere.cancel()).join().ok();
/// assert!(cancel.is_cancelled());
/// ```
#[derive(Clone, Debug, Default)]
pub struct Cancel(Arc<AtomicBool>);

impl Cancel {
    /// Nothing is ended yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Ends them, for good.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Have they been ended?
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    pub(crate) fn check(&self) -> Result<(), QueryError> {
        if self.is_cancelled() { Err(QueryError::Cancelled) } else { Ok(()) }
    }
}

/// Two tokens are equal if they are the same one.
impl PartialEq for Cancel {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

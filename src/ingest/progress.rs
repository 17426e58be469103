//! What an ingest tells while it runs.

/// A stretch of the work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Stage {
    /// Finding the extent of sources that do not say it.
    Measure,
    /// Reading records and sorting them into buckets.
    Read,
    /// Building and encoding nodes.
    Build,
    /// The commit.
    Commit,
}

impl Stage {
    /// The word for it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Measure => "measuring",
            Self::Read => "reading",
            Self::Build => "building",
            Self::Commit => "commit",
        }
    }
}

/// Who wants to know how far an ingest is, and may stop it. Called from several threads.
pub trait Progress: Sync {
    /// A stage of `total` points begins.
    fn stage(&self, _stage: Stage, _total: u64) {}
    /// So many more points of the stage are done.
    fn advance(&self, _points: u64) {}
    /// Something that the user should know at once.
    fn say(&self, _message: &str) {}
    /// Should the ingest stop? It then ends with [`super::IngestError::Interrupted`], the store as it was.
    fn cancelled(&self) -> bool {
        false
    }
}

/// Nobody.
impl Progress for () {}

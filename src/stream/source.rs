//! Where parts come from: a store, or what a test puts in its place.

use super::gpu::PackedPoint;
use super::settings::Shown;
use super::spacing::Densities;
use crate::geometry::Camera;
use crate::lattice::Lattice;
use crate::points::Batch;
use crate::query::{QueryError, Wanted, WantedPart};
use crate::store::{Snapshot, StoreError};
use std::pin::Pin;
use std::sync::Arc;
use thiserror::Error;

/// Something that will be there later.
pub type Pending<T> = Pin<Box<dyn Future<Output = T> + Send>>;

/// Why something can't be shown.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum StreamError {
    /// The store can't be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// It can't be asked so.
    #[error(transparent)]
    Query(#[from] QueryError),
    /// A thread that worked on it ended without an answer.
    #[error("the work on it was given up")]
    GivenUp,
    /// The point is not there any more.
    #[error("the store has no such point any more")]
    NoPoint,
}

/// What changes over time.
pub trait Source: Send + Sync {
    /// The newest generation, as it is to be shown.
    fn open(&self, shown: Shown) -> Pending<Result<Arc<dyn Content>, StreamError>>;
}

/// One generation, seen in one way.
pub trait Content: Send + Sync {
    /// What positions mean.
    fn lattice(&self) -> &Lattice;

    /// The tag of the paint.
    fn paint(&self) -> u64;

    /// The snapshot behind it.
    fn snapshot(&self) -> &Snapshot;

    /// Has anything been committed since?
    fn is_outdated(self: Arc<Self>) -> Pending<Result<bool, StreamError>>;

    /// What a camera wants.
    fn select(self: Arc<Self>, view: View) -> Pending<Result<Selected, StreamError>>;

    /// The points of a part, in even order.
    fn load(self: Arc<Self>, part: WantedPart) -> Pending<Result<Loaded, StreamError>>;

    /// The stored point that is the `index`-th of the part in even order, with all attributes that its scan has.
    fn point(self: Arc<Self>, part: WantedPart, index: u32) -> Pending<Result<Batch, StreamError>>;
}

/// What is asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// From where.
    pub camera: Camera,
    /// How fine.
    pub error_px: f64,
    /// The most points.
    pub points: u64,
    /// The most blocks, where each part begins a block of its own.
    pub blocks: u32,
    /// Points of a block.
    pub block_points: u32,
}

/// What a camera wants.
#[derive(Clone, Debug, Default)]
pub struct Selected {
    /// The parts.
    pub wanted: Wanted,
    /// Was the number of matching points known of all parts? Otherwise it is worth asking again when all are loaded.
    pub exact: bool,
}

/// A part, ready for the adapter.
#[derive(Clone, Debug, Default)]
pub struct Loaded {
    /// In even order.
    pub points: Vec<PackedPoint>,
    /// How close they lie.
    pub densities: Arc<Densities>,
    /// Bytes of chunks that were read.
    pub bytes_read: u64,
}

//! A store as the source: selecting and decoding on rayon's threads.

use super::gpu::{PackedPoint, Paint};
use super::settings::Shown;
use super::source::{Content, Loaded, Pending, Selected, Source, StreamError, View};
use super::spacing::Densities;
use crate::lattice::Lattice;
use crate::points::Batch;
use crate::query::{PartId, Query, Statistics, Take, ViewParts, WantedPart};
use crate::store::{Snapshot, Store};
use std::collections::HashMap;
use std::sync::{Arc, PoisonError, RwLock};
use tokio::sync::oneshot;

/// The points of a store, also while it changes.
#[derive(Clone, Debug)]
pub struct StoreSource {
    store: Store,
    /// How many points of a part match, as far as parts were read: an id stands for the same points in every generation.
    matching: Arc<RwLock<HashMap<PartId, u32>>>,
}

impl StoreSource {
    /// Of this store.
    pub fn new(store: Store) -> Self {
        Self { store, matching: Arc::default() }
    }

    /// As [`Source::open`], on the calling thread.
    ///
    /// # Errors
    ///
    /// [`StreamError`] if the store can't be read, or has no attribute that the filter names.
    pub fn open_now(&self, shown: &Shown) -> Result<StoreContent, StreamError> {
        StoreContent::open(self, shown)
    }
}

/// Runs `work` on rayon's threads.
fn spawn<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, StreamError> + Send + 'static,
) -> Pending<Result<T, StreamError>> {
    let (sender, receiver) = oneshot::channel();
    rayon::spawn(move || {
        // A panic in here is a bug, but not the end of the picture: the sender is dropped, and that is told.
        let done = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work));
        if let Ok(done) = done {
            // Nobody waits for what was superseded.
            let _ = sender.send(done);
        }
    });
    Box::pin(async move { receiver.await.unwrap_or(Err(StreamError::GivenUp)) })
}

impl Source for StoreSource {
    fn open(&self, shown: Shown) -> Pending<Result<Arc<dyn Content>, StreamError>> {
        let source = self.clone();
        spawn(move || Ok(Arc::new(source.open_now(&shown)?) as Arc<dyn Content>))
    }
}

/// A snapshot of a store, seen in one way. Its own methods do on the calling thread what [`Content`] does elsewhere.
pub struct StoreContent {
    store: Store,
    parts: ViewParts,
    /// The same with all attributes.
    whole: ViewParts,
    paint: Arc<dyn Paint>,
    matching: Arc<RwLock<HashMap<PartId, u32>>>,
}

impl StoreContent {
    fn open(source: &StoreSource, shown: &Shown) -> Result<Self, StreamError> {
        let (store, matching) = (source.store.clone(), source.matching.clone());
        let snapshot = store.snapshot()?;
        let mut query = Query::new();
        let names = shown.scans.names(&snapshot);
        if let Some(names) = names {
            query = query.scans(names);
        }
        if let Some(filter) = &shown.filter {
            query = query.filter(filter.clone());
        }
        let whole = query.clone().with_scans(true).view_parts(&snapshot)?;
        let there = |name: &String| snapshot.attributes().iter().any(|a| a.attribute.name == *name);
        let wanted: Vec<String> = shown.paint.attributes().into_iter().filter(there).collect();
        query = if wanted.is_empty() { query.positions_only() } else { query.attributes(wanted) };
        let parts = query.with_scans(shown.paint.needs_scans()).view_parts(&snapshot)?;
        Ok(Self { store, parts, whole, paint: shown.paint.clone(), matching })
    }

    /// As [`Content::is_outdated`].
    ///
    /// # Errors
    ///
    /// [`StreamError`] if the store can't be read.
    pub fn is_outdated_now(&self) -> Result<bool, StreamError> {
        Ok(self.store.changed(self.snapshot())?)
    }

    /// What all readings cost so far.
    pub fn statistics(&self) -> Statistics {
        self.parts.statistics()
    }

    /// As [`Content::select`].
    ///
    /// # Errors
    ///
    /// [`StreamError`] if rows can't be read.
    pub fn select_now(&self, view: &View) -> Result<Selected, StreamError> {
        let (mut points, mut blocks, mut exact) = (view.points, view.blocks, true);
        let matching = self.matching.read().unwrap_or_else(PoisonError::into_inner);
        let take = |id: &PartId, stored: u32| {
            let known = if id.is_whole() { Some(stored) } else { matching.get(id).copied() };
            let count = known.unwrap_or(stored);
            let needed = count.div_ceil(view.block_points);
            if points == 0 || needed > blocks {
                return Take::First(0);
            }
            // What is not taken is not loaded, so it never becomes known.
            exact &= known.is_some();
            blocks -= needed;
            if u64::from(count) > points {
                return Take::First(points as u32);
            }
            points -= u64::from(count);
            Take::All(count)
        };
        let wanted = self.parts.select(&view.camera, view.error_px, take)?;
        Ok(Selected { wanted, exact })
    }

    /// As [`Content::load`].
    ///
    /// # Errors
    ///
    /// [`StreamError`] if the part can't be read.
    pub fn load_now(&self, part: &WantedPart) -> Result<Loaded, StreamError> {
        let found = self.parts.read(part)?;
        let batch = &found.batch;
        let mut values = Vec::with_capacity(batch.len());
        self.paint.paint(batch, self.lattice(), &mut values);
        // A paint that gives too few values is wrong, but no reason to lose points.
        values.resize(batch.len(), 0);
        // In key order first, axis by axis, which is fast; then only whole points are moved.
        let mut packed = Vec::with_capacity(batch.len());
        PackedPoint::pack_all(part.cube, &batch.positions, &values, &mut packed);
        let points: Vec<PackedPoint> = found.even_order().into_iter().map(|i| packed[i as usize]).collect();
        if !part.id.is_whole() {
            let mut matching = self.matching.write().unwrap_or_else(PoisonError::into_inner);
            matching.insert(part.id, points.len() as u32);
        }
        let densities = Arc::new(Densities::of(part.cube, &batch.positions));
        Ok(Loaded { points, densities, bytes_read: found.bytes_read })
    }

    /// As [`Content::point`].
    ///
    /// # Errors
    ///
    /// [`StreamError::NoPoint`] if there are fewer points; else as [`StoreContent::load_now`].
    pub fn point_now(&self, part: &WantedPart, index: u32) -> Result<Batch, StreamError> {
        let found = self.whole.read(part)?;
        let place = found.even_order().get(index as usize).copied().ok_or(StreamError::NoPoint)?;
        Ok(found.batch.gathered(&[place]))
    }
}

impl Content for StoreContent {
    fn lattice(&self) -> &Lattice {
        &self.snapshot().site().lattice
    }

    fn paint(&self) -> u64 {
        self.paint.tag()
    }

    fn snapshot(&self) -> &Snapshot {
        self.parts.snapshot()
    }

    fn is_outdated(self: Arc<Self>) -> Pending<Result<bool, StreamError>> {
        spawn(move || self.is_outdated_now())
    }

    fn select(self: Arc<Self>, view: View) -> Pending<Result<Selected, StreamError>> {
        spawn(move || self.select_now(&view))
    }

    fn load(self: Arc<Self>, part: WantedPart) -> Pending<Result<Loaded, StreamError>> {
        spawn(move || self.load_now(&part))
    }

    fn point(self: Arc<Self>, part: WantedPart, index: u32) -> Pending<Result<Batch, StreamError>> {
        spawn(move || self.point_now(&part, index))
    }
}

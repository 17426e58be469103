//! The task with a source that fails for some time, on a clock that only the test moves.

use crate::geometry::{Camera, WorldBox};
use crate::lattice::Lattice;
use crate::points::Batch;
use crate::query::WantedPart;
use crate::store::{SiteOptions, Snapshot, Store};
use crate::stream::gpu::{BLOCK_POINTS, MemoryPool, Paint};
use crate::stream::{
    Content, Limits, Loaded, Pending, ScanChoice, Selected, Shown, Source, StoreContent, StoreSource, Stream,
    StreamError, View,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

#[derive(Debug)]
struct Plain;

impl Paint for Plain {
    fn tag(&self) -> u64 {
        0
    }
    fn attributes(&self) -> Vec<String> {
        Vec::new()
    }
    fn needs_scans(&self) -> bool {
        false
    }
    fn paint(&self, batch: &Batch, _: &Lattice, values: &mut Vec<u32>) {
        values.resize(values.len() + batch.len(), 0);
    }
}

/// Can its rows be read, and how often were they asked for?
#[derive(Default)]
struct Disk {
    fails: AtomicBool,
    selections: AtomicU64,
}

struct Failing(StoreSource, Arc<Disk>);

struct FailingContent(Arc<StoreContent>, Arc<Disk>);

impl Source for Failing {
    fn open(&self, shown: Shown) -> Pending<Result<Arc<dyn Content>, StreamError>> {
        let (source, disk) = (self.0.clone(), self.1.clone());
        Box::pin(async move {
            let content = Arc::new(source.open_now(&shown)?);
            Ok(Arc::new(FailingContent(content, disk)) as Arc<dyn Content>)
        })
    }
}

impl Content for FailingContent {
    fn lattice(&self) -> &Lattice {
        self.0.lattice()
    }
    fn paint(&self) -> u64 {
        self.0.paint()
    }
    fn snapshot(&self) -> &Snapshot {
        self.0.snapshot()
    }
    fn is_outdated(self: Arc<Self>) -> Pending<Result<bool, StreamError>> {
        Box::pin(async { Ok(false) })
    }
    fn select(self: Arc<Self>, view: View) -> Pending<Result<Selected, StreamError>> {
        Box::pin(async move {
            self.1.selections.fetch_add(1, Ordering::Relaxed);
            if self.1.fails.load(Ordering::Relaxed) { Err(StreamError::GivenUp) } else { self.0.select_now(&view) }
        })
    }
    fn load(self: Arc<Self>, part: WantedPart) -> Pending<Result<Loaded, StreamError>> {
        Box::pin(async move { self.0.load_now(&part) })
    }
    fn point(self: Arc<Self>, part: WantedPart, index: u32) -> Pending<Result<Batch, StreamError>> {
        Box::pin(async move { self.0.point_now(&part, index) })
    }
}

/// It was not tried again until the camera moved, and the list of the camera before was told to be all of it.
#[test]
fn a_selection_that_failed_is_tried_again_and_is_not_complete_meanwhile() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build().unwrap();
    runtime.block_on(async {
        let lattice = Lattice::uniform(0.01).unwrap();
        let store = Store::in_memory(SiteOptions::new(lattice.clone())).unwrap();
        let (disk, limits) = (Arc::new(Disk::default()), Limits { points: 1000, ..Limits::default() });
        let pool = Box::new(MemoryPool::new(limits.blocks(BLOCK_POINTS), BLOCK_POINTS));
        let shown = Shown { scans: ScanChoice::default(), filter: None, paint: Arc::new(Plain) };
        let source = Arc::new(Failing(StoreSource::new(store), disk.clone()));
        let (stream, task) = Stream::new(source, pool, shown, limits, lattice, || ());
        tokio::spawn(task);
        let camera = |side| Camera::looking_at_all(&WorldBox::new([0.0; 3], [side; 3]).unwrap(), [100, 100]).unwrap();
        stream.set_camera(&camera(1.0));
        tokio::time::sleep(Duration::from_secs(2)).await;
        assert!(stream.status().complete, "{:?}", stream.status());
        disk.fails.store(true, Ordering::Relaxed);
        let before = disk.selections.load(Ordering::Relaxed);
        stream.set_camera(&camera(2.0));
        for _ in 0..100 {
            tokio::time::sleep(Duration::from_millis(100)).await;
            assert!(!stream.status().complete && stream.status().error_message.is_some());
        }
        let tried = disk.selections.load(Ordering::Relaxed) - before;
        assert!((10..=21).contains(&tried), "tried {tried} times in ten seconds");
        disk.fails.store(false, Ordering::Relaxed);
        tokio::time::sleep(Duration::from_secs(2)).await;
        assert!(stream.status().complete && stream.status().error_message.is_none(), "{:?}", stream.status());
    });
}

//! The frame's side: cameras in, draw lists out.

use super::driver::Driver;
use super::gpu::{DrawList, PointPool};
use super::settings::{Limits, Shown};
use super::source::{Content, Source, StreamError};
use crate::geometry::Camera;
use crate::lattice::Cube;
use crate::points::Batch;
use crate::query::{Wanted, WantedPart};
use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc};
use std::time::Duration;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};

/// What is to be drawn, and what it shows.
#[derive(Clone)]
pub struct Front {
    /// What to draw. To be dropped when its commands are submitted.
    pub list: Arc<DrawList>,
    /// The generation that it shows; `None` until the store has been opened.
    pub content: Option<Arc<dyn Content>>,
    /// What the camera asked for, of which the list shows what was there.
    pub wanted: Arc<Wanted>,
    /// Counts the lists.
    pub number: u64,
}

impl fmt::Debug for Front {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Front").field("number", &self.number).field("list", &self.list).finish_non_exhaustive()
    }
}

/// How far the stream is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Status {
    /// Points that are drawn.
    pub points: u64,
    /// Nodes that are drawn.
    pub nodes: u64,
    /// Points that the camera asks for and that are not there yet.
    pub missing_points: u64,
    /// Parts that are being read and decoded.
    pub loading: u64,
    /// The largest error on the image, in pixels, of what the newest complete selection promises.
    pub error_px: Option<f64>,
    /// The same in CRS units.
    pub error: Option<f64>,
    /// The generation that is drawn.
    pub generation: u64,
    /// Bytes of points uploaded so far.
    pub uploaded_bytes: u64,
    /// Bytes of chunks read so far.
    pub read_bytes: u64,
    /// Bytes of the pool's blocks that hold points.
    pub pool_used_bytes: u64,
    /// Bytes of the pool.
    pub pool_bytes: u64,
    /// How long the newest selection took.
    pub select_time: Duration,
    /// From a new camera to a complete list, the newest one.
    pub complete_time: Duration,
    /// Is everything there that the newest camera asks for?
    pub complete: bool,
    /// What went wrong last; what can be shown is shown.
    pub error_message: Option<String>,
    /// The adapter is lost: a new stream is needed.
    pub lost: bool,
}

/// What the task is asked to do.
#[derive(Clone, Debug)]
pub(super) struct Request {
    pub camera: Option<Camera>,
    pub shown: Shown,
    pub limits: Limits,
}

/// A point to look up.
pub(super) struct Pick {
    pub content: Arc<dyn Content>,
    pub part: WantedPart,
    pub index: u32,
    pub answer: mpsc::Sender<Result<Batch, StreamError>>,
}

/// What wakes the task.
pub(super) enum Message {
    /// There is a new request.
    Look,
    Pick(Pick),
    /// Something that the task began is done.
    Done(super::driver::Done),
    Stop,
}

/// What both sides see.
pub(super) struct Shared {
    pub request: Mutex<Request>,
    pub front: Mutex<Front>,
    pub status: Mutex<Status>,
    /// A `Look` is on its way.
    pub asked: AtomicBool,
    /// Called when there is something new to draw or to tell.
    pub changed: Box<dyn Fn() + Send + Sync>,
}

/// Locks for as long as a copy takes; nothing in here can panic halfway.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The stream of one window. Cheap to use from the frame's thread: nothing here waits for the disk.
///
/// ```
/// use esker::lattice::Lattice;
/// use esker::points::Batch;
/// use esker::store::{SiteOptions, Store};
/// use esker::stream::gpu::{BLOCK_POINTS, MemoryPool, Paint};
/// use esker::stream::{Limits, ScanChoice, Shown, StoreSource, Stream};
/// use std::sync::Arc;
///
/// /// Every point is red.
/// #[derive(Debug)]
/// struct Red;
/// impl Paint for Red {
///     fn tag(&self) -> u64 { 0 }
///     fn attributes(&self) -> Vec<String> { Vec::new() }
///     fn needs_scans(&self) -> bool { false }
///     fn paint(&self, batch: &Batch, _: &Lattice, values: &mut Vec<u32>) {
///         values.extend(std::iter::repeat_n(0xff00_00ff, batch.len()));
///     }
/// }
///
/// let lattice = Lattice::uniform(0.001)?;
/// let store = Store::in_memory(SiteOptions::new(lattice.clone()))?;
/// let limits = Limits { points: 100_000, ..Limits::default() };
/// let pool = MemoryPool::new(limits.blocks(BLOCK_POINTS), BLOCK_POINTS);
/// let shown = Shown { scans: ScanChoice::default(), filter: None, paint: Arc::new(Red) };
/// let stream = Stream::spawn(Arc::new(StoreSource::new(store)), Box::new(pool), shown, limits, lattice, || ())?;
/// assert_eq!(stream.front().list.points, 0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Stream {
    shared: Arc<Shared>,
    messages: UnboundedSender<Message>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Stream {
    /// A stream, and the task that drives it, which must be run on a tokio runtime with a clock. `changed` is called, from
    /// the task, when there is something new to draw or to tell. `lattice` is that of the empty list before anything is
    /// known.
    pub fn new(
        source: Arc<dyn Source>,
        pool: Box<dyn PointPool>,
        shown: Shown,
        limits: Limits,
        lattice: crate::lattice::Lattice,
        changed: impl Fn() + Send + Sync + 'static,
    ) -> (Self, impl Future<Output = ()> + Send) {
        let (messages, receiver): (_, UnboundedReceiver<Message>) = unbounded_channel();
        let list = Arc::new(DrawList::empty(lattice, shown.paint.tag()));
        let front = Front { list, content: None, wanted: Arc::default(), number: 0 };
        let shared = Arc::new(Shared {
            request: Mutex::new(Request { camera: None, shown, limits }),
            front: Mutex::new(front),
            status: Mutex::default(),
            asked: AtomicBool::new(false),
            changed: Box::new(changed),
        });
        let driver = Driver::new(shared.clone(), messages.clone(), receiver, source, pool);
        (Self { shared, messages, thread: None }, driver.run())
    }

    /// A stream with a thread of its own, which ends with it.
    ///
    /// # Errors
    ///
    /// [`std::io::Error`] if there can't be another thread.
    pub fn spawn(
        source: Arc<dyn Source>,
        pool: Box<dyn PointPool>,
        shown: Shown,
        limits: Limits,
        lattice: crate::lattice::Lattice,
        changed: impl Fn() + Send + Sync + 'static,
    ) -> std::io::Result<Self> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build()?;
        let (mut stream, task) = Self::new(source, pool, shown, limits, lattice, changed);
        let thread = std::thread::Builder::new().name("stream".into()).spawn(move || runtime.block_on(task))?;
        stream.thread = Some(thread);
        Ok(stream)
    }

    /// The camera is here now.
    pub fn set_camera(&self, camera: &Camera) {
        self.ask(|request| &mut request.camera, Some(camera.clone()));
    }

    /// This is to be seen.
    pub fn set_shown(&self, shown: &Shown) {
        self.ask(|request| &mut request.shown, shown.clone());
    }

    /// So much may be used.
    pub fn set_limits(&self, limits: Limits) {
        self.ask(|request| &mut request.limits, limits);
    }

    fn ask<T: PartialEq>(&self, of: impl FnOnce(&mut Request) -> &mut T, value: T) {
        {
            let mut request = lock(&self.shared.request);
            let held = of(&mut request);
            if *held == value {
                return;
            }
            *held = value;
        }
        // One word on its way is enough, however many cameras there are.
        if !self.shared.asked.swap(true, Ordering::AcqRel) {
            self.send(Message::Look);
        }
    }

    fn send(&self, message: Message) {
        // A task that has ended is told by the status.
        let _ = self.messages.send(message);
    }

    /// What to draw now.
    pub fn front(&self) -> Front {
        lock(&self.shared.front).clone()
    }

    /// How far it is.
    pub fn status(&self) -> Status {
        let mut status = lock(&self.shared.status).clone();
        status.complete &= !self.shared.asked.load(Ordering::Acquire);
        status
    }

    /// Looks up a stored point with all its attributes: the `index`-th of a part that the front shows, in the order in
    /// which it was uploaded. The answer comes later; none comes if the front does not show the part.
    pub fn pick(&self, front: &Front, place: PickPlace) -> mpsc::Receiver<Result<Batch, StreamError>> {
        let (answer, receiver) = mpsc::channel();
        if let (Some(part), Some(content)) = (place.part(&front.wanted), front.content.clone()) {
            let index = place.index;
            self.send(Message::Pick(Pick { content, part, index, answer }));
        }
        receiver
    }
}

/// A point of a draw list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PickPlace {
    /// Its node's cube.
    pub cube: Cube,
    /// Its node's layer.
    pub layer: u16,
    /// The node's part.
    pub part: u32,
    /// Which point of the part, in the order of its blocks.
    pub index: u32,
}

impl PickPlace {
    fn part(&self, wanted: &Wanted) -> Option<WantedPart> {
        let layer = |p: &WantedPart| wanted.nodes[p.node as usize].layer;
        let here = |p: &&WantedPart| p.part == self.part && p.cube == self.cube && layer(p) == self.layer;
        wanted.parts.iter().find(here).copied()
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        self.send(Message::Stop);
        if let Some(thread) = self.thread.take() {
            // It ends at once: what is being decoded goes on by itself and is not waited for.
            let _ = thread.join();
        }
    }
}

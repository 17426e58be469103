//! The task behind a stream: takes the newest camera, begins selections and loads, uploads, swaps lists.
//!
//! It never waits for anything but its next message or moment: whatever takes time runs elsewhere and sends a message
//! when it is done.

mod loading;
mod publishing;
#[cfg(test)]
mod tests;

use super::handle::{Message, Pick, Request, Shared, lock};
use super::motion::Motion;
use super::residency::{Key, Residency};
use super::settings::Shown;
use super::source::{Content, Loaded, Pending, Selected, Source, StreamError};
use crate::geometry::Camera;
use crate::query::{Wanted, WantedPart};
use std::collections::{HashMap, HashSet, VecDeque};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender};
use tokio::time::{Instant, timeout_at};

/// A new list is handed out at least so often while something is loading.
pub const SWAP_INTERVAL: Duration = Duration::from_millis(33);
/// What was shown before stays so long, at most, when something else is to be shown and is not complete.
pub const SETTLE_TIME: Duration = Duration::from_millis(500);
/// So far ahead of a moving camera parts are loaded.
pub const PREFETCH_AHEAD: Duration = Duration::from_millis(400);
/// How often the store is asked whether it has changed.
const CHECK_INTERVAL: Duration = Duration::from_millis(250);
/// How often held lists are looked at while an upload waits for their blocks.
const ROOM_INTERVAL: Duration = Duration::from_millis(4);
/// A selection that failed is tried again so much later.
const RETRY_INTERVAL: Duration = Duration::from_millis(500);
/// Memory that a point takes while it is decoded and packed, about.
const LOADING_BYTES_PER_POINT: u64 = 72;

/// Something that was begun is done.
pub(super) enum Done {
    Opened(Shown, Result<Arc<dyn Content>, StreamError>),
    Outdated(Result<bool, StreamError>),
    /// The number of the content, the camera asked for, when, and whether it is for what lies ahead.
    Selected(u64, Box<Camera>, Instant, bool, Result<Selected, StreamError>),
    Loaded(Key, Result<Loaded, StreamError>),
}

/// What the newest selection wants.
struct Want {
    wanted: Arc<Wanted>,
    exact: bool,
    keys: HashSet<Key>,
    /// Still to be loaded, most urgent last.
    queue: Vec<u32>,
    /// The request's camera.
    camera: Camera,
    /// When that camera came.
    since: Instant,
}

pub(super) struct Driver {
    shared: Arc<Shared>,
    messages: UnboundedSender<Message>,
    receiver: UnboundedReceiver<Message>,
    source: Arc<dyn Source>,
    residency: Residency,
    request: Request,
    /// What is open, and its number.
    content: Option<(Arc<dyn Content>, u64)>,
    opened: Option<Shown>,
    opening: bool,
    /// Is a newer generation known to be there?
    outdated: bool,
    checking: bool,
    next_check: Instant,
    selecting: bool,
    /// Is that selection for what lies ahead?
    foreseeing: bool,
    /// Has anything been read since the last selection began?
    learned: bool,
    /// Is the list that was handed out last all that was wanted?
    front_complete: bool,
    missing_points: u64,
    /// The newest camera is not answered yet; since when.
    unanswered: Option<Instant>,
    /// The selection for it failed: when it is tried again, and what was told.
    retry: Option<(Instant, String)>,
    want: Option<Want>,
    /// What lies ahead and is not wanted yet.
    ahead: Vec<WantedPart>,
    looked_ahead: bool,
    loading: HashMap<Key, u64>,
    loading_bytes: u64,
    /// Decoded, but there is no room yet.
    waiting: VecDeque<(Key, Loaded)>,
    /// Could not be read: drawn as if they were empty.
    failed: HashSet<Key>,
    motion: Motion,
    /// What is wanted or there has changed since the last list.
    dirty: bool,
    /// The content changed, then: nothing is handed out but what is complete, for some time.
    settling: Option<Instant>,
    published: Instant,
    number: u64,
}

impl Driver {
    pub fn new(
        shared: Arc<Shared>,
        messages: UnboundedSender<Message>,
        receiver: UnboundedReceiver<Message>,
        source: Arc<dyn Source>,
        pool: Box<dyn super::gpu::PointPool>,
    ) -> Self {
        let request = lock(&shared.request).clone();
        // Of a paused clock, too; read again when the task begins.
        let now = Instant::now();
        Self {
            shared,
            messages,
            receiver,
            source,
            residency: Residency::new(pool),
            request,
            content: None,
            opened: None,
            opening: false,
            outdated: false,
            checking: false,
            next_check: now,
            selecting: false,
            foreseeing: false,
            learned: false,
            front_complete: false,
            missing_points: 0,
            unanswered: None,
            retry: None,
            want: None,
            ahead: Vec::new(),
            looked_ahead: true,
            loading: HashMap::new(),
            loading_bytes: 0,
            waiting: VecDeque::new(),
            failed: HashSet::new(),
            motion: Motion::default(),
            dirty: false,
            settling: None,
            published: now,
            number: 0,
        }
    }

    pub async fn run(mut self) {
        (self.published, self.next_check) = (Instant::now(), Instant::now() + CHECK_INTERVAL);
        self.unanswered = self.request.camera.is_some().then(Instant::now);
        loop {
            self.go_on();
            let message = match timeout_at(self.next_moment(), self.receiver.recv()).await {
                Ok(Some(message)) => Some(message),
                Ok(None) => return,
                Err(_) => None,
            };
            let mut next = message;
            while let Some(message) = next {
                match message {
                    Message::Stop => return,
                    Message::Look => self.look(),
                    Message::Pick(pick) => self.pick(pick),
                    Message::Done(done) => self.done(done),
                }
                next = self.receiver.try_recv().ok();
            }
        }
    }

    /// Begins whatever can be begun, and hands out a list if it is time.
    fn go_on(&mut self) {
        if self.residency.let_go() || !self.waiting.is_empty() {
            self.upload_waiting();
        }
        self.open();
        self.check();
        self.select();
        self.load();
        self.publish();
        self.report();
    }

    /// When to look again if nothing comes.
    fn next_moment(&self) -> Instant {
        let now = Instant::now();
        let mut next = if self.checking || self.opening { now + CHECK_INTERVAL } else { self.next_check };
        if let (Some((then, _)), false) = (&self.retry, self.selecting) {
            next = next.min(*then);
        }
        if self.dirty {
            next = next.min((self.published + SWAP_INTERVAL).max(now + ROOM_INTERVAL));
        }
        if !self.waiting.is_empty() {
            next = next.min(now + ROOM_INTERVAL);
        }
        next
    }

    fn begin<T: 'static>(&self, work: Pending<T>, done: impl FnOnce(T) -> Done + Send + 'static) {
        let messages = self.messages.clone();
        tokio::spawn(async move {
            let result = work.await;
            // The task may have ended meanwhile.
            let _ = messages.send(Message::Done(done(result)));
        });
    }

    /// Takes the newest request.
    fn look(&mut self) {
        self.shared.asked.store(false, Ordering::Release);
        let request = lock(&self.shared.request).clone();
        lock(&self.shared.status).complete = false;
        let now = Instant::now();
        if request.camera != self.request.camera {
            if let Some(camera) = &request.camera {
                self.motion.see(camera, now);
            }
            self.unanswered.get_or_insert(now);
        }
        if request.limits != self.request.limits {
            self.unanswered.get_or_insert(now);
            let blocks = request.limits.blocks(self.residency.block_points());
            if let Err(error) = self.residency.set_limit(blocks) {
                self.pool_failed(&error);
            }
        }
        self.request = request;
    }

    fn open(&mut self) {
        let stale = self.opened.as_ref() != Some(&self.request.shown);
        if self.opening || !(stale || self.outdated) {
            return;
        }
        self.opening = true;
        self.outdated = false;
        let shown = self.request.shown.clone();
        let work = self.source.open(shown.clone());
        self.begin(work, move |result| Done::Opened(shown, result));
    }

    fn check(&mut self) {
        if self.checking || self.opening || Instant::now() < self.next_check {
            return;
        }
        let Some((content, _)) = &self.content else {
            // The first attempt failed.
            self.opened = None;
            return self.open();
        };
        self.checking = true;
        let work = content.clone().is_outdated();
        self.begin(work, Done::Outdated);
    }

    fn done(&mut self, done: Done) {
        match done {
            Done::Opened(shown, result) => self.opened(shown, result),
            Done::Outdated(result) => {
                self.checking = false;
                self.next_check = Instant::now() + CHECK_INTERVAL;
                match result {
                    Ok(outdated) => self.outdated |= outdated,
                    Err(error) => self.tell(&error),
                }
            }
            Done::Selected(content, camera, since, ahead, result) => {
                self.selected(content, *camera, since, ahead, result)
            }
            Done::Loaded(key, result) => {
                self.loading_bytes -= self.loading.remove(&key).unwrap_or(0);
                self.loaded(key, result);
            }
        }
    }

    fn opened(&mut self, shown: Shown, result: Result<Arc<dyn Content>, StreamError>) {
        self.opening = false;
        self.next_check = Instant::now() + CHECK_INTERVAL;
        // Also if it failed: what is open stays, and the same request would fail again.
        self.opened = Some(shown);
        match result {
            Ok(content) => {
                let number = self.content.as_ref().map_or(0, |(_, n)| *n) + 1;
                self.content = Some((content, number));
                self.failed.drain().for_each(|key| self.residency.forget(&key));
                // Places of nodes are those of a generation: what was wanted of the old one can't be read from the new one.
                (self.want, self.dirty) = (None, false);
                self.ahead.clear();
                self.waiting.clear();
                // Of an empty picture there is nothing to keep: the first points are seen as soon as they come.
                let something = lock(&self.shared.front).list.points > 0;
                self.settling = something.then(Instant::now);
                self.unanswered.get_or_insert_with(Instant::now);
                lock(&self.shared.status).error_message = None;
            }
            Err(error) => self.tell(&error),
        }
    }

    fn pick(&self, pick: Pick) {
        let work = pick.content.point(pick.part, pick.index);
        tokio::spawn(async move {
            // Whoever asked may have gone.
            let _ = pick.answer.send(work.await);
        });
    }
}

//! The task behind a stream: takes the newest camera, begins selections and loads, uploads, swaps lists.
//!
//! It never waits for anything but its next message or moment: whatever takes time runs elsewhere and sends a message
//! when it is done.

use super::cut::{Cut, closed_cut, keys};
use super::gpu::PoolError;
use super::handle::{Front, Message, Pick, Request, Shared, lock};
use super::motion::Motion;
use super::priority::load_order;
use super::residency::{Key, Residency};
use super::settings::Shown;
use super::source::{Content, Loaded, Pending, Selected, Source, StreamError, View};
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

    fn view(&self, camera: &Camera) -> View {
        let limits = self.request.limits;
        let block_points = self.residency.block_points();
        View {
            camera: camera.clone(),
            error_px: limits.error_px,
            points: limits.points,
            // Half of the pool: the list that is drawn has the other half.
            blocks: limits.blocks(block_points) / 2,
            block_points,
        }
    }

    fn select(&mut self) {
        let (Some((content, number)), false) = (&self.content, self.selecting) else { return };
        let Some(camera) = &self.request.camera else { return };
        let (content, number) = (content.clone(), *number);
        let now = Instant::now();
        if let Some(since) = self.unanswered.take() {
            (self.selecting, self.foreseeing) = (true, false);
            (self.looked_ahead, self.learned) = (false, false);
            let work = content.select(self.view(camera));
            let camera = Box::new(camera.clone());
            self.begin(work, move |result| Done::Selected(number, camera, since, false, result));
        } else if self.request.limits.prefetch && !self.looked_ahead && self.is_idle() {
            self.looked_ahead = true;
            let Some(ahead) = self.motion.ahead(camera, now, PREFETCH_AHEAD) else { return };
            (self.selecting, self.foreseeing) = (true, true);
            let work = content.select(self.view(&ahead));
            self.begin(work, move |result| Done::Selected(number, Box::new(ahead), now, true, result));
        }
    }

    /// Is everything there that is wanted?
    fn is_idle(&self) -> bool {
        let want = self.want.as_ref();
        self.waiting.is_empty() && self.loading.is_empty() && want.is_some_and(|w| w.queue.is_empty())
    }

    fn load(&mut self) {
        let Some((content, _)) = self.content.clone() else { return };
        let paint = content.paint();
        let most = 2 * rayon::current_num_threads() + 2;
        while self.loading.len() < most {
            let next = match &mut self.want {
                Some(want) => want.queue.pop().map(|i| want.wanted.parts[i as usize]),
                None => None,
            };
            let Some(part) = next.or_else(|| self.ahead.pop()) else { return };
            let key = (part.id, paint);
            if self.residency.is_settled(&key) || self.loading.contains_key(&key) || self.is_waiting(&key) {
                continue;
            }
            let bytes = u64::from(part.stored) * LOADING_BYTES_PER_POINT;
            if self.loading_bytes > 0 && self.loading_bytes + bytes > self.request.limits.loading_bytes {
                // Later: the queue is made anew when something has been loaded.
                self.requeue(&content);
                return;
            }
            self.loading_bytes += bytes;
            self.loading.insert(key, bytes);
            let work = content.clone().load(part);
            self.begin(work, move |result| Done::Loaded(key, result));
        }
    }

    fn is_waiting(&self, key: &Key) -> bool {
        self.waiting.iter().any(|(k, _)| k == key)
    }

    /// Makes the queue of what is wanted and not there.
    fn requeue(&mut self, content: &Arc<dyn Content>) {
        let heading = self.motion.heading(Instant::now());
        let Some(want) = &mut self.want else { return };
        let mut queue = load_order(&want.wanted, &want.camera, heading, content.lattice());
        let paint = content.paint();
        let (residency, loading, waiting) = (&self.residency, &self.loading, &self.waiting);
        queue.retain(|&i| {
            let key = (want.wanted.parts[i as usize].id, paint);
            let coming = loading.contains_key(&key) || waiting.iter().any(|(k, _)| *k == key);
            !residency.is_settled(&key) && !coming
        });
        queue.reverse();
        want.queue = queue;
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
                self.settling = Some(Instant::now());
                self.unanswered.get_or_insert_with(Instant::now);
                lock(&self.shared.status).error_message = None;
            }
            Err(error) => self.tell(&error),
        }
    }

    fn selected(
        &mut self,
        number: u64,
        camera: Camera,
        since: Instant,
        ahead: bool,
        result: Result<Selected, StreamError>,
    ) {
        self.selecting = false;
        let Some((content, current)) = self.content.clone() else { return };
        let selected = match result {
            Ok(selected) => selected,
            Err(error) => return self.tell(&error),
        };
        if number != current {
            // Of a generation that is not shown any more.
            self.unanswered.get_or_insert(since);
            return;
        }
        let paint = content.paint();
        let settled = |p: &WantedPart| self.residency.is_settled(&(p.id, paint));
        if ahead {
            self.ahead = selected.wanted.parts.into_iter().filter(|p| !settled(p)).collect();
            self.ahead.reverse();
            return;
        }
        let wanted = Arc::new(selected.wanted);
        let keys: HashSet<Key> = keys(&wanted, paint).collect();
        self.residency.touch(keys.iter());
        self.ahead.clear();
        // What waited for room for an older camera is not wanted any more.
        self.waiting.retain(|(key, _)| keys.contains(key));
        self.want = Some(Want { wanted, exact: selected.exact, keys, queue: Vec::new(), camera, since });
        self.requeue(&content);
        self.dirty = true;
        let mut status = lock(&self.shared.status);
        status.select_time = Instant::now().duration_since(since);
    }

    fn loaded(&mut self, key: Key, result: Result<Loaded, StreamError>) {
        let loaded = match result {
            Ok(loaded) => loaded,
            Err(error) => {
                self.tell(&error);
                self.failed.insert(key);
                Loaded::default()
            }
        };
        self.learned = true;
        lock(&self.shared.status).read_bytes += loaded.bytes_read;
        let wanted = self.want.as_ref().is_some_and(|w| w.keys.contains(&key));
        // What was loaded in advance may come when it is not needed yet; what a newer camera does not want is dropped.
        let in_advance = self.want.as_ref().is_some_and(|w| w.queue.is_empty()) && self.request.limits.prefetch;
        if wanted || in_advance {
            self.waiting.push_back((key, loaded));
            self.upload_waiting();
        }
    }

    fn upload_waiting(&mut self) {
        while let Some((key, loaded)) = self.waiting.pop_front() {
            let wanted = self.want.as_ref().map(|w| &w.keys);
            let keep = |key: &Key| wanted.is_some_and(|w| w.contains(key));
            let needed = keep(&key);
            match self.residency.insert(key, &loaded.points, keep) {
                Ok(true) => self.dirty |= needed,
                Ok(false) if needed => {
                    self.waiting.push_front((key, loaded));
                    return;
                }
                // There is no room for what is only foreseen.
                Ok(false) => {}
                Err(error) => return self.pool_failed(&error),
            }
        }
    }

    fn publish(&mut self) {
        let (Some((content, _)), Some(want), true) = (&self.content, &self.want, self.dirty) else { return };
        let now = Instant::now();
        let Cut { list, keys, missing_points } =
            closed_cut(&want.wanted, &self.residency, content.lattice(), content.paint());
        if !list.complete {
            let settled = self.settling.is_none_or(|since| {
                let begun = !list.blocks.is_empty() || want.wanted.parts.is_empty();
                begun && now.duration_since(since) >= SETTLE_TIME
            });
            if !settled || now.duration_since(self.published) < SWAP_INTERVAL {
                self.missing_points = missing_points;
                return;
            }
        }
        let complete = list.complete;
        let (nodes, points, since) = (list.nodes.len() as u64, list.points, want.since);
        let unknown = !want.exact && complete && self.learned;
        self.dirty = false;
        self.settling = None;
        self.published = now;
        let list = Arc::new(list);
        let content = content.clone();
        let wanted = want.wanted.clone();
        let same = {
            let front = lock(&self.shared.front);
            *front.list == *list && front.content.as_ref().is_some_and(|c| Arc::ptr_eq(c, &content))
        };
        if !same {
            self.number += 1;
            self.residency.hold(list.clone());
            self.residency.touch(keys.iter());
            *lock(&self.shared.front) = Front { list, content: Some(content.clone()), wanted, number: self.number };
            self.residency.let_go();
        }
        if unknown {
            // Now that all are loaded it is known how many points of each part match, so there may be room for more.
            self.unanswered.get_or_insert(since);
        }
        let (error, error_px) = (want.wanted.error_bound, want.wanted.error_bound_px);
        (self.missing_points, self.front_complete) = (missing_points, complete);
        let mut status = lock(&self.shared.status);
        (status.points, status.nodes) = (points, nodes);
        status.generation = content.snapshot().generation();
        if complete {
            (status.error, status.error_px) = (error, error_px);
            status.complete_time = now.duration_since(since);
        }
        drop(status);
        if !same {
            (self.shared.changed)();
        }
    }

    /// Tells how far it is.
    fn report(&self) {
        let block_bytes = u64::from(self.residency.block_points()) * 16;
        let answered = self.unanswered.is_none() && (!self.selecting || self.foreseeing) && !self.dirty;
        let newest = !self.opening && !self.outdated && self.opened.as_ref() == Some(&self.request.shown);
        let mut status = lock(&self.shared.status);
        let before = status.clone();
        status.missing_points = self.missing_points;
        status.loading = self.loading.len() as u64;
        status.uploaded_bytes = self.residency.uploaded_bytes;
        status.pool_used_bytes = u64::from(self.residency.used_blocks()) * block_bytes;
        status.pool_bytes = self.residency.budget_bytes();
        // Not while a newer request is on its way here.
        status.complete = answered && newest && self.front_complete && !self.shared.asked.load(Ordering::Acquire);
        let changed = *status != before;
        drop(status);
        if changed {
            (self.shared.changed)();
        }
    }

    fn tell(&self, error: &dyn std::error::Error) {
        let mut text = error.to_string();
        let mut source = error.source();
        while let Some(cause) = source {
            text = format!("{text}: {cause}");
            source = cause.source();
        }
        lock(&self.shared.status).error_message = Some(text);
        (self.shared.changed)();
    }

    fn pool_failed(&self, error: &PoolError) {
        if matches!(error, PoolError::Lost(_)) {
            lock(&self.shared.status).lost = true;
        }
        self.tell(error);
    }

    fn pick(&self, pick: Pick) {
        let work = pick.content.point(pick.part, pick.index);
        tokio::spawn(async move {
            // Whoever asked may have gone.
            let _ = pick.answer.send(work.await);
        });
    }
}

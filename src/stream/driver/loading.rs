//! What the newest camera wants is selected, loaded and uploaded.

use super::publishing::in_words;
use super::{Done, Driver, LOADING_BYTES_PER_POINT, PREFETCH_AHEAD, RETRY_INTERVAL, Want};
use crate::geometry::Camera;
use crate::query::WantedPart;
use crate::stream::cut::keys;
use crate::stream::handle::lock;
use crate::stream::priority::load_order;
use crate::stream::residency::Key;
use crate::stream::source::{Content, Loaded, Selected, StreamError, View};
use std::collections::HashSet;
use std::sync::Arc;
use tokio::time::Instant;

impl Driver {
    pub(super) fn view(&self, camera: &Camera) -> View {
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

    pub(super) fn select(&mut self) {
        let (Some((content, number)), false) = (&self.content, self.selecting) else { return };
        let Some(camera) = &self.request.camera else { return };
        let (content, number) = (content.clone(), *number);
        let now = Instant::now();
        if self.retry.as_ref().is_some_and(|(then, _)| now < *then) {
            return;
        }
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
    pub(super) fn is_idle(&self) -> bool {
        let want = self.want.as_ref();
        self.waiting.is_empty() && self.loading.is_empty() && want.is_some_and(|w| w.queue.is_empty())
    }

    pub(super) fn load(&mut self) {
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
    pub(super) fn requeue(&mut self, content: &Arc<dyn Content>) {
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

    pub(super) fn selected(
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
            Err(error) => {
                self.tell(&error);
                if !ahead {
                    // A store that can't be read now may be readable later, and what is drawn is not what was asked for.
                    self.unanswered.get_or_insert(since);
                    self.retry = Some((Instant::now() + RETRY_INTERVAL, in_words(&error)));
                }
                return;
            }
        };
        if let Some((_, told)) = self.retry.take_if(|_| !ahead) {
            let mut status = lock(&self.shared.status);
            status.error_message.take_if(|words| *words == told);
        }
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

    pub(super) fn loaded(&mut self, key: Key, result: Result<Loaded, StreamError>) {
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

    pub(super) fn upload_waiting(&mut self) {
        while let Some((key, loaded)) = self.waiting.pop_front() {
            let wanted = self.want.as_ref().map(|w| &w.keys);
            let keep = |key: &Key| wanted.is_some_and(|w| w.contains(key));
            let needed = keep(&key);
            match self.residency.insert(key, &loaded, keep) {
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
}

//! What is there becomes the list that the frame draws, and the status that it tells.

use super::{Driver, SETTLE_TIME, SWAP_INTERVAL};
use crate::stream::cut::{Cut, closed_cut};
use crate::stream::gpu::PoolError;
use crate::stream::handle::{Front, lock};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use tokio::time::Instant;

impl Driver {
    pub(super) fn publish(&mut self) {
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
        // After the first coarse picture what was shown before is that: drawing every step to the whole one takes the time
        // of loading it, where processors draw.
        let first = lock(&self.shared.front).list.points == 0;
        self.settling = (first && !complete && points > 0).then_some(now);
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
    pub(super) fn report(&self) {
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

    pub(super) fn tell(&self, error: &dyn std::error::Error) {
        lock(&self.shared.status).error_message = Some(in_words(error));
        (self.shared.changed)();
    }

    pub(super) fn pool_failed(&self, error: &PoolError) {
        if matches!(error, PoolError::Lost(_)) {
            lock(&self.shared.status).lost = true;
        }
        self.tell(error);
    }
}

/// An error with its causes.
pub(super) fn in_words(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        text = format!("{text}: {cause}");
        source = cause.source();
    }
    text
}

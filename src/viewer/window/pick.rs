//! Which point is under the pointer: asked of the adapter, then of the store, over some frames.

use super::Open;
use crate::points::Batch;
use crate::render::PickRequest;
use crate::stream::gpu::DrawList;
use crate::stream::{Front, PickPlace, StreamError};
use crate::viewer::found::found;
use crate::viewer::model::{Found, Model};
use crate::viewer::rig::Mode;
use std::sync::Arc;
use std::sync::mpsc::Receiver;

/// A point that is being looked up.
pub(super) struct Pick {
    of_centre: bool,
    front: Front,
    stage: PickStage,
}

enum PickStage {
    OnAdapter(PickRequest),
    InStore(Receiver<Result<Batch, StreamError>>),
}

impl Pick {
    /// Asked of the adapter, of what `front` shows.
    pub(super) fn asked(request: PickRequest, front: &Front, of_centre: bool) -> Self {
        // Without its list: a list that is held keeps its blocks.
        let list = Arc::new(DrawList::empty(front.list.lattice.clone(), front.list.paint));
        Self { of_centre, front: Front { list, ..front.clone() }, stage: PickStage::OnAdapter(request) }
    }
}

/// Is what lies ahead of interest, and not what is under the pointer?
pub(super) fn flies(model: &Model) -> bool {
    model.nav.rig.mode != Mode::Orbit && model.nav.is_moving()
}

impl Open {
    /// The pixel whose point is to be looked up in the next frame.
    pub(super) fn pick_place(&self, model: &Model) -> Option<[u32; 2]> {
        let [width, height] = self.gpu.size_px();
        if self.pick.is_some() || model.nav.is_dragging() {
            return None;
        }
        if flies(model) {
            return Some([width / 2, height / 2]);
        }
        let at = model.nav.pointer();
        let inside = (0.0..f64::from(width)).contains(&at[0]) && (0.0..f64::from(height)).contains(&at[1]);
        (self.pick_due && self.over_points && inside).then(|| at.map(|c| c as u32))
    }

    /// Goes on with the point that is being looked up.
    pub(super) fn follow_pick(&mut self, model: &mut Model) {
        if !self.over_points {
            model.hover = None;
        }
        let Some(pick) = &mut self.pick else { return };
        match &mut pick.stage {
            PickStage::OnAdapter(request) => match request.poll() {
                None => {}
                Some(None) => {
                    if !pick.of_centre {
                        model.hover = None;
                    }
                    self.pick = None;
                }
                Some(Some(place)) => {
                    let (cube, layer) = (place.cube, place.layer);
                    let at = PickPlace { cube, layer, part: place.part, index: place.index };
                    pick.stage = PickStage::InStore(self.stream.pick(&pick.front, at));
                }
            },
            PickStage::InStore(answer) => match answer.try_recv() {
                Err(std::sync::mpsc::TryRecvError::Empty) => {}
                Ok(Ok(batch)) => {
                    let found = model.site.as_ref().and_then(|site| found(&batch, site));
                    Self::point_found(model, found, pick.of_centre);
                    self.pick = None;
                }
                Ok(Err(_)) | Err(std::sync::mpsc::TryRecvError::Disconnected) => self.pick = None,
            },
        }
    }

    fn point_found(model: &mut Model, found: Option<Found>, of_centre: bool) {
        let Some(found) = found else { return };
        let depth = (found.world - model.nav.rig.eye()).dot(model.nav.rig.forward());
        if of_centre {
            // Speed follows the distance to what is looked at.
            model.nav.rig.set_distance(depth);
        } else {
            model.hover = Some(found);
        }
    }
}

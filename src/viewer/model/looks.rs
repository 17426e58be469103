//! How the points are drawn: what the model says to the renderer and to the stream.

use super::{Clip, ColorKey, Model};
use crate::lattice::Lattice;
use crate::points::Batch;
use crate::query::Filter;
use crate::render::{ClipBox, ColorMode, ColorOptions, Coloring, Edl, Fog, MAX_CLIPS, Palette, RenderOptions, Shape};
use crate::stream::gpu::Paint;
use crate::stream::{Limits, ScanChoice, Shown};
use std::sync::Arc;

/// So many palettes are kept for points that are still shown in old colours.
const KEPT_PALETTES: usize = 4;

impl Model {
    /// How the points are drawn.
    pub fn options(&self) -> RenderOptions {
        let set = &self.set;
        let clip = |c: &Clip| ClipBox::from_bounds(&c.bounds()?, c.keep).ok();
        let reach = self.seen_bounds().map_or(1.0, |b| b.extent().length());
        RenderOptions {
            radius_factor: set.splat,
            min_radius_px: set.least_px,
            shape: set.shape.parse::<Shape>().unwrap_or_default(),
            edl: (set.edl > 0.0).then(|| Edl { strength: set.edl, ..Edl::default() }),
            shadow_px: set.shadow_px,
            // Half of the site away at full haze everything is half hidden.
            fog: (set.haze > 0.0).then(|| Fog { color: None, start: 0.0, half: (reach * 0.25 / set.haze).max(1e-9) }),
            clips: self.clips.iter().filter(|c| c.on).filter_map(clip).take(MAX_CLIPS).collect(),
            node_boxes: self.node_boxes,
            ..RenderOptions::default()
        }
    }

    /// How much may be used.
    pub fn limits(&self) -> Limits {
        Limits { points: self.set.budget_points, error_px: self.set.error_px, ..Limits::default() }
    }

    /// The colouring of the site; made when something that it depends on has changed.
    pub fn coloring(&mut self) -> Option<&Coloring> {
        let site = self.site.as_ref()?;
        let key: ColorKey = (self.mode, self.range.map(|r| r.map(f64::to_bits)));
        let fresh = self.coloring.as_ref().is_some_and(|(g, k, _)| (*g, *k) == (site.generation, key));
        if !fresh {
            let options = ColorOptions {
                mode: self.mode,
                depths: site.depths.clone(),
                range: self.range,
                scan_names: site.scans.iter().map(|s| (s.id, s.name.clone())).collect(),
                levels: None,
            };
            let made = Coloring::new(&[&site.sample], &site.lattice, &options).or_else(|_| {
                // The mode shows what these points lack: heights are always there.
                Coloring::new(&[&site.sample], &site.lattice, &ColorOptions { mode: ColorMode::Height, ..options })
            });
            self.coloring = Some((site.generation, key, made.ok()?));
        }
        self.coloring.as_ref().map(|(_, _, coloring)| coloring)
    }

    /// The colours of the values that a paint made: while points of a new paint are on their way the old ones are shown as
    /// they were.
    pub fn palette_for(&mut self, paint: u64) -> Palette {
        if let Some(coloring) = self.coloring() {
            let (tag, palette) = (coloring.paint.tag(), coloring.palette.clone());
            self.palettes.retain(|(t, _)| *t != tag);
            self.palettes.push((tag, palette));
            let old = self.palettes.len().saturating_sub(KEPT_PALETTES);
            self.palettes.drain(..old);
        }
        let found = self.palettes.iter().find(|(tag, _)| *tag == paint);
        found.map(|(_, palette)| palette.clone()).unwrap_or_default()
    }

    /// What the stream is to show.
    pub fn shown(&mut self) -> Option<Shown> {
        let filter = self.shown_filter();
        let scans = self.scans.clone();
        let paint = self.coloring()?.paint.clone();
        Some(Shown { scans, filter, paint })
    }

    /// Which points are seen: those of the filter, without the classes that are off.
    pub fn shown_filter(&self) -> Option<Filter> {
        let there = self.site.as_ref().is_some_and(|s| s.has("Classification"));
        if self.classes_off.is_empty() || !there {
            return self.filter.clone();
        }
        let classes: Vec<String> = self.classes_off.iter().map(u32::to_string).collect();
        let on = format!("Classification is null or not (Classification in ({}))", classes.join(", "));
        let text = match &self.filter {
            Some(filter) => format!("({filter}) and ({on})"),
            None => on,
        };
        Filter::parse(&text).ok()
    }
}

/// What is shown before anything is known of the store.
pub(in crate::viewer) fn plain_shown() -> Shown {
    Shown { scans: ScanChoice::default(), filter: None, paint: Arc::new(Grey) }
}

/// All points are grey.
#[derive(Debug)]
struct Grey;

impl Paint for Grey {
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
        values.resize(values.len() + batch.len(), u32::from_le_bytes([150, 150, 150, 255]));
    }
}

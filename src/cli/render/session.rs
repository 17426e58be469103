//! From a camera to an image: select, read, decode and pack what is new, upload it, draw.

use super::resident::{Held, Key, Packed, Resident};
use super::statistics::FrameStatistics;
use crate::geometry::Camera;
use crate::lattice::Lattice;
use crate::query::{PartId, PartPoints, QueryError, Take, ViewParts, Wanted, WantedPart};
use crate::render::{Canvas, Coloring, GpuPool, Image, Legend, RenderError, RenderOptions, Renderer, View};
use crate::stream::gpu::{BLOCK_POINTS, DrawBlock, DrawList, DrawNode, PackedPoint, Paint};
use crate::stream::{Densities, set_spacings};
use anyhow::Context;
use rayon::prelude::*;
use std::collections::HashMap;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Parts that are packed before any of them is uploaded.
const WINDOW: usize = 256;
/// Under a filter it is known only after reading how many points of a part match; so often it is selected again.
const MAX_ROUNDS: usize = 8;

/// What is asked of every frame.
pub(super) struct Asked {
    pub capacity: u64,
    pub max_error_px: f64,
    pub options: RenderOptions,
    /// Does every stored point match?
    pub all_match: bool,
}

/// A renderer that is being made on a thread of its own.
///
/// It is waited for when it is dropped: a process that ends while a driver starts may be ended by the driver's signal
/// instead of with its exit code.
pub(super) struct Starting {
    began: Instant,
    thread: Option<JoinHandle<Made>>,
}

/// A renderer, and how long after the start of the command it was there.
type Made = Result<(Renderer, Duration), RenderError>;

impl Starting {
    /// For a command that began then.
    pub fn new(began: Instant) -> Self {
        let thread = std::thread::spawn(move || Ok((Renderer::new()?, began.elapsed())));
        Self { began, thread: Some(thread) }
    }

    fn renderer(mut self) -> anyhow::Result<(Renderer, Duration)> {
        let thread = self.thread.take().context("the adapter is not there")?;
        Ok(thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?)
    }
}

impl Drop for Starting {
    fn drop(&mut self) {
        // What became of it does not matter any more.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// One picture after another from one snapshot; parts stay on the adapter from one to the next.
pub(super) struct Session {
    parts: ViewParts,
    lattice: Lattice,
    coloring: Coloring,
    asked: Asked,
    /// How many points of a part match, as far as it is known.
    matching: HashMap<PartId, u32>,
    began: Instant,
    starting: Option<Starting>,
    gpu: Option<Gpu>,
}

struct Gpu {
    renderer: Renderer,
    /// From the start of the command until the adapter was there.
    ready: Duration,
    canvas: Canvas,
    resident: Resident<GpuPool>,
}

/// A part, read.
struct Read {
    key: Key,
    packed: Packed,
    matching: u32,
    bytes_read: u64,
    pack: Duration,
}

impl Session {
    /// `starting` finds the adapter meanwhile.
    pub fn new(parts: ViewParts, coloring: Coloring, asked: Asked, starting: Starting) -> Self {
        let lattice = parts.snapshot().site().lattice.clone();
        let (matching, began, starting) = (HashMap::new(), starting.began, Some(starting));
        Self { parts, lattice, coloring, asked, matching, began, starting, gpu: None }
    }

    /// The adapter's name; empty before the first frame.
    pub fn adapter_name(&self) -> &str {
        self.gpu.as_ref().map_or("", |gpu| gpu.renderer.adapter_name())
    }

    /// What the colours mean.
    pub fn legend(&self) -> &Legend {
        &self.coloring.legend
    }

    /// The camera's image.
    ///
    /// # Errors
    ///
    /// If the store can't be read or the adapter fails.
    pub fn frame(&mut self, camera: &Camera) -> anyhow::Result<(Image, FrameStatistics)> {
        let mut statistics = FrameStatistics::default();
        let mut wanted = self.select(camera, &mut statistics)?;
        for _ in 0..MAX_ROUNDS {
            let known = self.asked.all_match || wanted.parts.iter().all(|part| self.matching.contains_key(&part.id));
            self.load(&wanted, &mut statistics)?;
            if known {
                break;
            }
            wanted = self.select(camera, &mut statistics)?;
        }
        self.load(&wanted, &mut statistics)?;
        let gpu = self.gpu.as_mut().context("the adapter is not there")?;
        let started = Instant::now();
        gpu.renderer.finish()?;
        statistics.upload += started.elapsed();

        let started = Instant::now();
        let held = |part: &WantedPart| gpu.resident.get(&self.asked.key(part, &self.matching));
        let list = draw_list(&wanted, held, &self.lattice, self.coloring.paint.tag());
        let view = View { camera, options: &self.asked.options, palette: &self.coloring.palette };
        let points = gpu.resident.pool().points();
        let image = gpu.renderer.render_list(&mut gpu.canvas, &points, &list, view)?;
        statistics.draw = started.elapsed();
        statistics.points = list.points;
        statistics.nodes = list.nodes.len() as u64;
        statistics.error_px = wanted.error_bound_px;
        (statistics.adapter, statistics.elapsed) = (gpu.ready, self.began.elapsed());
        Ok((image, statistics))
    }

    /// What the camera wants, as far as it is known what matches: never more than the capacity.
    fn select(&self, camera: &Camera, statistics: &mut FrameStatistics) -> Result<Wanted, QueryError> {
        let started = Instant::now();
        let mut left = self.asked.capacity;
        let take = |id: &PartId, stored: u32| {
            let known = if self.asked.all_match { None } else { self.matching.get(id).copied() };
            let count = known.unwrap_or(stored);
            if u64::from(count) > left || left == 0 {
                return Take::First(left as u32);
            }
            left -= u64::from(count);
            Take::All(count)
        };
        let wanted = self.parts.select(camera, self.asked.max_error_px, take);
        statistics.select += started.elapsed();
        wanted
    }

    /// Loads what is wanted and not there.
    fn load(&mut self, wanted: &Wanted, statistics: &mut FrameStatistics) -> anyhow::Result<()> {
        if let Some(gpu) = &mut self.gpu {
            gpu.resident.begin(wanted.parts.iter().map(|part| self.asked.key(part, &self.matching)));
        }
        let is_missing = |part: &&WantedPart| {
            let key = self.asked.key(part, &self.matching);
            self.gpu.as_ref().is_none_or(|gpu| gpu.resident.get(&key).is_none())
        };
        let missing: Vec<WantedPart> = wanted.parts.iter().filter(is_missing).copied().collect();
        if let Some(gpu) = &mut self.gpu {
            gpu.resident.reserve(missing.iter().map(|part| part.points.div_ceil(BLOCK_POINTS) as usize).sum())?;
        }
        for window in missing.chunks(WINDOW) {
            let (started, before) = (Instant::now(), self.parts.statistics());
            let read: Vec<Read> = window.par_iter().map(|part| self.pack(part)).collect::<Result<_, _>>()?;
            let after = self.parts.statistics();
            statistics.load += started.elapsed();
            statistics.read += Duration::from_secs_f64((after.seconds_reading - before.seconds_reading).max(0.0));
            statistics.decode += Duration::from_secs_f64((after.seconds_decoding - before.seconds_decoding).max(0.0));

            let gpu = match &mut self.gpu {
                Some(gpu) => gpu,
                none => none.insert(Gpu::started(self.starting.take(), wanted, self.asked.capacity)?),
            };
            let started = Instant::now();
            for part in read {
                let points = part.packed.points.as_slice();
                statistics.parts_loaded += 1;
                statistics.points_loaded += points.len() as u64;
                statistics.bytes_read += part.bytes_read;
                statistics.bytes_uploaded += size_of_val(points) as u64;
                statistics.pack += part.pack;
                gpu.resident.insert(part.key, part.packed)?;
                self.matching.insert(part.key.0, part.matching);
            }
            statistics.upload += started.elapsed();
        }
        if self.gpu.is_none() {
            // A view of nothing is drawn, too.
            self.gpu = Some(Gpu::started(self.starting.take(), wanted, self.asked.capacity)?);
        }
        Ok(())
    }

    fn pack(&self, part: &WantedPart) -> Result<Read, QueryError> {
        let found = self.parts.read(part)?;
        let started = Instant::now();
        let matching = found.batch.len() as u32;
        let key = self.asked.key_of(part, matching);
        let points = packed_points(&found, part, key.1, &self.lattice, self.coloring.paint.as_ref());
        let densities = Densities::of(part.cube, &found.batch.positions);
        let share = points.len() as f32 / matching.max(1) as f32;
        let packed = Packed { points, densities, share };
        Ok(Read { key, packed, matching, bytes_read: found.bytes_read, pack: started.elapsed() })
    }
}

impl Asked {
    /// As what a part is in the pool.
    fn key(&self, part: &WantedPart, matching: &HashMap<PartId, u32>) -> Key {
        let all = if self.all_match { part.stored } else { matching.get(&part.id).copied().unwrap_or(part.stored) };
        self.key_of(part, all)
    }

    fn key_of(&self, part: &WantedPart, matching: u32) -> Key {
        (part.id, Some(part.points).filter(|&points| points < matching))
    }
}

impl Gpu {
    fn started(starting: Option<Starting>, wanted: &Wanted, capacity: u64) -> anyhow::Result<Self> {
        let starting = starting.context("the adapter is not there")?;
        let (renderer, ready) = starting.renderer()?;
        // What two frames of the capacity take, the last blocks of parts being half empty; the first picture alone takes
        // what it needs.
        let limit = (capacity.saturating_mul(5) / 2).div_ceil(u64::from(BLOCK_POINTS));
        let first: u32 = wanted.parts.iter().map(|part| part.points.div_ceil(BLOCK_POINTS)).sum();
        let mut resident = Resident::new(renderer.pool(0, BLOCK_POINTS)?, u32::try_from(limit).unwrap_or(u32::MAX));
        resident.reserve(first as usize)?;
        let canvas = renderer.canvas(false);
        Ok(Self { renderer, ready, canvas, resident })
    }
}

/// The points of a part: all in key order, which is fastest, or the first so many of the even order.
fn packed_points(
    found: &PartPoints,
    part: &WantedPart,
    first: Option<u32>,
    lattice: &Lattice,
    paint: &dyn Paint,
) -> Vec<PackedPoint> {
    let thinned;
    let batch = match first {
        None => &found.batch,
        Some(first) => {
            let mut order = found.even_order();
            order.truncate(first as usize);
            order.sort_unstable();
            thinned = found.batch.gathered(&order);
            &thinned
        }
    };
    let mut values = Vec::with_capacity(batch.len());
    paint.paint(batch, lattice, &mut values);
    let mut points = Vec::with_capacity(batch.len());
    PackedPoint::pack_all(part.cube, &batch.positions, &values, &mut points);
    points
}

/// All parts that are wanted, in node-key order.
fn draw_list<'r>(
    wanted: &Wanted,
    held: impl Fn(&WantedPart) -> Option<&'r Held>,
    lattice: &Lattice,
    paint: u64,
) -> DrawList {
    let mut order: Vec<usize> = (0..wanted.nodes.len()).collect();
    order.sort_by_key(|&n| (wanted.nodes[n].cube.node_key(), wanted.nodes[n].layer));
    let mut place = vec![0; order.len()];
    (0..).zip(&order).for_each(|(at, &n)| place[n] = at);
    let mut list = DrawList { complete: true, ..DrawList::empty(lattice.clone(), paint) };
    list.nodes.extend(order.iter().map(|&n| {
        let node = &wanted.nodes[n];
        let parent = node.parent.map(|p| place[p as usize]);
        DrawNode { cube: node.cube, layer: node.layer, spacing: node.spacing_before, stand_in: false, parent }
    }));
    let mut parts: Vec<(u32, u32, &WantedPart)> =
        wanted.parts.iter().map(|part| (place[part.node as usize], part.part, part)).collect();
    parts.sort_unstable_by_key(|&(node, part, _)| (node, part));
    let mut counted = Vec::with_capacity(parts.len());
    for (node, number, part) in parts {
        // Parts come in order, so the last one says how fine the node is drawn.
        list.nodes[node as usize].spacing = part.spacing;
        let Some(held) = held(part) else { continue };
        counted.push((node, &held.densities, held.share));
        let mut first = 0;
        for &block in &held.blocks {
            let points = (held.points - first).min(BLOCK_POINTS);
            list.blocks.push(DrawBlock { block, points, node, part: number, first });
            list.points += u64::from(points);
            first += points;
        }
    }
    set_spacings(&mut list, counted);
    list
}

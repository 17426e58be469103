//! Chunks of LAZ point formats 6, 7 and 8, decoded layer by layer.
//!
//! LASzip compresses these formats field by field: a chunk has its first record, its count, and then a *layer* of bytes for
//! scanner channels, returns, X and Y together, one for each other field, and one for each extra byte. What the first layer says
//! of a record is the context of the others. The format is that of LASzip (`laswriteitemcompressed_v3.cpp`, by M. Isenburg), which
//! the `laz` crate follows; the tests hold this decoder to that crate, on whole and on damaged chunks.
//!
//! It is here because reading is most of what an ingest of LAZ takes, and this takes six tenths of the crate's time
//! (`examples/laz_decode.rs`). The crate decodes all other formats, and encodes all.

mod channels;
mod coder;
mod fields;
mod integer;
mod items;
mod median;
mod point;
#[cfg(test)]
mod tests;
mod time;

use coder::{Coder, State};
use fields::Layer;
use laz::{LazItem, LazItemType};
use point::Points;

/// Bytes of the point itself.
const POINT_BYTES: usize = 30;
/// Layers of the point.
const POINT_LAYERS: usize = 9;
/// Records after which it is looked whether the layers have ended.
const BLOCK: usize = 256;

/// Which layers the chunks of a file have.
#[derive(Clone, Debug)]
pub struct Layers {
    record_bytes: usize,
    /// Version of the point's item.
    version: u16,
    /// Version and place of the colours' item.
    colors: Option<(u16, usize)>,
    infrared: Option<(u16, usize)>,
    /// Version, place and number of the extra bytes.
    extra: Option<(u16, usize, usize)>,
}

impl Layers {
    /// Of the items of a point format; `None` if they are others than are decoded here.
    pub fn new(items: &[LazItem]) -> Option<Self> {
        let mut layers = Self { record_bytes: 0, version: 0, colors: None, infrared: None, extra: None };
        for item in items {
            let (at, version) = (layers.record_bytes, item.version());
            match item.item_type() {
                LazItemType::Point14 if at == 0 => layers.version = version,
                LazItemType::RGB14 => layers.colors = Some((version, at)),
                LazItemType::RGBNIR14 => {
                    layers.colors = Some((version, at));
                    layers.infrared = Some((version, at + 6));
                }
                LazItemType::Byte14(bytes) => layers.extra = Some((version, at, bytes.into())),
                _ => return None,
            }
            layers.record_bytes += usize::from(item.size());
        }
        (layers.version != 0).then_some(layers)
    }

    /// Begins the decoding of a chunk; `None` if it ends before its layers do.
    pub fn open(&self, chunk: Vec<u8>) -> Option<Chunk> {
        let first: &[u8; POINT_BYTES] = chunk.first_chunk()?;
        let record = chunk.get(..self.record_bytes)?;
        let channel = point::channel_of(first);
        // The count of records, then the layers' sizes.
        let sizes = self.record_bytes + 4;
        let mut start = sizes + 4 * self.layers();
        let states = chunk.get(sizes..start)?.as_chunks::<4>().0.iter().map(|&size| {
            let size = usize::try_from(u32::from_le_bytes(size)).ok()?;
            let layer = start..start.checked_add(size)?;
            start = layer.end;
            Some((size > 0).then(|| State::new(&chunk, layer.start, layer.end)))
        });
        let states: Vec<Option<State>> = states.collect::<Option<_>>()?;
        if start > chunk.len() {
            return None;
        }
        let mut states = states.into_iter();
        let mut state = || states.next().flatten();
        let (version, extra, bytes) = self.extra.unwrap_or_default();
        Some(Chunk {
            stride: self.record_bytes,
            begun: false,
            points: Points::new(self.version, first),
            first_layer: state(),
            heights: Layer::new(fields::Heights::new(first), state()),
            classes: Layer::new(fields::Classes::new(first), state()),
            flags: Layer::new(fields::Flags::new(first), state()),
            intensities: Layer::new(fields::Intensities::new(first), state()),
            angles: Layer::new(fields::Angles::new(first), state()),
            user_data: Layer::new(fields::UserData::new(first), state()),
            sources: Layer::new(fields::PointSources::new(first), state()),
            times: Layer::new(fields::GpsTimes::new(first), state()),
            colors: self
                .colors
                .map(|(version, at)| Layer::new(items::Colors::new(version, channel, at, record), state())),
            infrared: self
                .infrared
                .map(|(version, at)| Layer::new(items::Infrared::new(version, channel, at, record), state())),
            extra: (extra..extra + bytes)
                .map(|at| Layer::new(items::ExtraByte::new(version, channel, at, record), state()))
                .collect(),
            bytes: chunk,
        })
    }

    fn layers(&self) -> usize {
        let items = usize::from(self.colors.is_some()) + usize::from(self.infrared.is_some());
        POINT_LAYERS + items + self.extra.map_or(0, |(_, _, bytes)| bytes)
    }
}

/// A chunk that is being decoded.
///
/// A layer is one long chain of steps that each wait for the last, but it waits for no other layer than the first. So all are
/// decoded record by record, for a processor to work on several of them at a time: the first symbols of all fields, which
/// nothing has to be known for, then the rest, and between them, step by step, the first layer of the record after.
pub struct Chunk {
    bytes: Vec<u8>,
    stride: usize,
    /// Has the first record been given?
    begun: bool,
    points: Points,
    /// `None` if it has no bytes: in a chunk of one record.
    first_layer: Option<State>,
    heights: Layer<fields::Heights>,
    classes: Layer<fields::Classes>,
    flags: Layer<fields::Flags>,
    intensities: Layer<fields::Intensities>,
    angles: Layer<fields::Angles>,
    user_data: Layer<fields::UserData>,
    sources: Layer<fields::PointSources>,
    times: Layer<fields::GpsTimes>,
    colors: Option<Layer<items::Colors>>,
    infrared: Option<Layer<items::Infrared>>,
    extra: Vec<Layer<items::ExtraByte>>,
}

impl Chunk {
    /// Decodes as many records as `out` has room for; false if a layer ends before.
    pub fn decode(&mut self, out: &mut [u8]) -> bool {
        let mut out = out;
        if !self.begun {
            let Some((first, rest)) = out.split_at_mut_checked(self.stride) else { return true };
            first.copy_from_slice(&self.bytes[..self.stride]);
            self.begun = true;
            out = rest;
        }
        out.chunks_mut(BLOCK * self.stride).all(|block| self.block(block))
    }

    fn block(&mut self, out: &mut [u8]) -> bool {
        let Some(state) = &mut self.first_layer else { return false };
        let bytes = &self.bytes[..];
        let mut coder = Coder::new(bytes, state);
        let Some((first, mut rest)) = out.split_at_mut_checked(self.stride) else { return true };
        let mut record = first;
        let mut mark = self.points.record(&mut coder, record);
        loop {
            let next = rest.split_at_mut_checked(self.stride);
            let changes = next.is_some().then(|| self.points.begin(&mut coder));
            let height = self.heights.begin(bytes, &mark);
            let class = self.classes.begin(bytes, &mark);
            let flags = self.flags.begin(bytes, &mark);
            let mut open = changes.map(|changes| self.points.begin_x(&mut coder, changes));
            let intensity = self.intensities.begin(bytes, &mark);
            let user_data = self.user_data.begin(bytes, &mark);
            let time = self.times.begin(bytes, &mark);
            let color = self.colors.as_mut().map(|colors| colors.begin(bytes, &mark)).unwrap_or_default();
            let infrared = self.infrared.as_mut().map(|infrared| infrared.begin(bytes, &mark)).unwrap_or_default();
            if let Some(open) = &open {
                self.points.finish_x(&mut coder, open);
            }
            self.heights.finish(bytes, &mark, height, record);
            self.classes.finish(bytes, &mark, class, record);
            self.flags.finish(bytes, &mark, flags, record);
            if let Some(open) = &mut open {
                self.points.begin_y(&mut coder, open);
            }
            self.intensities.finish(bytes, &mark, intensity, record);
            self.angles.finish(bytes, &mark, (), record);
            self.user_data.finish(bytes, &mark, user_data, record);
            self.sources.finish(bytes, &mark, (), record);
            self.times.finish(bytes, &mark, time, record);
            if let Some(colors) = &mut self.colors {
                colors.finish(bytes, &mark, color, record);
            }
            if let Some(layer) = &mut self.infrared {
                layer.finish(bytes, &mark, infrared, record);
            }
            for extra in &mut self.extra {
                let value = extra.begin(bytes, &mark);
                extra.finish(bytes, &mark, value, record);
            }
            let (Some((next, after)), Some(open)) = (next, open) else { break };
            mark = self.points.finish_y(&mut coder, open, next);
            (record, rest) = (next, after);
        }
        !self.is_exhausted()
    }

    /// Has more been read of any layer than it has?
    fn is_exhausted(&self) -> bool {
        self.first_layer.is_some_and(|state| state.is_exhausted())
            || self.heights.is_exhausted()
            || self.classes.is_exhausted()
            || self.flags.is_exhausted()
            || self.intensities.is_exhausted()
            || self.angles.is_exhausted()
            || self.user_data.is_exhausted()
            || self.sources.is_exhausted()
            || self.times.is_exhausted()
            || self.colors.as_ref().is_some_and(Layer::is_exhausted)
            || self.infrared.as_ref().is_some_and(Layer::is_exhausted)
            || self.extra.iter().any(Layer::is_exhausted)
    }
}

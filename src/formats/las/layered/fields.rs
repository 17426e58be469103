//! The layers of a record's other standard fields. One that no record of the chunk changes has no bytes.

use super::channels::Channels;
use super::coder::{Coder, Model64, Model256, State};
use super::integer::Differences;
use super::point::{Mark, channel_of};
use super::time::Times;

/// A field with a layer of its own.
pub trait Field {
    /// What the first symbol of a record says.
    type Begun: Copy + Default;

    /// Decodes the first symbol of the field of a record that the first layer's decoder has marked.
    fn begin(&mut self, coder: &mut Coder<'_>, mark: &Mark) -> Self::Begun;

    /// Decodes the rest.
    fn finish(&mut self, coder: &mut Coder<'_>, mark: &Mark, begun: Self::Begun, record: &mut [u8]);

    /// Gives a record what the first one has, as all do.
    fn repeat(&mut self, mark: &Mark, record: &mut [u8]);
}

/// A field and its layer.
pub struct Layer<F> {
    field: F,
    /// `None` if it has no bytes.
    state: Option<State>,
}

impl<F: Field> Layer<F> {
    pub fn new(field: F, state: Option<State>) -> Self {
        Self { field, state }
    }

    /// Has more been read than the layer has?
    pub fn is_exhausted(&self) -> bool {
        self.state.is_some_and(|state| state.is_exhausted())
    }

    /// Begins to decode a record's field.
    #[inline(always)]
    pub fn begin(&mut self, chunk: &[u8], mark: &Mark) -> F::Begun {
        match &mut self.state {
            Some(state) => self.field.begin(&mut Coder::new(chunk, state), mark),
            None => F::Begun::default(),
        }
    }

    /// Gives the record its field.
    #[inline(always)]
    pub fn finish(&mut self, chunk: &[u8], mark: &Mark, begun: F::Begun, record: &mut [u8]) {
        match &mut self.state {
            Some(state) => self.field.finish(&mut Coder::new(chunk, state), mark, begun, record),
            None => self.field.repeat(mark, record),
        }
    }
}

/// Bytes of a record.
pub fn bytes<const N: usize>(record: &[u8], at: usize) -> [u8; N] {
    std::array::from_fn(|i| record[at + i])
}

/// Puts them there.
pub fn put<const N: usize>(record: &mut [u8], at: usize, value: [u8; N]) {
    record[at..at + N].copy_from_slice(&value);
}

/// Models that are made when they are first used.
struct Models<M, const N: usize>([Option<Box<M>>; N]);

impl<M, const N: usize> Models<M, N> {
    fn new() -> Self {
        Self(std::array::from_fn(|_| None))
    }

    #[inline(always)]
    fn at(&mut self, at: usize, make: impl FnOnce() -> M) -> &mut M {
        self.0[at % N].get_or_insert_with(|| Box::new(make()))
    }
}

/// Z.
pub struct Heights(Channels<(i32, [i32; 8], Differences)>);

impl Heights {
    pub fn new(first: &[u8; 30]) -> Self {
        Self(Channels::new(channel_of(first), Self::after(i32::from_le_bytes(bytes(first, 8)))))
    }

    fn after(z: i32) -> (i32, [i32; 8], Differences) {
        (z, [z; 8], Differences::new(32, 20))
    }
}

impl Field for Heights {
    type Begun = u32;

    #[inline(always)]
    fn begin(&mut self, coder: &mut Coder<'_>, mark: &Mark) -> u32 {
        let (_, _, differences) = self.0.of(mark.channel, |(last, ..)| Self::after(*last));
        differences.begin(coder, mark.height.into())
    }

    #[inline(always)]
    fn finish(&mut self, coder: &mut Coder<'_>, mark: &Mark, bits: u32, record: &mut [u8]) {
        let (last, levels, differences) = self.0.current();
        let level = &mut levels[usize::from(mark.level % 8)];
        *level = level.wrapping_add(differences.finish(coder, bits));
        *last = *level;
        put(record, 8, last.to_le_bytes());
    }

    fn repeat(&mut self, _: &Mark, record: &mut [u8]) {
        put(record, 8, self.0.current().0.to_le_bytes());
    }
}

/// Classification.
pub struct Classes(Channels<(u8, Models<Model256, 64>)>);

impl Classes {
    pub fn new(first: &[u8; 30]) -> Self {
        Self(Channels::new(channel_of(first), (first[16], Models::new())))
    }
}

impl Field for Classes {
    type Begun = u8;

    #[inline(always)]
    fn begin(&mut self, coder: &mut Coder<'_>, mark: &Mark) -> u8 {
        let (last, models) = self.0.of(mark.channel, |(last, _)| (*last, Models::new()));
        let context = usize::from(*last & 31) << 1 | usize::from(mark.place == 3);
        *last = coder.symbol(models.at(context, || Model256::new(256))) as u8;
        *last
    }

    #[inline(always)]
    fn finish(&mut self, _: &mut Coder<'_>, _: &Mark, class: u8, record: &mut [u8]) {
        record[16] = class;
    }

    fn repeat(&mut self, _: &Mark, record: &mut [u8]) {
        record[16] = self.0.current().0;
    }
}

/// The byte of flags, of which the scanner channel is known: classification flags, scan direction, edge of flight line.
pub struct Flags(Channels<(u8, Models<Model64, 64>)>);

impl Flags {
    pub fn new(first: &[u8; 30]) -> Self {
        let flags = first[15] & 15 | first[15] >> 2 & 0b11_0000;
        Self(Channels::new(channel_of(first), (flags, Models::new())))
    }

    fn put(flags: u8, mark: &Mark, record: &mut [u8]) {
        record[15] = flags & 15 | (flags & 0b11_0000) << 2 | mark.channel << 4;
    }
}

impl Field for Flags {
    type Begun = u8;

    #[inline(always)]
    fn begin(&mut self, coder: &mut Coder<'_>, mark: &Mark) -> u8 {
        let (last, models) = self.0.of(mark.channel, |(last, _)| (*last, Models::new()));
        *last = coder.symbol(models.at((*last).into(), || Model64::new(64))) as u8;
        *last
    }

    #[inline(always)]
    fn finish(&mut self, _: &mut Coder<'_>, mark: &Mark, flags: u8, record: &mut [u8]) {
        Self::put(flags, mark, record);
    }

    fn repeat(&mut self, mark: &Mark, record: &mut [u8]) {
        Self::put(self.0.current().0, mark, record);
    }
}

/// Intensity.
pub struct Intensities(Channels<(u16, [u16; 8], Differences)>);

impl Intensities {
    pub fn new(first: &[u8; 30]) -> Self {
        Self(Channels::new(channel_of(first), Self::after(u16::from_le_bytes(bytes(first, 12)))))
    }

    fn after(last: u16) -> (u16, [u16; 8], Differences) {
        (last, [last; 8], Differences::new(16, 4))
    }
}

impl Field for Intensities {
    type Begun = u32;

    #[inline(always)]
    fn begin(&mut self, coder: &mut Coder<'_>, mark: &Mark) -> u32 {
        let (_, _, differences) = self.0.of(mark.channel, |(last, ..)| Self::after(*last));
        differences.begin(coder, mark.place.into())
    }

    #[inline(always)]
    fn finish(&mut self, coder: &mut Coder<'_>, mark: &Mark, bits: u32, record: &mut [u8]) {
        let (last, lasts, differences) = self.0.current();
        let of_kind = &mut lasts[usize::from(mark.place % 4) << 1 | usize::from(mark.time_changed)];
        *of_kind = of_kind.wrapping_add(differences.finish(coder, bits) as u16);
        *last = *of_kind;
        put(record, 12, last.to_le_bytes());
    }

    fn repeat(&mut self, _: &Mark, record: &mut [u8]) {
        put(record, 12, self.0.current().0.to_le_bytes());
    }
}

/// A `u16` that is decoded where it is said to have changed: scan angle or point source.
struct Changing<const AT: usize, const CONTEXTS: usize>(Channels<(u16, Differences)>);

impl<const AT: usize, const CONTEXTS: usize> Changing<AT, CONTEXTS> {
    fn new(first: &[u8; 30]) -> Self {
        Self(Channels::new(channel_of(first), Self::after(u16::from_le_bytes(bytes(first, AT)))))
    }

    fn after(last: u16) -> (u16, Differences) {
        (last, Differences::new(16, CONTEXTS))
    }

    #[inline(always)]
    fn record(&mut self, coder: &mut Coder<'_>, channel: u8, changed: bool, context: usize, record: &mut [u8]) {
        let (last, differences) = self.0.of(channel, |(last, _)| Self::after(*last));
        if changed {
            *last = last.wrapping_add(differences.next(coder, context).0 as u16);
        }
        put(record, AT, last.to_le_bytes());
    }

    fn repeat(&mut self, record: &mut [u8]) {
        put(record, AT, self.0.current().0.to_le_bytes());
    }
}

/// Scan angle.
pub struct Angles(Changing<18, 2>);

impl Angles {
    pub fn new(first: &[u8; 30]) -> Self {
        Self(Changing::new(first))
    }
}

impl Field for Angles {
    type Begun = ();

    fn begin(&mut self, _: &mut Coder<'_>, _: &Mark) {}

    fn finish(&mut self, coder: &mut Coder<'_>, mark: &Mark, (): (), record: &mut [u8]) {
        self.0.record(coder, mark.channel, mark.angle_changed, mark.time_changed.into(), record);
    }

    fn repeat(&mut self, _: &Mark, record: &mut [u8]) {
        self.0.repeat(record);
    }
}

/// Point source.
pub struct PointSources(Changing<20, 1>);

impl PointSources {
    pub fn new(first: &[u8; 30]) -> Self {
        Self(Changing::new(first))
    }
}

impl Field for PointSources {
    type Begun = ();

    fn begin(&mut self, _: &mut Coder<'_>, _: &Mark) {}

    #[inline(always)]
    fn finish(&mut self, coder: &mut Coder<'_>, mark: &Mark, (): (), record: &mut [u8]) {
        self.0.record(coder, mark.channel, mark.source_changed, 0, record);
    }

    fn repeat(&mut self, _: &Mark, record: &mut [u8]) {
        self.0.repeat(record);
    }
}

/// User data.
pub struct UserData(Channels<(u8, Models<Model256, 64>)>);

impl UserData {
    pub fn new(first: &[u8; 30]) -> Self {
        Self(Channels::new(channel_of(first), (first[17], Models::new())))
    }
}

impl Field for UserData {
    type Begun = u8;

    #[inline(always)]
    fn begin(&mut self, coder: &mut Coder<'_>, mark: &Mark) -> u8 {
        let (last, models) = self.0.of(mark.channel, |(last, _)| (*last, Models::new()));
        *last = coder.symbol(models.at(usize::from(*last / 4), || Model256::new(256))) as u8;
        *last
    }

    #[inline(always)]
    fn finish(&mut self, _: &mut Coder<'_>, _: &Mark, data: u8, record: &mut [u8]) {
        record[17] = data;
    }

    fn repeat(&mut self, _: &Mark, record: &mut [u8]) {
        record[17] = self.0.current().0;
    }
}

/// GPS time.
pub struct GpsTimes(Channels<(i64, Times)>);

impl GpsTimes {
    pub fn new(first: &[u8; 30]) -> Self {
        let bits = i64::from_le_bytes(bytes(first, 22));
        Self(Channels::new(channel_of(first), (bits, Times::new(bits))))
    }
}

impl Field for GpsTimes {
    type Begun = usize;

    #[inline(always)]
    fn begin(&mut self, coder: &mut Coder<'_>, mark: &Mark) -> usize {
        let (_, times) = self.0.of(mark.channel, |(last, _)| (*last, Times::new(*last)));
        if mark.time_changed { times.begin(coder) } else { 0 }
    }

    #[inline(always)]
    fn finish(&mut self, coder: &mut Coder<'_>, mark: &Mark, code: usize, record: &mut [u8]) {
        let (last, times) = self.0.current();
        if mark.time_changed {
            *last = times.finish(coder, code);
        }
        put(record, 22, last.to_le_bytes());
    }

    fn repeat(&mut self, _: &Mark, record: &mut [u8]) {
        put(record, 22, self.0.current().0.to_le_bytes());
    }
}

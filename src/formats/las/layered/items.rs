//! The layers behind the point itself: colours, near infrared, extra bytes.

use super::channels::Followed;
use super::coder::{Coder, Model16, Model128, Model256};
use super::fields::{Field, bytes, put};
use super::point::Mark;

/// A value for each scanner channel, and which of them a record goes by.
struct Lasts<T> {
    followed: Followed,
    values: [T; 4],
    /// Where the value is in a record.
    at: usize,
}

impl<T: Copy> Lasts<T> {
    fn new(version: u16, channel: u8, at: usize, first: T) -> Self {
        Self { followed: Followed::new(version, channel), values: [first; 4], at }
    }

    /// The channel whose models a record uses, and that whose value it follows.
    #[inline(always)]
    fn step(&mut self, mark: &Mark) -> (usize, usize) {
        self.followed.step(mark, &mut self.values)
    }
}

/// Models of the four scanner channels, made when they are first used.
struct OfChannels<M>([Option<Box<M>>; 4]);

impl<M> OfChannels<M> {
    fn new() -> Self {
        Self([const { None }; 4])
    }

    #[inline(always)]
    fn of(&mut self, channel: usize, make: impl FnOnce() -> M) -> &mut M {
        self.0[channel % 4].get_or_insert_with(|| Box::new(make()))
    }
}

struct ColorModels {
    changes: Model128,
    /// Low and high byte of red, green, blue.
    bytes: [Model256; 6],
}

/// Red, green and blue.
pub struct Colors {
    lasts: Lasts<[u16; 3]>,
    models: OfChannels<ColorModels>,
}

impl Colors {
    /// After a first record with this colour; `at` is its place there.
    pub fn new(version: u16, channel: u8, at: usize, first: &[u8]) -> Self {
        let first = std::array::from_fn(|band| u16::from_le_bytes(bytes(first, at + 2 * band)));
        Self { lasts: Lasts::new(version, channel, at, first), models: OfChannels::new() }
    }
}

fn put_color(color: [u16; 3], record: &mut [u8], at: usize) {
    for (band, value) in color.into_iter().enumerate() {
        put(record, at + 2 * band, value.to_le_bytes());
    }
}

impl Field for Colors {
    /// The channel whose models are used, that whose value is followed, and what changes.
    type Begun = (usize, usize, usize);

    #[inline(always)]
    fn begin(&mut self, coder: &mut Coder<'_>, mark: &Mark) -> Self::Begun {
        let (channel, follows) = self.lasts.step(mark);
        let models = self.models.of(channel, || ColorModels {
            changes: Model128::new(128),
            bytes: std::array::from_fn(|_| Model256::new(256)),
        });
        (channel, follows, coder.symbol(&mut models.changes))
    }

    #[inline(always)]
    fn finish(&mut self, coder: &mut Coder<'_>, _: &Mark, (channel, follows, changes): Self::Begun, record: &mut [u8]) {
        let at = self.lasts.at;
        let last = &mut self.lasts.values[follows % 4];
        let Some(models) = &mut self.models.0[channel % 4] else { return };
        let is_gray = changes & 1 << 6 == 0;
        let [old_red, old_green, old_blue] = last.map(u16::to_le_bytes);
        let mut byte = |which: usize, predicted: u8, old: u8| {
            if changes & 1 << which == 0 {
                return old;
            }
            predicted.wrapping_add(coder.symbol(&mut models.bytes[which]) as u8)
        };
        let red = [byte(0, old_red[0], old_red[0]), byte(1, old_red[1], old_red[1])];
        let (mut green, mut blue) = (red, red);
        if !is_gray {
            // Green goes the way of red, and blue that of both.
            for i in 0..2 {
                let moved = |now: u8, old: u8| i32::from(now) - i32::from(old);
                let predicted = |way: i32, old: u8| (way + i32::from(old)).clamp(0, 255) as u8;
                let way = moved(red[i], old_red[i]);
                green[i] = byte(2 + i, predicted(way, old_green[i]), old_green[i]);
                let way = (way + moved(green[i], old_green[i])) / 2;
                blue[i] = byte(4 + i, predicted(way, old_blue[i]), old_blue[i]);
            }
        }
        *last = [red, green, blue].map(u16::from_le_bytes);
        put_color(*last, record, at);
    }

    fn repeat(&mut self, _: &Mark, record: &mut [u8]) {
        put_color(self.lasts.values[0], record, self.lasts.at);
    }
}

struct InfraredModels {
    changes: Model16,
    bytes: [Model256; 2],
}

/// Near infrared.
pub struct Infrared {
    lasts: Lasts<[u8; 2]>,
    models: OfChannels<InfraredModels>,
}

impl Infrared {
    /// After a first record with this value; `at` is its place there.
    pub fn new(version: u16, channel: u8, at: usize, first: &[u8]) -> Self {
        let first = [first[at], first[at + 1]];
        Self { lasts: Lasts::new(version, channel, at, first), models: OfChannels::new() }
    }
}

impl Field for Infrared {
    /// The channel whose models are used, that whose value is followed, and what changes.
    type Begun = (usize, usize, usize);

    #[inline(always)]
    fn begin(&mut self, coder: &mut Coder<'_>, mark: &Mark) -> Self::Begun {
        let (channel, follows) = self.lasts.step(mark);
        let models = self.models.of(channel, || InfraredModels {
            changes: Model16::new(4),
            bytes: std::array::from_fn(|_| Model256::new(256)),
        });
        (channel, follows, coder.symbol(&mut models.changes))
    }

    #[inline(always)]
    fn finish(&mut self, coder: &mut Coder<'_>, _: &Mark, (channel, follows, changes): Self::Begun, record: &mut [u8]) {
        let at = self.lasts.at;
        let value = &mut self.lasts.values[follows % 4];
        let Some(models) = &mut self.models.0[channel % 4] else { return };
        for (bit, (byte, model)) in value.iter_mut().zip(&mut models.bytes).enumerate() {
            if changes & 1 << bit != 0 {
                *byte = byte.wrapping_add(coder.symbol(model) as u8);
            }
        }
        record[at..at + 2].copy_from_slice(value);
    }

    fn repeat(&mut self, _: &Mark, record: &mut [u8]) {
        record[self.lasts.at..self.lasts.at + 2].copy_from_slice(&self.lasts.values[0]);
    }
}

/// One of the extra bytes.
pub struct ExtraByte {
    lasts: Lasts<u8>,
    models: OfChannels<Model256>,
}

impl ExtraByte {
    /// After a first record with this byte; `at` is its place there.
    pub fn new(version: u16, channel: u8, at: usize, first: &[u8]) -> Self {
        Self { lasts: Lasts::new(version, channel, at, first[at]), models: OfChannels::new() }
    }
}

impl Field for ExtraByte {
    type Begun = u8;

    #[inline(always)]
    fn begin(&mut self, coder: &mut Coder<'_>, mark: &Mark) -> u8 {
        let (channel, follows) = self.lasts.step(mark);
        let value = &mut self.lasts.values[follows % 4];
        *value = value.wrapping_add(coder.symbol(self.models.of(channel, || Model256::new(256))) as u8);
        *value
    }

    #[inline(always)]
    fn finish(&mut self, _: &mut Coder<'_>, _: &Mark, value: u8, record: &mut [u8]) {
        record[self.lasts.at] = value;
    }

    fn repeat(&mut self, _: &Mark, record: &mut [u8]) {
        record[self.lasts.at] = self.lasts.values[0];
    }
}

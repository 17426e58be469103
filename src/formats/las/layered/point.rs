//! The first layer: scanner channels, returns, X and Y. What it decodes the other layers go by.

use super::channels::Channels;
use super::coder::{Coder, Model16, Model128};
use super::integer::Differences;
use super::median::Median;

/// What the other layers need to know of a record.
#[derive(Clone, Copy, Debug, Default)]
pub struct Mark {
    /// Its scanner channel, 0 to 3.
    pub channel: u8,
    /// The one that items behind the point go by.
    pub followed: u8,
    /// Place among the returns of its pulse: 3 single, 2 first, 1 last, 0 between.
    pub place: u8,
    /// Returns between it and the last one of its pulse, roughly; at most 7.
    pub level: u8,
    /// The context of its height.
    pub height: u8,
    /// Differs its GPS time from that of the record before in its channel?
    pub time_changed: bool,
    /// Its scan angle?
    pub angle_changed: bool,
    /// Its point source?
    pub source_changed: bool,
}

/// Contexts of steps in X and Y by number of returns (rows) and return number.
const STEP_CONTEXTS: [[u8; 16]; 16] = [
    [0, 1, 2, 3, 4, 5, 3, 4, 4, 5, 5, 5, 5, 5, 5, 5],
    [1, 0, 1, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3],
    [2, 1, 2, 4, 4, 4, 4, 4, 4, 4, 4, 3, 3, 3, 3, 3],
    [3, 3, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [4, 3, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [5, 3, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [3, 3, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4, 4],
    [4, 3, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4, 4],
    [4, 3, 4, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4, 4],
    [5, 3, 4, 4, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4, 4],
    [5, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 4, 4, 4, 4, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 4, 4, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5, 4, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5, 4],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5, 5],
    [5, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 4, 5, 5],
];

struct Channel {
    x: i32,
    y: i32,
    /// Return number in the low four bits, number of returns in the high ones.
    returns: u8,
    time_changed: bool,
    x_steps: [Median; 12],
    y_steps: [Median; 12],
    changes: [Model128; 8],
    switches: Model16,
    counts: [Option<Box<Model16>>; 16],
    numbers: [Option<Box<Model16>>; 16],
    number_steps: Model16,
    dx: Differences,
    dy: Differences,
}

impl Channel {
    fn after(x: i32, y: i32, returns: u8) -> Self {
        Self {
            x,
            y,
            returns,
            time_changed: false,
            x_steps: [Median::default(); 12],
            y_steps: [Median::default(); 12],
            changes: std::array::from_fn(|_| Model128::new(128)),
            switches: Model16::new(3),
            counts: Default::default(),
            numbers: Default::default(),
            number_steps: Model16::new(13),
            dx: Differences::new(32, 2),
            dy: Differences::new(32, 22),
        }
    }
}

/// The layer, record by record.
pub struct Points {
    version: u16,
    channels: Channels<Channel>,
}

/// A step's context by its magnitude: even ones up to `most`, each for one return of a pulse or for several.
fn by_magnitude(bits: u32, most: u32, single: bool) -> usize {
    (bits.min(most) & !1) as usize | usize::from(single)
}

/// The model for a last count or number of returns.
fn returns_model(models: &mut [Option<Box<Model16>>; 16], last: u8) -> &mut Model16 {
    models[usize::from(last % 16)].get_or_insert_with(|| Box::new(Model16::new(16)))
}

impl Points {
    /// After the chunk's first record.
    pub fn new(version: u16, first: &[u8; 30]) -> Self {
        let [x, y] = [0, 4].map(|at| i32::from_le_bytes(std::array::from_fn(|i| first[at + i])));
        Self { version, channels: Channels::new(channel_of(first), Channel::after(x, y, first[14])) }
    }

    /// Begins a record: what changes from the one before.
    #[inline(always)]
    pub fn begin(&mut self, coder: &mut Coder<'_>) -> usize {
        let before = self.channels.current();
        let (r, n) = (before.returns & 15, before.returns >> 4);
        let context = usize::from(r == 1) | usize::from(r >= n) << 1 | usize::from(before.time_changed) << 2;
        coder.symbol(&mut before.changes[context])
    }

    /// Decodes channel and returns, and begins X.
    #[inline(always)]
    pub fn begin_x(&mut self, coder: &mut Coder<'_>, changes: usize) -> Open {
        let mut mark = Mark::default();
        let mut number = self.channels.channel();
        let switches = changes & 1 << 6 != 0;
        if switches {
            let step = coder.symbol(&mut self.channels.current().switches) as u8;
            number = (number + step + 1) % 4;
        }
        mark.channel = number;
        // In version 3 the other items are told of a channel only where it changes, and else take it for 0.
        mark.followed = if switches || self.version != 3 { number } else { 0 };
        mark.source_changed = changes & 1 << 5 != 0;
        mark.time_changed = changes & 1 << 4 != 0;
        mark.angle_changed = changes & 1 << 3 != 0;
        let channel = self.channels.of(number, |last| Channel::after(last.x, last.y, last.returns));

        let (last_r, last_n) = (channel.returns & 15, channel.returns >> 4);
        let n =
            if changes & 1 << 2 == 0 { last_n } else { coder.symbol(returns_model(&mut channel.counts, last_n)) as u8 };
        let r = match changes & 3 {
            0 => last_r,
            1 => (last_r + 1) % 16,
            2 => (last_r + 15) % 16,
            _ if mark.time_changed => coder.symbol(returns_model(&mut channel.numbers, last_r)) as u8,
            _ => (last_r + coder.symbol(&mut channel.number_steps) as u8 + 2) % 16,
        };
        channel.returns = n << 4 | r;
        channel.time_changed = mark.time_changed;
        mark.place = u8::from(r == 1) << 1 | u8::from(r >= n);
        mark.level = n.abs_diff(r).min(7);

        let single = n == 1;
        let context =
            usize::from(STEP_CONTEXTS[usize::from(n % 16)][usize::from(r)]) << 1 | usize::from(mark.time_changed);
        let x_bits = channel.dx.begin(coder, single.into());
        Open { mark, single, context, x_bits, y_bits: 0 }
    }

    /// Decodes the rest of X.
    #[inline(always)]
    pub fn finish_x(&mut self, coder: &mut Coder<'_>, open: &Open) {
        let channel = self.channels.current();
        let steps = &mut channel.x_steps[open.context % 12];
        let step = steps.get().wrapping_add(channel.dx.finish(coder, open.x_bits));
        steps.add(step);
        channel.x = channel.x.wrapping_add(step);
    }

    /// Begins Y.
    #[inline(always)]
    pub fn begin_y(&mut self, coder: &mut Coder<'_>, open: &mut Open) {
        let channel = self.channels.current();
        open.y_bits = channel.dy.begin(coder, by_magnitude(open.x_bits, 20, open.single));
    }

    /// Decodes the rest of Y, and gives the record what the layer has of it.
    #[inline(always)]
    pub fn finish_y(&mut self, coder: &mut Coder<'_>, open: Open, record: &mut [u8]) -> Mark {
        let Open { mark, single, context, x_bits, y_bits } = open;
        let channel = self.channels.current();
        let steps = &mut channel.y_steps[context % 12];
        let step = steps.get().wrapping_add(channel.dy.finish(coder, y_bits));
        steps.add(step);
        channel.y = channel.y.wrapping_add(step);

        record[..4].copy_from_slice(&channel.x.to_le_bytes());
        record[4..8].copy_from_slice(&channel.y.to_le_bytes());
        record[14] = channel.returns;
        Mark { height: by_magnitude(x_bits.midpoint(y_bits), 18, single) as u8, ..mark }
    }

    /// Decodes what it has of a record.
    pub fn record(&mut self, coder: &mut Coder<'_>, record: &mut [u8]) -> Mark {
        let changes = self.begin(coder);
        let mut open = self.begin_x(coder, changes);
        self.finish_x(coder, &open);
        self.begin_y(coder, &mut open);
        self.finish_y(coder, open, record)
    }
}

/// A record of which X and Y are being decoded.
pub struct Open {
    mark: Mark,
    /// Is it the only return of its pulse?
    single: bool,
    /// Of the steps in X and Y.
    context: usize,
    x_bits: u32,
    y_bits: u32,
}

/// The scanner channel in a record's flags.
pub fn channel_of(record: &[u8; 30]) -> u8 {
    record[15] >> 4 & 3
}

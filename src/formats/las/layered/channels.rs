//! What a layer remembers of each scanner channel.

use super::point::Mark;

/// A state for each of the four scanner channels that came; that of a channel which comes for the first time begins with what
/// the channel before it had last.
pub struct Channels<T> {
    /// In the order in which their channels came.
    states: Vec<T>,
    /// The place of each channel's state.
    places: [Option<usize>; 4],
    channel: u8,
    current: usize,
}

impl<T> Channels<T> {
    /// With the state of the first record's channel.
    pub fn new(channel: u8, first: T) -> Self {
        let mut places = [None; 4];
        places[usize::from(channel % 4)] = Some(0);
        Self { states: vec![first], places, channel: channel % 4, current: 0 }
    }

    /// The channel of the last record.
    pub fn channel(&self) -> u8 {
        self.channel
    }

    /// The state of its channel.
    #[inline(always)]
    pub fn current(&mut self) -> &mut T {
        &mut self.states[self.current]
    }

    /// The state of the next record's channel; `begin` makes one from that of the last record's.
    #[inline(always)]
    pub fn of(&mut self, channel: u8, begin: impl FnOnce(&T) -> T) -> &mut T {
        if channel != self.channel {
            self.switch(channel, begin);
        }
        &mut self.states[self.current]
    }

    #[cold]
    fn switch(&mut self, channel: u8, begin: impl FnOnce(&T) -> T) {
        self.channel = channel % 4;
        let place = &mut self.places[usize::from(self.channel)];
        self.current = *place.get_or_insert_with(|| {
            self.states.push(begin(&self.states[self.current]));
            self.states.len() - 1
        });
    }
}

/// Which models, and which record before, the items behind the point itself go by.
pub struct Followed {
    /// In version 3 a value follows that of the channel before where the channel changes to one that is known: an oversight
    /// of its first writer that is the format now. Version 4 follows the channel.
    version: u16,
    current: usize,
    used: [bool; 4],
}

impl Followed {
    pub fn new(version: u16, channel: u8) -> Self {
        let current = usize::from(channel % 4);
        Self { version, current, used: std::array::from_fn(|channel| channel == current) }
    }

    /// The channel whose models are used for a record, and that whose last value (in `last`) it follows and replaces.
    #[inline(always)]
    pub fn step<T: Copy>(&mut self, mark: &Mark, last: &mut [T; 4]) -> (usize, usize) {
        let channel = usize::from(mark.followed) % 4;
        let mut follows = self.current;
        if channel != self.current {
            self.current = channel;
            if !self.used[channel] {
                self.used[channel] = true;
                last[channel] = last[follows];
                follows = channel;
            }
            if self.version != 3 {
                follows = channel;
            }
        }
        (channel, follows)
    }
}

//! GPS times: four sequences of times a channel, each going on by multiples of its last difference.

use super::coder::{Coder, Model16, Model528};
use super::integer::Differences;

/// The largest multiple with a code of its own; the smallest is [`LEAST`].
const MOST: i32 = 500;
const LEAST: i32 = -10;
/// The code of a time that is written out; those behind it are of another sequence.
const WHOLE: i32 = MOST - LEAST + 1;
/// Codes altogether.
const CODES: usize = WHOLE as usize + 4;
/// Differences in a row that are no multiple, after which the last of them is what multiples are of.
const ODD_ONES: u32 = 3;

/// The times of a channel.
pub struct Times {
    current: usize,
    newest: usize,
    /// Of each sequence: the bits of its last time.
    last: [i64; 4],
    difference: [i32; 4],
    odd: [u32; 4],
    multiples: Model528,
    first: Model16,
    differences: Differences,
}

impl Times {
    /// After a time with these bits.
    pub fn new(bits: i64) -> Self {
        Self {
            current: 0,
            newest: 0,
            last: [bits, 0, 0, 0],
            difference: [0; 4],
            odd: [0; 4],
            multiples: Model528::new(CODES),
            first: Model16::new(5),
            differences: Differences::new(32, 9),
        }
    }

    /// The bits of the last time.
    pub fn bits(&self) -> i64 {
        self.last[self.current % 4]
    }

    /// The code of the next time, which differs from the last.
    #[inline(always)]
    pub fn begin(&mut self, coder: &mut Coder<'_>) -> usize {
        if self.difference[self.current % 4] == 0 {
            coder.symbol(&mut self.first)
        } else {
            coder.symbol(&mut self.multiples)
        }
    }

    /// The bits of the next time, which has this code.
    pub fn finish(&mut self, coder: &mut Coder<'_>, mut code: usize) -> i64 {
        // A code may name another sequence, where the time follows; what is damaged can do so for ever.
        while !coder.is_exhausted() {
            let at = self.current % 4;
            let sequences_on =
                if self.difference[at] == 0 { self.without(coder, at, code) } else { self.with(coder, at, code) };
            let Some(on) = sequences_on else { break };
            self.current = (self.current + on) % 4;
            code = self.begin(coder);
        }
        self.bits()
    }

    /// A time of a sequence that has no difference yet; else how many sequences further it is.
    fn without(&mut self, coder: &mut Coder<'_>, at: usize, code: usize) -> Option<usize> {
        match code {
            0 => {
                self.difference[at] = self.differences.next(coder, 0).0;
                self.advance(at, self.difference[at]);
                self.odd[at] = 0;
                None
            }
            1 => {
                self.whole(coder, at);
                None
            }
            code => Some(code - 1),
        }
    }

    /// The same for a sequence that has one.
    fn with(&mut self, coder: &mut Coder<'_>, at: usize, code: usize) -> Option<usize> {
        let code = code as i32;
        if code > WHOLE {
            return Some((code - WHOLE) as usize);
        }
        if code == WHOLE {
            self.whole(coder, at);
            return None;
        }
        // Codes above the largest multiple are the negative ones.
        let multiple = if code > MOST { MOST - code } else { code };
        let (context, is_odd) = match multiple {
            0 => (7, true),
            1 => (1, false),
            2..10 => (2, false),
            10..MOST => (3, false),
            MOST => (4, true),
            _ if multiple > LEAST => (5, false),
            _ => (6, true),
        };
        let predicted = multiple.wrapping_mul(self.difference[at]);
        let difference = predicted.wrapping_add(self.differences.next(coder, context).0);
        self.advance(at, difference);
        if multiple == 1 {
            self.odd[at] = 0;
        } else if is_odd {
            self.odd[at] += 1;
            if self.odd[at] > ODD_ONES {
                self.difference[at] = difference;
                self.odd[at] = 0;
            }
        }
        None
    }

    fn advance(&mut self, at: usize, difference: i32) {
        self.last[at] = self.last[at].wrapping_add(difference.into());
    }

    /// A time that is written out begins a new sequence, in the place of the oldest.
    fn whole(&mut self, coder: &mut Coder<'_>, at: usize) {
        self.newest = (self.newest + 1) % 4;
        let predicted = (self.last[at] >> 32) as i32;
        let upper = predicted.wrapping_add(self.differences.next(coder, 8).0);
        let lower = u64::from(coder.bits(32));
        self.last[self.newest] = i64::from(upper) << 32 | lower as i64;
        self.difference[self.newest] = 0;
        self.odd[self.newest] = 0;
        self.current = self.newest;
    }
}

//! Integers as LASzip has them: the difference from a prediction, first its magnitude in bits, then the exact value.

use super::coder::{BitModel, Coder, Model48, Model256};

/// Bits of a difference that have a model; the lower ones of larger differences are stored as they are.
const MODELLED_BITS: u32 = 8;

/// Models of differences of up to `bits` bits, in several contexts.
pub struct Differences {
    /// How many bits a difference takes, by context.
    magnitudes: Vec<Model48>,
    /// Differences of no bits: 0 or 1.
    smallest: BitModel,
    /// The upper bits of those of 1 bit and more.
    upper: Vec<Model256>,
}

impl Differences {
    /// In so many contexts.
    pub fn new(bits: u32, contexts: usize) -> Self {
        Self {
            magnitudes: vec![Model48::new(bits as usize + 1); contexts],
            smallest: BitModel::default(),
            upper: (1..=bits).map(|bits| Model256::new(1 << bits.min(MODELLED_BITS))).collect(),
        }
    }

    /// The next difference, and how many bits it takes.
    #[inline(always)]
    pub fn next(&mut self, coder: &mut Coder<'_>, context: usize) -> (i32, u32) {
        let bits = self.begin(coder, context);
        (self.finish(coder, bits), bits)
    }

    /// How many bits the next difference takes.
    #[inline(always)]
    pub fn begin(&mut self, coder: &mut Coder<'_>, context: usize) -> u32 {
        coder.symbol(&mut self.magnitudes[context]) as u32
    }

    /// The next difference, which takes so many bits.
    ///
    /// How many cannot be foretold, so there is one way for all numbers of bits but 0 and 32.
    #[inline(always)]
    pub fn finish(&mut self, coder: &mut Coder<'_>, bits: u32) -> i32 {
        if bits == 0 {
            return i32::from(coder.bit(&mut self.smallest));
        }
        // A magnitude is at most the number of bits that there are models for; 32 bits are one value only.
        let model = self.upper.get_mut(bits as usize - 1).filter(|_| bits < 32);
        let Some(model) = model else { return i32::MIN };
        let rest = bits.saturating_sub(MODELLED_BITS);
        let upper = coder.symbol(model) as u32;
        let stored = upper << rest | coder.bits(rest);
        // 0 and 1 have a magnitude of their own, so that positive differences move up by one.
        let is_negative = u32::from(stored < 1 << (bits - 1));
        let difference = stored.wrapping_add(1).wrapping_sub(is_negative << bits);
        difference as i32
    }
}

//! Randomness and mathematics that are the same on every machine: ChaCha, integer hashes, and only those floating-point
//! operations that IEEE 754 fixes to the last bit (no `sin`, `exp` or `powf` of the platform).

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// A stream of random numbers.
pub(super) struct Random(ChaCha8Rng);

impl Random {
    /// Stream `stream` of `seed`: streams of one seed are independent, so blocks can be made in any order.
    pub fn new(seed: u64, stream: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(stream);
        Self(random)
    }

    /// Uniform in `[0, 1)`.
    pub fn unit(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
    }

    /// Uniform in `[low, high)`.
    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// True with probability `p`.
    pub fn chance(&mut self, p: f64) -> bool {
        self.unit() < p
    }

    /// Roughly normal with standard deviation 1, never beyond 3.
    pub fn normal(&mut self) -> f64 {
        // The sum of three numbers in [-1, 1) has variance 1.
        self.within(-1.0, 1.0) + self.within(-1.0, 1.0) + self.within(-1.0, 1.0)
    }

    /// A point on the unit circle: cosine and sine of a uniform angle.
    pub fn circle(&mut self) -> [f64; 2] {
        loop {
            let (x, y) = (self.within(-1.0, 1.0), self.within(-1.0, 1.0));
            let square = x * x + y * y;
            if (1e-12..=1.0).contains(&square) {
                let length = square.sqrt();
                return [x / length, y / length];
            }
        }
    }

    /// A point on the unit sphere, uniform.
    pub fn sphere(&mut self) -> [f64; 3] {
        loop {
            let p: [f64; 3] = std::array::from_fn(|_| self.within(-1.0, 1.0));
            let square = p[0] * p[0] + p[1] * p[1] + p[2] * p[2];
            if (1e-12..=1.0).contains(&square) {
                let length = square.sqrt();
                return p.map(|c| c / length);
            }
        }
    }
}

/// A number that is as good as random, from a cell of a grid (SplitMix64's finisher).
pub(super) fn hash(seed: u64, x: i64, y: i64) -> u64 {
    let mix = |mut z: u64| {
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    };
    let z = seed ^ x.cast_unsigned().wrapping_mul(0x9E37_79B9_7F4A_7C15);
    mix(mix(z) ^ y.cast_unsigned().wrapping_mul(0xD1B5_4A32_D192_ED03))
}

/// Sixteen bits of a hash, at `place` 0 to 3, as a number in `[0, 1)`.
pub(super) fn part(hash: u64, place: u32) -> f64 {
    (hash >> (16 * place) & 0xFFFF) as f64 / 65_536.0
}

/// Sine and cosine of an angle in turns, within 1e-14.
pub(super) fn sin_cos(turns: f64) -> (f64, f64) {
    let quarter = (turns * 4.0).round();
    let x = (turns - quarter / 4.0) * std::f64::consts::TAU;
    let square = x * x;
    // Taylor's series to the last term that counts for |x| <= pi/4.
    let (mut sin, mut cos) = (0.0, 0.0);
    for n in (0..8).rev() {
        let n = f64::from(n);
        sin = 1.0 - square / ((2.0 * n + 2.0) * (2.0 * n + 3.0)) * sin;
        cos = 1.0 - square / ((2.0 * n + 1.0) * (2.0 * n + 2.0)) * cos;
    }
    sin *= x;
    match (quarter as i64).rem_euclid(4) {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_those_of_the_standard_library() {
        for i in -2000..2000 {
            let turns = f64::from(i) / 777.0;
            let (sin, cos) = sin_cos(turns);
            let angle = turns * std::f64::consts::TAU;
            assert!((sin - angle.sin()).abs() < 1e-13 && (cos - angle.cos()).abs() < 1e-13, "{turns}");
        }
    }

    #[test]
    fn streams_differ_and_repeat() {
        let first = |seed, stream| Random::new(seed, stream).unit();
        assert_eq!(first(1, 2), first(1, 2));
        assert_ne!(first(1, 2), first(1, 3));
        assert_ne!(first(1, 2), first(2, 2));
    }

    #[test]
    fn hashes_are_spread_evenly() {
        let mean = (0..10_000).map(|i| part(hash(3, i % 100, i / 100), 1)).sum::<f64>() / 10_000.0;
        assert!((mean - 0.5).abs() < 0.02, "{mean}");
    }
}

//! From a source's own integer grid (scale and offset) to the lattice and back, in exact integers.

use super::grid::{Axis, BIAS};
use super::{BITS, Decimal, Lattice};

/// The grid of a source file: `world = scale * X + offset`, X an `i32`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SourceGrid {
    /// Step per axis; positive.
    pub scale: [Decimal; 3],
    /// World coordinate of `X = 0`.
    pub offset: [Decimal; 3],
}

/// How faithfully a scan's positions are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Exactness {
    /// The grids coincide: the stored position is the source's.
    Exact,
    /// Only the offsets differ: the source's integer is the nearest one to the stored position.
    Recoverable,
    /// Within half a quantum per axis.
    Rounded,
}

impl Exactness {
    /// The word for it in reports and in the store.
    pub fn word(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Recoverable => "recoverable",
            Self::Rounded => "rounded",
        }
    }

    /// The reverse of [`Exactness::word`].
    pub fn from_word(word: &str) -> Option<Self> {
        [Self::Exact, Self::Recoverable, Self::Rounded].into_iter().find(|e| e.word() == word)
    }
}

/// The map between one source grid and one lattice.
///
/// Half-way cases go up on the way in and down on the way out, so that they come back.
#[derive(Clone, Copy, Debug)]
pub struct SourceMap {
    axes: [AxisMap; 3],
}

/// `index - BIAS = (scale * X + offset) / quantum`, all in one decimal unit.
#[derive(Clone, Copy, Debug)]
struct AxisMap {
    scale: i128,
    /// Where [`AxisMap::is_cut`], a number between the same two multiples of the other units' last digit as the offset.
    offset: i128,
    quantum: i128,
    /// Does the offset have more digits than fit? It is then less than a unit off, and every point at the place and the
    /// record that the whole offset gives: half-way cases are of the other numbers' digits.
    is_cut: bool,
    /// `(multiplier, addend)` with `index = multiplier * X + addend`, where the grids coincide.
    exact: Option<(i64, i64)>,
}

impl SourceGrid {
    /// Reads scale and offset as shortest decimals; `None` if one is not finite or a scale is not positive.
    pub fn from_f64(scale: [f64; 3], offset: [f64; 3]) -> Option<Self> {
        let mut grid = Self { scale: [Decimal::ZERO; 3], offset: [Decimal::ZERO; 3] };
        for i in 0..3 {
            grid.scale[i] = Decimal::from_f64(scale[i]).filter(|&s| s > Decimal::ZERO)?;
            grid.offset[i] = Decimal::from_f64(offset[i])?;
        }
        Some(grid)
    }

    /// The world coordinates of a record, as the nearest floats.
    pub fn world(&self, x: [i32; 3]) -> [f64; 3] {
        std::array::from_fn(|i| f64::from(x[i]) * self.scale[i].to_f64() + self.offset[i].to_f64())
    }
}

impl SourceMap {
    /// The map from `grid` to `lattice`; `None` if quantum or scale have too many digits for exact arithmetic, or the offset
    /// is beyond all bounds. Digits of the offset that are far below those of the others decide nothing and do not count.
    pub fn new(grid: &SourceGrid, lattice: &Lattice) -> Option<Self> {
        let axis = |i: usize| AxisMap::new(grid.scale[i], grid.offset[i], lattice.axis(i));
        Some(Self { axes: [axis(0)?, axis(1)?, axis(2)?] })
    }

    /// How faithfully the lattice keeps this grid.
    pub fn exactness(&self) -> Exactness {
        self.axes
            .iter()
            .map(|a| match a {
                a if a.scale % a.quantum == 0 && a.offset % a.quantum == 0 => Exactness::Exact,
                a if a.quantum <= a.scale => Exactness::Recoverable,
                _ => Exactness::Rounded,
            })
            .max()
            .unwrap_or(Exactness::Exact)
    }

    /// `index = multiplier * X + addend` on every axis, if the grids coincide: the fast path. The results may be
    /// outside the lattice and are to be checked.
    pub fn affine(&self) -> Option<[(i64, i64); 3]> {
        Some([self.axes[0].exact?, self.axes[1].exact?, self.axes[2].exact?])
    }

    /// The lattice index of source integer `x` on `axis`; `None` if it is outside the lattice.
    pub fn to_lattice(&self, axis: usize, x: i32) -> Option<u64> {
        let a = &self.axes[axis];
        let steps = (2 * (i128::from(x) * a.scale + a.offset) + a.quantum).div_euclid(2 * a.quantum);
        let index = steps + i128::from(BIAS);
        (0..1 << BITS).contains(&index).then_some(index as u64)
    }

    /// The source integer nearest to lattice index `index` on `axis`; `None` if it does not fit an `i32`.
    pub fn from_lattice(&self, axis: usize, index: u64) -> Option<i32> {
        let a = &self.axes[axis];
        if let Some((multiplier, addend)) = a.exact {
            let steps = index as i64 - addend;
            let (x, rest) = (steps.div_euclid(multiplier), steps.rem_euclid(multiplier));
            if rest == 0 {
                return i32::try_from(x).ok();
            }
        }
        let steps = i128::from(index) - i128::from(BIAS);
        // ceil(v - 1/2) with v = (steps * quantum - offset) / scale.
        let twice = 2 * (steps * a.quantum - a.offset) - a.scale;
        i32::try_from(-(-twice).div_euclid(2 * a.scale)).ok()
    }

    /// The distance on `axis`, in CRS units, between source integer `x` and lattice index `index`. Where digits of the offset
    /// were cut, it is at most so much: less than two units of the finest digit that is left beyond it.
    pub fn error(&self, axis: usize, x: i32, index: u64, lattice: &Lattice) -> f64 {
        let a = &self.axes[axis];
        let steps = i128::from(index) - i128::from(BIAS);
        let off = (i128::from(x) * a.scale + a.offset - steps * a.quantum).unsigned_abs();
        let units = off + u128::from(a.is_cut);
        units as f64 / a.quantum as f64 * lattice.quantum_f64()[axis]
    }
}

impl AxisMap {
    fn new(scale: Decimal, offset: Decimal, axis: Axis) -> Option<Self> {
        // The last digit of everything but the offset.
        let last = Decimal::new(1, axis.exponent).common_exponent(scale);
        let whole = last.min(offset.common_exponent(scale));
        // The finest unit in which all fits; where digits of the offset are cut, one below the last digit at least, so that
        // what is left of it can lie between two of those.
        (whole..last).chain([last]).find_map(|unit| Self::in_units(scale, offset, axis, last, unit))
    }

    /// In units of `10^unit`; `None` if that does not fit.
    fn in_units(scale: Decimal, offset: Decimal, axis: Axis, last: i32, unit: i32) -> Option<Self> {
        // Twice `scale * X + offset + quantum`, X below 2^31, must fit, and twice `index * quantum - offset`.
        let fits = |v: i128, bits: u32| (v.unsigned_abs() < 1 << bits).then_some(v);
        let factor = 10_i128.checked_pow(u32::try_from(axis.exponent.checked_sub(unit)?).ok()?)?;
        let quantum = fits(axis.quantum.checked_mul(factor)?, 78)?;
        let scale = fits(scale.scaled_to(unit)?, 90)?;
        let (offset, is_cut) = match offset.scaled_to(unit) {
            Some(offset) => (offset, false),
            None if unit < last && offset.exponent() < unit => (cut(offset, unit), true),
            None => return None,
        };
        let offset = fits(offset.checked_sub(axis.phase.checked_mul(factor)?)?, 120)?;
        let exact = (scale % quantum == 0 && offset % quantum == 0)
            .then(|| {
                let multiplier = i64::try_from(scale / quantum).ok().filter(|m| *m < 1 << 30)?;
                let addend = i64::try_from(offset / quantum).ok().filter(|a| a.abs() < 1 << 61)?;
                Some((multiplier, addend + BIAS))
            })
            .flatten();
        Some(Self { scale, offset, quantum, is_cut, exact })
    }
}

/// A whole number of units of `10^unit` that is less than one unit from `number`, which has digits below it, and lies as
/// `number` does to all multiples of five units.
fn cut(number: Decimal, unit: i32) -> i128 {
    let digits = u32::try_from(unit.saturating_sub(number.exponent())).unwrap_or(u32::MAX);
    let below = || if number.mantissa() < 0 { -1 } else { 0 };
    let floor = 10_i128.checked_pow(digits).map_or_else(below, |one| number.mantissa().div_euclid(one));
    if floor.rem_euclid(5) == 0 { floor + 1 } else { floor }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn grid(scale: f64, offset: f64) -> SourceGrid {
        SourceGrid::from_f64([scale; 3], [offset; 3]).unwrap()
    }

    proptest! {
        #[test]
        fn source_integers_come_back_when_the_quantum_is_no_coarser(
            scale in prop::sample::select(vec![0.01, 0.001, 0.00025, 0.3, 1.0, 1.0 / 3e6, 1e-5_f64.next_up(), f64::from(0.001_f32)]),
            quantum in prop::sample::select(vec![0.01, 0.001, 0.00025, 0.0001, 0.004, 1.0]),
            offset in prop::sample::select(vec![0.0, 0.005, 0.0005, 637000.123, -1423214.5199999998, 0.000125, 6271234.512345678]),
            x in any::<i32>(),
        ) {
            let lattice = Lattice::uniform(quantum).unwrap();
            let map = SourceMap::new(&grid(scale, offset), &lattice).unwrap();
            let Some(index) = map.to_lattice(0, x) else { return Ok(()) };
            if let Some(affine) = map.affine() {
                prop_assert_eq!(i64::from(x) * affine[0].0 + affine[0].1, index as i64);
                prop_assert_eq!(map.exactness(), Exactness::Exact);
            }
            let error = map.error(0, x, index, &lattice);
            prop_assert!(error <= quantum / 2.0 * 1.000_000_001);
            if quantum <= scale {
                prop_assert!(map.exactness() <= Exactness::Recoverable);
                prop_assert_eq!(map.from_lattice(0, index), Some(x));
            } else if map.exactness() == Exactness::Exact {
                prop_assert_eq!(error, 0.0);
            }
        }
    }

    proptest! {
        #[test]
        fn digits_far_below_all_others_decide_ties_and_nothing_else(
            (scale, quantum) in prop::sample::select(vec![(1000, 1000), (10_000, 1000), (1000, 10_000), (1500, 1000), (250, 500)]),
            base in -400_i128..400, digits in 29_i32..=34, sign in prop::sample::select(vec![-1, 1]),
            x in prop_oneof![-20_i32..20, any::<i32>()], near in -40_i64..40,
        ) {
            // All in millionths; the offset is a multiple of 50 of them and a last digit far below, as numerical noise is.
            let base = base * 50;
            let noise = Decimal::new(base * 10_i128.pow(digits as u32 - 6) + sign, -digits);
            let grid = SourceGrid { scale: [Decimal::new(scale, -6); 3], offset: [noise; 3] };
            let lattice = Lattice::new([Decimal::new(quantum, -6); 3], [Decimal::ZERO; 3]).unwrap();
            let map = SourceMap::new(&grid, &lattice).unwrap();
            // The same rounding, where the noise is a twentieth of a millionth.
            let steps = (20 * (i128::from(x) * scale + base) + 10 * quantum + sign).div_euclid(20 * quantum);
            let index = map.to_lattice(1, x).unwrap();
            prop_assert_eq!(i128::from(index), steps + i128::from(BIAS));
            let back = |steps: i128| -(10 * scale + sign - 20 * (steps * quantum - base)).div_euclid(20 * scale);
            let other = (BIAS + near) as u64;
            prop_assert_eq!(map.from_lattice(1, other).map(i128::from), Some(back(near.into())));
            let error = ((i128::from(x) * scale + base - steps * quantum) as f64 / 1e6).abs();
            prop_assert!((map.error(1, x, index, &lattice) - error).abs() < 1e-15);
            if quantum <= scale {
                prop_assert_eq!(map.from_lattice(1, index), Some(x));
                prop_assert_eq!(map.exactness(), Exactness::Recoverable);
            } else {
                prop_assert_eq!(map.exactness(), Exactness::Rounded);
            }
        }
    }

    #[test]
    fn an_offset_of_noise_is_taken() {
        // They were refused for having too many digits; only their number decided.
        let lattice = Lattice::uniform(0.001).unwrap();
        for offset in [1.2345678901234567e-17, -1.2345678901234567e-17, 1.234567890123456e-25, 5e-324, -5e-324] {
            let map = SourceMap::new(&grid(0.001, offset), &lattice).unwrap();
            assert_eq!((map.exactness(), map.affine()), (Exactness::Recoverable, None));
            for x in [i32::MIN, -1, 0, 1, i32::MAX] {
                let index = map.to_lattice(0, x).unwrap();
                assert_eq!((index as i64 - BIAS, map.from_lattice(0, index)), (i64::from(x), Some(x)));
                let error = map.error(0, x, index, &lattice);
                assert!(offset.abs() <= error && error < offset.abs() * 1.000_001 + 1e-25, "{offset}: {error}");
            }
        }
        // At the ends of the lattice nothing overflows.
        let map = SourceMap::new(&grid(0.001, 1.2345678901234567e-17), &lattice).unwrap();
        assert_eq!(map.from_lattice(0, 0), None);
        assert_eq!(map.from_lattice(0, (1 << BITS) - 1), None);
        assert!(SourceMap::new(&grid(0.001, 1e40), &lattice).is_none());
    }

    #[test]
    fn half_step_offsets_are_recoverable() {
        let lattice = Lattice::uniform(0.01).unwrap();
        let map = SourceMap::new(&grid(0.01, 0.005), &lattice).unwrap();
        assert_eq!(map.exactness(), Exactness::Recoverable);
        for x in [-3, -2, -1, 0, 1, 2, 3, i32::MIN, i32::MAX] {
            assert_eq!(map.from_lattice(0, map.to_lattice(0, x).unwrap()), Some(x));
        }
    }
}

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
    offset: i128,
    quantum: i128,
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
    /// The map from `grid` to `lattice`; `None` if the numbers have too many digits for exact arithmetic.
    pub fn new(grid: &SourceGrid, lattice: &Lattice) -> Option<Self> {
        let axis = |i: usize| {
            let Axis { quantum, phase, exponent } = lattice.axis(i);
            let (scale, offset) = (grid.scale[i], grid.offset[i]);
            let unit = Decimal::new(1, exponent).common_exponent(scale).min(offset.common_exponent(scale));
            let factor = 10_i128.checked_pow(u32::try_from(exponent - unit).ok()?)?;
            // Twice `scale * X + offset + quantum`, X below 2^31, must fit.
            let fits = |v: i128, bits: u32| (v.unsigned_abs() < 1 << bits).then_some(v);
            let quantum = fits(quantum.checked_mul(factor)?, 90)?;
            let scale = fits(scale.scaled_to(unit)?, 90)?;
            let offset = fits(offset.scaled_to(unit)?.checked_sub(phase.checked_mul(factor)?)?, 120)?;
            let exact = (scale % quantum == 0 && offset % quantum == 0)
                .then(|| {
                    let multiplier = i64::try_from(scale / quantum).ok().filter(|m| *m < 1 << 30)?;
                    let addend = i64::try_from(offset / quantum).ok().filter(|a| a.abs() < 1 << 61)?;
                    Some((multiplier, addend + BIAS))
                })
                .flatten();
            Some(AxisMap { scale, offset, quantum, exact })
        };
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

    /// The distance on `axis`, in CRS units, between source integer `x` and lattice index `index`.
    pub fn error(&self, axis: usize, x: i32, index: u64, lattice: &Lattice) -> f64 {
        let a = &self.axes[axis];
        let steps = i128::from(index) - i128::from(BIAS);
        let units = (i128::from(x) * a.scale + a.offset - steps * a.quantum).unsigned_abs();
        units as f64 / a.quantum as f64 * lattice.quantum_f64()[axis]
    }
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

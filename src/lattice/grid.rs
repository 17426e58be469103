//! The lattice itself: quantum and phase, world to index and back.

use super::{BITS, Decimal, LatticeBox, LatticePoint};
use thiserror::Error;

/// The index of a world coordinate equal to the phase: one third of the range, which is never near the edge of an
/// aligned power-of-two cube of any size.
pub const BIAS: i64 = 0x5555_5555_5555;

const RANGE: i128 = 1 << BITS;

/// What a lattice can refuse.
#[derive(Debug, Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum LatticeError {
    /// A quantum is zero, negative, not finite, or has too many digits.
    #[error("quantum {0} is not usable: it must be a positive number between 1e-12 and 1e6")]
    Quantum(f64),
    /// A phase is not in `[0, quantum)`.
    #[error("phase {phase} is not usable: it must be at least 0 and less than the quantum {quantum}")]
    Phase {
        /// The phase asked for.
        phase: f64,
        /// The quantum of that axis.
        quantum: f64,
    },
    /// A coordinate is outside the lattice.
    #[error(
        "coordinate {value} on axis {axis} is outside the lattice, which holds {min} to {max}; use a coarser quantum"
    )]
    OutOfRange {
        /// 0, 1, 2 for x, y, z.
        axis: usize,
        /// The coordinate.
        value: f64,
        /// The least coordinate that fits.
        min: f64,
        /// The greatest that fits.
        max: f64,
    },
}

/// The integer grid: `world = phase + quantum * (index - BIAS)` on each axis, exact in decimal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lattice {
    quantum: [Decimal; 3],
    phase: [Decimal; 3],
    axes: [Axis; 3],
}

/// One axis in integers: `world = (quantum * (index - BIAS) + phase) * 10^exponent`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Axis {
    pub quantum: i128,
    pub phase: i128,
    pub exponent: i32,
}

impl Lattice {
    /// A lattice with this quantum and phase per axis.
    ///
    /// # Errors
    ///
    /// [`LatticeError::Quantum`] unless every quantum is within 1e-12 to 1e6; [`LatticeError::Phase`] unless
    /// `0 <= phase < quantum`.
    pub fn new(quantum: [Decimal; 3], phase: [Decimal; 3]) -> Result<Self, LatticeError> {
        let mut axes = [Axis { quantum: 1, phase: 0, exponent: 0 }; 3];
        for i in 0..3 {
            let (q, p) = (quantum[i], phase[i]);
            let exponent = q.common_exponent(p);
            let refused = LatticeError::Quantum(q.to_f64());
            if !(Decimal::new(1, -12)..=Decimal::new(1, 6)).contains(&q) || exponent < -30 {
                return Err(refused);
            }
            if !(Decimal::ZERO..q).contains(&p) {
                return Err(LatticeError::Phase { phase: p.to_f64(), quantum: q.to_f64() });
            }
            let scaled = |d: Decimal| d.scaled_to(exponent).filter(|m| m.unsigned_abs() < 1 << 64);
            let (Some(quantum), Some(phase)) = (scaled(q), scaled(p)) else {
                return Err(refused);
            };
            axes[i] = Axis { quantum, phase, exponent };
        }
        Ok(Self { quantum, phase, axes })
    }

    /// The same quantum on all axes, phase zero.
    ///
    /// # Errors
    ///
    /// As [`Lattice::new`].
    pub fn uniform(quantum: f64) -> Result<Self, LatticeError> {
        let q = Decimal::from_f64(quantum).ok_or(LatticeError::Quantum(quantum))?;
        Self::new([q; 3], [Decimal::ZERO; 3])
    }

    /// The step per axis, in CRS units.
    pub fn quantum(&self) -> [Decimal; 3] {
        self.quantum
    }

    /// The offset of the grid per axis, less than a quantum.
    pub fn phase(&self) -> [Decimal; 3] {
        self.phase
    }

    /// The step per axis as floats.
    pub fn quantum_f64(&self) -> [f64; 3] {
        self.quantum.map(Decimal::to_f64)
    }

    /// The largest step of the three axes, as a float: for error bounds in CRS units.
    pub fn largest_quantum(&self) -> f64 {
        self.quantum_f64().into_iter().fold(0.0, f64::max)
    }

    pub(super) fn axis(&self, axis: usize) -> Axis {
        self.axes[axis]
    }

    /// The world coordinates of `point`: the nearest `f64` to the exact decimal wherever that has at most 53 bits.
    #[inline]
    pub fn world_from_lattice(&self, point: LatticePoint) -> [f64; 3] {
        std::array::from_fn(|i| self.world_on_axis(i, point.0[i]))
    }

    /// One coordinate of [`Lattice::world_from_lattice`].
    #[inline]
    pub fn world_on_axis(&self, axis: usize, index: u64) -> f64 {
        let Axis { quantum, phase, exponent } = self.axes[axis];
        let units = (i128::from(index) - i128::from(BIAS)) * quantum + phase;
        if exponent < 0 { units as f64 / 10_f64.powi(-exponent) } else { units as f64 * 10_f64.powi(exponent) }
    }

    /// Appends the coordinates of `indices` on `axis`: what [`Lattice::world_on_axis`] gives for each, bit for bit, in a
    /// fraction of the time.
    pub fn extend_world(&self, axis: usize, indices: &[u64], world: &mut impl Extend<f64>) {
        let Axis { quantum, phase, exponent } = self.axes[axis];
        // 48 bits of index by 14 of quantum, and the phase is less than a quantum: sums of 63 bits.
        let (Ok(quantum), Ok(phase), true) = (i64::try_from(quantum), i64::try_from(phase), quantum < 1 << 14) else {
            world.extend(indices.iter().map(|&index| self.world_on_axis(axis, index)));
            return;
        };
        let unit = 10_f64.powi(exponent.abs());
        let units = indices.iter().map(|&index| ((index as i64 - BIAS) * quantum + phase) as f64);
        if exponent < 0 {
            world.extend(units.map(|u| u / unit));
        } else {
            world.extend(units.map(|u| u * unit));
        }
    }

    /// The coordinate `index` on `axis` as the exact decimal that it is.
    pub fn decimal_on_axis(&self, axis: usize, index: u64) -> Decimal {
        let Axis { quantum, phase, exponent } = self.axes[axis];
        Decimal::new((i128::from(index) - i128::from(BIAS)) * quantum + phase, exponent)
    }

    /// Rounds `world` to the nearest lattice point; at most half a quantum from it on each axis.
    ///
    /// # Errors
    ///
    /// [`LatticeError::OutOfRange`] if an axis does not fit; NaN never fits.
    pub fn lattice_from_world(&self, world: [f64; 3]) -> Result<LatticePoint, LatticeError> {
        let mut point = LatticePoint::default();
        for axis in 0..3 {
            point.0[axis] =
                self.nearest_index(axis, world[axis]).ok_or_else(|| self.out_of_range(axis, world[axis]))?;
        }
        Ok(point)
    }

    /// The error for a coordinate that does not fit.
    pub fn out_of_range(&self, axis: usize, value: f64) -> LatticeError {
        let (min, max) = (self.world_on_axis(axis, 0), self.world_on_axis(axis, (1 << BITS) - 1));
        LatticeError::OutOfRange { axis, value, min, max }
    }

    /// The nearest index to `world` on `axis`; `None` if it is outside the lattice or not a number.
    ///
    /// Computed in twice the precision of `f64`, so that the distance is at most half a quantum also at the far end of
    /// the range.
    pub fn nearest_index(&self, axis: usize, world: f64) -> Option<u64> {
        let Axis { quantum, phase, exponent } = self.axes[axis];
        // world = (steps * quantum + phase) * 10^exponent; find steps. The three factors are exact or within an ulp;
        // the residual of the first guess is formed with fused products, then corrected by at most one step.
        let unit = 10_f64.powi(exponent.abs());
        let step = quantum as f64;
        let in_units = if exponent < 0 { world * unit } else { world / unit };
        let guess = ((in_units - phase as f64) / step).round();
        if !(guess.abs() < RANGE as f64) {
            return None;
        }
        // residual = world - coordinate(guess), in units, without cancellation: world * unit as a sum of two floats.
        let low = match (exponent < 0, rest_of_power(exponent.unsigned_abs())) {
            (true, rest) => world.mul_add(unit, -in_units) + world * rest,
            (false, rest) => ((-in_units).mul_add(unit, world) - in_units * rest) / unit,
        };
        let guess_units = guess as i128 * quantum + phase;
        let whole = in_units.trunc();
        let residual = (whole as i128 - guess_units) as f64 + (in_units - whole) + low;
        let correction = (residual / step).round();
        let index = guess as i128 + correction as i128 + i128::from(BIAS);
        (0..RANGE).contains(&index).then_some(index as u64)
    }

    /// The least index whose coordinate is at least `bound`: `None` if that is above the lattice, 0 if below.
    /// Exact: the bound *is* its shortest decimal. NaN gives `None`.
    pub fn first_index_at_least(&self, axis: usize, bound: f64) -> Option<u64> {
        let Axis { quantum, phase, exponent } = self.axes[axis];
        if bound == f64::NEG_INFINITY {
            return Some(0);
        }
        let decimal = Decimal::from_f64(bound)?;
        // Coordinates are multiples of 10^exponent: a bound with more digits lies strictly between two of them, and
        // only its order matters.
        let low = decimal.exponent().min(exponent);
        let low = low.max(exponent - 1);
        let units = if decimal.exponent() >= low {
            decimal.scaled_to(low)
        } else {
            // Between two multiples of 10^exponent, or next to one: round down to 10^low and add a tenth if anything
            // was cut off, which keeps the order towards multiples of 10^exponent.
            let cut = u32::try_from(low - decimal.exponent()).unwrap_or(u32::MAX);
            let divisor = 10_i128.checked_pow(cut);
            let floor =
                divisor.map_or(if decimal.mantissa() < 0 { -1 } else { 0 }, |d| decimal.mantissa().div_euclid(d));
            let exact = divisor.is_some_and(|d| decimal.mantissa().rem_euclid(d) == 0);
            // Any value in (floor, floor + 1) in units of a tenth of a step of the grid: if floor is itself a multiple
            // of ten, floor + 1 is not and has the same order; otherwise floor has.
            Some(if exact || floor.rem_euclid(10) != 0 { floor } else { floor + 1 })
        };
        let Some(units) = units.filter(|u| u.unsigned_abs() < 1 << 120) else {
            return if bound < 0.0 { Some(0) } else { None };
        };
        let factor = 10_i128.pow((exponent - low) as u32);
        let (quantum, phase) = (quantum * factor, phase * factor);
        let steps = -(phase - units).div_euclid(quantum);
        let index = steps + i128::from(BIAS);
        if index >= RANGE { None } else { Some(index.max(0) as u64) }
    }

    /// The face that parts `index` on `axis` from the index below it: as a minimum of a box it takes `index`, as a maximum
    /// it leaves it out, and takes the one below.
    ///
    /// It is the coordinate of `index` wherever a float has just that decimal, else a float next to it and below. `index`
    /// may be one beyond the last.
    pub fn face_at(&self, axis: usize, index: u64) -> f64 {
        let exact = self.decimal_on_axis(axis, index);
        let mut face = self.world_on_axis(axis, index);
        // At most a few times: within the 48 bits of an index a quantum is sixteen steps of an f64 and more.
        while Decimal::from_f64(face).is_some_and(|decimal| decimal > exact) {
            face = face.next_down();
        }
        face
    }

    /// The lattice points of the half-open world box `[min, max)`, in exact decimal; `None` if it holds none.
    pub fn box_from_world(&self, min: [f64; 3], max: [f64; 3]) -> Option<LatticeBox> {
        let mut result = LatticeBox::of(LatticePoint::default());
        for axis in 0..3 {
            if max[axis].is_nan() {
                return None;
            }
            let first = self.first_index_at_least(axis, min[axis])?;
            let end = self.first_index_at_least(axis, max[axis]).unwrap_or(1 << BITS);
            result.min.0[axis] = first;
            result.max.0[axis] = end.checked_sub(1).filter(|&last| last >= first)?;
        }
        Some(result)
    }
}

/// What a power of ten is more than `powi` makes of it: nothing up to the 22nd, and not known beyond the 38th.
fn rest_of_power(exponent: u32) -> f64 {
    match exponent {
        23..=38 => (10_i128.pow(exponent) - 10_f64.powi(exponent as i32) as i128) as f64,
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn lattice() -> impl Strategy<Value = Lattice> {
        let quantum = prop::sample::select(vec![1e-6, 0.0001, 0.00025, 0.001, 0.01, 0.3, 1.0, 1000.0]);
        (quantum, prop::sample::select(vec![0.0, 0.25, 0.5, 0.123])).prop_map(|(q, part)| {
            let quantum = Decimal::from_f64(q).unwrap();
            let phase = Decimal::new(quantum.mantissa() * (part * 1000.0) as i128, quantum.exponent() - 3);
            Lattice::new([quantum; 3], [phase; 3]).unwrap()
        })
    }

    /// Powers of ten above the 22nd are no floats: what they lack was 1 % of a quantum at the far end. Coordinates within a hundredth
    /// of a step from the middle of two, at the far end; the indices were computed with fractions.
    #[test]
    fn rounding_to_a_quantum_of_many_digits_is_to_the_nearest() {
        let cases: [(i128, i32, f64, u64); 24] = [
            (46813507399154757, -23, 66840267.03153171, 236604866561659),
            (20366456748430167, -27, 3751.2575770097715, 278013023731314),
            (53060016610733911, -28, 901.6591153991332, 263756924602079),
            (96917312514434436, -24, 17704230.848043393, 276498555800739),
            (25572058754601588, -24, 4259888.947432426, 260408722874758),
            (52638471912025431, -28, 774.5965721162921, 240979068709864),
            (31357244218589965, -26, 56160.466593301215, 272923851185743),
            (54575342516354784, -25, 799162.1499230318, 240257815756691),
            (44203805422045132, -23, 72906923.27586055, 258758582410325),
            (46058899698686544, -25, 784928.8978298764, 264243500487151),
            (68192187494971287, -27, 11406.076897200428, 261088682055334),
            (49244024534182756, -24, 8829928.972196333, 273134645656195),
            (46128568137372048, -26, 73805.25068402915, 253823998631870),
            (62173866145726245, -25, 950200.7760025236, 246654602957151),
            (93708633152253414, -24, 15183960.627637845, 255858735733790),
            (33061754721518671, -24, 6104890.315023467, 278476120600922),
            (69878385494579825, -25, 1170439.4958674256, 261321634808601),
            (98168800894790696, -28, 1522.790253554131, 248944565836050),
            (52253392536772016, -26, 78290.81632888588, 243654146915771),
            (64165449901185480, -25, 1125840.413945908, 269283968318203),
            (13835747373508004, -25, 229872.25672136844, 259968714376187),
            (89728587101358681, -25, 1607297.9381939063, 272953850733038),
            (12098388697948319, -25, 220914.25075968905, 276423068951970),
            (78558438592831057, -25, 1214213.240246276, 248386776049767),
        ];
        for (mantissa, exponent, world, index) in cases {
            let lattice = Lattice::new([Decimal::new(mantissa, exponent); 3], [Decimal::ZERO; 3]).unwrap();
            assert_eq!(lattice.nearest_index(0, world), Some(index), "{world} in steps of {mantissa}e{exponent}");
        }
    }

    proptest! {
        #[test]
        fn world_and_back_is_the_same_index(lattice in lattice(), index in 0_u64..1 << 48) {
            let world = lattice.world_on_axis(0, index);
            prop_assert_eq!(lattice.nearest_index(0, world), Some(index));
            // Fifteen digits always survive the way through an f64; more need not.
            let exact = lattice.decimal_on_axis(0, index);
            if exact.mantissa().unsigned_abs() < 1_000_000_000_000_000 {
                prop_assert_eq!(Decimal::from_f64(world).unwrap(), exact);
            }
        }

        #[test]
        fn columns_of_coordinates_are_those_of_single_points(lattice in lattice(), at in prop::collection::vec(0_u64..1 << 48, 0..9)) {
            // Of two quanta of many digits, too: they take the slow way.
            let fine = Lattice::new([Decimal::new(123_456_789, -9); 3], [Decimal::new(98_765_432, -9); 3]).unwrap();
            for lattice in [lattice, fine] {
                let edges = at.iter().copied().chain([0, BIAS as u64, (1 << 48) - 1]);
                let indices: Vec<u64> = edges.collect();
                let mut world = Vec::new();
                lattice.extend_world(1, &indices, &mut world);
                let single: Vec<u64> = indices.iter().map(|&i| lattice.world_on_axis(1, i).to_bits()).collect();
                prop_assert_eq!(world.iter().map(|w| w.to_bits()).collect::<Vec<_>>(), single);
            }
        }

        #[test]
        fn rounding_is_within_half_a_quantum(lattice in lattice(), world in -1e6_f64..1e6) {
            let Some(index) = lattice.nearest_index(1, world) else { return Ok(()) };
            // The exact value of an f64 is not its shortest decimal; the difference is below an ulp.
            let error = Decimal::from_f64(world).unwrap().checked_sub(lattice.decimal_on_axis(1, index)).unwrap().to_f64();
            prop_assert!(error.abs() <= lattice.quantum_f64()[1] / 2.0 + world.abs() * f64::EPSILON, "{}", error);
        }

        #[test]
        fn box_faces_are_decided_in_decimal(lattice in lattice(), index in 1_u64..(1 << 48) - 1, nudge in -3_i64..=3) {
            let world = lattice.world_on_axis(2, index);
            let bound = f64::from_bits((world.to_bits() as i64 + nudge) as u64);
            prop_assume!(bound.is_finite() && Decimal::from_f64(bound).is_some());
            let exact = Decimal::from_f64(bound).unwrap();
            let first = lattice.first_index_at_least(2, bound).unwrap();
            prop_assert!(lattice.decimal_on_axis(2, first) >= exact);
            prop_assert!(first == 0 || lattice.decimal_on_axis(2, first - 1) < exact);
        }
    }

    proptest! {
        #[test]
        fn a_face_parts_an_index_from_the_one_below(
            q in prop::sample::select(vec![-12, -7, -3, 0, 6]), phase in 0_i128..10_000_000_000_000_000,
            near in -1_000_000_i64..1_000_000, far in 1_u64..=1 << 48,
        ) {
            // Of a phase with 16 digits half of the nearest floats are above the coordinate: they lost the point.
            let (quantum, phase) = (Decimal::new(1, q), Decimal::new(phase, q - 16));
            let lattice = Lattice::new([quantum; 3], [phase; 3]).unwrap();
            for index in [(BIAS + near) as u64, far] {
                let face = lattice.face_at(1, index);
                prop_assert_eq!(lattice.first_index_at_least(1, face).unwrap_or(1 << BITS), index, "{}", face);
            }
        }
    }

    #[test]
    fn boxes_are_half_open_and_tolerate_any_number() {
        let lattice = Lattice::uniform(0.01).unwrap();
        let inf = f64::INFINITY;
        let all = lattice.box_from_world([-inf; 3], [inf; 3]).unwrap();
        assert_eq!((all.min.0, all.max.0), ([0; 3], [(1 << 48) - 1; 3]));
        assert_eq!(lattice.box_from_world([0.0; 3], [0.0; 3]), None);
        assert_eq!(lattice.box_from_world([f64::NAN; 3], [1.0; 3]), None);
        assert_eq!(lattice.box_from_world([0.0; 3], [f64::NAN; 3]), None);
        let one = lattice.box_from_world([0.1; 3], [0.11; 3]).unwrap();
        assert_eq!(one.min, one.max);
        assert_eq!(lattice.world_from_lattice(one.min), [0.1; 3]);
        assert_eq!(lattice.first_index_at_least(0, 1e300), None);
        assert_eq!(lattice.first_index_at_least(0, -1e300), Some(0));
        let zero = lattice.first_index_at_least(0, 0.0).unwrap();
        assert_eq!(lattice.first_index_at_least(0, 1e-300), Some(zero + 1));
        assert_eq!(lattice.first_index_at_least(0, -1e-300), Some(zero));
        assert!(lattice.lattice_from_world([f64::NAN, 0.0, 0.0]).is_err());
        assert!(lattice.lattice_from_world([f64::INFINITY, 0.0, 0.0]).is_err());
    }
}

//! From lattice indices to the integers of a LAS record, fast where the grids coincide.

use crate::formats::FormatError;
use crate::lattice::{Lattice, SourceGrid, SourceMap};
use std::path::Path;

/// Points that are converted at a time.
pub(super) const BLOCK: usize = 512;

/// The largest index difference that an `f64` divides exactly.
const EXACT: u64 = 1 << 52;

/// X, Y, Z of a LAS file from lattice indices.
pub(super) struct Integers {
    map: SourceMap,
    /// `index = multiplier * X + addend` per axis, if the grids coincide.
    affine: Option<[(i64, i64); 3]>,
    lattice: Lattice,
    scale: [f64; 3],
    offset: [f64; 3],
}

impl Integers {
    /// The map for a file of this scale and offset; `None` if these are not usable.
    pub fn new(scale: [f64; 3], offset: [f64; 3], lattice: &Lattice) -> Option<Self> {
        let map = SourceMap::new(&SourceGrid::from_f64(scale, offset)?, lattice)?;
        Some(Self { affine: map.affine(), map, lattice: lattice.clone(), scale, offset })
    }

    /// Writes the integers of `indices`, at most [`BLOCK`] of them, to the start of `integers`; `shown` is what messages
    /// call the file.
    pub fn convert(
        &self,
        axis: usize,
        indices: &[u64],
        integers: &mut [i32; BLOCK],
        shown: &Path,
    ) -> Result<(), FormatError> {
        if self.convert_affine(axis, indices, integers) {
            return Ok(());
        }
        for (integer, &index) in integers.iter_mut().zip(indices) {
            let too_far = || FormatError::Unwritable { path: shown.into(), reason: self.too_far(axis, index) };
            *integer = self.map.from_lattice(axis, index).ok_or_else(too_far)?;
        }
        Ok(())
    }

    /// False if the grids do not coincide or some index is not on the file's grid or not in its range.
    fn convert_affine(&self, axis: usize, indices: &[u64], integers: &mut [i32; BLOCK]) -> bool {
        let Some((multiplier, addend)) = self.affine.map(|a| a[axis]) else { return false };
        let mut good = true;
        if multiplier == 1 {
            for (integer, &index) in integers.iter_mut().zip(indices) {
                let x = (index as i64).wrapping_sub(addend);
                *integer = x as i32;
                good &= i64::from(*integer) == x;
            }
        } else {
            // A quotient of integers below 2^53 that is an integer is exact in floats, and a float division is several
            // times as fast as one of 64-bit integers.
            let divisor = multiplier as f64;
            for (integer, &index) in integers.iter_mut().zip(indices) {
                let steps = (index as i64).wrapping_sub(addend);
                *integer = (steps as f64 / divisor) as i32;
                good &= i64::from(*integer) * multiplier == steps && steps.unsigned_abs() < EXACT;
            }
        }
        good
    }

    fn too_far(&self, axis: usize, index: u64) -> String {
        let name = ["x", "y", "z"][axis];
        let (scale, offset) = (self.scale[axis], self.offset[axis]);
        format!(
            "{name} coordinate {} does not fit 32 bits at scale {scale} and offset {offset}; \
             use a coarser --scale, or --split-by scan",
            self.lattice.world_on_axis(axis, index)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::Decimal;
    use proptest::prelude::*;

    fn convert(integers: &Integers, indices: &[u64]) -> Result<Vec<i32>, FormatError> {
        let mut out = [0; BLOCK];
        integers.convert(1, indices, &mut out, Path::new("a"))?;
        Ok(out[..indices.len()].to_vec())
    }

    proptest! {
        #[test]
        fn fast_and_exact_ways_agree(
            scale in prop::sample::select(vec![0.001, 0.01, 0.002, 1.0, 0.00025]),
            offset in prop::sample::select(vec![0.0, 5e6, 0.005, -123.456]),
            quantum in prop::sample::select(vec![0.001, 0.0001]),
            world in prop::collection::vec(-2e5_f64..2e5, 1..20),
        ) {
            let lattice = Lattice::uniform(quantum).unwrap();
            let integers = Integers::new([scale; 3], [offset; 3], &lattice).unwrap();
            let indices: Vec<_> = world.iter().map(|w| lattice.nearest_index(1, w + offset).unwrap()).collect();
            let exact: Option<Vec<_>> = indices.iter().map(|&i| integers.map.from_lattice(1, i)).collect();
            prop_assert_eq!(convert(&integers, &indices).ok(), exact);
        }
    }

    #[test]
    fn a_coordinate_that_does_not_fit_is_an_error_with_a_remedy() {
        let lattice = Lattice::uniform(0.001).unwrap();
        for (scale, fits, fits_not) in [(0.001, 2_147_483.647, 2_147_483.648), (0.002, 4_294_967.294, 4_294_967.296)] {
            let integers = Integers::new([scale; 3], [0.0; 3], &lattice).unwrap();
            let index = |w| lattice.nearest_index(1, w).unwrap();
            assert_eq!(convert(&integers, &[index(fits), index(-fits)]).unwrap(), [i32::MAX, -i32::MAX]);
            let error = convert(&integers, &[index(0.0), index(fits_not)]).unwrap_err().to_string();
            assert!(error.contains("--scale") && error.contains("--split-by scan"), "{error}");
        }
        assert!(Integers::new([0.0; 3], [0.0; 3], &lattice).is_none());
        assert!(Integers::new([f64::NAN; 3], [0.0; 3], &lattice).is_none());
        assert_eq!(Decimal::from_f64(2_147_483.648), Some(Decimal::new(2_147_483_648, -3)));
    }
}

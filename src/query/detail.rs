//! How fine: the sampling cell that an answer goes down to.

use super::QueryError;
use crate::lattice::{BITS, Cube};
use crate::octree::Metric;

/// How fine an answer is, apart from its capacity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub enum Detail {
    /// Every matching point, repeated positions included.
    #[default]
    Everything,
    /// One matching point per occupied cell of this level, 0 being the cells of the root; beyond the finest cell,
    /// everything.
    Level(u32),
    /// One matching point per occupied cell of at most this side, in CRS units; everything if that is below the quantum.
    Spacing(f64),
    /// The coarsest level that keeps every matching point within this distance, in CRS units, of a returned one, by the bound of
    /// a level.
    MaxError(f64),
}

impl Detail {
    /// The exponent of the cell to go down to; `None` for everything. `root` is the root of all points.
    ///
    /// # Errors
    ///
    /// [`QueryError::Detail`] for a spacing that is not positive and an error that is negative; NaN is neither.
    pub(crate) fn cell(self, root: Option<Cube>, g: u8, quantum: [f64; 3]) -> Result<Option<u8>, QueryError> {
        let refused = |what, value, expected| Err(QueryError::Detail { what, value, expected });
        let largest = quantum.into_iter().fold(0.0, f64::max);
        let coarsest = root.map_or(0, Cube::k).min(BITS);
        match self {
            Self::Everything => Ok(None),
            Self::Level(level) => {
                let finest = u32::from(coarsest.saturating_sub(g));
                Ok(finest.checked_sub(level).map(|c| c as u8))
            }
            Self::Spacing(spacing) => {
                if !(f64::MIN_POSITIVE..).contains(&spacing) {
                    return refused("spacing", spacing, "a length above 0");
                }
                Ok((0..=coarsest).rev().find(|&c| 2_f64.powi(c.into()) * largest <= spacing))
            }
            Self::MaxError(error) => {
                if !(0.0..).contains(&error) {
                    return refused("max error", error, "a length of 0 or more");
                }
                let metric = Metric::new(quantum);
                Ok((0..=coarsest).rev().find(|&c| metric.step_bound(c as i8, 7) <= error))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::LatticePoint;

    #[test]
    fn the_cell_is_the_coarsest_that_keeps_the_promise() {
        let root = Some(Cube::containing(LatticePoint([5; 3]), 20));
        let cell = |detail: Detail| detail.cell(root, 7, [0.01, 0.01, 0.02]).unwrap();
        assert_eq!(cell(Detail::Everything), None);
        assert_eq!(cell(Detail::Level(0)), Some(13));
        assert_eq!(cell(Detail::Level(13)), Some(0));
        assert_eq!(cell(Detail::Level(14)), None);
        assert_eq!(cell(Detail::Spacing(0.16)), Some(3));
        assert_eq!(cell(Detail::Spacing(0.159)), Some(2));
        assert_eq!(cell(Detail::Spacing(0.019)), None);
        assert_eq!(cell(Detail::Spacing(1e300)), Some(20));
        assert_eq!(cell(Detail::MaxError(0.0)), Some(0));
        for error in [0.03, 0.5, 7.0] {
            let c = cell(Detail::MaxError(error)).unwrap() as i8;
            let bound = |c| Metric::new([0.01, 0.01, 0.02]).step_bound(c, 7);
            assert!(bound(c) <= error && bound(c + 1) > error);
        }
        for bad in [Detail::Spacing(0.0), Detail::Spacing(f64::NAN), Detail::MaxError(-1.0), Detail::MaxError(f64::NAN)]
        {
            assert!(bad.cell(root, 7, [0.01; 3]).is_err());
        }
    }
}

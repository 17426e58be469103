//! Quantum and phase of a new store, from all inputs of its first command, whatever their order.

use super::IngestError;
use crate::lattice::{Decimal, Lattice, SourceGrid};

/// What one input says about the lattice.
#[derive(Clone, Debug)]
pub(super) struct Evidence {
    /// The source's integer grid, if it has one.
    pub grid: Option<SourceGrid>,
    /// Steps that do for its coordinates, where it has no grid and says so.
    pub step: Option<Decimal>,
    /// World bounds: of the points where there is no grid, else the header's.
    pub bounds: Option<([f64; 3], [f64; 3])>,
    /// Degrees in plan?
    pub geographic: bool,
}

/// A lattice that the user asked for, wholly or in part.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LatticeWish {
    /// One quantum, or one per axis.
    pub quantum: Option<[f64; 3]>,
    /// The phase per axis.
    pub phase: Option<[f64; 3]>,
}

/// The finest scale that any input has (per axis for geographic coordinates, else one number); for inputs without a
/// scale the largest power of ten that is at most 1e-6 of the extent, within 1e-6 to 1e-3. The phase is the residue of
/// the offsets where all inputs of the finest scale agree on it, else zero.
pub(super) fn choose(evidence: &[Evidence], wish: &LatticeWish) -> Result<(Lattice, Vec<String>), IngestError> {
    let mut notes = Vec::new();
    let quantum = match wish.quantum {
        Some(q) => {
            let decimals = q.map(|v| Decimal::from_f64(v).unwrap_or(Decimal::ZERO));
            [decimals[0], decimals[1], decimals[2]]
        }
        None => finest(evidence, &mut notes),
    };
    let phase = match wish.phase {
        Some(p) => {
            let mut phase = [Decimal::ZERO; 3];
            for axis in 0..3 {
                phase[axis] = Decimal::from_f64(p[axis]).ok_or_else(|| {
                    IngestError::Lattice(crate::lattice::LatticeError::Phase {
                        phase: p[axis],
                        quantum: quantum[axis].to_f64(),
                    })
                })?;
            }
            phase
        }
        None => std::array::from_fn(|axis| {
            let residue = common_residue(evidence, axis, quantum[axis]);
            // An offset with so many digits that its residue does not fit is treated as one that disagrees.
            let fits = Lattice::new([quantum[axis]; 3], [residue; 3]).is_ok();
            if fits { residue } else { Decimal::ZERO }
        }),
    };
    Ok((Lattice::new(quantum, phase)?, notes))
}

fn finest(evidence: &[Evidence], notes: &mut Vec<String>) -> [Decimal; 3] {
    let own = evidence.iter().map(|e| match (&e.grid, e.step, e.bounds) {
        (Some(grid), ..) => grid.scale,
        (None, Some(step), _) => [step; 3],
        // A tenth of a millimetre.
        (None, None, Some((min, max))) if e.geographic => {
            [Decimal::new(1, -9), Decimal::new(1, -9), for_extent(max[2] - min[2])]
        }
        (None, None, Some((min, max))) => [for_extent((0..3).map(|i| max[i] - min[i]).fold(0.0, f64::max)); 3],
        (None, None, None) => [Decimal::new(1, -3); 3],
    });
    let per_axis = own.reduce(|a, b| std::array::from_fn(|i| a[i].min(b[i]))).unwrap_or([Decimal::new(1, -3); 3]);
    let one = per_axis[0].min(per_axis[1]).min(per_axis[2]);
    let differ = per_axis[0] != per_axis[2] || per_axis[1] != per_axis[2];
    if !evidence.iter().any(|e| e.geographic) {
        return [one; 3];
    }
    let quantum = match per_axis {
        [x, y, z] if differ => format!("the quantum is {x} x {y} x {z} per axis, and "),
        _ => String::new(),
    };
    notes.push(format!(
        "coordinates are degrees and metres: {quantum}distances (spacing, error bounds, spheres) mix the two units"
    ));
    per_axis
}

/// The largest power of ten that is at most a millionth of `extent`, within 1e-6 to 1e-3.
fn for_extent(extent: f64) -> Decimal {
    let fits = |exponent: i32| Decimal::new(1, exponent).to_f64() <= extent / 1e6;
    (-6..=-3).rev().find(|&e| fits(e)).map_or(Decimal::new(1, -6), |e| Decimal::new(1, e))
}

fn common_residue(evidence: &[Evidence], axis: usize, quantum: Decimal) -> Decimal {
    let grids = || evidence.iter().filter_map(|e| e.grid);
    let Some(finest) = grids().map(|g| g.scale[axis]).min() else { return Decimal::ZERO };
    // On a coarser lattice nothing is exact, and which offset is left would hang on the file.
    if quantum > finest {
        return Decimal::ZERO;
    }
    let mut residues = grids().filter(|g| g.scale[axis] == finest).map(|g| g.offset[axis].checked_rem_euclid(quantum));
    let first = residues.next().flatten().unwrap_or(Decimal::ZERO);
    if residues.all(|r| r == Some(first)) { first } else { Decimal::ZERO }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn las(scale: f64, offset: f64) -> Evidence {
        let grid = SourceGrid::from_f64([scale; 3], [offset; 3]);
        Evidence { grid, bounds: None, step: None, geographic: false }
    }

    fn quantum(evidence: &[Evidence]) -> f64 {
        choose(evidence, &LatticeWish::default()).unwrap().0.quantum_f64()[0]
    }

    #[test]
    fn the_finest_scale_wins_in_any_order() {
        assert_eq!(quantum(&[las(0.01, 0.0), las(0.001, 0.0)]), 0.001);
        assert_eq!(quantum(&[las(0.001, 0.0), las(0.01, 0.0)]), 0.001);
    }

    #[test]
    fn sources_without_a_scale_get_a_power_of_ten_by_extent() {
        let cloud =
            |extent: f64| Evidence { grid: None, bounds: Some(([0.0; 3], [extent; 3])), step: None, geographic: false };
        assert_eq!(quantum(&[cloud(0.15)]), 1e-6);
        assert_eq!(quantum(&[cloud(10.0)]), 1e-5);
        assert_eq!(quantum(&[cloud(99.0)]), 1e-5);
        assert_eq!(quantum(&[cloud(5000.0)]), 1e-3);
        assert_eq!(quantum(&[cloud(1e9)]), 1e-3);
    }

    #[test]
    fn a_lattice_that_is_coarser_than_the_files_has_no_phase_of_theirs() {
        let wish = LatticeWish { quantum: Some([2.0; 3]), ..LatticeWish::default() };
        let phase = |e: &[Evidence]| choose(e, &wish).unwrap().0.phase()[0].to_f64();
        assert_eq!(phase(&[las(1.0, 5.0)]), 0.0);
        assert_eq!(phase(&[las(2.0, 5.0)]), 1.0);
    }

    #[test]
    fn a_common_odd_offset_becomes_the_phase() {
        let phase = |e: &[Evidence]| choose(e, &LatticeWish::default()).unwrap().0.phase()[0].to_f64();
        assert_eq!(phase(&[las(0.01, 12.005), las(0.01, 3.005)]), 0.005);
        assert_eq!(phase(&[las(0.01, 12.005), las(0.01, 3.0)]), 0.0);
        assert_eq!(phase(&[las(0.01, 12.0), las(0.1, 3.05)]), 0.0);
    }

    #[test]
    fn an_offset_of_noise_gives_no_phase_and_leaves_those_of_other_axes() {
        let grid = SourceGrid::from_f64([0.01; 3], [-1.2345678901234567e-17, 12.005, 5e-324]);
        let evidence = Evidence { grid, bounds: None, step: None, geographic: false };
        let (lattice, _) = choose(&[evidence], &LatticeWish::default()).unwrap();
        assert_eq!(lattice.phase().map(Decimal::to_f64), [0.0, 0.005, 0.0]);
    }

    #[test]
    fn degrees_keep_a_quantum_per_axis() {
        let grid = SourceGrid::from_f64([1e-7, 1e-7, 0.01], [0.0; 3]);
        let (lattice, notes) =
            choose(&[Evidence { grid, bounds: None, step: None, geographic: true }], &LatticeWish::default()).unwrap();
        assert_eq!(lattice.quantum_f64(), [1e-7, 1e-7, 0.01]);
        assert_eq!(notes.len(), 1);
        // Floats of eight digits are a millimetre.
        let bounds = Some(([11.5, 48.1, 500.0], [11.6, 48.2, 520.0]));
        let floats = Evidence { grid: None, bounds, step: None, geographic: true };
        let (lattice, notes) = choose(&[floats], &LatticeWish::default()).unwrap();
        assert_eq!((lattice.quantum_f64(), notes.len()), ([1e-9, 1e-9, 1e-5], 1));
    }
}

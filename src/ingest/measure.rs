//! Where the points of a source are, before they are read.

use super::IngestError;
use super::context::Context;
use super::progress::Stage;
use super::report::Stages;
use super::sources::Source;
use crate::formats::FormatError;
use crate::lattice::{BITS, Lattice, LatticeBox, LatticePoint};
use crate::points::PositionKind;
use rayon::prelude::*;

pub(super) type WorldBounds = ([f64; 3], [f64; 3]);

/// World bounds of the sources, as their headers say, or by reading the positions where the header says nothing. What they
/// are collected in says whether all are measured though one can't be.
pub(super) fn measure<C: FromIterator<Result<Option<WorldBounds>, IngestError>>>(
    context: &Context<'_>,
    sources: &[Source],
    stages: &mut Stages,
) -> C {
    let lacking = |s: &Source| {
        let info = s.reader.info();
        info.bounds_hint.is_none() && info.layout.position == PositionKind::World
    };
    let records = sources.iter().filter(|s| lacking(s)).map(|s| s.reader.info().records);
    let total = records.fold(0, u64::saturating_add);
    let measured = || {
        let of = |source: &Source| {
            if lacking(source) { bounds_of(context, source) } else { Ok(source.reader.info().bounds_hint) }
        };
        sources.iter().map(of).collect()
    };
    if total == 0 {
        return measured();
    }
    context.progress.stage(Stage::Measure, total);
    stages.time(Stage::Measure, total, measured)
}

fn bounds_of(context: &Context<'_>, source: &Source) -> Result<Option<WorldBounds>, IngestError> {
    let stride = source.reader.info().layout.stride();
    let pieces = source.reader.pieces(1 << 18);
    let parts: Vec<_> = pieces
        .into_par_iter()
        .map(|piece| {
            let mut bounds: Option<WorldBounds> = None;
            source.reader.read(piece, &mut |records| {
                for record in records.chunks_exact(stride) {
                    let world = world_position(record);
                    if world.iter().all(|v| v.is_finite()) {
                        bounds = Some(widen(bounds, (world, world)));
                    }
                }
                context.progress.advance((records.len() / stride) as u64);
                !context.progress.cancelled()
            })?;
            Ok::<_, FormatError>(bounds)
        })
        .collect::<Result<_, _>>()?;
    context.go_on()?;
    Ok(parts.into_iter().flatten().reduce(|a, b| widen(Some(a), b)))
}

fn world_position(record: &[u8]) -> [f64; 3] {
    std::array::from_fn(|i| {
        let mut bytes = [0; 8];
        bytes.copy_from_slice(&record[8 * i..8 * i + 8]);
        f64::from_le_bytes(bytes)
    })
}

fn widen(bounds: Option<WorldBounds>, other: WorldBounds) -> WorldBounds {
    let Some((min, max)) = bounds else { return other };
    (std::array::from_fn(|i| min[i].min(other.0[i])), std::array::from_fn(|i| max[i].max(other.1[i])))
}

/// Where the points of these sources are going to be, as far as headers can be believed, cut to the lattice.
pub(super) fn hinted_bounds(
    lattice: &Lattice,
    sources: &[Source],
    measured: &[Option<WorldBounds>],
) -> Option<LatticeBox> {
    let mut hint: Option<LatticeBox> = None;
    for (source, bounds) in sources.iter().zip(measured) {
        let Some((min, max)) = bounds else { continue };
        if source.reader.info().records == 0 {
            continue;
        }
        let clamp = |world: [f64; 3]| {
            LatticePoint(std::array::from_fn(|i| {
                let last = (1_u64 << BITS) - 1;
                lattice.first_index_at_least(i, world[i]).unwrap_or(last).min(last)
            }))
        };
        let (a, b) = (clamp(*min), clamp(*max));
        let corner = LatticeBox::of(a).with(b);
        hint = Some(hint.map_or(corner, |h| h.union(&corner)));
    }
    hint
}

//! Buckets that are too large for one go, cut into those of smaller cubes.

use super::IngestError;
use super::build::Plan;
use super::partition::{Bucket, Segment};
use super::rows::RowKey;
use super::spill::Place;
use crate::lattice::Cube;

/// Bytes of a segment that is written anew.
const SEGMENT_BYTES: usize = 64 << 10;

/// Appends `bucket` to `into`, in key order as buckets of at most `most_rows` rows each. Only points in a cube whose cells are
/// lattice steps are never cut. Rows in the temporary file stay there, and it does not grow.
pub(super) fn split<K: RowKey>(
    plan: &Plan<'_>,
    bucket: Bucket,
    most_rows: u64,
    into: &mut Vec<Bucket>,
) -> Result<(), IngestError> {
    let Plan { params, root, .. } = *plan;
    // It may be larger than the root; then it is the only one.
    let cube = if root.contains_cube(bucket.cube) { bucket.cube } else { root };
    if bucket.rows <= most_rows {
        into.push(Bucket { cube, ..bucket });
        return Ok(());
    }
    // At once to where its rows part: a mass of points in one place would be written again for every level.
    let cube = spanning::<K>(plan, &bucket)?.ancestor(params.g);
    if cube.k() <= params.g {
        tell_if_large(plan, bucket.rows);
        into.push(Bucket { cube, ..bucket });
        return Ok(());
    }
    for child in distribute::<K>(plan, bucket, cube)? {
        split::<K>(plan, child, most_rows, into)?;
    }
    Ok(())
}

/// The smallest cube that holds all rows.
fn spanning<K: RowKey>(plan: &Plan<'_>, bucket: &Bucket) -> Result<Cube, IngestError> {
    let mut buffer = Vec::new();
    let mut extremes: Option<(K, K)> = None;
    for segment in &bucket.segments {
        let bytes = match &segment.place {
            Place::Memory(bytes) => bytes,
            place => {
                buffer.clear();
                place.read_spilled(plan.spill, &mut buffer)?;
                &buffer
            }
        };
        let keys = bytes.chunks_exact(segment.row_bytes::<K>(plan.scans)).map(K::read);
        extremes = keys.fold(extremes, |so_far, key| {
            let (least, greatest) = so_far.unwrap_or((key, key));
            Some((least.min(key), greatest.max(key)))
        });
        go_on(plan)?;
    }
    let (least, greatest) = extremes.unwrap_or_default();
    let point = |key: K| key.full(bucket.cube.first_key()).point();
    Ok(Cube::spanning(point(least), point(greatest), 0))
}

/// The rows of `bucket`, all inside `cube`, as buckets of its octants, in key order.
fn distribute<K: RowKey>(plan: &Plan<'_>, bucket: Bucket, cube: Cube) -> Result<Vec<Bucket>, IngestError> {
    let digit = cube.k() - 1;
    let mut children: Vec<(Bucket, Vec<u8>)> = (cube.octants_in_key_order().into_iter())
        .filter_map(|octant| cube.child(octant))
        .map(|cube| (Bucket { cube, rows: 0, segments: Vec::new() }, Vec::new()))
        .collect();
    let hand_over = |(child, rows): &mut (Bucket, Vec<u8>), slot: u32, row_bytes: usize| {
        if !rows.is_empty() {
            let place = Place::again(rows, plan.spill)?;
            child.segments.push(Segment { slot, rows: (rows.len() / row_bytes) as u32, place });
            rows.clear();
        }
        Ok::<_, IngestError>(())
    };
    let mut buffer = Vec::new();
    let mut segments = bucket.segments.into_iter().peekable();
    while let Some(segment) = segments.next() {
        go_on(plan)?;
        let (slot, row_bytes) = (segment.slot, segment.row_bytes::<K>(plan.scans));
        for row in segment.place.take(plan.spill, &mut buffer)?.chunks_exact(row_bytes) {
            let child = &mut children[usize::from(K::read(row).digit(digit))];
            child.0.rows += 1;
            child.1.extend_from_slice(row);
            if child.1.len() >= SEGMENT_BYTES {
                hand_over(child, slot, row_bytes)?;
            }
        }
        if segments.peek().is_none_or(|next| next.slot != slot) {
            children.iter_mut().try_for_each(|child| hand_over(child, slot, row_bytes))?;
        }
    }
    Ok(children.into_iter().map(|child| child.0).filter(|bucket| bucket.rows > 0).collect())
}

fn go_on(plan: &Plan<'_>) -> Result<(), IngestError> {
    if plan.progress.cancelled() { Err(IngestError::Interrupted) } else { Ok(()) }
}

/// Says what points at one place take that are more than the memory has room for: they are put in order at once.
fn tell_if_large(plan: &Plan<'_>, rows: u64) {
    let payload = plan.scans.iter().map(|s| s.plan.layout.payload as u64).max().unwrap_or(0);
    // Rows as they were read, in bins, in order and as records, then as columns and encoded; keys, twice while they are sorted.
    // Measured: 124 bytes of points with 8 bytes of payload, 206 of such with 22.
    let bytes = rows.saturating_mul(6 * payload + 3 * SORTED_BYTES);
    if bytes > plan.memory.max(WORTH_TELLING) {
        plan.progress.say(&format!(
            "{rows} points lie at one place, or nearly so, and are put in order at once: about {} MiB of memory, more than {} MiB",
            bytes.div_ceil(1 << 20),
            plan.memory >> 20
        ));
    }
}

/// So much memory is taken whatever was asked for.
const WORTH_TELLING: u64 = 2 << 20;

/// What sorting takes of a row beside its bytes.
const SORTED_BYTES: u64 = 24;

#[cfg(test)]
mod tests {
    use super::super::gather::ScanColumns;
    use super::super::partition::RowPlan;
    use super::super::spill::Spill;
    use super::*;
    use crate::lattice::{BIAS, LatticePoint};
    use crate::octree::Params;
    use crate::points::{Attribute, PositionKind, RecordLayout, ScalarType};
    use crate::store::{ChunkIds, ScanTable};
    use proptest::prelude::*;
    use std::sync::Mutex;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(150))]
        #[test]
        fn pieces_have_all_rows_and_are_small_in_order_and_disjoint(
            places in prop::collection::vec(([0_u64..64, 0..64, 0..64], 0_u32..2), 1..400),
            // Some of them at one place.
            same in 0_usize..100,
            most_rows in 1_u64..80,
            // Beyond the root, too.
            k in 6_u8..9,
            spilled: bool,
        ) {
            let plan = |slot, ty| {
                let layout = RecordLayout::canonical(PositionKind::Lattice, [Attribute::new("A", ty)]);
                RowPlan::new(slot, layout, None)
            };
            let plans = [plan(0, ScalarType::U32), plan(1, ScalarType::U16)];
            let scans = [0, 1].map(|i| ScanColumns::new(i, [0; 32], &plans[i as usize], Vec::new()));
            let first = places[0];
            let places: Vec<_> = std::iter::repeat_n(first, same).chain(places).collect();
            let point = |xyz: [u64; 3]| LatticePoint(xyz.map(|c| (BIAS as u64 >> 9 << 9) + c));
            let mut rows: Vec<(u32, Vec<u8>)> = (0_u16..).zip(&places).map(|(number, &(xyz, slot))| {
                let mut row = vec![0; 8];
                <u64 as RowKey>::of(point(xyz)).write(&mut row);
                row.extend(number.to_le_bytes());
                row.resize(8 + plans[slot as usize].layout.payload, 0);
                (slot, row)
            }).collect();
            let folder = tempfile::tempdir().unwrap();
            let spill = spilled.then(|| Spill::create(&folder.path().join("a.esker")).unwrap());
            // Segments of a few rows, by scan.
            rows.sort_by_key(|row| row.0);
            let segment = |rows: &[(u32, Vec<u8>)]| {
                let bytes: Vec<u8> = rows.iter().flat_map(|row| row.1.clone()).collect();
                let place = match &spill {
                    Some(spill) => Place::Spilled(spill.append(&bytes).unwrap()),
                    None => Place::Memory(bytes),
                };
                Segment { slot: rows[0].0, rows: rows.len() as u32, place }
            };
            let segments = rows.chunk_by(|a, b| a.0 == b.0).flat_map(|of_scan| of_scan.chunks(7)).map(segment).collect();
            let bytes = spill.as_ref().map(Spill::bytes);
            let cube = Cube::containing(point([0; 3]), k);
            let bucket = Bucket { cube, rows: rows.len() as u64, segments };

            let (table, ids, large) = (ScanTable::default(), ChunkIds::default(), Mutex::default());
            let points: Vec<_> = places.iter().map(|p| point(p.0)).collect();
            let params = Params { g: 2, leaf_capacity: 8 };
            let root = points.iter().fold(Cube::containing(points[0], 2), |c, p| Cube::spanning(c.low(), *p, c.k()));
            let sink = super::super::build::Sink::Encoded(&|_| Ok(()));
            let plan = Plan {
                params, layer: 0, root, scans: &scans, table: &table, ids: &ids, spill: spill.as_ref(), most_rows,
                memory: 1 << 30, threads: 1, progress: &(), large, sink,
            };
            let mut pieces = Vec::new();
            split::<u64>(&plan, bucket, most_rows, &mut pieces).unwrap();

            prop_assert!(pieces.windows(2).all(|w| w[0].cube.last_key() < w[1].cube.first_key()));
            let mut got = Vec::new();
            for Bucket { cube, rows, segments } in &pieces {
                prop_assert!(root.contains_cube(*cube) && (*rows <= most_rows || cube.k() == params.g));
                prop_assert_eq!(*rows, segments.iter().map(|s| u64::from(s.rows)).sum::<u64>());
                for segment in segments {
                    let mut buffer = Vec::new();
                    let bytes = segment.place.take(spill.as_ref(), &mut buffer).unwrap();
                    let of_piece = bytes.chunks_exact(segment.row_bytes::<u64>(&scans));
                    prop_assert_eq!(of_piece.len(), segment.rows as usize);
                    for row in of_piece {
                        prop_assert!(cube.contains(<u64 as RowKey>::read(row).full(cube.first_key()).point()));
                        got.push((segment.slot, row.to_vec()));
                    }
                }
            }
            got.sort();
            rows.sort();
            prop_assert_eq!(got, rows);
            prop_assert_eq!(spill.as_ref().map(Spill::bytes), bytes, "the file does not grow");
        }
    }
}

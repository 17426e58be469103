//! Rows of `zone`: the zone maps, apart from the node rows so that selection does not load them.

use super::super::error::RowError;
use super::super::model::{Range, Slot, Zones};
use super::node::{node_name, row_name};
use super::{Put, Sql, Take, Taken, checked, put_row};
use crate::lattice::Cube;
use rusqlite::Connection;

const TABLE: &str = "zone";

/// The zone maps of a node, which must be there.
pub(in crate::store) fn load_zones(connection: &Connection, layer: u16, cube: Cube) -> Result<Zones, RowError> {
    let mut statement =
        connection.prepare_cached("SELECT layer, key, zones, checksum FROM zone WHERE layer = ? AND key = ?")?;
    let key = cube.node_key();
    let mut rows = statement.query((layer, &key.0[..]))?;
    let row = rows.next()?.ok_or_else(|| RowError::damage(TABLE, node_name(layer.into(), &key.0), "is missing"))?;
    let columns = checked(TABLE, row, 4, || row_name(row))?;
    columns.take(2, take_all)
}

pub(in crate::store) fn put_zones(
    connection: &Connection,
    layer: u16,
    cube: Cube,
    zones: &Zones,
) -> Result<(), RowError> {
    let mut put = Put::default();
    put_all(&mut put, zones);
    put_row(
        connection,
        TABLE,
        "INSERT OR REPLACE INTO zone (layer, key, zones, checksum) VALUES (?, ?, ?, ?)",
        &[Sql::Int(layer.into()), Sql::Blob(&cube.node_key().0), Sql::Blob(&put.0)],
    )
}

/// Removes a node's zone maps; false if there are none.
pub(in crate::store) fn delete_zones(connection: &Connection, layer: u16, cube: Cube) -> Result<bool, RowError> {
    let mut statement = connection.prepare_cached("DELETE FROM zone WHERE layer = ? AND key = ?")?;
    Ok(statement.execute((layer, &cube.node_key().0[..]))? == 1)
}

/// The subtree's maps are the own ones in a leaf: they are stored once.
const AS_OWN: u8 = 1;
const LISTED: u8 = 0;

fn put_all(put: &mut Put, zones: &Zones) {
    put_ranges(put, &zones.own);
    if zones.subtree == zones.own {
        put.u8(AS_OWN);
    } else {
        put.u8(LISTED);
        put_ranges(put, &zones.subtree);
    }
}

fn take_all(take: &mut Take<'_>) -> Taken<Zones> {
    let own = take_ranges(take)?;
    let subtree = match take.u8()? {
        AS_OWN => own.clone(),
        LISTED => take_ranges(take)?,
        other => return Err(format!("unknown kind of zone maps: {other}")),
    };
    Ok(Zones { own, subtree })
}

fn put_ranges(put: &mut Put, ranges: &[(Slot, Range)]) {
    put.varint(ranges.len() as u64);
    for &(slot, range) in ranges {
        put.varint(slot.into());
        match range {
            Range::OnlyNan => put.u8(0),
            Range::Unsigned(low, high) => {
                put.u8(1);
                put.varint(low);
                put.varint(high.wrapping_sub(low));
            }
            Range::Signed(low, high) => {
                put.u8(2);
                put.varint((low << 1 ^ low >> 63) as u64);
                put.varint(high.wrapping_sub(low) as u64);
            }
            Range::Float(low, high) => {
                put.u8(3);
                put.f64(low);
                put.f64(high);
            }
        }
    }
}

fn take_ranges(take: &mut Take<'_>) -> Taken<Vec<(Slot, Range)>> {
    let n = take.count(2)?;
    let mut ranges: Vec<(Slot, Range)> = Vec::with_capacity(n);
    for _ in 0..n {
        let slot = take.small()?;
        let range = match take.u8()? {
            0 => Range::OnlyNan,
            1 => {
                let low = take.varint()?;
                Range::Unsigned(low, low.checked_add(take.varint()?).ok_or("a range is too large")?)
            }
            2 => {
                let low = take.varint()?;
                let low = (low >> 1) as i64 ^ -((low & 1) as i64);
                Range::Signed(low, low.checked_add_unsigned(take.varint()?).ok_or("a range is too large")?)
            }
            3 => {
                let (low, high) = (take.f64()?, take.f64()?);
                if !(low <= high) {
                    return Err(format!("the range of column {slot} is inside out"));
                }
                Range::Float(low, high)
            }
            kind => return Err(format!("unknown kind of range: {kind}")),
        };
        ranges.push((slot, range));
    }
    if ranges.is_sorted_by(|a, b| a.0 < b.0) { Ok(ranges) } else { Err("the ranges are not ascending".into()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn range() -> impl Strategy<Value = Range> {
        prop_oneof![
            Just(Range::OnlyNan),
            (any::<u64>(), any::<u64>()).prop_map(|(a, b)| Range::Unsigned(a.min(b), a.max(b))),
            (any::<i64>(), any::<i64>()).prop_map(|(a, b)| Range::Signed(a.min(b), a.max(b))),
            (-1e300..1e300, -1e300..1e300).prop_map(|(a, b): (f64, f64)| Range::Float(a.min(b), a.max(b))),
        ]
    }

    proptest! {
        #[test]
        fn zone_maps_come_back_and_noise_is_refused_or_ordered(
            own in prop::collection::btree_map(any::<u16>(), range(), 0..9),
            subtree in prop::option::of(prop::collection::btree_map(any::<u16>(), range(), 0..9)),
            noise in prop::collection::vec(any::<u8>(), 0..60),
        ) {
            let own: Vec<_> = own.into_iter().collect();
            let zones = Zones { subtree: subtree.map_or(own.clone(), |s| s.into_iter().collect()), own };
            let mut put = Put::default();
            put_all(&mut put, &zones);
            let mut take = Take(&put.0);
            prop_assert_eq!(take_all(&mut take), Ok(zones));
            prop_assert!(take.end().is_ok());
            if let Ok(found) = take_all(&mut Take(&noise)) {
                for (_, range) in found.own {
                    let in_order = match range {
                        Range::OnlyNan => true,
                        Range::Unsigned(a, b) => a <= b,
                        Range::Signed(a, b) => a <= b,
                        Range::Float(a, b) => a <= b,
                    };
                    prop_assert!(in_order);
                }
            }
        }
    }
}

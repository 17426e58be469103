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
    columns.take(2, |t| Ok(Zones { own: take_ranges(t)?, subtree: take_ranges(t)? }))
}

pub(in crate::store) fn put_zones(
    connection: &Connection,
    layer: u16,
    cube: Cube,
    zones: &Zones,
) -> Result<(), RowError> {
    let mut put = Put::default();
    put_ranges(&mut put, &zones.own);
    put_ranges(&mut put, &zones.subtree);
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

fn put_ranges(put: &mut Put, ranges: &[(Slot, Range)]) {
    put.varint(ranges.len() as u64);
    for &(slot, range) in ranges {
        put.varint(slot.into());
        let (kind, low, high) = match range {
            Range::OnlyNan => (0, 0, 0),
            Range::Unsigned(a, b) => (1, a, b),
            Range::Signed(a, b) => (2, a as u64, b as u64),
            Range::Float(a, b) => (3, a.to_bits(), b.to_bits()),
        };
        put.u8(kind);
        if kind > 0 {
            put.u64(low);
            put.u64(high);
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
            1 => Range::Unsigned(take.u64()?, take.u64()?),
            2 => Range::Signed(take.u64()? as i64, take.u64()? as i64),
            3 => Range::Float(take.f64()?, take.f64()?),
            kind => return Err(format!("unknown kind of range: {kind}")),
        };
        let ordered = match range {
            Range::OnlyNan => true,
            Range::Unsigned(a, b) => a <= b,
            Range::Signed(a, b) => a <= b,
            Range::Float(a, b) => a <= b,
        };
        if !ordered {
            return Err(format!("the range of column {slot} is inside out"));
        }
        ranges.push((slot, range));
    }
    if ranges.is_sorted_by(|a, b| a.0 < b.0) { Ok(ranges) } else { Err("the ranges are not ascending".into()) }
}

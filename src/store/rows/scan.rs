//! Rows of `scan`.

use super::super::error::RowError;
use super::super::model::{FIRST_ATTRIBUTE, Rejected, Scan, ScanId};
use super::{Columns, Put, Sql, checked, put_row, to_i64, to_json};
use crate::lattice::Exactness;
use crate::points::LasFacts;
use rusqlite::Connection;

const TABLE: &str = "scan";

/// All of them, ascending by id.
pub(in crate::store) fn load_scans(connection: &Connection) -> Result<Vec<Scan>, RowError> {
    let mut statement = connection.prepare_cached(
        "SELECT id, name, source, source_bytes, identity, time, pose, read, stored, not_finite, out_of_range, \
         truncated, bounds, exactness, largest_error, format, las, vlrs, color_depth, visible, attributes, crs, \
         checksum FROM scan ORDER BY id",
    )?;
    let mut rows = statement.query([])?;
    let mut scans = Vec::new();
    while let Some(row) = rows.next()? {
        let id = row.get_ref(0)?.as_i64().unwrap_or(-1);
        scans.push(decode(&checked(TABLE, row, 23, || format!("scan {id}"))?)?);
    }
    Ok(scans)
}

fn decode<K: Fn() -> String>(columns: &Columns<'_, K>) -> Result<Scan, RowError> {
    let pose = columns.take(6, |t| {
        let mut pose = [0.0; 16];
        for v in &mut pose {
            *v = t.f64()?;
        }
        Ok(pose)
    })?;
    let bounds = if columns.is_null(12) { None } else { Some(columns.take(12, |t| t.lattice_box())?) };
    let exactness = columns.text(13)?;
    let color_depth = if columns.is_null(18) { None } else { Some(columns.int(18)?) };
    let attributes = columns.take(20, |t| {
        let mut slots = Vec::new();
        while !t.0.is_empty() {
            slots.push(t.u16()?);
        }
        Ok(slots)
    })?;
    if attributes.iter().any(|&s| s < FIRST_ATTRIBUTE) {
        return Err(columns.wrong("an attribute's id is reserved"));
    }
    Ok(Scan {
        id: columns.int(0)?,
        name: columns.text(1)?.to_owned(),
        source: columns.text(2)?.to_owned(),
        source_bytes: columns.int(3)?,
        identity: columns.blob(4)?.try_into().map_err(|_| columns.wrong("the identity is not 32 bytes"))?,
        time: columns.int(5)?,
        pose,
        read: columns.int(7)?,
        stored: columns.int(8)?,
        rejected: Rejected { not_finite: columns.int(9)?, out_of_range: columns.int(10)?, truncated: columns.int(11)? },
        bounds,
        exactness: Exactness::from_word(exactness)
            .ok_or_else(|| columns.wrong(format!("unknown exactness {exactness}")))?,
        largest_error: columns.real(14)?,
        format: columns.text(15)?.to_owned(),
        las: las_facts(columns)?,
        color_depth,
        visible: columns.int::<u8>(19)? != 0,
        attributes,
        crs: columns.json(21)?,
    })
}

/// The facts are JSON; the bytes of the variable length records, which would be bulky there, are a column of their own.
fn las_facts<K: Fn() -> String>(columns: &Columns<'_, K>) -> Result<Option<LasFacts>, RowError> {
    let Some(mut las) = columns.json::<LasFacts>(16)? else {
        return if columns.is_null(17) { Ok(None) } else { Err(columns.wrong("records without a LAS header")) };
    };
    columns.take(17, |t| {
        for vlr in &mut las.vlrs {
            let n = t.small()?;
            vlr.data = t.bytes(n)?.to_vec();
        }
        Ok(())
    })?;
    Ok(Some(las))
}

/// Writes a new row.
pub(in crate::store) fn put_scan(connection: &Connection, scan: &Scan) -> Result<(), RowError> {
    let mut pose = Put::default();
    scan.pose.iter().for_each(|&v| pose.f64(v));
    let bounds = scan.bounds.map(|b| {
        let mut put = Put::default();
        put.lattice_box(&b);
        put.0
    });
    let mut attributes = Put::default();
    scan.attributes.iter().for_each(|&s| attributes.u16(s));
    let mut las = scan.las.clone();
    let vlrs = las.as_mut().map(|las| {
        let mut put = Put::default();
        for vlr in &mut las.vlrs {
            let data = std::mem::take(&mut vlr.data);
            put.varint(data.len() as u64);
            put.0.extend_from_slice(&data);
        }
        put.0
    });
    if !scan.largest_error.is_finite() {
        return Err(RowError::Inconsistent(format!("scan {}: the largest error is {}", scan.name, scan.largest_error)));
    }
    let count = |v| to_i64(v, "a count of a scan").map(Sql::Int);
    put_row(
        connection,
        TABLE,
        "INSERT INTO scan (id, name, source, source_bytes, identity, time, pose, read, stored, not_finite, \
         out_of_range, truncated, bounds, exactness, largest_error, format, las, vlrs, color_depth, visible, \
         attributes, crs, checksum) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
        &[
            Sql::Int(scan.id.into()),
            Sql::Text(&scan.name),
            Sql::Text(&scan.source),
            count(scan.source_bytes)?,
            Sql::Blob(&scan.identity),
            Sql::Int(scan.time),
            Sql::Blob(&pose.0),
            count(scan.read)?,
            count(scan.stored)?,
            count(scan.rejected.not_finite)?,
            count(scan.rejected.out_of_range)?,
            count(scan.rejected.truncated)?,
            Sql::blob(&bounds),
            Sql::Text(scan.exactness.word()),
            // SQLite keeps no negative zero.
            Sql::Real(scan.largest_error.abs()),
            Sql::Text(&scan.format),
            Sql::text(&to_json(&las)?),
            Sql::blob(&vlrs),
            scan.color_depth.map_or(Sql::Null, |d| Sql::Int(d.into())),
            Sql::Int(scan.visible.into()),
            Sql::Blob(&attributes.0),
            Sql::text(&to_json(&scan.crs)?),
        ],
    )
}

/// Removes a scan's row; false if there is none.
pub(in crate::store) fn delete_scan(connection: &Connection, id: ScanId) -> Result<bool, RowError> {
    Ok(connection.prepare_cached("DELETE FROM scan WHERE id = ?")?.execute([id])? == 1)
}

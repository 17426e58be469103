//! Rows of `node`: all that selection needs, packed.

use super::super::error::RowError;
use super::super::model::{NodeHead, PartHead, ScanCount, Shape, Slot, Step};
use super::{Columns, Put, Sql, Take, Taken, checked, put_row};
use crate::codec::BlockSize;
use crate::lattice::{Cube, NodeKey};
use rusqlite::{Connection, Row};

const TABLE: &str = "node";

const LEAF: u8 = 1;
const OWN_BOUNDS: u8 = 2;
const COLOR: u8 = 4;

/// How a node is named in messages.
pub(super) fn node_name(layer: i64, key: &[u8]) -> String {
    let hex: String = key.iter().map(|b| format!("{b:02x}")).collect();
    match NodeKey::from_bytes(key).and_then(|k| Cube::from_node_key(&k)) {
        Some(cube) => format!("node {hex} of layer {layer} (side 2^{} at {:?})", cube.k(), cube.low().0),
        None => format!("node {hex} of layer {layer}"),
    }
}

/// How a node is named in messages.
pub(in crate::store) fn name_of(head: &NodeHead) -> String {
    node_name(head.layer.into(), &head.cube.node_key().0)
}

/// Layer and cube of a row whose first two columns are they.
pub(super) fn layer_and_cube<K: Fn() -> String>(columns: &Columns<'_, K>) -> Result<(u16, Cube), RowError> {
    let cube = NodeKey::from_bytes(columns.blob(1)?)
        .and_then(|k| Cube::from_node_key(&k))
        .ok_or_else(|| columns.wrong("the key is none of an aligned cube"))?;
    Ok((columns.int(0)?, cube))
}

/// The name of the row, for messages, whatever state it is in.
pub(super) fn row_name(row: &Row<'_>) -> String {
    let layer = row.get_ref(0).ok().and_then(|v| v.as_i64().ok()).unwrap_or(-1);
    let key = row.get_ref(1).ok().and_then(|v| v.as_blob().ok()).unwrap_or_default();
    node_name(layer, key)
}

/// All node rows in order of layer and key, given to `each` one by one; a row that is damaged is given as an error.
pub(in crate::store) fn load_nodes(
    connection: &Connection,
    mut each: impl FnMut(Result<NodeHead, RowError>),
) -> Result<(), RowError> {
    let mut statement = connection.prepare_cached("SELECT layer, key, head, checksum FROM node ORDER BY layer, key")?;
    let mut rows = statement.query([])?;
    while let Some(row) = rows.next()? {
        each(decode(row));
    }
    Ok(())
}

/// The node rows below a node in pre-order, given to `each` one by one.
pub(in crate::store) fn load_nodes_below(
    connection: &Connection,
    layer: u16,
    cube: Cube,
    mut each: impl FnMut(NodeHead),
) -> Result<(), RowError> {
    let mut statement = connection.prepare_cached(
        "SELECT layer, key, head, checksum FROM node WHERE layer = ? AND key > ? AND key <= ? ORDER BY key",
    )?;
    let mut rows = statement.query((layer, &cube.node_key().0[..], &cube.last_node_key().0[..]))?;
    while let Some(row) = rows.next()? {
        each(decode(row)?);
    }
    Ok(())
}

/// One node row, if it is there.
pub(in crate::store) fn load_node(
    connection: &Connection,
    layer: u16,
    cube: Cube,
) -> Result<Option<NodeHead>, RowError> {
    let mut statement =
        connection.prepare_cached("SELECT layer, key, head, checksum FROM node WHERE layer = ? AND key = ?")?;
    let key = cube.node_key();
    let mut rows = statement.query((layer, &key.0[..]))?;
    rows.next()?.map(decode).transpose()
}

fn decode(row: &Row<'_>) -> Result<NodeHead, RowError> {
    let columns = checked(TABLE, row, 4, || row_name(row))?;
    let (layer, cube) = layer_and_cube(&columns)?;
    columns.take(2, |t| take_head(t, layer, cube))
}

pub(in crate::store) fn put_node(connection: &Connection, head: &NodeHead) -> Result<(), RowError> {
    let mut put = Put::default();
    put_head(&mut put, head);
    put_row(
        connection,
        TABLE,
        "INSERT OR REPLACE INTO node (layer, key, head, checksum) VALUES (?, ?, ?, ?)",
        &[Sql::Int(head.layer.into()), Sql::Blob(&head.cube.node_key().0), Sql::Blob(&put.0)],
    )
}

/// Removes a node's row; false if there is none.
pub(in crate::store) fn delete_node(connection: &Connection, layer: u16, cube: Cube) -> Result<bool, RowError> {
    let mut statement = connection.prepare_cached("DELETE FROM node WHERE layer = ? AND key = ?")?;
    Ok(statement.execute((layer, &cube.node_key().0[..]))? == 1)
}

fn put_head(put: &mut Put, head: &NodeHead) {
    let flag = |on: bool, bit: u8| if on { bit } else { 0 };
    put.u8(flag(head.leaf, LEAF)
        | flag(head.own_bounds.is_some(), OWN_BOUNDS)
        | flag(head.shape.color.is_some(), COLOR));
    put.u8(head.children);
    put.varint(head.own_points);
    put.varint(head.subtree_points);
    put.varint(head.subtree_nodes);
    put.varint(head.scans.len() as u64);
    for scan in &head.scans {
        put.varint(scan.scan.into());
        put.varint(scan.own);
        put.varint(scan.subtree);
    }
    put.lattice_box(&head.subtree_bounds);
    if let Some(bounds) = &head.own_bounds {
        put.lattice_box(bounds);
    }
    let shape = &head.shape;
    put.f64(shape.spacing);
    shape.mean.iter().chain(&shape.moments).for_each(|&v| put.f64(v));
    put.f64(shape.radius);
    shape.color.iter().flatten().for_each(|&v| put.u16(v));
    put.u64(head.chunk_base as u64);
    put.varint(head.parts.len() as u64);
    for part in &head.parts {
        put.varint(part.points.into());
        put.u8(part.block_size.exponent());
        put_step(put, Some(part.first_step));
        put_step(put, part.last_step);
        put.varint(part.chunks.len() as u64);
        for &(slot, bytes) in &part.chunks {
            put.varint(slot.into());
            put.varint(bytes.into());
        }
        put.varint(part.packed.len() as u64);
        for &(slot, bytes) in &part.packed {
            put.varint(slot.into());
            put.varint(bytes.into());
        }
        put.varint(part.packed_bytes.into());
    }
}

/// Group 0 stands for no step.
fn put_step(put: &mut Put, step: Option<Step>) {
    let step = step.unwrap_or(Step { win: 0, group: 0 });
    put.u8(step.group);
    put.u8(step.win as u8);
}

fn take_step(take: &mut Take<'_>) -> Taken<Option<Step>> {
    let (group, win) = (take.u8()?, take.u8()? as i8);
    match (group, win) {
        (0, 0) => Ok(None),
        (1..=3, -1..=48) => Ok(Some(Step { win, group })),
        _ => Err(format!("no step: win {win}, group {group}")),
    }
}

fn take_head(take: &mut Take<'_>, layer: u16, cube: Cube) -> Taken<NodeHead> {
    let flags = take.u8()?;
    if flags & !(LEAF | OWN_BOUNDS | COLOR) != 0 {
        return Err(format!("unknown flags {flags:#x}"));
    }
    let children = take.u8()?;
    let own_points = take.varint()?;
    let subtree_points = take.varint()?;
    let subtree_nodes = take.varint()?;
    let n = take.count(3)?;
    let mut scans = Vec::with_capacity(n);
    for _ in 0..n {
        scans.push(ScanCount { scan: take.small()?, own: take.varint()?, subtree: take.varint()? });
    }
    let subtree_bounds = take.lattice_box()?;
    let own_bounds = if flags & OWN_BOUNDS != 0 { Some(take.lattice_box()?) } else { None };
    let mut shape = Shape { spacing: take.f64()?, ..Shape::default() };
    for v in shape.mean.iter_mut().chain(&mut shape.moments) {
        *v = take.f64()?;
    }
    shape.radius = take.f64()?;
    if flags & COLOR != 0 {
        shape.color = Some([take.u16()?, take.u16()?, take.u16()?]);
    }
    let chunk_base = take.u64()? as i64;
    let n = take.count(8)?;
    let mut parts = Vec::with_capacity(n);
    for _ in 0..n {
        parts.push(take_part(take)?);
    }
    Ok(NodeHead {
        layer,
        cube,
        leaf: flags & LEAF != 0,
        children,
        own_points,
        subtree_points,
        subtree_nodes,
        scans,
        own_bounds,
        subtree_bounds,
        shape,
        chunk_base,
        parts,
    })
}

fn take_part(take: &mut Take<'_>) -> Taken<PartHead> {
    let points = take.small()?;
    let exponent = take.u8()?;
    let block_size = BlockSize::of_exponent(exponent).ok_or_else(|| format!("no blocks have 2^{exponent} points"))?;
    let first_step = take_step(take)?.ok_or("a part has no first step")?;
    let last_step = take_step(take)?;
    let n = take.count(2)?;
    let mut chunks: Vec<(Slot, u32)> = Vec::with_capacity(n);
    for _ in 0..n {
        chunks.push((take.small()?, take.small()?));
    }
    let n = take.count(2)?;
    let mut packed: Vec<(Slot, u32)> = Vec::with_capacity(n);
    for _ in 0..n {
        packed.push((take.small()?, take.small()?));
    }
    if !chunks.is_sorted_by(|a, b| a.0 < b.0) || !packed.is_sorted_by(|a, b| a.0 < b.0) {
        return Err("a part's columns are not ascending".into());
    }
    Ok(PartHead { points, block_size, first_step, last_step, chunks, packed, packed_bytes: take.small()? })
}

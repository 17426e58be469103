//! Rows as SQLite holds them, to checked types and back. One file per table.
//!
//! Every row passes through [`checked`]: its checksum is compared before anything in it is believed.

mod attribute;
mod bookmark;
mod bytes;
mod chunk;
mod node;
mod pieces;
mod scan;
mod site;
mod zone;

pub(super) use attribute::{delete_attribute, load_attributes, put_attribute};
pub(super) use bookmark::{load_bookmarks, put_bookmark, remove_bookmark};
pub(super) use bytes::{Put, Take, Taken};
pub use chunk::{ChunkRow, pack};
pub(super) use chunk::{ReadChunk, RowName, load_garbage, put_chunk, read_blocks, read_chunk, unpack};
pub(super) use node::{delete_node, load_node, load_nodes, load_nodes_below, name_of, put_node};
pub(super) use scan::{delete_scan, load_scans, put_scan};
pub(super) use site::{SiteRow, load_generation, load_site, put_site};
pub(super) use zone::{delete_zones, load_zones, put_zones};

use super::checksum::Checksum;
use super::error::RowError;
use rusqlite::types::{ToSqlOutput, Value, ValueRef};
use rusqlite::{Connection, Row, params_from_iter};

/// A value on its way into a statement.
pub(super) enum Sql<'a> {
    Null,
    Int(i64),
    Real(f64),
    Text(&'a str),
    Blob(&'a [u8]),
}

impl Sql<'_> {
    fn value(&self) -> ValueRef<'_> {
        match *self {
            Self::Null => ValueRef::Null,
            Self::Int(v) => ValueRef::Integer(v),
            Self::Real(v) => ValueRef::Real(v),
            Self::Text(v) => ValueRef::Text(v.as_bytes()),
            Self::Blob(v) => ValueRef::Blob(v),
        }
    }

    /// Null where there is nothing.
    pub fn text(v: &Option<String>) -> Sql<'_> {
        v.as_deref().map_or(Sql::Null, Sql::Text)
    }

    /// Null where there is nothing.
    pub fn blob(v: &Option<Vec<u8>>) -> Sql<'_> {
        v.as_deref().map_or(Sql::Null, Sql::Blob)
    }
}

impl rusqlite::ToSql for Sql<'_> {
    fn to_sql(&self) -> rusqlite::Result<ToSqlOutput<'_>> {
        Ok(ToSqlOutput::Borrowed(self.value()))
    }
}

/// Runs `sql` with the values and, as the last parameter, their checksum.
pub(super) fn put_row(connection: &Connection, table: &str, sql: &str, values: &[Sql<'_>]) -> Result<(), RowError> {
    let checksum = Checksum::of_row(table, values.iter().map(Sql::value));
    let all = values.iter().map(|v| ToSqlOutput::Borrowed(v.value()));
    let all = all.chain([ToSqlOutput::Owned(Value::Integer(checksum.to_sql()))]);
    connection.prepare_cached(sql)?.execute(params_from_iter(all))?;
    Ok(())
}

/// The columns of a row whose checksum is right; the checksum is the last of `columns` columns. `key` names the row in
/// messages, and is asked only for those.
pub(super) fn checked<'r>(
    table: &'static str,
    row: &'r Row<'_>,
    columns: usize,
    key: impl Fn() -> String + 'r,
) -> Result<Columns<'r, impl Fn() -> String + 'r>, RowError> {
    let mut values = [ValueRef::Null; 24];
    for (i, value) in values.iter_mut().enumerate().take(columns) {
        *value = row.get_ref(i)?;
    }
    let expected = Checksum::of_row(table, values[..columns - 1].iter().copied());
    let found = match values[columns - 1] {
        ValueRef::Integer(v) => Checksum::from_sql(v),
        _ => return Err(RowError::damage(table, key(), "the checksum is not a number")),
    };
    if found != expected {
        let what = format!("checksum is {found}, but the row's content gives {expected}");
        return Err(RowError::damage(table, key(), what));
    }
    Ok(Columns { table, key, values })
}

/// The values of a checked row.
pub(super) struct Columns<'r, K> {
    table: &'static str,
    key: K,
    values: [ValueRef<'r>; 24],
}

impl<'r, K: Fn() -> String> Columns<'r, K> {
    /// The row is not as it should be, although its checksum is right.
    pub fn wrong(&self, what: impl Into<String>) -> RowError {
        RowError::damage(self.table, (self.key)(), what)
    }

    fn kind(&self, i: usize) -> RowError {
        self.wrong(format!("column {i} has the type {}", self.values[i].data_type()))
    }

    /// Is column `i` null?
    pub fn is_null(&self, i: usize) -> bool {
        matches!(self.values[i], ValueRef::Null)
    }

    /// An integer that fits `T`.
    pub fn int<T: TryFrom<i64>>(&self, i: usize) -> Result<T, RowError> {
        match self.values[i] {
            ValueRef::Integer(v) => T::try_from(v).map_err(|_| self.wrong(format!("column {i} is out of range: {v}"))),
            _ => Err(self.kind(i)),
        }
    }

    /// A float.
    pub fn real(&self, i: usize) -> Result<f64, RowError> {
        match self.values[i] {
            ValueRef::Real(v) => Ok(v),
            _ => Err(self.kind(i)),
        }
    }

    /// Text.
    pub fn text(&self, i: usize) -> Result<&'r str, RowError> {
        match self.values[i] {
            ValueRef::Text(v) => std::str::from_utf8(v).map_err(|_| self.wrong(format!("column {i} is not UTF-8"))),
            _ => Err(self.kind(i)),
        }
    }

    /// Bytes.
    pub fn blob(&self, i: usize) -> Result<&'r [u8], RowError> {
        match self.values[i] {
            ValueRef::Blob(v) => Ok(v),
            _ => Err(self.kind(i)),
        }
    }

    /// Bytes read by `read`, all of them.
    pub fn take<T>(&self, i: usize, read: impl FnOnce(&mut Take<'r>) -> Taken<T>) -> Result<T, RowError> {
        let mut take = Take(self.blob(i)?);
        read(&mut take).and_then(|v| take.end().map(|()| v)).map_err(|what| self.wrong(format!("column {i}: {what}")))
    }

    /// JSON, or nothing where the column is null.
    pub fn json<T: serde::de::DeserializeOwned>(&self, i: usize) -> Result<Option<T>, RowError> {
        if self.is_null(i) {
            return Ok(None);
        }
        serde_json::from_str(self.text(i)?)
            .map(Some)
            .map_err(|e| self.wrong(format!("column {i} is not the JSON that it should be: {e}")))
    }
}

/// JSON for a column.
pub(super) fn to_json<T: serde::Serialize>(value: &Option<T>) -> Result<Option<String>, RowError> {
    value
        .as_ref()
        .map(serde_json::to_string)
        .transpose()
        .map_err(|e| RowError::Inconsistent(format!("cannot be written as JSON: {e}")))
}

/// A count as SQLite holds it.
pub(super) fn to_i64(value: u64, what: &str) -> Result<i64, RowError> {
    i64::try_from(value).map_err(|_| RowError::Inconsistent(format!("{what} is too large: {value}")))
}

//! Rows of `attribute`.

use super::super::error::RowError;
use super::super::model::{FIRST_ATTRIBUTE, Slot, StoredAttribute};
use super::{Put, Sql, checked, put_row};
use crate::points::{Attribute, ScalarType, Scaling};
use rusqlite::Connection;

const TABLE: &str = "attribute";

/// All of them, ascending by id.
pub(in crate::store) fn load_attributes(connection: &Connection) -> Result<Vec<StoredAttribute>, RowError> {
    let mut statement = connection
        .prepare_cached("SELECT id, name, type, scaling, no_data, description, checksum FROM attribute ORDER BY id")?;
    let mut rows = statement.query([])?;
    let mut attributes = Vec::new();
    while let Some(row) = rows.next()? {
        let id = row.get_ref(0)?.as_i64().unwrap_or(-1);
        let columns = checked(TABLE, row, 7, || format!("attribute {id}"))?;
        let ty = columns.text(2)?;
        let ty = ScalarType::from_word(ty).ok_or_else(|| columns.wrong(format!("unknown type {ty}")))?;
        let scaling = if columns.is_null(3) {
            None
        } else {
            Some(columns.take(3, |t| Ok(Scaling { scale: t.f64()?, offset: t.f64()? }))?)
        };
        let no_data = if columns.is_null(4) { None } else { Some(columns.take(4, |t| t.u64())?.to_le_bytes()) };
        let id = columns.int(0)?;
        if id < FIRST_ATTRIBUTE {
            return Err(columns.wrong("the id is reserved"));
        }
        let attribute = Attribute {
            name: columns.text(1)?.to_owned(),
            ty,
            scaling,
            no_data,
            description: columns.text(5)?.to_owned(),
        };
        attributes.push(StoredAttribute { id, attribute });
    }
    Ok(attributes)
}

pub(in crate::store) fn delete_attribute(connection: &Connection, id: Slot) -> Result<(), RowError> {
    connection.prepare_cached("DELETE FROM attribute WHERE id = ?")?.execute([id])?;
    Ok(())
}

pub(in crate::store) fn put_attribute(connection: &Connection, stored: &StoredAttribute) -> Result<(), RowError> {
    let attribute = &stored.attribute;
    let scaling = attribute.scaling.map(|s| {
        let mut put = Put::default();
        put.f64(s.scale);
        put.f64(s.offset);
        put.0
    });
    put_row(
        connection,
        TABLE,
        "INSERT INTO attribute (id, name, type, scaling, no_data, description, checksum) VALUES (?, ?, ?, ?, ?, ?, ?)",
        &[
            Sql::Int(stored.id.into()),
            Sql::Text(&attribute.name),
            Sql::Text(attribute.ty.word()),
            Sql::blob(&scaling),
            attribute.no_data.as_ref().map_or(Sql::Null, |b| Sql::Blob(b)),
            Sql::Text(&attribute.description),
        ],
    )
}

//! Rows of `bookmark`.

use super::super::error::RowError;
use super::{Sql, checked, put_row};
use rusqlite::Connection;

const TABLE: &str = "bookmark";

/// All names with their cameras as JSON, by name.
pub(in crate::store) fn load_bookmarks(connection: &Connection) -> Result<Vec<(String, String)>, RowError> {
    let mut statement = connection.prepare_cached("SELECT name, camera, checksum FROM bookmark ORDER BY name")?;
    let mut rows = statement.query([])?;
    let mut bookmarks = Vec::new();
    while let Some(row) = rows.next()? {
        let name = || row.get_ref(0).ok().and_then(|v| v.as_str().ok()).unwrap_or("?").to_owned();
        let columns = checked(TABLE, row, 3, name)?;
        bookmarks.push((columns.text(0)?.to_owned(), columns.text(1)?.to_owned()));
    }
    Ok(bookmarks)
}

pub(in crate::store) fn put_bookmark(connection: &Connection, name: &str, camera: &str) -> Result<(), RowError> {
    put_row(
        connection,
        TABLE,
        "INSERT OR REPLACE INTO bookmark (name, camera, checksum) VALUES (?, ?, ?)",
        &[Sql::Text(name), Sql::Text(camera)],
    )
}

pub(in crate::store) fn remove_bookmark(connection: &Connection, name: &str) -> Result<(), RowError> {
    connection.execute("DELETE FROM bookmark WHERE name = ?", [name])?;
    Ok(())
}

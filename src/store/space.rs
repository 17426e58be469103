//! Space that is used no more: chunk rows that nothing refers to, and free pages.

use super::error::RowError;
use rusqlite::Connection;

/// Rows that are removed in one transaction.
const REMOVED_AT_ONCE: usize = 4096;

/// One free page for so many is kept in the file.
const MOST_FREE: i64 = 16;

/// Pages that one step of the incremental vacuum frees.
const VACUUM_PAGES: u32 = 4096;

/// Is there a chunk row from `first` on?
pub(super) fn has_unreferenced(connection: &Connection, first: i64) -> Result<bool, RowError> {
    Ok(connection.query_row("SELECT EXISTS (SELECT 1 FROM chunk WHERE id >= ?)", [first], |row| row.get(0))?)
}

/// Does `garbage` name rows?
pub(super) fn has_garbage(connection: &Connection) -> Result<bool, RowError> {
    Ok(connection.query_row("SELECT EXISTS (SELECT 1 FROM garbage)", [], |row| row.get(0))?)
}

/// Removes chunk rows from `first` on.
pub(super) fn remove_unreferenced(connection: &Connection, first: i64) -> Result<u64, RowError> {
    let mut removed = 0;
    loop {
        let rows = remove_some(connection, first, i64::MAX)?;
        removed += rows as u64;
        if rows < REMOVED_AT_ONCE {
            return Ok(removed);
        }
    }
}

fn remove_some(connection: &Connection, first: i64, last: i64) -> Result<usize, RowError> {
    let mut statement = connection.prepare_cached(
        "DELETE FROM chunk WHERE id IN (SELECT id FROM chunk WHERE id BETWEEN ? AND ? ORDER BY id LIMIT ?)",
    )?;
    Ok(statement.execute((first, last, REMOVED_AT_ONCE as i64))?)
}

/// One transaction's worth; `None` when there is no garbage left.
pub(super) fn remove_some_garbage(connection: &Connection) -> Result<Option<u64>, RowError> {
    let transaction = connection.unchecked_transaction()?;
    let mut removed = 0;
    let mut any = false;
    while removed < REMOVED_AT_ONCE {
        let mut ranges = transaction.prepare_cached("SELECT first, last FROM garbage ORDER BY first LIMIT 1")?;
        let mut ranges = ranges.query([])?;
        let Some(range) = ranges.next()? else { break };
        let (first, last): (i64, i64) = (range.get(0)?, range.get(1)?);
        drop(ranges);
        any = true;
        let rows = remove_some(&transaction, first, last)?;
        removed += rows;
        if rows < REMOVED_AT_ONCE {
            transaction.prepare_cached("DELETE FROM garbage WHERE first = ?")?.execute([first])?;
        }
    }
    transaction.commit()?;
    Ok(any.then_some(removed as u64))
}

/// Are many pages free? A few are soon used again, and to give them back pages from the end of the file would be moved into
/// their places.
pub(super) fn has_room(connection: &Connection) -> Result<bool, RowError> {
    let pages: i64 = connection.query_row("PRAGMA page_count", [], |row| row.get(0))?;
    let free: i64 = connection.query_row("PRAGMA freelist_count", [], |row| row.get(0))?;
    Ok(free > pages / MOST_FREE)
}

/// Gives free pages back, some at a time.
pub(super) fn vacuum(connection: &Connection) -> Result<(), RowError> {
    loop {
        let free: i64 = connection.query_row("PRAGMA freelist_count", [], |row| row.get(0))?;
        if free == 0 {
            return Ok(());
        }
        let mut statement = connection.prepare(&format!("PRAGMA incremental_vacuum({VACUUM_PAGES})"))?;
        let mut steps = statement.query([])?;
        while steps.next()?.is_some() {}
        let left: i64 = connection.query_row("PRAGMA freelist_count", [], |row| row.get(0))?;
        if left >= free {
            return Ok(());
        }
    }
}

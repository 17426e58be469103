//! What concerns tables as a whole: SQLite's own check, rows that nothing refers to.

use super::super::error::RowError;
use super::super::index::NodeIndex;
use super::super::model::SLOT_PACKED;
use super::super::rows::{self, SiteRow};
use super::Finding;
use rusqlite::Connection;

/// SQLite's own check of the whole file.
pub(super) fn integrity(connection: &Connection) -> Result<Vec<Finding>, RowError> {
    let mut statement = connection.prepare("PRAGMA integrity_check")?;
    let messages = statement.query_map([], |row| row.get::<_, String>(0))?;
    let mut findings = Vec::new();
    for message in messages {
        // Several lines in one row.
        let what = message?.lines().collect::<Vec<_>>().join("; ");
        if what != "ok" {
            findings.push(Finding { table: "SQLite".into(), key: "structure of the file".into(), what });
        }
    }
    Ok(findings)
}

/// Every row of `zone` and `chunk` belongs to a node. Chunk rows may also wait to be removed, or be written just now.
pub(super) fn check(
    connection: &Connection,
    site: &SiteRow,
    index: &NodeIndex,
    all_nodes: bool,
) -> Result<Vec<Finding>, RowError> {
    let mut findings = Vec::new();
    let zones: i64 = connection.query_row("SELECT count(*) FROM zone", [], |row| row.get(0))?;
    if zones.unsigned_abs() != site.nodes {
        let what = format!("there are {zones}, but {} were written", site.nodes);
        findings.push(Finding { table: "zone".into(), key: "all rows".into(), what });
    }
    if !all_nodes {
        // Which rows a damaged node refers to is not known.
        return Ok(findings);
    }
    let mut expected: Vec<i64> = Vec::new();
    for head in index.heads() {
        for (i, part) in head.parts.iter().enumerate() {
            expected.extend(part.chunks.iter().map(|c| head.chunk_id(i, c.0)));
            expected.extend((!part.packed.is_empty()).then(|| head.chunk_id(i, SLOT_PACKED)));
        }
    }
    expected.sort_unstable();
    for pair in expected.windows(2).filter(|w| w[0] == w[1]) {
        let what = "two nodes refer to it".into();
        findings.push(Finding { table: "chunk".into(), key: format!("row {}", pair[0]), what });
    }
    let garbage = rows::load_garbage(connection)?;
    let is_garbage = |id: i64| {
        let after = garbage.partition_point(|g| g.0 <= id);
        after > 0 && id <= garbage[after - 1].1
    };
    let mut statement = connection.prepare("SELECT id FROM chunk WHERE id < ? ORDER BY id")?;
    let mut rows = statement.query([site.next_chunk])?;
    while let Some(row) = rows.next()? {
        let id: i64 = row.get(0)?;
        if expected.binary_search(&id).is_err() && !is_garbage(id) {
            let what = "no node refers to it".into();
            findings.push(Finding { table: "chunk".into(), key: format!("row {id}"), what });
        }
    }
    Ok(findings)
}

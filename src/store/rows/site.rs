//! The one row of `site`.

use super::super::error::RowError;
use super::super::log::LogMark;
use super::super::model::Site;
use super::{Columns, Put, Sql, Take, Taken, checked, put_row, to_i64, to_json};
use crate::lattice::{BITS, Cube, Decimal, Lattice, NodeKey};
use rusqlite::{Connection, OptionalExtension};

/// What the row holds: [`Site`], and what only the writer needs.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::store) struct SiteRow {
    pub site: Site,
    /// Random, from creation: tells this store from another one under the same name.
    pub store_id: [u8; 16],
    /// No chunk row that was ever referred to has this id or a greater one.
    pub next_chunk: i64,
    pub next_scan: u32,
    /// Rows of `node`, and of `zone`.
    pub nodes: u64,
    pub scans: u64,
    pub attributes: u64,
    pub log: LogMark,
}

const TABLE: &str = "site";

pub(in crate::store) fn load_generation(connection: &Connection) -> Result<u64, RowError> {
    let generation: Option<i64> = connection
        .prepare_cached("SELECT generation FROM site WHERE id = 1")?
        .query_row([], |row| row.get(0))
        .optional()?;
    generation
        .and_then(|g| u64::try_from(g).ok())
        .ok_or_else(|| RowError::damage(TABLE, "the one row", "there is no generation"))
}

pub(in crate::store) fn load_site(connection: &Connection) -> Result<SiteRow, RowError> {
    let mut statement = connection.prepare_cached(
        "SELECT id, store_id, quantum, phase, g, leaf_capacity, roots, crs, generation, next_chunk, next_scan, nodes, \
         scans, attributes, log, log_before, checksum FROM site",
    )?;
    let mut rows = statement.query([])?;
    let row = rows.next()?.ok_or_else(|| RowError::damage(TABLE, "the one row", "is missing"))?;
    let columns = checked(TABLE, row, 17, || "the one row".into())?;
    let lattice =
        Lattice::new(decimals(&columns, 2)?, decimals(&columns, 3)?).map_err(|e| columns.wrong(e.to_string()))?;
    let g: u8 = columns.int(4)?;
    if g > BITS {
        return Err(columns.wrong(format!("g is {g}")));
    }
    let row = SiteRow {
        site: Site {
            lattice,
            g,
            leaf_capacity: columns.int(5)?,
            roots: columns.take(6, take_roots)?,
            crs: columns.json(7)?,
            generation: columns.int(8)?,
        },
        store_id: columns.blob(1)?.try_into().map_err(|_| columns.wrong("the store's id is not 16 bytes"))?,
        next_chunk: columns.int(9)?,
        next_scan: columns.int(10)?,
        nodes: columns.int(11)?,
        scans: columns.int(12)?,
        attributes: columns.int(13)?,
        log: LogMark { this: columns.int(14)?, before: columns.int(15)? },
    };
    drop(columns);
    match rows.next()? {
        None => Ok(row),
        Some(_) => Err(RowError::damage(TABLE, "the one row", "there are two")),
    }
}

pub(in crate::store) fn put_site(connection: &Connection, row: &SiteRow) -> Result<(), RowError> {
    let site = &row.site;
    let mut roots = Put::default();
    put_roots(&mut roots, &site.roots);
    put_row(
        connection,
        TABLE,
        "INSERT OR REPLACE INTO site (id, store_id, quantum, phase, g, leaf_capacity, roots, crs, generation, \
         next_chunk, next_scan, nodes, scans, attributes, log, log_before, checksum) \
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
        &[
            Sql::Int(1),
            Sql::Blob(&row.store_id),
            Sql::Text(&decimal_words(site.lattice.quantum())),
            Sql::Text(&decimal_words(site.lattice.phase())),
            Sql::Int(site.g.into()),
            Sql::Int(site.leaf_capacity.into()),
            Sql::Blob(&roots.0),
            Sql::text(&to_json(&site.crs)?),
            Sql::Int(to_i64(site.generation, "the generation")?),
            Sql::Int(row.next_chunk),
            Sql::Int(row.next_scan.into()),
            Sql::Int(to_i64(row.nodes, "the number of nodes")?),
            Sql::Int(to_i64(row.scans, "the number of scans")?),
            Sql::Int(to_i64(row.attributes, "the number of attributes")?),
            Sql::Int(row.log.this),
            Sql::Int(row.log.before),
        ],
    )
}

/// Per layer one byte, 0 or 1, and 19 bytes of node key after a 1.
fn put_roots(put: &mut Put, roots: &[Option<Cube>]) {
    for root in roots {
        put.u8(root.is_some().into());
        if let Some(root) = root {
            put.0.extend_from_slice(&root.node_key().0);
        }
    }
}

fn take_roots(take: &mut Take<'_>) -> Taken<Vec<Option<Cube>>> {
    let mut roots = Vec::new();
    while !take.0.is_empty() {
        roots.push(match take.u8()? {
            0 => None,
            1 => {
                let key = NodeKey::from_bytes(take.bytes(19)?).ok_or("no node key")?;
                Some(Cube::from_node_key(&key).ok_or("a root is no aligned cube")?)
            }
            _ => return Err("a root is neither there nor missing".into()),
        });
    }
    Ok(roots)
}

/// Three exact decimals, `mantissa` `e` `exponent`, separated by spaces.
fn decimal_words(decimals: [Decimal; 3]) -> String {
    decimals.map(|d| format!("{}e{}", d.mantissa(), d.exponent())).join(" ")
}

fn decimals<K: Fn() -> String>(columns: &Columns<'_, K>, i: usize) -> Result<[Decimal; 3], RowError> {
    let text = columns.text(i)?;
    let parse = |word: &str| {
        let (mantissa, exponent) = word.split_once('e')?;
        let (mantissa, exponent) = (mantissa.parse::<i128>().ok()?, exponent.parse::<i32>().ok()?);
        // Far beyond any quantum, and far from where exponents overflow.
        (exponent.unsigned_abs() < 1000).then(|| Decimal::new(mantissa, exponent))
    };
    let words: Option<Vec<_>> = text.split(' ').map(parse).collect();
    words
        .and_then(|w| <[Decimal; 3]>::try_from(w).ok())
        .ok_or_else(|| columns.wrong(format!("column {i} is not three decimals: {text}")))
}

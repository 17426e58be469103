//! The last transaction of a change: node rows, scans, attributes, the site; checked as a whole before it counts.

use super::error::RowError;
use super::flip_check::{self, Changed};
use super::index::NodeIndex;
use super::model::{NodeHead, Scan, ScanId, Slot, StoredAttribute, Zones};
use super::rows::{self, SiteRow};
use super::snapshot::facts;
use crate::lattice::Cube;
use crate::points::Crs;
use rusqlite::Connection;
use std::collections::{BTreeMap, BTreeSet};

/// What a commit changes.
#[derive(Clone, Debug, Default)]
pub struct Flip {
    /// New scans, with ids from [`super::Writer::reserve_scan`].
    pub scans_added: Vec<Scan>,
    /// Scans that are gone.
    pub scans_removed: Vec<ScanId>,
    /// New rows for scans that stay (shown or hidden, say).
    pub scans_changed: Vec<Scan>,
    /// The root of each layer; `None` leaves them as they are.
    pub roots: Option<Vec<Option<Cube>>>,
    /// The nodes.
    pub nodes: NodeChange,
    /// The site's CRS; `None` leaves it as it is.
    pub crs: Option<Crs>,
}

/// Which node rows change. A node whose `chunk_base` stays keeps its chunk rows; those of all others that were there
/// before are removed.
#[derive(Clone, Debug, Default)]
pub enum NodeChange {
    /// None.
    #[default]
    Keep,
    /// These are all nodes, in any order.
    ReplaceAll(Vec<(NodeHead, Zones)>),
    /// Some.
    Delta {
        /// New, or in place of the row with the same layer and cube.
        put: Vec<(NodeHead, Zones)>,
        /// Gone.
        delete: Vec<(u16, Cube)>,
    },
}

/// Writes the change inside a transaction that the caller has begun and will end. `base` is the site's row before it,
/// with the ids given out since; those of `attributes` are written that are not there yet, and those removed that no scan
/// has any more. Returns the site's row and the attributes after it.
pub(super) fn flip(
    connection: &Connection,
    base: &SiteRow,
    attributes: &[StoredAttribute],
    change: Flip,
) -> Result<(SiteRow, Vec<StoredAttribute>), RowError> {
    let mut site = base.clone();
    site.site.generation += 1;
    if let Some(roots) = change.roots {
        site.site.roots = roots;
    }
    if change.crs.is_some() {
        site.site.crs = change.crs;
    }
    for attribute in attributes.iter().skip(usize::try_from(base.attributes).unwrap_or(usize::MAX)) {
        rows::put_attribute(connection, attribute)?;
    }
    let removed = change.scans_removed.iter().chain(change.scans_changed.iter().map(|s| &s.id));
    for &id in removed {
        if !rows::delete_scan(connection, id)? {
            return Err(RowError::Inconsistent(format!("there is no scan {id}")));
        }
    }
    for scan in change.scans_changed.iter().chain(&change.scans_added) {
        if scan.id >= base.next_scan {
            return Err(RowError::Inconsistent(format!("the number of scan {} was not reserved", scan.id)));
        }
        rows::put_scan(connection, scan)?;
    }
    let scans = rows::load_scans(connection)?;
    site.scans = scans.len() as u64;
    let used: BTreeSet<Slot> = scans.iter().flat_map(|s| s.attributes.iter().copied()).collect();
    let (kept, unused): (Vec<_>, Vec<_>) = attributes.iter().cloned().partition(|a| used.contains(&a.id));
    for attribute in unused {
        rows::delete_attribute(connection, attribute.id)?;
    }
    site.attributes = kept.len() as u64;
    let Put { old, new, nodes, changed } = put_nodes(connection, base, change.nodes)?;
    site.nodes = nodes;
    put_garbage(connection, old, &new)?;
    rows::put_site(connection, &site)?;
    check(connection, changed.as_ref())?;
    Ok((site, kept))
}

/// The chunk rows of nodes: first id to the id after the last.
type Ranges = BTreeMap<i64, i64>;

fn note(ranges: &mut Ranges, head: &NodeHead) {
    let ids = head.chunk_ids();
    if !ids.is_empty() {
        ranges.insert(ids.start, ids.end);
    }
}

/// Node rows that were written.
struct Put {
    /// The chunk rows of nodes that were there before, and the first of each node that was put.
    old: Ranges,
    new: BTreeSet<i64>,
    /// How many nodes there are now.
    nodes: u64,
    /// `None`: all are new.
    changed: Option<Changed>,
}

fn put_nodes(connection: &Connection, base: &SiteRow, change: NodeChange) -> Result<Put, RowError> {
    let mut old = Ranges::new();
    let mut nodes = base.nodes;
    let mut changed = Changed::default();
    let mut is_delta = true;
    let mut put = match change {
        NodeChange::Keep => Vec::new(),
        NodeChange::ReplaceAll(all) => {
            let mut wrong = None;
            rows::load_nodes(connection, |head| match head {
                Ok(head) => note(&mut old, &head),
                Err(e) => wrong = Some(e),
            })?;
            wrong.map_or(Ok(()), Err)?;
            connection.execute_batch("DELETE FROM node; DELETE FROM zone")?;
            (nodes, is_delta) = (0, false);
            all
        }
        NodeChange::Delta { put, delete } => {
            for (layer, cube) in delete {
                let head = rows::load_node(connection, layer, cube)?;
                let head = head.ok_or_else(|| RowError::Inconsistent("a node to delete is not there".into()))?;
                note(&mut old, &head);
                rows::delete_node(connection, layer, cube)?;
                rows::delete_zones(connection, layer, cube)?;
                nodes = nodes.saturating_sub(1);
                changed.note(layer, cube);
            }
            put
        }
    };
    // In the table's order, so that its pages fill up.
    put.sort_by_key(|(head, _)| (head.layer, head.cube.node_key()));
    let mut new = BTreeSet::new();
    for (head, zones) in &put {
        let before = if is_delta { rows::load_node(connection, head.layer, head.cube)? } else { None };
        match before {
            Some(before) => note(&mut old, &before),
            None => nodes += 1,
        }
        let ids = head.chunk_ids();
        if !ids.is_empty() && !new.insert(ids.start) {
            return Err(RowError::Inconsistent("two nodes have the same chunk rows".into()));
        }
        rows::put_node(connection, head)?;
        rows::put_zones(connection, head.layer, head.cube, zones)?;
        changed.note(head.layer, head.cube);
    }
    Ok(Put { old, new, nodes, changed: is_delta.then_some(changed) })
}

/// Neighbouring ranges become one.
fn put_garbage(connection: &Connection, old: Ranges, new: &BTreeSet<i64>) -> Result<(), RowError> {
    let mut joined: Vec<(i64, i64)> = Vec::new();
    for (first, end) in old {
        if new.contains(&first) {
            continue;
        }
        match joined.last_mut() {
            Some(last) if last.1 == first => last.1 = end,
            _ => joined.push((first, end)),
        }
    }
    let mut statement = connection.prepare_cached("INSERT OR REPLACE INTO garbage (first, last) VALUES (?, ?)")?;
    for (first, end) in joined {
        statement.execute((first, end - 1))?;
    }
    Ok(())
}

/// Reads it back: a mistake of the caller must not become a damaged store. What lies far from the nodes that changed was
/// whole before and is not looked at.
fn check(connection: &Connection, changed: Option<&Changed>) -> Result<(), RowError> {
    let mistake = |e: RowError| match e {
        RowError::Damage { table, key, what } => RowError::Inconsistent(format!("table {table}, {key}: {what}")),
        e => e,
    };
    let (site, scans, _) = facts(connection).map_err(mistake)?;
    let wrong = match changed {
        Some(changed) => {
            let roots = flip_check::check(connection, &site, changed).map_err(mistake)?;
            conservation(&roots, &scans)
        }
        None => {
            let (index, damage) = NodeIndex::load(connection, &site);
            damage.into_iter().next().map_or(Ok(()), |e| Err(mistake(e)))?;
            conservation(index.roots().map(|root| index.head(root)), &scans)
        }
    };
    match wrong.into_iter().next() {
        Some((scan, what)) => Err(RowError::Inconsistent(format!("scan {scan}: {what}"))),
        None => Ok(()),
    }
}

/// Law 1, scan by scan, for the roots of all layers: what does not hold.
pub(super) fn conservation<'h>(roots: impl IntoIterator<Item = &'h NodeHead>, scans: &[Scan]) -> Vec<(ScanId, String)> {
    let mut found: BTreeMap<ScanId, u64> = BTreeMap::new();
    for root in roots {
        for scan in &root.scans {
            let points = found.entry(scan.scan).or_default();
            // As many as a damaged row says; no scan has so many.
            *points = points.saturating_add(scan.subtree);
        }
    }
    let mut wrong = Vec::new();
    for scan in scans {
        let (id, tree) = (scan.id, found.remove(&scan.id).unwrap_or(0));
        if scan.stored.checked_add(scan.rejected.total()) != Some(scan.read) {
            let (read, stored, rejected) = (scan.read, scan.stored, scan.rejected.total());
            wrong.push((id, format!("{read} points read are not {stored} stored and {rejected} rejected")));
        }
        if tree != scan.stored {
            wrong.push((id, format!("{} points stored, but the tree has {tree}", scan.stored)));
        }
        if scan.bounds.is_some() != (scan.stored > 0) {
            wrong.push((id, "bounds without points, or the reverse".into()));
        }
    }
    wrong.extend(found.into_iter().map(|(id, n)| (id, format!("the tree has {n} points of it, but it is not there"))));
    wrong
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::LatticePoint;
    use crate::store::model::{Rejected, ScanCount};

    /// The sum was unchecked: it wrapped, or ended the process, before the damage was told.
    #[test]
    fn numbers_of_a_damaged_row_that_have_no_sum_are_told_as_damage() {
        let mut root = NodeHead::without_points(0, Cube::containing(LatticePoint([0; 3]), 4));
        root.scans = vec![ScanCount { scan: 7, own: 0, subtree: u64::MAX - 1 }];
        let wrong = conservation([&root, &root], &[]);
        assert_eq!(wrong, [(7, format!("the tree has {} points of it, but it is not there", u64::MAX))]);
        let rejected = Rejected { not_finite: u64::MAX, out_of_range: 2, truncated: 3 };
        assert_eq!(rejected.total(), u64::MAX);
    }
}

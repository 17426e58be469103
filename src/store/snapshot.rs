//! What a reader holds: one generation of a store, for as long as it likes.

use super::error::{RowError, StoreError};
use super::index::{NodeIndex, NodeIx};
use super::lanes::Lanes;
use super::model::{NodeHead, SLOT_PACKED, Scan, ScanId, Site, Slot, StoredAttribute, Zones};
use super::place::{Place, lock};
use super::rows::{self, RowName, SiteRow};
use rusqlite::Connection;
use std::ops::{AddAssign, Deref, Range};
use std::sync::{Arc, OnceLock};

/// One generation of a store. Cheap to clone; may be used from several threads at once.
#[derive(Clone, Debug)]
pub struct Snapshot {
    inner: Arc<Inner>,
}

#[derive(Debug)]
pub(super) struct Inner {
    place: Arc<Place>,
    source: Source,
    site: SiteRow,
    scans: Vec<Scan>,
    attributes: Vec<StoredAttribute>,
    index: OnceLock<Arc<NodeIndex>>,
    /// One cell per node, once the index is there.
    zones: OnceLock<Vec<OnceLock<Arc<Zones>>>>,
}

/// Where the rows come from.
#[derive(Debug)]
enum Source {
    File(Arc<Lanes>),
    /// The shared connection; everything but chunk rows was read when the snapshot was made.
    Memory,
}

/// What reading chunks cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReadCost {
    /// Rows of `chunk` that were read.
    pub rows: u64,
    /// Bytes of encoded columns in them.
    pub bytes: u64,
}

impl AddAssign for ReadCost {
    fn add_assign(&mut self, other: Self) {
        self.rows += other.rows;
        self.bytes += other.bytes;
    }
}

/// One encoded column of one part: what `codec` decodes. Cheap to clone.
#[derive(Clone, Debug)]
pub struct ChunkBytes {
    row: Arc<Vec<u8>>,
    range: Range<usize>,
}

impl Deref for ChunkBytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.row[self.range.clone()]
    }
}

impl Snapshot {
    pub(super) fn of(inner: Arc<Inner>) -> Self {
        Self { inner }
    }

    /// The site.
    pub fn site(&self) -> &Site {
        &self.inner.site.site
    }

    /// The generation.
    pub fn generation(&self) -> u64 {
        self.site().generation
    }

    /// All scans, ascending by id.
    pub fn scans(&self) -> &[Scan] {
        &self.inner.scans
    }

    /// A scan by its number.
    pub fn scan(&self, id: ScanId) -> Option<&Scan> {
        self.scans().binary_search_by_key(&id, |s| s.id).ok().map(|i| &self.scans()[i])
    }

    /// All attributes, ascending by id.
    pub fn attributes(&self) -> &[StoredAttribute] {
        &self.inner.attributes
    }

    /// An attribute by its number.
    pub fn attribute(&self, id: Slot) -> Option<&StoredAttribute> {
        self.attributes().binary_search_by_key(&id, |a| a.id).ok().map(|i| &self.attributes()[i])
    }

    /// All nodes, read and checked at the first call.
    ///
    /// # Errors
    ///
    /// [`StoreError::Damaged`] if a row is missing or wrong.
    pub fn index(&self) -> Result<Arc<NodeIndex>, StoreError> {
        if let Some(index) = self.inner.index.get() {
            return Ok(index.clone());
        }
        let index = self.inner.with(|c| whole_index(c, &self.inner.site))?;
        Ok(self.inner.index.get_or_init(|| Arc::new(index)).clone())
    }

    /// What can be read of the nodes of a damaged store, and what is wrong with the rest. A damaged node is left out
    /// with all that lies below it, so counts above it are not those of what is there.
    ///
    /// # Errors
    ///
    /// [`StoreError`] if nothing can be read.
    pub fn readable_index(&self) -> Result<(Arc<NodeIndex>, Vec<StoreError>), StoreError> {
        if let Some(index) = self.inner.index.get() {
            return Ok((index.clone(), Vec::new()));
        }
        let (index, damage) = self.inner.with(|c| Ok(NodeIndex::load(c, &self.inner.site)))?;
        Ok((Arc::new(index), damage.into_iter().map(|e| self.inner.place.error(e)).collect()))
    }

    /// The zone maps of a node of [`Snapshot::index`], kept after the first call.
    ///
    /// # Errors
    ///
    /// [`StoreError::Damaged`] if the row is missing or wrong.
    ///
    /// # Panics
    ///
    /// If there is no such node.
    pub fn zones(&self, node: NodeIx) -> Result<Arc<Zones>, StoreError> {
        let index = self.index()?;
        let cells = self.inner.zones.get_or_init(|| (0..index.len()).map(|_| OnceLock::new()).collect());
        let cell = &cells[node as usize];
        if let Some(zones) = cell.get() {
            return Ok(zones.clone());
        }
        let head = index.head(node);
        let zones = Arc::new(self.inner.with(|c| rows::load_zones(c, head.layer, head.cube))?);
        Ok(cell.get_or_init(|| zones).clone())
    }

    /// The encoded bytes of one column of a part; `None` if the part has none, because no point of it has the
    /// attribute.
    ///
    /// # Errors
    ///
    /// As [`Snapshot::read_part`].
    pub fn chunk_bytes(
        &self,
        head: &NodeHead,
        part: usize,
        slot: Slot,
        cost: &mut ReadCost,
    ) -> Result<Option<ChunkBytes>, StoreError> {
        Ok(self.read_part(head, part, &[slot], cost)?.pop().flatten())
    }

    /// The encoded bytes of several columns of a part, in the order of `slots`; `None` for a column that the part does
    /// not have, because no point of it has the attribute. A packed row is read once.
    ///
    /// # Errors
    ///
    /// [`StoreError::Damaged`] if a row is missing, its checksum is wrong, or it belongs elsewhere; also if there is no
    /// such part.
    pub fn read_part(
        &self,
        head: &NodeHead,
        part: usize,
        slots: &[Slot],
        cost: &mut ReadCost,
    ) -> Result<Vec<Option<ChunkBytes>>, StoreError> {
        self.inner.with(|c| read_part(c, head, part, slots, cost))
    }

    /// Named cameras, as JSON, by name.
    ///
    /// # Errors
    ///
    /// [`StoreError::Damaged`] if a row is wrong.
    pub fn bookmarks(&self) -> Result<Vec<(String, String)>, StoreError> {
        self.inner.with(rows::load_bookmarks)
    }

    pub(super) fn with<R>(&self, read: impl FnOnce(&Connection) -> Result<R, RowError>) -> Result<R, StoreError> {
        self.inner.with(read)
    }

    pub(super) fn site_row(&self) -> &SiteRow {
        &self.inner.site
    }

    pub(super) fn place(&self) -> &Arc<Place> {
        &self.inner.place
    }
}

fn whole_index(connection: &Connection, site: &SiteRow) -> Result<NodeIndex, RowError> {
    let (index, damage) = NodeIndex::load(connection, site);
    damage.into_iter().next().map_or(Ok(index), Err)
}

/// See [`Snapshot::read_part`].
fn read_part(
    connection: &Connection,
    head: &NodeHead,
    part: usize,
    slots: &[Slot],
    cost: &mut ReadCost,
) -> Result<Vec<Option<ChunkBytes>>, RowError> {
    let name = |slot| RowName { head, part, slot };
    let facts = head.parts.get(part).ok_or_else(|| name(SLOT_PACKED).damage("the node has no such part"))?;
    let mut packed = None;
    let mut columns = Vec::with_capacity(slots.len());
    for &slot in slots {
        if let Ok(i) = facts.chunks.binary_search_by_key(&slot, |c| c.0) {
            let bytes = rows::read_chunk(connection, name(slot), facts.chunks[i].1)?;
            cost.rows += 1;
            cost.bytes += bytes.len() as u64;
            columns.push(Some(ChunkBytes { range: 0..bytes.len(), row: Arc::new(bytes) }));
        } else if facts.packed.binary_search_by_key(&slot, |c| c.0).is_ok() {
            let (row, directory) = match &packed {
                Some(packed) => packed,
                None => {
                    let row = rows::read_chunk(connection, name(SLOT_PACKED), facts.packed_bytes)?;
                    cost.rows += 1;
                    cost.bytes += row.len() as u64;
                    let directory = rows::unpack(&row).map_err(|what| name(SLOT_PACKED).damage(what))?;
                    if !directory.iter().map(|d| (d.0, d.1.len() as u32)).eq(facts.packed.iter().copied()) {
                        return Err(name(SLOT_PACKED).damage("the columns are not those of the node's row"));
                    }
                    packed.insert((Arc::new(row), directory))
                }
            };
            let found = directory.binary_search_by_key(&slot, |d| d.0).ok();
            columns.push(found.map(|i| ChunkBytes { row: row.clone(), range: directory[i].1.clone() }));
        } else {
            columns.push(None);
        }
    }
    Ok(columns)
}

impl Inner {
    /// Reads what every snapshot has. For a file, `connection` is in a read transaction, which goes on.
    pub fn of_file(place: &Arc<Place>, connection: Connection, renews: bool) -> Result<Self, RowError> {
        let (site, scans, attributes) = facts(&connection)?;
        let lanes = Lanes::new(place.clone(), connection, site.site.generation, renews);
        Ok(Self {
            place: place.clone(),
            source: Source::File(lanes),
            site,
            scans,
            attributes,
            index: OnceLock::new(),
            zones: OnceLock::new(),
        })
    }

    /// Reads everything but chunk rows.
    pub fn of_memory(place: &Arc<Place>) -> Result<Self, RowError> {
        let Place::Memory(memory) = &**place else {
            return Err(RowError::Inconsistent("the store is not in memory".into()));
        };
        let connection = lock(&memory.connection);
        let (site, scans, attributes) = facts(&connection)?;
        let index = whole_index(&connection, &site)?;
        let zones = index
            .heads()
            .iter()
            .map(|h| Ok(OnceLock::from(Arc::new(rows::load_zones(&connection, h.layer, h.cube)?))))
            .collect::<Result<Vec<_>, RowError>>()?;
        *lock(&memory.snapshots).entry(site.site.generation).or_default() += 1;
        Ok(Self {
            place: place.clone(),
            source: Source::Memory,
            site,
            scans,
            attributes,
            index: OnceLock::from(Arc::new(index)),
            zones: OnceLock::from(zones),
        })
    }

    pub fn generation(&self) -> u64 {
        self.site.site.generation
    }

    fn with<R>(&self, read: impl FnOnce(&Connection) -> Result<R, RowError>) -> Result<R, StoreError> {
        match (&self.source, &*self.place) {
            (Source::File(lanes), _) => lanes.with(read),
            (Source::Memory, Place::Memory(memory)) => read(&lock(&memory.connection)).map_err(|e| self.place.error(e)),
            (Source::Memory, Place::File(_)) => Err(StoreError::Busy { path: self.place.path().into() }),
        }
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        if let (Source::Memory, Place::Memory(memory)) = (&self.source, &*self.place) {
            let mut snapshots = lock(&memory.snapshots);
            if let Some(n) = snapshots.get_mut(&self.site.site.generation) {
                *n -= 1;
                if *n == 0 {
                    snapshots.remove(&self.site.site.generation);
                }
            }
        }
    }
}

/// Site, scans and attributes, and that none is missing.
pub(super) fn facts(connection: &Connection) -> Result<(SiteRow, Vec<Scan>, Vec<StoredAttribute>), RowError> {
    let site = rows::load_site(connection)?;
    let scans = rows::load_scans(connection)?;
    let attributes = rows::load_attributes(connection)?;
    for (table, found, expected) in
        [("scan", scans.len(), site.scans), ("attribute", attributes.len(), site.attributes)]
    {
        if found as u64 != expected {
            let what = format!("there are {found}, but {expected} were written");
            return Err(RowError::damage(table, "all rows", what));
        }
    }
    for scan in &scans {
        let known = |slot: &Slot| attributes.binary_search_by_key(slot, |a| a.id).is_ok();
        if scan.id >= site.next_scan {
            return Err(RowError::damage("scan", format!("scan {}", scan.id), "the number was never given out"));
        }
        if !scan.attributes.iter().all(known) {
            return Err(RowError::damage("scan", format!("scan {}", scan.id), "has an attribute that is missing"));
        }
    }
    Ok((site, scans, attributes))
}

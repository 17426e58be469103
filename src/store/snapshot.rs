//! What a reader holds: one generation of a store, for as long as it likes.

use super::cache::{CachedBlock, block_key};
use super::error::{RowError, StoreError};
use super::index::{NodeIndex, NodeIx};
use super::lanes::Lanes;
use super::leaders;
use super::model::{NodeHead, SLOT_PACKED, Scan, ScanId, Site, Slot, StoredAttribute, Zones};
use super::nodes::{Nodes, Pages};
use super::place::{Limits, Place, lock};
use super::rows::{self, ReadChunk, RowName, SiteRow};
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
    pages: Pages,
    #[cfg(test)]
    reads: std::sync::Mutex<std::collections::BTreeSet<PayloadRead>>,
}

/// A column of a node's payload: its layer, its node, its slot.
#[cfg(test)]
pub type PayloadRead = (u16, crate::lattice::NodeKey, Slot);

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
    /// Rows that did not have to be read, because they were in the store's cache.
    pub cached: u64,
}

impl AddAssign for ReadCost {
    fn add_assign(&mut self, other: Self) {
        self.rows += other.rows;
        self.bytes += other.bytes;
        self.cached += other.cached;
    }
}

/// One encoded column of one part: what `codec` decodes. Cheap to clone.
#[derive(Clone, Debug)]
pub struct ChunkBytes {
    row: Arc<Vec<u8>>,
    range: Range<usize>,
    /// The blocks that are there; `None`: all.
    blocks: Option<Arc<[bool]>>,
}

impl ChunkBytes {
    /// Is a block there? One that is not can't be decoded.
    pub fn has(&self, block: usize) -> bool {
        self.blocks.as_ref().is_none_or(|blocks| blocks.get(block).copied().unwrap_or(false))
    }
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

    /// The attributes that this one is encoded after, in order; its chunks can be decoded only with theirs. In a part it
    /// follows those before the first that the part does not have.
    pub(crate) fn leaders(&self, id: Slot) -> impl Iterator<Item = Slot> + '_ {
        leaders::leaders(self.attributes(), id)
    }

    /// Are others encoded after this attribute?
    pub(crate) fn leads(&self, id: Slot) -> bool {
        leaders::leads(self.attributes(), id)
    }

    /// All nodes, read and checked at the first call: for work on all of them.
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
    pub(crate) fn readable_index(&self) -> Result<(Arc<NodeIndex>, Vec<StoreError>), StoreError> {
        if let Some(index) = self.inner.index.get() {
            return Ok((index.clone(), Vec::new()));
        }
        let (index, damage) = self.inner.with(|c| Ok(NodeIndex::load(c, &self.inner.site)))?;
        Ok((Arc::new(index), damage.into_iter().map(|e| self.inner.place.error(e)).collect()))
    }

    /// The nodes, each read when it is looked at.
    pub fn nodes(&self) -> Nodes {
        Nodes::of(self.clone())
    }

    /// The zone maps of a node, by its number.
    ///
    /// # Errors
    ///
    /// [`StoreError::Damaged`] if the row is missing or wrong.
    pub fn zones(&self, node: NodeIx) -> Result<Arc<Zones>, StoreError> {
        let nodes = self.nodes();
        nodes.zones(&nodes.node(node)?)
    }

    /// The encoded bytes of one column of a part; `None` if the part has none, because no point of it has the
    /// attribute.
    ///
    /// # Errors
    ///
    /// As [`Snapshot::read_part`].
    pub(crate) fn chunk_bytes(
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
    pub(crate) fn read_part(
        &self,
        head: &NodeHead,
        part: usize,
        slots: &[Slot],
        cost: &mut ReadCost,
    ) -> Result<Vec<Option<ChunkBytes>>, StoreError> {
        self.read_blocks(head, part, slots, None, cost)
    }

    /// The same of some blocks, unless rows are kept: `wanted` is asked for each row that has several, by its slot, with bytes
    /// of which the blocks are not there yet, and says which it wants (`None`: all).
    ///
    /// # Errors
    ///
    /// As [`Snapshot::read_part`]; blocks that are not wanted may be damaged.
    pub(crate) fn read_blocks(
        &self,
        head: &NodeHead,
        part: usize,
        slots: &[Slot],
        mut wanted: Option<&mut WantedBlocks<'_>>,
        cost: &mut ReadCost,
    ) -> Result<Vec<Option<ChunkBytes>>, StoreError> {
        #[cfg(test)]
        lock(&self.inner.reads).extend(slots.iter().map(|&slot| (head.layer, head.cube.node_key(), slot)));
        let place = &*self.inner.place;
        let caches = place.caches();
        // What is kept may be asked for other blocks next time.
        let is_cut = !caches.keeps_rows() && head.blocks(part).count() > 1;
        let mut row = |slot: Slot, bytes: u32| {
            let name = RowName { head, part, slot };
            let id = head.chunk_id(part, slot);
            if let Some(row) = caches.row(id) {
                cost.cached += 1;
                return Ok((row, None));
            }
            let read = self.inner.with(|c| match &mut wanted {
                Some(wanted) if is_cut => rows::read_blocks(c, name, bytes, &mut |bytes| wanted(slot, bytes)),
                _ => rows::read_chunk(c, name, bytes),
            });
            let ReadChunk { bytes, blocks, read } = read?;
            let row = Arc::new(bytes);
            cost.rows += 1;
            cost.bytes += read as u64;
            if blocks.is_none() {
                caches.keep_row(id, &row);
            }
            Ok((row, blocks.map(Arc::from)))
        };
        read_part(place, head, part, slots, &mut row)
    }

    /// A decoded block of a column that an earlier query has kept.
    pub(crate) fn cached_block(&self, head: &NodeHead, part: usize, slot: Slot, block: usize) -> Option<CachedBlock> {
        self.inner.place.caches().block(block_key(head, part, slot, block))
    }

    /// Keeps a decoded block for later queries, if there is room.
    pub(crate) fn keep_block(&self, head: &NodeHead, part: usize, slot: Slot, block: usize, decoded: CachedBlock) {
        self.inner.place.caches().keep_block(block_key(head, part, slot, block), decoded);
    }

    /// The most bytes of decoded blocks that are kept.
    pub(crate) fn kept_block_bytes(&self) -> u64 {
        self.inner.place.caches().block_limit()
    }

    /// Which payload was read through this snapshot, and through others of its generation and store, since the last call.
    #[cfg(test)]
    pub fn take_reads(&self) -> std::collections::BTreeSet<PayloadRead> {
        std::mem::take(&mut *lock(&self.inner.reads))
    }

    /// Named cameras, as JSON, by name. They belong to no generation: those that there are now, unless there is a newer one.
    ///
    /// # Errors
    ///
    /// [`StoreError::Damaged`] if a row is wrong.
    pub fn bookmarks(&self) -> Result<Vec<(String, String)>, StoreError> {
        match &self.inner.source {
            Source::File(lanes) => lanes.with_renewed(rows::load_bookmarks),
            Source::Memory => self.with(rows::load_bookmarks),
        }
    }

    pub(super) fn with<R>(&self, read: impl FnOnce(&Connection) -> Result<R, RowError>) -> Result<R, StoreError> {
        self.inner.with(read)
    }

    pub(super) fn site_row(&self) -> &SiteRow {
        &self.inner.site
    }

    pub(super) fn pages(&self) -> &Pages {
        &self.inner.pages
    }

    pub(super) fn place(&self) -> &Arc<Place> {
        &self.inner.place
    }
}

fn whole_index(connection: &Connection, site: &SiteRow) -> Result<NodeIndex, RowError> {
    let (index, damage) = NodeIndex::load(connection, site);
    damage.into_iter().next().map_or(Ok(index), Err)
}

/// The bytes of a row, and which blocks of it are there; `None`: all.
type Row = (Arc<Vec<u8>>, Option<Arc<[bool]>>);

/// Says which blocks of a row are wanted: see [`Snapshot::read_blocks`].
pub type WantedBlocks<'w> = dyn FnMut(Slot, &[u8]) -> Option<Vec<bool>> + 'w;

/// See [`Snapshot::read_part`]; `row` gives a row of the part.
fn read_part(
    place: &Place,
    head: &NodeHead,
    part: usize,
    slots: &[Slot],
    row: &mut dyn FnMut(Slot, u32) -> Result<Row, StoreError>,
) -> Result<Vec<Option<ChunkBytes>>, StoreError> {
    let packed_damage = |what: &str| place.error(RowName { head, part, slot: SLOT_PACKED }.damage(what));
    let facts = head.parts.get(part).ok_or_else(|| packed_damage("the node has no such part"))?;
    let mut packed = None;
    let mut columns = Vec::with_capacity(slots.len());
    for &slot in slots {
        if let Ok(i) = facts.chunks.binary_search_by_key(&slot, |c| c.0) {
            let (row, blocks) = row(slot, facts.chunks[i].1)?;
            columns.push(Some(ChunkBytes { range: 0..row.len(), row, blocks }));
        } else if facts.packed.binary_search_by_key(&slot, |c| c.0).is_ok() {
            let (row, blocks, directory) = match &packed {
                Some(packed) => packed,
                None => {
                    let (row, blocks) = row(SLOT_PACKED, facts.packed_bytes)?;
                    let directory = rows::unpack(&row).map_err(|what| packed_damage(&what))?;
                    if !directory.iter().map(|d| (d.0, d.1.len() as u32)).eq(facts.packed.iter().copied()) {
                        return Err(packed_damage("the columns are not those of the node's row"));
                    }
                    packed.insert((row, blocks, directory))
                }
            };
            let found = directory.binary_search_by_key(&slot, |d| d.0).ok();
            let range = |i: usize| directory[i].1.clone();
            columns.push(found.map(|i| ChunkBytes { row: row.clone(), range: range(i), blocks: blocks.clone() }));
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
        let limits = match &**place {
            Place::File(file) => file.limits,
            Place::Memory(_) => Limits::default(),
        };
        let (index, pages) = match site.site.generation {
            // Nothing is there, whatever comes: no transaction is held that would see to it.
            0 => {
                let (roots, zones) = (std::iter::empty(), Vec::new());
                (OnceLock::from(Arc::new(whole_index(&connection, &site)?)), Pages::whole(Vec::new(), roots, zones))
            }
            _ => (OnceLock::new(), Pages::new(limits.node_bytes)),
        };
        let lanes = Lanes::new(place.clone(), connection, site.site.generation, renews);
        Ok(Self {
            place: place.clone(),
            source: Source::File(lanes),
            site,
            scans,
            attributes,
            index,
            pages,
            #[cfg(test)]
            reads: Default::default(),
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
        let heads = index.heads().to_vec();
        let zones = heads.iter().map(|h| rows::load_zones(&connection, h.layer, h.cube)).collect::<Result<_, _>>()?;
        let are_roots = (0..heads.len() as NodeIx).map(|node| index.parent(node).is_none());
        let pages = Pages::whole(heads, are_roots, zones);
        *lock(&memory.snapshots).entry(site.site.generation).or_default() += 1;
        Ok(Self {
            place: place.clone(),
            source: Source::Memory,
            site,
            scans,
            attributes,
            index: OnceLock::from(Arc::new(index)),
            pages,
            #[cfg(test)]
            reads: Default::default(),
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

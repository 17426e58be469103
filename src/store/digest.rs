//! What proves that two stores hold the same: two hashes over content alone (law 3).
//!
//! No row ids, parts, layers, statistics or times go in. docs/format.md has the bytes that are hashed.

use super::decode::{DecodedPart, decode_part};
use super::error::{RowError, StoreError};
use super::model::{Scan, ScanId, Slot};
use super::snapshot::Snapshot;
use crate::codec::Decoder;
use crate::lattice::{Cube, Key};
use crate::points::{Column, Identity};
use blake3::{Hash, Hasher};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// The two hashes of a store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Digest {
    /// Lattice, sampling rule, and per node the sorted multiset of records.
    pub points: Hash,
    /// The same with the identity of each record's scan.
    pub scans: Hash,
}

/// Computes both hashes of a store of one layer; decodes all of it. `go_on` is told the points of each node
/// when they were hashed, in no order and from any thread; false gives `None`.
///
/// # Errors
///
/// [`StoreError::Damaged`] if anything can't be read; [`StoreError::Unsupported`] if there are several layers: the
/// digest is that of the merged tree, which [`crate::ingest::digest`] makes.
pub fn digest(snapshot: &Snapshot, go_on: &(dyn Fn(u64) -> bool + Sync)) -> Result<Option<Digest>, StoreError> {
    let index = snapshot.index()?;
    if index.roots().count() > 1 {
        let path = snapshot.place().path().into();
        return Err(StoreError::Unsupported { path, what: "the digest of several layers".into() });
    }
    let digester = Digester::new(snapshot)?;
    let nodes: Option<Vec<Digest>> = index
        .heads()
        .par_iter()
        .map_init(Decoder::new, |decoder, head| {
            let parts = (0..head.parts.len()).map(|part| decode_part(snapshot, head, part, decoder));
            let node = digester.node(head.cube, head.leaf, parts)?;
            Ok(go_on(head.own_points).then_some(node))
        })
        .collect::<Result<Option<_>, StoreError>>()?;
    Ok(nodes.map(|nodes| digester.store(&nodes)))
}

/// Hashes nodes one by one, then what they come to.
pub struct Digester<'a> {
    snapshot: &'a Snapshot,
    scans: BTreeMap<ScanId, ScanFacts>,
}

impl<'a> Digester<'a> {
    /// For content whose scans are those of this snapshot.
    ///
    /// # Errors
    ///
    /// [`StoreError::Damaged`] if a scan has an attribute that is missing.
    pub fn new(snapshot: &'a Snapshot) -> Result<Self, StoreError> {
        let facts = snapshot.scans().iter().map(|s| Ok((s.id, ScanFacts::of(snapshot, s)?)));
        Ok(Self { snapshot, scans: facts.collect::<Result<_, StoreError>>()? })
    }

    /// The two hashes of a node.
    ///
    /// # Errors
    ///
    /// Those of `parts`; [`StoreError::Damaged`] if a point has no scan, or lacks an attribute of its scan.
    pub fn node(
        &self,
        cube: Cube,
        leaf: bool,
        parts: impl IntoIterator<Item = Result<DecodedPart, StoreError>>,
    ) -> Result<Digest, StoreError> {
        // By kind of record: with its scan's attributes alone, and with its scan's identity too.
        let mut by_set: BTreeMap<[u8; 32], Records> = BTreeMap::new();
        let mut by_scan: BTreeMap<([u8; 32], [u8; 32]), Records> = BTreeMap::new();
        for (part, decoded) in parts.into_iter().enumerate() {
            let decoded = decoded?;
            for &scan in present(&decoded.scans).iter() {
                let wrong = |what: &str| {
                    let key = format!("node at {:?}, side 2^{}, part {part}", cube.low().0, cube.k());
                    self.snapshot.place().error(RowError::damage("chunk", key, format!("{what} of scan {scan}")))
                };
                let facts = self.scans.get(&scan).ok_or_else(|| wrong("has points, but there is no row,"))?;
                let records = records_of(&decoded, scan, facts).ok_or_else(|| wrong("lacks an attribute"))?;
                append(by_set.entry(facts.set).or_default(), &records);
                append(by_scan.entry((facts.identity, facts.set)).or_default(), &records);
            }
        }
        let mut points = begin(cube, leaf);
        let mut all = points.clone();
        for (set, records) in &by_set {
            points.update(set);
            records.put(&mut points);
        }
        for ((identity, set), records) in &by_scan {
            all.update(identity);
            all.update(set);
            records.put(&mut all);
        }
        Ok(Digest { points: points.finalize(), scans: all.finalize() })
    }

    /// The two hashes of the store with these nodes, which are in the order of their keys.
    pub fn store(&self, nodes: &[Digest]) -> Digest {
        let site = self.snapshot.site();
        let mut points = Hasher::new();
        points.update(b"esker digest 1\0");
        for decimal in site.lattice.quantum().into_iter().chain(site.lattice.phase()) {
            points.update(&decimal.mantissa().to_le_bytes());
            points.update(&decimal.exponent().to_le_bytes());
        }
        points.update(&[site.g]);
        points.update(&site.leaf_capacity.to_le_bytes());
        let mut all = points.clone();
        points.update(b"points\0");
        all.update(b"scans\0");
        for node in nodes {
            points.update(node.points.as_bytes());
            all.update(node.scans.as_bytes());
        }
        Digest { points: points.finalize(), scans: all.finalize() }
    }
}

/// What a record's scan contributes to it.
pub(super) struct ScanFacts {
    pub identity: [u8; 32],
    /// Hash of the identities of the attributes in canonical order.
    set: [u8; 32],
    /// The attributes in canonical order: column and bytes of a value.
    pub attributes: Vec<(Slot, usize)>,
}

impl ScanFacts {
    pub fn of(snapshot: &Snapshot, scan: &Scan) -> Result<Self, StoreError> {
        let mut attributes = Vec::with_capacity(scan.attributes.len());
        for &slot in &scan.attributes {
            let stored = snapshot.attribute(slot).ok_or_else(|| {
                let what = format!("attribute {slot} is missing");
                snapshot.place().error(RowError::damage("scan", format!("scan {}", scan.id), what))
            })?;
            attributes.push((stored.attribute.identity(), slot));
        }
        attributes.sort();
        let mut set = Hasher::new();
        for (Identity { name, ty, scaling, no_data }, _) in &attributes {
            set.update(&(name.len() as u64).to_le_bytes());
            set.update(name.as_bytes());
            set.update(ty.word().as_bytes());
            set.update(b"\0");
            set.update(&[scaling.is_some().into()]);
            if let Some([scale, offset]) = scaling {
                set.update(&scale.to_le_bytes());
                set.update(&offset.to_le_bytes());
            }
            set.update(&[no_data.is_some().into()]);
            if let Some(bytes) = no_data {
                set.update(bytes);
            }
        }
        let attributes = attributes.iter().map(|(identity, slot)| (*slot, identity.ty.size())).collect();
        Ok(Self { identity: scan.identity, set: set.finalize().into(), attributes })
    }
}

/// Records of one kind in a node: all have the same length, so that a run of bytes has one reading.
#[derive(Default)]
struct Records {
    keys: Vec<Key>,
    /// `stride` bytes per record.
    bytes: Vec<u8>,
    stride: usize,
}

impl Records {
    /// Hashes count and records, ordered by key, then by bytes.
    fn put(&self, hash: &mut Hasher) {
        let record = |i: usize| &self.bytes[i * self.stride..(i + 1) * self.stride];
        let mut order: Vec<usize> = (0..self.keys.len()).collect();
        // Stable, so that the runs that the parts are already in are used.
        order.sort_by(|&a, &b| self.keys[a].cmp(&self.keys[b]).then_with(|| record(a).cmp(record(b))));
        hash.update(&(order.len() as u64).to_le_bytes());
        let mut buffer = Vec::with_capacity(64 << 10);
        for i in order {
            for c in self.keys[i].point().0 {
                buffer.extend_from_slice(&c.to_le_bytes()[..6]);
            }
            buffer.extend_from_slice(record(i));
            if buffer.len() > 60 << 10 {
                hash.update(&buffer);
                buffer.clear();
            }
        }
        hash.update(&buffer);
    }
}

fn begin(cube: Cube, leaf: bool) -> Hasher {
    let mut hash = Hasher::new();
    hash.update(&cube.node_key().0);
    hash.update(&[leaf.into()]);
    hash
}

fn append(into: &mut Records, more: &Records) {
    into.stride = more.stride;
    into.keys.extend_from_slice(&more.keys);
    into.bytes.extend_from_slice(&more.bytes);
}

/// The different scans, ascending.
fn present(scans: &[ScanId]) -> Vec<ScanId> {
    let mut present: Vec<ScanId> = scans.chunk_by(|a, b| a == b).map(|run| run[0]).collect();
    present.sort_unstable();
    present.dedup();
    present
}

/// The records of one scan in a part; `None` if a column is missing.
fn records_of(part: &DecodedPart, scan: ScanId, facts: &ScanFacts) -> Option<Records> {
    let chosen: Vec<usize> = (0..part.scans.len()).filter(|&i| part.scans[i] == scan).collect();
    let stride = facts.attributes.iter().map(|a| a.1).sum();
    let mut bytes = vec![0; stride * chosen.len()];
    let mut offset = 0;
    for &(slot, size) in &facts.attributes {
        let i = part.columns.binary_search_by_key(&slot, |c| c.0).ok()?;
        let column: &Column = &part.columns[i].1;
        for (record, &i) in bytes.chunks_exact_mut(stride).zip(&chosen) {
            record[offset..offset + size].copy_from_slice(&column.raw(i)[..size]);
        }
        offset += size;
    }
    Some(Records { keys: chosen.iter().map(|&i| part.keys[i]).collect(), bytes, stride })
}
